"""Clarabel, an interior point solver with infeasibility certificates, with one fixed sparsity pattern.

Building a solver and its sparse matrices takes longer than solving a QP. Therefore one solver is built for a fixed
first problem, and later problems only replace its numbers. Presolve and equilibration are off, so a solution does not
depend on earlier QPs: it is the same bit for bit in any order, in any batch, on any thread.
"""

import clarabel
import numpy as np
from scipy import sparse

from htcp_jax.solvers.step_qp import QPSolution, QPStatus, StepQP

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
        P: Diagonal of the cost's matrix (N,).
        rows: Number of inequality rows, without the bounds.
        tolerance: Clarabel's tolerance of the residuals and the duality gap.
        task_rows: Number of equality rows.
    """

    def __init__(self, P: np.ndarray, rows: int, tolerance: float = 1e-8, task_rows: int = 3):
        self._P, self._rows, self._task_rows = np.asarray(P, float), rows, task_rows
        self._settings = clarabel.DefaultSettings()
        self._settings.verbose = False
        self._settings.presolve_enable = False
        self._settings.equilibrate_enable = False
        self._settings.max_threads = 1
        for name in ("tol_gap_abs", "tol_gap_rel", "tol_feas"):
            setattr(self._settings, name, tolerance)
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
        # Clarabel takes no infinite bounds: rows of infinitely far obstacles and of missing limits become 0 y <= 1.
        far = np.isposinf(qps.h) & np.isfinite(qps.G).all(axis=2)
        G, h = np.where(far[:, :, None], 0.0, qps.G), np.where(far, 1.0, qps.h)
        columns = np.concatenate([qps.A, G], axis=1).transpose(0, 2, 1)
        batch, n = qps.q.shape
        limits = np.stack([qps.ub, -qps.lb], axis=2)
        free = np.isposinf(limits)
        signs = np.where(free, 0.0, np.array([1.0, -1.0]))
        limits = np.where(free, 1.0, limits).transpose(0, 2, 1).reshape(batch, -1)
        values = np.concatenate([columns, signs], axis=2).reshape(batch, -1)
        bounds = np.concatenate([qps.b, h, limits], axis=1)
        # As lists: Clarabel reads numbers one by one, and each number of an array would first be made an object.
        rows = zip(qps.q.tolist(), values.tolist(), bounds.tolist(), strict=True)
        found = [self._solve_one(*row) for row in rows]
        y = np.array([step or [0.0] * n for step, _ in found]).reshape(batch, n)
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
