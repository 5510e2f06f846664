"""Clusters for branch and bound: balanced cuts, and searches in the order of the bounds.

A key is a 32-bit bound (rounded down) with the number of its cluster in its low bits, so that one integer minimum
finds both; a sort or an argmin costs ten times that on a CPU.
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
        points: All points.
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
    # A part without points repeats a neighbour's.
    low, high = (order[:middle], order[middle:]) if middle else (order, order)
    return cut_rows(points, low, left) + cut_rows(points, high, parts - left)


def padded_cluster(rows: Int[np.ndarray, "n"]) -> Int[np.ndarray, "FAN"]:
    """Return the rows of one cluster, padded with the last one."""
    return np.concatenate([rows, np.repeat(rows[-1:], FAN - len(rows))])


def order_keys(bound: Float[Array, "... n"]) -> Int[Array, "... n"]:
    """Return keys of bounds >= 0. Non-negative 32-bit floats order like their bits."""
    number = jax.lax.broadcasted_iota(jnp.int32, bound.shape, bound.ndim - 1)
    return jax.lax.bitcast_convert_type(bound, jnp.int32) & ~number_mask(bound.shape[-1]) | number


def least_number(bound: Float[Array, "... n"]) -> Int[Array, "..."]:
    """Return the number of the smallest bound, as far as keys distinguish them."""
    return jnp.min(order_keys(bound), axis=-1) & number_mask(bound.shape[-1])


def number_mask(count: int) -> int:
    """Return the mask of a key's low bits that hold its cluster's number."""
    return (1 << max(1, (count - 1).bit_length())) - 1
