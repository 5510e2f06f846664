"""Rows of a path that repeat a place: the arm passes it in one configuration, without a stop."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import toy

from htcp_jax.errors import InputError
from htcp_jax.model import Task
from htcp_jax.model import scenario as scenarios
from htcp_jax.model.built_in_rows import AxisTowards
from htcp_jax.model.path_frames import tangents
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.motion import motion as motions
from htcp_jax.planning.batch import Progress
from htcp_jax.planning.repeated_targets import are_distinct
from htcp_jax.spec.config import ProgramConfig
from htcp_jax.status import Kind, SegmentStatus, Status
from htcp_jax.trajectory.blends import motion_slack
from htcp_jax.trajectory.limits import joint_limits
from htcp_jax.trajectory.program import time_motion

PATH = toy.workpiece().path[:6]
FIRST = 1  # target of the path's first point; target 0 is the start at the same place
TASK = Task(tolerance_m=toy.SETTINGS.tolerance_m)


def scenario(path, number=0):
    part = replace(toy.workpiece(), path=path)
    return make_scenario(toy.robot(), part, None, rotation=(0.0, 0.0), number=number)


@cache
def planned(counts=(1,) * 6, off_m=0.0, method="beam", **changes):
    """The plan of a path whose points have these numbers of rows, the odd ones moved along x, and its progress."""
    path = np.repeat(PATH, counts, axis=0)
    path[1::2, 0] += off_m
    reported: list[Progress] = []
    settings = replace(toy.SETTINGS, **changes)
    return toy.planned([scenario(path)], method, settings, reported.append, threads=1), reported


def rows_of(counts):
    """First row of each place, and the place of each row, among the targets."""
    first = FIRST + np.append(0, np.cumsum(counts)[:-1])
    return np.append(0, first), np.append(0, FIRST + np.repeat(np.arange(len(counts)), counts))


@pytest.mark.parametrize("method", ["beam", "baseline", "hybrid"])
def test_repeated_rows_have_the_configurations_of_the_path_with_each_row_once(method):
    counts = (2, 1, 3, 2, 1, 2)
    (once, _), (found, reported) = planned(method=method), planned(counts, method=method)
    first, place = rows_of(counts)
    assert once.executable.all() and found.executable.all() and found.status.shape[1] == len(place)
    assert np.array_equal(found.x[0], once.x[0, place]) and np.array_equal(found.tcp[0], once.tcp[0, place])
    for name in ("status", "iterations", "segment_clearance", "segment_status", "joint_step", "residual"):
        assert np.array_equal(getattr(found, name)[0, first], getattr(once, name)[0], equal_nan=True), name
    assert np.array_equal(found.via_points.target, first[once.via_points.target])
    assert reported[-1].targets == reported[-1].targets_tracked == len(place)


def test_a_repeated_row_is_passed_without_motion_by_its_clearance():
    found, _ = planned((2,) * 6)
    again = np.arange(FIRST + 1, found.status.shape[1], 2)
    assert (found.joint_step[0, again] == 0).all() and (found.iterations[0, again] == 0).all()
    assert (found.segment_status[0, again] == SegmentStatus.VALID).all()
    assert np.array_equal(found.segment_clearance[0, again], found.clearance[0, again])
    motion = motions.motion(found, 0, FIRST)
    assert not (motion.kind == Kind.DWELL).any() and not motions.dwells(found, FIRST).any()


def test_a_program_is_that_of_the_path_with_each_row_once():
    rate = (1.0,) * 4
    limits = joint_limits(toy.robot(), ProgramConfig(velocity=rate, acceleration=rate, jerk=(10.0,) * 4))
    timed = []
    for plans in (planned()[0], planned((2, 1, 3, 2, 1, 2))[0]):
        motion = motions.motion(plans, 0, FIRST, retract=True)
        slack = motion_slack(plans, 0, motion, toy.SETTINGS.tube_m, toy.robot())
        timed.append(time_motion(toy.robot(), motion, slack, limits, 0.02).timed(0.01))
    once, found = timed
    assert np.array_equal(once.time_s, found.time_s) and np.array_equal(once.x, found.x)
    assert np.array_equal(once.kind, found.kind) and not (found.kind == Kind.DWELL).any()


def test_figures_of_a_motion_are_those_of_the_path_with_each_row_once():
    for one, other in zip(
        motions.motion_figures(planned()[0], FIRST), motions.motion_figures(planned((3,) * 6)[0], FIRST), strict=True
    ):
        assert np.array_equal(one, other, equal_nan=True)


def test_rows_a_few_micrometres_apart_are_one_place_and_have_their_own_errors():
    exact, moved = planned((2,) * 6)[0], planned((2,) * 6, 4e-6)[0]
    assert np.array_equal(exact.x, moved.x)
    error = np.linalg.norm(moved.tcp - moved.target, axis=2)
    np.testing.assert_allclose(moved.residual, error, atol=1e-12)
    assert np.ptp(moved.target[0, FIRST : FIRST + 2], axis=0).max() > 3e-6


def test_rows_whose_own_tolerance_a_place_s_configuration_violates_are_planned():
    found, _ = planned((2, 1, 1, 1, 1, 1), 8e-6, tolerance_m=2e-6, path_tolerance_m=1e-3)
    assert found.tracked.all() and (found.residual <= 2e-6).all()
    assert found.joint_step[0, FIRST + 1] > 0


def test_repeated_rows_after_a_failure_are_not_attempted():
    path = np.concatenate([PATH[:2], np.repeat([[5.0, 0.0, 0.3]], 2, axis=0)])
    beyond = make_scenario(toy.robot(), replace(toy.workpiece(), path=PATH[:4]), None, rotation=(0.0, 0.0))
    targets = beyond.targets.copy()
    targets[FIRST:] = path
    found = toy.planned([replace(beyond, targets=targets)], "baseline", threads=1)
    assert found.status[0, -2] not in (Status.TRACKED, Status.NOT_ATTEMPTED)
    assert found.status[0, -1] == Status.NOT_ATTEMPTED and np.isnan(found.x[0, -1]).all()


def test_scenarios_of_a_batch_have_their_own_repeated_rows():
    paths = [np.repeat(PATH, counts, axis=0) for counts in ((1,) * 6, (2, 1, 1, 1, 1, 2), (1, 1, 4, 1, 1, 1))]
    batch = [scenario(path, k) for k, path in enumerate(paths)]
    together = toy.planned(batch, "beam", threads=1)
    for k, one in enumerate(batch):
        alone = toy.planned([one], "beam", threads=1)
        assert np.array_equal(together.x[k, : len(one.targets)], alone.x[0])
        assert (together.exists[k].sum()) == len(one.targets)


def test_places_are_measured_from_their_first_row():
    """A path of many small steps is no single place."""
    path = PATH[0] + np.arange(8)[:, None] * [4e-6, 0.0, 0.0]
    found = are_distinct(scenarios.stack([scenario(path)]), TASK)[0, FIRST:]
    assert found.tolist() == [True, False, False, True, False, False, True, False]


def test_the_approach_is_left_as_it_is():
    part = replace(toy.workpiece(), path=PATH)
    given = make_scenario(toy.robot(), part, toy.START, rotation=(0.0, 0.0), approach=(2, 2))
    assert are_distinct(scenarios.stack([given]), TASK).all(), "the path's first point ends the approach, too"


@pytest.mark.parametrize("angle, distinct", [(0.5e-4, False), (3e-4, True)])
def test_rows_that_turn_the_tool_are_several_places(angle, distinct):
    axis = AxisTowards(3, (0.0, 0.0, 1.0))
    task = Task((*TASK.parts, axis), TASK.tolerance_m)
    one = scenario(np.repeat(PATH[:1], 2, axis=0))
    towards = np.array([[0, 0, -1.0]] * 2 + [[np.sin(angle), 0, -np.cos(angle)]])
    rest = np.zeros((3, axis.numbers - 3))
    one = replace(one, task_goals=np.concatenate([one.targets, towards, rest], axis=1))
    assert are_distinct(scenarios.stack([one]), task)[0].tolist() == [True, True, distinct]


def test_rows_at_one_place_have_one_tangent_and_do_not_bend_it():
    path = np.stack([np.linspace(0, 1, 5), np.zeros(5), np.zeros(5)], axis=1)
    twice = np.repeat(path, 2, axis=0)
    twice[1::2, 1] += 5e-6
    np.testing.assert_array_equal(tangents(twice), np.repeat(tangents(path), 2, axis=0))
    with pytest.raises(InputError, match="the path has no tangent"):
        tangents(twice[:2])
