"""Smoothing: motions become cheaper in equation (3) and stay motions; nothing else in a plan changes."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
import toy
from scipy.optimize import minimize
from small_motions import (
    SMALL,
    check_motions,
    check_rows,
    first_of,
    in_duct,
    plan_by_beam,
    planned,
    poses,
    same,
    scenario,
    segments,
)

from htcp_jax.errors import InputError
from htcp_jax.model.kinematics import jacobian, tcp_position
from htcp_jax.motion import CollisionChecker, ViaPoints, smoothing
from htcp_jax.motion.motion_check import RequiredMargins, verify_motions
from htcp_jax.motion.plans import ARRAYS
from htcp_jax.planning.batch import plan

SMOOTH = replace(SMALL, smooth=True)
NARROW = replace(SMALL, path_tolerance_m=3e-4, path_check="none")  # with these, motions of step QPs end early
_TCPS, _JACOBIANS = (jax.jit(jax.vmap(of, in_axes=(None, 0))) for of in (tcp_position, jacobian))


@cache
def smoothed():
    return plan_by_beam(poses(), SMOOTH, threads=1)


@cache
def of_baseline(smooth):
    """Baseline plans, tracked further than they are a motion."""
    return plan(in_duct(poses(), replace(NARROW, smooth=smooth), threads=1), "baseline")


def steps(plans, s):
    """Steps of all joint paths of a motion, via points included (n, N)."""
    return np.concatenate([np.diff(configurations, axis=0) for _, configurations in segments(plans, s)])


def cost(plans, s):
    """Cost of equation (3) with weights of 1."""
    return float((steps(plans, s) ** 2).sum())


def dwells(plans, s):
    """Targets before which the arm changes its configuration."""
    return set(plans.via_points.target[plans.via_points.scenario == s].tolist())


def smooth_again(scenarios, plans, settings=SMOOTH, **changes):
    """Change these plans, validate and smooth them, as if a method had made them."""
    plans = plans._replace(**{name: array.copy() for name, array in plans.arrays().items()})._replace(**changes)
    problem = in_duct(scenarios, settings, threads=1)
    plans = smoothing.smooth(problem, verify_motions(problem, plans))
    return verify_motions(problem, plans)


@pytest.mark.parametrize(
    ("before", "after", "settings"),
    [(planned, smoothed, SMOOTH), (lambda: of_baseline(False), lambda: of_baseline(True), NARROW)],
    ids=["beam", "baseline"],
)
def test_the_same_targets_by_a_cheaper_motion(before, after, settings):
    """Cheaper motions to the same targets.

    200 configurations on every joint path are checked; rows keep the margin; dwells are dropped, none is added.
    """
    before, after = before(), after()
    assert (after.executable == before.executable).all() and (after.status == before.status).all()
    check_motions(poses(), after, settings.tube_m)
    check_rows(poses(), after, settings)
    for s in range(3):
        assert cost(after, s) < 0.98 * cost(before, s) and dwells(after, s) <= dwells(before, s)
    assert sum(cost(after, s) for s in range(3)) < 0.7 * sum(cost(before, s) for s in range(3))
    longest = [max(np.linalg.norm(steps(plans, s), axis=1).max() for s in range(3)) for plans in (before, after)]
    assert longest[1] < 0.8 * longest[0]


def test_dwells_go_where_there_is_a_straight_way():
    assert any(dwells(planned(), s) for s in range(3)) and not any(dwells(smoothed(), s) for s in range(3))


def test_what_is_no_motion_stays_to_the_last_bit():
    """Rows after the end of a motion, and its last configuration before a lost target: bitwise unchanged."""
    before, after = of_baseline(False), of_baseline(True)
    assert (before.tracked.sum(axis=1) > before.executable.sum(axis=1)).sum() >= 2
    for s, one in enumerate(poses()):
        end = int(before.executable[s].sum())
        for name in ARRAYS:
            if name != "start":
                a, b = (getattr(plans, name)[s, end : int(one.count)] for plans in (before, after))
                np.testing.assert_array_equal(a, b, err_msg=name)
        np.testing.assert_array_equal(before.start[s], after.start[s])
        if before.tracked[s].sum() > end:
            np.testing.assert_array_equal(before.x[s, end - 1], after.x[s, end - 1])
    assert (after.path_clear == before.path_clear).all() and (after.iterations == before.iterations).all()


def test_via_points_behind_the_end_of_a_motion_stay():
    before = of_baseline(False)
    s = 0
    lost = int(before.executable[s].sum())
    beyond = ViaPoints.of([(s, lost, before.x[s, [lost]]), (s, lost + 3, before.x[s, [lost, lost + 3]])], 6)
    after = smooth_again(poses(), before, replace(NARROW, smooth=True), via_points=beyond)
    assert all(np.array_equal(a, b) for a, b in zip(after.via_points, beyond, strict=True))
    assert cost(after, s) < 0.9 * cost(before, s)


def test_a_scenario_without_a_motion_is_left_alone():
    """Scenario without a motion: unchanged, next to one with a motion."""
    one = first_of(scenario(2, (0.4, 0.0)), 6)
    lost = replace(one, targets=one.targets + 5.0)
    plans = plan_by_beam([lost, one], SMOOTH)
    assert not plans.tracked[0].any() and plans.executable[1].all()
    same(plans, 1, plan_by_beam([one], SMOOTH), 0, 6)
    assert not plan_by_beam([lost], SMOOTH).tracked.any()


class Counting(CollisionChecker):
    """Collision checker that counts the configurations and joint paths that it is called with."""

    lanes = 0

    def states(self, inputs, q):
        self.lanes += len(q)
        return super().states(inputs, q)

    def edges(self, inputs, a, b, *others, **how):
        self.lanes += len(a)
        return super().edges(inputs, a, b, *others, **how)


@pytest.mark.parametrize("anywhere", [False, True])
def test_what_another_step_has_shown_is_not_computed_again(anywhere):
    """Same bits for a partly shortened step, with less work, from the full step as from no step."""
    problem = in_duct(poses(), SMOOTH, threads=1)
    plans, checker = verify_motions(problem, planned()), Counting(problem.checkers[0].executor, problem.settings)
    paths = [smoothing.SmoothedPath.of(problem, plans, plans.outcomes.of(s)) for s in range(3)]
    for path in paths:
        path.begins_anywhere = anywhere
        path.x[0] = path.x[1] if anywhere else path.x[0]
    margins = RequiredMargins(problem, plans, reduced=True)
    smoother, rng = smoothing.Smoothing(problem, checker, margins), np.random.default_rng(0)
    smoother._look(paths)
    full = [
        np.where(rng.random((len(path.target), 1)) < 0.8, rng.normal(0, 4e-3, path.x[1:].shape), 0) for path in paths
    ]
    shares = [np.repeat(rng.choice([0.0, 0.5, 1.0, 1.0], len(y) // 6 + 1), 6)[: len(y), None] for y in full]
    nothing = [smoothing.Candidate.standing(path) for path in paths]
    last = smoother._candidates(list(zip(paths, full, nothing, strict=True)))
    found, lanes = [], []
    for known in (nothing, last):
        before = checker.lanes
        steps = [share * y for share, y in zip(shares, full, strict=True)]
        found.append(smoother._candidates(list(zip(paths, steps, known, strict=True))))
        lanes.append(checker.lanes - before)
    jax.tree.map(np.testing.assert_array_equal, *found)
    for each in ("valid", "proven"):
        flags = np.concatenate([getattr(candidate, each) for candidate in found[0]])
        assert flags.any() and not flags.all()
    assert lanes[1] < 0.9 * lanes[0]


def test_the_processes_that_solve_the_qps_have_no_influence(monkeypatch):
    """Same bits from two threads that share two processes as from one that solves its QPs itself."""
    monkeypatch.setattr(smoothing, "FEW_QPS", 2)
    problem = in_duct(poses(), SMOOTH, threads=1)
    plans = verify_motions(problem, planned())
    margins = RequiredMargins(problem, plans, reduced=True)

    def run(workers):
        paths = [smoothing.SmoothedPath.of(problem, plans, plans.outcomes.of(s)) for s in range(3)]
        smoothing.Smoothing(problem, problem.checkers[0], margins, workers).run(paths)
        return [path.x for path in paths]

    with ThreadPoolExecutor(2) as pool:
        shared = list(pool.map(run, [2, 2]))
    for found in shared:
        jax.tree.map(np.testing.assert_array_equal, found, run(1))


def test_a_smooth_motion_has_next_to_nothing_left_to_gain():
    """Second smoothing: it reduces the cost by a few per cent at most, and never increases it."""
    again = smooth_again(poses(), smoothed())
    for s in range(3):
        assert 0.95 * cost(smoothed(), s) < cost(again, s) <= cost(smoothed(), s)


def test_where_nothing_is_in_collision_it_is_the_shortest_path_over_the_targets():
    """Shortest path over the targets where no obstacle is near, by a dense optimiser.

    A few targets of the approach, before the walls are near.
    """
    one, robot = first_of(scenario(2, (0.4, 0.0)), 8), made_once.robot()
    plans = plan_by_beam([one], SMOOTH)
    shape = 8, 6
    path = lambda y: np.concatenate([one.x_start[None], y.reshape(shape)])  # noqa: E731
    on_target = {
        "type": "eq",
        "fun": lambda y: (np.asarray(_TCPS(robot, jnp.asarray(y.reshape(shape)))) - one.targets).ravel(),
        "jac": lambda y: jax.scipy.linalg.block_diag(*np.asarray(_JACOBIANS(robot, jnp.asarray(y.reshape(shape))))),
    }
    V = np.kron(np.eye(8) - np.eye(8, k=-1), np.eye(6))
    slope = lambda y: 2 * V.T @ np.diff(path(y), axis=0).ravel()  # noqa: E731
    found = minimize(
        lambda y: (np.diff(path(y), axis=0) ** 2).sum(), plans.x[0].ravel(), jac=slope, constraints=on_target,
        method="SLSQP", options={"ftol": 1e-12},
    )  # fmt: skip
    assert plans.executable.all() and plans.clearance.min() > 0.005 and found.success
    assert found.fun <= cost(plans, 0) * 1.001 and cost(plans, 0) < 1.01 * found.fun


def test_a_heavy_joint_moves_less():
    """Weighted joint: it moves less, and the weighted cost falls more than without the weight."""
    weights = np.ones(6)
    free = steps(smoothed(), 0)
    most = int((free**2).sum(axis=0).argmax())
    weights[most] = 30.0
    plans = plan_by_beam(poses()[0], replace(SMOOTH, path_weights=tuple(weights)))
    heavy = steps(plans, 0)
    assert (plans.executable[0] == smoothed().executable[0][: plans.executable.shape[1]]).all()
    assert (heavy**2).sum(axis=0)[most] < 0.8 * (free**2).sum(axis=0)[most]
    assert (weights * heavy**2).sum() < (weights * free**2).sum()
    check_motions(poses()[:1], plans, SMOOTH.tube_m)


def test_weights_of_another_arm_are_refused():
    with pytest.raises(InputError, match=r"path_weights has 2 values, but the robot gp50 has 6 joints"):
        plan_by_beam(poses()[0], replace(SMOOTH, path_weights=(1.0, 1.0)))


def test_it_is_for_the_settings_to_say_and_for_the_method_to_wish():
    """Smoothing by the settings, else by the method's default.

    The `beam` method is smoothed by default, the baseline is not; without path checks there are no motions to
    smooth.
    """

    def made(method, smooth, **more):
        of = toy.scenarios()[:2]
        return toy.planned(of, method, replace(toy.SETTINGS, smooth=smooth), **more).x

    for method, wishes in (("beam", True), ("baseline", False)):
        plain, smoothed = made(method, False), made(method, True)
        assert not np.array_equal(plain, smoothed)
        np.testing.assert_array_equal(made(method, None), smoothed if wishes else plain)
        np.testing.assert_array_equal(made(method, True, check_paths=False), plain)
