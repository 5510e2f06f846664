"""GPU kernels of the solvers: a QP, and square roots of a matrix, one instance for each.

`solve` is `interior_point.solve_dense`: each instance solves a complete QP, with its rows in parallel. As XLA code,
every iteration would take some twenty kernel launches, and the host would check for convergence. Loops that solve one
QP after the other would mostly wait for the host. The formulas and their order are those of `solve_dense`; only sums
over rows are rounded differently.

`square_roots` is for `cma_es`. On a GPU an eigendecomposition is a library call, which cannot be fused with other code.
Jacobi's cyclic method (Golub and Van Loan, Matrix Computations, section 8.5) needs only rotations of two rows, which
are unrolled here.
"""

from functools import partial

import jax
import jax.numpy as jnp

from htcp_jax.backend import kernel
from htcp_jax.numerics import solve_spd_scalars

ROWS_OF_A_WARP = 64  # two rows per thread; fewer threads synchronise less, but each divides more often
SWEEPS = 8  # number of sweeps; convergence is quadratic: 3 x 3 matrices need four, 7 x 7 matrices six


def solve(H, c, G, h, tolerance: float, iterations: int):
    """Return (y, multipliers, error) of the QP, see `interior_point.DenseSolution`.

    Arrays in Triton must have 2^k rows. Padding rows are 0 y <= 1 with multiplier 0, which remains 0.
    """
    m, n = G.shape
    size = max(16, 1 << (m - 1).bit_length())
    rows = jnp.pad(G.T, ((0, 0), (0, size - m)))
    limits = jnp.pad(h, (0, size - m), constant_values=1.0)
    out = [jax.ShapeDtypeStruct((k,), c.dtype) for k in (n, size, 1)]
    run = kernel(partial(_solve_kernel, m, tolerance, iterations), out, 1, max(1, size // ROWS_OF_A_WARP))
    y, multipliers, error = run(H, c, rows, limits)
    return y, multipliers[:m], error[0]


def _solve_kernel(m, tolerance, iterations, H, c, G, h, out_y, out_multipliers, out_error):
    """Solve one QP. Values per unknown are lists of n scalars, values per row are vectors."""
    n = c.shape[0]
    unknowns = range(n)
    H, c = [[H[i, j] for j in unknowns] for i in unknowns], [c[i] for i in unknowns]
    G, h = [G[i, :] for i in unknowns], h[...]
    real = jnp.arange(len(h)) < m

    def across(y):
        return sum((G[i] * y[i] for i in unknowns[1:]), start=G[0] * y[0])

    def along(row_values):
        return [jnp.sum(G[i] * row_values) for i in unknowns]

    def residuals(y, slack, multipliers):
        pull = along(multipliers)
        curve = [sum((H[i][j] * y[j] for j in unknowns[1:]), start=H[i][0] * y[0]) for i in unknowns]
        return [curve[i] + c[i] + pull[i] for i in unknowns], across(y) + slack - h

    def step_length(value, change):
        return jnp.minimum(jnp.min(jnp.where(change < 0, -value / jnp.where(change < 0, change, -1.0), 1.0)), 1.0)

    def body(state):
        y, slack, multipliers, dual, primal, best, count = state
        weight = multipliers / slack
        weighted = [weight * row for row in G]
        normal = {(i, j): H[i][j] + jnp.sum(G[i] * weighted[j]) for i in unknowns for j in range(i + 1)}

        def direction(complement):
            pull = along(weight * primal - complement / slack)
            dy = solve_spd_scalars(normal, [-dual[i] - pull[i] for i in unknowns], 1e-30)
            dslack = -primal - across(dy)
            return dy, dslack, -(complement + multipliers * dslack) / slack

        mu = jnp.sum(slack * multipliers) / m
        _, ds, dm = direction(slack * multipliers)
        step = jnp.minimum(step_length(slack, ds), step_length(multipliers, dm))
        mu_affine = jnp.sum((slack + step * ds) * (multipliers + step * dm)) / m
        ratio = mu_affine / mu
        centre = ratio * ratio * ratio * mu
        dy, ds, dm = direction(jnp.where(real, slack * multipliers + ds * dm - centre, 0.0))
        step = 0.995 * jnp.minimum(step_length(slack, ds), step_length(multipliers, dm))
        y = [y[i] + step * dy[i] for i in unknowns]
        slack, multipliers = slack + step * ds, multipliers + step * dm
        dual, primal = residuals(y, slack, multipliers)
        error = jnp.max(jnp.abs(primal))
        for residual in dual:
            error = jnp.maximum(error, jnp.abs(residual))
        error = jnp.maximum(error, jnp.sum(slack * multipliers) / m)
        better = error < best[-1]
        best = jax.tree.map(lambda new, old: jnp.where(better, new, old), (y, multipliers, error), best)
        count = jnp.where(error < 1e2 * best[-1], count + 1, iterations)
        return y, slack, multipliers, dual, primal, best, count

    y = [jnp.zeros((), h.dtype)] * n
    slack, multipliers = jnp.maximum(h, 0.1), jnp.where(real, 0.1, 0.0)
    nothing = y, jnp.zeros_like(h), jnp.full((), jnp.inf, h.dtype)
    start = (y, slack, multipliers, *residuals(y, slack, multipliers), nothing, jnp.int32(0))
    going = jax.lax.while_loop(lambda s: (s[5][-1] > tolerance) & (s[6] < iterations), body, start)
    y, out_multipliers[...], out_error[0] = going[5]
    for i in unknowns:
        out_y[i] = y[i]


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
