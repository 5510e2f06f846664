"""Plans of the GP50 in the duct: what they record holds, checked by plain numpy over all points and all facets."""

import re
from dataclasses import replace
from functools import cache

import jax
import made_once
import numpy as np
import pytest
import toy

from htcp_jax.device.executor import EXECUTABLES
from htcp_jax.errors import InputError
from htcp_jax.model.kinematics import capsule_segments, tcp_position
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.motion import Problem
from htcp_jax.motion.start_check import check_start, start_contact
from htcp_jax.motion.step_functions import ADVANCE, ADVANCE_SMALLEST, CLEAR, PREPARE
from htcp_jax.planning.batch import plan
from htcp_jax.planning.methods import find
from htcp_jax.planning.registry import names
from htcp_jax.planning.tracking import StepQPs
from htcp_jax.planning.tracking.stages import ENTER
from htcp_jax.settings import Settings, settings_of
from htcp_jax.status import Status

PAPER = Settings(**made_once.PAPER_CHOICES)
QUICK = {"baseline", "nspace-sqp", "keep-clear", "cspace-sample"}
every_method = pytest.mark.parametrize(
    "method", [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in names()]
)


def scene():
    return made_once.robot(), made_once.duct()


def scenario(number=0, rotation=(0.4, 0.1), start=made_once.START, **changes):
    return make_scenario(*scene(), start, rotation=rotation, number=number, margin_m=0.0, **changes)


@cache
def poses():
    """Three poses of the workpiece sweep in which the baseline gets stuck: soon, later, and near the end."""
    return [scenario(0, (0.8, -0.3)), scenario(1, (0.4, 0.1)), scenario(2, (0.6, 0.0))]


@cache
def planned(method):
    return plan(Problem.of(*scene(), poses(), PAPER), method)


_ENDS, _TCP = made_once.quick_jit(capsule_segments), made_once.quick_jit(tcp_position)


def numpy_D(robot, workpiece, scenario, x):
    """D at x by brute force in the workpiece frame: every body, every point, every facet."""
    T = np.asarray(scenario.T_world_workpiece)
    p, q = (np.asarray(end) for end in _ENDS(robot, x))
    smallest, squares = np.inf, (workpiece.cloud**2).sum(axis=1)
    for k in range(len(p)):
        ends = (np.stack([p[k], q[k]]) - T[:3, 3]) @ T[:3, :3]
        d = ends[1] - ends[0]
        along = workpiece.cloud @ d - ends[0] @ d
        s = np.clip(along / (d @ d or 1.0), 0, 1)
        square = squares - 2 * workpiece.cloud @ ends[0] + ends[0] @ ends[0] - 2 * s * along + s * s * (d @ d)
        near = square <= square.min() + 1e-9  # all others are farther away, however the squares are rounded
        distance = np.linalg.norm(workpiece.cloud[near] - ends[0] - s[near, None] * d, axis=1).min()
        outside = (ends @ workpiece.hull_normal.T - workpiece.hull_offset).max(1)
        deep = np.array([p[k], q[k]]) @ scenario.interior_plane[:3] > scenario.interior_plane[3]
        smallest = min(smallest, distance - float(robot.capsule_radius[k]), *-outside[deep & (outside > 0)])
    return smallest


@every_method
def test_a_tracked_target_is_reached_clear_and_within_the_limits(method):
    """Tracked targets, checked independently: TCP error at most 1 mm, D > 0 over all points, and the same saved."""
    plans, (robot, duct) = planned(method), scene()
    tracked = np.argwhere(plans.status <= Status.TRACKED_AFTER_RECOVERY)
    assert len(tracked) > 60
    for s, t in tracked[:: 1 + len(tracked) // 60]:
        x = plans.x[s, t]
        tcp = np.asarray(_TCP(robot, x))
        np.testing.assert_allclose(plans.tcp[s, t], tcp, atol=1e-14)
        residual = np.linalg.norm(tcp - poses()[s].targets[t])
        np.testing.assert_allclose(plans.residual[s, t], residual, atol=1e-14)
        assert residual <= PAPER.tolerance_m
        D = numpy_D(robot, duct, poses()[s], x)
        np.testing.assert_allclose(plans.clearance[s, t], D, atol=1e-14)
        assert (x >= robot.lower).all() and (x <= robot.upper).all()
    assert (plans.clearance[tuple(tracked.T)] > 0).all()
    assert (plans.residual[tuple(tracked.T)] <= PAPER.tolerance_m).all()


@pytest.mark.parametrize("method", names())
def test_plans_are_consistent(method):
    """Consistency of plans: nothing after the first failure; recoveries and steps as the statuses say."""
    plans, own, settings = toy.plans_by(method), find(method), toy.SETTINGS
    assert plans.compile_s >= 0 and plans.run_s > 0
    for s, one in enumerate(toy.scenarios()):
        first = 0 if isinstance(own, StepQPs) else int(one.on_path)  # a beam may leave the lines before the path
        np.testing.assert_array_equal(plans.target[s, first : int(one.count)], one.targets[first:])
        status, count = plans.status[s, : int(one.count)], int(plans.tracked[s].sum())
        assert (status[:count] <= Status.TRACKED_AFTER_RECOVERY).all()
        assert (status[count + 1 :] == Status.NOT_ATTEMPTED).all() and not plans.exists[s, len(status) :].any()
        assert count == len(status) or status[count] not in (Status.NOT_ATTEMPTED, Status.TRACKED)
        np.testing.assert_array_equal(plans.recovery[s, : len(status)] > 0, status == Status.TRACKED_AFTER_RECOVERY)
        assert (plans.iterations[s, count + 1 :] == 0).all()
        if isinstance(own, StepQPs):
            back = plans.recovery[s] == own.backwards
            assert (plans.recovery[s][~back] <= len(own.stages)).all() and (own.replan_backwards or not back.any())
            tried = min(count + 1, len(status))
            assert (plans.iterations[s, :tried][~back[:tried]] >= 1).all()
            assert (plans.iterations[s, :count] <= settings.max_step_qps).all() or own.stages
        for rows in (plans.x, plans.tcp, plans.clearance, plans.residual, plans.joint_step):
            assert np.isfinite(rows[s, :count]).all() and np.isnan(rows[s, count:]).all()
        configurations = np.concatenate([[one.x_start], plans.x[s, :count]])
        np.testing.assert_allclose(plans.joint_step[s, :count], np.linalg.norm(np.diff(configurations, axis=0), axis=1))
        assert (plans.path_clear[s, :count] >= 0).all() and (plans.path_clear[s, count:] == -1).all()


def test_paths_are_called_clear_where_their_interpolated_configurations_are():
    """`path_clear`, compared with the clearance at interpolated configurations, for jumps and for small steps."""
    settings = replace(toy.SETTINGS, **made_once.PAPER_CHOICES)
    plans, blocked = toy.plans_by("cspace-sample", settings), 0
    fractions = np.arange(1, settings.path_steps)[:, None] / settings.path_steps
    for s, one in enumerate(toy.scenarios()):
        for t in np.flatnonzero(plans.tracked[s]):
            between = plans.before(s, t) + fractions * (plans.x[s, t] - plans.before(s, t))
            clear = bool((toy.measured(one, between)[0] > 0).all())
            assert plans.path_clear[s, t] == clear
            blocked += not clear
    assert blocked > 0 and plans.path_clear[plans.tracked].any()


def test_a_recovery_gets_further_than_the_baseline():
    tracked = {method: planned(method).tracked.sum() for method in ("baseline", "nspace-sqp")}
    assert tracked["nspace-sqp"] > tracked["baseline"] + 20


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="a GPU launches a loop's kernels one by one")
def test_on_a_cpu_a_kernel_is_one_native_function():
    """Check the lane functions that every method needs, and the start of self-motions, for loops outside native code.

    A library call in a loop, for example to LAPACK, would make XLA dispatch its parts one by one. No other test would
    fail, and everything would take twice the time.
    """
    planned("nspace-sqp")
    programs = made_once.compiled_from(EXECUTABLES, PREPARE, ADVANCE, ADVANCE_SMALLEST, CLEAR, ENTER)
    assert {lane_function.name for lane_function, _ in programs} >= {"prepare", "advance", "is_clear", "enter"}
    for lane_function, program in programs:
        assert " while(" not in program.as_text().partition("\nENTRY ")[2], lane_function.name


def test_an_unchecked_path_is_unknown():
    unchecked = replace(toy.SETTINGS, path_check="none")
    assert (toy.planned(method="baseline", settings=unchecked, check_paths=False).path_clear == -1).all()


def test_scenarios_of_different_lengths_and_tools_share_a_batch():
    """Shorter target lists and longer tools in one batch: each scenario with its own end, TCP and capsules."""
    plans, mixed = toy.plans_by(), toy.scenarios()
    assert len({int(one.count) for one in mixed}) > 1 and len({float(one.tool_extension_m) for one in mixed}) > 1
    for s, one in enumerate(mixed):
        count, tracked = int(one.count), plans.tracked[s]
        assert plans.exists[s, :count].all() and not plans.exists[s, count:].any()
        assert np.isnan(plans.x[s, count:]).all() and tracked.sum() > 5
        D, tcp = toy.measured(one, plans.x[s, tracked])
        np.testing.assert_allclose(plans.tcp[s, tracked], tcp, atol=1e-14)
        np.testing.assert_allclose(plans.clearance[s, tracked], D, atol=1e-14)


def test_progress_counts_up_to_everything_that_was_done():
    heard = []
    plans = toy.planned(method="baseline", progress=heard.append, threads=2, check_paths=False)
    last, several = heard[-1], toy.scenarios()
    assert last.scenarios_done == last.scenarios == len(several)
    assert last.targets == sum(int(one.count) for one in several)
    assert last.targets_tracked == (plans.status <= Status.TRACKED_AFTER_RECOVERY).sum(where=plans.exists)
    for field in ("scenarios_done", "targets_tracked"):
        counts = [getattr(p, field) for p in heard]
        assert counts == sorted(counts)


def test_the_start_itself_is_the_first_target():
    """First target at the start: tracked at once, without motion, where the start is clear."""
    plans = toy.plans_by("baseline")
    assert (plans.status[:, 0] == Status.TRACKED).all()
    np.testing.assert_allclose(plans.joint_step[:, 0], 0.0, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("check", ["recoveries", "all"])
def test_a_checked_path_is_never_blocked(check):
    settings = Settings(**{**made_once.PAPER_CHOICES, "path_check": check})
    plans = plan(Problem.of(*scene(), poses(), settings), "nspace-sqp")
    recovered = plans.status == Status.TRACKED_AFTER_RECOVERY
    must = recovered if check == "recoveries" else plans.status <= Status.TRACKED_AFTER_RECOVERY
    assert must.sum() > 2 and (plans.path_clear[must] == 1).all()


@pytest.mark.slow
def test_every_path_of_the_hybrid_is_clear():
    plans = planned("hybrid")
    assert (plans.path_clear[plans.status <= Status.TRACKED_AFTER_RECOVERY] == 1).all()


@pytest.mark.slow
def test_the_prose_of_the_paper_tracks_again_after_a_recovery():
    """after_recovery="track", as in the paper's prose: the step QP tracks again after a recovery.

    A recovered target is reached like any other. With the QP's cost about x_{t-1}, equation (4), it goes straight back
    to where it was stuck: no recovery lasts.
    """
    lasted = {}
    for about in ("reference", "previous"):
        settings = Settings(**{**made_once.PAPER_CHOICES, "cost_about": about}, after_recovery="track")
        plans = plan(Problem.of(*scene(), poses(), settings, check_paths=False), "nspace-sqp")
        recovered = plans.status == Status.TRACKED_AFTER_RECOVERY
        lasted[about] = recovered.sum()
        assert (plans.residual[recovered] <= settings.tolerance_m).all() and (plans.clearance[recovered] > 0).all()
    assert lasted["reference"] >= 1 and lasted["previous"] == 0


def test_what_cannot_be_planned_is_refused_by_name():
    with pytest.raises(InputError, match=r"'nspace-sqq' is not a method; did you mean nspace-sqp\? valid: baseline"):
        plan(Problem.of(*scene(), poses()), "nspace-sqq")
    with pytest.raises(InputError, match=r"q_weights has 2 values.*6 joints"):
        plan(Problem.of(*scene(), poses(), Settings(q_weights=(1.0, 1.0))), "baseline")
    with pytest.raises(InputError, match="no scenarios"):
        plan(Problem.of(*scene(), []), "baseline")
    with pytest.raises(InputError, match="'nosuch' is not installed"):
        plan(Problem.of(*scene(), poses(), Settings(qp="qpsolvers:nosuch")), "baseline")


def test_a_start_in_collision_is_refused_with_its_body_and_depth():
    robot, duct = scene()
    check_start(robot, duct, scenario())
    D, body, *_ = start_contact(robot, duct, scenario())
    np.testing.assert_allclose(D, numpy_D(robot, duct, scenario(), np.array(made_once.START)), atol=1e-14)
    stuck = scenario(start=np.load(made_once.RECORDED)["x"][1])
    deep, body, other, _ = start_contact(robot, duct, stuck)
    assert deep < 0 and other == "the workpiece"
    with pytest.raises(
        InputError, match=re.escape(f"start is in collision: {body} is {-1e3 * deep:.3f} mm inside the workpiece")
    ):
        check_start(robot, duct, stuck)


def test_settings_are_a_mapping_too():
    """Settings given as a mapping: the same plan (regression: an AttributeError)."""
    spelled = {**made_once.PAPER_CHOICES, "q_weights": [5, 5, 2, 1, 5, 10]}
    assert settings_of(spelled) == PAPER and settings_of(None) == settings_of({}) == Settings()
    assert settings_of(PAPER) is PAPER
    by_mapping = toy.planned(method="baseline", settings={"q_weights": [1, 1, 1, 1], "max_step_qps": 15})
    given = toy.planned(method="baseline", settings=Settings(q_weights=(1.0,) * 4, max_step_qps=15))
    np.testing.assert_array_equal(by_mapping.x, given.x)


def test_only_the_ratios_of_joint_weights_matter():
    given = toy.planned(method="baseline", settings=Settings(q_weights=(1.0,) * 4, max_step_qps=15))
    for factor in (1e-12, 1e12):
        scaled = toy.planned(method="baseline", settings=Settings(q_weights=(factor,) * 4, max_step_qps=15))
        np.testing.assert_array_equal(scaled.x, given.x)


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        ({"alpha": 0.1}, r"settings: unknown key alpha; did you mean alpha_rad\?"),
        ({"zzz": 0.1}, "settings: unknown key zzz; valid: q_weights, cost_about"),
        ({"alpha_rad": -1.0}, "settings: alpha_rad is -1.0: at least 1e-15 is needed"),
        ({"samples": "many"}, "settings: samples is 'many': input should be a valid integer"),
        (
            {"include_proximal_bodies": [1] * 100},
            r"settings: include_proximal_bodies is \[1, 1, 1, 1, 1, 1, ...\]: input should be a valid bool",
        ),
        ({"q_weights": [1.0]}, "q_weights has 1 values, but the robot gp50 has 6 joints"),
    ],
)
def test_wrong_settings_are_one_line(settings, line):
    with pytest.raises(InputError, match=line) as error:
        plan(Problem.of(*scene(), scenario(), settings), "baseline")
    assert "\n" not in str(error.value)
