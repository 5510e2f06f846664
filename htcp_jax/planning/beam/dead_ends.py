"""Dead ends of a beam search: searches backwards from configurations at the lost target, joined with the beam's tree.

    sample    configurations at the first target that the beam did not reach, the clearest of many pushed clear
    backwards a beam from these towards the start, with the same proofs, in the direction of travel
    meet      at each target, by self-motions from the tree's configurations to those nearest to them
    arrive    if the motion may begin in another configuration: join the first target's configurations in free space
    graft     the reversed motions become branches of the tree, and the search goes on forwards from the lost target
    widen     if configurations there are not connected: forwards from some targets earlier, with a wider beam

Often the configurations that lead past the dead end were dropped at earlier targets, or never sampled. Configurations
that are extended backwards from the lost target do lead to it. `settings.effort` limits their number, relative to the
configurations used by the searches before.
"""

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from htcp_jax.clearance.proof import exclusion
from htcp_jax.device import tables
from htcp_jax.motion import (
    CollisionChecker,
    Problem,
    Tried,
    configurations,
    step_functions,
    tool_cells,
    transfers,
)
from htcp_jax.numerics import ragged_rows
from htcp_jax.planning.beam.functions import MOVE_TOWARDS, inputs_and_tubes
from htcp_jax.planning.beam.searches import NONE, Searches
from htcp_jax.planning.beam.tree import JointSteps
from htcp_jax.planning.tracking import stages
from htcp_jax.status import Exclusion, SegmentStatus, Status

FIRST_ROUND = 100_000  # rounds of draws; smaller ones belong to other searches
ROUNDS = 4  # number of rounds of draws at a time
FEW = 32  # draws that count as one configuration of the effort, if fewer than one in FEW arrives at the target
MOST_MISSED = 16_384  # draws after which sampling ends if none of them arrives at the target
PUSHED = 24  # number of draws to push clear: the clearest ones that are far apart
APART_RAD = 0.2
NEAR_RAD = 0.4  # standard deviation of draws around known configurations
SHARE = 0.15  # share of the effort for searches backwards, if the motion cannot begin elsewhere
BACK, WIDER = 8, 2  # targets before the lost one at which a wider search begins, and the multiple of the beam's width
PROOF_CELLS, TOOL_CELLS = 24, 128  # maximum numbers of cells of the proofs that exclude the lost target: arm, tool
MEET_RAD, PAIRS = 1.5, 4  # largest distance of configurations that are joined, and pairs tried at each target


class Meeting(NamedTuple):
    """A motion at one target from the tree to a configuration of a search backwards."""

    begin: Float[np.ndarray, "N"] | None  # the tree's configuration [rad or m]; None if the motion begins at `row`
    between: step_functions.State | None
    row: int  # tree row of the configuration of the search backwards


@dataclass
class Draws:
    """Configurations drawn after the dead ends of a scenario."""

    rounds: int = 0  # number of rounds of draws so far
    work: int = 0  # configurations used: draws on the target, and push steps
    missed: Counter[int] = field(default_factory=Counter)  # target -> draws since one arrived at the target
    clear: set[int] = field(default_factory=set)  # targets that no proof excludes


@dataclass
class BackwardSearch:
    """A search backwards from a lost target."""

    joined: int  # the search that it is to be joined to
    tree_x: dict[int, Float[np.ndarray, "n N"]]  # target -> configurations in the tree of `joined` [rad or m]
    meetings: list[Meeting] = field(default_factory=list)


@dataclass
class WiderSearch:
    """A wider search to a lost target."""

    lost: int  # the lost target
    work: int | None = None  # the work until the search reached it; None if it has not


class DeadEnds:
    """Searches that are begun after dead ends, for all scenarios of one tree."""

    def __init__(self, problem: Problem, checker: CollisionChecker, searches: Searches, joint_steps: JointSteps | None):
        self._problem, self._checker, self._searches, self._tree = problem, checker, searches, searches.tree
        self._joint_steps = joint_steps
        self._draws: defaultdict[int, Draws] = defaultdict(Draws)  # by scenario
        self._backwards: dict[int, BackwardSearch] = {}  # by search, until it ends
        self._wider: dict[int, WiderSearch] = {}  # by search
        self.tried: dict[tuple[int, int], Tried] = {}  # (scenario, lost target) -> attempts

    def has_begun(self, scenario: int) -> bool:
        """Return True if searches were begun after a dead end of the scenario."""
        return self._draws[scenario].rounds > 0

    def is_excluded(self, ended: int) -> bool:
        """Return True if a search has ended at a target that is proven to have no clear configuration.

        Then every other search would end there, too. If the lost target is before the path, which the motion may
        bypass, the proof is about the path's first point.
        """
        columns, chain, problem = self._searches.columns, self._searches.chain(ended), self._problem
        if columns.status[ended] == NONE or not problem.task.holds_tcp or self._left(chain) <= 0:
            return False
        s, best = int(columns.scenario[ended]), self._farthest(chain)
        lost = int(columns.target[best]) + 1
        target = int(problem.scenarios.on_path[s]) if self._leaves_lines(s, lost) else lost
        is_found = target == lost and columns.status[best] == Status.PATH_BLOCKED
        if is_found or lost == 0 or target in self._draws[s].clear:
            return False
        inputs, executor = problem.inputs(s, target), self._checker.executor
        (reason,) = tool_cells.exclusions(executor, problem.robot, inputs, PROOF_CELLS).tolist()
        tool = exclusion.Bodies.TOOL
        if reason == Exclusion.NONE and tool_cells.excluded(executor, None, inputs, TOOL_CELLS, tool).all():
            reason = Exclusion.TOOL
        if reason == Exclusion.NONE:
            self._draws[s].clear.add(target)
            return False
        self.tried[s, target] = Tried(excluded=Exclusion(reason))
        return True

    def set_blocked(self, ended: int) -> None:
        """Set the status of an ended search to PATH_BLOCKED if a clear configuration is known at the lost target."""
        columns = self._searches.columns
        lost = int(columns.scenario[ended]), int(columns.target[ended]) + 1
        if columns.status[ended] == Status.RECOVERY_EXHAUSTED and self.tried.get(lost, Tried()).found:
            columns.status[ended] = Status.PATH_BLOCKED

    def retry(self, ended: int) -> bool:
        """Begin another search after one has ended, and return True; return False if the scenario is finished."""
        columns, chain, problem = self._searches.columns, self._searches.chain(ended), self._problem
        s, scenarios = int(columns.scenario[ended]), problem.scenarios
        last = int(scenarios.count[s]) - 1
        if ended in self._backwards:
            lost = int(columns.target[self._backwards[ended].joined]) + 1
            self._count(s, lost, configurations=int(columns.work[ended]))
            if rows := self._grafted(ended):
                self._count(s, lost, connected=len(rows))
                self._searches.begin([s], [last], [np.array(rows)], ended)
                return True
        elif columns.status[ended] == NONE:
            return False
        if (wider := self._wider.get(ended)) is not None and wider.work is None:
            self._count(s, wider.lost, configurations=int(columns.work[ended]))
        best = self._farthest(chain)
        lost, on_path = int(columns.target[best]) + 1, int(scenarios.on_path[s])
        off_path = self._leaves_lines(s, lost)
        tree = self._ancestors(best)
        at = {int(t): self._tree.x[tree[self._tree.target[tree] == t]] for t in range(lost)}
        target, draws = on_path if off_path else lost, self._draws[s]
        while lost > 0 and self._left(chain) > 0 and draws.missed[target] < MOST_MISSED:
            before = draws.work
            anywhere = off_path or self._may_arrive(s, best)
            roots = self._sampled(s, target, None if anywhere else at[lost - 1])
            self._count(s, lost, configurations=draws.work - before, found=len(roots))
            problem.progress(0, 0)  # nothing new, but the search goes on
            if len(roots):
                self._count(s, lost, searches=1)
                if not off_path:
                    self._backwards[len(columns.target)] = BackwardSearch(best, at)
                first = last if off_path else self._first(best)
                self._searches.begin([s], [first], [roots], ended, backwards=not off_path)
                return True
        return not off_path and self._widen(s, lost, tree, chain)

    def _widen(self, s: int, lost: int, tree: Int[np.ndarray, "n"], chain: list[int]) -> bool:
        """Begin a wider search some targets before the lost one, if that may help; return True if it is begun.

        It may help if clear configurations were found at the lost target, and none of them is connected.
        """
        known = self.tried.get((s, lost), Tried())
        is_found = known.found or self._searches.columns.status[self._farthest(chain)] == Status.PATH_BLOCKED
        if known.connected or known.wider or not is_found or self._left(chain, share=1.0) <= 0:
            return False
        target = self._tree.target[tree]
        roots = tree[target == max(lost - BACK, int(target.min()))]
        self._count(s, lost, wider=1)
        self._wider[len(self._searches.columns.target)] = WiderSearch(lost)
        last = int(self._problem.scenarios.count[s]) - 1
        self._searches.begin([s], [last], [roots], chain[0], width=WIDER)
        return True

    def meet(self) -> None:
        """Join the beams of searches backwards with near configurations of the tree at the same target.

        Stop searches that have met the tree, and searches whose effort is spent.
        """
        columns, pairs = self._searches.columns, []
        stop = np.zeros(len(columns.target), bool)
        for search, backwards in self._backwards.items():
            if not self._searches.going[search]:
                continue
            tree_x = backwards.tree_x.pop(int(columns.target[search]), None)  # pairs are tried once
            pairs += [] if tree_x is None else self._nearest(search, tree_x)
            stop[search] = self._left(self._searches.chain(search)) <= 0
        for search, wider in self._wider.items():
            if wider.work is not None:
                continue
            if columns.target[search] >= wider.lost:
                columns.width[search], wider.work = 1, int(columns.work[search])
                s = int(columns.scenario[search])
                self._count(s, wider.lost, configurations=wider.work, connected=1)
            elif self._searches.going[search]:
                stop[search] = self._left(self._searches.chain(search), share=1.0) <= 0
        for search, meeting in self._joined(pairs):
            self._backwards[search].meetings.append(meeting)
            stop[search] = True
        self._searches.stop(stop)

    def _left(self, chain: list[int], share: float | None = None) -> float:
        """Return the number of configurations that searches after dead ends may still use.

        Args:
            chain: The searches of a scenario.
            share: Share of `settings.effort` that may be used; None: 1, or SHARE if the motion cannot begin elsewhere.
        """
        columns, s = self._searches.columns, int(self._searches.columns.scenario[chain[0]])
        forwards = columns.step[chain] > 0
        spent = self._draws[s].work + columns.work[chain][~forwards].sum()
        known = ((int(columns.work[k]), self._wider[k].work) for k in chain if k in self._wider)
        wider = sum(so_far if work is None else work for so_far, work in known)
        if share is None:
            share = 1.0 if self._may_arrive(s, self._farthest(chain)) else SHARE
        before = columns.work[chain][forwards].sum() - wider
        return float(share * self._problem.settings.effort * before - spent - wider)

    def _farthest(self, chain: list[int]) -> int:
        """Return the search that reached the farthest target; the first of several."""
        columns = self._searches.columns
        return max((each for each in chain[::-1] if columns.step[each] > 0), key=lambda each: columns.target[each])

    def _leaves_lines(self, s: int, lost: int) -> bool:
        """Return True if the lost target is not beyond the path's first point, which is then sampled in its place."""
        return bool(lost <= self._problem.scenarios.on_path[s] and not self._problem.begins_anywhere[s])

    def _first(self, search: int) -> int:
        """Return the target at which a search backwards ends: the first target of the search that it is joined to."""
        return max(0, int(self._tree.target[self._tree.path(self._searches.beam_of(search)[0])[0]]))

    def _ancestors(self, search: int) -> Int[np.ndarray, "n"]:
        return self._tree.with_ancestors(np.array(self._searches.beam_of(search)))

    def _may_arrive(self, s: int, best: int) -> bool:
        """Return True if the motion may begin in another configuration than the search to be joined."""
        elsewhere = self._problem.settings.transfers or bool(self._problem.scenarios.auto_start[s])
        return elsewhere or self._first(best) > 0

    def _sampled(self, s: int, target: int, near: Float[np.ndarray, "n N"] | None) -> Int[np.ndarray, "m"]:
        """Return tree rows of new valid configurations at a target: the clearest of random draws, pushed clear.

        They are far apart. Draws are uniform within the joint limits or, if `near` is given, around its configurations
        [rad or m].
        """
        problem, checker, draws = self._problem, self._checker, self._draws[s]
        first = FIRST_ROUND + draws.rounds
        rounds = first + np.arange(ROUNDS if near is None else 1)
        drawn = np.concatenate(transfers.drawn_configurations(problem, checker, np.full(len(rounds), s), rounds))
        if near is not None:
            rng = np.random.default_rng([problem.settings.seed, int(problem.scenarios.number[s]), first])
            drawn = near[rng.integers(len(near), size=len(drawn))] + NEAR_RAD * rng.standard_normal(drawn.shape)
            drawn = np.clip(drawn, *checker.executor.limits)
        draws.rounds += len(rounds)
        here = transfers.projected(problem, checker, np.full(len(drawn), s), target, drawn)
        reached = np.flatnonzero(problem.task.reached(here.residual))
        draws.missed[target] = 0 if len(reached) else draws.missed[target] + len(drawn)
        order = reached[np.argsort(-here.clearance[reached], kind="stable")]
        apart = order[configurations.first_apart(here.x[order], PUSHED, APART_RAD)]
        pushes = len(apart) * problem.settings.max_null_space_steps
        draws.work += max(len(reached), len(drawn) // FEW) + pushes
        inputs = problem.inputs(s, target, len(apart))
        pushed = checker.executor(stages.PUSH, inputs, here.x[apart]) if len(apart) else here
        at = checker.states(inputs, pushed.x)._replace(x=pushed.x, linear=None) if len(apart) else here
        good = np.flatnonzero(checker.valid(inputs, at)) if len(apart) else apart
        good = good[np.argsort(-at.clearance[good], kind="stable")]
        separation, zero = problem.settings.beam_separation_rad, np.zeros(len(good), int)
        good = good[configurations.dispersed(at.x[good], zero, problem.settings.beam_width, separation)]
        return self._tree.plant(tables.gather(at, good), target)

    def _nearest(self, search: int, tree_x: Float[np.ndarray, "n N"]) -> list[tuple[int, np.ndarray, int]]:
        """Return the pairs to join: search, configuration in the tree, tree row of the search's configuration."""
        beam = self._searches.beam.node[self._searches.beam.search == search]
        away = np.linalg.norm(tree_x[:, None] - self._tree.x[beam][None], axis=2)
        order = np.argsort(away, axis=None, kind="stable")[:PAIRS]
        a, b = np.unravel_index(order[away.ravel()[order] <= MEET_RAD], away.shape)
        return [(search, tree_x[i], int(beam[j])) for i, j in zip(a.tolist(), b.tolist(), strict=True)]

    def _joined(self, pairs: list[tuple[int, np.ndarray, int]]) -> list[tuple[int, Meeting]]:
        """Return the meetings of pairs that are joined by proven self-motions."""
        if not pairs:
            return []
        search, begin, row = (np.array(column) for column in zip(*pairs, strict=True))
        columns = self._searches.columns
        columns.work[:] += np.bincount(search, minlength=len(columns.work))
        target, end = self._tree.target[row], self._tree.x[row]
        inputs, tube = inputs_and_tubes(self._problem, columns.scenario[search], target, np.zeros_like(target), True)
        moved = self._checker.executor(MOVE_TOWARDS, inputs, begin, end)
        count = moved.steps + 1  # number of segments, including the one to the end
        lane, step = ragged_rows(count)
        x = np.concatenate([begin[:, None], moved.path.x, end[:, None]], axis=1)
        after = np.where(step == moved.steps[lane], x.shape[1] - 1, step + 1)
        proof = self._checker.edges(
            tables.gather(inputs, lane), x[lane, step], x[lane, after], tables.gather(tube, lane), tip=False
        )
        bad = (np.bincount(lane, proof.verdict != SegmentStatus.VALID, len(row)) > 0) | ~moved.arrives
        met = []
        for k in np.flatnonzero(~bad).tolist():
            between = jax.tree.map(lambda leaf, k=k: leaf[k, : moved.steps[k]], moved.path)
            met.append((int(search[k]), Meeting(begin[k], between, int(row[k]))))
        return met

    def _grafted(self, search: int) -> list[int]:
        """Add the reversed motions of a search backwards to the tree; return the tree rows at the lost target.

        There is one row for each configuration at the lost target that is connected.
        """
        columns, backwards = self._searches.columns, self._backwards.pop(search)
        best, meetings = backwards.joined, backwards.meetings
        s, tree, found = int(columns.scenario[search]), self._ancestors(best), {}
        if not meetings and columns.status[search] == NONE and self._may_arrive(s, best):
            meetings = [Meeting(None, None, row) for row in self._searches.beam_of(search)]
        for begin, between, row in meetings:
            path = self._tree.path(row)
            if (root := int(path[0])) in found:
                continue
            parent = None
            if begin is not None:
                here = tree[self._tree.target[tree] == self._tree.target[row]]
                parent = int(here[(self._tree.x[here] == begin).all(axis=1)][0])
            end = self._branch(parent, between, path[::-1], int(self._problem.scenarios.on_path[s]))
            if self._joint_steps is None or self._joint_steps.are_kept(s, self._tree.nodes(self._tree.path(end))):
                found[root] = end
        return list(found.values())

    def _branch(
        self, parent: int | None, between: step_functions.State | None, path: Int[np.ndarray, "k"], on_path: int
    ) -> int:
        """Add a branch to the tree, `between` and then copies of the nodes on `path`; return the tree row of its end.

        It starts at the node `parent`; None: at a new root.
        """
        nodes = self._tree.nodes(path)
        at, target, step_qps = nodes.at, nodes.target, nodes.step_qps
        if between is not None:
            at, zero = jax.tree.map(lambda a, b: np.concatenate([a, b]), between, at), np.zeros(len(between.x), int)
            target, step_qps = np.append(zero + target[0], target), np.append(zero, step_qps)
        first = 0 if parent is not None else 1
        row = np.array([parent]) if first == 0 else self._tree.plant(tables.gather(at, np.arange(1)), int(target[0]))
        turns = False
        for k in range(first, len(target)):
            turned, turns = turns, bool(target[k] == self._tree.target[row[0]])
            begins = turns and not turned and target[k] >= on_path
            here = tables.gather(at, np.array([k]))
            row = self._tree.grow(row, here, target[k], step_qps[k], by_self_motion=turns, dwells=int(begins))
        return int(row[0])

    def _count(self, s: int, lost: int, **more: int) -> None:
        """Add counts to the record of a dead end."""
        known = self.tried.get((s, lost), Tried())
        self.tried[s, lost] = known._replace(**{name: getattr(known, name) + value for name, value in more.items()})
