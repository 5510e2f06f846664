"""Square roots of a small symmetric matrix as one GPU kernel, for `cma_es`: one instance per matrix.

On a GPU an eigendecomposition is a library call, which cannot be fused with other code. Jacobi's cyclic method (Golub
and Van Loan, Matrix Computations, section 8.5) needs only rotations of two rows, which are unrolled here.
"""

import jax
import jax.numpy as jnp

from htcp_jax.pallas import kernel

SWEEPS = 8  # number of sweeps; convergence is quadratic: 3 x 3 matrices need four, 7 x 7 matrices six


def square_roots(C):
    """Return B D with B D^2 B' = C, and C^(-1/2).

    Eigenvalues are in ascending order; the largest component of each eigenvector is positive.
    """
    shape = jax.ShapeDtypeStruct(C.shape, C.dtype)
    return kernel(_square_roots_kernel, (shape, shape), 1)(C)


def _square_roots_kernel(C, axes, whiten):
    n = C.shape[0]
    square, B = _ordered(*_eigen([[C[i, j] for j in range(n)] for i in range(n)]))
    D = [jnp.sqrt(jnp.maximum(value, 1e-20)) for value in square]
    for i in range(n):
        for j in range(n):
            axes[i, j] = B[j][i] * D[j]
            whiten[i, j] = sum(B[k][i] * B[k][j] / D[k] for k in range(n))


def _eigen(C):
    """Return the eigenvalues and unit eigenvectors of a symmetric matrix, as lists of scalars."""
    n = len(C)

    def sweep(_, state):
        A, B = state
        for p in range(n):
            for q in range(p + 1, n):
                A, B = _rotate(A, B, p, q)
        return A, B

    one, zero = jnp.ones((), C[0][0].dtype), jnp.zeros((), C[0][0].dtype)
    unit = [[one if i == j else zero for j in range(n)] for i in range(n)]
    A, B = jax.lax.fori_loop(0, SWEEPS, sweep, (C, unit))
    return [A[i][i] for i in range(n)], B


def _rotate(A, B, p, q):
    """Return A and B after the rotation that makes A[p][q] zero; the rows of B converge to the eigenvectors."""
    off = A[p][q]
    # Tangent of the smaller of the two possible rotations; 0 if A[p][q] is already 0.
    ratio = (A[q][q] - A[p][p]) / (2 * jnp.where(off == 0, 1.0, off))
    tangent = 1 / (jnp.abs(ratio) + jnp.sqrt(1 + ratio * ratio))
    tangent = jnp.where(off == 0, 0.0, jnp.where(ratio < 0, -tangent, tangent))
    cosine = 1 / jnp.sqrt(1 + tangent * tangent)
    sine = tangent * cosine
    A, B = [list(row) for row in A], [list(row) for row in B]
    A[p][p], A[q][q] = A[p][p] - tangent * off, A[q][q] + tangent * off
    A[p][q] = A[q][p] = off - off  # a loop in Triton carries no literal
    for i in range(len(A)):
        if i not in (p, q):
            A[i][p], A[i][q] = cosine * A[i][p] - sine * A[i][q], sine * A[i][p] + cosine * A[i][q]
            A[p][i], A[q][i] = A[i][p], A[i][q]
        B[p][i], B[q][i] = cosine * B[p][i] - sine * B[q][i], sine * B[p][i] + cosine * B[q][i]
    return A, B


def _ordered(square, B):
    """Return the eigenvalues in ascending order, by exchanges of neighbours, and their vectors after `_positive`."""
    n = len(square)
    pairs = [(square[i], *_positive(B[i])) for i in range(n)]
    for last in reversed(range(n)):
        for i in range(last):
            low, high = pairs[i], pairs[i + 1]
            swap = low[0] > high[0]
            pairs[i] = tuple(jnp.where(swap, b, a) for a, b in zip(low, high, strict=True))
            pairs[i + 1] = tuple(jnp.where(swap, a, b) for a, b in zip(low, high, strict=True))
    return [pair[0] for pair in pairs], [pair[1:] for pair in pairs]


def _positive(v):
    """Return v or -v, so that the component of largest magnitude, the first of several, is positive."""
    longest = v[0]
    for component in v[1:]:
        longest = jnp.where(jnp.abs(component) > jnp.abs(longest), component, longest)
    return [jnp.where(longest < 0, -component, component) for component in v]
