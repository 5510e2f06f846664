"""`Backend`: the kind of device that a function is compiled for. Some functions have a variant for each kind.

`device.executor` sets the backend before it traces a function. The backend is stored in a user context of JAX. This
context is part of the keys of all caches of traced and compiled functions, including nested ones. A variant for one
device is therefore never used on another. The backend is read at trace time only, so it costs nothing when a compiled
function runs. A function that is called directly, outside of a plan, is compiled for JAX's default device.

GPU kernels are written in Pallas, for its Triton backend. They replace XLA loops, whose every iteration costs several
launches. If `Backend.interprets` is True, they run in an interpreter, on any machine.
"""

import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import cache
from types import ModuleType
from typing import NamedTuple

import jax

from htcp_jax.errors import InputError


@cache
def triton() -> ModuleType | None:
    """Return the module of Pallas' Triton backend; None if this JAX version does not contain it."""
    try:
        from jax.experimental.pallas import triton
    except ImportError:  # JAX plans to remove the module
        return None
    return triton


class Backend(NamedTuple):
    """Kind of device that a function is compiled for."""

    platform: str  # JAX's name: "cpu", "gpu", ...
    has_kernels: bool = False  # True if the device can run the kernels, see `kernel`
    interprets: bool = False  # True if the kernels run in Pallas' interpreter, which works on any machine

    @classmethod
    def of(cls, platform: str) -> "Backend":
        """Return the backend for a platform of JAX, such as "cpu" or "gpu"."""
        return cls(platform, platform == "gpu" and triton() is not None)

    @property
    def is_cpu(self) -> bool:
        """True for a CPU, where loops are cheap and vectorising over lanes gains nothing."""
        return self.platform == "cpu"


PLATFORMS = "JAX_PLATFORMS"  # environment variable: the platforms that JAX may use


def check_platforms() -> None:
    """Check that JAX finds a device on the platforms in the environment variable JAX_PLATFORMS, if it is set.

    Raises:
        InputError: If there is none.
    """
    if requested := os.environ.get(PLATFORMS):
        try:
            jax.devices()
        except (AssertionError, RuntimeError):  # AssertionError: of some versions of JAX
            raise InputError(
                f"{PLATFORMS}={requested}: JAX finds no such device on this machine; valid: cpu, or unset the variable"
            ) from None


_BOUND = jax.make_user_context(None)


def compiled_for(backend: Backend) -> AbstractContextManager[None]:
    """Return a context in which this thread traces functions for a backend."""
    # None for the default device: direct calls and plans then share their traces
    return _BOUND(None if backend == _default_backend() else backend)


def backend() -> Backend:
    """Return the backend that functions are traced for in this thread."""
    return _BOUND.value or _default_backend()


def _default_backend() -> Backend:
    return Backend.of(default_device().platform)


def default_device() -> jax.Device:
    """Return JAX's default device in this thread, which is also part of the keys of JAX's caches."""
    device = jax.config.jax_default_device
    return device if isinstance(device, jax.Device) else jax.local_devices(backend=device)[0]


def instance() -> jax.Array:
    """Return the index of the running instance of a kernel."""
    from jax.experimental import pallas as pl

    return pl.program_id(0)


def kernel(program: Callable, out, programs: int, warps: int = 1) -> Callable:
    """Return a function of arrays that runs a Pallas kernel.

    Args:
        program: Body of the kernel, called with references to the inputs and outputs.
        out (list): Pytree with the shapes and types of the outputs.
        programs: Number of instances of `program`, the size of the grid.
        warps: Warps per instance.
    """
    from jax.experimental import pallas as pl  # here, as the import is slow and only GPUs need it

    return pl.pallas_call(
        program,
        out_shape=out,
        grid=(programs,),
        compiler_params=triton().CompilerParams(num_warps=warps),
        interpret=backend().interprets,
    )
