"""Beam search over configurations: per scenario and target a beam, each configuration connected to the start by a
proven motion.

    extend   every configuration of the beam to the next target; accepted if its joint path is a proven motion
    spread   if few are accepted, by self-motions at the target, every step of them proven
    select   those that are far apart; if none is accepted, spread the beam itself and extend what is new
    approach if no straight line leads to the path: search again from configurations at its first point, joined in free
             space
    transfer if all that fails, and it is allowed: search again from other configurations at the first target

A local optimiser follows one configuration and stops at the first dead end; the beam holds many, on both sides of each
fork. All accepted configurations form a tree whose root is the start, and the chosen path leads to the leaf with the
fewest changes of configuration, and then the least cost of equation (3).

Random keys are folded from the scenario's number, the target, the round and the walk, so results do not depend on which
scenarios are planned together.
"""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice

import jax
import numpy as np

from htcp_jax.clearance.proof.motion_proof import Tube
from htcp_jax.device.programs import Kernels
from htcp_jax.device.tables import gather
from htcp_jax.motion.kernels import ADVANCE, SETTLE
from htcp_jax.motion.knots import Knots
from htcp_jax.motion.lane_inputs import LaneInputs, lane_inputs
from htcp_jax.motion.motion_check import tubes
from htcp_jax.motion.plans import Plans
from htcp_jax.motion.posture_tree import BeamTree, Posture
from htcp_jax.motion.problem import Problem
from htcp_jax.motion.proofs import proofs_of, prove_call
from htcp_jax.motion.tip_check import TipCheck, out_of_walls, tip_checks
from htcp_jax.motion.transfers import other_postures
from htcp_jax.planning.beam.functions import FEED, WALK
from htcp_jax.planning.beam.record import Knotted, RoadmapRecord
from htcp_jax.planning.beam.searches import NONE, Members, Searches
from htcp_jax.status import Status, Way

MOST_TRANSFERS = 3  # searches from other configurations, each from new ones
IN_FLIGHT = 4  # scenarios planned together: the number of lanes divided by this


@dataclass(frozen=True)
class Roadmap:
    """Beam search as a `registry.Method`."""

    name: str
    title: str
    description: str
    smooth = True  # unless the settings say otherwise

    def first_calls(self, problem: Problem) -> list[tuple]:
        """Return the first kernel calls, see `Kernels.preparing`."""
        return _calls(problem)

    def plan(self, problem: Problem) -> Plans:
        """Plan all scenarios; they are dealt out to threads, which write into different rows."""
        plans = problem.empty_plans()
        kernels = problem.kernels  # made here, before there are threads
        tips = tip_checks(kernels, problem.tip_guard)
        # Two per GPU: while it computes for one, the other builds its tables.
        threads = problem.threads if kernels[0].pays_by_lane else max(problem.threads, 2 * len(kernels))

        def work(number: int) -> list[Knotted]:
            own = number % len(kernels)
            growing = Growing(problem, plans, kernels[own], tips[own])
            return growing.run(iter(problem.to_plan.tolist()[number::threads]))

        with ThreadPoolExecutor(threads) as pool:
            ways = [way for part in pool.map(work, range(threads)) for way in part]
        return plans._replace(knots=Knots.of(ways, plans.x.shape[2]))


def _calls(problem: Problem) -> list[tuple]:
    """Return one call of each kernel, in the order in which they are needed, see `Kernels.preparing`."""
    one, zero = problem.to_plan[:1], np.zeros(1, int)
    x, turns = problem.scenarios.x_start[one], np.zeros(1, bool)
    inputs = lane_inputs(problem.scenarios, one, zero)
    tube = tubes(problem.scenarios, problem.task, problem.settings.tube_m, one, zero, turns)
    walks = [(WALK, inputs, x, zero.astype(np.int32))] if problem.kernels[0].freedom else []
    smooths = [] if problem.settings.smooth is False else [(SETTLE, inputs, x)]
    return [(ADVANCE, inputs, x, x), (FEED, inputs, x), prove_call(inputs, x, x, tube), *walks, *smooths]


class Growing:
    """Plan many scenarios at a time, in dense batches of all their configurations."""

    def __init__(self, problem: Problem, plans: Plans, kernels: Kernels, tip: TipCheck | None):
        self._problem, self._kernels, self._tip = problem, kernels, tip
        self._tree = BeamTree(plans.x.shape[2])
        self._searches = Searches(problem.settings, self._tree, kernels.freedom > 0)
        self._record = RoadmapRecord(problem, plans, kernels, tip, self._searches)

    def run(self, scenarios: Iterator[int]) -> list[Knotted]:
        """Plan until the iterator is exhausted."""
        ways, searches, most = [], self._searches, max(1, self._kernels.lanes // IN_FLIGHT)
        while True:
            before = searches.tracked
            self._begin(list(islice(scenarios, most - int(searches.going.sum()))))
            if not searches.going.any():
                return ways
            self._feed()
            self._walk()
            tracked, target = searches.tracked - before, searches.columns.target
            finished = [search for search in searches.take_ended() if not self._begin_elsewhere(search)]
            for last in finished:
                search, *path = self._record.chosen(last)
                ways += self._record.write(search, *path)
                tracked += int(target[search] - target[searches.chain(last)[-1]])
                searches.forget(searches.chain(last))
            searches.prune()
            self._problem.progress(tracked, len(finished))

    def _begin(self, new: list[int]) -> None:
        """Begin searches at the starts of some scenarios; without a given start, at configurations sampled at the first
        target."""
        if not new:
            return
        start, unknown = self._problem.scenarios.x_start[new], np.full((len(new), 3), np.nan)
        roots = list(self._tree.plant(Posture(start, *unknown[:, :2].T, unknown), -1)[:, None])
        for k in np.flatnonzero(self._problem.begins_anywhere[new]).tolist():
            others = self._other_postures(new[k], 0, 0)
            roots[k] = others if len(others) else roots[k]
        self._searches.begin(new, self._problem.scenarios.count[new].tolist(), roots)

    def _begin_elsewhere(self, search: int) -> bool:
        """Begin a search from other configurations after one has failed: at the path's first point if it was not
        reached, else at the first target, if allowed. Returns True if there is one."""
        columns, chain = self._searches.columns, self._searches.chain(search)
        s, scenarios, first = int(columns.scenario[search]), self._problem.scenarios, int(columns.target[chain[-1]])
        on_path, anywhere = int(scenarios.on_path[s]), bool(self._problem.begins_anywhere[s])
        off_path = 0 <= first < on_path and not anywhere
        may = off_path or self._problem.settings.transfers or (scenarios.auto_start[s] and not anywhere)
        if columns.status[search] == NONE or not may or len(chain) > MOST_TRANSFERS:
            return False
        roots = self._other_postures(s, len(chain) - 1 + anywhere, on_path if off_path else 0)
        if len(roots):
            self._searches.begin([s], [int(scenarios.count[s])], [roots], search)
        return len(roots) > 0

    def _other_postures(self, s: int, round_: int, target: int) -> np.ndarray:
        return self._tree.plant(other_postures(self._problem, self._kernels, self._tip, s, round_, target), target)

    def _feed(self) -> None:
        """Extend pending configurations to the next target; accepted if the joint path is a proven motion."""
        searches, unfed = self._searches, self._searches.unfed
        if not len(unfed.node):
            return
        scenario, target = searches.columns.scenario[unfed.search], self._tree.target[unfed.node] + 1
        x = self._tree.x[unfed.node]
        inputs, tube = self._inputs(scenario, target, np.zeros_like(target), False)
        fed = self._kernels(FEED, inputs, x)
        good = out_of_walls(self._tip, inputs, fed.at.x, fed.reached)
        proven = good.copy()
        proven[good] = self._proven(*gather((inputs, x, fed.at.x, tube), good))
        new = self._tree.grow(*gather((unfed.node, fed.at, target, fed.step_qps), proven))
        arrived = Members(unfed.search[proven], new)
        self._say_why(searches.has(unfed), searches.has(arrived), searches.has(gather(unfed, good)))
        searches.take_fed(arrived)

    def _walk(self) -> None:
        """Move in the null space, in searches without configurations to extend; as far as every step is proven."""
        searches, (walkers, walker) = self._searches, self._searches.walkers()
        if not len(walkers.node):
            return
        scenario, draws = gather((searches.columns.scenario, searches.columns.draws), walkers.search)
        target, x = self._tree.target[walkers.node], self._tree.x[walkers.node]
        inputs, tube = self._inputs(scenario, target, draws, True)
        walked = self._kernels(WALK, inputs, x, walker.astype(np.int32))
        lane, step = np.nonzero(np.arange(walked.path.x.shape[1]) < walked.steps[:, None])
        before = np.concatenate([x[:, None], walked.path.x], axis=1)
        proven = np.zeros(walked.path.clearance.shape, bool)
        proven[lane, step] = self._proven(inputs, before[lane, step], before[lane, step + 1], tube, lane)
        steps = np.logical_and.accumulate(proven, axis=1).sum(axis=1)
        last = walked.path.x[np.arange(len(x)), np.maximum(steps - 1, 0)]
        good = out_of_walls(self._tip, inputs, last, steps > 0)
        node, dwells = walkers.node.copy(), (target >= self._problem.scenarios.on_path[scenario]).astype(int)
        for k in range(walked.path.x.shape[1]):
            on = np.flatnonzero(good & (steps > k))
            at = jax.tree.map(lambda leaf, on=on, k=k: leaf[on, k], walked.path)
            node[on] = self._tree.grow(node[on], at, target[on], walked=True, dwells=dwells[on] * (k == 0))
        searches.take_walked(walkers, Members(walkers.search[good], node[good]))

    def _proven(
        self, inputs: LaneInputs, a: np.ndarray, b: np.ndarray, tube: Tube, lane: np.ndarray | None = None
    ) -> np.ndarray:
        """True for each straight joint path from a to b that is a motion, one per lane, with the bare tip out of the
        walls all along; or, with `lane`, for each step of its walk, whose tip is checked only at the end."""
        if not len(a):
            return np.zeros(0, bool)
        good = proofs_of(self._kernels, inputs, a, b, tube, lane=lane).verdict == Way.PROVEN
        if lane is None and self._tip is not None and good.any():
            good[good] = ~self._tip.along(*gather((inputs, a, b), good))
        return good

    def _say_why(self, fed: np.ndarray, arrived: np.ndarray, reached: np.ndarray) -> None:
        """Set the status of the extended searches in case no more configurations reach the next target. If some did,
        the start is clear, as the motion from there is proven."""
        columns, scenarios = self._searches.columns, self._problem.scenarios
        columns.failure[fed] = np.where(reached, Status.PATH_BLOCKED, Status.ESCAPE_EXHAUSTED)[fed]
        lost = np.flatnonzero(fed & ~arrived & (columns.target < 0))
        if len(lost):
            s = columns.scenario[lost]
            inputs, x = lane_inputs(scenarios, s, np.zeros_like(s)), scenarios.x_start[s]
            collides = self._kernels(ADVANCE, inputs, x, np.zeros_like(x)).clearance <= 0
            columns.failure[lost[collides]] = Status.START_IN_COLLISION

    def _inputs(self, scenario: np.ndarray, target: np.ndarray, draws: np.ndarray, turns: bool):
        """Return the lanes' inputs and tubes: on the segment to their target, or during a self-motion at it."""
        problem = self._problem
        inputs = lane_inputs(problem.scenarios, scenario, target, seed=problem.settings.seed, round_=draws)
        towards, which = target + turns, np.full(len(target), turns)
        return inputs, tubes(problem.scenarios, problem.task, problem.settings.tube_m, scenario, towards, which)
