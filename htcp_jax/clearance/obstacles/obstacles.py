"""The paper's D(x, O), equation (2): the smallest distance between the arm and its obstacles, and its contact.

O is a tuple of obstacles, see `obstacle`. A workpiece's obstacles are its points and, if it has one, the interior rule.
This module concatenates the rows of all obstacles: first one row per body, with the nearest contact of all kinds with
`per_body`, then the rows of every other kind.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from htcp_jax.backend import backend
from htcp_jax.clearance.obstacles.narrow_phase import decide_together
from htcp_jax.clearance.obstacles.obstacle import (
    DECIDED_M,
    BodyAxes,
    Contacts,
    HasWorkpiecePose,
    Obstacles,
    bodies_at,
    grouped,
    rows_of,
    slopes,
)
from htcp_jax.model import Robot, kinematics
from htcp_jax.model import robot as robots
from htcp_jax.numerics import one_by_one, value_and_jacobian, with_gradient
from htcp_jax.types import Bool, Float, Joints, Scalar


class ClearanceRows(NamedTuple):
    """Distances at one configuration, to first order."""

    distance: Float[jax.Array, "R"]  # [m]
    gradient: Float[jax.Array, "R N"]  # [m/rad]


@partial(jax.jit, static_argnames="smallest")
def contacts(
    robot: Robot, obstacles: Obstacles, where: HasWorkpiecePose, x: Joints, smallest: bool = False
) -> Contacts:
    """Return the nearest contact of every row at configuration x [rad or m].

    Args:
        robot: The robot, with the scenario's tool.
        obstacles: The obstacles O.
        where: A scenario, or another `HasWorkpiecePose`.
        x: The configuration [rad or m].
        smallest: True: only the row with the smallest distance has to be exact; other distances may be overestimated,
            see `Obstacle.closest`.
    """
    return contacts_of_each(robot, obstacles, where, x, smallest)[0]


def contacts_of_each(
    robot: Robot, obstacles: Obstacles, where: HasWorkpiecePose, x: Joints, smallest: bool = False
) -> tuple[Contacts, list[list[Contacts]]]:
    """Return the contacts of all rows, see `contacts`, and those of each obstacle in each group, see `grouped`."""
    bodies = bodies_at(robot, where, x)
    obstacles = decide_together(robot, obstacles, where, bodies)
    query = lambda each: each.closest if smallest else each.contacts  # noqa: E731
    groups = [[query(each)(robot, where, bodies) for each in own] for own in grouped(obstacles)]
    return _one_after_another([_nearest_contacts(own) for own in groups]), groups


def clearances(
    robot: Robot, obstacles: Obstacles, where: HasWorkpiecePose, x: Joints, smallest: bool = False
) -> Float[jax.Array, "R"]:
    """Return the distance D of every row [m].

    Its derivative in x [m/rad] is n' (J_body - J_other) at the nearest points, which are fixed (envelope theorem).

    Args:
        robot: The robot, with the scenario's tool.
        obstacles: The obstacles O.
        where: A scenario, or another `HasWorkpiecePose`.
        x: The configuration [rad or m].
        smallest: True: only the row of the smallest distance has to be exact, see `contacts`.
    """
    distance = lambda x, *scene: contacts(*scene, x, smallest).distance  # noqa: E731
    return with_gradient(distance, partial(_distances_and_gradients, smallest))(
        kinematics.checked_configuration(robot, x), robot, obstacles, where
    )


@jax.jit
def minimum_clearance(robot: Robot, obstacles: Obstacles, where: HasWorkpiecePose, x: Joints) -> Scalar:
    """Return D(x, O) [m], the smallest distance of all rows; its derivative is that of the smallest row.

    This is cheaper than `clearances`.

    Args:
        robot: The robot, with the scenario's tool.
        obstacles: The obstacles O.
        where: A scenario, or another `HasWorkpiecePose`.
        x: The configuration [rad or m].
    """
    return _smallest(kinematics.checked_configuration(robot, x), robot, obstacles, where)


@jax.jit
def is_clear(
    robot: Robot,
    obstacles: Obstacles,
    where: HasWorkpiecePose,
    x: Joints,
    margin_m: Float[ArrayLike, ""] = 0.0,
) -> Bool[jax.Array, ""]:
    """Return True if D(x, O) > margin_m, the verdict of `minimum_clearance`; cheaper, as the value is not computed.

    On a CPU the query ends at the first distance below the margin. If such a distance is within DECIDED_M of the
    margin, `minimum_clearance` decides.

    Args:
        robot: The robot, with the scenario's tool.
        obstacles: The obstacles O.
        where: A scenario, or another `HasWorkpiecePose`.
        x: The configuration [rad or m].
        margin_m: Required clearance [m], 0 or more.
    """
    bodies = bodies_at(robot, where, kinematics.checked_configuration(robot, x))
    margin = jnp.asarray(margin_m, float)
    if backend().is_cpu:
        return _is_clear_alone(obstacles, robot, where, bodies, margin)
    if robot.pieces is not None:
        return _smallest_of(robot, obstacles, where, bodies) > margin
    return _any_below(obstacles, robot, where, bodies, margin + DECIDED_M) > margin


def _any_below(obstacles: Obstacles, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes, limit: Scalar) -> Scalar:
    """Return a distance below the limit [m], see `Obstacle.any_below`."""
    if backend().is_cpu:
        return _first_below(obstacles, robot, where, bodies, limit)
    return _together(jnp.minimum, [each.any_below(robot, where, bodies, limit) for each in obstacles])


@one_by_one
def _first_below(
    obstacles: Obstacles, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes, limit: Scalar
) -> Scalar:
    found = jnp.full((), jnp.inf)
    for each in obstacles:
        measure = lambda each=each: each.any_below(robot, where, bodies, limit)  # noqa: E731
        found = jax.lax.cond(found < limit, lambda found=found: found, measure)
    return found


@one_by_one
def _is_clear_alone(obstacles: Obstacles, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes, margin):
    limit = margin + DECIDED_M
    found = _any_below(obstacles, replace(robot, pieces=None), where, bodies, limit)  # a mesh is not nearer
    is_refuted = (found <= margin - DECIDED_M) & (robot.pieces is None)
    exact = lambda: _smallest_of(robot, obstacles, where, bodies) > margin  # noqa: E731
    return jax.lax.cond((found < limit) & ~is_refuted, exact, lambda: found >= limit)


@jax.jit
def surely_collides(robot: Robot, obstacles: Obstacles, where: HasWorkpiecePose, x: Joints) -> Bool[jax.Array, ""]:
    """Return True if a body certainly touches at x; False if it does not, or if only `minimum_clearance` can.

    This is cheaper than `is_clear`, and much shorter code for an arm with pieces: it measures only capsules, with the
    core radius, within which the bodies certainly lie around.
    """
    bodies = bodies_at(robot, where, kinematics.checked_configuration(robot, x))
    core, limit = replace(robot, capsule_radius=robots.core_radius(robot), pieces=None), jnp.full((), -DECIDED_M)
    return _any_below(obstacles, core, where, bodies, limit) < limit


def free_radius(robot: Robot, obstacles: Obstacles, where: HasWorkpiecePose, x: Joints) -> Float[jax.Array, "R"]:
    """Return each row's free radius [m] at x, see `Obstacle.free_radius`; at most 0 in collision."""
    bodies = bodies_at(robot, where, x)
    obstacles = decide_together(robot, obstacles, where, bodies)
    groups = [[each.free_radius(robot, where, bodies) for each in own] for own in grouped(obstacles)]
    return _one_after_another([_together(jnp.minimum, own) for own in groups])


def clearance_rows(
    robot: Robot, obstacles: Obstacles, where: HasWorkpiecePose, x: Joints, smallest: bool = False
) -> ClearanceRows:
    """Return the distances and their gradients at x: `clearances` and its Jacobian, from one evaluation."""
    return ClearanceRows(*value_and_jacobian(lambda x: clearances(robot, obstacles, where, x, smallest), x))


def _smallest_distance(x: Joints, robot: Robot, obstacles: Obstacles, where: HasWorkpiecePose) -> Scalar:
    return _smallest_of(robot, obstacles, where, bodies_at(robot, where, x))


def _smallest_of(robot: Robot, obstacles: Obstacles, where: HasWorkpiecePose, bodies: BodyAxes) -> Scalar:
    obstacles = decide_together(robot, obstacles, where, bodies)
    return _together(jnp.minimum, [each.smallest(robot, where, bodies) for each in obstacles])


def _distance_and_gradient(
    x: Joints, robot: Robot, obstacles: Obstacles, where: HasWorkpiecePose
) -> tuple[Scalar, Joints]:
    """Return the smallest distance [m] and its gradient in closed form [m/rad]."""
    rows = _distances_and_gradients(True, x, robot, obstacles, where)
    lowest = jnp.argmin(rows.distance)
    return rows.distance[lowest], rows.gradient[lowest]


_smallest = with_gradient(_smallest_distance, _distance_and_gradient)


def _distances_and_gradients(
    smallest: bool, x: Joints, robot: Robot, obstacles: Obstacles, where: HasWorkpiecePose
) -> ClearanceRows:
    """Return the distances [m] and their gradients in closed form [m/rad]."""
    touch, rows = contacts(robot, obstacles, where, x, smallest), rows_of(robot, obstacles)
    return ClearanceRows(touch.distance, slopes(robot, x, rows, touch.normal, touch.point, touch.witness))


def _nearest_contacts(parts: list[Contacts]) -> Contacts:
    """Return for each row the contact with the smallest distance; the first of several equal ones."""
    nearest = parts[0]
    for other in parts[1:]:
        decides = other.distance < nearest.distance
        choose = lambda new, old, d=decides: jnp.where(d.reshape(-1, *[1] * (new.ndim - 1)), new, old)  # noqa: E731
        nearest = jax.tree.map(choose, other, nearest)
    return nearest


def _one_after_another(parts: list):
    return parts[0] if len(parts) == 1 else jax.tree.map(lambda *columns: jnp.concatenate(columns), *parts)


def _together(combine: Callable, values: list[jax.Array]) -> jax.Array:
    whole = values[0]
    for value in values[1:]:
        whole = combine(whole, value)
    return whole
