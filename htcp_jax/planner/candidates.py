"""Candidates: a sampling stage proposes configurations for a stuck scenario, which waits while the step QPs track its
target from each of them. Of those that reach it, the nearest by a clear joint path is where the scenario goes on."""

import threading
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from htcp_jax.planner.kernels import Measured
from htcp_jax.planner.lane_checks import LaneChecks
from htcp_jax.planner.lanes import Lanes, new_lanes
from htcp_jax.planner.sampling import Candidates
from htcp_jax.planner.stages import Escapes
from htcp_jax.planner.tables import concatenate, gather


@dataclass
class PendingCandidates:
    """A stuck scenario whose candidates are being tracked."""

    lane: Lanes  # the one lane that is stuck
    left: int  # candidates not decided yet
    qps: int = 0  # step QPs that the candidates took
    numbers: list[np.ndarray] = field(default_factory=list)  # of the candidates that reached the target
    ends: list[Measured] = field(default_factory=list)  # where those are


@dataclass
class Waiting:
    """The scenarios that wait for their candidates; these may be tracked by any engine."""

    of: dict[int, PendingCandidates] = field(default_factory=dict)  # by scenario
    lock: threading.Lock = field(default_factory=threading.Lock)


class Arrived(NamedTuple):
    """Lanes that a stage has brought to their target."""

    lanes: Lanes
    now: Measured
    clear: np.ndarray  # whether the joint path there is; -1: not checked


class Outcome(NamedTuple):
    """What a stage has come to; lanes that are in none of the three wait for their candidates."""

    stage: int
    spent: Lanes  # the stage has nothing left for these
    arrived: Arrived | None = None
    candidates: Lanes | None = None  # to be tracked


class CandidateSearch:
    """One engine's part in the scenarios that wait for their candidates."""

    def __init__(self, checks: LaneChecks, escapes: Escapes, waiting: Waiting):
        self._checks, self._kernels = checks, [stage.kernel(k) for k, stage in enumerate(escapes.stages)]
        self._waiting = waiting

    def sample(self, lanes: Lanes, stage: int) -> Outcome:
        """Propose candidates for every lane. Where some are done as they are, take the best of them; elsewhere try."""
        found: Candidates = self._checks.kernels(self._kernels[stage], self._checks.inputs(lanes), lanes.x_previous)
        found = found._replace(done=self._without_passing_tips(lanes, found))
        done = found.done.any(axis=1)
        outcome = self.track_from(gather(lanes, ~done), found.x[~done], found.valid[~done], stage)
        if not done.any():
            return outcome
        lanes, (owner, number) = gather(lanes, done), np.nonzero(found.done[done])
        x = found.x[done][owner, number]
        best, clear = self._best(lanes, owner, number, x)
        return outcome._replace(arrived=Arrived(lanes, self._checks.measured(lanes, x[best]), clear))

    def _without_passing_tips(self, lanes: Lanes, found: Candidates) -> np.ndarray:
        """Which candidates (lanes, C) are done, but for those whose tip passes through a wall."""
        owner, number = np.nonzero(found.done)
        x = found.x[owner, number]
        through = self._checks.tip_passes(gather(lanes, owner), x, np.ones(len(owner), bool))
        done = found.done.copy()
        done[owner[through], number[through]] = False
        return done

    def track_from(self, lanes: Lanes, x: np.ndarray, valid: np.ndarray, stage: int) -> Outcome:
        """Have the target of each lane tracked from its valid configurations, x (lanes, C, N), while the lane waits."""
        left = valid.sum(axis=1)
        for k in np.flatnonzero(left):
            self._waiting.of[int(lanes.scenario[k])] = PendingCandidates(gather(lanes, [k]), int(left[k]))
        owner, number = np.nonzero(valid)
        spent = gather(lanes, left == 0)
        if not len(owner):
            return Outcome(stage, spent)
        at = lanes.scenario[owner], lanes.target[owner], lanes.x_previous[owner]
        return Outcome(
            stage, spent, candidates=new_lanes(self._checks.kernels.sizes, *at, x[owner, number], candidate=number)
        )

    def decide(self, lanes: Lanes, now: Measured, reached: np.ndarray, stuck: np.ndarray) -> list[Outcome]:
        """Candidates that reached the target, and those that did not; outcomes where these were the last ones."""
        decided = np.flatnonzero(reached | stuck)
        if not len(decided):
            return []
        decided = decided[np.argsort(lanes.scenario[decided], kind="stable")]
        ready = []
        for rows in np.split(decided, np.flatnonzero(np.diff(lanes.scenario[decided])) + 1):
            with self._waiting.lock:
                scenario = int(lanes.scenario[rows[0]])
                pending = self._waiting.of[scenario]
                pending.left -= len(rows)
                pending.qps += int(lanes.iteration[rows].sum())
                good = rows[reached[rows]]
                if len(good):
                    pending.numbers.append(lanes.candidate[good])
                    pending.ends.append(gather(now, good))
                if not pending.left:
                    ready.append(self._waiting.of.pop(scenario))
        stages = sorted({int(pending.lane.phase[0]) for pending in ready})
        return [self._choose([each for each in ready if each.lane.phase[0] == stage], stage) for stage in stages]

    def _choose(self, ready: list[PendingCandidates], stage: int) -> Outcome:
        """The best of the candidates that reached the target."""
        lanes = concatenate([each.lane._replace(iteration=each.lane.iteration + each.qps) for each in ready])
        found = np.array([bool(each.numbers) for each in ready])
        spent = gather(lanes, ~found)
        if not found.any():
            return Outcome(stage, spent)
        ready, lanes = [each for each in ready if each.numbers], gather(lanes, found)
        owner = np.repeat(np.arange(len(ready)), [sum(map(len, each.numbers)) for each in ready])
        number = np.concatenate([part for each in ready for part in each.numbers])
        now = concatenate([part for each in ready for part in each.ends])
        best, clear = self._best(lanes, owner, number, now.x)
        return Outcome(stage, spent, Arrived(lanes, gather(now, best), clear))

    def _best(self, lanes: Lanes, owner: np.ndarray, number: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, ...]:
        """For every lane, which of the configurations x (M, N) that it owns has the smallest joint change of those
        whose path is clear, and whether that is clear (-1: not checked)."""
        clear = self._checks.path_clear(gather(lanes, owner), x, self._checks.of_escapes)
        best = nearest(owner, number, np.linalg.norm(x - lanes.x_previous[owner], axis=1), clear)
        return best, clear[best]


def nearest(owner: np.ndarray, number: np.ndarray, change: np.ndarray, clear: np.ndarray) -> np.ndarray:
    """For every owner, the place of its candidate of the smallest change among those whose path is clear or unchecked,
    of equals the first by number; one that is not clear only where none is. All (M,); the result is one a owner."""
    order = np.lexsort((number, np.where(clear != 0, change, np.inf), owner))
    return order[np.unique(owner[order], return_index=True)[1]]
