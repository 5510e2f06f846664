"""How a batch of lanes runs through a kernel.

`chunked` runs a kernel over a table of fixed capacity, a few lanes at a time and only as far as the table is filled:
one compiled program serves one lane and a thousand, and a lane's result does not depend on how many others there are.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

# Kernels that few lanes need at a time, or that have loops of their own to vectorise.
DEEP = ("enter", "walk", "ascend", "push", "check_path", "sample", "draw")
SAMPLED = ("sample", "draw")  # those with hundreds of configurations a lane


class Table(NamedTuple):
    """Size of the table that a program is compiled for, and how many of its lanes it computes side by side."""

    capacity: int
    width: int


def table_on(device: jax.Device, name: str) -> Table:
    """The table of kernel `name`, one for any number of lanes: another one would round in its own way. A CPU gains from
    a few lanes side by side, and nothing where a kernel has loops of its own; a GPU from thousands, fewer where each
    lane has hundreds of samples."""
    if device.platform == "cpu":
        return Table(128, 1 if name.startswith(DEEP) else 4)
    if name.startswith(SAMPLED):
        return Table(256, 32)
    return Table(2048, 512) if name.startswith(DEEP) else Table(4096, 4096)


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
