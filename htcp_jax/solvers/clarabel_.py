"""Clarabel, an interior point solver with infeasibility certificates, with one fixed sparsity pattern.

Building a solver and its sparse matrices takes longer than solving a QP. Therefore one solver is built for a fixed
first problem, and later problems only replace its numbers. Its tolerances are absolute, so it solves the QPs of
`step_qp.scaled`; joint limits, which are far compared with a step, otherwise cost iterations. Presolve and
equilibration are off, so a solution does not depend on earlier QPs: it is the same bit for bit in any order, in any
batch, on any thread.
"""

import clarabel
import numpy as np
from scipy import sparse

from htcp_jax.solvers.step_qp import QPSolution, QPStatus, StepQP, scaled

TIGHTEST = 1e-12  # smallest tolerance of Clarabel; 1e-14 is more than rounding allows in some QPs
_VERDICT = {
    clarabel.SolverStatus.Solved: QPStatus.SOLVED,
    clarabel.SolverStatus.AlmostSolved: QPStatus.SOLVED,
    clarabel.SolverStatus.PrimalInfeasible: QPStatus.INFEASIBLE,
    clarabel.SolverStatus.AlmostPrimalInfeasible: QPStatus.INFEASIBLE,
}


class ClarabelSolver:
    """Solver of step QPs, equation (9), in sequence on the caller's thread.

    Use one solver per thread: a solver is not thread-safe, as the GIL is released while a QP is solved.

    Args:
        P: Diagonal of the cost's matrix (N,); that of the QPs may have another unit.
        rows: Number of inequality rows, without the bounds.
        tolerance: Accuracy of the scaled QP; the power 1.5 of it is Clarabel's tolerance of residuals and gap.
        task_rows: Number of equality rows.
    """

    def __init__(self, P: np.ndarray, rows: int, tolerance: float = 1e-8, task_rows: int = 3):
        self._P, self._rows, self._task_rows = 2 * np.asarray(P, float) / np.max(P), rows, task_rows
        self._settings = clarabel.DefaultSettings()
        self._settings.verbose = False
        self._settings.presolve_enable = False
        self._settings.equilibrate_enable = False
        self._settings.max_threads = 1
        # With a gap of e a step may be off by sqrt(e) units: at margin 0 such a step would end in collision.
        for name in ("tol_gap_abs", "tol_gap_rel", "tol_feas"):
            setattr(self._settings, name, max(tolerance**1.5, TIGHTEST))
        self._solver = self.build()

    def build(self) -> clarabel.DefaultSolver:
        """Return a new solver of Clarabel with the fixed pattern."""
        n, m, rows = len(self._P), self._task_rows, self._rows
        identity = np.eye(n)
        pattern = sparse.csc_matrix(np.concatenate([np.ones((m + rows, n)), identity, -identity]))
        cones = [clarabel.ZeroConeT(m), clarabel.NonnegativeConeT(rows + 2 * n)]
        cost = sparse.csc_matrix(np.diag(self._P))
        bound = np.ones(m + rows + 2 * n)
        return clarabel.DefaultSolver(cost, np.zeros(n), pattern, bound, cones, self._settings)

    def solve(self, qps: StepQP) -> QPSolution:
        """Return the steps (B, N) and the status (B,) of every QP of a batch."""
        _, q, rows, bounds, size = scaled(qps)
        batch, n = q.shape
        dense = rows[:, : -2 * n].transpose(0, 2, 1)
        limits = rows[:, -2 * n :].reshape(batch, 2, n, n).diagonal(axis1=2, axis2=3).transpose(0, 2, 1)
        values = np.concatenate([dense, limits], axis=2).reshape(batch, -1)
        # As lists: Clarabel reads numbers one by one, and each number of an array would first be made an object.
        rows = zip(q.tolist(), values.tolist(), bounds.tolist(), strict=True)
        found = [self._solve_one(*row) for row in rows]
        y = size * np.array([step or [0.0] * n for step, _ in found]).reshape(batch, n)
        status = np.array([verdict for _, verdict in found], np.int32)
        lost = ~np.isfinite(y).all(axis=1)
        y[lost], status[lost] = 0.0, QPStatus.FAILED
        return QPSolution(y, status)

    def _solve_one(self, q: list, values: list, bounds: list) -> tuple[list | None, QPStatus]:
        try:
            self._solver.update(q=q, A=values, b=bounds)
            solution = self._solver.solve()
        except Exception:
            return None, QPStatus.FAILED
        except BaseException as panic:
            # A panic of the Rust core is not an Exception, and leaves the solver in an unknown state.
            if type(panic).__name__ != "PanicException":
                raise
            self._solver = self.build()
            return None, QPStatus.FAILED
        verdict = _VERDICT.get(solution.status, QPStatus.FAILED)
        return solution.x if verdict == QPStatus.SOLVED else None, verdict
