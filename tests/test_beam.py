"""The beam search: its tracked targets are motions from the given start, checked densely; and motions are validated."""

from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import made_once
import numpy as np
import pytest
import toy
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
)

from htcp_jax.model.inverse_kinematics import reanchor
from htcp_jax.motion import Plans, ViaPoints
from htcp_jax.motion.motion import motion, transfers
from htcp_jax.motion.motion_check import verify_motions
from htcp_jax.motion.start_check import start_contact
from htcp_jax.planning.batch import plan
from htcp_jax.planning.beam import dead_ends
from htcp_jax.settings import Settings
from htcp_jax.status import Kind, SegmentStatus, Status


def test_what_is_tracked_is_a_motion_from_the_given_start():
    """Tracked targets: proven motions from the start.

    200 configurations on every straight joint path are checked by the clearance itself; every tracked target is
    executable.
    """
    plans = planned()
    assert (plans.executable == plans.tracked).all() and (plans.tracked.sum(axis=1) > 60).all()
    assert (plans.segment_status[plans.tracked] == SegmentStatus.VALID).all()
    check_motions(poses(), plans, SMALL.tolerance_m)
    on_path = np.array([int(one.on_path) for one in poses()])
    assert (plans.via_points.target > on_path[plans.via_points.scenario]).any()  # a change of configuration on the path


def test_targets_count_as_those_of_any_method():
    """Rows of the targets, as for every method; rows after the last tracked target are NaN."""
    plans = planned()
    check_rows(poses(), plans, SMALL)
    for s, one in enumerate(poses()):
        count, exists = int(plans.tracked[s].sum()), int(one.count)
        assert (plans.path_clear[s, :count] == 1).all() and (plans.recovery[s] == 0).all()
        for rows in (plans.x, plans.tcp, plans.clearance, plans.residual, plans.joint_step, plans.segment_clearance):
            assert np.isnan(rows[s, count:]).all()
        assert (plans.status[s, :count] == Status.TRACKED).all()
        assert (plans.status[s, count + 1 : exists] == Status.NOT_ATTEMPTED).all()
        assert count == exists or plans.status[s, count] in (Status.PATH_BLOCKED, Status.RECOVERY_EXHAUSTED)
        assert (
            not plans.exists[s, exists:].any()
            and (plans.via_points.target[plans.via_points.scenario == s] < count).all()
        )
    assert {len(one.targets) for one in poses()} != {len(poses()[0].targets)}


def test_another_seed_is_another_search_for_motions():
    seeded = replace(toy.SETTINGS, seed=7)
    first, other, again = toy.plans_by(), toy.plans_by(settings=seeded), toy.planned(settings=seeded, threads=1)
    assert not np.array_equal(other.x, first.x, equal_nan=True)
    assert (other.executable == other.tracked).all() and other.tracked.sum() > 50
    np.testing.assert_array_equal(other.x, again.x)


def test_a_change_of_configuration_may_be_several_self_motions_one_after_the_other():
    """Changes of configuration by several self-motions in sequence.

    One configuration and one self-motion at a time, each from the end of the previous ones: the first is not enough.
    """
    one, settings = (
        first_of(scenario(14, (0.4, -0.3)), 60),
        replace(SMALL, beam_width=1, min_beam_width=1, self_motions=1, effort=0.0),
    )
    once, often = (plan_by_beam([one], replace(settings, self_motion_rounds=rounds)) for rounds in (1, 12))
    (lost,) = set(often.via_points.target.tolist())
    assert once.outcome(0).failed == lost and once.tracked.sum() == lost
    assert (often.executable == often.tracked).all() and often.tracked[0].all()
    steps = np.linalg.norm(np.diff(often.via_points.x, axis=0), axis=1)
    assert len(often.via_points.x) > 1 and steps.max() < 2 * settings.self_motion_step_rad


def test_after_a_dead_end_a_search_backwards_joins_the_beam():
    """Dead end of a beam of one configuration: passed by a search from the lost target, with a proven motion."""
    one, settings = first_of(scenario(14, (0.4, -0.3)), 60), replace(SMALL, beam_width=1, min_beam_width=1)
    settings = replace(settings, self_motions=1, self_motion_rounds=1)
    ended, joined = (plan_by_beam([one], replace(settings, effort=effort)) for effort in (0.0, 2.0))
    lost = ended.outcome(0).failed
    assert lost is not None and not len(ended.dead_ends.scenario)
    assert joined.outcome(0).can_be_driven and joined.dead_ends.on(0)[lost].connected > 0


def test_where_a_search_backwards_does_not_meet_the_beam_a_wider_one_passes_the_dead_end(monkeypatch):
    """The same dead end, with configurations at the lost target that are too far from the beam's to be joined."""
    monkeypatch.setattr(dead_ends, "MEET_RAD", 0.0)
    one, settings = first_of(scenario(14, (0.4, -0.3)), 60), replace(SMALL, beam_width=1, min_beam_width=1)
    plans = plan_by_beam([one], replace(settings, self_motions=1, self_motion_rounds=1, effort=40.0))
    (tried,) = plans.dead_ends.on(0).values()
    assert plans.outcome(0).can_be_driven and (tried.searches, tried.wider, tried.connected) == (1, 1, 1)
    assert "1 search backwards, 1 with a wider beam" in tried.description


def test_a_narrower_tube_is_kept_to():
    settings = replace(SMALL, path_tolerance_m=2e-4)
    plans = plan_by_beam(poses()[2:], settings)
    assert (plans.executable == plans.tracked).all() and plans.tracked.sum() > 60
    few = Plans.concatenate([plans])._replace(status=np.where(np.arange(plans.status.shape[1]) < 40, plans.status, 7))
    check_motions(poses()[2:], few._replace(status=few.status.astype(np.int8)), settings.tube_m)


def test_progress_counts_every_target_and_every_scenario():
    heard = []
    plans = toy.planned(threads=2, progress=heard.append)
    last = heard[-1]
    assert last.scenarios_done == last.scenarios == len(toy.scenarios()) and last.targets_tracked == plans.tracked.sum()
    assert [one.targets_tracked for one in heard] == sorted(one.targets_tracked for one in heard)
    smoothed = [one for one in heard if one.scenarios_done]  # a scenario is finished when its motion is smoothed
    assert len(smoothed) > 1 and {one.targets_tracked for one in smoothed} == {last.targets_tracked}


def test_a_start_in_collision_ends_it_at_once():
    """Start in collision: the end of the search, also if a clear configuration with the same TCP is near."""
    starts = np.load(made_once.RECORDED)["x"][:20]
    scenarios = [first_of(scenario(k, start=x), 3) for k, x in enumerate(starts)]
    depths = [start_contact(made_once.robot(), made_once.duct(), one).clearance_m for one in scenarios]
    stuck = [one for one, D in zip(scenarios, depths, strict=True) if D <= 0]
    assert len(stuck) >= 5
    plans = plan_by_beam(stuck)
    assert (plans.status[:, 0] == Status.START_IN_COLLISION).all() and not plans.tracked.any()
    assert (plans.status[:, 1:] == Status.NOT_ATTEMPTED).all() and (
        plans.segment_status == SegmentStatus.NOT_CHECKED
    ).all()


@pytest.mark.parametrize("where", ["through the wall", "out of reach"])
def test_a_target_that_cannot_be_reached_ends_it_and_leaves_what_came_before(where):
    one = first_of(scenario(2, (0.4, 0.0)), 20)
    lost, targets = 15, one.targets.copy()
    cloud = made_once.duct().cloud @ one.T_world_workpiece[:3, :3].T + one.T_world_workpiece[:3, 3]
    nearest = cloud[np.argmin(np.linalg.norm(cloud - targets[lost], axis=1))]
    outwards = (nearest - targets[lost]) / np.linalg.norm(nearest - targets[lost])
    targets[lost:] += outwards * (0.15 if where == "through the wall" else 5.0)
    plans = plan_by_beam([replace(one, targets=targets), one])
    end = plans.outcome(0)
    assert (end.tracked, end.executable, end.failed, end.segment_status) == (lost, lost, lost, SegmentStatus.VALID)
    assert end.status in (Status.PATH_BLOCKED, Status.RECOVERY_EXHAUSTED)
    assert (plans.status[0, lost + 1 :] == Status.NOT_ATTEMPTED).all()
    assert plans.outcome(1).executable == 20


def test_points_of_the_path_that_are_met_twice_are_no_obstacle():
    """Repeated points of a path: duplicates, and points 1 nm apart, between which no line has a direction."""
    one = first_of(scenario(2, (0.4, 0.0)), 20)
    first = int(one.on_path)
    again = np.repeat(one.targets[first:], 2, axis=0)
    again[1::4] += 1e-9
    twice = replace(one, targets=np.concatenate([one.targets[:first], again]), count=np.asarray(first + len(again)))
    twice = replace(twice, count=twice.count.astype(np.int32))
    plans = plan_by_beam([twice])
    assert plans.executable.all()
    check_motions([twice], plans, SMALL.tolerance_m)


# Validating motions


@cache
def example():
    """A scenario whose 40 targets are a motion, and its plans."""
    one = first_of(scenario(2, (0.4, 0.0)), 40)
    plans = plan_by_beam([one])
    assert plans.executable.all() and not len(plans.via_points.target)
    return one, plans


def verified(one, settings=SMALL, threads=1, **changes):
    """Plans of `example` with these arrays, validated anew."""
    plans = example()[1]
    plans = plans._replace(**{name: array.copy() for name, array in plans.arrays().items()})._replace(**changes)
    plans.segment_status[:], plans.segment_clearance[:] = SegmentStatus.NOT_CHECKED, np.nan
    return verify_motions(in_duct([one], settings, threads=threads), plans)


def ends(plans, target, *verdicts):
    """Check that the motion ends at this target, for one of these reasons."""
    end = plans.outcome(0)
    assert end.executable == target and end.segment_status in verdicts and plans.segment_status[0, target] in verdicts
    assert (plans.segment_status[0, :target] == SegmentStatus.VALID).all() and np.isfinite(
        plans.segment_clearance[0, :target]
    ).all()
    assert np.isnan(plans.segment_clearance[0, target]) and not plans.executable[0, target:].any()


def with_configuration(target, x):
    changed = example()[1].x.copy()
    changed[0, target] = x
    return changed


def configuration_at(target, point):
    """Configuration near the previous row's, with the TCP at a point."""
    x, off = reanchor(made_once.robot(), jnp.asarray(example()[1].x[0, target - 1]), jnp.asarray(point), 1e-6)
    assert off <= 1e-6
    return np.asarray(x)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_judging_again_says_the_same(threads):
    one, plans = example()
    again = verified(one, threads=threads)
    np.testing.assert_array_equal(again.segment_status, plans.segment_status)
    np.testing.assert_array_equal(again.segment_clearance, plans.segment_clearance)


@pytest.mark.parametrize("target", [15, 16, 31])
def test_a_tool_that_leaves_its_path_is_no_motion(target):
    """Tool off its path: no motion from there on.

    The statuses of the next targets are still tracked; nothing after the first lost one is executable.
    """
    one, _ = example()
    line = one.targets[target] - one.targets[target - 1]
    beside = np.cross(line, [0.3, 0.5, 0.8])
    point = one.targets[target] + 2e-3 * beside / np.linalg.norm(beside)
    changed = verified(one, x=with_configuration(target, configuration_at(target, point)))
    ends(changed, target, SegmentStatus.OFF_PATH)
    assert (
        changed.tracked.all()
        and (changed.segment_status[0, target // 16 * 16 + 16 :] == SegmentStatus.NOT_CHECKED).all()
    )
    assert (
        verified(one, replace(SMALL, path_tolerance_m=5e-3), x=changed.x).segment_status[0, target]
        == SegmentStatus.VALID
    )


def test_a_tool_that_goes_backwards_is_no_motion():
    one, _ = example()
    line = one.targets[20] - one.targets[19]
    point = one.targets[19] - 5e-4 * line / np.linalg.norm(line)
    ends(verified(one, x=with_configuration(20, configuration_at(20, point))), 20, SegmentStatus.REVERSES)


def test_at_a_point_that_is_met_twice_the_tool_may_go_any_way():
    one, targets = example()[0], example()[0].targets.copy()
    line = (targets[20] - targets[19]) / np.linalg.norm(targets[20] - targets[19])
    behind = with_configuration(20, configuration_at(20, targets[19] - 5e-4 * line))
    for apart, verdict in ((0.0, SegmentStatus.VALID), (1e-9, SegmentStatus.VALID), (1e-4, SegmentStatus.REVERSES)):
        targets[20] = targets[19] + apart * line
        assert verified(replace(one, targets=targets.copy()), x=behind).segment_status[0, 20] == verdict


@pytest.mark.parametrize("target", [0, 5, 20])
def test_an_arm_that_touches_on_its_segment_is_no_motion(target):
    """Arm in collision within one segment: no motion, although the targets themselves are clear."""
    one, plans = example()
    before = plans.start[0] if target == 0 else plans.x[0, target - 1]
    far = made_once.configurations_near(before, 200, 1.5)
    D, _ = made_once.measured(one, far)
    through = ViaPoints.of([(0, target, far[[int(np.argmin(D))]])], 6)
    assert D.min() < 0
    changed = verified(one, via_points=through)
    ends(
        changed,
        target,
        *(
            (SegmentStatus.IN_COLLISION,)
            if target < one.on_path
            else (SegmentStatus.IN_COLLISION, SegmentStatus.OFF_PATH)
        ),
    )
    assert (
        verified(one, replace(SMALL, path_tolerance_m=0.1), via_points=through).segment_status[0, target]
        != SegmentStatus.VALID
    )


def test_a_change_of_configuration_has_to_stay_at_the_target_before():
    """Dwell on the path: the TCP must stay at the previous target.

    Before the path the TCP may go anywhere that is clear.
    """
    one, _ = example()
    for target, point, verdict in (
        (20, one.targets[19] + [0, 0, 5e-4], SegmentStatus.VALID),
        (20, one.targets[19] + [0, 0, 3e-3], SegmentStatus.OFF_PATH),
        (5, one.targets[4] + [0, 0, 3e-3], SegmentStatus.VALID),
        (int(one.on_path), one.targets[one.on_path - 1] + [0, 0, 3e-3], SegmentStatus.VALID),
        (int(one.on_path) + 1, one.targets[one.on_path] + [0, 0, 3e-3], SegmentStatus.OFF_PATH),
    ):
        there = configuration_at(target, point)
        back = configuration_at(target, one.targets[target - 1])
        segment_status = np.stack([there, back])
        changed = verified(one, via_points=ViaPoints.of([(0, target, segment_status)], 6))
        assert changed.segment_status[0, target] == verdict
        ends(changed, target, verdict) if verdict != SegmentStatus.VALID else check_motions(
            [one], changed, SMALL.tolerance_m
        )


def test_a_plan_from_another_start_is_no_motion():
    one, plans = example()
    changed = verified(one, start=plans.start + 1e-12)
    assert (
        changed.segment_status[0, 0] == SegmentStatus.WRONG_START
        and (changed.segment_status[0, 1:] == SegmentStatus.NOT_CHECKED).all()
    )
    assert changed.outcome(0).executable == 0 and changed.outcome(0).segment_status == SegmentStatus.WRONG_START


def test_nobody_looks_beyond_a_failure_or_where_nobody_is_asked_to():
    one, plans = example()
    status = plans.status.copy()
    status[0, 10], status[0, 11:] = Status.PATH_BLOCKED, Status.NOT_ATTEMPTED
    changed = verified(one, status=status)
    assert (changed.segment_status[0, :10] == SegmentStatus.VALID).all() and (
        changed.segment_status[0, 10:] == SegmentStatus.NOT_CHECKED
    ).all()
    assert changed.outcome(0).executable == 10
    assert (plan_by_beam([first_of(one, 5)], check_paths=False).segment_status == SegmentStatus.NOT_CHECKED).all()


def test_what_another_method_makes_is_verified_as_well():
    """Motions of another method, validated as well: by brute force, the verdicts are right."""
    scenarios = [first_of(scenario(k, rotation), 24) for k, rotation in enumerate([(0.4, 0.0), (0.8, -0.3)])]
    plans = plan(in_duct(scenarios), "baseline")
    check_motions(scenarios, plans, SMALL.tolerance_m)
    assert plans.executable.sum() > 24


def test_other_configurations_at_the_first_target_lead_further_by_a_transfer():
    """Transfers to other configurations at the first target.

    From a start in a dead end the arm changes its configuration before the path, by a proven joint path, and gets
    further; every segment is checked densely. Where transfers are not allowed, or the start itself leads on, nothing
    changes.
    """
    without, settings = Settings(smooth=False), Settings(smooth=False, transfers=True)
    lost, easy = scenario(1, (0.2, -0.2)), first_of(poses()[2], 30)
    own, plans = plan_by_beam([lost, easy], without), plan_by_beam([lost, easy], settings)
    assert own.executable[0].sum() < plans.executable[0].sum()
    assert (plans.executable == plans.tracked).all()
    assert plans.joint_step[0, 0] > 1.0 > own.joint_step[0, 0]
    assert transfers(plans).tolist() == [True, False] and not transfers(own).any()
    straight = plans._replace(via_points=ViaPoints.none(plans.x.shape[2]))  # as recorded if the straight path is clear
    kinds = motion(straight, 0, int(lost.on_path)).kind
    assert (kinds[:2] == Kind.TRANSFER).all() and (kinds[2:] > Kind.TRANSFER).all()
    check_motions([lost, easy], plans, settings.tube_m)
    same(own, 1, plans, 1, 30)
