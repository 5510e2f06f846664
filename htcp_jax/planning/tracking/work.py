"""Work shared by several engines: new scenarios, lanes passed to an idle engine, and scenarios with candidates.

A lane has all data that another engine needs to continue the lane. When only hard scenarios are left, their lanes are
repeatedly divided among the engines, so that no engine is idle for long.
"""

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import NamedTuple

import numpy as np

from htcp_jax.motion import step_functions
from htcp_jax.planning.tracking.lanes import Lanes


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
