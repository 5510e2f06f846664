"""What a kernel is: a function of one lane, the table that it is compiled for, and the settings that it reads.

`chunked` runs it over a table of fixed capacity, a few lanes at a time and only as far as the table is filled: one
compiled program serves one lane and a thousand, and a lane's result does not depend on how many others there are.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.settings import Settings

_SETTINGS = frozenset(field.name for field in fields(Settings))


class Table(NamedTuple):
    """Size of the table that a program is compiled for, and how many of its lanes it computes side by side."""

    capacity: int
    width: int


class Load(NamedTuple):
    """The tables of a kind of kernels, one for any number of lanes: another one would round in its own way. A CPU gains
    nothing from lanes side by side; a GPU from thousands, fewer where each lane has hundreds of samples."""

    cpu: Table
    gpu: Table

    def on(self, device: jax.Device) -> Table:
        """The table on that device."""
        return self.cpu if device.platform == "cpu" else self.gpu


ALONE = Table(128, 1)
STEP = Load(cpu=ALONE, gpu=Table(4096, 4096))  # what every lane needs all the time
DEEP = Load(cpu=ALONE, gpu=Table(2048, 512))  # what few lanes need, or what has loops of its own to vectorise
SAMPLED = Load(cpu=ALONE, gpu=Table(256, 128))  # with hundreds of configurations a lane


@dataclass(frozen=True)
class Kernel:
    """A function of one lane, function(*parts, settings, scene, lane, ...), and what is compiled for it.

    settings: names of those that it reads. Programs are compiled for their values alone, so that another seed, say,
    compiles nothing. A setting that is read and not named is an AttributeError when the kernel is compiled.
    """

    name: str
    function: Callable
    load: Load
    settings: tuple[str, ...] = ()
    parts: tuple = ()  # hashable; what tells this kernel from others of the same function

    def values(self, settings: Settings) -> tuple:
        """Of the settings that it reads."""
        return tuple(getattr(settings, name) for name in self.settings)

    def of(self, settings: Settings) -> Callable:
        """The function with its parts and settings: of (scene, lane, ...)."""
        return partial(self.function, *self.parts, _NamedSettings.of(settings, self))


class _NamedSettings(Settings):
    """The settings that a kernel names, and no others."""

    @classmethod
    def of(cls, settings: Settings, kernel: Kernel) -> "_NamedSettings":
        own = object.__new__(cls)  # the values were checked when the settings were made
        vars(own).update({name: getattr(settings, name) for name in kernel.settings}, kernel=kernel.name)
        return own

    def __getattribute__(self, name: str) -> Any:
        if name in _SETTINGS and name not in object.__getattribute__(self, "__dict__"):
            raise AttributeError(f"kernel {self.kernel!r} reads the setting {name}, which it does not name")
        return super().__getattribute__(name)


def chunked(kernel: Callable, width: int) -> Callable:
    """`kernel(scene, *one lane)` over tables with a leading axis of capacity C: run(scene, chunks, *tables) computes
    the first chunks x width lanes; the rest of the result is zeros. One lane at a time is not batched: loops then ask
    for no lane but their own, and the program is a fifth shorter."""

    @jax.jit  # so that Python traces it once, for the shapes of its results as for the loop
    def one_chunk(scene, tables, start):
        if width == 1:
            lane = jax.tree.map(lambda t: jax.lax.dynamic_index_in_dim(t, start, keepdims=False), tables)
            return jax.tree.map(lambda r: jnp.asarray(r)[None], kernel(scene, *lane))
        part = jax.tree.map(lambda t: jax.lax.dynamic_slice_in_dim(t, start, width), tables)
        return jax.vmap(partial(kernel, scene))(*part)

    def run(scene, chunks, *tables):
        def body(i, results):
            start = i * width
            return jax.tree.map(
                lambda all_, part: jax.lax.dynamic_update_slice_in_dim(all_, part, start, 0),
                results,
                one_chunk(scene, tables, start),
            )

        capacity = jax.tree.leaves(tables)[0].shape[0]
        if width == capacity:
            return one_chunk(scene, tables, 0)
        shapes = jax.eval_shape(one_chunk, scene, tables, chunks)
        empty = jax.tree.map(lambda s: jnp.zeros((capacity, *s.shape[1:]), s.dtype), shapes)
        return jax.lax.fori_loop(0, chunks, body, empty)

    return jax.jit(run)
