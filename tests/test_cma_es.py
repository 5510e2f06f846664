"""CMA-ES: updates equal to the `cma` package's on the same population, rates equal to the tutorial's formulas."""

import cma
import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
from cma.utilities.math import Mh

from htcp_jax.solvers import cma_es

TELL = made_once.quick_jit(cma_es.tell, static_argnames="r")


class Hashable(cma_es.StrategyParameters):
    """Rates as a static argument of jit; compared by identity, one object per test."""

    __hash__ = object.__hash__
    __eq__ = object.__eq__


def package(mean, sigma, population, seed=1):
    """Strategy of the package with positive weights only, as ours."""
    options = {"CMA_active": False, "popsize": population, "seed": seed, "verbose": -9}
    return cma.CMAEvolutionStrategy(list(mean), sigma, options)


def rates_of(es) -> cma_es.StrategyParameters:
    """Strategy parameters of the package, whose two for the step size deliberately differ from the tutorial's."""
    weights = es.sp.weights
    es.adapt_sigma.initialize(es)
    return Hashable(
        weights=np.array(weights.positive_weights), mu_eff=weights.mueff, c_sigma=es.adapt_sigma.cs,
        d_sigma=es.adapt_sigma.damps, c_c=es.sp.cc, c_1=es.sp.c1, c_mu=es.sp.cmu, chi_n=Mh.chiN(es.N),
    )  # fmt: skip


def start_of(es) -> cma_es.Distribution:
    """Our state at the package's start, whose covariance is the identity up to 1e-4, which makes the axes distinct."""
    return cma_es.start(jnp.asarray(es.mean), es.sigma)._replace(C=jnp.asarray(es.sm.covariance_matrix))


def ellipsoid(x):
    return float(np.sum(np.geomspace(1, 100, len(x)) * (np.asarray(x) - 0.3) ** 2))


def ridge(x):
    return float(x[0] + 10 * np.linalg.norm(x[1:]))  # the step size grows


@pytest.mark.parametrize(("n", "population"), [(3, 100), (4, 20), (6, 12)])
@pytest.mark.parametrize("cost", [ellipsoid, ridge])
def test_updates_equal_those_of_the_package(n, population, cost):
    """Compare mean, step size, covariance and both paths over ten generations from the same samples."""
    mean = np.linspace(-1, 1, n)
    es = package(mean, 0.5, population)
    rates, ours = rates_of(es), start_of(es)
    for _ in range(10):
        samples = es.ask()
        costs = [cost(x) for x in samples]
        es.tell(samples, costs)
        ours = TELL(ours, jnp.asarray(samples), jnp.asarray(costs), r=rates)
        np.testing.assert_allclose(ours.mean, es.mean, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(ours.sigma, es.sigma, rtol=1e-9)
        np.testing.assert_allclose(ours.C, es.sm.covariance_matrix, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(ours.path_C, es.pc, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(ours.path_sigma, es.adapt_sigma.ps, rtol=1e-8, atol=1e-10)


def test_a_long_path_stalls_the_covariance_path_as_in_the_package():
    """Samples far to one side of the mean: the step size grows and the rank-one update is stalled."""
    n, population = 3, 30
    es = package(np.zeros(n), 0.1, population)
    rates, ours = rates_of(es), start_of(es)
    samples = [x + np.array([0.25, 0.0, 0.0]) for x in es.ask()]
    costs = [ellipsoid(x) for x in samples]
    es.repair_genotype = lambda x, copy_if_changed=False: x  # the package would move external samples back
    es.tell(samples, costs)
    ours = TELL(ours, jnp.asarray(samples), jnp.asarray(costs), r=rates)
    np.testing.assert_array_equal(es.pc, 0.0)
    np.testing.assert_array_equal(ours.path_C, 0.0)
    np.testing.assert_allclose(ours.C, es.sm.covariance_matrix, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(ours.sigma, es.sigma, rtol=1e-9)


@pytest.mark.parametrize(("population", "n"), [(100, 3), (12, 6), (7, 4)])
def test_the_default_rates_are_the_tutorials(population, n):
    """Equations (49) to (58) without negative weights; those of the covariance also equal the package's."""
    rates, es = cma_es.strategy_parameters(population, n), package(np.zeros(n), 1.0, population)
    theirs = rates_of(es)
    for name in ("weights", "mu_eff", "c_c", "c_1", "c_mu", "chi_n"):
        np.testing.assert_allclose(getattr(rates, name), getattr(theirs, name), rtol=1e-3 if name == "chi_n" else 1e-12)
    mu = population // 2
    weights = np.log((population + 1) / 2) - np.log(np.arange(1, mu + 1))
    mu_eff = weights.sum() ** 2 / (weights**2).sum()
    c_sigma = (mu_eff + 2) / (n + mu_eff + 5)
    np.testing.assert_allclose(rates.c_sigma, c_sigma)
    np.testing.assert_allclose(rates.d_sigma, 1 + 2 * max(0, np.sqrt((mu_eff - 1) / (n + 1)) - 1) + c_sigma)


def test_samples_have_the_mean_and_covariance_of_the_distribution():
    C = np.array([[2.0, 0.6, -0.3], [0.6, 1.0, 0.2], [-0.3, 0.2, 0.5]])
    distribution = cma_es.start(jnp.array([1.0, -2.0, 0.5]), 0.3)._replace(C=jnp.asarray(C))
    samples = np.asarray(cma_es.ask(distribution, jax.random.key(0), 40_000))
    np.testing.assert_allclose(samples.mean(0), distribution.mean, atol=0.01)
    np.testing.assert_allclose(np.cov(samples.T), 0.09 * C, atol=0.005)
    again = cma_es.ask(distribution, jax.random.key(0), 40_000)
    np.testing.assert_array_equal(samples, again)


def test_the_order_of_the_samples_does_not_matter():
    rng, rates = np.random.default_rng(0), Hashable(*cma_es.strategy_parameters(20, 3))
    samples = rng.normal(size=(20, 3))
    costs, order = np.array([ellipsoid(x) for x in samples]), rng.permutation(20)
    start = cma_es.start(jnp.zeros(3), 0.5)
    one = TELL(start, jnp.asarray(samples), jnp.asarray(costs), r=rates)
    other = TELL(start, jnp.asarray(samples[order]), jnp.asarray(costs[order]), r=rates)
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)


def test_it_finds_a_minimum():
    rates = Hashable(*cma_es.strategy_parameters(20, 4))
    distribution = cma_es.start(jnp.ones(4), 0.5)
    scale = jnp.geomspace(1, 100, 4)
    ask = made_once.quick_jit(lambda d, g: cma_es.ask(d, jax.random.fold_in(jax.random.key(1), g), 20))
    for generation in range(80):
        samples = ask(distribution, generation)
        costs = jnp.sum(scale[None, :] * (samples - 0.3) ** 2, axis=1)
        distribution = TELL(distribution, samples, costs, r=rates)
    np.testing.assert_allclose(distribution.mean, 0.3, atol=1e-6)
