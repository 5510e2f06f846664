"""Clusters of points: their tree, flat discs that bound them, and lower bounds on their distance to a segment.

A cluster is bounded by a disc: middle m, normal n, half thickness e, radius r. Let c be the point of the segment
closest to m, and v the unit vector from m to c. Every point of the segment lies beyond the plane through c normal to v
(c is the projection of m onto a convex set), and no point of the cluster lies further along v than
|v.n| e + sqrt(1 - (v.n)^2) r. So

    distance(segment, cluster) >= |c - m| - |v.n| e - sqrt(1 - (v.n)^2) r,

For a patch of a wall that faces the segment, the bound is exact up to the wall's thickness. It is computed in 32-bit
floats and reduced by `SLACK`. The middle m is nearly the centre of the smallest circle about the cluster. With the
cluster's most central point as m, discs would be a fifth larger, and a search would measure 50 % more leaves.

Searches order clusters by keys. A key is an integer: a 32-bit bound, rounded down, with the number of its cluster in
its low bits. One integer minimum finds both the smallest bound and its cluster. On a CPU a sort or an argmin takes ten
times as long.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.types import Array, Float, Int

SLACK = 1e-5  # [m]; a bound in 32-bit floats is wrong by less than this within 20 m of the origin
FAN = 16  # members of a cluster: points, facets, or clusters
NONE_LEFT = np.int32(2**31 - 1)


class LineSegments(NamedTuple):
    """Line segments p + s d [m], 0 <= s <= 1, with coordinates along the first axis and bodies along the others."""

    p: Float[Array, "3 *K"]
    d: Float[Array, "3 *K"]
    inverse: Float[Array, "*K"]  # 1 / |d|^2


def as_segments(p: Float[Array, "K 3"], q: Float[Array, "K 3"]) -> LineSegments:
    """Return the segments between p and q [m]."""
    d = q - p
    square = jnp.sum(d * d, axis=1)
    # A segment shorter than 1e-15 m is treated as a point: its inverse would be infinite in 32-bit floats.
    return LineSegments(p.T, d.T, 1 / jnp.maximum(square, 1e-30))


def single(segments: LineSegments) -> LineSegments:
    """Return the segments in 32-bit floats."""
    return jax.tree.map(lambda a: a.astype(jnp.float32), segments)


def with_axes(segments: LineSegments, axes: int) -> LineSegments:
    """Return the segments with extra axes, for broadcasting against points or discs."""
    return jax.tree.map(lambda a: a.reshape(*a.shape, *[1] * axes), segments)


def lever_arm(segment: LineSegments, points):
    """Return the vector from the closest point of the segment to each point (3, ...)."""
    a = [points[i] - segment.p[i] for i in range(3)]
    s = sum(a[i] * segment.d[i] for i in range(3)) * segment.inverse
    s = jnp.where(s > 0, s, 0)  # one instruction per `where`; jnp.clip takes two more, as it propagates NaN
    s = jnp.where(s < 1, s, 1)
    return [a[i] - s * segment.d[i] for i in range(3)]


def squared_distance(segment: LineSegments, points):
    """Return the squared distance of points (3, ...) to a segment [m^2]."""
    a = lever_arm(segment, points)
    return a[0] * a[0] + a[1] * a[1] + a[2] * a[2]


def lower_bounds(segment: LineSegments, bound):
    """Return lower bounds on the distance from a segment to the points inside bounding discs (8, ...) [m]."""
    a = lever_arm(segment, bound)
    square = a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
    distance = jnp.sqrt(square)
    along = a[0] * bound[3] + a[1] * bound[4] + a[2] * bound[5]  # |c - m| (v.n), up to its sign
    # The difference nearly cancels for a patch that faces the segment; its rounding error is below 2e-6.
    rest = square - along * along
    across = jnp.sqrt(jnp.where(rest > 0, rest, 0) + 2e-6 * square)
    reach = (jnp.abs(along) * bound[6] + across * bound[7]) / jnp.maximum(distance, 1e-12)
    return distance - reach - jnp.float32(SLACK)


def bounding_discs(groups: Float[np.ndarray, "n points 3"]) -> Float[np.ndarray, "n 8"]:
    """Return the bounding disc of each group: middle, normal, half thickness, radius."""
    mean = groups.mean(axis=1)
    offset = groups - mean[:, None]
    axes = np.linalg.eigh(np.einsum("npi,npj->nij", offset, offset))[1]
    height, a, b = np.einsum("npi,nij->jnp", offset, axes)
    middle = np.stack([(height.max(1) + height.min(1)) / 2, *_middle(a, b)])
    thickness = np.abs(height - middle[0, :, None]).max(1)
    radius = np.sqrt(_square_distance(a, b, *middle[1:]).max(1))
    return np.column_stack([mean + np.einsum("nij,jn->ni", axes, middle), axes[:, :, 0], thickness, radius])


def _middle(a, b):
    """Return the centre of the smallest circle about the points (a, b) of each group, to about 1 % of its radius.

    The search begins in the middle of the points' bounding box, and steps towards the furthest point, each time by
    less.
    """
    x, y = (a.max(1) + a.min(1)) / 2, (b.max(1) + b.min(1)) / 2
    groups = np.arange(len(a))
    for step in 0.25 * 0.85 ** np.arange(10):
        furthest = groups, np.argmax(_square_distance(a, b, x, y), axis=1)
        x, y = x + step * (a[furthest] - x), y + step * (b[furthest] - y)
    return x, y


def _square_distance(a, b, x, y):
    return (a - x[:, None]) ** 2 + (b - y[:, None]) ** 2


class CloudIndex(NamedTuple):
    """A cloud and its tree of clusters.

    A level has a group of clusters for each cluster of the level above. There are two levels or more, and one group at
    the top. The 8 rows of a level are the clusters' bounding discs: middle xyz, normal xyz, half thickness, radius [m].
    """

    levels: tuple[Float[Array, "groups 8 clusters"], ...]
    points: Float[Array, "leaves 3 points"]  # [m]
    rows: Int[Array, "leaves points"]  # row of the cloud that each point came from


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
