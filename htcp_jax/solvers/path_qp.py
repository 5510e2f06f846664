"""Smoothing QP: equation (3) about a path, as one sparse QP in the steps y_1 .. y_P of all of its configurations.

    minimise    sum_i  w' (x_i + y_i - x_{i-1} - y_{i-1})^2      ||x||_Q^2 with Q = V' V; x_0 is fixed, y_0 = 0
    subject to  A_i y_i = 0                        where the task is required: it stays satisfied, to first order
                G_i y_i <= h_i                     the clearance rows (8) of a configuration,
                C_i (y_{i-1} + y_i) / 2 <= c_i     and those half way to it
                lower_i <= y_i <= upper_i          the trust region, inside the joint limits

With h, c >= 0, lower <= 0 and upper >= 0 the step 0 is feasible, so a solution always exists.
"""

from functools import lru_cache
from typing import NamedTuple

import clarabel
import numpy as np
from jaxtyping import Bool, Float
from scipy import sparse

SOLVED = ("Solved", "AlmostSolved")


class PathQP(NamedTuple):
    """The QP of one path with P configurations after the start; see the module's docstring."""

    x: Float[np.ndarray, "P1 N"]  # the start, then the configurations [rad or m]
    weights: Float[np.ndarray, "N"]  # w, weights of the joints
    constrained: Bool[np.ndarray, "P"]  # True for configurations at which the task is required
    A: Float[np.ndarray, "P M N"]  # Jacobian of the task
    G: Float[np.ndarray, "P R N"]  # clearance rows at each configuration
    h: Float[np.ndarray, "P R"]  # [m]
    C: Float[np.ndarray, "P R N"]  # clearance rows half way to each configuration
    c: Float[np.ndarray, "P R"]  # [m]
    lower: Float[np.ndarray, "P N"]  # [rad or m]
    upper: Float[np.ndarray, "P N"]  # [rad or m]
    begins_anywhere: bool = False  # True: the segment to the first configuration is not part of the cost


def path_cost(x: Float[np.ndarray, "P1 N"], weights: Float[np.ndarray, "N"]) -> float:
    """Return the cost of equation (3), ||x||_Q^2 [rad2 if the joints are hinges of weight 1]."""
    steps = np.diff(x, axis=0)
    return float((steps * steps * weights).sum())


def solve_path_qp(qp: PathQP) -> Float[np.ndarray, "P N"]:
    """Return the steps y of the path's configurations [rad or m]; zeros if the solver fails."""
    count, joints = qp.lower.shape
    differences = _difference_matrix(count)[1:] if qp.begins_anywhere else _difference_matrix(count)
    cost = 2 * sparse.kron(differences.T @ differences, sparse.diags(qp.weights))
    pull = 2 * differences.T @ (np.diff(qp.x[qp.begins_anywhere :], axis=0) * qp.weights)
    rows, bounds, equal = _constraints(qp)
    cones = [clarabel.ZeroConeT(equal), clarabel.NonnegativeConeT(len(bounds) - equal)]
    options = clarabel.DefaultSettings()
    options.verbose, options.max_threads = False, 1
    solver = clarabel.DefaultSolver(sparse.triu(cost, format="csc"), pull.ravel(), rows, bounds, cones, options)
    solution = solver.solve()
    y = np.asarray(solution.x).reshape(count, joints)
    good = str(solution.status) in SOLVED and np.isfinite(y).all()
    return np.clip(y, qp.lower, qp.upper) if good else np.zeros((count, joints))


def _constraints(qp: PathQP) -> tuple[sparse.csc_matrix, np.ndarray, int]:
    """Return the matrix and the bounds of the constraints, first the equations, and the number of equations.

    Clearance rows that no step within the bounds can violate are omitted.
    """
    count, joints = qp.lower.shape
    most = np.maximum(-qp.lower, qp.upper)
    between = 0.5 * (most + np.concatenate([np.zeros((1, joints)), most[:-1]]))
    at = qp.h < np.einsum("prn,pn->pr", np.abs(qp.G), most)
    at_midpoints = qp.c < np.einsum("prn,pn->pr", np.abs(qp.C), between)
    constrained, identity = np.flatnonzero(qp.constrained), sparse.identity(count * joints, format="csc")
    halves = _sparse_rows(np.nonzero(at_midpoints)[0], 0.5 * qp.C[at_midpoints], count)
    earlier = _sparse_rows(np.nonzero(at_midpoints)[0] - 1, 0.5 * qp.C[at_midpoints], count)
    task = _sparse_rows(np.repeat(constrained, qp.A.shape[1]), qp.A[constrained].reshape(-1, joints), count)
    rows = [task, _sparse_rows(np.nonzero(at)[0], qp.G[at], count), halves + earlier, identity, -identity]
    bounds = [np.zeros(task.shape[0]), qp.h[at], qp.c[at_midpoints], qp.upper.ravel(), -qp.lower.ravel()]
    return sparse.vstack(rows, format="csc"), np.concatenate(bounds), task.shape[0]


def _sparse_rows(configuration: np.ndarray, coefficients: np.ndarray, count: int) -> sparse.csc_matrix:
    """Return a sparse matrix with one row per constraint on the step of one configuration.

    Rows for the start, configuration -1, are empty.
    """
    joints, there = coefficients.shape[1], configuration >= 0
    row = np.repeat(np.flatnonzero(there), joints)
    column = (configuration[there][:, None] * joints + np.arange(joints)).ravel()
    shape = len(configuration), count * joints
    return sparse.csc_matrix((coefficients[there].ravel(), (row, column)), shape=shape)


@lru_cache(maxsize=128)
def _difference_matrix(count: int) -> sparse.csc_matrix:
    """Return the matrix V of finite differences without the start's column: row i is y_i - y_{i-1}."""
    return sparse.diags([np.ones(count), -np.ones(count - 1)], [0, -1], format="csc")
