"""The lanes of engines: the table's columns, the work that engines share, and the lanes that one engine advances.

Every column of a table is a numpy array, with one row per lane. A lane has all data that another engine needs to
continue it. When only hard scenarios are left, their lanes are repeatedly divided among the engines, so that no engine
is idle for long.
"""

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import NamedTuple

import numpy as np

from htcp_jax.clearance import ClearanceRows
from htcp_jax.clearance.obstacles import Linearisation, TaskRows
from htcp_jax.device import Executor, tables
from htcp_jax.model import Scenario
from htcp_jax.motion import step_functions

MAIN = -1  # `candidate` of a scenario's main lane, which is not a candidate
# Phases; the phase of a lane in a recovery stage is the stage's number. The last three are for lanes planned
# backwards: configurations are drawn at the failed target, moved back from target to target, and checked.
NEW, TRACK, DRAWING, PUSHING, CHECKING = -2, -1, -3, -4, -5
BACKWARDS = DRAWING, PUSHING, CHECKING
ENTERING = -1  # `null_space_steps` of a lane before its first null-space step
KINDS = TaskRows, ClearanceRows


class Lanes(NamedTuple):
    """Table of lanes, one per row."""

    scenario: np.ndarray
    target: np.ndarray
    candidate: np.ndarray  # MAIN, or the number of a candidate
    phase: np.ndarray  # NEW: to be linearised; TRACK: step QPs; else a recovery stage, or a phase of planning backwards
    iteration: np.ndarray  # number of step QPs at this target so far
    null_space_steps: np.ndarray  # number of null-space steps so far, or ENTERING
    x_previous: np.ndarray  # configurations at the previous target [rad or m]
    x_ref: np.ndarray  # current configurations [rad or m]
    linear: Linearisation  # task and clearance at x_ref to first order

    @property
    def size(self) -> int:
        """Number of lanes."""
        return len(self.scenario)


def new_lanes(sizes: tuple[int, int], scenario, target, x_previous, x_ref, candidate=MAIN) -> Lanes:
    """Return lanes that start at x_ref.

    Args:
        sizes: Number of values in the task, and of clearance rows.
        scenario: Rows of the scenarios (L,).
        target: Indices of the targets (L,).
        x_previous: Configurations at the previous targets (L, N) [rad or m].
        x_ref: Configurations to start at (L, N) [rad or m].
        candidate: MAIN, or the candidates' numbers (L,).
    """
    lanes, n = x_ref.shape

    def column(value):
        return np.broadcast_to(np.asarray(value, np.int32), lanes).copy()

    linear = Linearisation(
        *(kind(np.zeros((lanes, rows)), np.zeros((lanes, rows, n))) for kind, rows in zip(KINDS, sizes, strict=True))
    )
    return Lanes(
        column(scenario), column(target), column(candidate), column(NEW), column(0), column(0),
        np.array(x_previous), np.array(x_ref), linear,
    )  # fmt: skip


class ArrivedCandidates(NamedTuple):
    """Candidates that reached their target, and their states there."""

    number: np.ndarray  # number of each candidate in its scenario
    now: step_functions.State


@dataclass
class PendingCandidates:
    """A stuck scenario whose candidates are being tracked."""

    lane: tuple[Lanes, np.ndarray]  # the table and the row of the stuck lane
    stage: int  # number of the sampling stage
    undecided: int  # number of candidates not decided yet
    qps: int = 0  # number of step QPs solved for the candidates
    # candidates that reached the target: tables, and their rows for this scenario
    arrived: list[tuple[ArrivedCandidates, np.ndarray]] = field(default_factory=list)


class Work:
    """Scenarios for a number of engines, one per thread.

    Attributes:
        pending: Scenarios that wait for their candidates, which any engine may track; `pending_lock` guards it.
    """

    def __init__(self, scenarios: Sequence[int], engines: int):
        # Neighbouring scenarios of a grid are similar: they go to different engines, so that all get some hard ones.
        self._scenarios = iter([scenario for first in range(engines) for scenario in scenarios[first::engines]])
        self._most, self._engines = -(-len(scenarios) // engines), engines
        self._idle = 0
        self._shared: list[Lanes] = []  # lanes passed on and not yet taken
        self.pending: dict[int, PendingCandidates] = {}
        self.pending_lock = threading.Lock()
        self._changed = threading.Condition()

    def take(self, most: int) -> list[int]:
        """Return new scenarios, at most `most` and at most an engine's share of all scenarios."""
        with self._changed:
            return list(islice(self._scenarios, min(most, self._most)))

    @property
    def has_idle_engine(self) -> bool:
        """True if an idle engine has no work assigned."""
        return self._idle > len(self._shared)

    def share(self, lanes: Lanes) -> None:
        """Pass lanes to an idle engine."""
        with self._changed:
            self._shared.append(lanes)
            self._changed.notify_all()

    def wait(self) -> Lanes | None:
        """Wait for lanes from another engine; return None once no engine has any lanes."""
        with self._changed:
            self._idle += 1
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._shared or self._idle >= self._engines)
            if not self._shared:
                return None
            self._idle -= 1
            return self._shared.pop()

    def end(self) -> None:
        """Deregister an engine that has ended or failed, so that no other engine waits for its lanes."""
        with self._changed:
            self._engines -= 1
            self._changed.notify_all()


class LaneTable:
    """One engine's lanes, refilled from the shared work."""

    def __init__(self, executor: Executor, scenarios: Scenario, work: Work):
        self._executor, self._starts, self._work = executor, scenarios.x_start, work
        self._kept: list[Lanes] = []  # lanes being advanced
        self._queue: list[Lanes] = []

    def keep(self, lanes: Lanes) -> None:
        """Put unfinished lanes back into the table."""
        if lanes.size:
            self._kept.append(lanes)

    def queue(self, lanes: Lanes) -> None:
        """Queue lanes until rows of the table are free."""
        self._queue.append(lanes)

    def fill(self) -> bool:
        """Pass some lanes to an idle engine, if there is one, and fill the table; return False if no work is left."""
        if self._work.has_idle_engine:
            self._share_lanes()
        while not self._top_up():
            lanes = self._work.wait()
            if lanes is None:
                return False
            self._queue.append(lanes)
        return True

    def _share_lanes(self) -> None:
        """Pass half of a queued block of lanes to an idle engine; if the queue is empty, half of the table's lanes.

        Lanes that are planned backwards stay, as this engine has further state of them.
        """
        if self._queue:
            block = self._queue.pop()
            self._work.share(tables.gather(block, slice(0, None, 2)))
            if block.size > 1:
                self._queue.append(tables.gather(block, slice(1, None, 2)))
        elif self._kept:
            lanes = tables.concatenate(self._kept)
            movable = np.flatnonzero(lanes.phase >= NEW)[1::2]
            if len(movable):
                self._work.share(tables.gather(lanes, movable))
                self._kept = [tables.gather(lanes, ~np.isin(np.arange(lanes.size), movable))]

    def _top_up(self) -> bool:
        """Fill the table from the queue, then with new scenarios; return False if there are no lanes."""
        free = self._executor.lanes - sum(lanes.size for lanes in self._kept)
        while free > 0 and self._queue:
            block = self._queue.pop(0)
            if block.size > free:
                self._queue.insert(0, tables.gather(block, slice(free, None)))
                block = tables.gather(block, slice(0, free))
            self._kept.append(block)
            free -= block.size
        if new := self._work.take(free):
            starts = self._starts[new]
            self._kept.append(new_lanes(self._executor.sizes, np.array(new), np.zeros(len(new), int), starts, starts))
        return bool(self._kept)

    def next_chunk(self) -> list[tuple[int, Lanes]]:
        """Remove the lanes to advance next from the table, and return them by phase.

        On a CPU these are all lanes. If a call with few lanes takes as long as one with many lanes, only lanes in the
        most frequent phase are taken, while further lanes collect in the other phases.
        """
        lanes, self._kept = tables.concatenate(self._kept), []
        phases, counts = np.unique(lanes.phase, return_counts=True)
        if not self._executor.pays_by_lane:
            phases = phases[[np.argmax(counts)]]
            self.keep(tables.gather(lanes, lanes.phase != phases[0]))
        return [(int(phase), tables.gather(lanes, lanes.phase == phase)) for phase in phases]
