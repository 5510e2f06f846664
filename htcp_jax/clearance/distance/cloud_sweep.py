"""Lower bound on a moving capsule's clearance to a cloud, to second order.

Let the ends p, q of the capsule's axis move by p(s) = p + s p' and q(s) = q + s q' with an error below b, for |s| <= h.
Let n be the unit vector from a point w of the cloud to the nearest point of the axis at s = 0 (Ericson, Real-Time
Collision Detection, section 5.1.2). The axis is at least as far from w as its lower end is above the plane through w
normal to n. On the complete motion therefore

    distance >= min(n.(p - w) - h |n.p'|, n.(q - w) - h |n.q'|) - b.

Only motion towards the point reduces the bound, as in the directed bounds of conservative advancement (Tang, Kim and
Manocha, C2A, ICRA 2009). Motion along a wall does not, whereas a bound by travel subtracts all of the travel. Points
farther away than the body's travel are skipped by the bounds of their clusters.
"""

import jax
import jax.numpy as jnp

from htcp_jax.backend import backend
from htcp_jax.clearance.distance.cloud_tree import empty_lists, for_each_leaf, in_reach
from htcp_jax.clearance.distance.cloud_tree_gpu import least_in_reach
from htcp_jax.clearance.distance.clusters import (
    CloudIndex,
    LineSegments,
    as_segments,
    lever_arm,
    single,
    with_axes,
)
from htcp_jax.clearance.distance.sweep import BodySweep, RequiredClearance
from htcp_jax.numerics import one_by_one
from htcp_jax.types import Array, Float


def clear_along(
    index: CloudIndex,
    p: Float[Array, "K 3"],
    q: Float[Array, "K 3"],
    sweep: BodySweep,
    reach: Float[Array, "K"],
    wanted: RequiredClearance,
) -> Float[Array, "K"]:
    """Return lower bounds on the clearance of bodies along a sweep [m].

    Once a body has less than `wanted.least`, the search ends for all bodies.

    Args:
        index: The cloud's tree.
        p: First ends of the bodies' axes, in the cloud's frame [m].
        q: Second ends, in the cloud's frame [m].
        sweep: The bodies' motion.
        reach: Radii of the bodies [m].
        wanted: The bodies that a bound is computed for, the required clearance, and the clearance above which the bound
            need not be exact [m].

    Returns:
        The bounds; at most `wanted.enough`, which is also the value of bodies that are not requested.
    """
    return _clear_along(index, p, q, *sweep, reach, *wanted)


@one_by_one
def _clear_along(index: CloudIndex, p, q, p_moves, q_moves, bend, travel, reach, requested, least, enough):
    seen, moving = jnp.where(requested, enough + travel + reach, -1.0), (p, q, p_moves, q_moves, bend, travel, reach)
    if backend().has_kernels:  # where bodies do not wait for each other's results
        return least_in_reach(index, p, q, seen, jnp.broadcast_to(enough, reach.shape), _stays_clear, *moving)
    segments, moving = as_segments(p, q), tuple(a.T for a in moving)
    top = in_reach(with_axes(single(segments), 1), index.levels[0][0][:, None, :], seen[:, None])

    def look(k, state):
        clear, lists = state
        segment, own = jax.tree.map(lambda a: a[..., k], (segments, moving))
        beyond = jnp.all(clear >= least)  # skip the remaining bodies

        def measure(leaf, clear):
            return jnp.minimum(clear, _stays_clear(segment, *own, index.points[leaf]))

        near = jnp.where(beyond, seen[k], -1.0), jnp.where(beyond, top[k], 0)
        found, lists = for_each_leaf(index, segment, *near, measure, enough, lists)
        return clear.at[k].set(found), lists

    start = jnp.broadcast_to(enough, reach.shape)
    search = lambda: jax.lax.fori_loop(0, len(reach), look, (start, empty_lists(index)))[0]  # noqa: E731
    return jax.lax.cond(jnp.any(requested), search, lambda: start)


def _stays_clear(segment: LineSegments, p, q, p_moves, q_moves, bend, travel, reach, points):
    """Return a lower bound on the clearance between a body of radius `reach` and points (3, n) along the sweep [m].

    It is the larger of two bounds: by the plane between the body and each point, and by the body's travel.
    """
    towards = [-a for a in lever_arm(segment, points)]
    distance = jnp.sqrt(sum(a * a for a in towards))
    first, second = (
        sum(towards[i] * (end[i] - points[i]) for i in range(3)) - jnp.abs(sum(towards[i] * moves[i] for i in range(3)))
        for end, moves in ((p, p_moves), (q, q_moves))
    )
    by_plane = jnp.minimum(first, second) / jnp.maximum(distance, 1e-300) - bend
    return jnp.min(jnp.maximum(by_plane, distance - travel)) - reach
