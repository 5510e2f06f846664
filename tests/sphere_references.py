"""Reference minimisers of the subproblems of equation (11): scipy and the `cma` package."""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import cma
import jax
import jax.numpy as jnp
import made_once
import numpy as np
from scipy.optimize import BFGS, NonlinearConstraint, minimize

from htcp_jax.clearance import Scene, contacts
from htcp_jax.clearance.obstacles import Contacts
from htcp_jax.clearance.obstacles.linearisation import linearise
from htcp_jax.planning.tracking.null_space import sphere_problem
from htcp_jax.settings import Settings
from htcp_jax.solvers import sphere


class Where(NamedTuple):
    T_world_workpiece: jax.Array
    interior_plane: jax.Array


@cache
def recorded() -> tuple[np.ndarray, Where]:
    """Configurations x (200, N) and poses of the recorded subproblems, see benchmarks/record_subproblems.py."""
    data = np.load(made_once.RECORDED)
    return data["x"], Where(data["T_world_workpiece"], data["gate"])


def place(k: int) -> tuple[Where, jax.Array]:
    """Pose and configuration of recorded subproblem k."""
    x, poses = recorded()
    return Where(*(jnp.asarray(leaf[k]) for leaf in poses)), jnp.asarray(x[k])


class Problem(NamedTuple):
    """One subproblem for scipy: f(w) -> exact (values (K,), gradients (K, D)); G w <= h; the start of our solver."""

    f: Callable
    G: np.ndarray
    h: np.ndarray
    start: np.ndarray
    touch: Contacts  # contacts at x

    def merit(self, w: np.ndarray) -> float:
        """Objective at the unit vector along w; -inf outside the joint limits."""
        w = w / np.linalg.norm(w)
        return float(self.f(w)[0].min()) if np.all(self.G @ w <= self.h + 1e-9) else -np.inf


@cache
def _compiled(settings: Settings):
    """Compiled functions for exact values and gradients, by the linearisation at x, and for limits and start."""
    weights = np.diag(settings.q_weights)

    def exact(robot, obstacle, where, x_ref, reach, w):
        linear = linearise(robot, obstacle, where, x_ref + reach @ w)
        step = reach @ w
        j1 = settings.j1_weight * step @ weights @ step
        j1_gradient = 2 * settings.j1_weight * reach.T @ weights @ step
        return linear.clearance.distance - j1, linear.clearance.gradient @ reach - j1_gradient[None, :]

    def begin(scene, where, x_ref):
        touch = contacts(*scene[:2], where, x_ref)
        problem, seen, reach = sphere_problem(scene, settings, where, x_ref, touch=touch)
        return problem.G, problem.h, sphere.first_direction(problem, seen), reach, touch

    return jax.jit(exact), made_once.quick_jit(begin)


@cache
def problem(k: int, settings: Settings) -> Problem:
    """Recorded subproblem k."""
    return problem_in(made_once.scene(), k, settings)


def problem_in(scene: Scene, k: int, settings: Settings) -> Problem:
    """Recorded subproblem k in another scene."""
    where, x_ref = place(k)
    exact, begin = _compiled(settings)
    G, h, start, reach, touch = begin(scene, where, x_ref)

    def f(w):
        return tuple(map(np.asarray, exact(*scene[:2], where, x_ref, reach, jnp.asarray(w))))

    near = np.asarray(h) < 10.0  # scipy needs no rows for limits that are out of reach
    return Problem(f, np.asarray(G)[near], np.asarray(h)[near], np.asarray(start), touch)


class _Remembered:
    """Cache of f, evaluated once per point for objective, constraints and gradients."""

    def __init__(self, f):
        self._f, self._seen = f, {}

    def __call__(self, z):
        key = z[:-1].tobytes()
        if key not in self._seen:
            self._seen[key] = self._f(z[:-1])
        return self._seen[key]


def _epigraph(p: Problem):
    """Epigraph form (f at z, start) for z = (w, t): maximise t with t <= f_k(w)."""
    return _Remembered(p.f), np.append(p.start, p.f(p.start)[0].min())


def slsqp(p: Problem) -> np.ndarray:
    """Minimiser w by scipy's SLSQP on the epigraph form from the same start."""
    f, z0 = _epigraph(p)
    constraints = [
        {
            "type": "ineq",
            "fun": lambda z: f(z)[0] - z[-1],
            "jac": lambda z: np.c_[f(z)[1], -np.ones(len(f(z)[0]))],
        },
        {"type": "eq", "fun": lambda z: z[:-1] @ z[:-1] - 1, "jac": lambda z: np.append(2 * z[:-1], 0)},
    ]
    if len(p.h):
        rows = np.c_[-p.G, np.zeros(len(p.h))]
        constraints.append({"type": "ineq", "fun": lambda z: p.h + rows @ z, "jac": lambda z: rows})
    result = minimize(
        lambda z: -z[-1], z0, jac=lambda z: np.append(np.zeros(len(z) - 1), -1.0), constraints=constraints,
        method="SLSQP", options={"ftol": 1e-12, "maxiter": 100},
    )  # fmt: skip
    return result.x[:-1]


def trust_constr(p: Problem) -> np.ndarray:
    """Minimiser w by scipy's trust-constr, an interior point method, on the epigraph form from the same start."""
    f, z0 = _epigraph(p)
    rows = np.c_[p.G, np.zeros(len(p.h))]

    def values(z):
        return np.concatenate([f(z)[0] - z[-1], p.h - rows @ z, [z[:-1] @ z[:-1]]])

    def gradients(z):
        return np.concatenate([np.c_[f(z)[1], -np.ones(len(f(z)[0]))], -rows, [np.append(2 * z[:-1], 0)]])

    low = np.append(np.zeros(len(values(z0)) - 1), 1.0)
    high = np.append(np.full(len(low) - 1, np.inf), 1.0)
    result = minimize(
        lambda z: -z[-1], z0, jac=lambda z: np.append(np.zeros(len(z) - 1), -1.0),
        hess=lambda z: np.zeros((len(z), len(z))),
        constraints=NonlinearConstraint(values, low, high, jac=gradients, hess=BFGS()),
        method="trust-constr", options={"gtol": 1e-8, "xtol": 1e-9, "barrier_tol": 1e-8, "maxiter": 150},
    )  # fmt: skip
    return result.x[:-1]


def cma_package(p: Problem, population: int, generations: int, sigma: float, seed: int) -> float:
    """Best objective that the `cma` package finds with our budget, our start and normalised samples."""
    options = {"CMA_active": False, "popsize": population, "seed": seed, "verbose": -9}
    es, best = cma.CMAEvolutionStrategy(list(p.start), sigma, options), -np.inf
    for _ in range(generations):
        samples = es.ask()
        merits = [p.merit(np.asarray(w)) for w in samples]
        es.tell(samples, [-m if np.isfinite(m) else 1e3 for m in merits])
        best = max(best, *merits)
    return best
