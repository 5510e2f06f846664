"""Planning engine: its lanes, shared work and phases; nothing compiles twice, a failed QP fails one scenario only."""

import threading
from dataclasses import replace

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
import toy

from htcp_jax.device import Executor
from htcp_jax.device.executor import EXECUTABLES, ExecutableCache
from htcp_jax.device.lane_function import STEP, LaneFunction
from htcp_jax.device.tables import gather_from
from htcp_jax.model.scenario import stack
from htcp_jax.motion import CollisionChecker
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.motion.step_functions import ADVANCE, STEPS_PER_CHUNK
from htcp_jax.planning.methods import find
from htcp_jax.planning.tracking import Engine
from htcp_jax.planning.tracking.candidates import nearest
from htcp_jax.planning.tracking.lanes import DRAWING, NEW, TRACK, Lanes, LaneTable, Work
from htcp_jax.planning.tracking.stages import ENTER
from htcp_jax.solvers import ClarabelSolver
from htcp_jax.solvers.step_qp import QPSolution, QPStatus
from htcp_jax.status import Status

PAPER = replace(toy.SETTINGS, **made_once.PAPER_CHOICES)
SHIFTS = (0.0, 0.0, 0.0), (0.0, 0.05, 0.03), (0.03, 0.0, -0.03)
COMPARED = ("x", "status", "clearance", "residual", "iterations", "recovery")


class Noting(Executor):
    """Executor that keeps a log of its calls: name, number of lanes."""

    def __init__(self, *scene):
        super().__init__(*scene)
        self.log = []

    def __call__(self, lane_function, inputs, *tables):
        self.log.append((lane_function.name, len(inputs.row)))
        return super().__call__(lane_function, inputs, *tables)


class AsOnGpu(Noting):
    """Executor whose calls take as long for one lane as for many."""

    pays_by_lane = False


class FourLanes(Executor):
    """Executor for four lanes at a time."""

    lanes = 4


def clarabel(cls=ClarabelSolver):
    return cls(2 * np.array(PAPER.q_weights), 1, PAPER.qp_tolerance)


def planned_by(executor, method="baseline", settings=PAPER, solver=None):
    """Plans that one engine makes of all scenarios with these lane functions and this QP solver."""
    problem = toy.problem(settings=settings, threads=1)
    work, plans = Work(list(range(len(problem.scenarios.number))), 1), problem.empty_plans()
    checker = CollisionChecker(executor, settings)
    Engine(problem, checker, solver or clarabel(), find(method), plans, work).run()
    return plans


def same(a, b, rows=slice(None)):
    for name in COMPARED:
        np.testing.assert_array_equal(getattr(a, name)[rows], getattr(b, name)[rows], err_msg=name)


# Lanes, phases and work


@pytest.mark.parametrize("method", ["nspace-sqp", "cspace-sample"])
@pytest.mark.parametrize("after_recovery", ["accept", "track"])
def test_which_phase_goes_first_changes_no_plan_and_on_a_gpu_calls_are_fuller(method, after_recovery):
    settings = replace(PAPER, after_recovery=after_recovery)
    every, fuller = Noting(toy.scene(), settings), AsOnGpu(toy.scene(), settings)
    same(planned_by(every, method, settings), planned_by(fuller, method, settings))
    recovery = "null space 0" if method == "nspace-sqp" else "sample 0"
    lanes, fewer = ([count for name, count in executor.log if name == recovery] for executor in (every, fuller))
    assert sum(fewer) == sum(lanes) and len(fewer) < len(lanes)


@pytest.mark.parametrize("method", ["baseline", "nspace-sqp"])
def test_the_margin_of_a_seam_is_the_one_that_a_plan_keeps(method):
    """Also at the start of tracking, where a lane that is too near is not called blocked at its tip."""
    own = [toy.scenario(k, shift=shift, margin_m=0.02) for k, shift in enumerate(SHIFTS)]
    of_seams = [
        replace(each, margin_m=np.array(0.0), seam_margins_m=np.tile([0.02, 0.0], (len(each.targets), 1)))
        for each in own
    ]
    ended, expected = (toy.planned(each, method, PAPER, threads=1) for each in (of_seams, own))
    same(ended, expected)
    assert (expected.status == Status.TRACKED).any()


def test_fewer_slots_than_scenarios_change_no_plan():
    same(planned_by(Executor(toy.scene(), PAPER)), planned_by(FourLanes(toy.scene(), PAPER)))


def lanes_of(table: LaneTable) -> Lanes:
    """Lanes in flight, which leave the table."""
    ((_, lanes),) = table.next_chunk()
    return lanes


def table_of(work: Work) -> LaneTable:
    """Lane table of an engine with four slots."""
    return LaneTable(FourLanes(toy.scene(), PAPER), stack(toy.scenarios() * 2), work)


def left_by(table: LaneTable, work: Work) -> list[int]:
    """Scenarios of the lanes that the table leaves to an engine that waits, while it fills itself."""
    got = []
    idle = threading.Thread(target=lambda: got.append(work.wait()))
    idle.start()
    while not work.has_idle_engine:
        pass
    assert table.fill()
    if not got:
        work.end()
    idle.join()
    return [] if got == [None] else got[0].scenario.tolist()


def test_a_table_is_filled_from_its_queue_first_and_then_with_new_scenarios():
    table = table_of(Work(list(range(9)), 2))
    assert table.fill()
    first = lanes_of(table)
    assert first.scenario.tolist() == [0, 2, 4, 6] and (first.phase == NEW).all()
    table.queue(first._replace(phase=np.full(4, TRACK, np.int32)))
    assert table.fill()
    assert lanes_of(table).scenario.tolist() == [0, 2, 4, 6]
    assert table.fill()
    assert lanes_of(table).scenario.tolist() == [8, 1, 3, 5]


@pytest.mark.parametrize("queued", [False, True])
def test_half_of_an_engine_s_lanes_go_to_one_that_is_idle(queued):
    """Leave every other lane, of those queued if there are any; together they are those there were."""
    work = Work(list(range(4)), 2)
    table = table_of(work)
    assert table.fill() and table.fill()
    before = lanes_of(table)
    assert sorted(before.scenario.tolist()) == [0, 1, 2, 3]
    (table.queue if queued else table.keep)(before)
    left = left_by(table, work)
    assert len(left) == 2 and sorted(left + lanes_of(table).scenario.tolist()) == [0, 1, 2, 3]


def test_lanes_planned_backwards_stay_with_their_engine():
    work = Work(list(range(4)), 2)
    table = table_of(work)
    assert table.fill() and table.fill()
    table.keep(lanes_of(table)._replace(phase=np.full(4, DRAWING, np.int32)))
    assert left_by(table, work) == []
    assert lanes_of(table).size == 4


def test_an_engine_without_work_ends_when_no_other_one_has_any():
    work = Work([0], 1)
    table = table_of(work)
    assert table.fill() and lanes_of(table).size == 1
    assert not table.fill()


@pytest.mark.parametrize("method", ["nspace-sqp", "cspace-sample"])
def test_engines_that_share_their_lanes_make_the_plans_of_one(method):
    same(toy.plans_by(method, PAPER), toy.planned(method=method, settings=PAPER, threads=4))


def test_an_engine_that_breaks_lets_the_others_end():
    def breaking(progress):
        raise ArithmeticError("broken")

    with pytest.raises(ArithmeticError, match="broken"):
        toy.planned(method="baseline", settings=PAPER, threads=3, progress=breaking)


def test_null_space_steps_in_chunks_are_those_in_one_call():
    """Compare ten null-space steps, where the baseline is stuck, with five and from their end five more.

    All lanes but the first require a clearance of 1 m, which no step reaches.
    """
    executor, steps_of = Executor(toy.scene(), PAPER), find("nspace-sqp").stages[0].lane_function(0)
    plans = toy.plans_by("baseline", PAPER)
    lost = plans.tracked.sum(axis=1)
    which = np.arange(len(lost))
    inputs, x = lane_inputs(stack(toy.scenarios()), which, lost), plans.x[which, lost - 1]
    inputs = inputs._replace(margin_m=np.where(which > 0, 1.0, inputs.margin_m))
    begin, zero, five = executor(ENTER, inputs, x).x, np.zeros(len(lost), np.int32), np.int32(STEPS_PER_CHUNK)
    whole, null_space_steps = executor(steps_of, inputs, x, begin, zero, zero + 2 * five)
    half, at = executor(steps_of, inputs, x, begin, zero, zero + five)
    rest, end = executor(steps_of, inputs, x, half.x, at, at + five)
    more = null_space_steps > five  # the first lane may be clear before
    assert more.sum() >= 4 and (at[more] == five).all()
    np.testing.assert_array_equal(end[more], null_space_steps[more])
    np.testing.assert_array_equal(rest.x[more], whole.x[more])


def test_the_best_candidate_is_the_nearest_whose_path_is_clear():
    """Check ties and path flags: the first of equal candidates wins, unchecked paths (-1) count as clear."""
    random = np.random.default_rng(0)
    for _ in range(200):
        owner = np.sort(random.integers(0, 4, 12))
        number = np.concatenate([random.permutation(count) for count in np.unique(owner, return_counts=True)[1]])
        change = random.choice([0.1, 0.2, 0.3], 12)
        clear = random.choice([-1, 0, 0, 1], 12)
        for who, best in zip(np.unique(owner), nearest(owner, number, change, clear), strict=True):
            own = np.flatnonzero(owner == who)
            good = [k for k in own if clear[k]]
            assert best in own
            if good:
                assert best == min(good, key=lambda k: (change[k], number[k]))


def test_rows_of_many_places_come_in_their_order():
    """Compare rows gathered from two alternating tables, some selections empty, with plain concatenation."""
    rng = np.random.default_rng(0)
    tables = [(rng.normal(size=(9, 2)), rng.integers(0, 99, 9)) for _ in range(2)]
    places = [(tables[k % 2], rng.integers(0, 9, k % 4)) for k in range(1, 12)]
    found = gather_from(places)
    for column, own in enumerate(found):
        np.testing.assert_array_equal(own, np.concatenate([table[column][rows] for table, rows in places]))


# Compilation


def test_a_second_plan_compiles_nothing_whatever_the_number_of_scenarios():
    toy.planned(toy.scenarios()[:1], "baseline", PAPER)
    before = len(EXECUTABLES)
    again = toy.planned(toy.scenarios()[:3], "baseline", PAPER)
    assert len(EXECUTABLES) == before and again.compile_s == 0


def test_another_seed_compiles_nothing_and_draws_others():
    first = toy.planned(method="cspace-sample", settings=PAPER, threads=1)
    before = len(EXECUTABLES)
    other = toy.planned(method="cspace-sample", settings=replace(PAPER, seed=1), threads=1)
    assert len(EXECUTABLES) == before and other.compile_s == 0
    assert not np.array_equal(first.x, other.x, equal_nan=True)


def test_a_setting_compiles_the_lane_functions_that_read_it_and_no_others():
    toy.planned(method="cspace-sample", settings=PAPER, threads=1)
    before = len(EXECUTABLES)
    toy.planned(method="cspace-sample", settings=replace(PAPER, samples=9), threads=1)
    assert len(EXECUTABLES) == before + 1  # the lane function that draws the samples
    unread = replace(PAPER, samples=9, max_null_space_steps=7, population=9)
    toy.planned(method="cspace-sample", settings=unread, threads=1)
    assert len(EXECUTABLES) == before + 1


def test_a_lane_function_sees_no_setting_that_it_does_not_name():
    """Check that reading an undeclared setting fails: programs are shared by declared settings only."""
    reads = lambda settings, *_: settings.alpha_rad + settings.samples  # noqa: E731
    lane_function, lane = (
        LaneFunction("mine", reads, STEP, ("alpha_rad",)),
        jax.tree.map(jnp.asarray, toy.scenarios()[0]),
    )
    with pytest.raises(AttributeError, match="lane function 'mine' reads the setting samples, but does not declare it"):
        lane_function.of(PAPER)(toy.scene(), lane)


def test_programs_can_be_given_back():
    executables = ExecutableCache()
    executor = Executor(toy.scene(), PAPER, executables=executables)
    inputs = lane_inputs(stack(toy.scenarios()), np.arange(2), np.zeros(2, int))
    x = np.stack([toy.START, toy.START])
    there = executor(ADVANCE, inputs, x, np.zeros_like(x))
    assert len(executables) == 1 and executor.compile_s > 0
    executables.clear()
    assert len(executables) == 0
    np.testing.assert_array_equal(executor(ADVANCE, inputs, x, np.zeros_like(x)).x, there.x)


# A QP that breaks down


class Broken(ClarabelSolver):
    """Clarabel solver that fails on every QP whose TCP step (right-hand side b) is `victim`."""

    victim: np.ndarray

    def solve(self, qps):
        y, status = super().solve(qps)
        hit = np.isclose(qps.b, self.victim, atol=1e-12).all(axis=1)
        return QPSolution(np.where(hit[:, None], np.nan, y), np.where(hit, QPStatus.FAILED, status))


def test_a_qp_that_breaks_down_fails_its_scenario_and_no_other():
    executor = Executor(toy.scene(), PAPER)
    whole, victim = planned_by(executor), 1
    # The first actual step of the scenario leads to target 1.
    Broken.victim = toy.scenarios()[victim].targets[1] - whole.tcp[victim, 0]
    broken = planned_by(executor, solver=clarabel(Broken))
    same(broken, whole, [0, 2, 3, 4])
    assert broken.status[victim, 1] == Status.QP_FAILED
    assert (broken.status[victim, 2 : toy.scenarios()[victim].count] == Status.NOT_ATTEMPTED).all()
