"""Candidates: configurations that a sampling stage proposes for a stuck scenario.

The scenario waits while step QPs track its target from each candidate. It continues from the nearest candidate that
reaches the target by a clear joint path.
"""

from typing import NamedTuple

import numpy as np

from htcp_jax.device import tables
from htcp_jax.motion import step_functions
from htcp_jax.planning.tracking.lane_checks import LaneChecks
from htcp_jax.planning.tracking.lanes import ArrivedCandidates, Lanes, PendingCandidates, Work, new_lanes
from htcp_jax.planning.tracking.sampling import Candidates
from htcp_jax.planning.tracking.stages import Recoveries


class Arrivals(NamedTuple):
    """Lanes that a stage has brought to their target."""

    lanes: Lanes
    now: step_functions.State
    clear: np.ndarray  # joint path to the target: 1 clear, 0 blocked, -1 not checked


class StageOutcome(NamedTuple):
    """Result of a stage; lanes that are neither spent nor arrived wait for their candidates."""

    stage: int  # number of the stage
    spent: Lanes  # lanes for which the stage has failed
    arrived: Arrivals | None = None
    candidates: Lanes | None = None  # candidates to be tracked


class CandidateSearch:
    """Proposes, tracks and selects candidates for one engine."""

    def __init__(self, checks: LaneChecks, recoveries: Recoveries, work: Work):
        self._checks, self._functions = checks, [stage.lane_function(k) for k, stage in enumerate(recoveries.stages)]
        self._work = work

    def sample(self, lanes: Lanes, stage: int) -> StageOutcome:
        """Propose candidates for every lane; select the best one that is already done, else track from all of them."""
        found: Candidates = self._checks.executor(self._functions[stage], self._checks.inputs(lanes), lanes.x_previous)
        found = found._replace(done=self._without_passing_tips(lanes, found))
        done = found.done.any(axis=1)
        outcome = self.track_from(tables.gather(lanes, ~done), found.x[~done], found.valid[~done], stage)
        if not done.any():
            return outcome
        lanes, (owner, number) = tables.gather(lanes, done), np.nonzero(found.done[done])
        x = found.x[done][owner, number]
        best, clear = self._best(lanes, owner, number, x)
        return outcome._replace(arrived=Arrivals(lanes, self._checks.measured(lanes, x[best]), clear))

    def _without_passing_tips(self, lanes: Lanes, found: Candidates) -> np.ndarray:
        """Return True for candidates (lanes, C) that are done and whose bare tip does not pass through a wall."""
        owner, number = np.nonzero(found.done)
        done = found.done.copy()
        done[owner, number] = self._checks.tip_free(
            tables.gather(lanes, owner), found.x[owner, number], done[owner, number]
        )
        return done

    def track_from(self, lanes: Lanes, x: np.ndarray, valid: np.ndarray, stage: int) -> StageOutcome:
        """Make each lane wait, and return its valid candidates as lanes to be tracked.

        Args:
            lanes: The stuck lanes.
            x: The candidates of each lane (lanes, C, N) [rad or m].
            valid: True for candidates to try (lanes, C).
            stage: Number of the sampling stage.

        Returns:
            The outcome, with the lanes to be tracked as its `candidates`.
        """
        count = valid.sum(axis=1)
        for k in np.flatnonzero(count):
            pending = PendingCandidates((lanes, np.array([k])), stage, int(count[k]))
            self._work.pending[int(lanes.scenario[k])] = pending
        owner, number = np.nonzero(valid)
        spent = tables.gather(lanes, count == 0)
        if not len(owner):
            return StageOutcome(stage, spent)
        at = lanes.scenario[owner], lanes.target[owner], lanes.x_previous[owner]
        return StageOutcome(
            stage, spent, candidates=new_lanes(self._checks.executor.sizes, *at, x[owner, number], candidate=number)
        )

    def decide(
        self, lanes: Lanes, now: step_functions.State, reached: np.ndarray, stuck: np.ndarray
    ) -> list[StageOutcome]:
        """Register candidates that reached the target, and candidates that cannot reach it.

        Args:
            lanes: Lanes of candidates, and other lanes.
            now: States of the lanes.
            reached: True for candidates on their target (lanes,).
            stuck: True for candidates that cannot reach their target (lanes,).

        Returns:
            Outcomes of the scenarios whose last candidate is decided.
        """
        decided = np.flatnonzero(reached | stuck)
        if not len(decided):
            return []
        decided = decided[np.argsort(lanes.scenario[decided], kind="stable")]
        first = np.flatnonzero(np.diff(lanes.scenario[decided], prepend=-1))
        qps = np.add.reduceat(lanes.iteration[decided], first)
        good = np.concatenate([[0], np.cumsum(reached[decided])])  # reached ones before each row, and in total
        rows = decided[reached[decided]]
        arrived = ArrivedCandidates(lanes.candidate[rows], tables.gather(now, rows))
        ready = []
        with self._work.pending_lock:
            for k, (start, end) in enumerate(zip(first, [*first[1:], len(decided)], strict=True)):
                scenario = int(lanes.scenario[decided[start]])
                pending = self._work.pending[scenario]
                pending.undecided -= int(end - start)
                pending.qps += int(qps[k])
                if good[end] > good[start]:
                    pending.arrived.append((arrived, np.arange(good[start], good[end])))
                if not pending.undecided:
                    ready.append(self._work.pending.pop(scenario))
        stages = sorted({pending.stage for pending in ready})
        return [self._choose([each for each in ready if each.stage == stage], stage) for stage in stages]

    def _choose(self, ready: list[PendingCandidates], stage: int) -> StageOutcome:
        """Select, for each scenario, the best candidate that reached the target."""
        lanes = tables.gather_from([each.lane for each in ready])
        lanes = lanes._replace(iteration=lanes.iteration + np.array([each.qps for each in ready], np.int32))
        found = np.array([bool(each.arrived) for each in ready])
        spent = tables.gather(lanes, ~found)
        if not found.any():
            return StageOutcome(stage, spent)
        ready, lanes = [each for each in ready if each.arrived], tables.gather(lanes, found)
        places = [place for each in ready for place in each.arrived]
        number, now = tables.gather_from(places)
        owner = np.repeat(np.arange(len(ready)), [sum(len(rows) for _, rows in each.arrived) for each in ready])
        best, clear = self._best(lanes, owner, number, now.x)
        return StageOutcome(stage, spent, Arrivals(lanes, tables.gather(now, best), clear))

    def _best(self, lanes: Lanes, owner: np.ndarray, number: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return the row in x (M, N) of each lane's best configuration, and the result of its joint path.

        The best configuration has the smallest joint change among those with a clear or unchecked path. Results are 1:
        clear, 0: blocked, -1: not checked.
        """
        clear = self._checks.path_clear(tables.gather(lanes, owner), x, self._checks.of_recoveries)
        best = nearest(owner, number, np.linalg.norm(x - lanes.x_previous[owner], axis=1), clear)
        return best, clear[best]


def nearest(owner: np.ndarray, number: np.ndarray, change: np.ndarray, clear: np.ndarray) -> np.ndarray:
    """Return the row of each owner's best candidate (owners,).

    The best candidate has the smallest change among those with a clear or unchecked path; among equal ones, the lowest
    number. A candidate with a blocked path is returned only if the owner has no other candidate.

    Args:
        owner: Owner of each candidate (M,).
        number: The candidates' numbers (M,).
        change: The candidates' joint changes (M,) [rad or m].
        clear: Results of the candidates' paths (M,): 1 clear, 0 blocked, -1 not checked.
    """
    order = np.lexsort((number, np.where(clear != 0, change, np.inf), owner))
    return order[np.unique(owner[order], return_index=True)[1]]
