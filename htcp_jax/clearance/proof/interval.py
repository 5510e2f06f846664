"""Lower bound on the clearance on an interval of a joint path, computed at the interval's middle.

The first bound is the distance at the middle minus each body's travel. If this bound is too small, the obstacle's own
bound for moving bodies is used (`Obstacle.clear_along`), if it has one. Adaptive bisection by such bounds is from
Schwarzer, Saha and Latombe (Adaptive Dynamic Collision Checking for Single and Multiple Articulated Robots, T-RO 2005).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax.typing import ArrayLike

from htcp_jax.clearance.distance.sweep import BodySweep, RequiredClearance
from htcp_jax.clearance.obstacles.obstacle import (
    BodyAxes,
    HasWorkpiecePose,
    Obstacle,
    Obstacles,
    RowPairs,
    bodies_at,
)
from htcp_jax.clearance.proof.known_rows import KnownRows, MeasuredRows, free_radii
from htcp_jax.clearance.proof.motion_bound import OUTSIDE_M, JointSweep, body_sweep, pair_travel_bound
from htcp_jax.model import Robot, moved_by
from htcp_jax.types import Array, Bool, Float, Int, Joints, Scalar

MOST_HALVINGS = 3  # with one narrow place at the middle, eight parts need no more checks than repeated halving


class Interval(NamedTuple):
    """Clearance on an interval of a joint path."""

    middle: Scalar  # lower bound on D at the interval's middle [m]
    clear: Scalar  # lower bound on D on the complete interval [m]: the required clearance if no share of D is kept
    proven: Bool[Array, ""]  # True: `clear` is at least the required clearance
    halvings: Int[Array, ""]  # number of halvings that divide an interval that is not proven


def on_interval(
    robot: Robot,
    obstacles: Obstacles,
    where: HasWorkpiecePose,
    x: Joints,
    sweep: JointSweep,
    least: Float[ArrayLike, ""],
    kept: Float[ArrayLike, ""],
    keeps: Bool[Array, ""],
    requested: Bool[Array, ""],
    known: KnownRows | None = None,
) -> tuple[Interval, KnownRows | None]:
    """Return bounds on D on an interval of a joint path, and what is known then.

    Args:
        robot: The robot.
        obstacles: The obstacles.
        where: A scenario, or another `HasWorkpiecePose`.
        x: The configuration at the interval's middle [rad or m].
        sweep: The joints' motion about it.
        least: Required clearance [m].
        kept: Share of D at the middle that is also required if `keeps` is True.
        keeps: True to require the share `kept`.
        requested: True to use the obstacles' own bounds, too; False to use only the bodies' travel.
        known: Rows measured before, see `known_rows`; rows that cannot change the result are then not measured. None:
            all rows are measured.
    """
    if not obstacles:
        return Interval(jnp.full((), jnp.inf), jnp.full((), jnp.inf), jnp.full((), True), jnp.ones((), int)), known
    bodies, moves = bodies_at(robot, where, x), body_sweep(robot, x, sweep)
    rows = [each.rows(robot) for each in obstacles]
    travels = [moves.travel if own.other is None else pair_travel_bound(robot, own, x, sweep) for own in rows]
    turns = [piece_turn_bound(robot, own, sweep) for own in rows]
    free_radius, known = free_radii(robot, obstacles, where, x, bodies, travels, turns, least, kept > 0, known)
    middle = jnp.min(jnp.concatenate([own.distance for own in free_radius]))
    good = jnp.maximum(kept * middle, least)
    # The computed bound may exceed the required one, as it is recorded as the proven clearance.
    required = jnp.where(keeps, good, least)
    wanted = RequiredClearance(requested, required, jnp.maximum(jnp.sqrt(kept) * middle, least))
    clear, halvings = [], jnp.ones((), int)
    for each, own, travel, turn in zip(obstacles, free_radius, travels, turns, strict=True):
        by_travel = _left(own, travel, turn)
        if each.sweeps:
            clear.append(_closer(each, robot, where, bodies, moves, own.distance, by_travel, good, wanted))
        else:
            too_far = [jnp.any(_left(own, 0.5**k * travel, 0.5**k * turn) < required) for k in range(1, MOST_HALVINGS)]
            halvings = jnp.maximum(halvings, 1 + sum(each.astype(int) for each in too_far))
            clear.append(jnp.minimum(by_travel, own.distance))
    clear = jnp.min(jnp.concatenate(clear))
    recorded = jnp.where(kept > 0, clear, least)
    return Interval(middle, recorded, clear >= wanted.least, jnp.where(kept > 0, 1, halvings)), known


def _left(own: MeasuredRows, travel: Float[Array, "R"], turn: Float[Array, "R"]) -> Float[Array, "R"]:
    """Return what travel leaves of each row's free radius [m]; a piece also turns about the axis of its capsule."""
    return jnp.maximum(own.of_capsules, own.free_radius - turn) - travel


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
) -> Float[Array, "K"]:
    """Return lower bounds on the bodies' clearance [m], by the obstacle's own bound for bodies that travel too far.

    The obstacle's bound is not computed if it would probably fail for one of these bodies, because the body would come
    too near even to a flat wall.
    """
    open_, nearer = by_travel < good, moves.travel**2 / (2 * robot.capsule_radius)  # `nearer`: estimate, for a point
    hopeful = jnp.all(~open_ | (free_radius - moves.bend >= wanted.least) & (nearer <= 4 * free_radius))
    needed = open_ & wanted.requested & hopeful
    by_sweep = kind.clear_along(robot, where, bodies, moves, wanted._replace(requested=needed))
    if robot.pieces is not None:  # a piece's free radius may prove more than the sweep of its capsule
        failed = jnp.any(needed & (by_sweep < wanted.least))  # True: the other values are arbitrary
        by_sweep = jnp.where(failed, by_travel, jnp.maximum(by_sweep, by_travel))
    return jnp.where(needed, by_sweep, by_travel)


def piece_turn_bound(robot: Robot, rows: RowPairs, sweep: JointSweep) -> Float[Array, "R"]:
    """Return bounds on the displacement that rotation adds to points of the rows' pieces [m].

    A capsule is symmetric about its axis, so that the ends of its axis bound its motion. A piece is not symmetric: its
    points are up to the capsule's radius r away from the axis, and move about it by |(R - 1) v| <= r min(angle, 2). For
    an arm without pieces the bounds are 0.

    Args:
        robot: The robot.
        rows: Both sides of each row; displacements are relative to the other side's link.
        sweep: The joints' motion about the interval's middle.
    """
    if robot.pieces is None:
        return jnp.zeros(len(rows.body))
    hinge, body = ~jnp.asarray(robot.slides), rows.body
    moves = jnp.asarray(moved_by(robot.parents))
    between = hinge[None] & (moves[rows.links(robot)] ^ moves[jnp.asarray(rows.others)])
    angle = jnp.sum(jnp.where(between, sweep.of_joints(robot).turns[None], 0.0), axis=1)
    reach = jnp.where(robot.pieces.excess_m > 0, robot.capsule_radius + OUTSIDE_M, 0.0)[body]
    return reach * jnp.minimum(angle, 2.0)
