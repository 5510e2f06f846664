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
from htcp_jax.types import Array, Float, Int

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
    limit = jnp.full(p.shape[0], 1e150) if within is None else within
    alone = jax.lax.stop_gradient((p[:, None], q[:, None], jnp.zeros((p.shape[0], 1)), limit))
    return _searches(index, *alone).row


def nearest_body(
    index: CloudIndex,
    p: Float[Array, "K 3"],
    q: Float[Array, "K 3"],
    radius: Float[Array, "K"],
    below: float = 1e150,
) -> Nearest:
    """The pair of body and point with the smallest distance(segment, point) - radius, if that is below `below` [m].

    One search for all bodies: cheaper than one a body, because what is nearer to one body rules out all others.
    """
    some = jax.lax.stop_gradient((p[None], q[None], radius[None], jnp.full(1, below)))
    return jax.tree.map(lambda leaf: leaf[0], _searches(index, *some))


@custom_vmap
def _searches(index: CloudIndex, p, q, radius, below):
    """Independent searches, one a row: p, q (n, K, 3), radius (n, K), below (n,)."""
    return jax.vmap(lambda *search: _search(index, *search))(p, q, radius, below)


@_searches.def_vmap
def _searches_batch(axis_size, in_batched, index, *searches):
    return one_by_one(_searches, axis_size, in_batched, index, searches)


def _search(index: CloudIndex, p, q, radius, below) -> Nearest:
    """One search over K bodies: nodes in rounds, the leaves of each round's nodes in rounds. A pair of body and cluster
    is numbered body * clusters + cluster."""
    segments = _segments(p, q)
    segments32 = jax.tree.map(lambda a: a.astype(jnp.float32), segments)
    bodies, nodes = p.shape[0], index.node_bound.shape[1]
    leaves = NODES_A_ROUND * LEAVES_A_NODE
    # Keys must not be negative: bounds are of distance - radius + the largest radius.
    lift = jnp.max(radius)

    def leaf_round(state):
        keys, pairs, best, best_leaf, best_body = state
        picked, keys = _take_best(keys)
        local = _picked_index(picked, leaves)
        pair = pairs[local // LEAVES_A_NODE]
        body, leaf = pair // nodes, pair % nodes * LEAVES_A_NODE + local % LEAVES_A_NODE
        own = _of(segments, body)
        square = _squared_distance(own, index.leaf_points[leaf].transpose(1, 0, 2))
        distance = jnp.sqrt(jnp.min(square, axis=1)) - _of_body(radius, body)
        smallest = jnp.min(distance)
        first = jnp.max(jnp.where(distance == smallest, jnp.arange(LEAVES_A_ROUND, dtype=jnp.int32), -1))
        better = smallest < best
        return (
            keys,
            pairs,
            jnp.where(better, smallest, best),
            jnp.where(better, leaf[first], best_leaf),
            jnp.where(better, body[first], best_body),
        )

    def node_round(state):
        keys, best, best_leaf, best_body = state
        picked, keys = _take_best(keys)
        pairs = _picked_index(picked, bodies * nodes)
        body = pairs // nodes
        own = _of(segments32, body)
        bound = _lower_bound(own, index.leaf_bound[pairs % nodes].transpose(1, 0, 2))
        bound = _lifted(bound, _of_body(radius, body), lift)
        leaf_keys = _keys(bound.reshape(-1)).reshape(-1, LEAVES_A_ROUND)
        _, _, *found = jax.lax.while_loop(
            lambda s: jnp.min(s[0]) <= _key_above(s[2] + lift, leaves),
            leaf_round,
            (leaf_keys, pairs, best, best_leaf, best_body),
        )
        return keys, *found

    own = jax.tree.map(lambda a: a[..., None], segments32)
    bound = _lifted(_lower_bound(own, index.node_bound[:, None, :]), radius, lift)
    node_keys = _keys(bound.reshape(-1)).reshape(-1, NODES_A_ROUND)
    none = jnp.full((), -1, jnp.int32)
    _, _, leaf, body = jax.lax.while_loop(
        lambda s: jnp.min(s[0]) <= _key_above(s[1] + lift, bodies * nodes), node_round, (node_keys, below, none, none)
    )
    square = _squared_distance(_of(segments, body), index.leaf_points[leaf])
    return Nearest(body, jnp.where(leaf < 0, -1, index.leaf_rows[leaf, jnp.argmin(square)]))


class _Segments(NamedTuple):
    """Segments p + s d, 0 <= s <= 1: coordinates first, then the bodies, so that bodies can be picked and broadcast."""

    p: Float[Array, "3 *K"]
    d: Float[Array, "3 *K"]
    inverse: Float[Array, "*K"]  # 1 / |d|^2, 0 for a point


def _segments(p, q) -> _Segments:
    d = q - p
    square = jnp.sum(d * d, axis=1)
    return _Segments(p.T, d.T, jnp.where(square > 0, 1 / jnp.where(square > 0, square, 1.0), 0.0))


def _of_body(values, body):
    """Values (..., K) of the given bodies; with a single body nothing is gathered, which is faster."""
    if values.shape[-1] == 1:
        return jnp.broadcast_to(values.reshape(*values.shape[:-1], *[1] * body.ndim), (*values.shape[:-1], *body.shape))
    return values[..., body]


def _of(segments: _Segments, body) -> _Segments:
    """The segments of the given bodies, with an axis for points."""
    return _Segments(*(_of_body(values, body)[..., None] for values in segments))


def _arm(segment: _Segments, points):
    """From the closest point of the segment to each point (3, ...)."""
    a = [points[i] - segment.p[i] for i in range(3)]
    s = jnp.clip(sum(a[i] * segment.d[i] for i in range(3)) * segment.inverse, 0, 1)
    return [a[i] - s * segment.d[i] for i in range(3)]


def _squared_distance(segment: _Segments, points):
    a = _arm(segment, points)
    return a[0] * a[0] + a[1] * a[1] + a[2] * a[2]


def _lower_bound(segment: _Segments, bound):
    """The module's bound for clusters (8, ...), 32-bit [m]."""
    a = _arm(segment, bound)
    square = a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
    distance = jnp.sqrt(square)
    along = a[0] * bound[3] + a[1] * bound[4] + a[2] * bound[5]  # |c - m| (v.n), up to its sign
    # The difference cancels where the patch is seen face on: 2e-6 is more than its rounding.
    across = jnp.sqrt(jnp.maximum(square - along * along, 0) + 2e-6 * square)
    reach = (jnp.abs(along) * bound[6] + across * bound[7]) / jnp.maximum(distance, 1e-12)
    return distance - reach - jnp.float32(SLACK)


def _lifted(bound, radius, lift):
    """Bounds of distance - radius + lift for pairs (n, clusters), not below 0, rounded down."""
    more = (lift - radius).astype(jnp.float32)[:, None]
    return jnp.maximum((jnp.maximum(bound, 0) + more) * jnp.float32(1 - 1e-6), 0)


def _index_bits(count: int) -> int:
    return max(1, (count - 1).bit_length())


def _keys(bound):
    """Non-negative 32-bit floats order like their bits; the low bits make room for the index (rounding down)."""
    mask = (1 << _index_bits(bound.shape[0])) - 1
    bits = jax.lax.bitcast_convert_type(bound, jnp.int32)
    return (bits & ~mask) | jnp.arange(bound.shape[0], dtype=jnp.int32)


def _key_above(value, count):
    """Key above those of all bounds, out of `count`, smaller than `value`; below all keys if that is negative."""
    distance = jnp.minimum(value * (1 + 1e-6), 1e30)
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
