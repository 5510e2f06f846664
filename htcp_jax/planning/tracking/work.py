"""Work shared by several engines: scenarios not yet begun, and lanes passed from one engine to an idle one.

A lane has all data that another engine needs to continue the lane. When only hard scenarios are left, their lanes are
repeatedly divided among the engines, so that no engine is idle for long.
"""

import threading
from collections.abc import Sequence
from itertools import islice

from htcp_jax.planning.tracking.lanes import Lanes


class Work:
    """Scenarios for a number of engines, one per thread."""

    def __init__(self, scenarios: Sequence[int], engines: int):
        # Neighbouring scenarios of a grid are similar: they go to different engines, so that all get some hard ones.
        self._scenarios = iter([scenario for first in range(engines) for scenario in scenarios[first::engines]])
        self._share, self._engines = -(-len(scenarios) // engines), engines
        self._waiting = 0
        self._left: list[Lanes] = []
        self._changed = threading.Condition()

    def take(self, most: int) -> list[int]:
        """Return new scenarios, at most `most` and at most an engine's share of all scenarios."""
        with self._changed:
            return list(islice(self._scenarios, min(most, self._share)))

    @property
    def wanted(self) -> bool:
        """True if an idle engine has no work assigned."""
        return self._waiting > len(self._left)

    def leave(self, lanes: Lanes) -> None:
        """Pass lanes to an idle engine."""
        with self._changed:
            self._left.append(lanes)
            self._changed.notify_all()

    def wait(self) -> Lanes | None:
        """Wait for lanes from another engine; return None once no engine has any lanes."""
        with self._changed:
            self._waiting += 1
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._left or self._waiting >= self._engines)
            if not self._left:
                return None
            self._waiting -= 1
            return self._left.pop()

    def end(self) -> None:
        """Deregister an engine that has ended or failed, so that no other engine waits for its lanes."""
        with self._changed:
            self._engines -= 1
            self._changed.notify_all()
