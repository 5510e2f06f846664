"""Minimisers of J2 over the unit sphere, equation (11): the null-space direction w with the largest clearance.

    maximise  min_k f_k(w)   over |w| = 1,  G w <= h,     f_k(w) = D_k(x_ref + alpha N w) - J1

f_k belongs to body k. The objective is a minimum of functions, each of which is a minimum over points. It therefore has
kinks, and its maximum is usually at a kink. `observe` evaluates it exactly, which is expensive, and returns K contacts,
one per body. `predict` evaluates the distance to known contacts at another w. This is cheap, never less than f_k, and
equal to f_k if the contacts at w are known. The minimisers depend on robots and obstacles only through these functions.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from htcp_jax.backend import backend
from htcp_jax.numerics import null_basis, product, safe_norm, solve_spd, value_and_jacobian
from htcp_jax.solvers import cma_es
from htcp_jax.solvers.interior_point import solve_dense
from htcp_jax.types import Array, Bool, Float, Int, Scalar

Direction = Float[Array, "D"]
Observation: TypeAlias = PyTree[Array]  # contacts: the leading axis of every leaf has the length R, or a multiple of R


class Sphere(NamedTuple):
    """The maximisation problem in the module's docstring.

    `observe`, `measure` and `predict` return f_k [m], differentiable in w; J1(w) = 1/2 w' curvature w is already
    subtracted. w, G and h have no unit.
    """

    observe: Callable[[Direction], tuple[Float[Array, "K"], Observation]]
    measure: Callable[[Direction], Scalar]  # returns only min_k f_k(w), which is cheaper than `observe`
    predict: Callable[[Direction, Observation], Float[Array, "R"]]
    curvature: Float[Array, "D D"]
    G: Float[Array, "m D"]
    h: Float[Array, "m"]

    def predict_with_gradient(self, w: Direction, seen: Observation) -> tuple[Float[Array, "R"], Float[Array, "R D"]]:
        """Return the prediction [m] and its gradient by autodiff, from one evaluation."""
        return value_and_jacobian(lambda w: self.predict(w, seen), w)


class Best(NamedTuple):
    """A direction and its objective."""

    w: Direction
    value: Scalar  # min_k f_k(w), exact


def spread_directions(count: int, dimension: int) -> Float[np.ndarray, "count dimension"]:
    """Return fixed unit vectors: the positive and negative axes, then random ones from a fixed seed."""
    axes = np.concatenate([np.eye(dimension), -np.eye(dimension)])
    more = np.random.Generator(np.random.PCG64(0)).standard_normal((max(count, len(axes)), dimension))
    return np.concatenate([axes, more / np.linalg.norm(more, axis=1, keepdims=True)])[:count]


def _unit_direction(v: Direction) -> Direction:
    return v / jnp.maximum(safe_norm(v), 1e-300)


def _merit(sphere: Sphere, w: Direction, value: Scalar) -> Scalar:
    """Return the objective minus an exact penalty on joint limits, whose 10 m/rad are steeper than any clearance."""
    return value - 10.0 * jnp.max(jnp.maximum(product(sphere.G, w) - sphere.h, 0.0), initial=0.0)


def first_direction(sphere: Sphere, seen: Observation, key: jax.Array | None = None, count: int = 64) -> Direction:
    """Return the initial direction of a minimiser.

    With a key the direction is random, uniform on the sphere. Otherwise it is the best of `count` spread directions, as
    predicted by the given contacts.

    Args:
        sphere: The problem.
        seen: Contacts for the prediction.
        key: Random key; None: the best of the spread directions.
        count: Number of spread directions.
    """
    if key is not None:
        return _unit_direction(jax.random.normal(key, sphere.curvature.shape[:1]))
    directions = jnp.asarray(spread_directions(count, sphere.curvature.shape[0]))
    merit = jax.vmap(lambda w: _merit(sphere, w, jnp.min(sphere.predict(w, seen))))(directions)
    return directions[jnp.argmax(merit)]


def _better_of_two(sphere: Sphere) -> Best:
    """Return the better of the two directions 1 and -1, for D = 1."""
    directions = jnp.array([[1.0], [-1.0]])
    merit = jnp.stack([_merit(sphere, w, sphere.measure(w)) for w in directions])
    return Best(directions[jnp.argmax(merit)], jnp.max(merit))


def sqp(
    sphere: Sphere, seen: Observation, observations: int = 12, memory: int = 8, start_key: jax.Array | None = None
) -> Best:
    """Return the best direction by SQP on the epigraph: maximise t, with t <= the distance to every known contact.

    The method is an outer approximation: maximise the prediction from the known contacts, observe the result, and
    repeat from the best observed direction. The prediction is never less than the objective, so the search has reached
    a local maximum when no direction nearby is predicted to be better. Usually three observations are needed.

    Args:
        sphere: The problem.
        seen: Contacts of the current configuration.
        observations: Maximum number of observations.
        memory: Number of observations whose contacts are kept.
        start_key: Random key for the initial direction; None: see `first_direction`.
    """
    if sphere.curvature.shape[0] == 1:
        return _better_of_two(sphere)

    def body(search: _Search) -> _Search:
        values, new = sphere.observe(search.proposed)
        slot = search.count % memory * values.shape[0]
        store = jax.tree.map(lambda s, n: jax.lax.dynamic_update_slice_in_dim(s, n, slot, 0), search.store, new)
        now = Best(search.proposed, _merit(sphere, search.proposed, jnp.min(values)))
        best = jax.tree.map(lambda n, b: jnp.where(now.value > search.best.value, n, b), now, search.best)
        climb = _climb(sphere, best.w, store)
        more = ~climb.ended | (climb.merit > best.value + 1e-9)
        return _Search(best, climb.w, store, more, search.count + 1)

    w = first_direction(sphere, seen, start_key)
    store = jax.tree.map(lambda leaf: jnp.concatenate([leaf] * memory), seen)
    start = _Search(Best(w, jnp.full((), -jnp.inf)), w, store, jnp.full((), True), jnp.zeros((), jnp.int32))
    return jax.lax.while_loop(lambda search: search.more & (search.count < observations), body, start).best


class _Search(NamedTuple):
    """State of the SQP search."""

    best: Best  # best observed direction
    proposed: Direction  # next direction to observe
    store: Observation  # contacts of the last observations
    more: Bool[Array, ""]  # True: the proposed direction is predicted to be better
    count: Int[Array, ""]  # number of observations


class _Climb(NamedTuple):
    """State of a climb on the predicted merit."""

    w: Direction
    value: Float[Array, "R"]  # predicted distance at w to each known contact
    gradient: Float[Array, "R D"]
    merit: Scalar
    multipliers: Float[Array, "R"]  # multipliers of the previous QP
    radius: Scalar  # radius of the trust region; 0 at the end
    steps: Int[Array, ""]

    @property
    def ended(self) -> Bool[Array, ""]:
        """True if no step of any length is predicted to increase the merit."""
        return self.radius < 1e-6


def _climb(sphere: Sphere, w: Direction, seen: Observation, steps: int = 12) -> _Climb:
    """Maximise the predicted merit locally from w, by SQP steps within a trust region; return the last state."""

    def stepped(climb):
        step, multipliers, gain = _tangent_step(sphere, climb)
        return _unit_direction(climb.w + step), multipliers, gain, 0.25 * jnp.max(jnp.abs(step))

    def body(climb):
        begins = climb.steps < 0
        stay = lambda climb: (climb.w, climb.multipliers, jnp.full((), jnp.inf), climb.radius)  # noqa: E731
        w, multipliers, gain, shorter = jax.lax.cond(begins, stay, stepped, climb)
        value, gradient = sphere.predict_with_gradient(w, seen)
        merit = _merit(sphere, w, jnp.min(value))
        # After a step that gains too little, the next one is a quarter of it. If a QP predicts no gain, the climb ends.
        radius = jnp.where(merit - climb.merit > 0.1 * gain, jnp.minimum(2 * climb.radius, 0.5), shorter)
        radius = jnp.where(gain > 1e-10, radius, 0.0)
        there, here = (w, value, gradient, merit), (climb.w, climb.value, climb.gradient, climb.merit)
        higher = jax.tree.map(lambda new, old: jnp.where(begins | (merit > climb.merit), new, old), there, here)
        lowest = jax.nn.one_hot(jnp.argmin(value), value.shape[0])
        multipliers = jnp.where(begins, lowest, multipliers)
        return _Climb(*higher, multipliers, radius, climb.steps + 1)

    # The first iteration predicts at the initial w, so that the prediction is compiled only once.
    rows, dimension = jax.eval_shape(sphere.predict, w, seen).shape[0], w.shape[0]
    unknown = w, jnp.zeros(rows), jnp.zeros((rows, dimension)), jnp.full((), -jnp.inf), jnp.zeros(rows)
    start = _Climb(*unknown, jnp.full((), 0.5), jnp.full((), -1, jnp.int32))
    return jax.lax.while_loop(lambda climb: ~climb.ended & (climb.steps < steps), body, start)


def _tangent_step(sphere: Sphere, climb: _Climb) -> tuple[Direction, Float[Array, "R"], Scalar]:
    """Return the solution of the tangent QP at w: a step in R^D, the contacts' multipliers, and the predicted gain.

    The radius bounds the step's components in the tangent plane. Along the arc w -> unit(w + T d), a function with
    gradient g increases by g'T d - 1/2 (g'w) |d|^2 to second order. The QP includes this curvature and that of J1.
    """
    w, value, gradient, multipliers, radius = climb.w, climb.value, climb.gradient, climb.multipliers, climb.radius
    dimension = w.shape[0]
    tangent = null_basis(w[None, :])
    hessian = jnp.sum(multipliers * product(gradient, w)) * jnp.eye(dimension - 1) + product(
        tangent.T, product(sphere.curvature, tangent)
    )
    # A non-convex QP is made convex (Gershgorin); its rows and the box bound the step.
    disc = jnp.diag(hessian) - (jnp.sum(jnp.abs(hessian), axis=1) - jnp.abs(jnp.diag(hessian)))
    regularisation = jnp.maximum(1e-3 - jnp.min(disc), 0.0)
    H = jnp.pad(hessian + regularisation * jnp.eye(dimension - 1), (0, 1))
    box = jnp.eye(dimension)[:-1]
    rows = jnp.concatenate([-product(gradient, tangent), product(sphere.G, tangent)])
    rise = jnp.concatenate([jnp.ones(value.shape), jnp.zeros(sphere.h.shape)])
    G = jnp.concatenate([jnp.concatenate([rows, rise[:, None]], axis=1), box, -box])
    slack = jnp.maximum(sphere.h - product(sphere.G, w), 0.0)
    h = jnp.concatenate([value - jnp.min(value), slack, jnp.full(2 * (dimension - 1), 1.0) * radius])
    solution = solve_dense(H, -jnp.eye(dimension)[-1], G, h)
    return product(tangent, solution.y[:-1]), solution.multipliers[: value.shape[0]], solution.y[-1]


def max_min_step(sphere: Sphere, seen: Observation, longest: Scalar) -> Direction:
    """Return the step w from 0, |w| <= longest, that increases the smallest predicted distance the most.

    The step is the solution of one QP, the epigraph problem to first order, without an observation. Slight damping
    selects the shortest of several optimal steps.

    Args:
        sphere: The problem.
        seen: Contacts for the prediction.
        longest: Largest length of the step.
    """
    dimension = sphere.curvature.shape[0]
    value, gradient = sphere.predict_with_gradient(jnp.zeros(dimension), seen)
    up = jnp.eye(dimension + 1)[-1]
    box = jnp.eye(dimension + 1)[:-1]
    lift = jnp.concatenate([-gradient, jnp.ones((*value.shape, 1))], axis=1)
    limits = jnp.concatenate([sphere.G, jnp.zeros((*sphere.h.shape, 1))], axis=1)
    G = jnp.concatenate([lift, limits, box, -box])
    h = jnp.concatenate([value - jnp.min(value), jnp.maximum(sphere.h, 0.0), jnp.full(2 * dimension, 1.0) * longest])
    w = solve_dense(1e-4 * jnp.diag(1 - up), -up, G, h).y[:-1]
    return w * jnp.minimum(1.0, longest / jnp.maximum(safe_norm(w), 1e-12))


def interior_point(sphere: Sphere, seen: Observation, iterations: int = 24, start_key: jax.Array | None = None) -> Best:
    """Return the best direction by a log barrier: maximise t + mu (sum log(f_k(w) - t) + sum log(h - G w)).

    mu decreases to 1e-7 m, with two steps for every mu. t is eliminated: its optimum solves sum mu / (f_k - t) = 1.
    This leaves a smooth approximation of the minimum over the bodies, with a barrier at the joint limits. The steps are
    Newton steps in the tangent plane with the barrier's curvature. A step that does not increase the objective is
    rejected, and the next step is shorter.

    Args:
        sphere: The problem.
        seen: Contacts of the current configuration.
        iterations: Number of Newton steps, with one observation each.
        start_key: Random key for the initial direction; None: see `first_direction`.
    """
    dimension = sphere.curvature.shape[0]
    if dimension == 1:
        return _better_of_two(sphere)

    def barrier(w, values, mu):
        t = _epigraph(values, mu)
        slack = jnp.maximum(sphere.h - product(sphere.G, w), 1e-12)
        return t + mu * (jnp.sum(jnp.log(values - t)) + jnp.sum(jnp.log(slack)))

    def newton(w, values, gradient, mu):
        tangent = null_basis(w[None, :])
        t = _epigraph(values, mu)
        weight = mu / (values - t)  # the sum is 1
        slack = jnp.maximum(sphere.h - product(sphere.G, w), 1e-12)
        pull = product(weight, gradient) - product(mu / slack, sphere.G)
        across = gradient - product(weight, gradient)[None, :]
        # Hessian of the negative barrier: terms of the bodies (t moves with the weighted mean), limits, sphere and J1.
        stiff = product(across.T, (weight / (values - t))[:, None] * across)
        stiff = stiff + product(sphere.G.T, (mu / slack**2)[:, None] * sphere.G) + sphere.curvature
        hessian = product(tangent.T, product(stiff, tangent)) + jnp.maximum(product(pull, w), 1e-3) * jnp.eye(
            dimension - 1
        )
        step = solve_spd(hessian, product(tangent.T, pull))
        return product(tangent, step * jnp.minimum(1.0, 0.5 / jnp.maximum(safe_norm(step), 1e-12)))

    def body(count, state):
        w, values, seen, scale, best, best_merit = state
        mu = 1e-2 * 0.35 ** (count // 2)
        _, gradient = sphere.predict_with_gradient(w, seen)
        w_new = _unit_direction(w + scale * newton(w, values, gradient, mu))
        new_values, new_seen = sphere.observe(w_new)
        up = (barrier(w_new, new_values, mu) > barrier(w, values, mu)) & jnp.all(product(sphere.G, w_new) < sphere.h)
        w = jnp.where(up, w_new, w)
        values = jnp.where(up, new_values, values)
        seen = jax.tree.map(lambda new, old: jnp.where(up, new, old), new_seen, seen)
        merit = _merit(sphere, w, jnp.min(values))
        better = merit > best_merit
        scale = jnp.where(up, jnp.minimum(2 * scale, 1.0), 0.4 * scale)
        return w, values, seen, scale, jnp.where(better, w, best), jnp.maximum(merit, best_merit)

    w = first_direction(sphere, seen, start_key)
    values, seen = sphere.observe(w)
    merit = _merit(sphere, w, jnp.min(values))
    start = (w, values, seen, jnp.ones(()), w, merit)
    *_, w, merit = jax.lax.fori_loop(0, iterations, body, start)
    return Best(w, merit)


def _epigraph(values, mu):
    """Return t below all values with sum mu / (values - t) = 1, by Newton on the convex side.

    t lies between min(values) - K mu and min(values) - mu.
    """
    low = jnp.min(values) - values.shape[0] * mu

    def newton(_, t):
        gap = values - t
        # 1 / sum(mu / gap) is concave and nearly linear in t: a few steps from below are enough, and never overshoot.
        total = jnp.sum(mu / gap)
        slope = jnp.sum(mu / gap**2)
        return t + (1 - total) * total / slope

    # On a GPU every iteration of a loop takes at least one launch, for which the host waits.
    return jax.lax.fori_loop(0, 8, newton, low, unroll=None if backend().is_cpu else 8)


def adam(
    sphere: Sphere, seen: Observation, iterations: int = 40, rate: float = 0.15, start_key: jax.Array | None = None
) -> Best:
    """Return the best direction by Adam (optax) on the gradient of J2, projected onto the sphere after every step.

    Args:
        sphere: The problem.
        seen: Contacts of the current configuration, for the initial direction.
        iterations: Number of steps.
        rate: Learning rate of the first step, no unit; it decreases to 0 by a cosine schedule.
        start_key: Random key for the initial direction; None: see `first_direction`.
    """
    import optax  # here, as this import takes half a second

    schedule = optax.cosine_decay_schedule(rate, iterations)
    optimiser = optax.adam(schedule)

    def body(_, state):
        w, momentum, best, best_merit = state
        value, gradient = jax.value_and_grad(sphere.measure)(w)
        merit = _merit(sphere, w, value)
        better = merit > best_merit
        best, best_merit = jnp.where(better, w, best), jnp.maximum(merit, best_merit)
        over = product(sphere.G, w) - sphere.h
        worst = jnp.argmax(over)
        # Negative subgradient of the merit, in the tangent plane.
        descent = -gradient + jnp.where(over[worst] > 0, 10.0, 0.0) * sphere.G[worst]
        descent = descent - product(descent, w) * w
        with jax.numpy_dtype_promotion("standard"):  # optax raises a float to the power of its int32 count
            update, momentum = optimiser.update(descent, momentum, w)
        return _unit_direction(w + update), momentum, best, best_merit

    w = first_direction(sphere, seen, start_key)
    start = (w, optimiser.init(w), w, jnp.full((), -jnp.inf))
    *_, w, merit = jax.lax.fori_loop(0, iterations, body, start)
    return Best(w, merit)


def cmaes(
    sphere: Sphere,
    seen: Observation,
    key: jax.Array,
    population: int = 100,
    generations: int = 5,
    sigma: float = 0.5,
    start_key: jax.Array | None = None,
) -> Best:
    """Return the best direction measured by CMA-ES; samples are normalised before they are measured.

    Args:
        sphere: The problem.
        seen: Contacts of the current configuration, for the initial direction.
        key: Random key of the samples.
        population: Number of samples per generation; by default as in the paper.
        generations: Number of generations; by default as in the paper.
        sigma: Initial standard deviation, no unit; not given in the paper. 0.5 covers a hemisphere.
        start_key: Random key for the initial direction; None: see `first_direction`.
    """
    strategy = cma_es.strategy_parameters(population, sphere.curvature.shape[0])

    def body(generation, state):
        distribution, best, best_merit = state
        samples = cma_es.ask(distribution, jax.random.fold_in(key, generation), population)
        directions = jax.vmap(_unit_direction)(samples)
        merit = jax.vmap(lambda w: _merit(sphere, w, sphere.measure(w)))(directions)
        top = jnp.argmax(merit)
        better = merit[top] > best_merit
        best = jnp.where(better, directions[top], best)
        return cma_es.tell(distribution, samples, -merit, strategy), best, jnp.maximum(merit[top], best_merit)

    w = first_direction(sphere, seen, start_key)
    state = (cma_es.start(w, sigma), w, jnp.full((), -jnp.inf))
    _, w, merit = jax.lax.fori_loop(0, generations, body, state)
    return Best(w, merit)
