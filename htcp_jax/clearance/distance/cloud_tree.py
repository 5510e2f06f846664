"""Exact nearest point of a cloud to a line segment, by branch and bound over a tree of clusters.

The cloud is cut once into balanced leaves of 16 points; 16 neighbouring leaves make a cluster, 16 of these the next
larger one, and so on up to a small top level. Each cluster is bounded by a flat disc (see `bounding_discs`). A search
opens every cluster whose bound is not above the smallest distance found, so the result is certified to be the nearest
point. `cloud_tree_walk` is the implementation for CPUs, `cloud_tree_gpu` the one for GPUs.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.backend import backend
from htcp_jax.caching import cached_by_values
from htcp_jax.clearance.distance import branch_and_bound, cloud_tree_gpu, cloud_tree_walk
from htcp_jax.clearance.distance.bounding_discs import (
    CloudIndex,
    as_segments,
    bounding_discs,
    squared_distance,
    with_axes,
)
from htcp_jax.clearance.distance.branch_and_bound import FAN
from htcp_jax.numerics import one_by_one
from htcp_jax.types import Array, Float, Int

TOP = 31  # maximum number of clusters at the top: a search stores them as bits of one number


def build_index(points: Float[np.ndarray, "P 3"]) -> CloudIndex:
    """Build the index of a cloud of P >= 1 points [m]. Clusters with too few points repeat one of them."""
    return jax.device_put(_host_index(points))  # in the final types: JAX compiles every conversion


@cached_by_values(2)
def _host_index(points: Float[np.ndarray, "P 3"]) -> CloudIndex:
    """Return the index as numpy arrays."""
    depth = 2
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


def _nested_clusters(points, rows, parts: int, levels: int):
    """Return nested clusters of the rows, (parts, FAN, ..., FAN): `parts` clusters, cut into FAN each, and so on."""
    groups = branch_and_bound.cut_rows(points, rows, parts)
    if levels == 1:
        return np.stack([branch_and_bound.padded_cluster(group) for group in groups])
    return np.stack([_nested_clusters(points, group, FAN, levels - 1) for group in groups])


class NearestPoint(NamedTuple):
    """Indices of the nearest pair of a body and a point of the cloud; -1, -1 if no pair is within the limit."""

    body: Int[Array, ""]
    row: Int[Array, ""]


def nearest_rows(index: CloudIndex, p: Float[Array, "K 3"], q: Float[Array, "K 3"]) -> Int[Array, "K"]:
    """Return the row of the cloud's point nearest to each of K segments; any of several equally near points.

    The search is exact. A row has no gradient: differentiate the distance to the point in this row.

    Args:
        index: The cloud's tree.
        p: First ends of the segments [m].
        q: Second ends [m].
    """
    limit = jnp.full(p.shape[0], 1e150, float)
    return _nearest_rows(index, *jax.lax.stop_gradient((p, q, limit)))


def nearest_body(
    index: CloudIndex,
    p: Float[Array, "K 3"],
    q: Float[Array, "K 3"],
    radius: Float[Array, "K"],
    below: float = 1e150,
) -> NearestPoint:
    """Return the pair of body and point with the smallest distance(segment, point) - radius.

    This is cheaper than `nearest_rows`, because a point found for one body limits the search of all other bodies.

    Args:
        index: The cloud's tree.
        p: First ends of the bodies' axes [m].
        q: Second ends [m].
        radius: Radii of the bodies [m].
        below: Upper limit of distance - radius [m]; pairs above it are not returned, see `NearestPoint`.
    """
    return _nearest_body(index, *jax.lax.stop_gradient((p, q, radius, jnp.asarray(below, float))))


@one_by_one
def _nearest_rows(index: CloudIndex, p, q, limit):
    return _search_rows(index, p, q, jnp.zeros(limit.shape, float), limit, shared=False)


@one_by_one
def _nearest_body(index: CloudIndex, p, q, radius, below):
    rows = _search_rows(index, p, q, radius, jnp.broadcast_to(below, radius.shape), shared=True)
    body = jnp.argmax(rows).astype(jnp.int32)
    return NearestPoint(jnp.where(rows[body] < 0, -1, body), rows[body])


def _search_rows(index: CloudIndex, p, q, radius, limit, shared: bool):
    """Return the row of the nearest point of each of K bodies, -1 if none has distance - radius below its limit.

    With a shared limit, only the nearest body gets a row; all other bodies get -1.
    """
    search = cloud_tree_gpu if backend().has_kernels else cloud_tree_walk
    leaf = search.nearest_leaves(index, p, q, radius, limit, shared)
    square = squared_distance(with_axes(as_segments(p, q), 1), index.points[leaf].transpose(1, 0, 2))
    return jnp.where(leaf < 0, -1, _row_of_least(square, index.rows[leaf]))


def _row_of_least(square: Float[Array, "K FAN"], rows: Int[Array, "K FAN"]) -> Int[Array, "K"]:
    """Return the row with the smallest squared distance, by repeated halving: an argmin takes three times as long."""
    while square.shape[1] > 1:
        (a, b), (row_a, row_b) = jnp.split(square, 2, axis=1), jnp.split(rows, 2, axis=1)
        square, rows = jnp.minimum(a, b), jnp.where(a <= b, row_a, row_b)
    return rows[:, 0]
