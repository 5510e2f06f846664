"""How clear the arm stays on an interval of a straight joint path, seen from its middle.

First by how far every body moves, whichever way. Where that is too much, by what a kind of obstacle itself knows of
bodies that move (`obstacle.Sweepable`), if it does. Adaptive bisection by such bounds is Schwarzer, Saha and Latombe's
(Adaptive Dynamic Collision Checking for Single and Multiple Articulated Robots, T-RO 2005).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from htcp_jax.clearance.distance.sweep import Sweep, Wanted
from htcp_jax.clearance.obstacles.obstacle import (
    Bodies,
    Obstacle,
    Obstacles,
    Posed,
    Rows,
    Sweepable,
    bodies_at,
)
from htcp_jax.clearance.proof.motion_bound import sweep, travel_bound
from htcp_jax.model.robot import Robot
from htcp_jax.types import Array, Bool, Float, Joints, Scalar


class Interval(NamedTuple):
    """Of an interval of a joint path."""

    middle: Scalar  # D in its middle, or less [m]
    clear: Scalar  # D on all of it, at least [m]
    proven: Bool[Array, ""]  # whether that is what was wanted


def on_interval(
    robot: Robot,
    obstacles: Obstacles,
    where: Posed,
    x: Joints,
    rates: Joints,
    half: Scalar,
    least: Float[ArrayLike, ""],
    kept: Float[ArrayLike, ""],
    keeps: Bool[Array, ""],
    asked: Bool[Array, ""],
) -> Interval:
    """D on the joint path x + s `rates` [rad or m] with |s| <= half.

    least: what is wanted of it [m]; where it `keeps`, the share `kept` of D in the middle, too. Where it is not asked
    for, the bodies' travel alone is looked at.
    """
    bodies, moves = bodies_at(robot, where, x), sweep(robot, x, rates, half)
    room = [each.room(robot, where, bodies) for each in obstacles]
    middle = jnp.min(jnp.concatenate(room))
    good = jnp.maximum(kept * middle, least)
    # More is found out than has to be: it goes on record.
    wanted = Wanted(jnp.where(keeps, good, least), jnp.maximum(jnp.sqrt(kept) * middle, least))
    clear = []
    for each, own in zip(obstacles, room, strict=True):
        rows = each.rows(robot)
        travel = moves.travel if rows == Rows.of_bodies(robot) else row_travel_bound(robot, rows, x, rates, half)
        closer = isinstance(each, Sweepable)
        clear.append(_closer(each, robot, where, bodies, moves, own, good, wanted, asked) if closer else own - travel)
    clear = jnp.min(jnp.concatenate(clear))
    return Interval(middle, clear, clear >= wanted.least)


def _closer(
    kind: Obstacle,
    robot: Robot,
    where: Posed,
    bodies: Bodies,
    moves: Sweep,
    room: Float[Array, "K"],
    good: Scalar,
    wanted: Wanted,
    asked: Bool[Array, ""],
) -> Float[Array, "K"]:
    """How clear bodies stay of a kind that is asked about those that travel too far; not where one of them hardly can,
    as it would come too near if it moved along a flat wall."""
    by_travel = room - moves.travel
    open_, nearer = by_travel < good, moves.travel**2 / (2 * robot.capsule_radius)  # of a point that it moves towards
    asked &= jnp.all(~open_ | (room - moves.bend >= wanted.least) & (nearer <= 4 * room))
    return jnp.where(open_ & asked, kind.clear_along(robot, where, bodies, moves, open_ & asked, wanted), by_travel)


def row_travel_bound(robot: Robot, rows: Rows, x: Joints, rates: Joints, half: Scalar) -> Float[Array, "R"]:
    """`travel_bound` of each row's body, as seen from the link of the row's other, before it in the chain [m]: with all
    joints up to that link at rest."""
    if any(0 <= other >= robot.capsule_link[body] for body, other in zip(*rows, strict=True)):
        raise ValueError("the body of a row must lie beyond the link of its other")
    seen_from = sorted(set(rows.other))
    moving = np.arange(len(robot.slides))[None, :] > np.array(seen_from)[:, None]
    found = jax.vmap(lambda moving: travel_bound(robot, x, jnp.where(moving, rates, 0.0), half))(moving)
    return found[np.array([seen_from.index(other) for other in rows.other]), np.array(rows.body)]
