"""Lower bound on the clearance on an interval of a straight joint path, from its middle.

First by each body's travel, in any direction. If that is too much, by the obstacle's own bound for moving bodies
(`Obstacle.clear_along`), if it has one. Adaptive bisection by such bounds is Schwarzer, Saha and Latombe's (Adaptive
Dynamic Collision Checking for Single and Multiple Articulated Robots, T-RO 2005).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from htcp_jax.clearance.distance.sweep import BodySweep, RequiredClearance
from htcp_jax.clearance.obstacles import narrow_phase
from htcp_jax.clearance.obstacles.obstacle import (
    BodyAxes,
    HasWorkpiecePose,
    Obstacle,
    Obstacles,
    RowPairs,
    bodies_at,
)
from htcp_jax.clearance.proof.motion_bound import OUTSIDE_M, body_sweep, travel_bound
from htcp_jax.model import Robot
from htcp_jax.types import Array, Bool, Float, Joints, Scalar


class Interval(NamedTuple):
    """Clearance on an interval of a joint path."""

    middle: Scalar  # lower bound on D in its middle [m]
    clear: Scalar  # lower bound on D on all of it [m]
    proven: Bool[Array, ""]  # True: `clear` is at least the required clearance


def on_interval(
    robot: Robot,
    obstacles: Obstacles,
    where: HasWorkpiecePose,
    x: Joints,
    rates: Joints,
    half: Scalar,
    least: Float[ArrayLike, ""],
    kept: Float[ArrayLike, ""],
    keeps: Bool[Array, ""],
    requested: Bool[Array, ""],
) -> Interval:
    """Return bounds on D on the joint path x + s `rates` with |s| <= half.

    Args:
        robot: The robot.
        obstacles: The obstacles.
        where: A scenario, or another `HasWorkpiecePose`.
        x: The middle [rad or m].
        rates: Its derivative in s [rad or m].
        half: Half of the interval's length.
        least: Required clearance [m].
        kept: Share of D in the middle that is required, too, where `keeps`.
        keeps: True: `kept` is required.
        requested: True: obstacles' own bounds are used; False: only the bodies' travel.
    """
    bodies, moves = bodies_at(robot, where, x), body_sweep(robot, x, rates, half)
    measured = narrow_phase.decide_together(robot, obstacles, where, bodies)
    free_radius = [each.free_radius(robot, where, bodies) for each in measured]
    middle = jnp.min(jnp.concatenate(free_radius))
    good = jnp.maximum(kept * middle, least)
    # A larger bound than required is computed, as it is recorded.
    wanted = RequiredClearance(jnp.where(keeps, good, least), jnp.maximum(jnp.sqrt(kept) * middle, least))
    clear = []
    for each, own in zip(obstacles, free_radius, strict=True):
        rows = each.rows(robot)
        travel = moves.travel if rows == RowPairs.of_bodies(robot) else row_travel_bound(robot, rows, x, rates, half)
        if robot.pieces is not None:  # the row's distance may be a piece's, unless it is above the limit
            own_turn = piece_turn_bound(robot, rows, half * jnp.abs(rates))
            travel = travel + jnp.where(own <= narrow_phase.limit_m(where), own_turn, 0.0)
        by_travel = own - travel
        clear.append(
            _closer(each, robot, where, bodies, moves, own, by_travel, good, wanted, requested)
            if each.sweeps
            else by_travel
        )
    clear = jnp.min(jnp.concatenate(clear))
    return Interval(middle, clear, clear >= wanted.least)


def _closer(
    kind: Obstacle,
    robot: Robot,
    where: HasWorkpiecePose,
    bodies: BodyAxes,
    moves: BodySweep,
    free_radius: Float[Array, "K"],
    by_travel: Float[Array, "K"],
    good: Scalar,
    wanted: RequiredClearance,
    requested: Bool[Array, ""],
) -> Float[Array, "K"]:
    """Return a lower bound on the bodies' clearance, by the obstacle's own bound for those that travel too far.

    It is skipped if it can hardly succeed for one of them: if the body would come too near even along a flat wall.
    """
    open_, nearer = by_travel < good, moves.travel**2 / (2 * robot.capsule_radius)  # of a point that it moves towards
    requested &= jnp.all(~open_ | (free_radius - moves.bend >= wanted.least) & (nearer <= 4 * free_radius))
    by_sweep = kind.clear_along(robot, where, bodies, moves, open_ & requested, wanted)
    if robot.pieces is not None:  # whose free radius may be larger than what the capsule's sweep proves
        failed = jnp.any(open_ & requested & (by_sweep < wanted.least))  # then other values are arbitrary
        by_sweep = jnp.where(failed, by_travel, jnp.maximum(by_sweep, by_travel))
    return jnp.where(open_ & requested, by_sweep, by_travel)


def piece_turn_bound(robot: Robot, rows: RowPairs, turns: Joints) -> Float[Array, "R"]:
    """Return bounds on what a turn adds to the displacement of points of the rows' pieces [m].

    A capsule is symmetric about its axis, so that the ends of its axis bound its motion. A piece is not: its points are
    up to the capsule's radius r away from the axis, and move about it by |(R - 1) v| <= r min(angle, 2).

    Args:
        robot: The robot, with pieces.
        rows: The pairs; a body is seen from the link of the row's other.
        turns: Largest distance of every joint from the middle [rad or m].
    """
    hinge, body = ~np.array(robot.slides), np.array(rows.body)
    links, others = np.array(robot.capsule_link)[body], np.array(rows.other)
    joints = np.arange(len(hinge))[None]
    between = hinge[None] & (joints <= links[:, None]) & (joints > others[:, None])
    angle = jnp.sum(jnp.where(between, turns[None], 0.0), axis=1)
    reach = jnp.where(robot.pieces.excess_m > 0, robot.capsule_radius + OUTSIDE_M, 0.0)[body]
    return reach * jnp.minimum(angle, 2.0)


def row_travel_bound(robot: Robot, rows: RowPairs, x: Joints, rates: Joints, half: Scalar) -> Float[Array, "R"]:
    """Return `travel_bound` of each row's body, relative to the link of the row's other, before it in the chain [m].

    All joints up to that link are at rest.

    Args:
        robot: The robot.
        rows: The pairs.
        x: The middle [rad or m].
        rates: Its derivative in s [rad or m].
        half: Half of the interval's length.

    Raises:
        ValueError: For a row whose body does not lie beyond the link of its other.
    """
    if any(0 <= other >= robot.capsule_link[body] for body, other in zip(*rows, strict=True)):
        raise ValueError("the body of a row must lie beyond the link of its other")
    seen_from = sorted(set(rows.other))
    moving = np.arange(len(robot.slides))[None, :] > np.array(seen_from)[:, None]
    found = jax.vmap(lambda moving: travel_bound(robot, x, jnp.where(moving, rates, 0.0), half))(moving)
    return found[np.array([seen_from.index(other) for other in rows.other]), np.array(rows.body)]
