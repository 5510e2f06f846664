"""Beam search over configurations: one beam per scenario and target, connected to the start by proven motions.

    extend    extend every configuration of the beam to the next target; accept it if its joint path is a proven motion
    spread    if few are accepted, move them in the null space at the target, with a proof of every step; if none is
              accepted, spread the beam at its own target and extend the new configurations
    select    keep the best configurations that are far apart
    approach  if the path's first point is not reached on straight lines: search again from configurations at this
              point, joined to the start in free space
    transfer  if this fails and transfers are allowed: search again from other configurations at the first target
    retry     after a dead end: search backwards from configurations at the lost target, see `dead_ends`

A local optimiser follows one configuration and stops at the first dead end. A beam has several configurations, on both
sides of each fork. All accepted configurations form a tree whose root is the start. The chosen path leads to the leaf
with the fewest changes of configuration and, among these, the least cost (3).

Random keys are folded from the scenario's number, the target, the round and the self-motion, so results do not depend
on which scenarios are planned together.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import jax
import numpy as np

from htcp_jax.device import tables
from htcp_jax.motion import (
    CollisionChecker,
    Plans,
    Problem,
    Tried,
    ViaPoints,
    lane_inputs,
    prove_call,
    step_functions,
    transfers,
)
from htcp_jax.planning.beam.dead_ends import DeadEnds
from htcp_jax.planning.beam.functions import EXTEND, SELF_MOTION, Extension, inputs_and_tubes
from htcp_jax.planning.beam.record import BeamRecord, ViaPointRow
from htcp_jax.planning.beam.searches import NONE, Members, Searches
from htcp_jax.planning.beam.tree import BeamTree, JointSteps
from htcp_jax.planning.method import Method, WarmUp
from htcp_jax.planning.tracking.stages import PUSH
from htcp_jax.status import SegmentStatus, Status

MOST_TRANSFERS = 3  # maximum number of searches from other configurations per scenario
GPU_THREADS = 4  # maximum on GPUs; more threads wait for each other, as Python runs one at a time
EACH_PAYS = 192  # scenarios per thread on GPUs; fewer take as long as many, and the GPU runs one call at a time
IN_FLIGHT = 4  # the number of scenarios planned together is the number of lanes / IN_FLIGHT


@dataclass(frozen=True)
class BeamSearchMethod(Method):
    """Beam search."""

    name: str
    title: str
    description: str
    smooth = True  # motions are smoothed unless the settings disable it
    plans_indexed = True

    def warm_up(self, problem: Problem) -> WarmUp:
        """Return one call of each lane function; those that continue after dead ends are for hard targets."""
        one, zero = problem.to_plan[:1], np.zeros(1, int)
        inputs, x = problem.inputs(one, 0), problem.scenarios.x_start[one]
        moving = problem.with_still_joints(inputs, one, zero)
        proof = prove_call(problem.task, inputs, x, x, problem.tubes(one, zero))
        first = [(step_functions.ADVANCE, inputs, x, x), (EXTEND, moving, x), proof]
        smooths = [] if problem.settings.smooth is False else [(step_functions.SETTLE, moving, x)]
        if not problem.checkers[0].executor.freedom:
            return WarmUp([*first, *smooths])
        self_motion = SELF_MOTION, moving, x, x, zero.astype(np.int32)
        return WarmUp([*first, self_motion, *smooths], [(PUSH, inputs, x)])

    def plan(self, problem: Problem) -> Plans:
        """Plan all scenarios, shared among threads that write into different rows of the plans."""
        plans, threads = problem.empty_plans(), problem.threads
        if not problem.checkers[0].executor.pays_by_lane:
            # while a GPU computes for one thread, the others build their tables
            threads = max(threads, min(GPU_THREADS, len(problem.to_plan) // EACH_PAYS))

        def work(checker: CollisionChecker, share: slice) -> tuple[list[ViaPointRow], dict[tuple[int, int], Tried]]:
            return BeamSearch(problem, plans, checker).run(iter(problem.to_plan[share].tolist()))

        parts = problem.in_threads(work, threads)
        via_points = ViaPoints.of([row for rows, _ in parts for row in rows], plans.x.shape[2])
        tried = {key: value for _, part in parts for key, value in part.items()}
        return plans._replace(via_points=via_points, dead_ends=plans.dead_ends.of(tried))


class BeamSearch:
    """Beam searches of many scenarios at a time, with the configurations of all searches in one batch."""

    def __init__(self, problem: Problem, plans: Plans, checker: CollisionChecker):
        self._problem, self._checker = problem, checker
        self._tree = BeamTree(plans.x.shape[2])
        self._searches = Searches(problem.settings, self._tree, checker.executor.freedom > 0)
        self._record = BeamRecord(problem, plans, checker, self._searches)
        self._joint_steps = JointSteps.of(problem.scenarios)
        self._dead_ends = DeadEnds(problem, checker, self._searches, self._joint_steps)

    def run(self, scenarios: Iterator[int]) -> tuple[list[ViaPointRow], dict[tuple[int, int], Tried]]:
        """Plan scenarios until the iterator is exhausted.

        Returns:
            Via points of all segments that have some, and the attempts after dead ends: (scenario, target) -> attempts.
        """
        via_points, searches, most = [], self._searches, max(1, self._checker.executor.lanes // IN_FLIGHT)
        while True:
            before = searches.tracked
            self._begin(list(islice(scenarios, most - int(searches.going.sum()) - len(self._dead_ends))))
            if not searches.going.any() and not len(self._dead_ends):
                return via_points, self._dead_ends.tried
            self._extend()
            self._spread()
            self._dead_ends.meet()
            tracked, target = searches.tracked - before, searches.columns.target
            finished = self._begin_again(searches.pop_ended())
            for last, (search, *path) in zip(finished, self._record.chosen(finished), strict=True):
                self._dead_ends.set_blocked(search)
                via_points += self._record.write(search, *path)
                tracked += int(target[search] - target[searches.chain(last)[-1]])
                searches.forget(searches.chain(last))
            searches.prune()
            self._problem.progress(tracked, len(finished))

    def _begin(self, new: list[int]) -> None:
        """Begin a search for each new scenario: at its start or, if none is given, at the first target.

        At the first target, configurations are sampled.
        """
        if not new:
            return
        start, unknown = self._problem.scenarios.x_start[new], np.full((len(new), 3), np.nan)
        at = step_functions.State(start, clearance=unknown[:, 0], residual=unknown[:, 0], tcp=unknown)
        roots = list(self._tree.plant(at, -1)[:, None])
        anywhere = np.flatnonzero(self._problem.begins_anywhere[new])
        others = self._other_configurations(np.array(new)[anywhere], 0, 0)
        for k, rows in zip(anywhere.tolist(), others, strict=True):
            roots[k] = rows if len(rows) else roots[k]
        self._searches.begin(new, (self._problem.scenarios.count[new] - 1).tolist(), roots)

    def _begin_again(self, ended: list[int]) -> list[int]:
        """Begin other searches after some have ended; return the last searches of the scenarios that are finished."""
        excluded = self._dead_ends.excluded(ended)
        begun = self._begin_elsewhere([one for one in ended if one not in excluded])
        return [*excluded, *self._dead_ends.retry([one for one in ended if one not in excluded and one not in begun])]

    def _begin_elsewhere(self, ended: list[int]) -> set[int]:
        """Begin searches from other configurations after some have failed; return those after which one is begun.

        The configurations are at the path's first point if it was not reached. Otherwise they are at the first target,
        if transfers are allowed.
        """
        searches, scenarios = self._searches, self._problem.scenarios
        where = {one: place for one in ended if (place := self._elsewhere(one)) is not None}
        if not where:
            return set()
        scenario = searches.columns.scenario[list(where)]
        roots = self._other_configurations(scenario, *np.array(list(where.values())).T)
        found = {one: rows for one, rows in zip(where, roots, strict=True) if len(rows)}
        scenario = searches.columns.scenario[list(found)]
        last = (scenarios.count[scenario] - 1).tolist()
        searches.begin(scenario.tolist(), last, list(found.values()), list(found))
        return set(found)

    def _elsewhere(self, ended: int) -> tuple[int, int] | None:
        """Return the round of draws and the target for another search from the path's begin; None if there is none."""
        columns, chain, scenarios = self._searches.columns, self._searches.chain(ended), self._problem.scenarios
        s, first = int(columns.scenario[ended]), int(columns.target[chain[-1]])
        on_path, anywhere = int(scenarios.on_path[s]), bool(self._problem.begins_anywhere[s])
        off_path = 0 <= first < on_path and not anywhere
        may = off_path or self._problem.settings.transfers or (scenarios.auto_start[s] and not anywhere)
        spent = len(chain) > MOST_TRANSFERS or self._dead_ends.has_begun(s)
        if columns.status[ended] == NONE or not may or spent:
            return None
        return len(chain) - 1 + anywhere, on_path if off_path else 0

    def _other_configurations(
        self, scenario: np.ndarray, round_: int | np.ndarray, target: int | np.ndarray
    ) -> list[np.ndarray]:
        """Return, for each scenario, the tree rows of other valid configurations at a target."""
        if not len(scenario):
            return []
        at, lane = transfers.other_configurations(self._problem, self._checker, scenario, round_, target)
        rows = self._tree.plant(at, np.broadcast_to(target, len(scenario))[lane])
        return np.split(rows, np.searchsorted(lane, np.arange(1, len(scenario))))

    def _extend(self) -> None:
        """Extend pending configurations to the next target; accept those whose joint path is a proven motion."""
        searches, pending = self._searches, self._searches.pending
        if not len(pending.node):
            return
        scenario, step = tables.gather((searches.columns.scenario, searches.columns.step), pending.search)
        x, before = self._tree.x[pending.node], self._tree.target[pending.node]
        target, zero = before + step, np.zeros_like(before)
        segment = np.maximum(before, target)
        inputs = lane_inputs.lane_inputs(self._problem.scenarios, scenario, target, seed=self._problem.settings.seed)
        if self._joint_steps is not None:
            left = self._joint_steps.left(self._tree, pending.node, scenario, segment)
            inputs = inputs._replace(max_joint_step=left)
        lanes = self._problem.with_still_joints(inputs, scenario, segment)
        extended = self._extended(lanes, x, self._tree.clearance[pending.node])
        good = self._checker.valid(inputs, extended.at)
        if inputs.max_joint_step is not None:
            good &= (np.abs(extended.at.x - x) <= inputs.max_joint_step).all(axis=1)
        proven = good.copy()
        if good.any():
            segments, tube = inputs_and_tubes(self._problem, scenario, segment, zero, False)
            a, b = _in_order_of_travel(step, x, extended.at.x)
            edges = self._checker.edges(*tables.gather((segments, a, b, tube), good))
            proven[good] = edges.verdict == SegmentStatus.VALID
        new = self._tree.grow(*tables.gather((pending.node, extended.at, target, extended.step_qps), proven))
        arrived = Members(pending.search[proven], new)
        self._set_failures(searches.has(pending), searches.has(arrived), searches.has(tables.gather(pending, good)))
        searches.store_extended(arrived)

    def _extended(self, inputs: lane_inputs.LaneInputs, x: np.ndarray, clearance: np.ndarray) -> Extension:
        """Return configurations extended to the lanes' targets.

        On a GPU those with the smallest clearance begin first: they need the most step QPs, up to twenty times the
        mean, and the call ends with the last of them.
        """
        executor = self._checker.executor
        if executor.pays_by_lane:
            return executor(EXTEND, inputs, x)
        order = np.argsort(clearance, kind="stable")
        return tables.gather(executor(EXTEND, *tables.gather((inputs, x), order)), np.argsort(order))

    def _spread(self) -> None:
        """Spread the searches that have no pending configurations, by self-motions in which every step is proven."""
        searches, (origins, motion_number) = self._searches, self._searches.origins()
        if not len(origins.node):
            return
        columns = searches.columns
        scenario, draws, way = tables.gather((columns.scenario, columns.draws, columns.step), origins.search)
        target, x = self._tree.target[origins.node], self._tree.x[origins.node]
        inputs, tube = inputs_and_tubes(self._problem, scenario, target, draws, True)
        lanes = self._problem.with_still_joints(inputs, scenario, target + 1)
        moved = self._checker.executor(SELF_MOTION, lanes, x, np.full_like(x, np.nan), motion_number.astype(np.int32))
        lane, step = np.nonzero(np.arange(moved.path.x.shape[1]) < moved.steps[:, None])
        proven = np.zeros(moved.path.clearance.shape, bool)
        if len(lane):  # the tip is checked only at the end of each self-motion
            ends = moved.path.x.reshape(-1, x.shape[1]).take(lane * proven.shape[1] + step, axis=0)
            starts = np.where((step == 0)[:, None], x[lane], np.roll(ends, 1, axis=0))
            edges = _in_order_of_travel(way[lane], starts, ends)
            proof = self._checker.edges(tables.gather(inputs, lane), *edges, tables.gather(tube, lane), tip=False)
            proven[lane, step] = proof.verdict == SegmentStatus.VALID
        if self._joint_steps is not None:
            left = self._joint_steps.left(self._tree, origins.node, scenario, target + 1)
            travel = np.abs(np.diff(moved.path.x, axis=1, prepend=x[:, None])).cumsum(axis=1)
            proven &= (travel <= left[:, None]).all(axis=2)
        steps = np.logical_and.accumulate(proven, axis=1).sum(axis=1)
        last = moved.path.x[np.arange(len(x)), np.maximum(steps - 1, 0)]
        good = self._checker.tip_free(inputs, last, steps > 0)
        node, dwells = origins.node.copy(), (target >= self._problem.scenarios.on_path[scenario]).astype(int)
        for k in range(moved.path.x.shape[1]):
            on = np.flatnonzero(good & (steps > k))
            at = jax.tree.map(lambda leaf, on=on, k=k: leaf[on, k], moved.path)
            node[on] = self._tree.grow(node[on], at, target[on], by_self_motion=True, dwells=dwells[on] * (k == 0))
        searches.store_self_motions(origins, Members(origins.search[good], node[good]))

    def _set_failures(self, extended: np.ndarray, arrived: np.ndarray, reached: np.ndarray) -> None:
        """Set the status that extended searches get if no more of their configurations arrive at the next target.

        It is START_IN_COLLISION only for searches at a colliding start. If a configuration arrived, the start is clear,
        as the motion from it is proven.
        """
        columns, scenarios = self._searches.columns, self._problem.scenarios
        columns.failure[extended] = np.where(reached, Status.PATH_BLOCKED, Status.RECOVERY_EXHAUSTED)[extended]
        lost = np.flatnonzero(extended & ~arrived & (columns.target < 0))
        if len(lost):
            s = columns.scenario[lost]
            inputs = lane_inputs.lane_inputs(scenarios, s, np.zeros_like(s))
            collides = self._checker.states(inputs, scenarios.x_start[s]).clearance <= 0
            columns.failure[lost[collides]] = Status.START_IN_COLLISION


def _in_order_of_travel(step: np.ndarray, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return both ends of joint paths in the order of travel: a, b for searches forwards, b, a for those backwards."""
    forwards = step[:, None] > 0
    return (a, b) if forwards.all() else (np.where(forwards, a, b), np.where(forwards, b, a))
