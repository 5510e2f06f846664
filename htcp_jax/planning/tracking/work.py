"""What several engines share: scenarios that none has begun, and lanes that one engine leaves to another that has none.

A lane brings along all that an engine needs to go on with it. So towards the end, when only hard scenarios are left,
they are halved among the engines again and again, and none waits for another for long.
"""

import threading
from collections.abc import Sequence
from itertools import islice

from htcp_jax.planning.tracking.lanes import Lanes


class Work:
    """Scenarios for so many engines, one a thread."""

    def __init__(self, scenarios: Sequence[int], engines: int):
        # Neighbours in a grid are alike: dealt out in turn, every engine gets its part of the hard ones.
        self._scenarios = iter([scenario for first in range(engines) for scenario in scenarios[first::engines]])
        self._share, self._engines = -(-len(scenarios) // engines), engines
        self._waiting = 0
        self._left: list[Lanes] = []
        self._changed = threading.Condition()

    def take(self, most: int) -> list[int]:
        """New scenarios, at most an engine's share of all."""
        with self._changed:
            return list(islice(self._scenarios, min(most, self._share)))

    @property
    def wanted(self) -> bool:
        """Whether an engine waits for whom no lanes are left yet."""
        return self._waiting > len(self._left)

    def leave(self, lanes: Lanes) -> None:
        """Lanes for an engine that waits."""
        with self._changed:
            self._left.append(lanes)
            self._changed.notify_all()

    def wait(self) -> Lanes | None:
        """Lanes that another engine leaves; None once none has any."""
        with self._changed:
            self._waiting += 1
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._left or self._waiting >= self._engines)
            if not self._left:
                return None
            self._waiting -= 1
            return self._left.pop()

    def end(self) -> None:
        """An engine is done, or broken: nobody waits for what it leaves."""
        with self._changed:
            self._engines -= 1
            self._changed.notify_all()
