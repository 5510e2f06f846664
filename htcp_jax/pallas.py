"""GPU kernels in Pallas. They replace XLA loops, whose every iteration costs several launches.

The kernels use Pallas' Triton backend. If `Backend.interprets` is True, they run in an interpreter, on any machine.
"""

from collections.abc import Callable

import jax

from htcp_jax.backend import backend, triton


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
