"""The lanes that an engine has in flight, at most as many as the kernels' table takes, and those that wait for room."""

import numpy as np

from htcp_jax.planner.lanes import NEW, Lanes, new_lanes
from htcp_jax.planner.programs import Kernels
from htcp_jax.planner.tables import concatenate, gather
from htcp_jax.planner.work import Work
from htcp_jax.scene.scenario import Scenario


class LaneTable:
    """One engine's, topped up from the work of all."""

    def __init__(self, kernels: Kernels, scenarios: Scenario, work: Work):
        self._kernels, self._starts, self._work = kernels, scenarios.x_start, work
        self._lanes: Lanes | None = None
        self._queue: list[Lanes] = []

    def keep(self, lanes: Lanes) -> None:
        """Put lanes that go on back into the table."""
        if lanes.size:
            self._lanes = lanes if self._lanes is None else concatenate([self._lanes, lanes])

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
        elif self._lanes is not None:
            movable = np.flatnonzero(self._lanes.phase >= NEW)[1::2]
            if len(movable):
                self._work.leave(gather(self._lanes, movable))
                self._lanes = gather(self._lanes, ~np.isin(np.arange(self._lanes.size), movable))

    def _top_up(self) -> bool:
        """From the queue, then with new scenarios. False where there is nothing."""
        parts, free = [], self._kernels.lanes
        if self._lanes is not None:
            parts, free = [self._lanes], free - self._lanes.size
        while free > 0 and self._queue:
            block = self._queue.pop(0)
            if block.size > free:
                self._queue.insert(0, gather(block, slice(free, None)))
                block = gather(block, slice(0, free))
            parts.append(block)
            free -= block.size
        if new := self._work.take(free):
            starts = self._starts[new]
            parts.append(new_lanes(self._kernels.sizes, np.array(new), np.zeros(len(new), int), starts, starts))
        self._lanes = concatenate(parts) if parts else None
        return self._lanes is not None

    def turn(self) -> list[tuple[int, Lanes]]:
        """Take the lanes whose turn it is out of the table, by phase. Where a call takes its time however few lanes
        there are, it is the turn of the phase that has most: the others grow meanwhile."""
        lanes, self._lanes = self._lanes, None
        phases, counts = np.unique(lanes.phase, return_counts=True)
        if not self._kernels.pays_by_lane:
            phases = phases[[np.argmax(counts)]]
            self.keep(gather(lanes, lanes.phase != phases[0]))
        return [(int(phase), gather(lanes, lanes.phase == phase)) for phase in phases]
