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

from functools import partial

import jax
import jax.numpy as jnp

from htcp_jax.clearance import branch_and_bound
from htcp_jax.clearance.bounding_discs import Segments, arm, as_segments, disc_bounds, single, spread
from htcp_jax.clearance.cloud_index import ONE_BODY, SIDE_BY_SIDE, CloudIndex, levels_of
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
    beside = jnp.stack([bend, travel, reach])
    start = jnp.broadcast_to(enough, reach.shape)
    backend = jax.default_backend()
    levels, numbers = levels_of(index, backend), jnp.arange(len(reach))
    if backend != "cpu":
        limit = jnp.where(asked, start, -jnp.inf)
        found = _descend(levels, index.points, segments, ends, beside, least, limit, SIDE_BY_SIDE)
        return jnp.where(asked, found, enough)

    def search_one(state):
        left, found = state
        body = jnp.argmax(left)
        one = jax.tree.map(lambda a: jax.lax.dynamic_slice_in_dim(a, body, 1, axis=-1), (segments, ends, beside))
        clear = _descend(levels, index.points, *one, least, jnp.reshape(enough, (1,)), ONE_BODY)
        found = jnp.where(numbers == body, clear, found)
        return left & (numbers != body) & (clear >= least), found

    return jax.lax.while_loop(lambda state: jnp.any(state[0]), search_one, (asked, start))[1]


def _descend(levels, points, segments: Segments, ends, beside, least, clear, widths):
    """What K bodies are clear by at least, lowered from `clear`: the bodies search side by side, each so many clusters
    of its own at a time as `widths` says for the level."""
    segments32, bodies = single(segments), len(clear)
    bend, travel, reach = beside
    ends = jax.tree.map(lambda a: a[:, :, None, None], ends)

    def pruned(keys, clear):
        """Without the clusters that are so far away that they cannot be nearer than what was found."""
        return branch_and_bound.prune(keys, jnp.where(clear < least, -1.0, clear + travel + reach))

    def search(level, parent, clear):
        """The clusters inside of each body's parents (K, width), in the order of their bounds."""
        bound = jnp.moveaxis(levels[level][parent], 2, 0)
        fan = bound.shape[-1]
        lower = disc_bounds(spread(segments32, 2), bound)[0].reshape(bodies, -1)
        keys = pruned(branch_and_bound.order_keys(lower, widths[level]), clear)

        def take(state):
            picked, keys, clear = state
            local = branch_and_bound.number(picked, parent.shape[1] * fan)
            child = jnp.take_along_axis(parent, local // fan, axis=1) * fan + local % fan
            deeper = measure if level + 1 == len(levels) else partial(search, level + 1)
            clear = deeper(child, clear)
            keys = pruned(branch_and_bound.without(keys, picked), clear)
            return branch_and_bound.best(keys), keys, clear

        start = branch_and_bound.best(keys), keys, clear
        return jax.lax.while_loop(lambda state: branch_and_bound.any_left(state[0]), take, start)[2]

    def measure(child, clear):
        """The points of leaves (K, width)."""
        w = jnp.moveaxis(points[child], 2, 0)
        towards = [-a for a in arm(spread(segments, 2), w)]
        distance = jnp.sqrt(sum(a * a for a in towards))
        n = [a / jnp.maximum(distance, 1e-300) for a in towards]
        p, q, p_moves, q_moves = ends
        first, second = (
            sum(n[i] * (end[i] - w[i]) for i in range(3)) - jnp.abs(sum(n[i] * moves[i] for i in range(3)))
            for end, moves in ((p, p_moves), (q, q_moves))
        )
        by_plane = jnp.minimum(first, second) - bend[:, None, None]
        stays = jnp.maximum(by_plane, distance - travel[:, None, None])
        return jnp.minimum(clear, jnp.min(stays, axis=(1, 2)) - reach)

    return search(0, jnp.zeros((bodies, 1), jnp.int32), clear)
