"""Any solver of the library qpsolvers, one QP at a time: for tests, and to try other solvers."""

import contextlib
import ctypes
import functools
import os
import threading
from collections.abc import Iterator

import numpy as np
import qpsolvers

from htcp_jax.errors import InputError
from htcp_jax.solvers.step_qp import QPSolution, QPStatus, ScaledQP, StepQP, scaled

TRIAL_ERROR = 1e-3  # largest error of a usable solver in the trial QP, relative to the step
OPTIONS = {name: {"eps_abs": 1e-7, "eps_rel": 1e-7} for name in ("osqp", "qpalm")}  # by default 1e-3 and 1e-4
_ONE_AT_A_TIME = threading.Lock()  # standard output belongs to the process


class QPSolversSolver:
    """Solver of step QPs by `qpsolvers.solve_problem`.

    qpsolvers does not distinguish an infeasible problem from a failure to converge: in both cases the status is
    INFEASIBLE, unless the solver raised an exception or returned NaN.

    Args:
        name: The solver's name in qpsolvers.

    Raises:
        InputError: If the solver is not installed, or does not solve a QP with a known solution, such as one
            without a licence.
    """

    def __init__(self, name: str):
        if name not in qpsolvers.available_solvers:
            raise InputError(f"qp solver {name!r} is not installed; valid: {', '.join(qpsolvers.available_solvers)}")
        if fault := _fault(name):
            raise InputError(f"qp solver {name!r} is not usable: {fault}; valid: clarabel, device")
        self._name = name

    def solve(self, qps: StepQP) -> QPSolution:
        """Return the steps (B, N) and the status (B,) of every QP of a batch."""
        y = np.zeros(qps.q.shape)
        status = np.full(len(y), QPStatus.FAILED, np.int32)
        problems = scaled(qps)
        with _quiet():
            for k in range(len(y)):
                one = ScaledQP(*(field[k] for field in problems))
                if not all(np.isfinite(field).all() for field in one):
                    continue  # status FAILED; some solvers would return numbers
                try:
                    u = _solve(self._name, one, qps.b.shape[1])
                except Exception:  # each back end has its own exceptions
                    continue
                if u is None:
                    status[k] = QPStatus.INFEASIBLE
                elif np.isfinite(u).all():
                    y[k], status[k] = one.size * u, QPStatus.SOLVED
        return QPSolution(y, status)


def _solve(name: str, qp: ScaledQP, equations: int) -> np.ndarray | None:
    """Return the solution of one scaled QP; None if the solver finds none."""
    (A, G), (b, h) = np.split(qp.rows, [equations]), np.split(qp.bound, [equations])
    bounded = G.any(axis=1) | (h < 0)  # back ends differ in the treatment of infinite bounds
    # clarabel, scs, highs and others need sparse matrices, quadprog needs dense ones; qpsolvers converts
    problem = qpsolvers.Problem(np.diag(qp.P), qp.q, G[bounded], h[bounded], A, b)
    solution = qpsolvers.solve_problem(problem, solver=name, **OPTIONS.get(name, {}))
    return solution.x if solution.found else None


@functools.cache
def _fault(name: str) -> str | None:
    """Return why a back end does not solve a QP with a known solution, with a joint without limits; None if it does."""
    rng = np.random.default_rng(0)
    P, A, G = np.arange(1.0, 7.0), rng.normal(size=(3, 6)), rng.normal(size=(2, 6))
    y = 1e-3 * (rng.normal(size=3) @ A - G[0]) / P  # stationary, with multiplier 1e-3 of the active row G[0]
    limit = np.array([np.inf, 3, 3, 3, 3, 3])
    trial = StepQP(P, np.zeros(6), A, A @ y, G, G @ y + [0.0, 0.1], -limit, limit)
    one = ScaledQP(*(field[0] for field in scaled(StepQP(*(field[None] for field in trial)))))
    with _quiet():
        try:
            u = _solve(name, one, 3)
        except Exception as error:
            return " ".join(f"{type(error).__name__}: {error}".split())[:200]
    if u is None or not np.abs(one.size * u - y).max() <= TRIAL_ERROR * np.abs(y).max():
        return "it does not solve a trial QP"
    return None


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Move what libraries print, such as banners, from standard output, which may carry JSON, to standard error."""
    with _ONE_AT_A_TIME:
        flush = ctypes.CDLL(None).fflush
        flush(None)
        kept = os.dup(1)
        try:
            os.dup2(2, 1)
            yield
        finally:
            flush(None)
            os.dup2(kept, 1)
            os.close(kept)
