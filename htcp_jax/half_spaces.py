"""Which facet of a convex hull a point has crossed, for the clearance's interior rule.

Nearly always none, and that is decided in 32-bit floats with room for their error; only where a point comes within
that room of the boundary are all facets measured in 64-bit.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

from htcp_jax.numerics import one_by_one
from htcp_jax.types import Array, Bool, Float, Int

ROOM = 1e-5  # [m]; a 32-bit height is wrong by less than this within 20 m of the origin


class HalfSpaces(NamedTuple):
    """The convex set normal @ x <= offset, unit normals outwards; F >= 1."""

    normal: Float[Array, "F 3"]
    offset: Float[Array, "F"]


def crossed_facets(hull: HalfSpaces, points: Float[Array, "n 3"], asked: Bool[Array, "n"]) -> Int[Array, "n"]:
    """For each point asked about that lies outside: the facet that it is furthest beyond; otherwise -1."""
    return _crossed(hull, *jax.lax.stop_gradient((points, asked)))


@custom_vmap
def _crossed(hull: HalfSpaces, points, asked):
    normal, offset, point = (a.astype(jnp.float32) for a in (hull.normal.T, hull.offset, points.T))
    height = (
        point[0][:, None] * normal[0][None, :]
        + point[1][:, None] * normal[1][None, :]
        + point[2][:, None] * normal[2][None, :]
        - offset[None, :]
    )
    near = asked & (jnp.max(height, axis=1) > -ROOM)
    return jax.lax.cond(
        jnp.any(near), _measure, lambda *_: jnp.full(points.shape[0], -1, jnp.int32), hull, points, near
    )


def _measure(hull: HalfSpaces, points, asked):
    height = points @ hull.normal.T - hull.offset[None, :]
    facet = jnp.argmax(height, axis=1).astype(jnp.int32)
    return jnp.where(asked & (jnp.max(height, axis=1) > 0), facet, -1)


@_crossed.def_vmap
def _crossed_batch(axis_size, in_batched, hull, *points):
    return one_by_one(_crossed, axis_size, in_batched, hull, points)
