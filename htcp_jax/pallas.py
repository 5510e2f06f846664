"""GPU kernels in Pallas, in place of XLA loops, whose every iteration costs several launches.

They are written in Pallas for its Triton backend; where `Backend.interprets` is set they run on any machine.
"""

from collections.abc import Callable

from jax.experimental import pallas as pl

from htcp_jax.backend import backend, triton


def kernel(program: Callable, out, programs: int, warps: int = 1) -> Callable:
    """Return a function that computes arrays by a Pallas kernel.

    Args:
        program: Body of the kernel, called with references to the inputs and outputs.
        out (list): Shapes and types of the outputs, in any pytree.
        programs: Number of instances of `program`, the size of the grid.
        warps: Warps per instance.
    """
    return pl.pallas_call(
        program,
        out_shape=out,
        grid=(programs,),
        compiler_params=triton().CompilerParams(num_warps=warps),
        interpret=backend().interprets,
    )
