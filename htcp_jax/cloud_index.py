"""Exact nearest point of a cloud to a line segment, by branch and bound over a two-level tree.

The cloud is cut once into balanced leaves of 16 points, and 16 neighbouring leaves make a node. A cluster is bounded
by a flat disc about one of its points m (the medoid): normal n, half thickness e, radius r. Let c be the point of the
segment closest to m, and v the unit vector from m to c. Every point of the segment lies beyond the plane through c
normal to v (c is the projection of m onto a convex set), and no point of the cluster lies further along v than
|v.n| e + sqrt(1 - (v.n)^2) r. So

    distance(segment, cluster) >= |c - m| - |v.n| e - sqrt(1 - (v.n)^2) r,

which for a patch of a wall seen face on is the wall's thickness away from exact. A search round takes the best nodes,
bounds their leaves, takes the best leaves, measures their points; it ends when no bound left is below the smallest
distance found: that is the certificate, and nothing is returned without it.

Bounds are 32-bit (rounded down by `SLACK`) and carry their own index in their low bits, so that one vectorised integer
minimum finds both; a sort or an argmin costs ten times that on a CPU. Distances are 64-bit.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.numerics import one_by_one
from htcp_jax.types import Array, Float, Int

POINTS_A_LEAF = 16
LEAVES_A_NODE = 16
NODES_A_ROUND = 8
LEAVES_A_ROUND = 8
SLACK = 1e-5  # [m]; a bound in 32-bit floats is wrong by less than this within 20 m of the origin
NONE_LEFT = np.int32(2**31 - 1)


class CloudIndex(NamedTuple):
    """A cloud and its two-level tree. Rows of a bound: medoid xyz, normal xyz, half thickness, radius [m]."""

    node_bound: Float[Array, "8 nodes"]
    leaf_bound: Float[Array, "nodes 8 leaves"]
    leaf_points: Float[Array, "all_leaves 3 points"]
    leaf_rows: Int[Array, "all_leaves points"]  # row of the cloud that each point came from


def build_index(points: Float[np.ndarray, "P 3"]) -> CloudIndex:
    """Index of a cloud of P >= 1 points [m]. Clusters that are short of points repeat one of their own."""
    per_node = POINTS_A_LEAF * LEAVES_A_NODE
    nodes = _cut(points, np.arange(len(points)), -(-len(points) // per_node))
    leaves = [leaf for node in nodes for leaf in _cut(points, node, LEAVES_A_NODE)]
    rows = np.stack([_padded(leaf, POINTS_A_LEAF) for leaf in leaves])
    rows = rows.reshape(len(nodes), LEAVES_A_NODE, POINTS_A_LEAF)
    short = -len(nodes) % NODES_A_ROUND
    rows = np.concatenate([rows, np.repeat(rows[:1], short, axis=0)])
    clusters = points[rows]
    node_bound = _disc(clusters.reshape(len(rows), -1, 3))
    leaf_bound = _disc(clusters.reshape(-1, POINTS_A_LEAF, 3)).reshape(len(rows), LEAVES_A_NODE, 8)
    return CloudIndex(
        node_bound=jnp.asarray(node_bound.T, jnp.float32),
        leaf_bound=jnp.asarray(leaf_bound.transpose(0, 2, 1), jnp.float32),
        leaf_points=jnp.asarray(clusters.reshape(-1, POINTS_A_LEAF, 3).transpose(0, 2, 1)),
        leaf_rows=jnp.asarray(rows.reshape(-1, POINTS_A_LEAF), jnp.int32),
    )


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
    limit only the body that is nearest of all gets a row. The bodies search side by side, each its own clusters."""
    segments = _segments(p, q)
    segments32 = jax.tree.map(lambda a: a.astype(jnp.float32), segments)
    bodies = p.shape[0]

    def lowered(limit, distance):
        """The limits, lowered to what the bodies attain: distance (K, n) - radius."""
        nearest = jnp.min(distance, axis=1) - radius
        return jnp.minimum(limit, jnp.min(nearest) if shared else nearest)

    def leaf_round(state):
        keys, node, limit, nearest = state
        picked, keys = _take_best(keys)
        local = _picked_index(picked, NODES_A_ROUND * LEAVES_A_NODE)
        leaf = jnp.take_along_axis(node, local // LEAVES_A_NODE, axis=1) * LEAVES_A_NODE + local % LEAVES_A_NODE
        points = jnp.moveaxis(index.leaf_points[leaf], 2, 0)
        distance = jnp.sqrt(jnp.min(_squared_distance(_spread(segments, 2), points), axis=2))
        new = lowered(limit, distance)
        found = distance - radius[:, None] == new[:, None]
        found = jnp.max(jnp.where(found & (new < limit)[:, None], leaf, -1), axis=1)
        nearest = jnp.where(new < limit, found, nearest)  # with a shared limit, -1 for all but one
        return _prune(keys, new + radius), node, new, nearest

    def node_round(state):
        keys, limit, nearest = state
        picked, keys = _take_best(keys)
        node = _picked_index(picked, index.node_bound.shape[1])
        lower, upper = _bounds(_spread(segments32, 2), jnp.moveaxis(index.leaf_bound[node], 2, 0))
        limit = lowered(limit, upper.reshape(bodies, -1))
        leaf_keys = _prune(_keys(lower.reshape(bodies, -1), LEAVES_A_ROUND), limit + radius)
        _, _, limit, nearest = jax.lax.while_loop(_any_left, leaf_round, (leaf_keys, node, limit, nearest))
        return _prune(keys, limit + radius), limit, nearest

    lower, upper = _bounds(_spread(segments32, 1), index.node_bound[:, None, :])
    limit = lowered(limit, upper)
    keys = _prune(_keys(lower, NODES_A_ROUND), limit + radius)
    start = (keys, limit, jnp.full(bodies, -1, jnp.int32))
    _, _, leaf = jax.lax.while_loop(_any_left, node_round, start)
    square = _squared_distance(_spread(segments, 1), index.leaf_points[leaf].transpose(1, 0, 2))
    first = jnp.argmin(square, axis=1)
    return jnp.where(leaf < 0, -1, index.leaf_rows[leaf, first])


class _Segments(NamedTuple):
    """Segments p + s d, 0 <= s <= 1: coordinates first, then the bodies, so that bodies can be picked and broadcast."""

    p: Float[Array, "3 *K"]
    d: Float[Array, "3 *K"]
    inverse: Float[Array, "*K"]  # 1 / |d|^2


def _segments(p, q) -> _Segments:
    d = q - p
    square = jnp.sum(d * d, axis=1)
    # A segment shorter than 1e-15 m is as good as a point; its inverse would be infinite in 32-bit.
    return _Segments(p.T, d.T, 1 / jnp.maximum(square, 1e-30))


def _spread(segments: _Segments, axes: int) -> _Segments:
    """The segments with axes for what each of them is measured against."""
    return jax.tree.map(lambda a: a.reshape(*a.shape, *[1] * axes), segments)


def _arm(segment: _Segments, points):
    """From the closest point of the segment to each point (3, ...)."""
    a = [points[i] - segment.p[i] for i in range(3)]
    s = jnp.clip(sum(a[i] * segment.d[i] for i in range(3)) * segment.inverse, 0, 1)
    return [a[i] - s * segment.d[i] for i in range(3)]


def _squared_distance(segment: _Segments, points):
    a = _arm(segment, points)
    return a[0] * a[0] + a[1] * a[1] + a[2] * a[2]


def _bounds(segment: _Segments, bound):
    """The module's bound for clusters (8, ...), 32-bit [m], and the distance to their medoids, rounded up."""
    a = _arm(segment, bound)
    square = a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
    distance = jnp.sqrt(square)
    along = a[0] * bound[3] + a[1] * bound[4] + a[2] * bound[5]  # |c - m| (v.n), up to its sign
    # The difference cancels where the patch is seen face on: 2e-6 is more than its rounding.
    across = jnp.sqrt(jnp.maximum(square - along * along, 0) + 2e-6 * square)
    reach = (jnp.abs(along) * bound[6] + across * bound[7]) / jnp.maximum(distance, 1e-12)
    return distance - reach - jnp.float32(SLACK), distance + jnp.float32(SLACK)


def _index_bits(count: int) -> int:
    return max(1, (count - 1).bit_length())


def _keys(bound, columns: int):
    """Keys (K, n / columns, columns) of bounds (K, n). Non-negative 32-bit floats order like their bits; the low bits
    make room for the index (rounding down)."""
    bodies, clusters = bound.shape
    bits = jax.lax.bitcast_convert_type(jnp.maximum(bound, 0), jnp.int32)
    mask = (1 << _index_bits(clusters)) - 1
    return ((bits & ~mask) | jnp.arange(clusters, dtype=jnp.int32)[None, :]).reshape(bodies, -1, columns)


def _prune(keys, limit):
    """The keys of all bounds below the limit of their body (K,), NONE_LEFT in place of the others."""
    nearest = jnp.minimum(limit * (1 + 1e-6), 1e30).astype(jnp.float32)
    mask = (1 << _index_bits(keys[0].size)) - 1
    above = jax.lax.bitcast_convert_type(nearest, jnp.int32) | mask  # negative, so below all keys, like the limit
    return jnp.where(keys <= above[:, None, None], keys, NONE_LEFT)


def _any_left(state):
    """Whether a search goes on; its keys come first."""
    return jnp.min(state[0]) < NONE_LEFT


def _picked_index(picked, count):
    """Which of `count` clusters a key stands for; the first one where none was left."""
    return jnp.where(picked == NONE_LEFT, 0, picked & ((1 << _index_bits(count)) - 1))


def _take_best(keys):
    """The smallest key of each column, and the keys without them. Columns interleave clusters that are neighbours."""
    picked = jnp.min(keys, axis=1)
    return picked, jnp.where(keys == picked[:, None, :], NONE_LEFT, keys)


def _cut(points, rows, parts):
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
    return _cut(points, low, left) + _cut(points, high, parts - left)


def _padded(rows, size):
    return np.concatenate([rows, np.repeat(rows[-1:], size - len(rows))])


def _disc(clusters):
    """Bounding disc of each cluster (n, points, 3): medoid, normal, half thickness, radius, as rows (n, 8)."""
    n = np.arange(len(clusters))
    offset = clusters - clusters.mean(axis=1, keepdims=True)
    medoid = clusters[n, np.argmin(np.sum(offset**2, axis=-1), axis=1)]
    normal = np.linalg.eigh(np.einsum("npi,npj->nij", offset, offset))[1][:, :, 0]
    arm = clusters - medoid[:, None]
    height = np.einsum("npi,ni->np", arm, normal)
    across = np.linalg.norm(arm - height[..., None] * normal[:, None], axis=-1)
    return np.concatenate([medoid, normal, np.abs(height).max(1)[:, None], across.max(1)[:, None]], axis=1)
