"""Exact nearest point of a cloud to a line segment, by branch and bound over a tree of three levels.

The cloud is cut once into balanced leaves of 16 points; 16 neighbouring leaves make a branch, and 16 branches a root.
Each of these clusters is bounded by a flat disc (see `discs`). At every level the search takes the clusters in the
order of their bounds, and descends into each until no bound left is below the smallest distance found: that is the
certificate, and nothing is returned without it.

A CPU searches for one body after the other and takes one cluster at a time: that is the least arithmetic. So does each
program of a GPU's kernel (`cloud_index_gpu`). Where neither is at hand, a turn of a loop costs more than the arithmetic
in it: all bodies are searched for side by side, several clusters at a time.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance import branch_and_bound
from htcp_jax.clearance.bounding_discs import (
    Segments,
    as_segments,
    bounding_discs,
    disc_bounds,
    single,
    spread,
    squared_distance,
)
from htcp_jax.clearance.branch_and_bound import FAN
from htcp_jax.clearance.cloud_index import ONE_BODY, SIDE_BY_SIDE, CloudIndex, levels_of
from htcp_jax.clearance.cloud_tree_gpu import HAS_KERNEL, nearest_leaves
from htcp_jax.numerics import one_by_one
from htcp_jax.types import Array, Float, Int


def build_index(points: Float[np.ndarray, "P 3"]) -> CloudIndex:
    """Index of a cloud of P >= 1 points [m]. Clusters that are short of points repeat one of their own."""
    rows = _tree(points, np.arange(len(points)), -(-len(points) // FAN**3), 3)
    roots = len(rows)
    bounds = [bounding_discs(points[rows.reshape(count, -1)]) for count in (roots, roots * FAN, roots * FAN**2)]
    levels = [
        b.reshape(parents, -1, 8).transpose(0, 2, 1) for b, parents in zip(bounds, (1, roots, roots * FAN), strict=True)
    ]
    leaves = rows.reshape(-1, FAN)
    return CloudIndex(
        *(jnp.asarray(level, jnp.float32) for level in levels),
        points=jnp.asarray(points[leaves].transpose(0, 2, 1)),
        rows=jnp.asarray(leaves, jnp.int32),
    )


def _tree(points, rows, parts: int, levels: int):
    """Rows cut into `parts` clusters, each of these into FAN, and so on: (parts, FAN, ..., FAN)."""
    groups = branch_and_bound.cut(points, rows, parts)
    if levels == 1:
        return np.stack([branch_and_bound.padded(group) for group in groups])
    return np.stack([_tree(points, group, FAN, levels - 1) for group in groups])


class Nearest(NamedTuple):
    """Which point of the cloud is nearest to which of several segments; -1, -1 where none is within the limit."""

    body: Int[Array, ""]
    row: Int[Array, ""]


def nearest_rows(
    index: CloudIndex,
    p: Float[Array, "K 3"],
    q: Float[Array, "K 3"],
    within: Float[Array, "K"] | None = None,
) -> Int[Array, "K"]:
    """Row of the cloud nearest to each of K segments p q [m], exact (ties: one of the nearest).

    within: -1 where no point is nearer than this [m]. An integer carries no gradient: differentiate the distance to the
    point it names.
    """
    limit = jnp.full(p.shape[0], 1e150, float) if within is None else within
    return _nearest_rows(index, *jax.lax.stop_gradient((p, q, limit)))


def nearest_body(
    index: CloudIndex,
    p: Float[Array, "K 3"],
    q: Float[Array, "K 3"],
    radius: Float[Array, "K"],
    below: float = 1e150,
) -> Nearest:
    """The pair of body and point with the smallest distance(segment, point) - radius, if that is below `below` [m].

    Cheaper than the nearest point of every body, because what is nearer to one body rules out all others.
    """
    return _nearest_body(index, *jax.lax.stop_gradient((p, q, radius, jnp.asarray(below, float))))


@one_by_one
def _nearest_rows(index: CloudIndex, p, q, limit):
    return _search(index, p, q, jnp.zeros(limit.shape, float), limit, shared=False)


@one_by_one
def _nearest_body(index: CloudIndex, p, q, radius, below):
    rows = _search(index, p, q, radius, jnp.broadcast_to(below, radius.shape), shared=True)
    body = jnp.argmax(rows).astype(jnp.int32)
    return Nearest(jnp.where(rows[body] < 0, -1, body), rows[body])


def _search(index: CloudIndex, p, q, radius, limit, shared: bool):
    """Row of the nearest point of each of K bodies, -1 where none has distance - radius below its limit; with a shared
    limit only the body that is nearest of all gets a row."""
    segments = as_segments(p, q)
    backend = jax.default_backend()
    if backend == "cpu":
        leaf = _in_turn(index, segments, radius, limit, shared)
    elif backend == "gpu" and HAS_KERNEL:
        leaf = nearest_leaves(index, p, q, radius, limit, shared)
    else:
        _, leaf = _descend(levels_of(index, backend), index.points, segments, radius, limit, shared, SIDE_BY_SIDE)
    square = squared_distance(spread(segments, 1), index.points[leaf].transpose(1, 0, 2))
    return jnp.where(leaf < 0, -1, index.rows[leaf, jnp.argmin(square, axis=1)])


def _in_turn(index: CloudIndex, segments: Segments, radius, limit, shared: bool):
    """The leaf of each body's nearest point, -1 for none: one body after the other, the most promising first."""
    levels, bodies = levels_of(index, "cpu"), radius.shape[0]
    _, upper = disc_bounds(single(spread(segments, 1)), index.roots[0, :, None, :])
    promise = jnp.min(upper, axis=1) - radius

    def search_one(state):
        left, limit, leaf = state
        body = jnp.argmin(jnp.where(left, promise, jnp.inf))
        this = jnp.arange(bodies) == body
        one = jax.tree.map(lambda a: jax.lax.dynamic_slice_in_dim(a, body, 1, axis=-1), (segments, radius, limit))
        lowest, found = _descend(levels, index.points, *one, shared, ONE_BODY)
        if shared:  # what is found beats all that was found before
            leaf = jnp.where(found >= 0, jnp.where(this, found, -1), leaf)
            limit = jnp.broadcast_to(lowest, limit.shape)
        else:
            leaf = jnp.where(this, found, leaf)
        return left & ~this, limit, leaf

    start = jnp.full(bodies, True), limit, jnp.full(bodies, -1, jnp.int32)
    return jax.lax.while_loop(lambda state: jnp.any(state[0]), search_one, start)[2]


def _descend(levels, points, segments: Segments, radius, limit, shared: bool, widths):
    """The limits of K bodies, lowered to what they attain, and the leaves where they do, -1 where none does: the bodies
    search side by side, each so many clusters of its own at a time as `widths` says for the level."""
    segments32, bodies = single(segments), radius.shape[0]

    def lowered(limit, distance):
        """The limits, lowered by distances (K, n)."""
        nearest = jnp.min(distance, axis=1) - radius
        return jnp.minimum(limit, jnp.min(nearest) if shared else nearest)

    def search(level, parent, limit, leaf):
        """The clusters inside of each body's parents (K, width), in the order of their bounds."""
        bound = jnp.moveaxis(levels[level][parent], 2, 0)
        fan = bound.shape[-1]
        lower, upper = disc_bounds(spread(segments32, 2), bound)
        limit = lowered(limit, upper.reshape(bodies, -1))
        keys = branch_and_bound.prune(
            branch_and_bound.order_keys(lower.reshape(bodies, -1), widths[level]), limit + radius
        )

        def take(state):
            picked, keys, limit, leaf = state
            local = branch_and_bound.number(picked, parent.shape[1] * fan)
            child = jnp.take_along_axis(parent, local // fan, axis=1) * fan + local % fan
            deeper = measure if level + 1 == len(levels) else partial(search, level + 1)
            limit, leaf = deeper(child, limit, leaf)
            keys = branch_and_bound.prune(branch_and_bound.without(keys, picked), limit + radius)
            return branch_and_bound.best(keys), keys, limit, leaf

        start = branch_and_bound.best(keys), keys, limit, leaf
        return jax.lax.while_loop(lambda state: branch_and_bound.any_left(state[0]), take, start)[2:]

    def measure(child, limit, leaf):
        """The points of leaves (K, width)."""
        square = squared_distance(spread(segments, 2), jnp.moveaxis(points[child], 2, 0))
        distance = jnp.sqrt(jnp.min(square, axis=2))
        new = lowered(limit, distance)
        found = distance - radius[:, None] == new[:, None]
        found = jnp.max(jnp.where(found & (new < limit)[:, None], child, -1), axis=1)
        return new, jnp.where(new < limit, found, leaf)  # with a shared limit, -1 for all but one

    return search(0, jnp.zeros((bodies, 1), jnp.int32), limit, jnp.full(bodies, -1, jnp.int32))
