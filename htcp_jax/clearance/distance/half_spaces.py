"""The facet of a convex hull that a point has crossed, for the clearance's interior rule.

Usually there is none. Most points lie inside a small polytope within the hull, its core, which is tested in 32-bit with
a tolerance for its error. The others, one in ten, are measured against every facet in 64-bit: one after another on a
CPU, in parallel on a GPU (`half_spaces_gpu`).
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from htcp_jax.backend import backend
from htcp_jax.clearance.distance.half_spaces_gpu import highest
from htcp_jax.numerics import one_by_one
from htcp_jax.types import Array, Bool, Float, Int

ROUNDING_M = 1e-5  # [m]; a 32-bit height is wrong by less than this within 20 m of the origin
CORE_VERTICES = 96  # at most
FAN = 16  # facets in a row of the table, as an argmax takes ten times as long as a maximum


class HalfSpaces(NamedTuple):
    """The convex set normal @ x <= offset, unit normals outwards, F facets.

    Its core likewise, C facets; and the facets again as a table, padded with the last one: normal xyz, offset.
    """

    normal: Float[Array, "F 3"]
    offset: Float[Array, "F"]
    core_normal: Float[Array, "C 3"]
    core_offset: Float[Array, "C"]
    table: Float[Array, "4 rows FAN"]


def half_spaces(
    normal: Float[np.ndarray, "F 3"], offset: Float[np.ndarray, "F"], vertices: Float[np.ndarray, "V 3"]
) -> HalfSpaces:
    """Return the set with F facets and its core.

    Args:
        normal: Unit outward normals of the facets.
        offset: Their offsets [m].
        vertices: Points of the set [m] that extend well into its corners.
    """
    core = _core(vertices) if len(offset) else np.zeros((0, 4))
    facets = np.column_stack([normal, offset])
    filled = np.concatenate([facets, np.repeat(facets[-1:], -len(facets) % FAN, axis=0)])
    table = filled.T.reshape(4, -1, FAN)
    return jax.device_put(HalfSpaces(*map(np.asarray, (normal, offset, core[:, :3], -core[:, 3], table))))


def _core(vertices: np.ndarray) -> Float[np.ndarray, "C 4"]:
    """Return planes of the hull of the vertices that are outermost along directions spread evenly (golden angle)."""
    k = np.arange(CORE_VERTICES) + 0.5
    z, turn = 1 - 2 * k / CORE_VERTICES, np.pi * (1 + 5**0.5) * k
    directions = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])
    outermost = np.unique(np.argmax((vertices - vertices.mean(axis=0)) @ directions, axis=0))
    try:
        return scipy.spatial.ConvexHull(vertices[outermost]).equations
    except scipy.spatial.QhullError:
        return np.array([[0.0, 0.0, 0.0, 1.0]])  # too thin for one: the empty set


def crossed_facets(hull: HalfSpaces, points: Float[Array, "n 3"], requested: Bool[Array, "n"]) -> Int[Array, "n"]:
    """Return the facet that each requested point is furthest beyond, -1 for points inside and all others; F >= 1."""
    return _crossed(hull, *jax.lax.stop_gradient((points, requested)))


def depths(hull: HalfSpaces, points: Float[Array, "n 3"], requested: Bool[Array, "n"]) -> Float[Array, "n"]:
    """Return a lower bound on the depth [m] inside the hull of each point in `requested`; 0 if it may be outside."""
    return _depths(hull, *jax.lax.stop_gradient((points, requested)))


@one_by_one
def _crossed(hull: HalfSpaces, points, requested):
    left = requested & jnp.any(_core_heights(hull, points) > -ROUNDING_M, axis=1)
    nothing = jnp.full(points.shape[0], -1, jnp.int32)
    return _measured(hull, lambda found: jnp.where(found.height > 0, found.facet, -1), left, points, nothing)


@one_by_one
def _depths(hull: HalfSpaces, points, requested):
    core = -jnp.max(_core_heights(hull, points), axis=1).astype(float) - ROUNDING_M
    exact = _measured(hull, lambda found: -found.height, requested & (core <= 0), points, core)
    return jnp.maximum(exact, 0.0)


def _measured(hull: HalfSpaces, take, left, points, results):
    """Return `results`, replaced by take(highest facet) for the points in `left`."""
    if backend().has_kernels:
        return jnp.where(left, take(_Highest(*highest(hull.table, points, left))), results)
    if not backend().is_cpu:
        return jnp.where(left, take(jax.vmap(partial(_highest_facet, hull))(points)), results)
    number = jnp.arange(left.shape[0])

    def step(state):
        left, results = state
        first = jnp.argmax(left)
        this = number == first
        return left & ~this, jnp.where(this, take(_highest_facet(hull, points[first])), results)

    return jax.lax.while_loop(lambda state: jnp.any(state[0]), step, (left, results))[1]


class _Highest(NamedTuple):
    """The facet that a point is highest above, or least deep below, and the height [m]."""

    facet: Int[Array, ""]
    height: Float[Array, ""]


def _highest_facet(hull: HalfSpaces, point) -> _Highest:
    row = jnp.argmax(jnp.max(_heights(hull.table, point), axis=1))
    heights = _heights(hull.table[:, row], point)
    facet = jnp.minimum(row * FAN + jnp.argmax(heights), hull.offset.shape[0] - 1)
    return _Highest(facet.astype(jnp.int32), jnp.max(heights))


def _heights(facets, point):
    return facets[0] * point[0] + facets[1] * point[1] + facets[2] * point[2] - facets[3]


def _core_heights(hull: HalfSpaces, points):
    """Return the heights of the points above each facet of the core, 32-bit (n, C)."""
    x, y, z = (a.astype(jnp.float32)[:, None] for a in points.T)
    core = [a.astype(jnp.float32)[None] for a in (*hull.core_normal.T, hull.core_offset)]
    return _heights(core, (x, y, z))
