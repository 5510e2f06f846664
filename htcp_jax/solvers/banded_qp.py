"""Interior-point method for QPs whose variables have common terms and constraints only with near variables.

    minimise    u' H u / 2 + g' u
    subject to  lower <= B u <= upper,   J u <= b

Mehrotra's predictor-corrector method (Nocedal and Wright, Numerical Optimization, section 16.6). Each iteration solves
two systems with the banded matrix H + B' D B + J' E J. Its entries are linear in the diagonals D and E, so one sparse
product assembles it (`_products`). Clarabel, which orders and factors a general sparse matrix with the equations, takes
four times as long for a path of 105 targets, and was most of the time of smoothing; it is the reference in the tests.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.linalg import blas, lapack

TOLERANCE = 1e-8  # of the inequalities, and relative to 1 or the data of the gradient and of the duality gap
MOST_ITERATIONS = 100  # most QPs need 8 to 15
SLACK, CENTRE = 1e-3, 1e-3  # least slack, and slack times multiplier, at the beginning
BACK_OFF = 0.995  # share of the longest step after which slacks and multipliers are not negative


class Rows(NamedTuple):
    """Rows of a sparse matrix with the same number of entries each; an unused entry has the value 0."""

    value: Float[np.ndarray, "m W"]
    column: Int[np.ndarray, "m W"]  # variable of each entry


class BandedQP(NamedTuple):
    """The problem in the module's docstring, with n variables; variables with common rows differ by less than K."""

    H: Float[np.ndarray, "n K"]  # entry (j, k) is that of the variables j + k and j
    g: Float[np.ndarray, "n"]
    B: Rows  # at least one
    lower: Float[np.ndarray, "m"]
    upper: Float[np.ndarray, "m"]
    J: Sequence[Rows]
    b: Float[np.ndarray, "r"]


def solve_banded_qp(qp: BandedQP) -> Float[np.ndarray, "n"] | None:
    """Return the minimum u, or None if the method does not converge."""
    (size, width), two_sided = qp.H.shape, len(qp.upper)
    J = _matrix([qp.B, Rows(-qp.B.value, qp.B.column), *qp.J], size)
    Jt, squares, bounds = J.T, _products([qp.B, *qp.J], size, width), np.concatenate([qp.upper, -qp.lower, qp.b])
    scale = 1 + np.abs(qp.g).max()
    u, Ju = np.zeros(size), np.zeros(len(bounds))
    s = np.maximum(bounds, SLACK)
    z = CENTRE / s
    for _ in range(MOST_ITERATIONS):
        Hu = blas.dsbmv(width - 1, 1.0, qp.H.T, u, lower=1)
        slope, gap, violation = Hu + qp.g + Jt @ z, s @ z, Ju + s - bounds
        saved = abs((0.5 * Hu + qp.g) @ u)
        if not np.isfinite(gap):
            return None
        if max(gap / max(1.0, saved), np.abs(violation).max(), np.abs(slope).max() / scale) <= TOLERANCE:
            return u
        ratio = z / s
        diagonal = np.concatenate([ratio[:two_sided] + ratio[two_sided : 2 * two_sided], ratio[2 * two_sided :]])
        factor, failed = lapack.dpbtrf((qp.H + (squares @ diagonal).reshape(size, width)).T, lower=1, overwrite_ab=1)
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


def _products(parts: Sequence[Rows], size: int, width: int) -> sparse.csc_matrix:
    """Return the matrix P for which P @ d is the band of sum_r d_r a_r a_r', as in `BandedQP.H`, with the rows a_r."""
    pairs = []
    for rows in parts:
        a, b = np.tril_indices(rows.value.shape[1])
        place = band_place(rows.column[:, a], rows.column[:, b], width)
        pairs.append(Rows(rows.value[:, a] * rows.value[:, b], place))
    return _matrix(pairs, size * width).T


def band_place(a: Int[np.ndarray, "..."], b: Int[np.ndarray, "..."], width: int) -> Int[np.ndarray, "..."]:
    """Return the place of pairs of variables, broadcast, in a flat table like `BandedQP.H`."""
    return np.minimum(a, b) * width + np.abs(b - a)
