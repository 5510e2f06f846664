"""Free radii that a proof has measured, and what they imply at other configurations.

Let a row's free radius be f at one configuration, and let the ends of its body's axis be at most m away at another one,
both seen from the row's other side. The free radius there is at least f - m and, if f is an exact distance, at most
f + m. At the middle of an interval the smallest of these upper bounds is an upper bound on D. A row that stays farther
than that on all of the interval changes neither D nor the interval's bound, so it is not measured. What is known
therefore saves time, and changes no result. If only the required clearance is recorded, a row is not measured if it has
that.
"""

from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from htcp_jax.clearance.obstacles import narrow_phase
from htcp_jax.clearance.obstacles.obstacle import BodyAxes, HasWorkpiecePose, Obstacles, RowPairs
from htcp_jax.clearance.proof.motion_bound import ROUNDING_M
from htcp_jax.model import Robot, kinematics
from htcp_jax.numerics import product
from htcp_jax.types import Bool, Float, Joints, Scalar

Rows = list[Float[jax.Array, "_"]]  # one array per obstacle, with one value per row


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
    travel: Rows,
    least: Float[ArrayLike, ""],
    is_recorded: Bool[ArrayLike, ""],
    known: KnownRows,
) -> tuple[Rows, KnownRows]:
    """Return the free radii at x of the rows that may decide an interval, and what is known then.

    Other rows get lower bounds, which have the required clearance on all of the interval. If the clearance is recorded,
    they are also larger than the smallest free radius at x on all of it.

    Args:
        robot: The robot.
        obstacles: The obstacles.
        where: A scenario, or another `HasWorkpiecePose`.
        x: The interval's middle [rad or m].
        bodies: The bodies at x.
        travel: The rows' largest displacements on the interval [m].
        least: Required clearance [m].
        is_recorded: True if the proven clearance is recorded; False if only the required one is.
        known: What is known of the same scenario.
    """
    ends, starts = _relative_ends(robot, _rows(robot, obstacles), x, bodies), np.cumsum([0, *map(len, travel)])
    bounds = _bounds(robot, where, known, ends)
    lower, upper = ([own[start:end] for start, end in pairwise(starts)] for own in bounds)
    exact, others = ([k for k, each in enumerate(obstacles) if each.is_exact is kind] for kind in (True, False))
    smallest, seen = _smallest([upper[k] for k in exact]), {}
    for numbers in (exact, others):
        needed = jnp.maximum(jnp.where(is_recorded, smallest, ROUNDING_M), jnp.maximum(least, ROUNDING_M))
        enough = {k: _enough(robot, where, lower[k], travel[k], needed) for k in numbers}
        seen |= _measured(robot, obstacles, where, bodies, enough)
        smallest = _smallest([jnp.maximum(seen[k], lower[k]) for k in exact])
    measured = jnp.concatenate([seen[k] for k in range(len(obstacles))])
    is_new = (measured > -jnp.inf) & (measured >= bounds[0])
    radius, ends = jnp.where(is_new, measured, known.free_radius), jnp.where(is_new[:, None, None], ends, known.ends)
    return [jnp.maximum(seen[k], lower[k]) for k in range(len(obstacles))], KnownRows(radius, ends)


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


def _measured(
    robot: Robot, obstacles: Obstacles, where: HasWorkpiecePose, bodies: BodyAxes, enough: dict[int, jax.Array]
) -> dict[int, jax.Array]:
    """Return free radii of some obstacles up to `enough`, by the obstacle's number; -inf for obstacles not needed."""
    needed = [jnp.any(own > -jnp.inf) for own in enough.values()]
    own = narrow_phase.decide_together(robot, tuple(obstacles[k] for k in enough), where, bodies, needed)
    return {
        k: jax.lax.cond(
            is_needed,
            lambda each=each, k=k: each.free_radius_up_to(robot, where, bodies, enough[k]),
            lambda k=k: jnp.full(enough[k].shape, -jnp.inf),
        )
        for k, each, is_needed in zip(enough, own, needed, strict=True)
    }


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
