"""Interior-point method for least squares with inequalities, in which a row has only variables next to each other.

    minimise    sum_r  w_r (V u + e)_r^2
    subject to  J u <= b

Mehrotra's predictor-corrector method (Nocedal and Wright, Numerical Optimization, section 16.6). Each iteration solves
two systems with the matrix 2 V' W V + J' D J. It is banded, and its entries are linear in the diagonals W and D, so one
sparse product assembles it (`_products`).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.linalg import lapack

TOLERANCE = 1e-8  # of the inequalities, and relative to 1 or the data of the gradient and of the duality gap
MOST_ITERATIONS = 100  # most QPs need 8 to 15
SLACK, CENTRE = 1e-3, 1e-3  # least slack, and slack times multiplier, at the beginning
BACK_OFF = 0.995  # share of the longest step after which slacks and multipliers are not negative


class Rows(NamedTuple):
    """Rows of a sparse matrix with the same number of entries each; an unused entry has the value 0."""

    value: Float[np.ndarray, "m W"]
    column: Int[np.ndarray, "m W"]  # variable of each entry


class BandedQP(NamedTuple):
    """The problem in the module's docstring, with n variables and m inequalities."""

    size: int  # n
    bandwidth: int  # the variables of a row differ by less than this
    V: Rows
    weights: Float[np.ndarray, "r"]  # w
    offset: Float[np.ndarray, "r"]  # e
    J: Sequence[Rows]  # parts of the inequalities' matrix
    bounds: Float[np.ndarray, "m"]  # b, at least one


def solve_banded_qp(qp: BandedQP) -> Float[np.ndarray, "n"] | None:
    """Return the minimum u, or None if the method does not converge."""
    V, J, squares, twice = _matrix([qp.V], qp.size), _matrix(qp.J, qp.size), _products(qp.J, qp), 2 * qp.weights
    Vt, Jt, cost = V.T, J.T, _products([qp.V], qp) @ twice
    scale = 1 + np.abs(Vt @ (twice * qp.offset)).max()
    u, Ju = np.zeros(qp.size), np.zeros(len(qp.bounds))
    s = np.maximum(qp.bounds, SLACK)
    z = CENTRE / s
    for _ in range(MOST_ITERATIONS):
        Vu, gap, violation = V @ u, s @ z, Ju + s - qp.bounds
        slope = Vt @ (twice * (Vu + qp.offset)) + Jt @ z
        saved = np.abs(twice * (0.5 * Vu + qp.offset) @ Vu)
        if not np.isfinite(gap):
            return None
        if max(gap / max(1.0, saved), np.abs(violation).max(), np.abs(slope).max() / scale) <= TOLERANCE:
            return u
        ratio = z / s
        band = (cost + squares @ ratio).reshape(qp.size, qp.bandwidth).T
        factor, failed = lapack.dpbtrf(band, lower=1)
        if failed:
            return None

        def newton_step(products: np.ndarray) -> tuple[np.ndarray, ...]:
            """Return the steps of u, J u, s and z towards s z + products = 0."""
            fixed = ratio * violation - products / s  # noqa: B023
            du = lapack.dpbtrs(factor, -slope - Jt @ fixed, lower=1)[0]  # noqa: B023
            Jdu = J @ du
            return du, Jdu, -violation - Jdu, fixed + ratio * Jdu  # noqa: B023

        _, _, ds, dz = newton_step(s * z)
        share = _longest(s, z, ds, dz)
        centring = ((s + share * ds) @ (z + share * dz) / gap) ** 3
        du, Jdu, ds, dz = newton_step(s * z + ds * dz - centring * gap / len(s))
        share = BACK_OFF * _longest(s, z, ds, dz)
        u, Ju, s, z = u + share * du, Ju + share * Jdu, s + share * ds, z + share * dz
    return None


def _longest(s: np.ndarray, z: np.ndarray, ds: np.ndarray, dz: np.ndarray) -> float:
    """Return the largest share of a step, at most 1, after which neither s nor z is negative."""
    return 1.0 / max(1.0, -(ds / s).min(), -(dz / z).min())


def _matrix(parts: Sequence[Rows], size: int) -> sparse.csr_matrix:
    lengths = np.concatenate([np.full(len(rows.value), rows.value.shape[1]) for rows in parts])
    value, column = (np.concatenate([table.ravel() for table in tables]) for tables in zip(*parts, strict=True))
    return sparse.csr_matrix((value, column, np.append(0, np.cumsum(lengths))), shape=(len(lengths), size))


def _products(parts: Sequence[Rows], qp: BandedQP) -> sparse.csc_matrix:
    """Return the matrix P for which P @ d is the lower band of sum_r d_r a_r a_r', with the rows a_r.

    The band's entry (j + k, j) is at j * bandwidth + k: transposed, it is LAPACK's.
    """
    pairs = []
    for rows in parts:
        a, b = np.tril_indices(rows.value.shape[1])
        first, last = rows.column[:, a], rows.column[:, b]
        place = np.minimum(first, last) * qp.bandwidth + np.abs(last - first)
        pairs.append(Rows(rows.value[:, a] * rows.value[:, b], place))
    return _matrix(pairs, qp.size * qp.bandwidth).T
