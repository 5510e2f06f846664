from . import cma_es, sphere, step_qp
from .active_set import solve_step
from .clarabel_ import ClarabelSolver
from .path_qp import PathQP, path_cost, solve_path_qp
from .qpsolvers_ import QPSolversSolver

__all__ = [
    "ClarabelSolver",
    "PathQP",
    "QPSolversSolver",
    "cma_es",
    "path_cost",
    "solve_path_qp",
    "solve_step",
    "sphere",
    "step_qp",
]
