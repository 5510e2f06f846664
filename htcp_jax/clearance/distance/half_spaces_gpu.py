"""GPU kernel that finds the facet of a hull that a point is highest above.

It has one instance per point, which returns at once if the point need not be measured.
"""

import jax
import jax.numpy as jnp

from htcp_jax.pallas import instance, kernel
from htcp_jax.types import Array, Bool, Float, Int

BLOCK = 256  # facets per block


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
