"""`interior_point.solve_dense` as one GPU kernel: each instance solves a complete QP, with its rows in parallel.

As XLA code, every iteration would take some twenty kernel launches, and the host would check for convergence. Loops
that solve one QP after the other would mostly wait for the host. The formulas and their order are those of
`solve_dense`; only sums over rows are rounded differently.
"""

from functools import partial

import jax
import jax.numpy as jnp

from htcp_jax.numerics import solve_spd_scalars
from htcp_jax.pallas import kernel

ROWS_OF_A_WARP = 64  # two rows per thread; fewer threads synchronise less, but each divides more often


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
