"""Which facet of a convex hull a point has crossed, for the clearance's interior rule.

Nearly always none. Most points lie inside a small polytope within the hull, its core, and are done; the others are
measured against every facet one by one, in 32-bit floats with room for their error, and only where a point comes within
that room of the boundary in 64-bit.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from htcp_jax.numerics import one_by_one
from htcp_jax.types import Array, Bool, Float, Int

ROOM = 1e-5  # [m]; a 32-bit height is wrong by less than this within 20 m of the origin
CORE_VERTICES = 96  # at most


class HalfSpaces(NamedTuple):
    """The convex set normal @ x <= offset, unit normals outwards, F facets; its core likewise, C facets."""

    normal: Float[Array, "F 3"]
    offset: Float[Array, "F"]
    core_normal: Float[Array, "C 3"]
    core_offset: Float[Array, "C"]


def half_spaces(
    normal: Float[np.ndarray, "F 3"], offset: Float[np.ndarray, "F"], vertices: Float[np.ndarray, "V 3"]
) -> HalfSpaces:
    """The set with F facets, where `vertices` are points of it [m] that reach well into its corners."""
    core = _core(vertices) if len(offset) else np.zeros((0, 4))
    return HalfSpaces(*(jnp.asarray(a) for a in (normal, offset, core[:, :3], -core[:, 3])))


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
    left = asked & (_top32(hull.core_normal, hull.core_offset, points.T) > -ROOM)
    return _one_at_a_time(partial(_facet, hull), left, points, jnp.full(points.shape[0], -1, jnp.int32))


@one_by_one
def _depths(hull: HalfSpaces, points, asked):
    core = -_top32(hull.core_normal, hull.core_offset, points.T).astype(float) - ROOM
    exact = _one_at_a_time(lambda point: _depth(hull, point).astype(float), asked & (core <= 0), points, core)
    return jnp.maximum(exact, 0.0)


def _one_at_a_time(measure, left, points, results):
    """The results, with measure(point) in place of those that are left."""

    def step(state):
        left, results = state
        first = jnp.argmax(left)
        return left.at[first].set(False), results.at[first].set(measure(points[first]))

    return jax.lax.while_loop(lambda state: jnp.any(state[0]), step, (left, results))[1]


def _facet(hull: HalfSpaces, point):
    """The facet crossed, or -1; 64-bit where the point is near the boundary or outside."""
    near = _depth(hull, point) <= 0
    return jax.lax.cond(near, _facet64, lambda *_: jnp.full((), -1, jnp.int32), hull, point)


def _facet64(hull: HalfSpaces, point):
    height = hull.normal @ point - hull.offset
    return jnp.where(jnp.max(height) > 0, jnp.argmax(height).astype(jnp.int32), -1)


def _depth(hull: HalfSpaces, point):
    """A lower bound of the depth inside the hull, 32-bit."""
    return -_top32(hull.normal, hull.offset, point[:, None])[0] - jnp.float32(ROOM)


def _top32(normal, offset, points):
    """The largest height of each of the points (3, n) over all facets, 32-bit."""
    normal, offset, points = (a.astype(jnp.float32) for a in (normal.T, offset, points[:, :, None]))
    height = points[0] * normal[0][None, :] + points[1] * normal[1][None, :] + points[2] * normal[2][None, :]
    return jnp.max(height - offset[None, :], axis=1)
