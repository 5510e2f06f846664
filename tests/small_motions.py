"""Small scenarios for the beam search, and brute-force checks of motions at sampled points."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import made_once
import numpy as np

from htcp_jax.model.robot import lengthen_tool
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.motion import Execution, Problem
from htcp_jax.motion.plans import ARRAYS
from htcp_jax.planning.batch import plan
from htcp_jax.settings import Settings

# A small search: none of these settings is compiled into a program.
SMALL = Settings(beam_width=6, min_beam_width=6, self_motions=6, self_motion_rounds=2, smooth=False)
PLACES = 200  # samples on every straight joint path


def scenario(number=0, rotation=(0.4, 0.1), start=made_once.START, **changes):
    return make_scenario(made_once.robot(), made_once.duct(), start, rotation=rotation, number=number, **changes)


def first_of(one, targets):
    """Scenario with only its first targets."""
    goals = None if one.task_goals is None else one.task_goals[:targets]
    return replace(one, targets=one.targets[:targets], task_goals=goals, count=np.asarray(targets, np.int32))


@cache
def poses():
    """Scenarios that need a wide beam and reconfigurations, with different lengths, margins, and tools."""
    return (
        scenario(0, (0.4, -0.3)),
        scenario(1, (0.2, -0.3), approach=(3, 2), margin_m=0.0),
        scenario(2, (0.4, 0.0), tool_extension_m=0.02),
    )


def in_duct(scenarios, settings=SMALL, check_paths=True, **execution) -> Problem:
    """Problem of scenarios in the duct; `execution`: of an `Execution`."""
    made = made_once.robot(), made_once.duct(), scenarios, settings
    return Problem.of(*made, execution=Execution(**execution), check_paths=check_paths)


def plan_by_beam(*of, **more):
    return plan(in_duct(*of, **more), "beam")


@cache
def planned():
    return plan_by_beam(poses(), threads=1)


def same(one, row, other, other_row, count):
    """Check that two plans of a scenario are equal to the last bit."""
    for name in ARRAYS:
        here, there = (getattr(p, name)[r] for p, r in ((one, row), (other, other_row)))
        if name != "start":
            here, there = here[:count], there[:count]
        np.testing.assert_array_equal(here, there, err_msg=name)
    for t in range(count):
        np.testing.assert_array_equal(one.via_points.on_segment(row, t), other.via_points.on_segment(other_row, t))


def segments(plans, s):
    """Yield (target, configurations from the previous row to its own) of the executable targets."""
    before = plans.start[s]
    for t in np.flatnonzero(plans.executable[s]).tolist():
        yield t, np.concatenate([before[None], plans.via_points.on_segment(s, t), plans.x[s, t][None]])
        before = plans.x[s, t]


def off_line(start, end, points):
    line = end - start
    along = np.clip((points - start) @ line / (line @ line or 1.0), 0, 1)
    return np.linalg.norm(points - start - along[:, None] * line, axis=1)


def check_segment(one, t, configurations, radius):
    """Check one segment by brute force; return the smallest D.

    It is clear everywhere. On the path the TCP stays near its line and never reverses; while the arm changes its
    configuration, the TCP stays near the previous target.
    """
    robot = lengthen_tool(made_once.robot(), float(one.tool_extension_m))
    smallest = np.inf
    for k, (a, b) in enumerate(pairwise(configurations)):
        D, points = made_once.measured(one, a + np.linspace(0, 1, PLACES)[:, None] * (b - a), robot)
        smallest = min(smallest, D.min())
        if t <= one.on_path:
            continue
        start, end = one.targets[t - 1 : t + 1]
        turns = k < len(configurations) - 2
        assert off_line(start, start if turns else end, points).max() <= radius
        assert turns or (np.diff(points @ (end - start)) >= -1e-15).all()
    return smallest


def check_motions(scenarios, plans, radius):
    for s, one in enumerate(scenarios):
        np.testing.assert_array_equal(plans.start[s], one.x_start)
        for t, configurations in segments(plans, s):
            smallest = check_segment(one, t, configurations, radius)
            assert 0 < plans.segment_clearance[s, t] <= smallest + 1e-9


def check_rows(scenarios, plans, settings):
    """Check tracked rows: on target, within margin and limits, and with the recorded values of the configuration."""
    lower, upper = np.asarray(made_once.robot().lower), np.asarray(made_once.robot().upper)
    for s, one in enumerate(scenarios):
        robot = lengthen_tool(made_once.robot(), float(one.tool_extension_m))
        own = plans.tracked[s]
        x, count = plans.x[s, own], int(own.sum())
        D, tcp = made_once.measured(one, x, robot)
        np.testing.assert_allclose(plans.clearance[s, own], D, atol=1e-13)
        assert (plans.clearance[s, own] > 0).all() and (plans.clearance[s, own] >= one.margin_m).all()
        np.testing.assert_allclose(plans.tcp[s, own], tcp, atol=1e-13)
        residual = np.linalg.norm(tcp - one.targets[:count], axis=1)
        np.testing.assert_allclose(plans.residual[s, own], residual, atol=1e-13)
        assert residual.max() <= settings.tolerance_m
        assert (x >= lower).all() and (x <= upper).all()
        null_space_steps = np.concatenate([[one.x_start], x])
        np.testing.assert_allclose(plans.joint_step[s, own], np.linalg.norm(np.diff(null_space_steps, axis=0), axis=1))
