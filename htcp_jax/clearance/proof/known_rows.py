"""Free radii that decide an interval of a proof: those that it measures, and those known from other configurations.

Let a row's free radius be f at one configuration, and let the ends of its body's axis be at most m away at another one,
both seen from the row's other side. The free radius there is at least f - m and, if f is an exact distance, at most
f + m. At the middle of an interval the smallest of these upper bounds is an upper bound on D. A row that stays farther
than that on all of the interval changes neither D nor the interval's bound, so it is not measured. What is known
therefore saves time, and changes no result. If only the required clearance is recorded, a row is not measured if it has
that.

For an arm with pieces, D of a row in doubt is at most `narrow_phase.limit_m`. Its free radius is that with a larger
limit: with the distance that decides the interval.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from htcp_jax.clearance.obstacles import narrow_phase
from htcp_jax.clearance.obstacles.obstacle import BodyAxes, HasWorkpiecePose, Obstacle, Obstacles, RowPairs
from htcp_jax.clearance.proof.motion_bound import ROUNDING_M
from htcp_jax.model import Robot, kinematics
from htcp_jax.numerics import product
from htcp_jax.types import Bool, Float, Joints, Scalar

Rows = list[Float[jax.Array, "_"]]  # one array per obstacle, with one value per row


class MeasuredRows(NamedTuple):
    """An obstacle's rows at the middle of an interval; rows that do not decide the interval have lower bounds."""

    free_radius: Float[jax.Array, "R"]  # [m]
    of_capsules: Float[jax.Array, "R"]  # free radius of the capsules alone [m]; without pieces the same
    distance: Float[jax.Array, "R"]  # D [m]

    def at_least(self, lower: Float[jax.Array, "R"]) -> "MeasuredRows":
        """Return the rows, with lower bounds that are known [m] in place of smaller values; they are of capsules."""
        return MeasuredRows(*(jnp.maximum(own, lower) for own in self))


class KnownRows(NamedTuple):
    """Rows of all obstacles as they were last measured, in one scenario."""

    free_radius: Float[jax.Array, "R"]  # [m]; -inf: not measured
    ends: Float[jax.Array, "R 2 3"]  # ends of the body's axis, in the frame of the link on the row's other side [m]


def nothing_known(robot: Robot, obstacles: Obstacles) -> KnownRows:
    """Return the knowledge before the first measurement."""
    count = len(_rows(robot, obstacles).body)
    return KnownRows(jnp.full(count, -jnp.inf), jnp.zeros((count, 2, 3)))


def exact_alone(robot: Robot, obstacles: Obstacles, known: KnownRows) -> KnownRows:
    """Return what is known of the exact kinds of obstacles.

    The free radius of another kind may be less than the distance. If one configuration's is used at another one, the
    proven clearance may be larger than without. A proof therefore uses only those that it measured itself, so that its
    result does not depend on earlier proofs.
    """
    is_exact = np.repeat([each.is_exact for each in obstacles], [len(each.rows(robot).body) for each in obstacles])
    return known._replace(free_radius=jnp.where(is_exact, known.free_radius, -jnp.inf))


def free_radii(
    robot: Robot,
    obstacles: Obstacles,
    where: HasWorkpiecePose,
    x: Joints,
    bodies: BodyAxes,
    travels: Rows,
    turns: Rows,
    least: Float[ArrayLike, ""],
    is_recorded: Bool[ArrayLike, ""],
    known: KnownRows | None,
) -> tuple[list[MeasuredRows], KnownRows | None]:
    """Return the rows of each obstacle at x, as far as they may decide an interval, and what is known then.

    Other rows have the required clearance on all of the interval. If the clearance is recorded, they are also larger
    than the smallest distance at x on all of it.

    Args:
        robot: The robot.
        obstacles: The obstacles.
        where: A scenario, or another `HasWorkpiecePose`.
        x: The interval's middle [rad or m].
        bodies: The bodies at x.
        travels: The rows' largest displacements on the interval [m].
        turns: What the rotation of pieces adds to them [m].
        least: Required clearance [m].
        is_recorded: True if the proven clearance is recorded; False if only the required one is.
        known: What is known of the same scenario; None: all rows are measured.
    """
    if known is None:
        limits = _limits(where, travels, turns, jnp.where(is_recorded, jnp.inf, least))
        own = narrow_phase.decide_together(robot, obstacles, where, bodies, limits=limits)
        return [_rows_of(robot, where, each, each.free_radius(robot, where, bodies)) for each in own], None
    ends, starts = _relative_ends(robot, _rows(robot, obstacles), x, bodies), np.cumsum([0, *map(len, travels)])
    bounds = _bounds(robot, where, known, ends)
    lower, upper = ([own[start:end] for start, end in pairwise(starts)] for own in bounds)
    exact, others = ([k for k, each in enumerate(obstacles) if each.is_exact is kind] for kind in (True, False))
    smallest, seen = _smallest([upper[k] for k in exact]), {}
    for numbers in (exact, others):
        needed = jnp.maximum(jnp.where(is_recorded, smallest, ROUNDING_M), jnp.maximum(least, ROUNDING_M))
        enough = [_enough(robot, where, lower[k], travels[k], needed) for k in numbers]
        limits = _limits(where, travels, turns, needed)
        measured = _measured(
            robot, [obstacles[k] for k in numbers], where, bodies, enough, [limits[k] for k in numbers]
        )
        seen |= dict(zip(numbers, measured, strict=True))
        smallest = _smallest([jnp.maximum(seen[k].distance, lower[k]) for k in exact])
    measured = jnp.concatenate([seen[k].distance for k in range(len(obstacles))])
    is_new = (measured > -jnp.inf) & (measured >= bounds[0])
    radius, ends = jnp.where(is_new, measured, known.free_radius), jnp.where(is_new[:, None, None], ends, known.ends)
    rows = [seen[k].at_least(lower[k]) for k in range(len(obstacles))]
    return rows, KnownRows(radius, ends)


def _smallest(rows: Rows) -> Scalar:
    return jnp.min(jnp.concatenate([*rows, jnp.full(1, jnp.inf)]))


def _enough(
    robot: Robot, where: HasWorkpiecePose, lower: Float[jax.Array, "R"], travel: Float[jax.Array, "R"], least: Scalar
) -> Float[jax.Array, "R"]:
    """Return the free radius above which a row does not decide the interval [m]; -inf if it is known to be above."""
    enough = least + travel
    if robot.pieces is not None:  # larger free radii are those of capsules, which need no bound on turns
        enough = jnp.maximum(enough, narrow_phase.limit_m(where) + ROUNDING_M)
    return jnp.where(lower - travel < least, enough, -jnp.inf)


def _limits(where: HasWorkpiecePose, travels: Rows, turns: Rows, least: Scalar) -> Rows:
    """Return the distances up to which pieces may decide the interval [m]."""
    limit = narrow_phase.limit_m(where)
    least = jnp.minimum(least, limit)
    return [jnp.maximum(limit, least + travel + turn) for travel, turn in zip(travels, turns, strict=True)]


def _measured(
    robot: Robot,
    obstacles: Sequence[Obstacle],
    where: HasWorkpiecePose,
    bodies: BodyAxes,
    enough: Rows,
    limits: Rows,
) -> list[MeasuredRows]:
    """Return the rows of some obstacles, with free radii up to `enough` and -inf for obstacles that are not needed."""
    needed = [jnp.any(own > -jnp.inf) for own in enough]
    queries = narrow_phase.decide_together(robot, tuple(obstacles), where, bodies, needed, limits)
    return [
        jax.lax.cond(
            is_needed,
            lambda each=each, own=own: _rows_of(robot, where, each, each.free_radius_up_to(robot, where, bodies, own)),
            lambda each=each, own=own: _rows_of(robot, where, each, jnp.full(own.shape, -jnp.inf)),
        )
        for each, own, is_needed in zip(queries, enough, needed, strict=True)
    ]


def _rows_of(robot: Robot, where: HasWorkpiecePose, each: Obstacle, free_radius: Float[jax.Array, "R"]) -> MeasuredRows:
    """Return an obstacle's rows with these free radii, for an obstacle of `decide_together`."""
    if robot.pieces is None:
        return MeasuredRows(free_radius, free_radius, free_radius)
    of_capsules = narrow_phase.of_capsules(where, each, free_radius)
    distance = jnp.maximum(jnp.minimum(free_radius, narrow_phase.limit_m(where)), of_capsules)
    return MeasuredRows(free_radius, of_capsules, distance)


def _bounds(
    robot: Robot, where: HasWorkpiecePose, known: KnownRows, ends: Float[jax.Array, "R 2 3"]
) -> tuple[Float[jax.Array, "R"], Float[jax.Array, "R"]]:
    """Return lower bounds on the rows' free radii with the ends of the bodies' axes at `ends`, and upper bounds [m].

    The upper bounds are for exact kinds. For an arm with pieces, a free radius up to `narrow_phase.limit_m` may be that
    of a piece, which is at most the limit.
    """
    apart = ends - known.ends
    moved = jnp.max(jnp.sqrt(jnp.sum(apart * apart, axis=2)), axis=1) + 2 * ROUNDING_M
    lower = known.free_radius - moved
    upper = jnp.where(known.free_radius > -jnp.inf, known.free_radius + moved, jnp.inf)
    if robot.pieces is None:
        return lower, upper
    limit = narrow_phase.limit_m(where)
    return jnp.where(lower > limit, lower, -jnp.inf), jnp.maximum(upper, limit + moved)


def _rows(robot: Robot, obstacles: Obstacles) -> RowPairs:
    """Return both sides of each obstacle's rows, one obstacle after the other."""
    return RowPairs.concatenate([each.rows(robot) for each in obstacles])


def _relative_ends(robot: Robot, rows: RowPairs, x: Joints, bodies: BodyAxes) -> Float[jax.Array, "R 2 3"]:
    """Return both ends of each row's body's axis in the frame of the link on the row's other side [m]."""
    body, other = jnp.asarray(rows.body), rows.other
    ends = jnp.stack([bodies.p[body], bodies.q[body]], axis=1)
    if other is None:
        return ends
    other = jnp.asarray(other)
    T = kinematics.link_poses(robot, x)[jnp.maximum(other, 0)]
    own = product(ends - T[:, None, :3, 3], T[:, :3, :3])
    return jnp.where((other >= 0)[:, None, None], own, ends)
