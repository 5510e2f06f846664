"""Dead ends of beam searches: searches backwards from configurations at the lost target, joined with the beam's tree.

    exclude   end the scenario if the lost target is proven to have no clear configuration
    sample    configurations at the first target that the beam did not reach, the clearest of many pushed clear
    backwards a beam from these towards the start, with the same proofs, in the direction of travel
    meet      at each target, by self-motions from the tree's configurations to those nearest to them
    arrive    if the motion may begin in another configuration: join the first target's configurations in free space
    graft     the reversed motions become branches of the tree, and the search goes on forwards from the lost target
    widen     if configurations there are not connected: forwards from some targets earlier, with a wider beam

Often the configurations that lead past the dead end were dropped at earlier targets, or never sampled. Configurations
that are extended backwards from the lost target do lead to it. `settings.effort` limits their number, relative to the
configurations used by the searches before.

Each of these is one call of a lane function for all scenarios that need it at the time.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable
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
    lane_inputs,
    step_functions,
    tool_cells,
    transfers,
)
from htcp_jax.numerics import ragged_rows
from htcp_jax.planning.beam.functions import SELF_MOTION, inputs_and_tubes
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
TURNS = 4  # calls of `retry` until dead ends are sampled on a GPU, where few lanes take as long as many
TOGETHER = 64  # dead ends at which configurations are sampled in one call, which limits the memory
MEET_RAD, PAIRS = 1.5, 4  # largest distance of configurations that are joined, and pairs tried at each target


class Meeting(NamedTuple):
    """A motion at one target from the tree to a configuration of a search backwards."""

    begin: Float[np.ndarray, "N"] | None  # the tree's configuration [rad or m]; None if the motion begins at `row`
    between: step_functions.State | None
    row: int  # tree row of the configuration of the search backwards


class Ancestors(NamedTuple):
    """Configurations of a search's beam and all their ancestors in the tree, in ascending order of their targets."""

    row: Int[np.ndarray, "n"]  # tree rows, until the tree is pruned
    target: Int[np.ndarray, "n"]
    x: Float[np.ndarray, "n N"]  # [rad or m]

    def at(self, target: int) -> slice:
        """Return the places of the configurations at a target."""
        return slice(*np.searchsorted(self.target, [target, target + 1]).tolist())


@dataclass
class Draws:
    """Configurations drawn after the dead ends of a scenario."""

    rounds: int = 0  # number of rounds of draws so far
    work: int = 0  # configurations used: draws on the target, and push steps


@dataclass
class DeadEnd:
    """A dead end of a scenario after which configurations are sampled."""

    scenario: int
    ended: int  # the search that ended last
    best: int  # the search that reached the farthest target
    lost: int  # the target after that
    off_path: bool  # True: configurations are sampled at the path's first point in place of the lost target
    target: int  # the target at which they are sampled
    anywhere: bool  # True: they are sampled in the complete joint range; False: around those at the target before
    tree: Ancestors | None = None  # of the search `best`, once configurations are sampled


@dataclass
class BackwardSearch:
    """A search backwards from a lost target."""

    joined: int  # the search that it is to be joined to
    tree: Ancestors  # of that search
    tried: int  # the target at which pairs of configurations were tried last
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
        self._missed: Counter[tuple[int, int]] = Counter()  # (scenario, target) -> draws since one arrived
        self._exclusion: dict[bytes, Exclusion] = {}  # inputs of a target -> why it has no clear configuration
        self._turn = 0  # number of calls of `retry`
        self._open: list[DeadEnd] = []  # those at which configurations are sampled in the next round
        self._backwards: dict[int, BackwardSearch] = {}  # by search, until it ends
        self._wider: dict[int, WiderSearch] = {}  # by search
        self.tried: dict[tuple[int, int], Tried] = {}  # (scenario, lost target) -> attempts

    def __len__(self) -> int:
        """Number of scenarios at whose dead ends configurations are still sampled."""
        return len(self._open)

    def has_begun(self, scenario: int) -> bool:
        """Return True if configurations were sampled after a dead end of the scenario."""
        return self._draws[scenario].rounds > 0

    def excluded(self, ended: list[int]) -> set[int]:
        """Return the searches that have ended at a target that is proven to have no clear configuration.

        Then every other search would end there, too. If the lost target is before the path, which the motion may
        bypass, the proof is about the path's first point.
        """
        targets = {one: target for one in ended if (target := self._target_to_exclude(one)) is not None}
        if not targets:
            return set()
        scenario, target = self._searches.columns.scenario[list(targets)], np.array(list(targets.values()))
        reasons = self._exclusions(self._problem.inputs(scenario, target))
        places = zip(scenario.tolist(), target.tolist(), strict=True)
        self.tried |= {place: Tried(excluded=why) for place, why in zip(places, reasons, strict=True) if why}
        return {one for one, why in zip(targets, reasons, strict=True) if why}

    def _exclusions(self, inputs: lane_inputs.LaneInputs) -> list[Exclusion]:
        """Return why targets have no clear configuration; NONE without a proof.

        Equal targets of several scenarios need only one proof.
        """
        executor, zero = self._checker.executor, np.zeros_like(inputs.row)
        inputs = inputs._replace(number=zero, row=zero)  # these select random numbers, and proofs have none
        leaves = [np.reshape(leaf, (len(zero), -1)) for leaf in jax.tree.leaves(inputs)]
        keys = [row.tobytes() for row in np.concatenate(leaves, axis=1)]
        new = {key: k for k, key in enumerate(keys) if key not in self._exclusion}
        if new:
            inputs = tables.gather(inputs, np.array(list(new.values())))
            reasons = tool_cells.exclusions(executor, self._problem.robot, inputs, PROOF_CELLS)
            rest = np.flatnonzero(reasons == Exclusion.NONE)
            if len(rest):
                rest_of = tables.gather(inputs, rest)
                by_tool = tool_cells.excluded(executor, None, rest_of, TOOL_CELLS, exclusion.Bodies.TOOL)
                reasons[rest[by_tool]] = Exclusion.TOOL
            self._exclusion |= zip(new, map(Exclusion, reasons.tolist()), strict=True)
        return [self._exclusion[key] for key in keys]

    def _target_to_exclude(self, ended: int) -> int | None:
        """Return the target whose exclusion by proof would end a scenario; None if there is none."""
        columns, chain, problem = self._searches.columns, self._searches.chain(ended), self._problem
        if columns.status[ended] == NONE or not problem.task.holds_tcp or self._left(chain) <= 0:
            return None
        s, best = int(columns.scenario[ended]), self._searches.forwards(chain[0])[0]
        lost = int(columns.target[best]) + 1
        target = int(problem.scenarios.on_path[s]) if self._leaves_lines(s, lost) else lost
        is_found = target == lost and columns.status[best] == Status.PATH_BLOCKED
        return None if is_found or lost == 0 else target

    def set_blocked(self, ended: int) -> None:
        """Set the status of an ended search to PATH_BLOCKED if a clear configuration is known at the lost target."""
        columns = self._searches.columns
        lost = int(columns.scenario[ended]), int(columns.target[ended]) + 1
        if columns.status[ended] == Status.RECOVERY_EXHAUSTED and self.tried.get(lost, Tried()).found:
            columns.status[ended] = Status.PATH_BLOCKED

    def retry(self, ended: list[int]) -> list[int]:
        """Begin other searches after some have ended; return the last searches of the scenarios that are finished.

        Configurations are sampled once at each dead end. Where none is found, they are sampled again in the next call.
        """
        columns = self._searches.columns
        finished = [one for one in ended if one not in self._backwards and columns.status[one] == NONE]
        grafted = self._grafted([one for one in ended if one in self._backwards])
        self._searches.begin(*self._to_the_end(grafted), list(grafted.values()), list(grafted))
        past = grafted.keys() | set(finished)
        self._open += [self._dead_end(one) for one in ended if one not in past]
        self._turn += 1
        if self._turn % TURNS and self._searches.going.any() and not self._checker.executor.pays_by_lane:
            return finished
        samples = [self._may_sample(end) for end in self._open]
        over = [end for end, may in zip(self._open, samples, strict=True) if not may]
        self._open = self._search_from_samples([end for end, may in zip(self._open, samples, strict=True) if may])
        return finished + self._not_widened(over)

    def _to_the_end(self, searches: Iterable[int]) -> tuple[list[int], list[int]]:
        """Return the scenarios of searches, and their last targets."""
        scenario = self._searches.columns.scenario[list(searches)]
        return scenario.tolist(), (self._problem.scenarios.count[scenario] - 1).tolist()

    def _dead_end(self, ended: int) -> DeadEnd:
        """Return the dead end at which a search has ended, and count the work of searches to its target."""
        columns, chain = self._searches.columns, self._searches.chain(ended)
        s, best = int(columns.scenario[ended]), self._searches.forwards(chain[0])[0]
        if (wider := self._wider.get(ended)) is not None and wider.work is None:
            self._count(s, wider.lost, configurations=int(columns.work[ended]))
        lost = int(columns.target[best]) + 1
        off_path = self._leaves_lines(s, lost)
        target = int(self._problem.scenarios.on_path[s]) if off_path else lost
        return DeadEnd(s, ended, best, lost, off_path, target, off_path or self._may_arrive(s, best))

    def _may_sample(self, end: DeadEnd) -> bool:
        """Return True if configurations may still be sampled at a dead end."""
        missed = self._missed[end.scenario, end.target]
        return end.lost > 0 and missed < MOST_MISSED and self._left(self._searches.chain(end.ended)) > 0

    def _not_widened(self, ends: list[DeadEnd]) -> list[int]:
        """Begin wider searches some targets before lost ones, if that may help; return the searches of other dead ends.

        It may help if clear configurations were found at the lost target, and none of them is connected.
        """
        wide = [end for end in ends if self._may_widen(end)]
        roots = []
        for end, tree in zip(wide, self._ancestors([end.best for end in wide]), strict=True):
            roots.append(tree.row[tree.at(max(end.lost - BACK, int(tree.target[0])))])
            self._count(end.scenario, end.lost, wider=1)
        ended = {end.ended: end.lost for end in wide}
        begun = self._searches.begin(*self._to_the_end(ended), roots, list(ended), width=WIDER)
        self._wider |= {search: WiderSearch(lost) for search, lost in zip(begun, ended.values(), strict=True)}
        return [end.ended for end in ends if end.ended not in ended]

    def _may_widen(self, end: DeadEnd) -> bool:
        known, columns = self.tried.get((end.scenario, end.lost), Tried()), self._searches.columns
        is_found = known.found or columns.status[end.best] == Status.PATH_BLOCKED
        may = is_found and not known.connected and not known.wider and not end.off_path
        return bool(may and self._left(self._searches.chain(end.ended), share=1.0) > 0)

    def meet(self) -> None:
        """Join the beams of searches backwards with near configurations of the tree at the same target.

        Stop searches that have met the tree, and searches whose effort is spent.
        """
        columns, pairs = self._searches.columns, []
        stop = np.zeros(len(columns.target), bool)
        for search in np.flatnonzero(self._searches.going).tolist():
            target = int(columns.target[search])
            if (backwards := self._backwards.get(search)) is not None:
                if target != backwards.tried:  # pairs are tried once
                    pairs += self._nearest(search, backwards.tree.x[backwards.tree.at(target)])
                    backwards.tried = target
                stop[search] = self._left(self._searches.chain(search)) <= 0
            elif (wider := self._wider.get(search)) is not None and wider.work is None:
                if target >= wider.lost:
                    columns.width[search], wider.work = 1, int(columns.work[search])
                    s = int(columns.scenario[search])
                    self._count(s, wider.lost, configurations=wider.work, connected=1)
                else:
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
        columns, before, wider = self._searches.columns, 0, 0
        s = int(columns.scenario[chain[0]])
        spent = self._draws[s].work
        for search in chain:
            work = int(columns.work[search])
            if columns.step[search] < 0:
                spent += work
            elif (of_wider := self._wider.get(search)) is not None:
                wider += work if of_wider.work is None else of_wider.work
                before += 0 if of_wider.work is None else work - of_wider.work
            else:
                before += work
        if share is None:
            share = 1.0 if self._may_arrive(s, self._searches.forwards(chain[0])[0]) else SHARE
        return share * self._problem.settings.effort * before - spent - wider

    def _leaves_lines(self, s: int, lost: int) -> bool:
        """Return True if the lost target is not beyond the path's first point, which is then sampled in its place."""
        return bool(lost <= self._problem.scenarios.on_path[s] and not self._problem.begins_anywhere[s])

    def _ancestors(self, searches: list[int]) -> list[Ancestors]:
        """Return the beams of ended searches, each of another scenario, with all ancestors."""
        beams = [np.array(self._searches.beam_of(search)) for search in searches]
        if not beams:
            return []
        owner = np.repeat(np.arange(len(beams)), [len(beam) for beam in beams])
        row, owner = self._tree.with_ancestors(np.concatenate(beams), owner)
        order = np.lexsort((self._tree.target[row], owner))
        row, owner = row[order], owner[order]
        every = Ancestors(row, self._tree.target[row], self._tree.x[row])
        ends = np.searchsorted(owner, np.arange(len(beams) + 1))
        return [tables.gather(every, slice(*ends[k : k + 2])) for k in range(len(beams))]

    def _may_arrive(self, s: int, best: int) -> bool:
        """Return True if the motion may begin in another configuration than the search to be joined."""
        elsewhere = self._problem.settings.transfers or bool(self._problem.scenarios.auto_start[s])
        return elsewhere or bool(self._searches.columns.root[best] > 0)

    def _search_from_samples(self, ends: list[DeadEnd]) -> list[DeadEnd]:
        """Sample configurations at dead ends, and begin searches from them; return the dead ends without any."""
        if not ends:
            return []
        new = [end for end in ends if end.tree is None]
        for end, tree in zip(new, self._ancestors([end.best for end in new]), strict=True):
            end.tree = tree
        work = [self._draws[end.scenario].work for end in ends]
        roots = self._sampled_configurations(ends)
        for end, before, rows in zip(ends, work, roots, strict=True):
            used = self._draws[end.scenario].work - before
            self._count(end.scenario, end.lost, configurations=used, found=len(rows), searches=int(len(rows) > 0))
        found = [(end, rows) for end, rows in zip(ends, roots, strict=True) if len(rows)]
        scenario, last = self._to_the_end(end.ended for end, _ in found)
        first = self._searches.columns.root[[end.best for end, _ in found]].tolist()
        last = [to if end.off_path else back for to, back, (end, _) in zip(last, first, found, strict=True)]
        backwards = np.array([not end.off_path for end, _ in found], bool)
        begun = self._searches.begin(
            scenario, last, [rows for _, rows in found], [end.ended for end, _ in found], backwards
        )
        for search, (end, _) in zip(begun, found, strict=True):
            if not end.off_path:
                self._backwards[search] = BackwardSearch(end.best, end.tree, end.lost)
        return [end for end, rows in zip(ends, roots, strict=True) if not len(rows)]

    def _sampled_configurations(self, ends: list[DeadEnd]) -> list[Int[np.ndarray, "m"]]:
        """Return, for each dead end, tree rows of new valid configurations: the clearest of random draws, pushed clear.

        They are far apart.
        """
        problem, checker, settings = self._problem, self._checker, self._problem.settings
        parts = [self._arrived(ends[first : first + TOGETHER]) for first in range(0, len(ends), TOGETHER)]
        x = [own for part in parts for own in part]
        lane = np.repeat(np.arange(len(ends)), [len(own) for own in x])
        if not len(lane):
            return [lane] * len(ends)
        scenario, target = (np.array([getattr(end, name) for end in ends]) for name in ("scenario", "target"))
        inputs = problem.inputs(scenario[lane], target[lane])
        pushed = checker.executor(stages.PUSH, inputs, np.concatenate(x))
        at = checker.states(inputs, pushed.x)._replace(x=pushed.x, linear=None)
        good = np.flatnonzero(checker.valid(inputs, at))
        good = good[np.lexsort((-at.clearance[good], lane[good]))]
        good = good[configurations.dispersed(at.x[good], lane[good], settings.beam_width, settings.beam_separation_rad)]
        rows = self._tree.plant(tables.gather(at, good), target[lane[good]])
        return np.split(rows, np.searchsorted(lane[good], np.arange(1, len(ends))))

    def _arrived(self, ends: list[DeadEnd]) -> list[Float[np.ndarray, "m N"]]:
        """Return, for each dead end, draws that arrive at the target: the clearest ones that are far apart."""
        problem, drawn = self._problem, self._drawn(ends)
        lane = np.repeat(np.arange(len(ends)), [len(x) for x in drawn])
        scenario, target = (np.array([getattr(end, name) for end in ends])[lane] for name in ("scenario", "target"))
        here = transfers.projected(problem, self._checker, scenario, target, np.concatenate(drawn))
        reached = np.flatnonzero(problem.task.reached(here.residual))
        reached = reached[np.lexsort((-here.clearance[reached], lane[reached]))]
        apart = reached[configurations.first_apart(here.x[reached], lane[reached], PUSHED, APART_RAD)]
        found = np.split(here.x[apart], np.searchsorted(lane[apart], np.arange(1, len(ends))))
        for end, x, own, count in zip(ends, drawn, found, np.bincount(lane[reached], minlength=len(ends)), strict=True):
            draws, place = self._draws[end.scenario], (end.scenario, end.target)
            self._missed[place] = 0 if count else self._missed[place] + len(x)
            draws.work += max(int(count), len(x) // FEW) + len(own) * problem.settings.max_null_space_steps
        return found

    def _drawn(self, ends: list[DeadEnd]) -> list[Float[np.ndarray, "n N"]]:
        """Return random configurations for each dead end [rad or m].

        They are uniform within the joint limits, or around the tree's configurations at the target before the lost one.
        """
        rounds = {}
        for end in ends:
            draws, count = self._draws[end.scenario], ROUNDS if end.anywhere else 1
            rounds[end.scenario] = FIRST_ROUND + draws.rounds + np.arange(count)
            draws.rounds += count
        found = {end.scenario: self._drawn_near(end, *rounds[end.scenario]) for end in ends if not end.anywhere}
        if len(found) < len(ends):
            anywhere = [end.scenario for end in ends if end.anywhere]
            scenario, round_ = np.repeat(anywhere, ROUNDS), np.concatenate([rounds[s] for s in anywhere])
            x = transfers.drawn_configurations(self._problem, self._checker, scenario, round_)
            found |= zip(anywhere, x.reshape(len(anywhere), -1, x.shape[2]), strict=True)
        return [found[end.scenario] for end in ends]

    def _drawn_near(self, end: DeadEnd, round_: int) -> Float[np.ndarray, "n N"]:
        """Return random configurations around the tree's at the target before the lost one [rad or m]."""
        near = end.tree.x[end.tree.at(end.lost - 1)]
        number = int(self._problem.scenarios.number[end.scenario])
        rng = np.random.default_rng([self._problem.settings.seed, number, round_])
        drawn = near[rng.integers(len(near), size=transfers.DRAWS)]
        return np.clip(drawn + NEAR_RAD * rng.standard_normal(drawn.shape), *self._checker.executor.limits)

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
        lanes = self._problem.with_still_joints(inputs, columns.scenario[search], target + 1)
        moved = self._checker.executor(SELF_MOTION, lanes, begin, end, np.zeros(len(row), np.int32))
        count = moved.steps + 1  # number of segments, including the one to the end
        lane, step = ragged_rows(count)
        x = np.concatenate([begin[:, None], moved.path.x, end[:, None]], axis=1)
        after = np.where(step == moved.steps[lane], x.shape[1] - 1, step + 1)
        proof = self._checker.edges(
            tables.gather(inputs, lane), x[lane, step], x[lane, after], tables.gather(tube, lane), tip=False
        )
        bad = (np.bincount(lane, proof.verdict != SegmentStatus.VALID, len(row)) > 0) | ~moved.arrives
        if lanes.still is not None:
            bad |= (lanes.still & (begin != end)).any(axis=1)
        met = []
        for k in np.flatnonzero(~bad).tolist():
            between = jax.tree.map(lambda leaf, k=k: leaf[k, : moved.steps[k]], moved.path)
            met.append((int(search[k]), Meeting(begin[k], between, int(row[k]))))
        return met

    def _grafted(self, ended: list[int]) -> dict[int, Int[np.ndarray, "m"]]:
        """Add the reversed motions of ended searches backwards to the tree, where they are connected.

        Returns:
            The searches that are connected, and the tree rows at their lost targets: one for each configuration there
            that is connected.
        """
        columns, found = self._searches.columns, {}
        backwards = [self._backwards.pop(search) for search in ended]
        trees = self._ancestors([each.joined for each in backwards])
        for search, each, tree in zip(ended, backwards, trees, strict=True):
            s, lost = int(columns.scenario[search]), int(columns.target[each.joined]) + 1
            if not each.meetings and columns.status[search] == NONE and self._may_arrive(s, each.joined):
                each.meetings = [Meeting(None, None, row) for row in self._searches.beam_of(search)]
            rows = self._branches(s, each.meetings, tree)
            self._count(s, lost, configurations=int(columns.work[search]), connected=len(rows))
            if rows:
                found[search] = np.array(rows)
        return found

    def _branches(self, s: int, meetings: list[Meeting], tree: Ancestors) -> list[int]:
        """Add a branch for each connected configuration at the lost target; return the rows of the branches' ends."""
        found = {}
        for begin, between, row in meetings:
            path = self._tree.path(row)
            if (root := int(path[0])) in found:
                continue
            parent = configurations.NO_PARENT
            if begin is not None:
                here = tree.at(int(self._tree.target[row]))
                parent = int(tree.row[here][(tree.x[here] == begin).all(axis=1)][0])
            end = self._branch(parent, between, path[::-1], int(self._problem.scenarios.on_path[s]))
            if self._joint_steps is None or self._joint_steps.are_kept(s, self._tree.nodes(self._tree.path(end))):
                found[root] = end
        return list(found.values())

    def _branch(
        self, parent: int, between: step_functions.State | None, path: Int[np.ndarray, "k"], on_path: int
    ) -> int:
        """Add a branch to the tree, `between` and then copies of the nodes on `path`; return the tree row of its end.

        It starts at the node `parent`, or at a new root for NO_PARENT.
        """
        nodes = self._tree.nodes(path)
        at, target, step_qps = nodes.at, nodes.target, nodes.step_qps
        if between is not None:
            at, zero = jax.tree.map(lambda a, b: np.concatenate([a, b]), between, at), np.zeros(len(between.x), int)
            target, step_qps = np.append(zero + target[0], target), np.append(zero, step_qps)
        before = self._tree.target[parent] if parent != configurations.NO_PARENT else -1
        if parent == configurations.NO_PARENT:
            step_qps = np.append(0, step_qps[1:])
        turns = np.diff(target, prepend=before) == 0
        begins = turns & ~np.append(False, turns[:-1]) & (target >= on_path)
        return self._tree.grow_path(parent, at, target, step_qps, turns, begins)

    def _count(self, s: int, lost: int, **more: int) -> None:
        """Add counts to the record of a dead end."""
        known = self.tried.get((s, lost), Tried())
        self.tried[s, lost] = known._replace(**{name: getattr(known, name) + value for name, value in more.items()})
