"""Any solver of the library qpsolvers, one QP at a time: for tests, and to try other solvers."""

import numpy as np
import qpsolvers

from htcp_jax.errors import InputError
from htcp_jax.solvers.step_qp import QPSolution, QPStatus, StepQP


class QPSolversSolver:
    """Solver of step QPs by `qpsolvers.solve_problem`.

    qpsolvers does not distinguish an infeasible problem from a failure to converge: in both cases the status is
    INFEASIBLE, unless the solver raised an exception or returned NaN.

    Args:
        name: The solver's name in qpsolvers.

    Raises:
        InputError: If the solver is not installed.
    """

    def __init__(self, name: str):
        if name not in qpsolvers.available_solvers:
            raise InputError(f"qp solver {name!r} is not installed; valid: {', '.join(qpsolvers.available_solvers)}")
        self._name = name

    def solve(self, qps: StepQP) -> QPSolution:
        """Return the steps (B, N) and the status (B,) of every QP of a batch."""
        y = np.zeros(qps.q.shape)
        status = np.full(len(y), QPStatus.FAILED, np.int32)
        for k in range(len(y)):
            one = StepQP(*(np.asarray(field[k]) for field in qps))
            limits = np.stack([one.lb, one.ub])
            rest = one.P, one.q, one.A, one.b, one.G, one.h
            if not all(np.isfinite(field).all() for field in rest) or np.isnan(limits).any():
                continue  # status FAILED; some solvers would return numbers
            cost = np.diag(one.P)
            # clarabel, scs, highs and others need sparse matrices, quadprog needs dense ones; qpsolvers converts
            problem = qpsolvers.Problem(cost, one.q, one.G, one.h, one.A, one.b, one.lb, one.ub)
            try:
                solution = qpsolvers.solve_problem(problem, solver=self._name)
            except (qpsolvers.SolverError, ValueError, ArithmeticError):
                continue
            if not solution.found:
                status[k] = QPStatus.INFEASIBLE
            elif np.isfinite(solution.x).all():
                y[k], status[k] = solution.x, QPStatus.SOLVED
        return QPSolution(y, status)
