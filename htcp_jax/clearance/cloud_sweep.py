"""How clear a capsule stays of a cloud while it moves, to second order.

Let the ends of its axis move by p(s) = p + s p' and less than b beside that, for |s| <= h, and let n be the unit vector
from a point w of the cloud to the nearest point of the axis at the middle (Ericson, Real-Time Collision Detection,
section 5.1.2). The plane through w normal to n keeps the axis from w by at least as much as the lower of its two ends,
so that on all of the way

    distance >= min(n.(p - w) - h |n.p'|, n.(q - w) - h |n.q'|) - b.

Only motion towards the point counts, as in the directed bounds of conservative advancement (Tang, Kim and Manocha, C2A,
ICRA 2009): motion along a wall costs nothing, where a bound on how far a body moves has to have that much room. Points
that are further away than the body moves are passed over, and found to be so by the bounds of their clusters.
"""

import jax
import jax.numpy as jnp

from htcp_jax.clearance.bounding_discs import Segments, arm, as_segments, single, spread
from htcp_jax.clearance.cloud_index import CloudIndex
from htcp_jax.clearance.cloud_tree_walk import Lists, empty_lists, for_each_leaf, in_reach
from htcp_jax.clearance.sweep import Sweep, Wanted
from htcp_jax.numerics import one_by_one
from htcp_jax.types import Array, Bool, Float


def clear_along(
    index: CloudIndex,
    p: Float[Array, "K 3"],
    q: Float[Array, "K 3"],
    sweep: Sweep,
    reach: Float[Array, "K"],
    asked: Bool[Array, "K"],
    wanted: Wanted,
) -> Float[Array, "K"]:
    """How clear bodies of radius `reach` about the segments p q stay while they sweep, all in the cloud's frame, at
    least [m]; at most as much as is enough, which is also what one counts as that was not asked about. Once one does
    not stay clear by the least that will do, the search ends, for the other bodies as well."""
    return _clear_along(index, p, q, *sweep, reach, asked, *wanted)


@one_by_one
def _clear_along(index: CloudIndex, p, q, p_moves, q_moves, bend, travel, reach, asked, least, enough):
    segments, ends = as_segments(p, q), tuple(a.T for a in (p, q, p_moves, q_moves))
    seen = jnp.where(asked, enough + travel + reach, -1.0)
    top = in_reach(spread(single(segments), 1), index.levels[0][0][:, None, :], seen[:, None])

    def look(k, state):
        clear, lists = state
        one = jax.tree.map(lambda a: a[..., k], (segments, ends, bend, travel, reach))
        beyond = jnp.all(clear >= least)  # nothing is in reach of a body that need not be looked at
        found, lists = _clear_of(
            index, *one, jnp.where(beyond, seen[k], -1.0), jnp.where(beyond, top[k], 0), enough, lists
        )
        return clear.at[k].set(found), lists

    start = jnp.broadcast_to(enough, reach.shape), empty_lists(index)
    return jax.lax.fori_loop(0, len(reach), look, start)[0]


def _clear_of(index: CloudIndex, segment: Segments, ends, bend, travel, reach, seen, top, enough, lists: Lists):
    """How clear one body stays, by all points that it may see, and the lists."""
    p, q, p_moves, q_moves = (end[:, None] for end in ends)

    def measure(leaf, clear):
        w = index.points[leaf]
        towards = [-a for a in arm(spread(segment, 1), w)]
        distance = jnp.sqrt(sum(a * a for a in towards))
        first, second = (
            sum(towards[i] * (end[i] - w[i]) for i in range(3)) - jnp.abs(sum(towards[i] * moves[i] for i in range(3)))
            for end, moves in ((p, p_moves), (q, q_moves))
        )
        stays = jnp.maximum(jnp.minimum(first, second) / jnp.maximum(distance, 1e-300) - bend, distance - travel)
        return jnp.minimum(clear, jnp.min(stays) - reach)

    return for_each_leaf(index, segment, seen, top, measure, enough, lists)
