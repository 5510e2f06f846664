"""Clusters of points or facets for branch and bound, and integer keys that order them by their bounds.

A key is an integer: a 32-bit bound, rounded down, with the number of its cluster in its low bits. One integer minimum
finds both the smallest bound and its cluster. On a CPU a sort or an argmin takes ten times as long.
"""

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.types import Array, Float, Int

FAN = 16  # members of a cluster: points, facets, or clusters
NONE_LEFT = np.int32(2**31 - 1)


def cut_rows(points: Float[np.ndarray, "P d"], rows: Int[np.ndarray, "n"], parts: int) -> list[Int[np.ndarray, "..."]]:
    """Cut rows into `parts` groups of nearly equal size, each time across the longest axis of inertia.

    Args:
        points: All points (P, d).
        rows: Rows of the points to group.
        parts: Number of groups.
    """
    if parts == 1 or len(rows) <= 1:
        return [rows] * parts
    centred = points[rows] - points[rows].mean(axis=0)
    axis = np.linalg.eigh(centred.T @ centred)[1][:, -1]
    order = rows[np.argsort(centred @ axis, kind="stable")]
    left = parts // 2
    middle = len(rows) * left // parts
    # A part without points gets the points of its neighbour.
    low, high = (order[:middle], order[middle:]) if middle else (order, order)
    return cut_rows(points, low, left) + cut_rows(points, high, parts - left)


def padded_cluster(rows: Int[np.ndarray, "n"]) -> Int[np.ndarray, "FAN"]:
    """Return the rows of one cluster, padded with the last row."""
    return np.concatenate([rows, np.repeat(rows[-1:], FAN - len(rows))])


def order_keys(bound: Float[Array, "... n"]) -> Int[Array, "... n"]:
    """Return integer keys in the order of bounds >= 0: the bits of non-negative 32-bit floats have the same order."""
    number = jax.lax.broadcasted_iota(jnp.int32, bound.shape, bound.ndim - 1)
    return jax.lax.bitcast_convert_type(bound, jnp.int32) & ~number_mask(bound.shape[-1]) | number


def least_number(bound: Float[Array, "... n"]) -> Int[Array, "..."]:
    """Return the index of the smallest bound along the last axis, to the precision of the keys."""
    return jnp.min(order_keys(bound), axis=-1) & number_mask(bound.shape[-1])


def number_mask(count: int) -> int:
    """Return the mask of a key's low bits, which contain the cluster's number."""
    return (1 << max(1, (count - 1).bit_length())) - 1
