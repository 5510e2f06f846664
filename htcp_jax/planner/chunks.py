"""How a batch of lanes runs through a kernel.

`chunked` runs a kernel over a table of fixed capacity, a few lanes at a time and only as far as the table is filled:
one compiled program serves one lane and a thousand, and a lane's result does not depend on how many others there are.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp


def chunked(kernel: Callable, width: int) -> Callable:
    """`kernel(scene, *one lane)` over tables with a leading axis of capacity C: run(scene, chunks, *tables) computes
    the first chunks x width lanes; the rest of the result is zeros."""

    def run(scene, chunks, *tables):
        def one_chunk(start):
            part = jax.tree.map(lambda t: jax.lax.dynamic_slice_in_dim(t, start, width), tables)
            return jax.vmap(partial(kernel, scene))(*part)

        def body(i, results):
            start = i * width
            return jax.tree.map(
                lambda all_, part: jax.lax.dynamic_update_slice_in_dim(all_, part, start, 0), results, one_chunk(start)
            )

        capacity = jax.tree.leaves(tables)[0].shape[0]
        if width == capacity:
            return one_chunk(0)
        shapes = jax.eval_shape(one_chunk, 0)
        empty = jax.tree.map(lambda s: jnp.zeros((capacity, *s.shape[1:]), s.dtype), shapes)
        return jax.lax.fori_loop(0, chunks, body, empty)

    return jax.jit(run)
