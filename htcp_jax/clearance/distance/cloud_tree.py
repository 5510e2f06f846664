"""Exact nearest point of a cloud to a line segment, by branch and bound over a tree of clusters.

The cloud is cut once into balanced leaves of 16 points; 16 neighbouring leaves make a cluster, 16 of these the next
larger one, and so on up to a small top level. Each cluster is bounded by a flat disc (see `clusters`). A search
opens every cluster whose bound is not above the smallest distance found, so the result is certified to be the nearest
point.

`nearest_leaves` is the search in plain JAX, for CPUs; `cloud_tree_gpu` has the one for GPUs. It opens every cluster
within a search radius, level by level. The search radius comes from two quick descents, for all bodies in parallel:
from each of the two nearest clusters at the top to the child with the nearest middle, down to a leaf, which is
measured. The smaller distance is usually within millimetres of the minimum, so the search needs no priority order. Its
iterations are independent, so a CPU overlaps them. A best-first search waits for every square root and takes two and a
half times as long.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.backend import backend
from htcp_jax.caching import cached_by_values
from htcp_jax.clearance.distance import cloud_tree_gpu
from htcp_jax.clearance.distance.clusters import (
    FAN,
    CloudIndex,
    LineSegments,
    as_segments,
    bounding_discs,
    cut_rows,
    least_number,
    lower_bounds,
    padded_cluster,
    single,
    squared_distance,
    with_axes,
)
from htcp_jax.numerics import one_by_one
from htcp_jax.types import Array, Bool, Float, Int, Scalar

TOP = 31  # maximum number of clusters at the top: a search stores them as bits of one number
SIZES = 16, TOP  # numbers of clusters at the top of trees on a CPU, so that most clouds share executables
AWAY_M = 1e7  # position of clusters without points, which no search opens


def build_index(points: Float[np.ndarray, "P 3"], least_levels: int = 2) -> CloudIndex:
    """Build the index of a cloud of P >= 1 points [m], with `least_levels` levels or more.

    Clusters with too few points repeat one of them.
    """
    index = _host_index(points, least_levels)
    if backend().is_cpu:
        index = _padded(index, next(size for size in SIZES if size >= index.levels[0].shape[2]))
    return jax.device_put(index)  # in the final types: JAX compiles every conversion


@cached_by_values(2)
def _host_index(points: Float[np.ndarray, "P 3"], depth: int) -> CloudIndex:
    """Return the index as numpy arrays, with `depth` levels or more."""
    while len(points) > TOP * FAN**depth:
        depth += 1
    top = -(-len(points) // FAN**depth)
    rows = _nested_clusters(points, np.arange(len(points)), top, depth)
    counts = [top * FAN**level for level in range(depth)]
    bounds = [bounding_discs(points[rows.reshape(count, -1)]) for count in counts]
    levels = [b.reshape(parents, -1, 8).transpose(0, 2, 1) for b, parents in zip(bounds, [1, *counts], strict=False)]
    leaves = rows.reshape(-1, FAN)
    return CloudIndex(
        levels=tuple(level.astype(np.float32) for level in levels),
        points=points[leaves].transpose(0, 2, 1),
        rows=leaves.astype(np.int32),
    )


def _padded(index: CloudIndex, top: int) -> CloudIndex:
    """Return the index with a number of clusters at the top, of which the new ones are AWAY_M from the origin."""
    first, *others = index.levels

    def longer(table: np.ndarray, axis: int, value: float = 0.0) -> np.ndarray:
        missing = table.shape[axis] * top // first.shape[2] - table.shape[axis]
        return np.pad(table, [(0, missing if k == axis else 0) for k in range(table.ndim)], constant_values=value)

    levels = longer(first, 2), *(longer(level, 0) for level in others)
    levels[0][:, 0, first.shape[2] :] = AWAY_M
    return CloudIndex(levels, longer(index.points, 0, AWAY_M), longer(index.rows, 0))


def _nested_clusters(points, rows, parts: int, levels: int):
    """Return nested clusters of the rows, (parts, FAN, ..., FAN): `parts` clusters, cut into FAN each, and so on."""
    groups = cut_rows(points, rows, parts)
    if levels == 1:
        return np.stack([padded_cluster(group) for group in groups])
    return np.stack([_nested_clusters(points, group, FAN, levels - 1) for group in groups])


class NearestPoint(NamedTuple):
    """Indices of the nearest pair of a body and a point of the cloud; -1, -1 if no pair is within the limit."""

    body: Int[Array, ""]
    row: Int[Array, ""]


def nearest_rows(
    index: CloudIndex, p: Float[Array, "K 3"], q: Float[Array, "K 3"], needed: Bool[Array, "K"] | None = None
) -> Int[Array, "K"]:
    """Return the row of the cloud's point nearest to each of K segments; any of several equally near points.

    The search is exact. A row has no gradient: differentiate the distance to the point in this row.

    Args:
        index: The cloud's tree.
        p: First ends of the segments [m].
        q: Second ends [m].
        needed: True for the segments to search for, others get -1; None: all.
    """
    limit = jnp.full(p.shape[0], 1e150, float) if needed is None else jnp.where(needed, 1e150, -1.0)
    return _nearest_rows(index, *jax.lax.stop_gradient((p, q, limit)))


def nearest_body(
    index: CloudIndex,
    p: Float[Array, "K 3"],
    q: Float[Array, "K 3"],
    radius: Float[Array, "K"],
) -> NearestPoint:
    """Return the pair of body and point with the smallest distance(segment, point) - radius.

    This is cheaper than `nearest_rows`, because a point found for one body limits the search of all other bodies.

    Args:
        index: The cloud's tree.
        p: First ends of the bodies' axes [m].
        q: Second ends [m].
        radius: Radii of the bodies [m].
    """
    return _nearest_body(index, *jax.lax.stop_gradient((p, q, radius, jnp.full(radius.shape, 1e150, float))))


def body_within(
    index: CloudIndex, p: Float[Array, "K 3"], q: Float[Array, "K 3"], reach: Float[Array, "K"]
) -> NearestPoint:
    """Return a pair of body and point with distance(segment, point) < reach; see `NearestPoint` if there is none.

    On a CPU this is the first pair found, so a query that only decides stops there. On a GPU it is the pair with the
    smallest distance - reach, as lanes would wait for each other.

    Args:
        index: The cloud's tree.
        p: First ends of the bodies' axes [m].
        q: Second ends [m].
        reach: Distance from each axis within which a point is sought [m].
    """
    search = _first_body if backend().is_cpu else _nearest_body
    return search(index, *jax.lax.stop_gradient((p, q, reach, jnp.zeros(reach.shape, float))))


@one_by_one
def _nearest_rows(index: CloudIndex, p, q, limit):
    return _search_rows(index, p, q, jnp.zeros(limit.shape, float), limit, shared=False)


@one_by_one
def _nearest_body(index: CloudIndex, p, q, radius, limit):
    rows = _search_rows(index, p, q, radius, limit, shared=True)
    body = jnp.argmax(rows).astype(jnp.int32)
    return NearestPoint(jnp.where(rows[body] < 0, -1, body), rows[body])


@one_by_one
def _first_body(index: CloudIndex, p, q, radius, limit):
    segments, reach = as_segments(p, q), radius + limit
    top = in_reach(with_axes(single(segments), 1), index.levels[0][0][:, None, :], reach[:, None])

    def search(state):
        near, *_ = state
        k = jnp.argmax(near).astype(jnp.int32)
        leaf = _first_leaf(index, *jax.tree.map(lambda a: a[..., k], (segments, reach, top)))
        return near.at[k].set(False), k, leaf

    nobody = top != 0, jnp.int32(-1), jnp.int32(-1)
    _, body, leaf = jax.lax.while_loop(lambda state: jnp.any(state[0]) & (state[2] < 0), search, nobody)
    segment = jax.tree.map(lambda a: a[..., body, None], segments)
    row = _row_of_least(squared_distance(segment, index.points[leaf])[None], index.rows[leaf][None])[0]
    return NearestPoint(*jnp.where(leaf < 0, -1, jnp.stack([body, row])))


def _first_leaf(index: CloudIndex, segment: LineSegments, reach, top):
    """Return the first leaf with a point within `reach` [m] of a segment, depth first; -1 if there is none.

    `top` has the bits of the clusters at the top that are `in_reach`.
    """
    alone, alone32 = with_axes(segment, 1), with_axes(single(segment), 1)

    def among(depth, first, bits):
        """Return the first such leaf in the clusters `bits` of the group that begins with cluster `first`."""

        def look(state):
            bits, _ = state
            cluster = first + _lowest(bits)
            if depth == len(index.levels) - 1:
                leaf = jnp.where(_distance_to_points(alone, index.points[cluster]) < reach, cluster, -1)
            else:
                level = index.levels[depth + 1]
                leaf = among(depth + 1, cluster * level.shape[2], in_reach(alone32, level[cluster], reach))
            return bits & (bits - 1), leaf

        return jax.lax.while_loop(lambda state: (state[0] != 0) & (state[1] < 0), look, (bits, jnp.int32(-1)))[1]

    return among(0, jnp.int32(0), top)


def _lowest(bits):
    """Return the index of the lowest bit that is set."""
    return jax.lax.population_count((bits & -bits) - 1)


def _search_rows(index: CloudIndex, p, q, radius, limit, shared: bool):
    """Return the row of the nearest point of each of K bodies, -1 if none has distance - radius below its limit.

    With a shared limit, only the nearest body gets a row; all other bodies get -1.
    """
    search = cloud_tree_gpu.nearest_leaves if backend().has_kernels else nearest_leaves
    leaf = search(index, p, q, radius, limit, shared)
    square = squared_distance(with_axes(as_segments(p, q), 1), index.points[leaf].transpose(1, 0, 2))
    return jnp.where(leaf < 0, -1, _row_of_least(square, index.rows[leaf]))


def _row_of_least(square: Float[Array, "K FAN"], rows: Int[Array, "K FAN"]) -> Int[Array, "K"]:
    """Return the row with the smallest squared distance, by repeated halving: an argmin takes three times as long."""
    while square.shape[1] > 1:
        (a, b), (row_a, row_b) = jnp.split(square, 2, axis=1), jnp.split(rows, 2, axis=1)
        square, rows = jnp.minimum(a, b), jnp.where(a <= b, row_a, row_b)
    return rows[:, 0]


class _OpenClusters(NamedTuple):
    """List of opened groups of clusters at one level of the tree; the first `count` entries are valid.

    Each entry has the group's number, and a bit mask of the group's clusters within the search radius, which is not 0.
    """

    group: Int[Array, "n"]
    bits: Int[Array, "n"]
    count: Int[Array, ""]


Lists = list[_OpenClusters]  # one per level, from the second level on


def nearest_leaves(index: CloudIndex, p, q, radius, limit, shared: bool) -> Int[Array, "K"]:
    """Return the leaf of each body's nearest point; -1 if no point is below the body's limit.

    With a shared limit, all bodies except the nearest one get -1.
    """
    segments, body = as_segments(p, q), jnp.arange(p.shape[0])
    distance, leaf = _descend(index, segments)
    found = distance - radius
    if shared:
        found = jnp.where(body == jnp.argmin(found), found, jnp.inf)
    leaf = jnp.where(found < limit, leaf, -1)
    limit = jnp.minimum(limit, jnp.min(found) if shared else found)
    top = in_reach(with_axes(single(segments), 1), index.levels[0][0][:, None, :], (limit + radius)[:, None])

    def search(k, state):
        limit, leaf, lists = state
        one = jax.tree.map(lambda a: a[..., k], (segments, radius, limit, top))
        lowest, found, lists = _search_one(index, *one, lists)
        others = jnp.where(found < 0, leaf, -1) if shared else leaf  # a new find is nearer than all earlier ones
        leaf = jnp.where((body == k) & (found >= 0), found, others)
        return jnp.broadcast_to(lowest, limit.shape) if shared else limit, leaf, lists

    return jax.lax.fori_loop(0, len(body), search, (limit, leaf, empty_lists(index)))[1]


def _descend(index: CloudIndex, segments: LineSegments):
    """Descend to two leaves per body; return the distance [m] and the number of the nearer leaf."""
    segments32 = with_axes(single(segments), 1)

    def descent(cluster):
        for level in index.levels[1:]:
            middles = jnp.moveaxis(level[cluster, :3], 1, 0)
            cluster = cluster * level.shape[2] + least_number(squared_distance(segments32, middles))
        return _distance_to_points(with_axes(segments, 1), jnp.moveaxis(index.points[cluster], 1, 0)), cluster

    top = squared_distance(segments32, index.levels[0][0, :3, None, :])
    first = least_number(top)
    second = least_number(jnp.where(jnp.arange(top.shape[1], dtype=first.dtype)[None] == first[:, None], jnp.inf, top))
    distance, leaf = jax.vmap(descent)(jnp.stack([first, second]))
    return jnp.min(distance, axis=0), jnp.where(distance[0] <= distance[1], *leaf)


def _search_one(index: CloudIndex, segment: LineSegments, radius, limit, top, lists: Lists):
    """Search for one body; return the lowered limit [m], the leaf of the point found (-1: none), and the lists."""

    def measure(leaf, state):
        limit, best = state
        here = _distance_to_points(with_axes(segment, 1), index.points[leaf]) - radius
        return jnp.minimum(limit, here), jnp.where(here < limit, leaf, best)

    (limit, best), lists = for_each_leaf(index, segment, limit + radius, top, measure, (limit, jnp.int32(-1)), lists)
    return limit, best, lists


def empty_lists(index: CloudIndex) -> Lists:
    """Return lists of maximum length for all searches to share: making lists per search costs more than a search."""
    return [_OpenClusters(*jnp.zeros((2, len(level)), jnp.int32), jnp.int32(0)) for level in index.levels[1:]]


def for_each_leaf(
    index: CloudIndex,
    segment: LineSegments,
    reach: Scalar,
    top: Int[Array, ""],
    take: Callable,
    state: Any,
    lists: Lists,
    may_matter: Callable | None = None,
) -> tuple[Any, Lists]:
    """Apply state = take(leaf, state) to every leaf that may have a point near a segment; return state and lists.

    Args:
        index: The cloud's tree.
        segment: The segment.
        reach: Search radius: largest distance of the points from the segment [m].
        top: Bit mask of the clusters at the top that are `in_reach`.
        take: Function (leaf, state) that returns the new state.
        state: The initial state.
        lists: From `empty_lists`, or from the previous search.
        may_matter: Function of discs (8, n) that returns a bit mask of those that are searched; None: all are.
    """
    segment32 = single(segment)
    opened, filled = _OpenClusters(jnp.zeros(1, jnp.int32), top[None], (top != 0).astype(jnp.int32)), []
    for above, level, opened_here in zip(index.levels[:-1], index.levels[1:], lists, strict=True):

        def open_group(group, found: _OpenClusters, level=level):
            bits = in_reach(with_axes(segment32, 1), level[group], reach)
            if may_matter is not None:
                bits &= may_matter(level[group])
            return _OpenClusters(
                jax.lax.dynamic_update_index_in_dim(found.group, group, found.count, 0),
                jax.lax.dynamic_update_index_in_dim(found.bits, bits, found.count, 0),
                found.count + (bits != 0).astype(jnp.int32),
            )

        opened = _for_each(opened, above.shape[2], open_group, opened_here._replace(count=jnp.int32(0)))
        filled.append(opened)

    return _for_each(opened, index.levels[-1].shape[2], take, state), filled


def _for_each(opened: _OpenClusters, fan: int, take: Callable, state):
    """Apply state = take(cluster, state) to every opened cluster, in order; return the state."""

    def step(carry):
        entry, bits, state = carry
        state = take(opened.group[entry] * fan + _lowest(bits), state)
        rest = bits & (bits - 1)
        entry = entry + (rest == 0).astype(jnp.int32)
        return entry, jnp.where(rest == 0, opened.bits[entry], rest), state

    start = jnp.int32(0), opened.bits[0], state
    return jax.lax.while_loop(lambda carry: carry[0] < opened.count, step, start)[2]


def in_reach(segment: LineSegments, bound, reach):
    """Return a bit mask of the discs (8, ..., n) that may have a point within `reach` [m] of the segment.

    The mask is 0 if `reach` is negative.
    """
    reach32 = jnp.where(reach < 0, -jnp.inf, jnp.minimum(reach * (1 + 1e-6), 1e30)).astype(jnp.float32)
    return bit_mask(lower_bounds(segment, bound) <= reach32)


def bit_mask(members: Bool[Array, "*m n"]) -> Int[Array, "*m"]:
    """Return a number whose bits are the members along the last axis."""
    bit = jnp.left_shift(jnp.int32(1), jax.lax.broadcasted_iota(jnp.int32, members.shape, members.ndim - 1))
    return jnp.sum(jnp.where(members, bit, 0), axis=-1, dtype=jnp.int32)


def _distance_to_points(segment: LineSegments, points):
    """Return the distance from a segment to the nearest of points (3, ..., n) [m].

    The minimum is taken over the bits of the squared distances as integers: without NaN these have the same order, and
    it takes half the time.
    """
    bits = jax.lax.bitcast_convert_type(squared_distance(segment, points), jnp.int64)
    return jnp.sqrt(jax.lax.bitcast_convert_type(jnp.min(bits, axis=-1), float))
