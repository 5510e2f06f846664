"""A small dense convex QP on the device: minimise 1/2 y' H y + c' y subject to G y <= h, for a handful of unknowns.

The method is Mehrotra's predictor-corrector on the normal equations. With 2 to 6 unknowns and up to a hundred rows, the
only linear algebra is an unrolled n x n Cholesky factorisation, so thousands of QPs fuse into a few vectorised loops.
The caller must guarantee that a feasible point exists.

The library qpax is not used: it needs two QR factorisations per iteration, which are library calls for each lane, and
returns the last iterate. Here the best iterate is returned, so that the tolerance can be near rounding.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.backend import backend
from htcp_jax.numerics import product, solve_spd
from htcp_jax.solvers import gpu_kernels
from htcp_jax.types import Array, Float, Int, Scalar


class DenseSolution(NamedTuple):
    """Solution of a dense QP."""

    y: Float[Array, "n"]  # minimiser
    multipliers: Float[Array, "m"]  # multipliers of G y <= h
    error: Scalar  # the largest of primal residual, dual residual and complementarity


class _Iterate(NamedTuple):
    """State of the interior point method."""

    y: Float[Array, "n"]
    slack: Float[Array, "m"]
    multipliers: Float[Array, "m"]
    best: DenseSolution
    count: Int[Array, ""]  # number of iterations; set to the maximum if the method diverges


def solve_dense(
    H: Float[Array, "n n"],
    c: Float[Array, "n"],
    G: Float[Array, "m n"],
    h: Float[Array, "m"],
    tolerance: float = 1e-11,
    iterations: int = 30,
) -> DenseSolution:
    """Solve one QP with H positive semidefinite and G of full column rank (Mehrotra 1992; Wright 1997, ch. 14).

    Args:
        H: Matrix of the cost.
        c: Vector of the cost.
        G: Inequality rows.
        h: Bounds of the rows.
        tolerance: Error at which to stop, see `DenseSolution`.
        iterations: Maximum number of iterations.

    Returns:
        The iterate with the smallest error.
    """
    if backend().has_kernels:
        return DenseSolution(*gpu_kernels.solve(H, c, G, h, tolerance, iterations))
    m = len(h)

    def step_length(value, change):
        return jnp.min(jnp.where(change < 0, -value / jnp.where(change < 0, change, -1.0), 1.0), initial=1.0)

    def error(y, slack, multipliers):
        dual = product(H, y) + c + product(G.T, multipliers)
        primal = product(G, y) + slack - h
        worst = jnp.maximum(jnp.max(jnp.abs(dual)), jnp.max(jnp.abs(primal)))
        return jnp.maximum(worst, jnp.sum(slack * multipliers) / m)

    def body(state: _Iterate) -> _Iterate:
        y, slack, multipliers, best, count = state
        dual = product(H, y) + c + product(G.T, multipliers)
        primal = product(G, y) + slack - h
        weight = multipliers / slack
        normal = H + product(G.T, weight[:, None] * G)

        def direction(complement):
            dy = solve_spd(normal, -dual - product(G.T, weight * primal - complement / slack), floor=1e-30)
            dslack = -primal - product(G, dy)
            return dy, dslack, -(complement + multipliers * dslack) / slack

        mu = jnp.sum(slack * multipliers) / m
        _, ds, dm = direction(slack * multipliers)
        step = jnp.minimum(step_length(slack, ds), step_length(multipliers, dm))
        mu_affine = jnp.sum((slack + step * ds) * (multipliers + step * dm)) / m
        centre = (mu_affine / mu) ** 3 * mu
        dy, ds, dm = direction(slack * multipliers + ds * dm - centre)
        step = 0.995 * jnp.minimum(step_length(slack, ds), step_length(multipliers, dm))
        y, slack, multipliers = y + step * dy, slack + step * ds, multipliers + step * dm
        new = DenseSolution(y, multipliers, error(y, slack, multipliers))
        better = new.error < best.error
        best = jax.tree.map(lambda n, b: jnp.where(better, n, b), new, best)
        count = jnp.where(new.error < 1e2 * best.error, count + 1, iterations)
        return _Iterate(y, slack, multipliers, best, count)

    y = jnp.zeros_like(c)
    nothing = DenseSolution(y, jnp.zeros(m), jnp.full((), jnp.inf))
    start = _Iterate(y, jnp.maximum(h, 0.1), jnp.full(m, 0.1), nothing, jnp.zeros((), jnp.int32))
    # Once rounding prevents progress the error increases again, or becomes NaN: return the best iterate.
    return jax.lax.while_loop(lambda s: (s.best.error > tolerance) & (s.count < iterations), body, start).best
