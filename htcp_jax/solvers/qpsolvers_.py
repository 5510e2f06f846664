"""Any solver of the library qpsolvers, one QP at a time: for tests, and to try other solvers."""

import contextlib
import ctypes
import functools
import os
import threading
import warnings
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import qpsolvers
from scipy.sparse import csc_matrix

from htcp_jax.errors import InputError
from htcp_jax.solvers.step_qp import QPSolution, QPStatus, StepQP
from htcp_jax.types import Float

TRIAL_ERROR = 1e-3  # largest error of a usable solver in the trial QP, relative to the step
OPTIONS: dict[str, dict[str, float]] = {
    "osqp": {"eps_abs": 1e-7, "eps_rel": 1e-7},  # by default 1e-3
    "qpalm": {"eps_abs": 1e-7, "eps_rel": 1e-7},  # by default 1e-4
    "ecos": {"abstol": 5e-7, "reltol": 5e-7},  # by default 1e-8, which it often misses, and then finds no solution
}
SHORTEST, LONGEST = 2.0**-20, 1.0  # shorter and longer steps are scaled like these [rad or m]
UNIT = 0.25  # length of a unit relative to the step
_ONE_AT_A_TIME = threading.Lock()  # standard output belongs to the process


class ScaledQP(NamedTuple):
    """A batch of B step QPs, scaled for solvers on the host, with the step y = size * u.

    minimise 1/2 u' diag(P) u + q' u with M equations, rows @ u = bound, and inequalities, rows @ u <= bound.
    """

    P: Float[np.ndarray, "B N"]  # the largest entry is 2
    q: Float[np.ndarray, "B N"]
    rows: Float[np.ndarray, "B S N"]  # A, then G, upper limits and lower limits; zeros if there is no bound
    bound: Float[np.ndarray, "B S"]  # of inequalities less than 2
    size: Float[np.ndarray, "B 1"]  # length of a unit, a power of two [rad or m]


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
        problems = _scaled(qps)
        with _quiet():
            for k in range(len(y)):
                one = ScaledQP(*(field[k] for field in problems))
                if not all(np.isfinite(field).all() for field in one):
                    continue  # status FAILED; some solvers would return numbers
                if _stays(one, qps.b.shape[1]):
                    status[k] = QPStatus.SOLVED
                    continue
                try:
                    u = _solve(self._name, one, qps.b.shape[1])
                except Exception:  # each back end has its own exceptions
                    continue
                if u is None:
                    status[k] = QPStatus.INFEASIBLE
                elif np.isfinite(u).all():
                    y[k], status[k] = one.size * u, QPStatus.SOLVED
        return QPSolution(y, status)


def _stays(qp: ScaledQP, equations: int) -> bool:
    """Return True if no step is the solution. ECOS 2.0.14 calls its solutions of such problems inaccurate."""
    return not qp.q.any() and not qp.bound[:equations].any() and bool((qp.bound[equations:] >= 0).all())


def _solve(name: str, qp: ScaledQP, equations: int) -> np.ndarray | None:
    """Return the solution of one scaled QP; None if the solver finds none."""
    (A, G), (b, h) = np.split(qp.rows, [equations]), np.split(qp.bound, [equations])
    bounded = G.any(axis=1) | (h < 0)  # back ends differ in the treatment of infinite bounds
    is_sparse = name in qpsolvers.sparse_solvers and name not in qpsolvers.dense_solvers
    matrix = csc_matrix if is_sparse else np.asarray
    problem = qpsolvers.Problem(matrix(np.diag(qp.P)), qp.q, matrix(G[bounded]), h[bounded], matrix(A), b)
    solution = qpsolvers.solve_problem(problem, solver=name, **OPTIONS.get(name, {}))
    return solution.x if solution.found else None


def _scaled(qps: StepQP) -> ScaledQP:
    """Return a batch of step QPs with weights, steps and bounds of about 1.

    The results are bitwise the same in any batch.

    Args:
        qps: Numpy arrays with a leading axis B.
    """
    (batch, n), equations = qps.q.shape, qps.b.shape[1]
    eye = np.broadcast_to(np.eye(n), (batch, n, n))
    rows = np.concatenate([qps.A, qps.G, eye, -eye], axis=1)
    bound = np.concatenate([qps.b, qps.h, qps.ub, -qps.lb], axis=1)

    # The longest step that the cost or one constraint alone requires
    required = np.concatenate([np.abs(qps.q), np.abs(qps.b), -bound[:, equations:]], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        required /= np.concatenate([qps.P, np.abs(rows).max(axis=2)], axis=1)
    longest = np.fmax.reduce(required, axis=1, keepdims=True)
    size = UNIT * _power_of_two(np.fmin(np.fmax(longest, SHORTEST), LONGEST))

    bound /= size
    limited = bound[:, equations:]
    far = np.isposinf(limited)
    share = 2 / _power_of_two(np.where(far, 1.0, np.maximum(limited, 1.0)))
    limited[...] = np.where(far, 1.0, share * limited)
    rows[:, equations:] *= np.where(far, 0.0, share)[:, :, None]
    per_weight = 2 / qps.P.max(axis=1, keepdims=True)
    return ScaledQP(per_weight * qps.P, per_weight * qps.q / size, rows, bound, size)


def _power_of_two(value: np.ndarray) -> np.ndarray:
    """Return powers of two, larger than positive values by a factor of at most two."""
    return np.ldexp(1.0, np.frexp(value)[1])


@functools.cache
def _fault(name: str) -> str | None:
    """Return why a back end does not solve a QP with a known solution; None if it does.

    A joint has no limits, and a body hardly moves, as a base does: qtqp 0.0.7 divides by such a row.
    """
    rng = np.random.default_rng(0)
    P, A, G = np.arange(1.0, 7.0), rng.normal(size=(3, 6)), rng.normal(size=(3, 6))
    G[2] = [1e-18, 0, 0, 0, 0, 0]
    y = 1e-3 * (rng.normal(size=3) @ A - G[0]) / P  # stationary, with multiplier 1e-3 of the active row G[0]
    limit = np.array([np.inf, 3, 3, 3, 3, 3])
    trial = StepQP(P, np.zeros(6), A, A @ y, G, G @ y + [0.0, 0.1, 0.1], -limit, limit)
    one = ScaledQP(*(field[0] for field in _scaled(StepQP(*(field[None] for field in trial)))))
    with _quiet(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the trial's result is the message
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
