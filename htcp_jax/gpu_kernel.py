"""GPU kernels in Pallas, in place of XLA loops, whose every iteration costs several launches.

They are written in Pallas for its Triton backend; with `interpret` they run on any machine.
"""

from collections.abc import Callable

from jax.experimental import pallas as pl

try:
    from jax.experimental.pallas import triton
except ImportError:  # JAX means to take it out
    triton = None

HAS_KERNEL = triton is not None


def kernel(program: Callable, out, programs: int, interpret: bool, warps: int = 1) -> Callable:
    """Return a function that maps arrays to arrays of the shapes `out`, computed by `programs` instances of
    `program`."""
    return pl.pallas_call(
        program,
        out_shape=out,
        grid=(programs,),
        compiler_params=triton.CompilerParams(num_warps=warps),
        interpret=interpret,
    )
