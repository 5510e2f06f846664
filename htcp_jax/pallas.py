"""GPU kernels in Pallas, in place of XLA loops, whose every iteration costs several launches.

They are written in Pallas for its Triton backend; with `interpret` they run on any machine.
"""

from collections.abc import Callable

from jax.experimental import pallas as pl

try:
    from jax.experimental.pallas import triton
except ImportError:  # JAX plans to remove it
    triton = None

HAS_KERNEL = triton is not None


def kernel(program: Callable, out, programs: int, interpret: bool, warps: int = 1) -> Callable:
    """Return a function that computes arrays by a Pallas kernel.

    Args:
        program: Body of the kernel, called with references to the inputs and outputs.
        out (list): Shapes and types of the outputs, in any pytree.
        programs: Number of instances of `program`, the size of the grid.
        interpret: True: run in Pallas' interpreter, on any machine.
        warps: Warps per instance.
    """
    return pl.pallas_call(
        program,
        out_shape=out,
        grid=(programs,),
        compiler_params=triton.CompilerParams(num_warps=warps),
        interpret=interpret,
    )
