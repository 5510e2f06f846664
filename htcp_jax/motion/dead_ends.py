"""Dead ends of plans: the targets at which a search had no successor, and what was tried after them."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from htcp_jax.status import Exclusion


class Tried(NamedTuple):
    """Attempts after one dead end, in numbers."""

    searches: int = 0  # from configurations found at the lost target
    configurations: int = 0  # sampled, extended or moved
    found: int = 0  # valid configurations at the lost target
    connected: int = 0  # of these, to the start by a proven motion, or to a configuration where the motion may begin
    wider: int = 0  # searches forwards from an earlier target, with a wider beam
    excluded: Exclusion = Exclusion.NONE  # why no configuration is clear at the lost target, so nothing is searched

    @property
    def description(self) -> str:
        """Description of the attempts, in one line."""
        if self.excluded:
            return f"the target is excluded by proof: {self.excluded.message}; no search"
        connected = str(self.connected) if self.connected else "none"
        searches = f"{self.searches} search{'es' if self.searches != 1 else ''} backwards"
        searches += f", {self.wider} with a wider beam" if self.wider else ""
        work = f"{searches}, {self.configurations:,} configurations sampled or extended"
        found = f"{self.found} clear configuration{'s' if self.found != 1 else ''} found at the target"
        return f"{work}; {found}" + (f", {connected} connected" if self.found else "")

    def record(self) -> dict[str, int | str | None]:
        """Return the numbers and the reason as text, for files; None without one."""
        return self._asdict() | {"excluded": self.excluded.words if self.excluded else None}

    def plus(self, other: "Tried") -> "Tried":
        """Return these attempts and others together, with the reason of either."""
        numbers = (a + b for a, b in zip(self[:-1], other[:-1], strict=True))
        return Tried(*numbers, self.excluded or other.excluded)


class DeadEnds(NamedTuple):
    """Dead ends of S scenarios, sorted by scenario and target."""

    scenario: Int[np.ndarray, "n"]  # its row in the plans
    target: Int[np.ndarray, "n"]  # the lost target
    searches: Int[np.ndarray, "n"]  # as in `Tried`, as are the next five
    configurations: Int[np.ndarray, "n"]
    found: Int[np.ndarray, "n"]
    connected: Int[np.ndarray, "n"]
    wider: Int[np.ndarray, "n"]
    excluded: Int[np.ndarray, "n"]  # numbers of `Exclusion`

    @classmethod
    def of(cls, tried: Mapping[tuple[int, int], Tried]) -> "DeadEnds":
        """Return dead ends from what was tried, by scenario and target."""
        rows = [(*key, *tried[key]) for key in sorted(tried)]
        return cls(*np.array(rows, np.int32).reshape(-1, len(cls._fields)).T)

    def rows(self, which: Int[np.ndarray, "R"]) -> "DeadEnds":
        """Select scenarios by their rows, renumbered in the order of `which`."""
        found = [self.on(old) for old in which.tolist()]
        return DeadEnds.of({(new, t): tried for new, own in enumerate(found) for t, tried in own.items()})

    def on(self, scenario: int) -> dict[int, Tried]:
        """Return what was tried in one scenario, by lost target."""
        own = np.flatnonzero(self.scenario == scenario)
        rows = {int(self.target[k]): [int(column[k]) for column in self[2:]] for k in own}
        return {target: Tried(*numbers, Exclusion(reason)) for target, (*numbers, reason) in rows.items()}

    def moved(self, target: Int[np.ndarray, "S R"]) -> "DeadEnds":
        """Return the dead ends at other targets, added up where two come to the same one.

        Args:
            target: The target in place of each one, per scenario.
        """
        found: dict[tuple[int, int], Tried] = {}
        for scenario in np.unique(self.scenario).tolist():
            for old, tried in self.on(scenario).items():
                key = scenario, int(target[scenario, old])
                found[key] = found.get(key, Tried()).plus(tried)
        return DeadEnds.of(found)
