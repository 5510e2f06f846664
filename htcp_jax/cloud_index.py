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
from jax.custom_batching import custom_vmap

from htcp_jax.numerics import one_by_one
from htcp_jax.types import Array, Float, Int, Scalar, Vector3

POINTS_A_LEAF = 16
LEAVES_A_NODE = 16
NODES_A_ROUND = 16
LEAVES_A_ROUND = 64
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


def nearest_rows(
    index: CloudIndex,
    p: Float[Array, "K 3"],
    q: Float[Array, "K 3"],
    within: Float[Array, "K"] | None = None,
) -> Int[Array, "K"]:
    """Row of the cloud nearest to each of K segments p q [m], exact (ties: one of the nearest).

    within: look no further than this [m]; -1 where no point is as near. An integer carries no gradient: differentiate
    the distance to the point it names.
    """
    limit = jnp.full(p.shape[0], 1e150) if within is None else within
    return _nearest_rows(index, *jax.lax.stop_gradient((p, q, limit)))


def distance_above(index: CloudIndex, p: Float[Array, "K 3"], q: Float[Array, "K 3"]) -> Float[Array, "K"]:
    """A distance [m] that the nearest point to each segment does not exceed: that to the nodes' medoids."""

    def above(p, q):
        d = q - p
        square = jnp.sum(d * d)
        inverse = jnp.where(square > 0, 1 / jnp.where(square > 0, square, 1.0), 0.0)
        square = _squared_distance(
            p.astype(jnp.float32), d.astype(jnp.float32), inverse.astype(jnp.float32), index.node_bound[:3]
        )
        return jnp.sqrt(jnp.min(square)).astype(p.dtype) + SLACK

    return jax.lax.stop_gradient(jax.vmap(above)(p, q))


@custom_vmap
def _nearest_rows(index: CloudIndex, p, q, limit):
    return jax.vmap(lambda *segment: _search(index, *segment))(p, q, limit)


@_nearest_rows.def_vmap
def _nearest_rows_batch(axis_size, in_batched, index, *segments):
    return one_by_one(_nearest_rows, axis_size, in_batched, index, segments)


def _search(index: CloudIndex, p: Vector3, q: Vector3, limit: Scalar) -> Int[Array, ""]:
    """Row of the cloud nearest to one segment: nodes in rounds, the leaves of each round's nodes in rounds."""
    d = q - p
    square = jnp.sum(d * d)
    inverse = jnp.where(square > 0, 1 / jnp.where(square > 0, square, 1.0), 0.0)
    segment32 = (p.astype(jnp.float32), d.astype(jnp.float32), inverse.astype(jnp.float32))
    nodes, leaves = index.node_bound.shape[1], NODES_A_ROUND * LEAVES_A_NODE

    def leaf_round(state):
        keys, chosen_nodes, best, best_leaf = state
        picked, keys = _take_best(keys)
        local = _picked_index(picked, leaves)
        leaf_ids = chosen_nodes[local // LEAVES_A_NODE] * LEAVES_A_NODE + local % LEAVES_A_NODE
        square = _squared_distance(p, d, inverse, index.leaf_points[leaf_ids].transpose(1, 0, 2))
        square = jnp.min(square, axis=1)
        smallest = jnp.min(square)
        leaf = jnp.max(jnp.where(square == smallest, leaf_ids, -1))
        better = smallest < best
        return keys, chosen_nodes, jnp.where(better, smallest, best), jnp.where(better, leaf, best_leaf)

    def node_round(state):
        keys, best, best_leaf = state
        picked, keys = _take_best(keys)
        chosen = _picked_index(picked, nodes)
        bound = index.leaf_bound[chosen].transpose(1, 0, 2).reshape(8, -1)
        leaf_keys = _keys(_lower_bound(segment32, bound)).reshape(-1, LEAVES_A_ROUND)
        _, _, best, best_leaf = jax.lax.while_loop(
            lambda s: jnp.min(s[0]) <= _key_above(s[2], leaves), leaf_round, (leaf_keys, chosen, best, best_leaf)
        )
        return keys, best, best_leaf

    node_keys = _keys(_lower_bound(segment32, index.node_bound)).reshape(-1, NODES_A_ROUND)
    start = (node_keys, limit * limit, jnp.full((), -1, jnp.int32))
    _, _, leaf = jax.lax.while_loop(lambda s: jnp.min(s[0]) <= _key_above(s[1], nodes), node_round, start)
    square = _squared_distance(p, d, inverse, index.leaf_points[leaf])
    return jnp.where(leaf < 0, -1, index.leaf_rows[leaf, jnp.argmin(square)])


def _squared_distance(p, d, inverse, points):
    """Squared distance of points (3, ...) to the segment p + s d, 0 <= s <= 1; inverse is 1 / |d|^2 or 0."""
    a0, a1, a2 = points[0] - p[0], points[1] - p[1], points[2] - p[2]
    s = jnp.clip((a0 * d[0] + a1 * d[1] + a2 * d[2]) * inverse, 0, 1)
    a0, a1, a2 = a0 - s * d[0], a1 - s * d[1], a2 - s * d[2]
    return a0 * a0 + a1 * a1 + a2 * a2


def _lower_bound(segment, bound):
    """The module's bound for clusters (8, n), not below 0, 32-bit [m]."""
    p, d, inverse = segment
    a0, a1, a2 = bound[0] - p[0], bound[1] - p[1], bound[2] - p[2]
    s = jnp.clip((a0 * d[0] + a1 * d[1] + a2 * d[2]) * inverse, 0, 1)
    a0, a1, a2 = a0 - s * d[0], a1 - s * d[1], a2 - s * d[2]
    square = a0 * a0 + a1 * a1 + a2 * a2
    distance = jnp.sqrt(square)
    along = a0 * bound[3] + a1 * bound[4] + a2 * bound[5]  # |c - m| (v.n), up to its sign
    # The difference cancels where the patch is seen face on: 2e-6 is more than its rounding.
    across = jnp.sqrt(jnp.maximum(square - along * along, 0) + 2e-6 * square)
    reach = (jnp.abs(along) * bound[6] + across * bound[7]) / jnp.maximum(distance, 1e-12)
    return jnp.maximum(distance - reach - jnp.float32(SLACK), 0)


def _index_bits(count: int) -> int:
    return max(1, (count - 1).bit_length())


def _keys(bound):
    """Non-negative 32-bit floats order like their bits; the low bits make room for the index (rounding down)."""
    mask = (1 << _index_bits(bound.shape[0])) - 1
    bits = jax.lax.bitcast_convert_type(bound, jnp.int32)
    return (bits & ~mask) | jnp.arange(bound.shape[0], dtype=jnp.int32)


def _key_above(square, count):
    """Key above those of all bounds, out of `count`, that are smaller than sqrt(square)."""
    distance = jnp.minimum(jnp.sqrt(square) * (1 + 1e-6), 1e30)
    bits = jax.lax.bitcast_convert_type(distance.astype(jnp.float32), jnp.int32)
    return bits | ((1 << _index_bits(count)) - 1)


def _picked_index(picked, count):
    """Which of `count` clusters a key stands for; the first one where none was left."""
    return jnp.where(picked == NONE_LEFT, 0, picked & ((1 << _index_bits(count)) - 1))


def _take_best(keys):
    """The smallest key of each column, and the keys without them. Columns interleave clusters that are neighbours."""
    picked = jnp.min(keys, axis=0)
    return picked, jnp.where(keys == picked[None, :], NONE_LEFT, keys)


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
