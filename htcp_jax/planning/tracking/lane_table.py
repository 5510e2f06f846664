"""The lanes that an engine has in flight, at most as many as the kernels' table takes, and those that wait for room."""

import numpy as np

from htcp_jax.device.programs import Kernels
from htcp_jax.device.tables import concatenate, gather
from htcp_jax.model.scenario import Scenario
from htcp_jax.planning.tracking.lanes import NEW, Lanes, new_lanes
from htcp_jax.planning.tracking.work import Work


class LaneTable:
    """One engine's, topped up from the work of all."""

    def __init__(self, kernels: Kernels, scenarios: Scenario, work: Work):
        self._kernels, self._starts, self._work = kernels, scenarios.x_start, work
        self._kept: list[Lanes] = []  # in flight
        self._queue: list[Lanes] = []

    def keep(self, lanes: Lanes) -> None:
        """Put lanes that go on back into the table."""
        if lanes.size:
            self._kept.append(lanes)

    def queue(self, lanes: Lanes) -> None:
        """Lanes for when there is room."""
        self._queue.append(lanes)

    def fill(self) -> bool:
        """Leave an engine that waits some of the lanes, and top the table up. False when nothing is left to do."""
        if self._work.wanted:
            self._leave()
        while not self._top_up():
            lanes = self._work.wait()
            if lanes is None:
                return False
            self._queue.append(lanes)
        return True

    def _leave(self) -> None:
        """Half of the lanes that wait, or else of those in flight. Where a way back is planned, the engine knows more
        than its lanes."""
        if self._queue:
            block = self._queue.pop()
            self._work.leave(gather(block, slice(0, None, 2)))
            if block.size > 1:
                self._queue.append(gather(block, slice(1, None, 2)))
        elif self._kept:
            lanes = concatenate(self._kept)
            movable = np.flatnonzero(lanes.phase >= NEW)[1::2]
            if len(movable):
                self._work.leave(gather(lanes, movable))
                self._kept = [gather(lanes, ~np.isin(np.arange(lanes.size), movable))]

    def _top_up(self) -> bool:
        """From the queue, then with new scenarios. False where there is nothing."""
        free = self._kernels.lanes - sum(lanes.size for lanes in self._kept)
        while free > 0 and self._queue:
            block = self._queue.pop(0)
            if block.size > free:
                self._queue.insert(0, gather(block, slice(free, None)))
                block = gather(block, slice(0, free))
            self._kept.append(block)
            free -= block.size
        if new := self._work.take(free):
            starts = self._starts[new]
            self._kept.append(new_lanes(self._kernels.sizes, np.array(new), np.zeros(len(new), int), starts, starts))
        return bool(self._kept)

    def turn(self) -> list[tuple[int, Lanes]]:
        """Take the lanes whose turn it is out of the table, by phase. Where a call takes its time however few lanes
        there are, it is the turn of the phase that has most: the others grow meanwhile."""
        lanes, self._kept = concatenate(self._kept), []
        phases, counts = np.unique(lanes.phase, return_counts=True)
        if not self._kernels.pays_by_lane:
            phases = phases[[np.argmax(counts)]]
            self.keep(gather(lanes, lanes.phase != phases[0]))
        return [(int(phase), gather(lanes, lanes.phase == phase)) for phase in phases]
