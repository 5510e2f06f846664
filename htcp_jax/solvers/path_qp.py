"""Smoothing QP: equation (3) about a path, as one sparse QP in the steps y_1 .. y_P of all of its configurations.

    minimise    sum_i  w' (x_i + y_i - x_{i-1} - y_{i-1})^2      ||x||_Q^2 with Q = V' V; x_0 is fixed, y_0 = 0
    subject to  A_i y_i = 0                        where the task is required: it stays satisfied, to first order
                G_i y_i <= h_i                     the clearance rows (8) of a configuration,
                C_i (y_{i-1} + y_i) / 2 <= c_i     and those half way to it
                lower_i <= y_i <= upper_i          the trust region, inside the joint limits

With h, c >= 0, lower <= 0 and upper >= 0 the step 0 is feasible, so a solution always exists.

The equations are eliminated: y_i = Z_i u_i with an orthonormal basis Z_i of the directions that satisfy them and that
move no fixed joint. Only consecutive configurations have common rows, so that `banded_qp` can solve the rest.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.solvers.banded_qp import BandedQP, Rows, band_place, solve_banded_qp
from htcp_jax.solvers.step_qp import scaled_weights

DEPENDENT = 1e-10  # singular values of A_i below this share of the largest one count as 0
STANDS = 1e-12  # a row with smaller entries along all directions is violated by no step


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
    qp = qp._replace(weights=scaled_weights(qp.weights))  # only their ratios matter
    directions = _free_directions(qp)
    u = solve_banded_qp(_banded(qp, directions)) if directions.size else None
    return np.zeros_like(qp.lower) if u is None else np.clip(directions.along(u), qp.lower, qp.upper)


class _FreeDirections(NamedTuple):
    """Directions along which the configurations of a path may move, and a numbering of all of them."""

    Z: Float[np.ndarray, "P N W"]  # orthonormal columns, the last ones; zeros for configurations with fewer than W
    column: Int[np.ndarray, "P W"]  # number of each direction, that of a near one for zeros
    size: int  # number of directions

    def at(self, configuration: Int[np.ndarray, "m"], rows: Float[np.ndarray, "m N"]) -> Rows:
        """Return rows on the steps of one configuration each as rows on the directions."""
        value = np.matmul(rows[:, None, :], self.Z[configuration])[:, 0]
        return Rows(value, self.column[configuration])

    def between(self, configuration: Int[np.ndarray, "m"], earlier: np.ndarray, own: np.ndarray) -> Rows:
        """Return rows on the steps of a configuration and of the previous one; the start has no step."""
        previous = self.at(np.maximum(configuration - 1, 0), np.where(configuration[:, None] > 0, earlier, 0.0))
        return Rows(*(np.concatenate(pair, axis=1) for pair in zip(previous, self.at(configuration, own), strict=True)))

    def along(self, u: Float[np.ndarray, "n"]) -> Float[np.ndarray, "P N"]:
        """Return the configurations' steps of given lengths along the directions."""
        return np.matmul(self.Z, u[self.column][:, :, None])[:, :, 0]


def _free_directions(qp: PathQP) -> _FreeDirections:
    joints, fixed = qp.lower.shape[1], qp.lower == qp.upper
    A = np.where(qp.constrained[:, None, None], qp.A, 0.0)
    if fixed.any():
        A = np.concatenate([A, fixed[:, :, None] * np.eye(joints)], axis=1)
    _, sizes, basis = np.linalg.svd(A)
    free = np.arange(joints) >= (sizes > DEPENDENT * sizes[:, :1]).sum(axis=1)[:, None]
    first = joints - int(free.sum(axis=1).max())
    Z, free = (basis * free[:, :, None])[:, first:].transpose(0, 2, 1), free[:, first:]
    number = np.cumsum(free).reshape(free.shape)
    return _FreeDirections(Z, np.maximum(number - 1, 0), int(free.sum()))


def _banded(qp: PathQP, directions: _FreeDirections) -> BandedQP:
    """Return the QP in the lengths along the free directions."""
    joints, most = directions.Z.shape[1:]
    box = Rows(directions.Z.reshape(-1, most), np.repeat(directions.column, joints, axis=0))
    moves = np.abs(box.value).max(axis=1) > STANDS
    box, lower, upper = Rows(*(table[moves] for table in box)), qp.lower.ravel()[moves], qp.upper.ravel()[moves]
    return BandedQP(*_cost(qp, directions), box, lower, upper, *_clearance_rows(qp, directions))


def _cost(qp: PathQP, directions: _FreeDirections) -> tuple[Float[np.ndarray, "n K"], Float[np.ndarray, "n"]]:
    """Return the cost's Hessian, as in `BandedQP.H`, and its gradient at the step 0."""
    Z, column, size = directions
    count, joints, most = Z.shape
    pulls = 2 * qp.weights * np.diff(qp.x, axis=0)  # gradient of each segment's cost by its end
    pulls[: int(qp.begins_anywhere)] = 0.0
    pull = pulls - np.concatenate([pulls[1:], np.zeros((1, joints))])
    g = np.bincount(column.ravel(), np.matmul(pull[:, None, :], Z).ravel(), size)
    segments = np.full(count, 2.0)  # number of segments at each configuration
    segments[-1] -= 1.0
    segments[0] -= qp.begins_anywhere
    weighted, (a, b), width = 2 * qp.weights[:, None] * Z, np.tril_indices(most), 2 * most
    own = segments[:, None] * np.matmul(Z.transpose(0, 2, 1), weighted)[:, a, b]
    shared = -np.matmul(Z[1:].transpose(0, 2, 1), weighted[:-1])
    own_place = band_place(column[:, a], column[:, b], width)
    shared_place = band_place(column[1:, :, None], column[:-1, None, :], width)
    place = np.concatenate([own_place.ravel(), shared_place.ravel()])
    H = np.bincount(place, np.concatenate([own.ravel(), shared.ravel()]), size * width)
    return H.reshape(size, width), g


def _clearance_rows(qp: PathQP, directions: _FreeDirections) -> tuple[list[Rows], Float[np.ndarray, "m"]]:
    """Return the clearance rows and their bounds, without rows that no step within the trust region can violate."""
    most = np.maximum(-qp.lower, qp.upper)
    between = 0.5 * (most + np.concatenate([np.zeros((1, most.shape[1])), most[:-1]]))
    at = qp.h < np.einsum("prn,pn->pr", np.abs(qp.G), most)
    half_way = qp.c < np.einsum("prn,pn->pr", np.abs(qp.C), between)
    halves = 0.5 * qp.C[half_way]
    parts = [
        (directions.at(np.nonzero(at)[0], qp.G[at]), qp.h[at]),
        (directions.between(np.nonzero(half_way)[0], halves, halves), qp.c[half_way]),
    ]
    moves = [np.abs(rows.value).max(axis=1) > STANDS for rows, _ in parts]
    rows = [Rows(*(table[own] for table in rows)) for (rows, _), own in zip(parts, moves, strict=True)]
    return rows, np.concatenate([bounds[own] for (_, bounds), own in zip(parts, moves, strict=True)])
