"""Home configuration, start and approach: motions begin and end at home, and approaches avoid infeasible lines.

A start is given or chosen. All motions are checked at sampled points by brute force.
"""

from collections import Counter
from dataclasses import replace
from functools import cache

import made_once
import numpy as np
import pytest
import toy
from small_motions import SMALL, check_motions, check_segment, first_of, in_duct, plan_by_beam, same, scenario, segments
from stranger_jobs import car_job

import htcp_jax
from htcp_jax.device import Executor
from htcp_jax.model.scenario import NOT_REFUSED
from htcp_jax.motion import leave_home
from htcp_jax.motion.motion import motion, motion_figures, transfers
from htcp_jax.motion.start_check import check_start
from htcp_jax.planning.batch import plan
from htcp_jax.status import Kind, SegmentStatus, Status
from htcp_jax.validation import validate_results

HOME = (0.9, -2.0, 0.2, 0.3, 0.9, -1.0)
TOUCHES = (0.0, -1.2, -0.5, 0.0, 0.5, -2.0)


def at_home(number, rotation=(0.4, 0.1), start=None, targets=4, **changes):
    one = scenario(number, rotation, start, home=HOME, **changes)
    return first_of(one, int(one.on_path) + targets)


@cache
def begun():
    """Scenarios with chosen starts, a given start, and no home, and their plans from one batch."""
    scenarios = at_home(0), at_home(1, start=made_once.START), first_of(scenario(2), 14), at_home(3, (0.2, -0.3))
    return scenarios, plan_by_beam(scenarios, threads=1)


def test_motions_begin_at_home_and_are_proven_from_there_on():
    scenarios, plans = begun()
    assert (plans.executable == plans.tracked).all() and plans.tracked[:3].all(where=plans.exists[:3])
    for s, one in enumerate(scenarios):
        np.testing.assert_array_equal(plans.start[s], one.x_home)
        for t, configurations in segments(plans, s):
            assert 0 < plans.segment_clearance[s, t] <= check_segment(one, t, configurations, SMALL.tube_m) + 1e-9
        assert plans.joint_step[s, 0] == pytest.approx(np.linalg.norm(plans.x[s, 0] - plans.start[s]))


def test_a_chosen_start_is_at_the_first_point_of_the_path():
    scenarios, plans = begun()
    for s in (0, 3):
        part, one = made_once.duct(), scenarios[s]
        first = one.T_world_workpiece[:3, :3] @ part.path[0] + one.T_world_workpiece[:3, 3]
        assert one.auto_start and one.on_path == 1 and int(one.count) == 5
        assert np.linalg.norm(plans.tcp[s, 0] - first) <= SMALL.tolerance_m
        np.testing.assert_allclose(plans.target[s, :2], [first, first], atol=1e-15)


def test_a_start_that_was_given_is_passed_on_the_way_from_home():
    """Check this also for a smoothed motion, where all other points move."""
    scenarios, plans = begun()
    smoothed = plan_by_beam(scenarios, replace(SMALL, smooth=True), threads=1)
    for found in (plans, smoothed):
        assert (found.via_points.on_segment(1, 0) == made_once.START).all(axis=1).any()
    cost, less = (motion_figures(found, np.array([one.on_path for one in scenarios])) for found in (plans, smoothed))
    assert (less.motion_cost_rad2 <= cost.motion_cost_rad2).all() and (smoothed.executable == plans.executable).all()


def test_rows_say_that_the_arm_goes_from_home_to_another_configuration_and_back():
    scenarios, plans = begun()
    for s, transferred in enumerate((True, True, False, True)):
        there = motion(plans, s, int(scenarios[s].on_path), retract=True)
        kinds = there.kind[: int(plans.tracked[s].sum()) + 1 + (plans.via_points.scenario == s).sum()]
        assert ((kinds == Kind.TRANSFER) == ((there.target[: len(kinds)] == 0) & transferred)).all()
        assert (there.kind[len(kinds) :] == Kind.RETRACT).all() and len(there.kind) == 2 * len(kinds) - 1
        np.testing.assert_array_equal(there.x[-1], scenarios[s].x_home)


def test_any_method_begins_at_home():
    """Compare with a plan without home: only the segment to the first target differs."""
    one = at_home(0, start=made_once.START)
    without = replace(one, x_home=one.x_start)
    from_start, from_home = (plan(in_duct(s), "baseline") for s in (without, one))
    np.testing.assert_array_equal(from_home.x, from_start.x)
    assert (from_home.segment_status == from_start.segment_status).all() and (from_home.start == HOME).all()
    assert from_home.executable.sum() == from_start.executable.sum() > 0


def test_a_home_from_which_there_is_no_way_is_a_scenario_with_that_reason():
    """Check the status of each scenario, and that a valid scenario in the same batch is unaffected."""
    collides = at_home(5, start=made_once.START)
    collides = replace(collides, x_home=np.array(TOUCHES))
    starts_in_it = at_home(6, start=TOUCHES)
    nowhere = at_home(7, margin_m=0.5)  # no configuration keeps this margin
    fine, plans = begun()
    found = plan_by_beam([collides, starts_in_it, nowhere, fine[2]])
    ends = Status.HOME_IN_COLLISION, Status.START_IN_COLLISION, Status.NO_START
    assert found.status[:3, 0].tolist() == list(ends) and not found.tracked[:3].any()
    assert (found.segment_status[:3] == SegmentStatus.NOT_CHECKED).all()
    same(found, 3, plans, 2, int(fine[2].count))


def test_a_home_in_collision_is_named_with_its_body_and_depth():
    one = replace(at_home(0, start=made_once.START), x_home=np.array(TOUCHES))
    with pytest.raises(
        htcp_jax.InputError, match=r"home is in collision: \w+ \(\w+\) is \d+\.\d{3} mm inside the keep-out zone"
    ):
        check_start(made_once.robot(), made_once.duct(), one)


def test_starts_of_many_scenarios_take_the_calls_of_one_and_are_those_of_each_alone(monkeypatch):
    """Count the calls of lane functions: together as many as for the scenario that needs most."""
    near = {"start": None, "home": toy.START}
    given = [toy.scenario(k, shift=(0.0, 0.01 * k, 0.0), **near) for k in range(5)]
    given[2:2] = [toy.scenario(5, start=toy.START, home=tuple(np.add(toy.START, 0.1))), toy.scenario(6, start=None)]
    counts, call = Counter(), Executor.__call__

    def counted(self, function, *of):
        counts[function.name] += 1
        return call(self, function, *of)

    monkeypatch.setattr(Executor, "__call__", counted)

    def begun(scenarios):
        counts.clear()
        problem, from_home = leave_home(toy.problem(scenarios, threads=1))
        return problem.scenarios, from_home, dict(counts)

    scenarios, from_home, together = begun(given)
    most = Counter()
    for k, one in enumerate(given):
        alone, own, calls = begun([one])
        most |= Counter(calls)
        np.testing.assert_array_equal(alone.x_start[0], scenarios.x_start[k])
        assert alone.refused[0] == scenarios.refused[k] and (0 in own) == (k in from_home)
        np.testing.assert_array_equal(own.get(0, 0), from_home.get(k, 0))
    assert len(from_home) == 6 and (scenarios.refused == NOT_REFUSED).all()
    assert together["settle"] <= 2 and sum(together.values()) <= 3 * sum(most.values())


def off_its_lines(number, rotation=(0.4, 0.1)):
    """Scenario whose straight approach leads beyond the reach of the arm."""
    one = first_of(scenario(number, rotation), 16)
    targets = one.targets.copy()
    targets[5] = 9.0
    return replace(one, targets=targets)


def test_an_approach_leaves_its_lines_where_these_lead_nowhere():
    """Check the replacement by a proven motion through free space, and that feasible approaches stay unchanged.

    The targets of the new approach are the first point of the path.
    """
    scenarios = off_its_lines(0), first_of(scenario(1), 16), off_its_lines(2, (0.2, -0.3))
    plans = plan_by_beam(scenarios, threads=1)
    assert (plans.executable == plans.exists).all() and not transfers(plans).any()
    check_motions(scenarios, plans, SMALL.tube_m)
    for s, one in enumerate(scenarios):
        first, requested = int(one.on_path), one.targets.copy()
        if s != 1:
            requested[1:first] = requested[first]
            assert (plans.x[s, 1:first] == plans.x[s, first]).all()
        np.testing.assert_array_equal(plans.target[s], requested)
        np.testing.assert_allclose(plans.tcp[s], requested, atol=SMALL.tolerance_m)
        there = motion(plans, s, first)
        assert (there.kind[there.target < first] == Kind.APPROACH).all()
    assert (scenarios[0].targets[5] == 9).all()  # the scenario itself is unchanged
    same(plans, 2, plan_by_beam(scenarios[2:], threads=1), 0, 16)
    same(plans, 1, plan_by_beam(scenarios[1:], threads=2), 0, 16)


@pytest.mark.slow
@pytest.mark.parametrize("how", [{"start_rad": "auto"}, {}, {"method": "baseline", "start_rad": "auto"}])
def test_a_stranger_s_arm_goes_behind_a_rib_from_home_and_mujoco_refutes_nothing(tmp_path, how):
    """Check a user-supplied part: the start is chosen behind the rib, or the approach avoids the rib.

    The straight lines of the approach would lead through it.
    """
    home = {"home_rad": [0.0, -2.4, 2.3, 0.0, -1.57, 0.0]}
    made = htcp_jax.plan(car_job(tmp_path), {"method": "beam", **home, **how})
    made.save(tmp_path / "out", retract=True)
    assert made.motion_summary.end.executable == len(made.plans.x[0]) and made.motion_summary.transfer_legs
    rows = (tmp_path / "out" / "motion.csv").read_text().splitlines()[1:]
    assert rows[0].split(",")[1:] == ["TRANSFER", *map(str, home["home_rad"])]
    assert rows[-1].split(",")[1:] == ["RETRACT", *map(str, home["home_rad"])]
    assert validate_results(tmp_path / "out", between=1000).refuted == ()


def test_configurations_drawn_to_find_a_start_are_counted_up_to_the_maximum_if_there_is_none():
    seen, one = [], replace(toy.scenario(), auto_start=np.array(True), margin_m=np.array(0.5))  # nowhere so clear
    toy.planned([one], progress=seen.append)
    draws = [now.draws for now in seen if now.starts == 0]
    assert [drawn for drawn, _ in draws] == sorted(drawn for drawn, _ in draws)
    assert {most for _, most in draws} == {2048} and draws[-1] == (2048, 2048) and (512, 2048) in draws
