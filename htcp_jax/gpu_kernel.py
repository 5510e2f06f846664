"""GPU kernels of our own, for what XLA would make loops of: every turn of such a loop is some launches.

They are written in Pallas for its Triton backend; with `interpret` they run on any machine.
"""

from collections.abc import Callable

import jax
from jax.experimental import pallas as pl

try:
    from jax.experimental.pallas import triton
except ImportError:  # JAX means to take it out
    triton = None

HAS_KERNEL = triton is not None


def has_gpu() -> bool:
    """Whether there is one that runs such kernels."""
    return jax.default_backend() == "gpu" and HAS_KERNEL


def kernel(program: Callable, out, programs: int, interpret: bool, warps: int = 1) -> Callable:
    """A function of tables that so many programs fill other ones by, of the shapes `out`."""
    return pl.pallas_call(
        program,
        out_shape=out,
        grid=(programs,),
        compiler_params=triton.CompilerParams(num_warps=warps),
        interpret=interpret,
    )
