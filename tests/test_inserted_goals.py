"""Long segments of a path: goals are inserted on them while planning, and become via points of their segment."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
import toy
from scipy.spatial.transform import Rotation

from htcp_jax.device import tables
from htcp_jax.errors import InputError
from htcp_jax.model import Task, Workpiece, kinematics
from htcp_jax.model import scenario as scenarios
from htcp_jax.model.built_in_rows import AxisTowards, FrameOrientation, PointAlong
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.model.task_rows import TaskPoint
from htcp_jax.motion import motion as motions
from htcp_jax.motion.step_functions import State
from htcp_jax.planning.batch import Progress
from htcp_jax.planning.beam.tree import BeamTree, JointSteps
from htcp_jax.planning.inserted_goals import PathParts, inserted, pieces_of
from htcp_jax.spec import AxisRow, OrientationRow
from htcp_jax.status import Kind, SegmentStatus, Status
from htcp_jax.validation.scene_rules import WorkpieceData
from htcp_jax.validation.task_check import part_between

TOY_TASK = Task(tolerance_m=toy.SETTINGS.tolerance_m)
CORNERS = ((0.45, -0.12, 0.3), (0.62, -0.12, 0.3), (0.62, 0.12, 0.3), (0.45, 0.12, 0.3))


def workpiece(path) -> Workpiece:
    return replace(toy.workpiece(), path=np.array(path, float))


def scenario(path, number=0, **changes):
    """A scenario that begins anywhere at the path's first point, which is target 0, too."""
    choices = {"rotation": (0.0, 0.0), "number": number} | changes
    return make_scenario(toy.robot(), workpiece(path), None, **choices)


@cache
def rectangle(method="beam", **changes):
    """The plan along a rectangle of four points, and the same with all tracked targets counted."""
    reported: list[Progress] = []
    settings = replace(toy.SETTINGS, **changes)
    how = {"part": workpiece(CORNERS), "threads": 1}
    return toy.planned([scenario(CORNERS)], method, settings, reported.append, **how), reported


def joint_path(plans, s, t):
    return np.concatenate([[plans.before(s, t)], plans.via_points.on_segment(s, t), [plans.x[s, t]]])


@pytest.mark.parametrize("method", ["beam", "baseline", "hybrid"])
def test_a_rectangle_of_four_points_has_four_results_and_its_lines_are_followed(method):
    plans, reported = rectangle(method)
    on_path = 1
    assert plans.status.shape == (1, on_path + len(CORNERS)) and plans.executable.all()
    assert reported[-1].targets == reported[-1].targets_tracked == plans.status.shape[1]
    for t in range(on_path + 1, on_path + len(CORNERS)):
        shares, x = plans.via_points.shares_on(0, t), joint_path(plans, 0, t)
        assert len(shares) >= 4 and (np.diff(shares) >= 0).all() and 0 <= shares[0] < shares[-1] < 1
        a, b = plans.target[0, t - 1], plans.target[0, t]
        fine = np.concatenate([x[:1], *(np.linspace(p, q, 9)[1:] for p, q in pairwise(x))])
        _, tcp = toy.measured(scenario(CORNERS), fine)
        along = np.clip((tcp - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        assert np.linalg.norm(tcp - a - along[:, None] * (b - a), axis=1).max() <= toy.SETTINGS.tolerance_m + 1e-9
        assert plans.segment_clearance[0, t] > 0 and plans.iterations[0, t] >= 0
    np.testing.assert_allclose(
        plans.joint_step[0], np.linalg.norm(np.diff(np.concatenate([plans.start, plans.x[0]]), axis=0), axis=1)
    )


def test_via_points_on_a_line_are_part_of_the_process_and_no_dwells():
    plans, _ = rectangle()
    known, found = plans.via_points, motions.motion(plans, 0, 1, retract=True)
    process, moving = found.kind == Kind.PROCESS, (known.target > 1) & ~known.stays
    assert process.sum() == 3 + moving.sum() and moving.sum() > 10
    assert (found.span[process][:, 0] < found.span[process][:, 1]).all()
    assert motions.dwells(plans, 1).sum() == len(np.unique(known.target[known.stays & (known.target > 1)]))


def test_nothing_is_inserted_on_short_segments_and_before_the_path():
    stacked = scenarios.stack([toy.scenario(), scenario(CORNERS)])
    pieces = pieces_of(toy.robot(), TOY_TASK, stacked, toy.SETTINGS)
    assert (pieces[0] == 1).all() and (pieces[1, :2] == 1).all() and (pieces[1, 2:5] > 4).all()
    assert (pieces_of(toy.robot(), TOY_TASK, stacked, replace(toy.SETTINGS, path_tolerance_m=0.1)) == 1).all()


def test_a_scenario_with_long_segments_has_the_same_plan_in_any_batch():
    both = toy.planned([toy.scenarios()[3], scenario(CORNERS)], part=workpiece(CORNERS))
    alone, others = rectangle()[0], toy.plans_by()
    toy.same(both, 1, alone, 0, alone.status.shape[1])
    toy.same(both, 0, others, 3, int(toy.scenarios()[3].count))
    np.testing.assert_array_equal(both.via_points.shares_on(1, 3), alone.via_points.shares_on(0, 3))


def test_a_segment_that_fails_in_the_middle_fails_at_its_target_and_keeps_what_was_followed():
    """The line leaves the arm's reach between its two points."""
    path = (*CORNERS[:1], (0.45, 0.0, 0.3), (1.3, 0.0, 0.3))
    far = scenario(path, beyond_reach="record")
    far = replace(far, refused=np.asarray(scenarios.NOT_REFUSED, np.int32))
    plans = toy.planned([far], settings=replace(toy.SETTINGS, effort=0.0), part=workpiece(path))
    end = plans.outcome(0)
    assert (end.failed, end.tracked, end.executable) == (3, 3, 3) and not end.status.tracked
    assert np.isnan(plans.x[0, 3]).all() and plans.segment_status[0, 3] == SegmentStatus.NOT_CHECKED
    reached = plans.via_points.shares_on(0, 3)
    assert 0.2 < reached.max() < 0.9  # at 0.95 m of 0.45 to 1.3 m the arm is stretched
    motion = motions.motion(plans, 0, 1)
    assert motion.target.max() == 2 and Status(plans.status[0, 3]) != Status.NOT_ATTEMPTED


def test_parts_are_equal_and_end_at_the_targets():
    pieces, count = np.array([[1, 1, 3, 2], [1, 2, 1, 9]]), np.array([4, 3])
    parts = PathParts.of(pieces, count)
    assert parts.row.tolist()[0] == [0, 1, 4, 6] and parts.row.tolist()[1][:3] == [0, 2, 3]
    assert parts.target[0].tolist() == [0, 1, 2, 2, 2, 3, 3] and parts.target[1, :4].tolist() == [0, 1, 1, 2]
    np.testing.assert_array_equal(parts.end[0], [1, 1, 1 / 3, 2 / 3, 1, 0.5, 1])
    np.testing.assert_array_equal(parts.begin[0][1:][parts.begin[0][1:] > 0], parts.end[0][:-1][parts.end[0][:-1] < 1])


def test_inserted_goals_lie_on_the_line_and_turn_evenly():
    rng, link = np.random.default_rng(3), None
    rows = (
        TaskPoint(),
        AxisTowards(link, (0.0, 0.0, 1.0)),
        FrameOrientation(link),
        PointAlong(0, (0.1, 0.0, 0.0), 2, True),
    )
    task = Task(rows)
    a, b = Rotation.random(rng=rng), Rotation.random(rng=rng)
    places, cone = rng.normal(size=(2, 3)), (0.3, 0.5)

    def goal(turned, place, angle):
        u = turned.as_matrix().T[:2]
        across = np.column_stack([u, u @ place])
        return np.concatenate(
            [place, turned.apply([0, 0, 1]), [angle], turned.as_matrix().ravel(), across.ravel(), [0.01]]
        )

    goals = np.stack([goal(a, places[0], cone[0]), goal(b, places[1], cone[1])])[None].repeat(3, axis=0)
    share = np.array([0.0, 0.25, 1.0])
    found = task.interpolated(goals, share, places[None].repeat(3, axis=0))
    np.testing.assert_allclose(found[[0, 2]], goals[0], atol=1e-12)
    place, way = places[0] + 0.25 * (places[1] - places[0]), (b * a.inv()).as_rotvec()
    np.testing.assert_allclose(found[1, :3], place)
    from_a, from_b = (np.arccos(found[1, 3:6] @ each.apply([0, 0, 1])) for each in (a, b))
    np.testing.assert_allclose(3 * from_a, from_b)
    assert found[1, 6] == 0.35
    np.testing.assert_allclose(
        found[1, 7:16].reshape(3, 3), (Rotation.from_rotvec(0.25 * way) * a).as_matrix(), atol=1e-12
    )
    planes = found[1, 16:24].reshape(2, 4)
    np.testing.assert_allclose(planes[:, :3] @ place, planes[:, 3])
    np.testing.assert_allclose(np.linalg.norm(planes[:, :3], axis=1), 1.0)
    np.testing.assert_allclose(task.turn(goals), max(np.linalg.norm(way), from_a + from_b))


def test_goals_are_inserted_where_the_task_turns_the_tool_by_more_than_its_cones_allow():
    path = [[0.5, 0.0, 0.3], [0.5, 0.002, 0.3], [0.5, 0.004, 0.3]]
    angles = np.deg2rad([0.0, 19.0, 20.0])
    normals = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1)
    found = {}
    for cone_deg in (None, 5.0, 15.0):
        task = Task((TaskPoint(), AxisTowards(None, (0.0, 0.0, 1.0), cone=cone_deg is not None)))
        cone = [np.deg2rad(cone_deg or 0.0)]
        goals = np.stack([np.concatenate([place, normal, cone]) for place, normal in zip(path, normals, strict=True)])
        stacked = scenarios.stack([replace(scenario(path), task_goals=goals[[0, 0, 1, 2]])])  # target 1 begins the path
        found[cone_deg] = pieces_of(toy.robot(), task, stacked, toy.SETTINGS)[0, 1:].tolist()
    widest = np.sqrt(8 * 0.125 * toy.SETTINGS.tube_m / (0.1 * kinematics.max_reach(toy.robot())))
    assert found[None] == [1, np.ceil(angles[1] / widest), 1]
    assert found[5.0] == [1, np.ceil((angles[1] - 2 * np.deg2rad(5.0)) / widest), 1]
    assert found[15.0] == [1, 1, 1]
    assert found[None][1] > found[5.0][1] > 1


def test_an_arm_on_a_slide_without_limits_gets_no_inserted_goals(monkeypatch):
    monkeypatch.setattr(kinematics, "max_reach", lambda robot: np.inf)
    found = pieces_of(toy.robot(), TOY_TASK, scenarios.stack([scenario(CORNERS)]), toy.SETTINGS)
    np.testing.assert_array_equal(found, np.ones_like(found))


def test_inserted_scenarios_keep_the_files_goals_to_the_last_bit():
    stacked = scenarios.stack([toy.scenario(), scenario(CORNERS)])
    pieces = pieces_of(toy.robot(), TOY_TASK, stacked, toy.SETTINGS)
    parts = PathParts.of(pieces, stacked.count)
    denser = inserted(TOY_TASK, stacked, parts)
    for s, count in enumerate(stacked.count):
        np.testing.assert_array_equal(denser.targets[s, parts.row[s, :count]], stacked.targets[s, :count])
        assert denser.count[s] == parts.row[s, count - 1] + 1


def test_validation_turns_directions_between_targets_as_inserted_goals_do():
    rng = np.random.default_rng(5)
    path, turns = rng.normal(size=(3, 3)), Rotation.random(3, rng=rng)
    normals = turns.apply([0.0, 0.0, 1.0])
    part = WorkpieceData(path, path, None, np.empty((0, 3, 3)), 0.0, normals, None, turns.as_matrix())
    rows = AxisRow(axis="tcp.z", towards="path.normal"), OrientationRow(orientation="path")
    point, share = np.array([1, 2, 2, 1]), np.array([0.0, 0.4, 1.0, 0.7])
    found = part_between(rows, np.eye(3), np.zeros(3), part, point, share)
    columns = np.concatenate([path, normals, np.zeros((3, 1)), turns.as_matrix().reshape(3, 9)], axis=1)
    task = Task((TaskPoint(), AxisTowards(None, (0.0, 0.0, 1.0), cone=False), FrameOrientation(None)))
    goals = task.interpolated(np.stack([columns[point - 1], columns[point]], axis=1), share)
    np.testing.assert_allclose(found.workpiece.path[found.point], goals[:, :3], atol=1e-12)
    np.testing.assert_allclose(found.workpiece.normals[found.point], goals[:, 3:6], atol=1e-12)
    np.testing.assert_allclose(found.workpiece.rotations[found.point].reshape(4, 9), goals[:, 7:], atol=1e-12)


# The longest joint step


def travelled(plans, s, t):
    return np.abs(np.diff(joint_path(plans, s, t), axis=0)).sum(axis=0)


@pytest.mark.parametrize("method", ["beam", pytest.param("hybrid", marks=pytest.mark.slow)])
def test_no_joint_travels_farther_between_two_targets_than_the_bound(method):
    free, some = toy.plans_by(method), [1, 3]  # the scenarios with the longest steps
    of = [toy.scenarios()[s] for s in some]
    on_path = np.array([int(one.on_path) for one in toy.scenarios()])
    bound = 0.6 * float(np.nanmax(motions.largest_joint_steps(free, on_path).step))
    on_path = on_path[some]
    plans = toy.planned(of, method, replace(toy.SETTINGS, max_joint_step_rad=bound), threads=1)
    seen = 0
    for s, t in np.argwhere(plans.tracked).tolist():
        if t > on_path[s]:
            assert (travelled(plans, s, t) <= bound).all()
            seen += 1
    assert seen > 5 and plans.tracked.sum() < free.tracked[some].sum() + 5
    assert np.nanmax(motions.largest_joint_steps(plans, on_path).step) <= bound


def test_a_bound_that_nothing_reaches_changes_nothing():
    free, bounded = toy.plans_by(), toy.plans_by(settings=replace(toy.SETTINGS, max_joint_step_rad=(50.0,) * 4))
    for s, one in enumerate(toy.scenarios()):
        toy.same(free, s, bounded, s, int(one.count))


def test_the_bound_holds_for_the_sum_over_inserted_goals():
    whole = rectangle("baseline")[0]
    largest = motions.largest_joint_steps(whole, 1)
    t, j = int(largest.target[0]), int(largest.joint[0])
    np.testing.assert_allclose(largest.step[0], travelled(whole, 0, t)[j])
    bound = 1.5 * float(largest.step[0])
    bounded = rectangle("baseline", max_joint_step_rad=bound)[0]
    assert bounded.tracked[0, 2:].any()
    assert max(travelled(bounded, 0, t).max() for t in range(2, 5) if bounded.tracked[0, t]) <= bound


@pytest.mark.parametrize("smooth, factor", [(False, 1.001), (True, 1.5)])
def test_beam_may_use_all_of_the_bound_on_any_part_of_a_segment(smooth, factor):
    """Regression: on each part between inserted goals only its share was allowed, and the first segment was lost."""
    bound = factor * float(motions.largest_joint_steps(rectangle(smooth=smooth)[0], 1).step[0])
    bounded = rectangle(smooth=smooth, max_joint_step_rad=bound)[0]
    assert bounded.executable.all()
    assert max(travelled(bounded, 0, t).max() for t in range(2, 5)) <= bound


def test_a_search_backwards_counts_a_segment_s_travel_from_its_end():
    """Three rows on the segment to target 1, then a self-motion at it, which belongs to the segment to target 2."""
    bounds = JointSteps(np.array([[0, 1, 1, 1, 2, 3]]), np.full((1, 6, 1), 10.0))
    tree, x, target = BeamTree(1), (0.0, 1.0, 3.0, 7.0, 15.0), (4, 3, 3, 2, 2)
    at = [State(np.array([[q]]), clearance=np.zeros(1), residual=np.zeros(1), tcp=np.zeros((1, 3))) for q in x]
    rows = [tree.plant(at[0], target[0])]
    for k in range(1, 5):
        rows.append(tree.grow(rows[-1], at[k], target[k], by_self_motion=target[k] == target[k - 1]))
    s = np.zeros(1, int)
    left = [float(bounds.left(tree, rows[k], s, np.array([row]))[0, 0]) for k, row in ((2, 4), (2, 3), (3, 2), (4, 2))]
    np.testing.assert_allclose(left, [7.0, 10.0, 6.0, -2.0])
    backwards = tree.nodes(np.concatenate(rows)[:4])
    assert bounds.are_kept(0, tables.gather(backwards, np.arange(4)[::-1]))
    assert not bounds.are_kept(0, tables.gather(tree.nodes(np.concatenate(rows)), np.arange(5)[::-1]))


@pytest.mark.parametrize("bound", [0.0, -1.0, (0.1, 0.0, 0.1, 0.1), (0.1, 0.1)])
def test_a_bound_of_0_or_of_another_number_of_joints_is_refused(bound):
    with pytest.raises(InputError, match="max_joint_step_rad") as refused:
        toy.planned(settings=replace(toy.SETTINGS, max_joint_step_rad=bound))
    assert "\n" not in str(refused.value)
