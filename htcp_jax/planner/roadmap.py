"""The roadmap: per scenario and target a front of postures, each connected to the start by a proven motion.

    feed     every posture of the front to the next target; it arrives where its joint path is a proven motion
    spread   where few arrive, by walks in the null space of the target, every step of them proven
    go on    with those that are far apart; where nothing arrives, spread the front itself and feed what is new
    approach where no straight line leads to the path: once more from postures at its first point, joined in free space
    transfer where all that is exhausted, and it is allowed: once more from other postures at the first target

A local optimiser carries one posture along and is lost in the first dead end; the front holds many, on both sides of
what forks the way. All that arrived is a tree whose root is the start, and the path that is chosen is that of the leaf
with the fewest changes of posture, and then the least cost of equation (3).

Random keys are folded from the scenario's number, the target, the round and the walk, so results do not depend on which
scenarios are planned together.
"""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import jax
import numpy as np

from htcp_jax.clearance.motion_proof import Tube
from htcp_jax.planner.front import Node, best_first, dispersed
from htcp_jax.planner.kernels import ADVANCE, SETTLE
from htcp_jax.planner.knots import Knots
from htcp_jax.planner.lane_inputs import LaneInputs, lane_inputs
from htcp_jax.planner.motion_check import tubes
from htcp_jax.planner.plans import Plans
from htcp_jax.planner.problem import Problem
from htcp_jax.planner.programs import Kernels
from htcp_jax.planner.proofs import proofs_of, prove_call
from htcp_jax.planner.roadmap_kernels import FEED, WALK
from htcp_jax.planner.tables import gather
from htcp_jax.planner.tip_check import TipCheck, out_of_walls, tip_checks
from htcp_jax.planner.transfers import joined, other_postures
from htcp_jax.settings import Settings
from htcp_jax.status import Status, Way

MOST_TRANSFERS = 3  # searches from other postures, each from others
TRANSFERRED = 1  # the escape of a first target that is reached by a transfer
IN_FLIGHT = 4  # scenarios are planned together, a quarter as many as a table has lanes


@dataclass(frozen=True)
class Roadmap:
    """The planner. A `registry.Method`."""

    name: str
    title: str
    description: str
    smooth = True  # unless the settings say otherwise

    def first_calls(self, problem: Problem) -> list[tuple]:
        """See `Kernels.preparing`."""
        return _calls(problem)

    def plan(self, problem: Problem) -> Plans:
        """Plan all scenarios; threads take them in turn, and write into different rows."""
        plans = problem.empty_plans()
        kernels = problem.kernels  # made here, before there are threads
        tips = tip_checks(kernels, problem.tip_guard)

        def work(number: int) -> list[tuple[int, int, np.ndarray]]:
            own = number % len(kernels)
            growing = Growing(problem, plans, kernels[own], tips[own])
            return growing.run(iter(problem.to_plan.tolist()[number :: problem.threads]))

        with ThreadPoolExecutor(problem.threads) as pool:
            ways = [way for part in pool.map(work, range(problem.threads)) for way in part]
        return plans._replace(knots=Knots.of(ways, plans.x.shape[2]))


def _calls(problem: Problem) -> list[tuple]:
    """One of each kernel that will be called, in the order in which they are waited for, see `Kernels.preparing`."""
    one, zero = problem.to_plan[:1], np.zeros(1, int)
    x, turns = problem.scenarios.x_start[one], np.zeros(1, bool)
    inputs = lane_inputs(problem.scenarios, one, zero)
    tube = tubes(problem.scenarios, problem.task, problem.settings.tube_m, one, zero, turns)
    walks = [(WALK, inputs, x, zero.astype(np.int32))] if problem.kernels[0].freedom else []
    smooths = [] if problem.settings.smooth is False else [(SETTLE, inputs, x)]
    return [(ADVANCE, inputs, x, x), (FEED, inputs, x), prove_call(inputs, x, x, tube), *walks, *smooths]


@dataclass(eq=False)
class Search:
    """How far one scenario has come: its front, which of that is still to be fed, and what has arrived."""

    scenario: int
    targets: int
    on_path: int
    settings: Settings
    can_walk: bool
    front: list[Node]
    unfed: list[Node]
    arrived: list[Node] = field(default_factory=list)
    rounds: int = 0  # of walks from the front since something arrived
    draws: int = 0  # rounds of walks in all
    status: Status | None = None  # why the search ended, where it did not come to the last target
    earlier: "Search | None" = None  # the one before, where this one is from other postures at the first target

    @property
    def target(self) -> int:
        """That of the front."""
        return self.front[0].target

    @property
    def chain(self) -> "list[Search]":
        """Itself and those before it."""
        return [self, *(self.earlier.chain if self.earlier is not None else [])]

    @property
    def approached(self) -> bool:
        """Whether it begins at the path's first point, and not at the first target."""
        return self.earlier is not None and self.front[0].root.target > 0

    @property
    def row_0(self) -> Node:
        """The posture at the first target, from the start, of the best that the first search has come to."""
        best = best_first(self.chain[-1].front)[0]
        return next(node for node in best.ancestors() if node.target == 0 and node.walked is None)

    @property
    def done(self) -> bool:
        """Whether it has ended, one way or the other."""
        return self.status is not None or self.target == self.targets - 1

    @property
    def walkers(self) -> list[Node]:
        """The postures to walk from now, one a walk."""
        if self.unfed or self.done:
            return []
        among, count = self.arrived or self.front, self.settings.walks
        return [among[(k + count * self.rounds) % len(among)] for k in range(count)]

    def take_fed(self, arrived: list[Node], failure: Status) -> None:
        """What came of feeding; failure: what to say if nothing ever arrives."""
        self.arrived, self.unfed = self.arrived + arrived, []
        last = self.target == self.targets - 2
        thin = len(self.arrived) < self.settings.thin_front and not last and self.can_walk
        if self.arrived and not thin:
            self._go_on()
        elif not self.arrived and (self.target < 0 or not self.can_walk or self.rounds >= self.settings.walk_rounds):
            self.status = failure

    def take_walked(self, found: list[Node], failure: Status) -> None:
        """What came of a round of walks."""
        self.draws += 1
        if self.arrived:
            self.arrived = self.arrived + found
            self._go_on()
            return
        self.rounds += 1
        self.unfed = dispersed(found, len(found), self.settings.front_apart_rad, known=self.front)
        self.front = self.front + self.unfed
        if not self.unfed and self.rounds >= self.settings.walk_rounds:
            self.status = failure

    def _go_on(self) -> None:
        self.front = dispersed(self.arrived, self.settings.front, self.settings.front_apart_rad)
        self.unfed, self.arrived, self.rounds = self.front, [], 0


class Growing:
    """Plans scenarios, many at a time, in dense batches of all their postures."""

    def __init__(self, problem: Problem, plans: Plans, kernels: Kernels, tip: TipCheck | None):
        self._problem, self._plans, self._kernels, self._tip = problem, plans, kernels, tip
        self._failure: dict[int, Status] = {}  # of scenarios: what the last feeding failed of

    def run(self, scenarios: Iterator[int]) -> list[tuple[int, int, np.ndarray]]:
        """Plan until the iterator is empty. Returns the knots of ways: (scenario, target, postures)."""
        ways, going, most = [], [], max(1, self._kernels.lanes // IN_FLIGHT)
        while True:
            while len(going) < most and (scenario := next(scenarios, None)) is not None:
                going.append(self._begin(scenario))
            if not going:
                return ways
            before = sum(search.target for search in going if search.earlier is None)
            self._feed([(search, node) for search in going for node in search.unfed])
            self._walk([(search, node) for search in going for node in search.walkers])
            tracked = sum(search.target for search in going if search.earlier is None) - before
            ended = [(search, self._elsewhere(search)) for search in going if search.done]
            going = [search for search in going if not search.done] + [other for _, other in ended if other is not None]
            finished = [self._chosen(search) for search, other in ended if other is None]
            for found in finished:
                ways += self._record(*found)
                tracked += found[0].target - found[0].chain[-1].target
            self._problem.progress(tracked, len(finished))

    def _begin(self, s: int) -> Search:
        scenarios = self._problem.scenarios
        start = Node(scenarios.x_start[s], np.nan, np.nan, np.full(3, np.nan), -1)
        count, on_path = int(scenarios.count[s]), int(scenarios.on_path[s])
        can_walk, roots = self._kernels.freedom > 0, [start]
        if scenarios.begins_anywhere[s]:
            roots = other_postures(self._problem, self._kernels, self._tip, s, 0) or roots
        return Search(s, count, on_path, self._problem.settings, can_walk, roots, roots)

    def _elsewhere(self, search: Search) -> Search | None:
        """Where the start's own part is exhausted: a search from other postures, at the path's first point where
        nothing comes to the path, else at the first target, if it may be."""
        s, settings, searches = search.scenario, self._problem.settings, len(search.chain)
        first, anywhere = search.chain[-1], bool(self._problem.scenarios.begins_anywhere[s])
        off_path = 0 <= first.target < search.on_path and not anywhere
        may = off_path or settings.transfers or (self._problem.scenarios.auto_start[s] and not anywhere)
        if search.status is None or not may or searches > MOST_TRANSFERS:
            return None
        target = search.on_path if off_path else 0
        others = other_postures(self._problem, self._kernels, self._tip, s, searches - 1 + anywhere, target)
        if not others:
            return None
        more = Search(s, search.targets, search.on_path, settings, search.can_walk, others, others)
        more.earlier, more.draws = search, search.draws
        return more

    def _chosen(self, search: Search) -> tuple[Search, Node, np.ndarray | None]:
        """What to write down of a scenario: the search that came furthest, the leaf of its best path, and the knots of
        the transfer to it."""
        for each in sorted(search.chain[::-1], key=lambda one: -one.target):
            leaves = best_first(each.front)
            if each.earlier is None or self._problem.scenarios.begins_anywhere[each.scenario]:
                return each, leaves[0], None
            start = each.row_0.x if each.approached else self._problem.scenarios.x_start[each.scenario]
            if (found := joined(self._problem, self._kernels, self._tip, each.scenario, start, leaves)) is not None:
                return each, *found
        raise AssertionError("the first search begins at the start, and needs no transfer")

    def _feed(self, lanes: list[tuple[Search, Node]]) -> None:
        if not lanes:
            return
        scenario = np.array([search.scenario for search, _ in lanes])
        target = np.array([node.target + 1 for _, node in lanes])
        x = np.stack([node.x for _, node in lanes])
        inputs, tube = self._inputs(scenario, target, np.zeros_like(target), False)
        fed = self._kernels(FEED, inputs, x)
        good = out_of_walls(self._tip, inputs, fed.at.x, fed.reached)
        proven = good.copy()
        proven[good] = self._proven(*gather((inputs, x, fed.at.x, tube), good), along=True)
        arrived: dict[Search, list[Node]] = {search: [] for search, _ in lanes}
        for k in np.flatnonzero(proven).tolist():
            search, node = lanes[k]
            here = (leaf[k] for leaf in fed.at)
            arrived[search].append(Node(*here, int(target[k]), node, None, int(fed.step_qps[k])))
        for search, nodes in arrived.items():
            own = scenario == search.scenario
            self._failure[search.scenario] = self._why(search, bool(nodes), bool(good[own].any()))
            search.take_fed(nodes, self._failure[search.scenario])

    def _walk(self, lanes: list[tuple[Search, Node]]) -> None:
        if not lanes:
            return
        scenario = np.array([search.scenario for search, _ in lanes])
        target = np.array([node.target for _, node in lanes])
        x, draws = np.stack([node.x for _, node in lanes]), np.array([search.draws for search, _ in lanes])
        inputs, tube = self._inputs(scenario, target, draws, True)
        first = np.flatnonzero(np.diff(scenario, prepend=-1))  # of every search; theirs stand together, in any order
        walker = np.arange(len(lanes)) - np.repeat(first, np.diff(np.append(first, len(lanes))))
        walked = self._kernels(WALK, inputs, x, walker.astype(np.int32))
        lane, step = np.nonzero(np.arange(walked.path.x.shape[1]) < walked.steps[:, None])
        before = np.concatenate([x[:, None], walked.path.x], axis=1)
        segments = gather((inputs, tube), lane)
        a, b = before[lane, step], before[lane, step + 1]
        proven = np.zeros(walked.path.clearance.shape, bool)
        proven[lane, step] = self._proven(segments[0], a, b, segments[1])
        steps = np.logical_and.accumulate(proven, axis=1).sum(axis=1)
        last = jax.tree.map(lambda leaf: leaf[np.arange(len(x)), np.maximum(steps - 1, 0)], walked.path)
        good = out_of_walls(self._tip, inputs, last.x, steps > 0)
        found: dict[Search, list[Node]] = {search: [] for search, _ in lanes}
        for k in np.flatnonzero(good).tolist():
            search, node = lanes[k]
            path, dwells = walked.path.x[k, : steps[k]].copy(), int(target[k] >= search.on_path)
            here = (leaf[k] for leaf in last)
            found[search].append(Node(*here, int(target[k]), node, path, dwells=dwells))
        for search, nodes in found.items():
            search.take_walked(nodes, self._failure[search.scenario])

    def _proven(self, inputs: LaneInputs, a: np.ndarray, b: np.ndarray, tube: Tube, along: bool = False) -> np.ndarray:
        """Which straight joint paths from a to b are motions. along: whether to look at the bare tip, too."""
        if not len(a):
            return np.zeros(0, bool)
        good = proofs_of(self._kernels, inputs, a, b, tube).verdict == Way.PROVEN
        if along and self._tip is not None and good.any():
            good[good] = ~self._tip.along(*gather((inputs, a, b), good))
        return good

    def _why(self, search: Search, arrived: bool, reached: bool) -> Status:
        """What to say of a scenario if nothing more arrives at the next target. Where something did, its start is
        clear: the way from there is proven."""
        if search.target < 0 and not arrived:
            [node] = search.front
            inputs = lane_inputs(self._problem.scenarios, np.array([search.scenario]), np.zeros(1, int))
            if self._kernels(ADVANCE, inputs, node.x[None], np.zeros((1, len(node.x)))).clearance[0] <= 0:
                return Status.START_IN_COLLISION
        return Status.PATH_BLOCKED if reached else Status.ESCAPE_EXHAUSTED

    def _inputs(self, scenario: np.ndarray, target: np.ndarray, draws: np.ndarray, turns: bool):
        """What lanes are about, and their tubes: on the way to their target, or while they turn at it."""
        problem = self._problem
        inputs = lane_inputs(problem.scenarios, scenario, target, seed=problem.settings.seed, round_=draws)
        towards, which = target + turns, np.full(len(target), turns)
        return inputs, tubes(problem.scenarios, problem.task, problem.settings.tube_m, scenario, towards, which)

    def _record(self, search: Search, leaf: Node, transfer: np.ndarray | None) -> list[tuple[int, int, np.ndarray]]:
        """Write down the path to a leaf, and how the search ended; returns the knots of its ways."""
        s, plans, ways = search.scenario, self._plans, []
        knots: list[np.ndarray] = []
        later: Node | None = None
        for node in leaf.ancestors():
            if node.walked is not None:
                knots.insert(0, node.walked)
                continue
            if later is not None:
                plans.joint_step[s, later.target] = np.linalg.norm(later.x - node.x)
                if knots:
                    ways.append((s, later.target, np.concatenate(knots)))
            knots = []
            if node.target >= 0:
                self._write(s, node.target, node)
                later = node
        if self._problem.scenarios.begins_anywhere[s]:
            plans.start[s], plans.joint_step[s, 0] = plans.x[s, 0], 0.0
        if transfer is not None:
            ways.append((s, self._joined(search, leaf.root), transfer))
        if search.status is not None:
            plans.status[s, search.target + 1] = search.status
        return ways

    def _write(self, s: int, t: int, node: Node) -> None:
        """One row. A node that is written to several stays where it is."""
        plans = self._plans
        plans.x[s, t], plans.tcp[s, t] = node.x, node.tcp
        plans.clearance[s, t], plans.residual[s, t] = node.clearance, node.residual
        plans.status[s, t], plans.iterations[s, t] = Status.TRACKED, node.step_qps
        plans.path_clear[s, t] = 1

    def _joined(self, search: Search, root: Node) -> int:
        """Write down how the arm gets to the posture in which a search begins; returns the target to which that leads.
        An approach leaves its lines: all of its targets but the first are the path's first point."""
        s, plans, on_path = search.scenario, self._plans, search.on_path
        if not search.approached:
            plans.joint_step[s, 0] = np.linalg.norm(root.x - plans.start[s])
            plans.status[s, 0], plans.escape[s, 0] = Status.TRACKED_AFTER_ESCAPE, TRANSFERRED
            return 0
        for table in (self._problem.scenarios.targets, self._problem.scenarios.aims):
            table[s, 1:on_path] = table[s, on_path]
        for t in range(1, on_path):
            self._write(s, t, root)
        self._write(s, 0, search.row_0)
        plans.joint_step[s, 0] = np.linalg.norm(search.row_0.x - plans.start[s])
        plans.joint_step[s, 1] = np.linalg.norm(root.x - search.row_0.x)
        plans.joint_step[s, 2 : on_path + 1] = 0.0
        return 1
