"""Table of the lanes that an engine is advancing, at most as many as one call computes, and a queue of other lanes."""

import numpy as np

from htcp_jax.device import Executor, tables
from htcp_jax.model import Scenario
from htcp_jax.planning.tracking.lanes import NEW, Lanes, new_lanes
from htcp_jax.planning.tracking.work import Work


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
