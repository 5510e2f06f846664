"""The lanes that an engine has in flight, at most as many as the kernels' table takes, and those that wait for room."""

from collections.abc import Iterator

import numpy as np

from htcp_jax.planner.lanes import Lanes, concatenate, gather, new_lanes
from htcp_jax.planner.programs import Kernels
from htcp_jax.scene.scenario import Scenario


class LaneTable:
    """Takes at most `share` new scenarios at a time."""

    def __init__(self, kernels: Kernels, scenarios: Scenario, share: int):
        self._kernels, self._starts, self._share = kernels, scenarios.x_start, share
        self._lanes: Lanes | None = None
        self._queue: list[Lanes] = []

    def keep(self, lanes: Lanes) -> None:
        """Put lanes that go on back into the table."""
        if lanes.size:
            self._lanes = lanes if self._lanes is None else concatenate([self._lanes, lanes])

    def queue(self, lanes: Lanes) -> None:
        """Lanes for when there is room."""
        self._queue.append(lanes)

    def fill(self, scenarios: Iterator[int]) -> bool:
        """Top the table up from the queue, then with new scenarios. False when nothing is left to do."""
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
        new = []
        while len(new) < min(free, self._share) and (scenario := next(scenarios, None)) is not None:
            new.append(scenario)
        if new:
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
