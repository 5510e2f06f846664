"""The searches of `cloud_tree` and `cloud_sweep` as GPU kernels, with one instance per body or per configuration.

In an XLA loop, every iteration would be a kernel launch that reads and writes the keys of all bodies. A kernel instance
treats a tree of any depth as two levels: branches, which are clusters of 16 leaves, and leaves.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from htcp_jax.backend import instance, kernel
from htcp_jax.clearance.distance.clusters import (
    FAN,
    NONE_LEFT,
    CloudIndex,
    LineSegments,
    least_number,
    lower_bounds,
    number_mask,
    order_keys,
    single,
    squared_distance,
)
from htcp_jax.types import Array, Float, Int


def nearest_leaves(index, p, q, radius, limit, shared: bool) -> Int[Array, "K"]:
    """Return the leaf of each body's nearest point; -1 if no point is below the body's limit.

    With a shared limit, all bodies except the nearest one get -1.
    """
    bodies, count = p.shape[0], _branch_count(index)
    search = partial(_tree_kernel, shared, count, bodies)
    tables = p, q, radius, limit, _branches(index), index.levels[-1], index.points
    out = jax.ShapeDtypeStruct((bodies,), jnp.int32)
    return kernel(search, out, 1 if shared else bodies)(*tables)


def least_in_reach(index: CloudIndex, p, q, reach, start, measure: Callable, *rows) -> Float[Array, "K"]:
    """Return each body's smallest measure(segment, *the body's rows, points) over points (3, n) of the cloud.

    Args:
        index: The cloud's tree.
        p (Array): First ends of the bodies' axes (K, 3) [m].
        q (Array): Second ends (K, 3) [m].
        reach (Array): Distance (K,) from each body within which points are measured [m]; none if negative. Points
            farther away may be measured, too.
        start (Array): Upper limit of each body's result (K,).
        measure: The function to minimise.
        *rows (Array): Tables (K,) or (K, 3), of which `measure` gets the body's rows; a row of 3 is passed as a list.
    """
    least = partial(_least_of_branch, measure, _branch_count(index), len(rows))
    tables = p, q, reach, start, *rows, _branches(index), index.points
    return kernel(least, jax.ShapeDtypeStruct(start.shape, start.dtype), start.shape[0])(*tables)


def _branch_count(index: CloudIndex) -> int:
    return index.levels[-1].shape[0]


def _branches(index: CloudIndex) -> Float[Array, "8 n"]:
    """Return the branches' bounding discs as columns, padded to a number of columns that is a power of two."""
    branches = index.levels[-2].transpose(1, 0, 2).reshape(8, -1)
    missing = (1 << (branches.shape[1] - 1).bit_length()) - branches.shape[1]
    return jnp.pad(branches, ((0, 0), (0, missing)), mode="edge")


def _tree_kernel(shared, branch_count, bodies, p, q, radius, limit, branches, leaves, points, out):
    one = partial(_nearest_leaf, branch_count, p, q, radius, branches, leaves, points)
    if not shared:
        body = instance()
        out[body] = one(body, limit[body])[1]
        return

    def search(k, state):
        body = bodies - 1 - k  # the tool first, as it is usually nearest
        lowest, best, found = state
        lowest, leaf = one(body, lowest)
        return lowest, jnp.where(leaf >= 0, body, best), jnp.where(leaf >= 0, leaf, found)

    _, best, found = jax.lax.fori_loop(0, bodies, search, (limit[0], jnp.int32(-1), jnp.int32(-1)))
    for body in range(bodies):
        out[body] = jnp.where(best == body, found, -1)


def _nearest_leaf(branch_count, p, q, radius, branches, leaves, points, body, limit):
    """Return one body's limit, lowered to the smallest distance found, and the leaf with this distance."""
    segment, r = _segment(p, q, body), radius[body]

    def measure(leaf, state):
        limit, found = state
        here = jnp.sqrt(jnp.min(squared_distance(segment, [points[leaf, i, :] for i in range(3)]))) - r
        return jnp.minimum(limit, here), jnp.where(here < limit, leaf, found)

    def reach(state):
        return state[0] + r

    def descend(branch, state):
        take = lambda leaf, state: measure(branch * FAN + leaf, state)  # noqa: E731
        return _for_each_cluster(segment, lambda i: leaves[branch, i, :], FAN, reach, take, state)

    def nearest_middle(load):
        return least_number(squared_distance(single(segment), [load(i) for i in range(3)]))

    # The leaf whose middle is nearest is measured first; its distance is the first limit.
    first = jnp.minimum(nearest_middle(lambda i: branches[i, :]), branch_count - 1)
    start = measure(first * FAN + nearest_middle(lambda i: leaves[first, i, :]), (limit, jnp.int32(-1)))
    return _for_each_cluster(segment, lambda i: branches[i, :], branch_count, reach, descend, start)


def _least_of_branch(measure, branch_count, rows, p, q, reach, start, *refs):
    """Kernel of `least_in_reach`: minimise `measure` for one body.

    All points of a branch are measured at once: with 32 threads, selecting leaves takes longer.
    """
    *refs, branches, points, out = refs
    body = instance()
    segment, within = _segment(p, q, body), reach[body]
    own = [_row_of_body(ref, body) for ref in refs[:rows]]
    number = jax.lax.broadcasted_iota(jnp.int32, (FAN * FAN,), 0)

    def descend(branch, least):
        w = [points[branch * FAN + number // FAN, i, number % FAN] for i in range(3)]
        return jnp.minimum(least, measure(segment, *own, w))

    out[body] = _for_each_cluster(
        segment, lambda i: branches[i, :], branch_count, lambda _: within, descend, start[body]
    )


def _row_of_body(table, body):
    """Return one body's row of a table: a number, or a list of coordinates."""
    return table[body] if len(table.shape) == 1 else [table[body, i] for i in range(table.shape[1])]


def _segment(p, q, body) -> LineSegments:
    """Return the axis of one body as a segment."""
    start, end = _row_of_body(p, body), _row_of_body(q, body)
    along = [b - a for a, b in zip(start, end, strict=True)]
    square = along[0] * along[0] + along[1] * along[1] + along[2] * along[2]
    return LineSegments(start, along, 1 / jnp.maximum(square, 1e-30))


def _for_each_cluster(
    segment: LineSegments, load: Callable, count: int, reach: Callable, take: Callable, state: Any
) -> Any:
    """Apply state = take(cluster, state) to each of `count` clusters, in the order of their bounds; return the state.

    Clusters that cannot have a point within reach(state) [m] of the segment are skipped. `load(i)` returns coordinate i
    of all discs, and may be padded after the last disc.
    """
    keys = order_keys(jnp.maximum(lower_bounds(single(segment), [load(i) for i in range(8)]), 0.0))
    mask = number_mask(len(keys))
    keys = jnp.where((keys & mask) < count, keys, NONE_LEFT)

    def prune(keys, state):
        furthest = jnp.full(len(keys), jnp.minimum(reach(state) * (1 + 1e-6), 1e30), jnp.float32)
        return jnp.where(keys <= (jax.lax.bitcast_convert_type(furthest, jnp.int32) | mask), keys, NONE_LEFT)

    def step(carry):
        picked, keys, state = carry
        state = take(picked & mask, state)
        keys = prune(jnp.where(keys == picked, NONE_LEFT, keys), state)
        return jnp.min(keys), keys, state

    keys = prune(keys, state)
    return jax.lax.while_loop(lambda carry: carry[0] < NONE_LEFT, step, (jnp.min(keys), keys, state))[2]
