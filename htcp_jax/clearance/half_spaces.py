"""Which facet of a convex hull a point has crossed, for the clearance's interior rule.

Nearly always none. Most points lie inside a small polytope within the hull, its core, and are done. For the others the
facet that a point is highest above (or least deep below) is found by branch and bound over clusters of 16 facets with
similar normals: of a cluster with a facet (c, o), a point m and r = max |n_f - c| over its facets, none is higher below
x than

    c.(x - m) + r |x - m| - min (o_f - n_f.m),

because n_f.x - o_f = n_f.(x - m) - (o_f - n_f.m). Bounds are 32-bit with room for their error, heights 64-bit. A GPU
measures every facet instead: that costs it less than a loop.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from htcp_jax.clearance import branch_and_bound
from htcp_jax.clearance.branch_and_bound import FAN
from htcp_jax.numerics import one_by_one, product
from htcp_jax.types import Array, Bool, Float, Int

ROOM = 1e-5  # [m]; a 32-bit height is wrong by less than this within 20 m of the origin
CORE_VERTICES = 96  # at most


class HalfSpaces(NamedTuple):
    """The convex set normal @ x <= offset, unit normals outwards, F facets; its core likewise, C facets; and the facets
    in clusters. Rows of a bound: c xyz, m xyz, r, min (o_f - n_f.m), o."""

    normal: Float[Array, "F 3"]
    offset: Float[Array, "F"]
    core_normal: Float[Array, "C 3"]
    core_offset: Float[Array, "C"]
    bound: Float[Array, "9 clusters"]
    facets: Int[Array, "clusters facets"]
    size: Float[Array, ""]  # of the set, about [m]


def half_spaces(
    normal: Float[np.ndarray, "F 3"], offset: Float[np.ndarray, "F"], vertices: Float[np.ndarray, "V 3"]
) -> HalfSpaces:
    """The set with F facets, where `vertices` are points of it [m] that reach well into its corners."""
    core = _core(vertices) if len(offset) else np.zeros((0, 4))
    groups = branch_and_bound.cut(normal, np.arange(len(offset)), -(-len(offset) // FAN)) if len(offset) else []
    facets = np.stack([branch_and_bound.padded(group) for group in groups]) if groups else np.zeros((0, FAN), int)
    bound = np.array([_bound(normal[own], offset[own], vertices) for own in facets]).reshape(-1, 9)
    return HalfSpaces(
        *(jnp.asarray(a) for a in (normal, offset, core[:, :3], -core[:, 3])),
        bound=jnp.asarray(bound.T, jnp.float32),
        facets=jnp.asarray(facets, jnp.int32),
        size=jnp.asarray(np.linalg.norm(np.ptp(vertices, axis=0)), float),
    )


def _bound(normal, offset, vertices):
    """The module's bound of one cluster, about its most central facet and the vertex furthest in that direction."""
    middle = np.argmax(normal @ normal.sum(axis=0))
    m = vertices[np.argmax(vertices @ normal[middle])]
    r = np.linalg.norm(normal - normal[middle], axis=1).max()
    return [*normal[middle], *m, r, (offset - normal @ m).min(), offset[middle]]


def _core(vertices: np.ndarray) -> Float[np.ndarray, "C 4"]:
    """Planes of the hull of the vertices that reach out furthest along directions spread evenly (golden angle)."""
    k = np.arange(CORE_VERTICES) + 0.5
    z, turn = 1 - 2 * k / CORE_VERTICES, np.pi * (1 + 5**0.5) * k
    directions = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])
    outermost = np.unique(np.argmax((vertices - vertices.mean(axis=0)) @ directions, axis=0))
    try:
        return ConvexHull(vertices[outermost]).equations
    except QhullError:
        return np.array([[0.0, 0.0, 0.0, 1.0]])  # too thin for one: the empty set


def crossed_facets(hull: HalfSpaces, points: Float[Array, "n 3"], asked: Bool[Array, "n"]) -> Int[Array, "n"]:
    """For each point asked about that lies outside: the facet that it is furthest beyond; otherwise -1. F >= 1."""
    return _crossed(hull, *jax.lax.stop_gradient((points, asked)))


def depths(hull: HalfSpaces, points: Float[Array, "n 3"], asked: Bool[Array, "n"]) -> Float[Array, "n"]:
    """A depth [m] that each point asked about has inside the hull at least; 0 where it may be outside."""
    return _depths(hull, *jax.lax.stop_gradient((points, asked)))


@one_by_one
def _crossed(hull: HalfSpaces, points, asked):
    if jax.default_backend() != "cpu":
        height = product(points, hull.normal.T) - hull.offset[None, :]
        return jnp.where(asked & (jnp.max(height, axis=1) > 0), jnp.argmax(height, axis=1).astype(jnp.int32), -1)
    left = asked & (_top32(hull.core_normal, hull.core_offset, points.T) > -ROOM)
    nothing = jnp.full(points.shape[0], -1, jnp.int32)
    return _one_at_a_time(lambda point: _highest(hull, point, 0.0).facet, left, points, nothing)


@one_by_one
def _depths(hull: HalfSpaces, points, asked):
    core = -_top32(hull.core_normal, hull.core_offset, points.T).astype(float) - ROOM
    exact = _one_at_a_time(lambda point: -_highest(hull, point, -1e9).height, asked & (core <= 0), points, core)
    return jnp.maximum(exact, 0.0)


def _one_at_a_time(measure, left, points, results):
    """The results, with measure(point) in place of those that are left."""
    number = jnp.arange(left.shape[0])

    def step(state):
        left, results = state
        first = jnp.argmax(left)
        this = number == first
        return left & ~this, jnp.where(this, measure(points[first]), results)

    return jax.lax.while_loop(lambda state: jnp.any(state[0]), step, (left, results))[1]


class _Highest(NamedTuple):
    """The facet that a point is highest above, -1 for none above the floor, and how high [m]."""

    facet: Int[Array, ""]
    height: Float[Array, ""]


def _highest(hull: HalfSpaces, point, floor: float) -> _Highest:
    """The highest facet, if it is above the floor."""
    upper, lower = _heights32(hull.bound, point)
    best = jnp.maximum(jnp.max(lower).astype(float), floor)

    def prune(keys, best):
        """The clusters that may be higher. Keys are depths below `size`; above it, all are alike."""
        return branch_and_bound.prune(keys, jnp.maximum(hull.size - best, 0.0))

    def take(state):
        picked, keys, best, cluster = state
        this = picked & branch_and_bound.number_mask(len(keys))
        height = jnp.max(_heights(hull, this, point))
        keys = prune(branch_and_bound.without(keys, picked), jnp.maximum(best, height))
        return jnp.min(keys), keys, jnp.maximum(best, height), jnp.where(height > best, this, cluster)

    depth = jnp.maximum(hull.size - upper, 0).astype(jnp.float32)
    keys = prune(branch_and_bound.order_keys(depth), best)
    start = jnp.min(keys), keys, best, jnp.full((), -1, jnp.int32)
    _, _, best, cluster = jax.lax.while_loop(lambda state: state[0] < branch_and_bound.NONE_LEFT, take, start)
    facet = hull.facets[cluster, jnp.argmax(_heights(hull, cluster, point))]
    return _Highest(jnp.where(cluster < 0, -1, facet), best)


def _heights(hull: HalfSpaces, cluster, point):
    facets = hull.facets[cluster]
    return product(hull.normal[facets], point) - hull.offset[facets]


def _heights32(bound, point):
    """The module's bounds, and the heights above one facet of each cluster, rounded outwards."""
    point = point.astype(jnp.float32)
    c, arm = bound[:3], point[:, None] - bound[3:6]
    reach = jnp.sqrt(arm[0] * arm[0] + arm[1] * arm[1] + arm[2] * arm[2])
    upper = c[0] * arm[0] + c[1] * arm[1] + c[2] * arm[2] + bound[6] * reach - bound[7]
    lower = c[0] * point[0] + c[1] * point[1] + c[2] * point[2] - bound[8]
    return upper + jnp.float32(ROOM), lower - jnp.float32(ROOM)


def _top32(normal, offset, points):
    """The largest height of each of the points (3, n) over all facets, 32-bit."""
    normal, offset, points = (a.astype(jnp.float32) for a in (normal.T, offset, points[:, :, None]))
    height = points[0] * normal[0][None, :] + points[1] * normal[1][None, :] + points[2] * normal[2][None, :]
    return jnp.max(height - offset[None, :], axis=1)
