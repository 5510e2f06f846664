"""Search for the facet of a convex hull that a point has crossed, for the interior rule of the clearance.

Usually no facet is crossed: most points lie inside the hull's core, a smaller polytope. This is tested in 32-bit floats
with a tolerance for rounding. The other points, one in ten, are measured against every facet in 64-bit floats: one
after another on a CPU, in parallel on a GPU. The GPU kernel has one instance per point, which returns at once if the
point need not be measured.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax.typing import ArrayLike

from htcp_jax.backend import backend, instance, kernel
from htcp_jax.caching import cached_by_values
from htcp_jax.numerics import one_by_one, padded_count, with_repeated
from htcp_jax.types import Array, Bool, Float, Int

ROUNDING_M = 1e-5  # [m]; a 32-bit height is wrong by less than this within 20 m of the origin
CORE_VERTICES = 96  # maximum number of vertices of the core
FAN = 16  # facets in a row of the table: the argmax, ten times slower than a maximum, then covers fewer numbers
CORE = np.array([1.0, 1.0, 1.0, -1.0])  # signs that turn Qhull's equations n @ x + d <= 0 into n @ x <= offset
EVERYWHERE = np.array([[0.0, 0.0, 0.0, np.inf]])  # a facet that every point is infinitely deep below
LEAST = 192, 1024  # minimum numbers of facets of a core and of a hull, with padding: few sizes let parts share programs
BLOCK = 256  # facets per block of the kernel


class HalfSpaces(NamedTuple):
    """The convex set normal @ x <= offset with F facets and unit outward normals.

    `core` has the C facets of its core in 32-bit floats (normal xyz, offset). `table` has all F facets again in 64-bit
    floats, padded with the last one.
    """

    normal: Float[Array, "F 3"]
    offset: Float[Array, "F"]
    core: Float[Array, "4 C"]
    table: Float[Array, "4 rows FAN"]


def half_spaces(
    normal: Float[np.ndarray, "F 3"], offset: Float[np.ndarray, "F"], vertices: Float[np.ndarray, "V 3"]
) -> HalfSpaces:
    """Return a convex set with F facets, and its core, as half-spaces; without a facet, the whole space.

    Args:
        normal: Unit outward normals of the facets.
        offset: Their offsets [m].
        vertices: Points of the set near its corners [m]; the core is the hull of some of them.
    """
    known = (_core(vertices) * CORE, np.column_stack([normal, offset])) if len(offset) else (EVERYWHERE, EVERYWHERE)
    core, facets = (
        with_repeated(each, padded_count(max(len(each), least))) for each, least in zip(known, LEAST, strict=True)
    )
    table = with_repeated(facets, -(-len(facets) // FAN) * FAN).T.reshape(4, -1, FAN)
    return jax.device_put(HalfSpaces(facets[:, :3], facets[:, 3], core.T.astype(np.float32), table))


@cached_by_values(4)
def _core(vertices: np.ndarray) -> Float[np.ndarray, "C 4"]:
    """Return the facets of the core: the hull of the outermost vertices along evenly spread directions."""
    k = np.arange(CORE_VERTICES) + 0.5
    z, turn = 1 - 2 * k / CORE_VERTICES, np.pi * (1 + 5**0.5) * k
    directions = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])
    outermost = np.unique(np.argmax((vertices - vertices.mean(axis=0)) @ directions, axis=0))
    try:
        return scipy.spatial.ConvexHull(vertices[outermost]).equations
    except scipy.spatial.QhullError:
        return np.array([[0.0, 0.0, 0.0, 1.0]])  # too thin for a core: the empty set


def crossed_facets(
    hull: HalfSpaces, points: Float[Array, "n 3"], requested: Bool[Array, "n"], enough: Float[ArrayLike, ""] = np.inf
) -> Int[Array, "n"]:
    """Return the facet that each point is furthest beyond; -1 for points inside the hull or not in `requested`.

    Args:
        hull: The hull, with at least one facet.
        points: The points [m].
        requested: True for the points to measure.
        enough: Height above a facet [m]: once a point is higher, other points may get -1.
    """
    return _crossed(hull, *jax.lax.stop_gradient((points, requested, jnp.asarray(enough, float))))


def depths(hull: HalfSpaces, points: Float[Array, "n 3"], requested: Bool[Array, "n"]) -> Float[Array, "n"]:
    """Return a lower bound on the depth [m] inside the hull of each point in `requested`; 0 if it may be outside."""
    return _depths(hull, *jax.lax.stop_gradient((points, requested)))


@one_by_one
def _crossed(hull: HalfSpaces, points, requested, enough):
    nothing = jnp.int32(-1)
    return _measured(
        hull, points, requested, lambda _: nothing, lambda at: jnp.where(at.height > 0, at.facet, -1), nothing, enough
    )


@one_by_one
def _depths(hull: HalfSpaces, points, requested):
    in_core = lambda height: -height.astype(float) - ROUNDING_M  # noqa: E731
    depth = _measured(hull, points, requested, in_core, lambda at: -at.height, jnp.zeros(()), jnp.inf)
    return jnp.maximum(depth, 0.0)


def _measured(hull: HalfSpaces, points, requested, in_core: Callable, beyond: Callable, nothing, enough):
    """Return in_core(height over the core) or, outside of it, beyond(highest facet); `nothing` if not requested.

    On a CPU, points that follow one higher than `enough` above a facet get `nothing`.
    """
    if backend().is_cpu:
        return _measured_in_turn(hull, points, requested, in_core, beyond, nothing, enough)
    core = jnp.max(jax.vmap(partial(_core_heights, hull))(points), axis=1)
    left = requested & (core > -ROUNDING_M)
    if backend().has_kernels:
        exact = _Highest(*highest(hull.table, points, left))
    else:
        exact = jax.vmap(partial(_highest_facet, hull))(points)
    return jnp.where(left, beyond(exact), jnp.where(requested, in_core(core), nothing))


def _measured_in_turn(hull: HalfSpaces, points, requested, in_core: Callable, beyond: Callable, nothing, enough):
    def measure(point):
        core = _core_heights(hull, point)
        is_outside = jnp.sum(core > -ROUNDING_M, dtype=jnp.int32) > 0  # takes a third of the time of `jnp.any`

        def outside():
            found = _highest_facet(hull, point)
            return beyond(found), found.height

        return jax.lax.cond(is_outside, outside, lambda: (in_core(jnp.max(core)), jnp.full((), -jnp.inf)))

    def step(state):
        k, _, results = state
        skipped = lambda _: (nothing, jnp.full((), -jnp.inf))  # noqa: E731
        value, height = jax.lax.cond(requested[k], measure, skipped, points[k])
        return k + 1, height > enough, results.at[k].set(value)

    start = jnp.int32(0), jnp.zeros((), bool), jnp.full(len(points), nothing)
    return jax.lax.while_loop(lambda state: (state[0] < len(points)) & ~state[1], step, start)[2]


class _Highest(NamedTuple):
    """The facet with the largest signed height of a point above it, and this height [m]."""

    facet: Int[Array, ""]
    height: Float[Array, ""]


def _highest_facet(hull: HalfSpaces, point) -> _Highest:
    row = jnp.argmax(jnp.max(_heights(hull.table, point), axis=1))
    heights = _heights(hull.table[:, row], point)
    facet = jnp.minimum(row * FAN + jnp.argmax(heights), hull.offset.shape[0] - 1)
    return _Highest(facet.astype(jnp.int32), jnp.max(heights))


def _heights(facets, point):
    return facets[0] * point[0] + facets[1] * point[1] + facets[2] * point[2] - facets[3]


def _core_heights(hull: HalfSpaces, point):
    """Return the heights (C,) of a point above each facet of the core [m], in 32-bit floats."""
    return _heights(hull.core, point.astype(jnp.float32))


def highest(
    table: Float[Array, "4 rows FAN"], points: Float[Array, "n 3"], left: Bool[Array, "n"]
) -> tuple[Int[Array, "n"], Float[Array, "n"]]:
    """Return the facet that each point in `left` is highest above (the first of several), and the height [m].

    Args:
        table: The facets: normal xyz, offset [m]; padded with the last facet.
        points: The points [m].
        left: True for the points to measure.
    """
    facets = table.reshape(4, -1)
    blocks = -(-facets.shape[1] // BLOCK)
    filled = jnp.pad(facets, ((0, 0), (0, blocks * BLOCK - facets.shape[1])), mode="edge")
    out = [jax.ShapeDtypeStruct(left.shape, dtype) for dtype in (jnp.int32, points.dtype)]
    own_blocks = jnp.where(left, jnp.int32(blocks), jnp.int32(0))
    return tuple(kernel(_height_kernel, out, len(left))(points, own_blocks, filled))


def _height_kernel(points, blocks, table, facet, height):
    from jax.experimental import pallas as pl

    k = instance()
    x, y, z = (points[k, i] for i in range(3))
    number = jax.lax.broadcasted_iota(jnp.int32, (BLOCK,), 0)

    def step(block, state):
        top, best = state
        a, b, c, offset = (table[i, pl.ds(block * BLOCK, BLOCK)] for i in range(4))
        here = a * x + b * y + c * z - offset
        return jnp.maximum(top, here), jnp.where(here > top, block * BLOCK + number, best)

    start = jnp.full(BLOCK, -jnp.inf, points.dtype), number
    top, best = jax.lax.fori_loop(0, blocks[k], step, start)
    height[k] = jnp.max(top)
    facet[k] = jnp.min(jnp.where(top == jnp.max(top), best, table.shape[1]))
