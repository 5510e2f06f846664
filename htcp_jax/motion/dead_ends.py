"""Dead ends of plans: the targets at which a search found no successor, and the attempts to get past them."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from htcp_jax.status import Exclusion


class Tried(NamedTuple):
    """Counts of the attempts to get past one dead end, and the proof about its target."""

    searches: int = 0  # number of searches from configurations found at the lost target
    configurations: int = 0  # number of configurations sampled, extended or moved
    found: int = 0  # number of valid configurations at the lost target
    connected: int = 0  # number of `found` that were joined to the start or to another possible start
    wider: int = 0  # number of searches forwards from an earlier target, with a wider beam
    excluded: Exclusion = Exclusion.NONE  # reason why no configuration at the lost target is clear

    @property
    def description(self) -> str:
        """Return a description of the attempts in one line."""
        if self.excluded:
            return f"the target is excluded by proof: {self.excluded.message}; no search"
        connected = str(self.connected) if self.connected else "none"
        searches = f"{self.searches} search{'es' if self.searches != 1 else ''} backwards"
        searches += f", {self.wider} with a wider beam" if self.wider else ""
        work = f"{searches}, {self.configurations:,} configurations sampled or extended"
        found = f"{self.found} clear configuration{'s' if self.found != 1 else ''} found at the target"
        return f"{work}; {found}" + (f", {connected} connected" if self.found else "")

    def record(self) -> dict[str, int | str | None]:
        """Return the counts for a file, with the reason `excluded` as a text or None."""
        return self._asdict() | {"excluded": self.excluded.words if self.excluded else None}

    def plus(self, other: "Tried") -> "Tried":
        """Return the sum of both counts, with the reason `excluded` of one of them."""
        numbers = (a + b for a, b in zip(self[:-1], other[:-1], strict=True))
        return Tried(*numbers, self.excluded or other.excluded)


class DeadEnds(NamedTuple):
    """Table of n dead ends, sorted by scenario and target."""

    scenario: Int[np.ndarray, "n"]  # the scenario's row in the plans
    target: Int[np.ndarray, "n"]  # the lost target
    searches: Int[np.ndarray, "n"]  # see `Tried`, also for the next columns
    configurations: Int[np.ndarray, "n"]
    found: Int[np.ndarray, "n"]
    connected: Int[np.ndarray, "n"]
    wider: Int[np.ndarray, "n"]
    excluded: Int[np.ndarray, "n"]  # values of `Exclusion`

    @classmethod
    def of(cls, tried: Mapping[tuple[int, int], Tried]) -> "DeadEnds":
        """Return the table for a mapping (scenario, lost target) -> attempts."""
        rows = [(*key, *tried[key]) for key in sorted(tried)]
        return cls(*np.array(rows, np.int32).reshape(-1, len(cls._fields)).T)

    def rows(self, which: Int[np.ndarray, "R"]) -> "DeadEnds":
        """Return the dead ends of some scenarios, which are renumbered in the order of `which`."""
        found = [self.on(old) for old in which.tolist()]
        return DeadEnds.of({(new, t): tried for new, own in enumerate(found) for t, tried in own.items()})

    def on(self, scenario: int) -> dict[int, Tried]:
        """Return the attempts in one scenario: lost target -> attempts."""
        own = np.flatnonzero(self.scenario == scenario)
        rows = {int(self.target[k]): [int(column[k]) for column in self[2:]] for k in own}
        return {target: Tried(*numbers, Exclusion(reason)) for target, (*numbers, reason) in rows.items()}

    def moved(self, target: Int[np.ndarray, "S R"]) -> "DeadEnds":
        """Return the dead ends with other numbers of targets; attempts with the same new number are added up.

        Args:
            target: New number of each target: target[s, r] for target r of scenario s.
        """
        found: dict[tuple[int, int], Tried] = {}
        for scenario in np.unique(self.scenario).tolist():
            for old, tried in self.on(scenario).items():
                key = scenario, int(target[scenario, old])
                found[key] = found.get(key, Tried()).plus(tried)
        return DeadEnds.of(found)
