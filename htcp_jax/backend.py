"""`Backend`: the kind of device that a function is compiled for; the mathematics choose their variants by it.

`device.executor` binds it around every trace. It is a user context of JAX, which is part of the keys of all caches of
traced and compiled functions, nested ones included: a variant for one device is never used on another. It is read at
trace time only and costs nothing when a compiled function runs. A function called directly, outside of a plan, is
compiled for JAX's default device.
"""

from contextlib import AbstractContextManager
from functools import cache
from types import ModuleType
from typing import NamedTuple

import jax


@cache
def triton() -> ModuleType | None:
    """Return Pallas' Triton backend, imported when a GPU needs it; None if this JAX has none."""
    try:
        from jax.experimental.pallas import triton
    except ImportError:  # JAX plans to remove it
        return None
    return triton


class Backend(NamedTuple):
    """Kind of device that a function is compiled for."""

    platform: str  # of JAX: "cpu", "gpu", ...
    has_kernels: bool = False  # True if it runs the kernels of `pallas`
    interprets: bool = False  # True: these run in Pallas' interpreter, on any machine

    @classmethod
    def of(cls, platform: str) -> "Backend":
        """Return the backend for a platform of JAX."""
        return cls(platform, platform == "gpu" and triton() is not None)

    @property
    def is_cpu(self) -> bool:
        """True for a CPU, where loops cost little and lanes side by side gain nothing."""
        return self.platform == "cpu"


_BOUND = jax.make_user_context(None)


def compiled_for(backend: Backend) -> AbstractContextManager[None]:
    """Return a context in which this thread traces functions for a backend."""
    # so that traces for the default device are shared
    return _BOUND(None if backend == _default_backend() else backend)


def backend() -> Backend:
    """Return the backend that functions are traced for in this thread."""
    return _BOUND.value or _default_backend()


def _default_backend() -> Backend:
    return Backend.of(default_device().platform)


def default_device() -> jax.Device:
    """Return JAX's default device in this thread, another part of the keys of its caches."""
    device = jax.config.jax_default_device
    return device if isinstance(device, jax.Device) else jax.local_devices(backend=device)[0]
