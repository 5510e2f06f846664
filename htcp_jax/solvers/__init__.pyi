from . import active_set, cma_es, path_qp, sphere, step_qp
from .clarabel_ import ClarabelSolver
from .qpsolvers_ import QPSolversSolver

__all__ = [
    "ClarabelSolver",
    "QPSolversSolver",
    "active_set",
    "cma_es",
    "path_qp",
    "sphere",
    "step_qp",
]
