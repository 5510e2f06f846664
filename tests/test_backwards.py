"""Backward planning: choice of the chain, its rows in the plan, and no delay for other scenarios."""

from typing import ClassVar, NamedTuple

import made_once
import numpy as np
import pytest

from htcp_jax.clearance import Scene
from htcp_jax.device import Executor
from htcp_jax.device.tables import concatenate, gather
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.motion import Execution, Plans, Problem
from htcp_jax.motion.motion import transfers
from htcp_jax.motion.plans import is_tracked
from htcp_jax.motion.step_functions import State
from htcp_jax.planning.batch import plan
from htcp_jax.planning.method import Method
from htcp_jax.planning.methods import BUILT_IN
from htcp_jax.planning.tracking.backwards import BackwardPlans
from htcp_jax.planning.tracking.lane_checks import LaneChecks
from htcp_jax.planning.tracking.lanes import Lanes, new_lanes
from htcp_jax.planning.tracking.record import Record
from htcp_jax.planning.tracking.stages import Recoveries
from htcp_jax.settings import Settings
from htcp_jax.status import Status

DRAWN = 3  # configurations drawn per round, in the toy below
[HYBRID] = [method for method in BUILT_IN if method.name == "hybrid"]


class Inputs(NamedTuple):
    lanes: Lanes
    round: np.ndarray


class Toy(LaneChecks):
    """One-joint arm whose configuration encodes its origin: x = 100 scenario + 10 round + number of the draw.

    A push adds 0.1. good(x, row): True if configuration x is valid at a row; clear(x): True if its chain is clear.
    """

    def __init__(self, good, clear):
        self._good, self._clear, self.calls = good, clear, []

    def inputs(self, lanes: Lanes, round_=0) -> Inputs:
        return Inputs(lanes, np.broadcast_to(round_, lanes.scenario.shape))

    def executor(self, lane_function, inputs: Inputs, *tables) -> State:
        self.calls.append((lane_function.name, inputs.lanes.scenario.tolist(), inputs.lanes.target.tolist()))
        if lane_function.name == "draw":
            name = 100.0 * inputs.lanes.scenario + 10.0 * inputs.round
            x = (name[:, None] + np.arange(DRAWN))[:, :, None]
        else:
            x = tables[0] + 0.1
        return State(x, clearance=np.ones(x.shape[:-1]), residual=np.zeros(x.shape[:-1]))

    def at_target(self, lanes: Lanes, here: State) -> np.ndarray:
        return np.array([self._good(int(x), row) for x, row in zip(here.x[:, 0], lanes.target, strict=True)], bool)

    def path_clear(self, lanes: Lanes, x: np.ndarray, requested: bool) -> np.ndarray:
        return np.array([self._clear(int(one)) for one in x[:, 0]], np.int8)

    def measured(self, lanes: Lanes, x: np.ndarray) -> State:
        linear = new_lanes((3, 1), np.zeros(len(x)), 0, x, x).linear
        return State(x, linear, np.ones(len(x)), np.zeros(len(x)), np.zeros((len(x), 3)))


def lost(*targets: int) -> Lanes:
    """Lanes of scenarios 0, 1, ... that failed at these targets after seven step QPs each."""
    x = np.zeros((len(targets), 1))
    lanes = new_lanes((3, 1), np.arange(len(targets)), np.array(targets), x, x)
    return lanes._replace(iteration=np.full_like(lanes.iteration, 7))


def empty(scenarios: int, rows: int) -> Plans:
    """Plans of a one-joint arm in which nothing is tracked."""
    return Plans.empty(np.zeros((scenarios, 1)), np.zeros((scenarios, rows, 3)))


def planned_backwards(toy: Toy, lanes: Lanes, configurations: int = 2) -> tuple[Plans, Record, dict[int, Lanes], int]:
    """Plan failed lanes backwards; return plans, record, the continued lanes by scenario, and the number of rounds."""
    count = int(lanes.scenario.max()) + 1
    plans = empty(count, 6)
    record, found, rounds = Record(plans), {}, 0
    backwards = BackwardPlans(
        toy,
        record,
        Recoveries(replan_backwards=True),
        Settings(restart_rounds=configurations),
        np.full((count, 1), -1.0),
    )
    replanned = backwards.begin(lanes)
    while replanned.going.size:
        rounds += 1
        table, going = replanned.going, []
        for phase in np.unique(table.phase):
            replanned = backwards.advance(gather(table, table.phase == phase), int(phase))
            going.append(replanned.going)
            found |= {int(s): gather(replanned.found, [k]) for k, s in enumerate(replanned.found.scenario)}
        replanned = replanned._replace(going=concatenate(going))
    return plans, record, found, rounds


def test_the_clearest_chain_whose_paths_are_clear_replaces_the_rows_so_far():
    """Three draws: draw 0 fails at row 1, draw 1 is blocked, draw 2 reaches the start."""
    toy = Toy(good=lambda x, row: not (x == 0 and row == 1), clear=lambda x: x == 2)
    plans, record, found, _ = planned_backwards(toy, lost(3))
    np.testing.assert_allclose(plans.x[0, :4, 0], [2.3, 2.2, 2.1, 2.0])
    np.testing.assert_allclose(plans.joint_step[0, :4], [3.3, 0.1, 0.1, 0.1])  # the first is from the start, -1
    np.testing.assert_array_equal(plans.status[0], [Status.TRACKED_AFTER_RECOVERY] * 4 + [Status.NOT_ATTEMPTED] * 2)
    np.testing.assert_array_equal(plans.iterations[0, :4], [0, 0, 0, 7])
    np.testing.assert_array_equal(plans.recovery[0, :4], 1)  # no stages here: the number after the last stage is 1
    np.testing.assert_array_equal(plans.path_clear[0, :4], 1)
    assert found[0].target == 3 and record.tracked == 1  # the three targets before it were tracked already


def test_when_a_round_leads_nowhere_there_is_another_and_after_the_last_the_target_is_lost():
    toy = Toy(good=lambda x, row: x >= 10, clear=lambda x: True)
    plans, _, found, _ = planned_backwards(toy, lost(2))
    np.testing.assert_allclose(plans.x[0, :3, 0], [10.2, 10.1, 10.0])
    for rounds in (0, 1):
        plans, record, found, _ = planned_backwards(toy, lost(2), configurations=rounds)
        assert not found and np.isnan(plans.x).all() and record.tracked == 0


def test_the_first_target_itself_can_be_lost():
    _, record, found, _ = planned_backwards(Toy(lambda x, row: True, lambda x: True), lost(0))
    assert found[0].target == 0 and record.tracked == 1


def test_scenarios_advance_together_and_each_comes_to_what_it_does_alone():
    """Scenarios share lane function calls, and the number of rounds is that of the longest chain."""

    def toy():
        return Toy(good=lambda x, row: x % 10 != 1 or row > 1, clear=lambda x: x % 100 >= 10 or x >= 200)

    together, _, _, rounds = planned_backwards(both := toy(), lost(4, 2, 3))
    alone = [planned_backwards(toy(), gather(lost(4, 2, 3), [k]))[3] for k in range(3)]
    assert rounds == max(alone)
    assert any(name == "push" and len(set(scenarios)) == 3 for name, scenarios, _ in both.calls)
    assert any(name == "draw" and scenarios == [0, 1, 2] for name, scenarios, _ in both.calls)
    tracked = is_tracked(together.status).sum(axis=1)
    np.testing.assert_array_equal(tracked, [5, 3, 4])


@pytest.fixture(scope="module")
def crossed():
    """Three poses of the workpiece sweep: hybrid plans backwards at the first and the last only."""
    arm, duct = made_once.robot(), made_once.duct()
    poses = {1: (0.2, -0.2), 2: (0.2, -0.1), 3: (0.2, 0.0)}  # by their number in the sweep
    return arm, duct, [make_scenario(arm, duct, made_once.START, rotation=at, number=k) for k, at in poses.items()]


class Followed(Executor):
    """An executor that notes the name of every lane function that it runs, and the scenarios' numbers."""

    calls: ClassVar[list] = []

    def __call__(self, lane_function, inputs, *tables):
        self.calls.append((lane_function.name, set(np.asarray(inputs.number).tolist())))
        return super().__call__(lane_function, inputs, *tables)


class FollowedHybrid(Method):
    """The method hybrid, followed."""

    name, title, description = "followed-hybrid", HYBRID.title, HYBRID.description

    def plan(self, problem: Problem) -> Plans:
        scene = Scene(problem.robot, problem.obstacles, problem.task)
        for checker in problem.checkers:
            checker.executor = Followed(scene, problem.settings, checker.executor.device)
        return HYBRID.plan(problem)


@pytest.mark.slow
def test_a_plan_made_backwards_says_so_and_holds_up_nobody(crossed):
    """Check status and counts of a backward chain in real plans, and step QPs of other scenarios between its pushes."""
    *scene, scenarios = crossed
    plans, calls = plan(Problem.of(*scene, scenarios, execution=Execution(threads=1)), FollowedHybrid()), Followed.calls
    back = plans.recovery == HYBRID.backwards
    assert back[0].sum() > 50 and not back[1].any() and HYBRID.backwards == 3
    last = np.flatnonzero(back[0])[-1]
    assert (plans.iterations[0, :last] == 0).all() and plans.iterations[0, last] > 0
    assert (plans.status[back] == Status.TRACKED_AFTER_RECOVERY).all() and (plans.path_clear[back] == 1).all()
    assert (plans.start == made_once.START).all() and transfers(plans).tolist() == [True, False, True]
    x = np.concatenate([[scenarios[0].x_start], plans.x[0]])
    np.testing.assert_allclose(plans.joint_step[0], np.linalg.norm(np.diff(x, axis=0), axis=1))
    pushes = {one: [k for k, (name, at) in enumerate(calls) if name == "push" and one in at] for one in (1, 3)}
    assert any(one not in numbers for one, own in pushes.items() for _, numbers in calls[own[0] : own[-1]])
