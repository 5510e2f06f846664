"""Clusters for branch and bound: cut evenly, and taken in the order of their bounds.

A bound is a 32-bit float that carries the number of its cluster in its low bits (rounded down), so that one integer
minimum finds both; a sort or an argmin costs ten times that on a CPU. The keys of each of K searches form a table
(rows, width): its columns interleave clusters that are neighbours, and a search takes the best of each column.
"""

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.types import Array, Bool, Float, Int

FAN = 16  # what a cluster is made of: points, facets, or clusters
NONE_LEFT = np.int32(2**31 - 1)


def cut(points: Float[np.ndarray, "P d"], rows: Int[np.ndarray, "n"], parts: int) -> list[Int[np.ndarray, "..."]]:
    """Rows cut into `parts` groups of nearly equal size, each time across the longest axis of inertia."""
    if parts == 1 or len(rows) <= 1:
        return [rows] * parts
    centred = points[rows] - points[rows].mean(axis=0)
    axis = np.linalg.eigh(centred.T @ centred)[1][:, -1]
    order = rows[np.argsort(centred @ axis, kind="stable")]
    left = parts // 2
    middle = len(rows) * left // parts
    # A part without points repeats a neighbour's.
    low, high = (order[:middle], order[middle:]) if middle else (order, order)
    return cut(points, low, left) + cut(points, high, parts - left)


def padded(rows: Int[np.ndarray, "n"]) -> Int[np.ndarray, "FAN"]:
    """The rows of one cluster, the last one repeated."""
    return np.concatenate([rows, np.repeat(rows[-1:], FAN - len(rows))])


def order_keys(bound: Float[Array, "K n"], width: int) -> Int[Array, "K rows width"]:
    """Keys of bounds; those below 0 count as 0. Non-negative 32-bit floats order like their bits."""
    bodies, clusters = bound.shape
    bits = jax.lax.bitcast_convert_type(jnp.maximum(bound, 0), jnp.int32)
    mask = (1 << index_bits(clusters)) - 1
    return ((bits & ~mask) | jnp.arange(clusters, dtype=jnp.int32)[None, :]).reshape(bodies, -1, width)


def prune(keys: Int[Array, "K rows width"], limit: Float[Array, "K"]) -> Int[Array, "K rows width"]:
    """The keys of all bounds below the limit of their search, NONE_LEFT in place of the others."""
    nearest = jnp.minimum(limit * (1 + 1e-6), 1e30).astype(jnp.float32)
    mask = (1 << index_bits(keys[0].size)) - 1
    above = jax.lax.bitcast_convert_type(nearest, jnp.int32) | mask  # negative, so below all keys, like the limit
    return jnp.where(keys <= above[:, None, None], keys, NONE_LEFT)


def best(keys: Int[Array, "K rows width"]) -> Int[Array, "K width"]:
    """The smallest key of each column."""
    return least(keys, axis=1)


def any_left(picked: Int[Array, "K width"]) -> Bool[Array, ""]:
    """Whether any of the best keys stands for a cluster."""
    return jnp.min(picked) < NONE_LEFT


def without(keys: Int[Array, "K rows width"], picked: Int[Array, "K width"]) -> Int[Array, "K rows width"]:
    """The keys without those picked."""
    return jnp.where(keys == picked[:, None, :], NONE_LEFT, keys)


def number(picked: Int[Array, "K width"], clusters: int) -> Int[Array, "K width"]:
    """Which of the clusters a key stands for; the first one where none was left."""
    return jnp.where(picked == NONE_LEFT, 0, picked & ((1 << index_bits(clusters)) - 1))


def least(values: Array, axis: int) -> Array:
    """Minimum along an axis, by halves where that is short: a chain of comparisons would wait for each other."""
    length = values.shape[axis]
    while 1 < length <= 32:
        half = (length + 1) // 2
        low = jax.lax.slice_in_dim(values, 0, half, axis=axis)
        values = jnp.minimum(low, jax.lax.slice_in_dim(values, length - half, length, axis=axis))
        length = half
    return jnp.min(values, axis=axis)


def index_bits(count: int) -> int:
    """Low bits of a key that its cluster's number takes."""
    return max(1, (count - 1).bit_length())
