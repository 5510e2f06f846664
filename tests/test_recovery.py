"""Recovery strategies: each follows the paper's algorithm and returns only valid configurations."""

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
import toy
from sphere_references import place

from htcp_jax.clearance import clearances, contacts, is_clear, minimum_clearance
from htcp_jax.device import Executor
from htcp_jax.model.kinematics import jacobian, tcp_position
from htcp_jax.model.scenario import stack
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.planning.methods import BUILT_IN
from htcp_jax.planning.tracking import StepQPs
from htcp_jax.planning.tracking.null_space import (
    StuckScenario,
    anchor,
    null_space_step,
    seen_rows,
    sphere_problem,
    stuck_key,
)
from htcp_jax.planning.tracking.sampling import cspace_samples, nspace_samples
from htcp_jax.planning.tracking.stages import ASCEND, ENTER
from htcp_jax.settings import Settings
from htcp_jax.solvers import sphere

RNG = np.random.default_rng(0)
SETTINGS = Settings()


@cache
def jitted(function, settings):
    """`function(scene, settings, ...)`, compiled once for all tests."""
    return made_once.quick_jit(lambda scene, *rest: function(scene, settings, *rest))


def run(function, *rest, settings=SETTINGS):
    return jax.tree.map(np.asarray, jitted(function, settings)(made_once.scene(), *rest))


_D = made_once.quick_jit(minimum_clearance)
_CLEAR = made_once.quick_jit(jax.vmap(is_clear, (None, None, None, 0)))
AHEAD = np.array([0.0, 3e-3, 0.0])
_TCP, _JACOBIAN = made_once.quick_jit(tcp_position), made_once.quick_jit(jacobian)


def D(where, x):
    return float(_D(*made_once.scene()[:2], where, jnp.asarray(x)))


def tcp(x):
    return np.asarray(_TCP(made_once.robot(), jnp.asarray(x)))


def stuck_places(count):
    """Yield (where, x, target) at or near recorded configurations at which the baseline got stuck."""
    for k in range(0, 200, 200 // count):
        where, x = place(k)
        yield where, x, jnp.asarray(tcp(x))


def stuck_lanes(count):
    """Places as `stuck_places` yields them, and the lanes' inputs and configurations for an executor."""
    places, nominal = list(stuck_places(count)), jax.tree.map(np.asarray, made_once.nominal())
    poses = [replace(nominal, **jax.tree.map(np.asarray, where)._asdict()) for where, _, _ in places]
    inputs = lane_inputs(stack(poses), np.arange(count), np.zeros(count, int))
    return (
        places,
        inputs._replace(target=np.stack([target for _, _, target in places])),
        np.stack([x for _, x, _ in places]),
    )


def executor():
    """Executor with the settings of `test_planner.py`, whose programs are the same."""
    return Executor(made_once.scene(), Settings(**made_once.PAPER_CHOICES))


def directions(count):
    w = RNG.normal(size=(count, 3))
    return w / np.linalg.norm(w, axis=1, keepdims=True)


# Equation (11)


def _look(scene, settings, where, x_ref, w):
    problem, _, reach = sphere_problem(scene, settings, where, x_ref)
    x = x_ref + reach @ w
    return problem.observe(w)[0], problem.measure(w), problem.h - problem.G @ w, x, clearances(*scene[:2], where, x)


PAPER = Settings(j1_weight=1.0, alpha_rad=0.05, include_proximal_bodies=False)


def test_j2_is_minus_D_plus_j1_on_a_step_of_length_alpha_in_the_null_space(settings=PAPER):
    for where, x_ref, _ in stuck_places(8):
        (w,) = directions(1)
        values, smallest, free_radius, x, every = run(_look, where, x_ref, jnp.asarray(w), settings=settings)
        step = x - np.asarray(x_ref)
        np.testing.assert_allclose(np.linalg.norm(step), settings.alpha_rad, rtol=1e-12)
        assert np.linalg.norm(tcp(x) - tcp(x_ref)) < 2 * settings.alpha_rad**2
        j1 = settings.j1_weight * np.sum(settings.q_weights * step**2)
        seen = np.array(seen_rows(made_once.scene(), settings.include_proximal_bodies))
        assert seen.sum() == 5
        np.testing.assert_allclose(values[seen], every[seen] - j1, atol=1e-14)
        np.testing.assert_allclose(smallest, every[seen].min() - j1, atol=1e-14)
        assert (values[~seen] > 5.0).all()
        robot = made_once.robot()
        np.testing.assert_allclose(free_radius, np.concatenate([robot.upper - x, x - robot.lower]), atol=1e-12)


def _predict(scene, settings, where, x_ref, seen_at, w):
    """Predict values and gradients at w from the contacts observed at `seen_at` (R, D).

    Also returns the gradients by central differences, the true values, and whether the contacts are planes.
    """
    problem, _, reach = sphere_problem(scene, settings, where, x_ref)
    looks = [problem.observe(v)[1] for v in seen_at]
    seen = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *looks)
    sides = [jnp.stack([problem.predict(w + step * axis, seen) for axis in jnp.eye(len(w))]) for step in (1e-6, -1e-6)]
    slope = (sides[0] - sides[1]).T / 2e-6
    crossed = jnp.concatenate([contacts(*scene[:2], where, x_ref + reach @ v).plane for v in seen_at])
    return problem.predict_with_gradient(w, seen), slope, problem.observe(w)[0], crossed


def test_contacts_seen_predict_the_truth_where_they_were_seen_and_never_less_elsewhere(settings=PAPER):
    """Check predictions: equal to the true value where observed and never less elsewhere, as they lack unseen points.

    The only exception is an end that leaves the hull through another facet or leaves the interior: these contacts are
    excluded here.
    """
    loose = 0
    for where, x_ref, _ in stuck_places(8):
        first, second, other = jnp.asarray(directions(3))
        for w, at in ((first, 0), (second, 8), (other, None)):
            both = jnp.stack([first, second])
            (value, gradient), slope, truth, crossed = run(_predict, where, x_ref, both, w, settings=settings)
            np.testing.assert_allclose(gradient, slope, atol=1e-8)
            if at is not None:
                np.testing.assert_allclose(value[at : at + 8], truth, atol=1e-14)
            real = ~crossed
            assert (value[real] >= np.tile(truth, 2)[real] - 1e-13).all()
            loose += np.sum(value[real] > np.tile(truth, 2)[real] + 1e-6)
    assert loose > 20


# Steps


def _best_guess(problem, seen, key, settings):
    w = sphere.first_direction(problem, seen)
    return sphere.Best(w, problem.measure(w))


_STEP = partial(null_space_step, _best_guess)


def test_a_null_space_step_ends_on_the_target_and_says_how_clear_it_is():
    """Algorithm 1, lines 11 to 13: a step of about alpha, re-anchored if the residual exceeds the tolerance."""
    better = []
    for where, x_ref, target in stuck_places(10):
        here = run(_STEP, where, StuckScenario(x_ref, target, jax.random.key(0)), x_ref, 0)
        np.testing.assert_allclose(here.residual, np.linalg.norm(tcp(here.x) - target), atol=1e-14)
        assert here.residual <= SETTINGS.tolerance_m
        np.testing.assert_allclose(here.clearance, D(where, here.x), atol=1e-14)
        assert 0.5 * SETTINGS.alpha_rad < np.linalg.norm(here.x - x_ref) < 1.5 * SETTINGS.alpha_rad
        better.append(here.clearance - D(where, x_ref))
    assert np.mean(np.array(better) > 0) >= 0.8


def test_a_recovery_begins_on_its_target_next_to_the_configuration_before():
    """Algorithm 1, line 9: the shortest joint motion, to first order, regardless of obstacles."""
    places, inputs, before = stuck_lanes(4)
    found = executor()(ENTER, inputs._replace(target=inputs.target + AHEAD), before)
    for k, (where, x, target) in enumerate(places):
        ahead, now = np.asarray(target) + AHEAD, found.x[k]
        assert np.linalg.norm(tcp(now) - ahead) <= 0.1 * SETTINGS.tolerance_m
        shortest = np.linalg.pinv(_JACOBIAN(made_once.robot(), x)) @ (ahead - np.asarray(target))
        np.testing.assert_allclose(now - x, shortest, atol=3e-4)
        np.testing.assert_allclose(found.clearance[k], D(where, now), atol=1e-14)


def test_an_anchor_moves_only_what_is_off_by_more_than_the_tolerance():
    where, x, target = next(stuck_places(1))
    near = target + 0.9e-3 * jnp.array([1.0, 0.0, 0.0])
    np.testing.assert_array_equal(run(anchor, where, x, near).x, x)
    far = target + 5e-3 * jnp.array([0.0, 1.0, 0.0])
    moved = run(anchor, where, x, far)
    assert moved.residual <= 0.1 * SETTINGS.tolerance_m and not np.array_equal(moved.x, x)


def test_keep_clear_never_ends_worse_and_stays_on_the_target():
    (places, inputs, x), robot = stuck_lanes(20), made_once.robot()
    before = np.array([D(where, x) for where, x, _ in places])
    here = executor()(ASCEND, inputs, x)
    assert (here.clearance >= before).all() and (here.residual <= SETTINGS.tolerance_m).all()
    after = [D(where, own) for (where, _, _), own in zip(places, here.x, strict=True)]
    np.testing.assert_allclose(here.clearance, after, atol=1e-14)
    again = executor()(ASCEND, inputs, here.x)  # with little left to gain
    assert (again.clearance >= here.clearance).all()
    far = before >= SETTINGS.keep_clear_m
    np.testing.assert_array_equal(here.x[far], x[far])
    assert ((here.x <= np.asarray(robot.upper)) & (here.x >= np.asarray(robot.lower))).all()
    gained = (here.clearance - before)[~far]
    assert np.median(gained) > 1e-3


# Samples


def test_cspace_samples_are_feasible_and_move_joints_3_to_6_alone():
    """Check the first `samples` feasible draws within +-1 rad on joint 3 and +-2 rad on joints 4 to 6."""
    robot, obstacle = made_once.scene()[:2]
    for where, x, target in stuck_places(3):
        found = run(cspace_samples, where, StuckScenario(x, target, jax.random.key(1)))
        off = found.x - np.asarray(x)
        assert found.x.shape[0] == 8 * SETTINGS.samples
        np.testing.assert_array_equal(off[:, :2], 0.0)
        assert (np.abs(off) <= [0, 0, 1, 2, 2, 2]).all() and (np.abs(off).max(0)[2:] > [0.95, 1.9, 1.9, 1.9]).all()
        clear = np.asarray(_CLEAR(robot, obstacle, where, found.x))
        inside = ((found.x <= np.asarray(robot.upper)) & (found.x >= np.asarray(robot.lower))).all(1)
        feasible = clear & inside & (np.linalg.norm(off, axis=1) <= SETTINGS.max_sample_distance_rad)
        np.testing.assert_array_equal(found.valid, feasible & (np.cumsum(feasible) <= SETTINGS.samples))
        assert found.valid.any() and not found.done.any()


SHORT = Settings(samples=12, sample_steps=25)


def _nspace(scene, settings, where, stuck):
    return nspace_samples(scene, settings, where, stuck, (0.01, 0.04))


def test_nspace_samples_walk_their_length_and_stay_on_the_target():
    """Check self-motions in random directions at each step length: about 25 steps long where they are straight."""
    for where, x, target in stuck_places(2):
        stuck = StuckScenario(x, target, jax.random.key(1))
        found = run(_nspace, where, stuck, settings=SHORT)
        assert found.x.shape == (24, 6)
        error = np.array([np.linalg.norm(tcp(one) - target) for one in found.x])
        assert np.mean(error <= SHORT.tolerance_m) > 0.9
        far = np.linalg.norm(found.x - np.asarray(x), axis=1)
        short, long = far[:12], far[12:]
        assert (short < 25 * 0.01 * 1.3).all() and np.median(short) > 25 * 0.01 * 0.7
        assert np.median(long) > 2 * np.median(short)
        np.testing.assert_array_equal(found.valid, far <= SHORT.max_sample_distance_rad)
        other = run(_nspace, where, stuck._replace(key=jax.random.key(2)), settings=SHORT)
        assert not np.allclose(found.x, other.x, atol=1e-3)


# Keys, table


def test_a_random_key_belongs_to_one_scenario_one_target_one_stage_and_one_round():
    base = dict(seed=0, number=3, row=7, stage=0, round_=0)
    keys = [jax.random.bits(stuck_key(**{**base, **change})) for change in (
        {}, {"number": 4}, {"row": 8}, {"stage": 1}, {"round_": 1}, {"seed": 1},
    )]  # fmt: skip
    assert len({int(k) for k in keys}) == len(keys)


PAPERS = ["baseline", "cspace-sample", "nspace-sample", "nspace-sqp", "nspace-ip", "nspace-cmaes"]


def test_the_papers_six_come_first():
    assert [method.name for method in BUILT_IN][:6] == PAPERS
    assert not BUILT_IN[0].stages


STAGES = {
    f"{method.name} {k}": stage.lane_function(k)
    for method in BUILT_IN
    if isinstance(method, StepQPs)
    for k, stage in enumerate(method.stages)
}


@pytest.mark.parametrize("name", STAGES)
def test_every_stage_gives_what_its_kind_promises(name):
    """A self-motion returns a configuration on the target; a sampler returns candidates, and those done are clear."""
    plans, scenarios, several = toy.plans_by("baseline"), toy.scenarios(), np.arange(5)
    lower, upper = np.asarray(toy.robot().lower), np.asarray(toy.robot().upper)
    lost = plans.tracked.sum(axis=1)
    inputs, x = lane_inputs(stack(scenarios), several, lost), plans.before(several, lost)
    executor, zero = Executor(toy.scene(), toy.SETTINGS), np.zeros(5, np.int32)
    if STAGES[name].name.startswith("null space"):
        found, null_space_steps = executor(STAGES[name], inputs, x, x, zero, zero + 1)
        assert (null_space_steps == 1).all()
        assert (found.residual <= toy.SETTINGS.tolerance_m).all() and (found.x != x).any(axis=1).all()
        assert ((found.x >= lower) & (found.x <= upper)).all()
        return
    found = executor(STAGES[name], inputs, x)
    assert found.x.shape == (*found.valid.shape, 4) and found.done.shape == found.valid.shape
    assert found.valid.any(axis=1).all()
    for one, target, candidates, done in zip(scenarios, inputs.target, found.x, found.done, strict=True):
        D, at = toy.measured(one, candidates)
        assert (D[done] > 0).all() and (np.linalg.norm(at - target, axis=1)[done] <= toy.SETTINGS.tolerance_m).all()
