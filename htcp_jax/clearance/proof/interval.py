"""Lower bound on the clearance on an interval of a joint path, computed at the interval's middle.

The first bound is the distance at the middle minus each body's travel. If this bound is too small, the obstacle's own
bound for moving bodies is used (`Obstacle.clear_along`), if it has one. Adaptive bisection by such bounds is from
Schwarzer, Saha and Latombe (Adaptive Dynamic Collision Checking for Single and Multiple Articulated Robots, T-RO 2005).
"""

from typing import NamedTuple

import jax.numpy as jnp
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
from htcp_jax.clearance.proof.known_rows import KnownRows, free_radii
from htcp_jax.clearance.proof.motion_bound import OUTSIDE_M, JointSweep, body_sweep, pair_travel_bound
from htcp_jax.model import Robot, moved_by
from htcp_jax.types import Array, Bool, Float, Joints, Scalar


class Interval(NamedTuple):
    """Clearance on an interval of a joint path."""

    middle: Scalar  # lower bound on D at the interval's middle [m]
    clear: Scalar  # lower bound on D on the complete interval [m]: the required clearance if no share of D is kept
    proven: Bool[Array, ""]  # True: `clear` is at least the required clearance


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
        return Interval(jnp.full((), jnp.inf), jnp.full((), jnp.inf), jnp.full((), True)), known
    bodies, moves = bodies_at(robot, where, x), body_sweep(robot, x, sweep)
    rows = [each.rows(robot) for each in obstacles]
    travels = [moves.travel if own.other is None else pair_travel_bound(robot, own, x, sweep) for own in rows]
    if known is None:
        measured = narrow_phase.decide_together(robot, obstacles, where, bodies)
        free_radius = [each.free_radius(robot, where, bodies) for each in measured]
    else:
        free_radius, known = free_radii(robot, obstacles, where, x, bodies, travels, least, kept > 0, known)
    middle = jnp.min(jnp.concatenate(free_radius))
    good = jnp.maximum(kept * middle, least)
    # The computed bound may exceed the required one, as it is recorded as the proven clearance.
    required = jnp.where(keeps, good, least)
    wanted = RequiredClearance(requested, required, jnp.maximum(jnp.sqrt(kept) * middle, least))
    clear = []
    for each, own, own_rows, travel in zip(obstacles, free_radius, rows, travels, strict=True):
        if robot.pieces is not None:  # a distance up to the limit may be that of a piece
            own_turn = piece_turn_bound(robot, own_rows, sweep.of_joints(robot).turns)
            travel = travel + jnp.where(own <= narrow_phase.limit_m(where), own_turn, 0.0)
        by_travel = own - travel
        clear.append(
            _closer(each, robot, where, bodies, moves, own, by_travel, good, wanted) if each.sweeps else by_travel
        )
    clear = jnp.min(jnp.concatenate(clear))
    return Interval(middle, jnp.where(kept > 0, clear, least), clear >= wanted.least), known


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


def piece_turn_bound(robot: Robot, rows: RowPairs, turns: Float[Array, "J"]) -> Float[Array, "R"]:
    """Return bounds on the displacement that rotation adds to points of the rows' pieces [m].

    A capsule is symmetric about its axis, so that the ends of its axis bound its motion. A piece is not symmetric: its
    points are up to the capsule's radius r away from the axis, and move about it by |(R - 1) v| <= r min(angle, 2).

    Args:
        robot: The robot, with pieces.
        rows: Both sides of each row; displacements are relative to the other side's link.
        turns: Largest distance of every joint q from the middle [rad or m].
    """
    hinge, body = ~jnp.asarray(robot.slides), rows.body
    moves = jnp.asarray(moved_by(robot.parents))
    between = hinge[None] & (moves[rows.links(robot)] ^ moves[jnp.asarray(rows.others)])
    angle = jnp.sum(jnp.where(between, turns[None], 0.0), axis=1)
    reach = jnp.where(robot.pieces.excess_m > 0, robot.capsule_radius + OUTSIDE_M, 0.0)[body]
    return reach * jnp.minimum(angle, 2.0)
