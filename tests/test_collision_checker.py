"""The collision checker: its answers are those of plain computations, for any batch and number of threads.

A problem is final: a method gets it with all starts chosen, and nothing can write into it.
"""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
import toy
from small_motions import SMALL, in_duct, off_line, planned, poses
from sphere_references import place

from htcp_jax.clearance import in_workpiece
from htcp_jax.clearance.obstacles.tip_guard import TipGuard, WallTriangles, make_tip_guard
from htcp_jax.clearance.proof.motion_proof import Tube
from htcp_jax.device import Executor
from htcp_jax.device.tables import gather
from htcp_jax.io.parts.workpiece_source import load_workpiece
from htcp_jax.model.kinematics import tcp_position, tip_bounds, tip_segment
from htcp_jax.model.robot import lengthen_tool
from htcp_jax.model.scenario import stack
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.motion import CollisionChecker
from htcp_jax.motion.home import begin_at_home, leave_home
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.motion.motion_check import check_remaining_paths, raise_air_moves, tighten, verify_motions
from htcp_jax.motion.plans import ARRAYS
from htcp_jax.motion.smoothing import smooth
from htcp_jax.motion.tip_motions import PLACES, TIP_STEP_M
from htcp_jax.planning import registry
from htcp_jax.planning.batch import plan
from htcp_jax.settings import Settings
from htcp_jax.status import SegmentStatus, Status

MANY, MARGIN_M = 200, 0.001
TIPS = made_once.quick_jit(
    jax.vmap(lambda robot, where, x: in_workpiece(where, tip_segment(robot, x)), (None, None, 0))
)
TCPS = made_once.quick_jit(jax.vmap(tcp_position, (None, 0)))


@cache
def guard():
    return make_tip_guard(load_workpiece(tip_contact_m=0.01))


@cache
def checker(threads=1, guarded=True):
    executor = Executor(made_once.scene(), Settings(), threads=threads)
    return CollisionChecker(executor, Settings(), guard() if guarded else None)


@cache
def one():
    """A scenario with the pose of a recorded configuration deep in the duct, and that configuration."""
    where, x = place(86)
    pose = {"T_world_workpiece": where.T_world_workpiece, "interior_plane": where.interior_plane}
    return jax.tree.map(np.asarray, replace(made_once.nominal(), **pose)), np.asarray(x)


@cache
def lanes():
    """Configurations in the duct, most with their own TCP as the target, and others to move to; many collide."""
    scenario, x = one()
    a = made_once.configurations_near(x, MANY, 0.05)
    inputs = lane_inputs(stack([scenario]), np.zeros(MANY, int), np.zeros(MANY, int))
    own = np.asarray(TCPS(made_once.robot(), a))
    target = np.where((np.arange(MANY) % 3 == 0)[:, None], own + 0.002, own)
    return inputs._replace(target=target, margin_m=np.full(MANY, MARGIN_M)), a, a + 0.3 * (a - x)[::-1]


def clearances(x):
    return made_once.measured(one()[0], x)[0]


def tip_passes(x):
    tips = np.asarray(TIPS(made_once.robot(), one()[0], x))
    return guard().passes(tips[:, 0], tips[:, 1])


def places(a, b, count):
    """Configurations (count, N) between two, without the ends."""
    return a + np.arange(1, count)[:, None] / count * (b - a)


@cache
def sampled():
    """Smallest clearance of each path at PLACES configurations, and True where the tip passes there."""
    _, a, b = lanes()
    x = np.concatenate([places(*ends, PLACES) for ends in zip(a, b, strict=True)])
    return clearances(x).reshape(MANY, -1).min(axis=1), tip_passes(x).reshape(MANY, -1).any(axis=1)


def test_states_are_those_of_the_functions_of_one_configuration():
    inputs, q, _ = lanes()
    here = checker().states(inputs, q)
    np.testing.assert_array_equal(here.x, q)
    np.testing.assert_allclose(here.clearance, clearances(q), rtol=0, atol=1e-12)
    np.testing.assert_allclose(here.tcp, TCPS(made_once.robot(), q), rtol=0, atol=1e-12)
    np.testing.assert_allclose(here.residual, np.linalg.norm(here.tcp - inputs.target, axis=1), rtol=0, atol=1e-12)
    np.testing.assert_allclose(here.linear.clearance.distance.min(axis=1), here.clearance, rtol=0, atol=1e-12)


def test_valid_is_what_keeps_the_margin_on_the_target_with_its_tip_out_of_the_walls():
    inputs, q, _ = lanes()
    on, clear, free = np.arange(MANY) % 3 != 0, clearances(q) >= MARGIN_M, ~tip_passes(q)
    here, among = checker().states(inputs, q), np.arange(MANY) % 2 == 0
    assert checker().valid(inputs, here).tolist() == (on & clear & free).tolist()
    assert checker(guarded=False).valid(inputs, here).tolist() == (on & clear).tolist()
    assert checker().valid(inputs, here, among).tolist() == (on & clear & free & among).tolist()
    for one, other in ((on & clear, ~free), (on & free, ~clear), (clear & free, ~on), (on & clear, free)):
        assert (one & other).any()


def test_what_is_projected_is_on_its_target():
    inputs, q, _ = lanes()
    x = checker().project(inputs, q)
    assert np.linalg.norm(TCPS(made_once.robot(), x) - inputs.target, axis=1).max() < 1e-4
    assert (x[::3] != q[::3]).any(axis=1).all()


def test_proven_edges_are_clear_at_all_places_and_refuted_ones_collide_where_they_say():
    inputs, a, b = lanes()
    bare, guarded = checker(guarded=False).edges(inputs, a, b), checker().edges(inputs, a, b)
    smallest, passes = sampled()
    valid, there = bare.verdict == SegmentStatus.VALID, clearances(a + bare.place[:, None] * (b - a))
    assert (smallest >= bare.clearance)[valid].all() and (bare.clearance[valid] > 0).all()
    assert (bare.verdict[~valid] == SegmentStatus.IN_COLLISION).all() and (there[~valid] <= 0).all()
    expected = np.where(passes & (bare.verdict == SegmentStatus.VALID), int(SegmentStatus.IN_COLLISION), bare.verdict)
    assert guarded.verdict.tolist() == expected.tolist() != bare.verdict.tolist()
    assert len(np.unique(bare.verdict)) == 2


def test_the_bare_tip_of_a_long_path_passes_through_no_triangle_at_any_place():
    """Check a swing in free air across triangles: between two of the first 100 places, and at both ends' next place."""
    scenario, x = one()
    pose, no_interior = np.array(scenario.T_world_workpiece), np.array([0, 0, 0, 1e3])
    pose[2, 3] += 10
    far = replace(scenario, T_world_workpiece=pose, interior_plane=no_interior)
    inputs = lane_inputs(stack([far]), np.zeros(1, int), np.zeros(1, int))
    where, count = place(86)[0]._replace(T_world_workpiece=jnp.asarray(pose)), 2665  # count * (PLACES / count) > PLACES
    swing = (count - 0.5) * TIP_STEP_M / tip_bounds(made_once.robot()).speeds[0]
    a, b = x[None], x[None] + swing * np.eye(6)[:1]
    large = 100 + np.eye(3)  # far away; without it the search would cut the tip into pieces of micrometres
    for share, size in ((0.505, 1e-3), (1 / count, 1e-5), ((count - 1) / count, 1e-5)):
        tip = np.asarray(in_workpiece(where, tip_segment(made_once.robot(), jnp.asarray(x + share * (b - a)[0]))))
        along = (tip[1] - tip[0]) / np.linalg.norm(tip[1] - tip[0])
        u = np.cross(along, [0, 0, 1]) / np.linalg.norm(np.cross(along, [0, 0, 1]))
        triangle = tip.mean(axis=0) + size * np.array([u, np.cross(along, u), -u - np.cross(along, u)])
        for offset, free in ((0, False), (0.1 * along, True)):
            wall = TipGuard(WallTriangles(np.stack([triangle + offset, large])), 0.0)
            guarded = CollisionChecker(checker().executor, Settings(), wall)
            assert guarded.path_clear(inputs, a, b).tolist() == [free]


def test_walls_beyond_the_tip_s_travel_are_those_that_no_place_passes_through():
    """Compare with all places of long paths, whose numbers the bound on the tip's travel gives, among small walls."""
    scenario, x = one()
    pose, count = np.array(scenario.T_world_workpiece), 24
    pose[2, 3] += 10
    far = replace(scenario, T_world_workpiece=pose, interior_plane=np.array([0, 0, 0, 1e3]))
    rng, where = np.random.default_rng(5), place(86)[0]._replace(T_world_workpiece=jnp.asarray(pose))
    a, b = x + rng.uniform(-0.5, 0.5, (2, count, len(x)))
    robot = made_once.robot()
    seen = np.asarray(TIPS(robot, where, a + rng.random((count, 1)) * (b - a))).mean(axis=1)
    walls = seen[: 2 * count // 3, None] + rng.uniform(-0.02, 0.02, (2 * count // 3, 3, 3))
    large = 100 + np.eye(3)[None]  # far away; without it the search would cut the tip into pieces of micrometres
    wall = TipGuard(WallTriangles(np.concatenate([walls, large])), 0.0)
    counts = np.ceil(np.abs(b - a) @ tip_bounds(robot).speeds / TIP_STEP_M).astype(int)
    passes = []
    for k in range(count):
        q = np.concatenate([places(a[k], b[k], n) for n in (PLACES, counts[k])])
        tips = np.asarray(TIPS(robot, where, np.resize(q, (max(counts) + PLACES, len(x)))))
        passes.append(bool(wall.passes(tips[:, 0], tips[:, 1]).any()))
    inputs = lane_inputs(stack([far]), np.zeros(count, int), np.zeros(count, int))
    free = CollisionChecker(checker().executor, Settings(), wall).path_clear(inputs, a, b)
    assert free.tolist() == np.logical_not(passes).tolist() and 5 < free.sum() < count - 5


def test_the_tcp_of_a_proven_edge_stays_in_its_tube():
    inputs, a, b = lanes()
    start, end = (np.asarray(TCPS(made_once.robot(), x)) for x in (a, b))
    robot, radius = made_once.robot(), np.full(MANY, 1e-4)
    found = checker(guarded=False).edges(inputs, a, b, Tube(start, end, radius)).verdict
    tcps = np.asarray(TCPS(robot, np.concatenate([places(*ends, PLACES) for ends in zip(a, b, strict=True)])))
    for k, verdict in enumerate(found):
        off = off_line(start[k], end[k], tcps.reshape(MANY, -1, 3)[k]).max()
        assert verdict != SegmentStatus.VALID or off <= 1e-4
    assert {SegmentStatus.VALID, SegmentStatus.OFF_PATH} <= set(found.tolist())


@pytest.mark.parametrize("test", ["bisection", "samples"])
def test_a_path_is_clear_by_the_test_of_the_settings(test):
    """By samples, one of a hundred places is enough to refute it; the tip is checked in either case."""
    inputs, a, b = lanes()
    settings = Settings(path_test=test, path_steps=PLACES)
    found = CollisionChecker(
        checker().executor if test == "bisection" else Executor(made_once.scene(), settings), settings, guard()
    )
    smallest, passes = sampled()
    clear = (smallest > 0) & ~passes
    assert found.path_clear(inputs, a, b).tolist() == clear.tolist()
    assert clear.any() and not clear.all()


@pytest.mark.parametrize("threads", [1, 3])
def test_other_rows_and_threads_have_no_influence(threads):
    inputs, a, b = lanes()
    whole = checker().states(inputs, a), checker().edges(inputs, a, b)
    for rows in (slice(None), slice(3, None, 7), [MANY - 1]):
        own, x, y = gather((inputs, a, b), rows)
        found = checker(threads).states(own, x), checker(threads).edges(own, x, y)
        jax.tree.map(np.testing.assert_array_equal, found, gather(whole, rows))


# A problem


def problem_of(scenarios, threads=1, settings=SMALL):
    return in_duct(scenarios, settings, threads=threads)


def test_nothing_in_a_problem_can_be_written_into():
    given = stack(poses())
    problem = replace(problem_of(poses()), scenarios=given)
    for array in (*jax.tree.leaves(problem.scenarios), problem.begins_anywhere):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    with pytest.raises(AttributeError):
        problem.scenarios = given
    given.refused[:] = 7  # what the problem was made of stays the caller's


class Spy(registry.Method):
    """A planner that keeps its problem, after `act`."""

    name, title, description = "spy", "Spy", "keeps its problem"

    def __init__(self, act=lambda problem: None):
        self._act = act

    def plan(self, problem):
        self.problem = problem
        self._act(problem)
        plans = problem.empty_plans()
        plans.status[problem.to_plan, 0] = Status.NO_SOLUTION
        return plans


def planned_by(spy, scenarios):
    registry.METHODS.register(spy)
    try:
        return plan(in_duct(scenarios, threads=1), "spy")
    finally:
        registry.METHODS._own.pop("spy")


@pytest.mark.parametrize("column", ["refused", "x_start", "targets"])
def test_a_method_that_writes_into_its_problem_fails(column):
    def write(problem):
        getattr(problem.scenarios, column)[0] = 0

    with pytest.raises(ValueError, match="read-only"):
        planned_by(Spy(write), poses()[:1])


def test_a_method_gets_chosen_starts_and_known_refusals():
    """A start chosen at the first target, a home in collision; the scenarios that were given stay as they are."""
    free, home = make_scenario(made_once.robot(), made_once.duct(), None, number=3), np.array(made_once.START)
    touching = one()[1] + np.array([0.3, 0, 0, 0, 0, 0])
    scenarios = stack([free, replace(free, x_home=home), replace(free, x_home=touching)])
    before = jax.tree.map(np.array, scenarios)
    plans = planned_by(spy := Spy(), scenarios)
    final = spy.problem.scenarios
    assert spy.problem.to_plan.tolist() == [0, 1]
    assert plans.status[:, 0].tolist() == [Status.NO_SOLUTION, Status.NO_SOLUTION, Status.HOME_IN_COLLISION]
    inputs = lane_inputs(final, np.arange(2), np.zeros(2, int))
    own = spy.problem.checkers[0]
    assert own.valid(inputs, own.states(inputs, final.x_start[:2])).all()
    jax.tree.map(np.testing.assert_array_equal, scenarios, before)


def test_every_thread_gets_a_checker_and_its_share_of_the_rows():
    problem, rows = problem_of(poses(), threads=3), np.arange(10)
    found = problem.in_threads(lambda checker, share: (checker in problem.checkers, rows[share].tolist()))
    assert found == [(True, [0, 3, 6, 9]), (True, [1, 4, 7]), (True, [2, 5, 8])]
    with pytest.raises(ZeroDivisionError):
        problem.in_threads(lambda checker, share: 1 // share.start, 2)


def test_goals_follow_the_targets_of_an_approach_that_left_its_lines():
    one = poses()[0]
    first, goals = int(one.on_path), np.arange(4.0 * len(one.targets)).reshape(-1, 4)
    problem = problem_of([one]).with_scenarios(stack([replace(one, task_goals=goals)] * 2))
    plans = problem.empty_plans()
    assert problem.as_planned(plans) is problem
    plans.target[1, 1:first] = plans.target[1, first]
    there = problem.as_planned(plans)
    np.testing.assert_array_equal(there.scenarios.targets, plans.target)
    np.testing.assert_array_equal(there.scenarios.task_goals[0], goals)
    assert (there.scenarios.task_goals[1, 1:first] == goals[first]).all() and there.checkers is problem.checkers
    np.testing.assert_array_equal(
        np.delete(there.scenarios.task_goals[1], range(1, first), 0), np.delete(goals, range(1, first), 0)
    )


def test_a_step_stays_on_the_path_where_a_dense_sampling_of_it_does():
    """Steps of plans, and others near them: off the line, backwards, or free before the path and between seams."""
    problem, plans, rng = problem_of(poses()), planned(), np.random.default_rng(7)
    s, t = (np.repeat(each, 4) for each in np.nonzero(plans.executable))
    a, b = plans.before(s, t), plans.x[s, t]
    b = np.where((np.arange(len(s)) % 4 == 0)[:, None], b, b + rng.choice([1e-4, 1e-3, 0.1], (len(s), 1)) * (b - a))
    b[1::4] += 1e-3 * rng.normal(size=b[1::4].shape)
    b[2::4] = 2 * a[2::4] - b[2::4]
    found = problem.checkers[0].stays_on_path(problem.inputs(s, t), a, b, problem.tubes(s, t))
    free, expected, clear_cut = t <= problem.scenarios.on_path[s], [], []
    for k in range(len(s)):
        arm = made_once.robot()
        arm = lengthen_tool(arm, problem.scenarios.tool_extension_m[s[k]])
        start, end = problem.scenarios.targets[s[k], [max(t[k] - 1, 0), t[k]]]
        tcp = np.asarray(TCPS(arm, np.concatenate([a[k, None], places(a[k], b[k], PLACES), b[k, None]])))
        off, ahead = off_line(start, end, tcp).max(), np.diff(tcp @ (end - start)).min()
        expected.append(free[k] or (off <= problem.settings.tube_m and ahead >= 0))
        clear_cut.append(free[k] or (abs(off - problem.settings.tube_m) > 1e-6 and abs(ahead) > 1e-10))
    sure = np.array(clear_cut)
    assert found[sure].tolist() == np.array(expected)[sure].tolist() and sure.mean() > 0.95
    assert free.any() and (found & ~free).sum() > 20 and (~found).sum() > 20
    proofs = problem.checkers[0].edges(problem.inputs(s, t), a, b, problem.tubes(s, t))
    assert found[proofs.verdict == SegmentStatus.VALID].all()
    assert not found[np.isin(proofs.verdict, [SegmentStatus.OFF_PATH, SegmentStatus.REVERSES])].any()


def test_steps_after_a_method_return_plans_and_change_none():
    """Arrays that cannot be written into go through every step."""
    settings, scenarios = replace(toy.SETTINGS, smooth=False), toy.scenarios()
    problem, segments = leave_home(toy.problem(scenarios, settings, threads=1))
    given = toy.planned(settings=settings, threads=1)
    plans = given._replace(
        path_clear=np.full_like(given.path_clear, -1),
        segment_status=np.full_like(given.segment_status, SegmentStatus.NOT_CHECKED),
    )
    steps = (
        check_remaining_paths,
        lambda p, each: begin_at_home(p, each, segments),
        verify_motions,
        smooth,
        verify_motions,
        tighten,
    )
    for step in steps:
        for name in ARRAYS:
            getattr(plans, name).flags.writeable = False
        before = {name: array.copy() for name, array in plans.arrays().items()}
        after = step(problem, plans)
        for name, array in before.items():
            np.testing.assert_array_equal(getattr(plans, name), array, err_msg=name)
        plans = after
    assert (plans.segment_status == given.segment_status).all() and plans.executable.any()


def test_the_bound_of_an_air_move_is_raised_until_the_path_decides_the_guaranteed_clearance():
    given, problem = toy.plans_by(), leave_home(toy.problem(threads=1))[0]
    along = ~problem.off_path(*np.indices(given.executable.shape)) & given.executable
    s = int(np.flatnonzero(along.any(axis=1))[0])
    bound = given.segment_clearance.copy()
    bound[s, 0] = 1e-9
    raised = raise_air_moves(problem, given._replace(segment_clearance=bound)).segment_clearance
    np.testing.assert_array_equal(raised[along], bound[along])
    steps = np.linspace(0, 1, 200)[:, None] * (given.x[s, 0] - given.start[s])
    clearance = toy.measured(toy.scenarios()[s], given.start[s] + steps)[0].min()
    assert min(bound[s, along[s]].min(), 0.97 * clearance) <= raised[s, 0] <= clearance


def test_the_bounds_of_air_moves_are_raised_together_as_one_by_one():
    given, problem = toy.plans_by(), leave_home(toy.problem(threads=1))[0]
    moved = np.flatnonzero(given.executable[:, 0])
    assert len(moved) > 1

    def raised(scenarios):
        bound = given.segment_clearance.copy()
        bound[scenarios, 0] = 1e-9
        return raise_air_moves(problem, given._replace(segment_clearance=bound)).segment_clearance[scenarios, 0]

    together = raised(moved)
    assert (together > 1e-9).all()
    np.testing.assert_array_equal(together, [raised(s) for s in moved.tolist()])
