"""The whole path at once: equation (3) about a path, as one sparse QP in the steps y_1 .. y_P of its postures.

    minimise    sum_i  w' (x_i + y_i - x_{i-1} - y_{i-1})^2          ||x||_Q^2 with Q = V' V; x_0 is held, y_0 = 0
    subject to  A_i y_i = 0         where a task is held: the posture stays on its target, to first order
                G_i y_i <= h_i      the clearance rows (CFS)
                |y_i| <= r_i        the trust region, inside the joint limits

With h >= 0 the step 0 is feasible, so the QP always has an answer.
"""

from functools import lru_cache
from typing import NamedTuple

import clarabel
import numpy as np
from jaxtyping import Bool, Float
from scipy import sparse


class PathQP(NamedTuple):
    """One path of P postures."""

    x: Float[np.ndarray, "P1 N"]  # the start, and the P postures [rad or m]
    weights: Float[np.ndarray, "N"]  # of the joints
    held: Bool[np.ndarray, "P"]  # which of them hold the task
    A: Float[np.ndarray, "P M N"]
    G: Float[np.ndarray, "P R N"]
    h: Float[np.ndarray, "P R"]  # [m]; infinite where there is no row
    lower: Float[np.ndarray, "P N"]  # of the steps
    upper: Float[np.ndarray, "P N"]


def path_cost(x: Float[np.ndarray, "P1 N"], weights: Float[np.ndarray, "N"]) -> float:
    """Equation (3) of a path [rad2]."""
    steps = np.diff(x, axis=0)
    return float((steps * steps * weights).sum())


def solve_path_qp(qp: PathQP) -> Float[np.ndarray, "P N"]:
    """The steps; zeros where the solver breaks down."""
    count, joints = qp.lower.shape
    second = _second_difference(count)
    cost = sparse.kron(2 * second, sparse.diags(qp.weights), format="csc")
    pull = 2 * _differences(count).T @ (np.diff(qp.x, axis=0) * qp.weights)
    # A row that no step within the trust region breaks is left out.
    most = np.maximum(np.abs(qp.lower), np.abs(qp.upper))
    near = qp.h < np.einsum("prn,pn->pr", np.abs(qp.G), most)
    held = np.flatnonzero(qp.held)
    posture, _ = np.nonzero(near)
    rows = [
        _rows(np.repeat(held, qp.A.shape[1]), qp.A[held].reshape(-1, joints), count),
        _rows(posture, qp.G[near], count),
        sparse.identity(count * joints, format="csc"),
        -sparse.identity(count * joints, format="csc"),
    ]
    bound = np.concatenate([np.zeros(rows[0].shape[0]), qp.h[near], qp.upper.ravel(), -qp.lower.ravel()])
    equal = rows[0].shape[0]
    cones = [clarabel.ZeroConeT(equal), clarabel.NonnegativeConeT(len(bound) - equal)]
    solver = clarabel.DefaultSolver(
        sparse.triu(cost, format="csc"), pull.ravel(), sparse.vstack(rows, format="csc"), bound, cones, _options()
    )
    solution = solver.solve()
    y = np.asarray(solution.x).reshape(count, joints)
    solved = str(solution.status) in ("Solved", "AlmostSolved") and np.isfinite(y).all()
    return np.clip(y, qp.lower, qp.upper) if solved else np.zeros((count, joints))


def _rows(posture, coefficients, count) -> sparse.csc_matrix:
    """Rows of the constraint matrix: each has the coefficients of one posture's step."""
    joints = coefficients.shape[1]
    row = np.repeat(np.arange(len(posture)), joints)
    column = (posture[:, None] * joints + np.arange(joints)).ravel()
    return sparse.csc_matrix((coefficients.ravel(), (row, column)), shape=(len(posture), count * joints))


@lru_cache(maxsize=64)
def _differences(count: int) -> sparse.csr_matrix:
    """V, with the start left out: row i takes y_{i-1} from y_i."""
    return sparse.diags([np.ones(count), -np.ones(count - 1)], [0, -1], format="csr")


@lru_cache(maxsize=64)
def _second_difference(count: int) -> sparse.csr_matrix:
    return (_differences(count).T @ _differences(count)).tocsr()


def _options() -> clarabel.DefaultSettings:
    options = clarabel.DefaultSettings()
    options.verbose, options.max_threads = False, 1
    return options
