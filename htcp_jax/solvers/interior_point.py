"""A small dense convex QP on the device: minimise 1/2 y' H y + c' y subject to G y <= h, for a handful of unknowns.

Mehrotra's predictor-corrector on the normal equations. With 2 to 6 unknowns and up to a hundred rows, the only linear
algebra is an n x n Cholesky factorisation, unrolled, so thousands of these fuse into a few vectorised loops. The
caller guarantees that a feasible point exists (here: t can always be lowered).

Not qpax, which needs two QR factorisations per iteration, library calls for each lane, and returns the last iterate:
here the best one is returned, so that a tolerance near rounding can be required.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.backend import backend
from htcp_jax.numerics import product, solve_spd
from htcp_jax.solvers import interior_point_gpu
from htcp_jax.types import Array, Float, Int, Scalar


class DenseSolution(NamedTuple):
    """Minimiser, multipliers of G y <= h, and the largest of primal residual, dual residual and complementarity."""

    y: Float[Array, "n"]
    multipliers: Float[Array, "m"]
    error: Scalar


class _Iterate(NamedTuple):
    """State of the method."""

    y: Float[Array, "n"]
    slack: Float[Array, "m"]
    multipliers: Float[Array, "m"]
    best: DenseSolution
    count: Int[Array, ""]  # iterations; set to their maximum on divergence


def solve_dense(
    H: Float[Array, "n n"],
    c: Float[Array, "n"],
    G: Float[Array, "m n"],
    h: Float[Array, "m"],
    tolerance: float = 1e-11,
    iterations: int = 30,
) -> DenseSolution:
    """Solve one QP, H positive semidefinite and G of full column rank. Mehrotra (1992); Wright (1997), ch. 14.

    Args:
        H: Matrix of the cost.
        c: Vector of the cost.
        G: Inequality rows.
        h: Their bounds.
        tolerance: Error at which to stop.
        iterations: Most iterations.

    Returns:
        The iterate with the smallest error.
    """
    if backend().has_kernels:
        return DenseSolution(*interior_point_gpu.solve(H, c, G, h, tolerance, iterations))
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
    # Beyond what rounding allows the error grows again (or turns NaN, which compares false): return the best one.
    return jax.lax.while_loop(lambda s: (s.best.error > tolerance) & (s.count < iterations), body, start).best
