"""Minimisers of J2 over the unit sphere, equation (11): one null-space step looks for the direction w that clears best.

    maximise  min_k f_k(w)   over |w| = 1,  G w <= h,     f_k(w) = D_k(x_ref + alpha N w) - J1

f_k belongs to body k, so the objective is a minimum of functions, each itself a minimum over points: kinked where it
matters most. `observe` measures it exactly and is dear; every observation leaves K planes behind, one a body: its
contact, held fixed to body and workpiece. `predict` moves the planes of earlier observations to another w, exact to
first order and cheap. The minimisers know nothing else of robots or clouds.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from htcp_jax import cma_es
from htcp_jax.nullspace import null_basis
from htcp_jax.numerics import safe_norm
from htcp_jax.qp_dense import solve_dense
from htcp_jax.types import Array, Float, Scalar

Direction = Float[Array, "D"]
Planes = object  # a pytree whose leaves have a leading axis K, or a multiple of it


class Sphere(NamedTuple):
    """The problem above. J1(w) = 1/2 w' curvature w is already inside the values that observe and predict return."""

    observe: Callable[[Direction], tuple[Float[Array, "K"], Planes]]
    predict: Callable[[Direction, Planes], tuple[Float[Array, "R"], Float[Array, "R D"]]]
    curvature: Float[Array, "D D"]
    G: Float[Array, "m D"]
    h: Float[Array, "m"]


class Best(NamedTuple):
    """A direction and what it attains."""

    w: Direction
    value: Scalar  # min_k f_k(w), exact


def spread_directions(count: int, dimension: int) -> Float[np.ndarray, "count dimension"]:
    """Fixed unit vectors, the same on every machine: the positive and negative axes, then seeded random ones."""
    axes = np.concatenate([np.eye(dimension), -np.eye(dimension)])
    more = np.random.Generator(np.random.PCG64(0)).standard_normal((max(count, len(axes)), dimension))
    return np.concatenate([axes, more / np.linalg.norm(more, axis=1, keepdims=True)])[:count]


def _unit(v: Direction) -> Direction:
    return v / jnp.maximum(safe_norm(v), 1e-300)


def _merit(sphere: Sphere, w: Direction, value: Scalar) -> Scalar:
    """Objective less an exact penalty on joint limits: 10 m/rad is steeper than any clearance."""
    return value - 10.0 * jnp.max(jnp.maximum(sphere.G @ w - sphere.h, 0.0), initial=0.0)


def first_guess(sphere: Sphere, planes: Planes, count: int = 64) -> Direction:
    """Best of `count` spread directions by the planes at hand: costs no observation."""
    directions = jnp.asarray(spread_directions(count, sphere.curvature.shape[0]))
    merit = jax.vmap(lambda w: _merit(sphere, w, jnp.min(sphere.predict(w, planes)[0])))(directions)
    return directions[jnp.argmax(merit)]


def sqp(sphere: Sphere, planes: Planes, iterations: int = 16, memory: int = 6) -> Best:
    """Sequential quadratic programming on the epigraph: maximise t with t <= every plane of the last observations.

    Each iteration solves one QP in the tangent plane at w, with the curvature of sphere and J1 and the multipliers of
    the QP before, backtracks along the arc on the merit that the planes predict, and observes there. An observation
    that is worse than w leaves its planes behind, and they are what the next QP needs: kinks are met from both sides.
    """
    w = first_guess(sphere, planes)
    values, seen = sphere.observe(w)
    store = jax.tree.map(lambda leaf: jnp.concatenate([leaf] * memory), seen)
    bodies = values.shape[0]

    def body(state):
        w, merit, store, multipliers, _, count = state
        value, gradient = sphere.predict(w, store)
        step, multipliers, gain = _tangent_step(sphere, w, value, gradient, multipliers)
        w_new = _backtrack(sphere, w, step, store, merit)
        values, seen = sphere.observe(w_new)
        merit_new = _merit(sphere, w_new, jnp.min(values))
        slot = (count + 1) % memory * bodies
        store = jax.tree.map(lambda s, o: jax.lax.dynamic_update_slice_in_dim(s, o, slot, 0), store, seen)
        better = merit_new > merit
        w, merit = jnp.where(better, w_new, w), jnp.maximum(merit, merit_new)
        return w, merit, store, multipliers, gain, count + 1

    start = (
        w,
        _merit(sphere, w, jnp.min(values)),
        store,
        jax.nn.one_hot(jnp.argmin(values), bodies * memory),
        jnp.full((), jnp.inf),
        jnp.zeros((), jnp.int32),
    )
    # The planes bound the gain from above where they are exact: 1e-8 m of it is not worth an observation.
    w, merit, *_ = jax.lax.while_loop(lambda s: (s[4] > 1e-8) & (s[5] < iterations), body, start)
    return Best(w, merit)


def max_min_step(sphere: Sphere, planes: Planes, longest: Scalar) -> Direction:
    """Step w, |w| <= longest, that raises the smallest plane seen from w = 0 the most: one QP, no observation.

    The epigraph at first order with a trace of damping, so that a flat optimum gives the shortest step."""
    dimension = sphere.curvature.shape[0]
    value, gradient = sphere.predict(jnp.zeros(dimension), planes)
    up = jnp.eye(dimension + 1)[-1]
    box = jnp.eye(dimension + 1)[:-1]
    lift = jnp.concatenate([-gradient, jnp.ones((*value.shape, 1))], axis=1)
    limits = jnp.concatenate([sphere.G, jnp.zeros((*sphere.h.shape, 1))], axis=1)
    G = jnp.concatenate([lift, limits, box, -box])
    h = jnp.concatenate([value - jnp.min(value), jnp.maximum(sphere.h, 0.0), jnp.full(2 * dimension, 1.0) * longest])
    w = solve_dense(1e-4 * jnp.diag(1 - up), -up, G, h).y[:-1]
    return w * jnp.minimum(1.0, longest / jnp.maximum(safe_norm(w), 1e-12))


def _tangent_step(sphere: Sphere, w, value, gradient, multipliers):
    """Step in R^D from the tangent QP at w, its multipliers for the planes, and the gain it predicts.

    Along the arc w -> unit(w + T d), a function with gradient g gains g'T d - 1/2 (g'w) |d|^2 to second order."""
    dimension = w.shape[0]
    tangent = null_basis(w[None, :])
    t0 = jnp.min(value)
    bend = jnp.sum(multipliers * (gradient @ w)) * jnp.eye(dimension - 1) + tangent.T @ sphere.curvature @ tangent
    # Where the objective bends upwards the QP is held convex; its rows and the box bound the step.
    lift = jnp.maximum(1e-3 - jnp.min(jnp.diag(bend) - _off_diagonal(bend)), 0.0)
    H = jnp.zeros((dimension, dimension)).at[:-1, :-1].set(bend + lift * jnp.eye(dimension - 1))
    box = jnp.eye(dimension)[:-1]
    rows = jnp.concatenate([-gradient @ tangent, sphere.G @ tangent])
    rise = jnp.concatenate([jnp.ones(value.shape), jnp.zeros(sphere.h.shape)])
    G = jnp.concatenate([jnp.concatenate([rows, rise[:, None]], axis=1), box, -box])
    h = jnp.concatenate([value - t0, jnp.maximum(sphere.h - sphere.G @ w, 0.0), jnp.full(2 * (dimension - 1), 0.5)])
    solution = solve_dense(H, -jnp.eye(dimension)[-1], G, h)
    return tangent @ solution.y[:-1], solution.multipliers[: value.shape[0]], solution.y[-1]


def _off_diagonal(a):
    return jnp.sum(jnp.abs(a), axis=1) - jnp.abs(jnp.diag(a))


def _backtrack(sphere: Sphere, w, step, store, merit):
    """Longest of the steps 1, 1/2, ..., 1/32 whose predicted merit is not below that of half of it."""
    fractions = 0.5 ** np.arange(6)
    arcs = jnp.stack([_unit(w + f * step) for f in fractions])
    merits = jax.vmap(lambda v: _merit(sphere, v, jnp.min(sphere.predict(v, store)[0])))(arcs)
    return arcs[jnp.argmax(merits)]


def interior_point(sphere: Sphere, planes: Planes, iterations: int = 24) -> Best:
    """Log barrier on the sphere: maximise t + mu (sum log(f_k(w) - t) + sum log(h - G w)), mu falling to 1e-6 m.

    t is eliminated (its optimum solves sum mu / (f_k - t) = 1), which leaves a smooth minimum of the bodies, pushed
    away from the joint limits. Newton steps in the tangent plane with the barrier's own curvature; a step that does
    not raise the barrier is halved; two steps for every mu.
    """
    dimension = sphere.curvature.shape[0]

    def barrier(w, values, mu):
        t = _epigraph(values, mu)
        room = jnp.maximum(sphere.h - sphere.G @ w, 1e-12)
        return t + mu * (jnp.sum(jnp.log(values - t)) + jnp.sum(jnp.log(room)))

    def newton(w, values, gradient, mu):
        tangent = null_basis(w[None, :])
        t = _epigraph(values, mu)
        weight = mu / (values - t)  # sums to 1
        room = jnp.maximum(sphere.h - sphere.G @ w, 1e-12)
        pull = weight @ gradient - (mu / room) @ sphere.G
        across = gradient - (weight @ gradient)[None, :]
        # d2(-barrier): the bodies' trade-off (t moves with the weighted mean), the limits, the sphere, J1.
        stiff = across.T @ ((weight / (values - t))[:, None] * across)
        stiff = stiff + sphere.G.T @ ((mu / room**2)[:, None] * sphere.G) + sphere.curvature
        bend = tangent.T @ stiff @ tangent + jnp.maximum(pull @ w, 1e-3) * jnp.eye(dimension - 1)
        step = jnp.linalg.solve(bend, tangent.T @ pull)
        return tangent @ (step * jnp.minimum(1.0, 0.5 / jnp.maximum(safe_norm(step), 1e-12)))

    def body(count, state):
        w, values, seen, scale, best, best_merit = state
        mu = 1e-2 * 0.45 ** (count // 2)
        _, gradient = sphere.predict(w, seen)
        w_new = _unit(w + scale * newton(w, values, gradient, mu))
        new_values, new_seen = sphere.observe(w_new)
        up = (barrier(w_new, new_values, mu) > barrier(w, values, mu)) & jnp.all(sphere.G @ w_new < sphere.h)
        w = jnp.where(up, w_new, w)
        values = jnp.where(up, new_values, values)
        seen = jax.tree.map(lambda new, old: jnp.where(up, new, old), new_seen, seen)
        merit = _merit(sphere, w, jnp.min(values))
        better = merit > best_merit
        scale = jnp.where(up, jnp.minimum(2 * scale, 1.0), 0.4 * scale)
        return w, values, seen, scale, jnp.where(better, w, best), jnp.maximum(merit, best_merit)

    w = first_guess(sphere, planes)
    values, seen = sphere.observe(w)
    merit = _merit(sphere, w, jnp.min(values))
    start = (w, values, seen, jnp.ones(()), w, merit)
    *_, w, merit = jax.lax.fori_loop(0, iterations, body, start)
    return Best(w, merit)


def _epigraph(values, mu):
    """t below all values with sum mu / (values - t) = 1: between min - K mu and min - mu; Newton on the convex side."""
    low = jnp.min(values) - values.shape[0] * mu

    def newton(_, t):
        gap = values - t
        # 1 / sum(mu / gap) is concave and nearly linear in t: a few steps from below suffice and never overshoot.
        total = jnp.sum(mu / gap)
        slope = jnp.sum(mu / gap**2)
        return t + (1 - total) * total / slope

    return jax.lax.fori_loop(0, 8, newton, low)


def adam(sphere: Sphere, planes: Planes, iterations: int = 40, rate: float = 0.15) -> Best:
    """Adam (optax) on the subgradient of the smallest f_k, projected onto the sphere after every step."""
    schedule = optax.cosine_decay_schedule(rate, iterations)
    optimiser = optax.adam(schedule)

    def body(_, state):
        w, momentum, best, best_merit = state
        values, seen = sphere.observe(w)
        merit = _merit(sphere, w, jnp.min(values))
        better = merit > best_merit
        best, best_merit = jnp.where(better, w, best), jnp.maximum(merit, best_merit)
        value, gradient = sphere.predict(w, seen)
        over = sphere.G @ w - sphere.h
        worst = jnp.argmax(over)
        # Minus the merit's subgradient, in the tangent plane.
        descent = -gradient[jnp.argmin(value)] + jnp.where(over[worst] > 0, 10.0, 0.0) * sphere.G[worst]
        descent = descent - (descent @ w) * w
        update, momentum = optimiser.update(descent, momentum, w)
        return _unit(w + update), momentum, best, best_merit

    w = first_guess(sphere, planes)
    start = (w, optimiser.init(w), w, jnp.full((), -jnp.inf))
    *_, w, merit = jax.lax.fori_loop(0, iterations, body, start)
    return Best(w, merit)


def cmaes(
    sphere: Sphere, planes: Planes, key: jax.Array, population: int = 100, generations: int = 5, sigma: float = 0.5
) -> Best:
    """CMA-ES over directions: samples are normalised before they are measured; the best one ever measured is kept.

    population and generations are the paper's; sigma, which the paper leaves open, covers a hemisphere at 0.5.
    """
    strategy = cma_es.rates(population, sphere.curvature.shape[0])

    def body(generation, state):
        distribution, best, best_merit = state
        samples = cma_es.ask(distribution, jax.random.fold_in(key, generation), population)
        directions = jax.vmap(_unit)(samples)
        merit = jax.vmap(lambda w: _merit(sphere, w, jnp.min(sphere.observe(w)[0])))(directions)
        top = jnp.argmax(merit)
        better = merit[top] > best_merit
        best = jnp.where(better, directions[top], best)
        return cma_es.tell(distribution, samples, -merit, strategy), best, jnp.maximum(merit[top], best_merit)

    w = first_guess(sphere, planes)
    state = (cma_es.start(w, sigma), w, jnp.full((), -jnp.inf))
    _, w, merit = jax.lax.fori_loop(0, generations, body, state)
    return Best(w, merit)
