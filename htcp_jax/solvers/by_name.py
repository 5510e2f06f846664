"""The step QP's solvers by name."""

from collections.abc import Callable

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.settings import Settings
from htcp_jax.solvers.clarabel_ import ClarabelSolver
from htcp_jax.solvers.qpsolvers_ import QPSolversSolver
from htcp_jax.solvers.step_qp import QPSolver


def make_solver(settings: Settings, joints: int, rows: int, task_rows: int = 3) -> QPSolver | None:
    """The solver that `settings.qp` names; None for the one on the device, which the kernels call themselves. Raises
    InputError for a name that is not installed."""
    if settings.qp == "device":
        return None
    name, _, backend = settings.qp.partition(":")
    makers: dict[str, Callable[[], QPSolver]] = {
        "clarabel": lambda: ClarabelSolver(2 * np.asarray(settings.q_weights), rows, settings.qp_tolerance, task_rows),
        "qpsolvers": lambda: QPSolversSolver(backend),
    }
    if name not in makers:
        raise InputError(f"qp is {settings.qp!r}; valid: clarabel, device, qpsolvers:<name of a solver>")
    return makers[name]()
