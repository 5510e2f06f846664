"""CMA-ES with positive weights (Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv:1604.00772), as pure functions.

It is implemented here because the complete strategy must run under vmap for thousands of scenarios in 64-bit. A test
checks that one update equals that of the `cma` package on the same population.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.backend import backend
from htcp_jax.numerics import product
from htcp_jax.solvers import gpu_kernels
from htcp_jax.types import Array, Float, Scalar


class Distribution(NamedTuple):
    """The search distribution N(mean, sigma^2 C), and its evolution paths; n is the dimension."""

    mean: Float[Array, "n"]
    sigma: Scalar
    C: Float[Array, "n n"]
    path_sigma: Float[Array, "n"]
    path_C: Float[Array, "n"]
    generation: Scalar


class StrategyParameters(NamedTuple):
    """Strategy parameters for a population size and dimension: Table 1 of the tutorial, without negative weights."""

    weights: Float[np.ndarray, "parents"]
    mu_eff: float
    c_sigma: float
    d_sigma: float
    c_c: float
    c_1: float
    c_mu: float
    chi_n: float


def strategy_parameters(population: int, n: int) -> StrategyParameters:
    """Return the tutorial's default parameters, equations (49) to (58)."""
    parents = population // 2
    raw = np.log((population + 1) / 2) - np.log(np.arange(1, parents + 1))
    weights = raw / raw.sum()
    mu_eff = 1 / np.sum(weights**2)
    c_1 = 2 / ((n + 1.3) ** 2 + mu_eff)
    c_sigma = (mu_eff + 2) / (n + mu_eff + 5)
    return StrategyParameters(
        weights=weights,
        mu_eff=mu_eff,
        c_sigma=c_sigma,
        d_sigma=1 + 2 * max(0.0, np.sqrt((mu_eff - 1) / (n + 1)) - 1) + c_sigma,
        c_c=(4 + mu_eff / n) / (n + 4 + 2 * mu_eff / n),
        c_1=c_1,
        c_mu=min(1 - c_1, 2 * (1 / 4 + mu_eff + 1 / mu_eff - 2) / ((n + 2) ** 2 + mu_eff)),
        chi_n=np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2)),
    )


def start(mean: Float[Array, "n"], sigma: float) -> Distribution:
    """Return the initial distribution: isotropic about `mean`, with the standard deviation sigma."""
    zero = jnp.zeros_like(mean)
    return Distribution(mean, jnp.full((), sigma), jnp.eye(len(mean)), zero, zero, jnp.zeros(()))


def ask(distribution: Distribution, key: jax.Array, population: int) -> Float[Array, "population n"]:
    """Return a population drawn from the distribution.

    Args:
        distribution: The search distribution.
        key: Random key.
        population: Number of samples.
    """
    n = distribution.mean.shape[0]
    axes, _ = _square_roots_of(distribution.C)
    normal = jax.random.normal(key, (population, n), distribution.mean.dtype)
    return distribution.mean[None, :] + _product(distribution.sigma * normal, axes.T)


def tell(
    distribution: Distribution,
    samples: Float[Array, "population n"],
    cost: Float[Array, "population"],
    r: StrategyParameters,
) -> Distribution:
    """Return the distribution updated by samples, which are ranked by cost; equations (41) to (47).

    Args:
        distribution: The distribution that the samples were drawn from.
        samples: The population.
        cost: Cost of each sample.
        r: Strategy parameters.
    """
    n = distribution.mean.shape[0]
    best = samples[jnp.argsort(cost)[: len(r.weights)]]
    steps = (best - distribution.mean[None, :]) / distribution.sigma
    step = _product(r.weights, steps)
    _, whiten = _square_roots_of(distribution.C)
    gain = np.sqrt(r.c_sigma * (2 - r.c_sigma) * r.mu_eff)
    path_sigma = (1 - r.c_sigma) * distribution.path_sigma + _product(gain * whiten, step)
    length = jnp.linalg.norm(path_sigma)
    generation = distribution.generation + 1
    fair = length / jnp.sqrt(1 - (1 - r.c_sigma) ** (2 * generation))
    moving = jnp.where(fair < (1.4 + 2 / (n + 1)) * r.chi_n, 1.0, 0.0)
    path_C = (1 - r.c_c) * distribution.path_C + moving * np.sqrt(r.c_c * (2 - r.c_c) * r.mu_eff) * step
    stalled = (1 - moving) * r.c_c * (2 - r.c_c)
    rank_mu = _scatter(r.weights, steps)
    C = (1 + r.c_1 * stalled - r.c_1 - r.c_mu) * distribution.C
    C = C + r.c_1 * path_C[:, None] * path_C[None, :] + r.c_mu * rank_mu
    sigma = distribution.sigma * jnp.exp(r.c_sigma / r.d_sigma * (length / r.chi_n - 1))
    return Distribution(distribution.mean + distribution.sigma * step, sigma, C, path_sigma, path_C, generation)


def _square_roots_of(C):
    """Return B D with B D^2 B' = C, and C^(-1/2)."""
    if backend().has_kernels:
        return gpu_kernels.square_roots(C)
    square, B = jnp.linalg.eigh(C)
    D = jnp.sqrt(jnp.maximum(square, 1e-20))
    return B * D[None, :], (B / D[None, :]) @ B.T


# On a GPU a matrix product is a library call that is not fused with other code; on a CPU both forms round differently.


def _product(a, b):
    """Return a @ b."""
    return product(a, b) if backend().platform == "gpu" else a @ b


def _scatter(weights, steps):
    """Return the sum of weight * step step'."""
    if backend().platform == "gpu":
        return product((weights[:, None] * steps).T, steps)
    return jnp.einsum("p,pi,pj->ij", weights, steps, steps)
