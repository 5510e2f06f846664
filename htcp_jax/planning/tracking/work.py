"""Work shared by several engines: scenarios not begun, and lanes that one engine leaves to an idle one.

A lane has all that an engine needs to continue it. So towards the end, when only hard scenarios are left, they are
divided among the engines again and again, and no engine is idle for long.
"""

import threading
from collections.abc import Sequence
from itertools import islice

from htcp_jax.planning.tracking.lanes import Lanes


class Work:
    """Scenarios for a number of engines, one per thread."""

    def __init__(self, scenarios: Sequence[int], engines: int):
        # Neighbours in a grid are alike: dealt out in turn, every engine gets its part of the hard ones.
        self._scenarios = iter([scenario for first in range(engines) for scenario in scenarios[first::engines]])
        self._share, self._engines = -(-len(scenarios) // engines), engines
        self._waiting = 0
        self._left: list[Lanes] = []
        self._changed = threading.Condition()

    def take(self, most: int) -> list[int]:
        """Return new scenarios, at most an engine's share of all."""
        with self._changed:
            return list(islice(self._scenarios, min(most, self._share)))

    @property
    def wanted(self) -> bool:
        """True if an idle engine has no work assigned."""
        return self._waiting > len(self._left)

    def leave(self, lanes: Lanes) -> None:
        """Leave lanes to an idle engine."""
        with self._changed:
            self._left.append(lanes)
            self._changed.notify_all()

    def wait(self) -> Lanes | None:
        """Wait for lanes that another engine leaves; return None once no engine has any."""
        with self._changed:
            self._waiting += 1
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._left or self._waiting >= self._engines)
            if not self._left:
                return None
            self._waiting -= 1
            return self._left.pop()

    def end(self) -> None:
        """Deregister an engine that is done or has failed, so that no engine waits for its lanes."""
        with self._changed:
            self._engines -= 1
            self._changed.notify_all()
