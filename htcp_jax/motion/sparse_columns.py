"""Columns of plans that few targets have: via points, and attempts to get past dead ends.

A via point is a configuration on a segment between two rows of a plan that is not one straight joint path. On the path,
the tool is at a share of the way from the previous target to the segment's target at each via point. Between via points
with equal shares the tool stays at one place while the arm changes its configuration. Otherwise the tool moves along
the line, see `planning.inserted_goals`.

A dead end is a target at which a search found no successor.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.status import Exclusion


class ViaPoints(NamedTuple):
    """Table of n via points, sorted by scenario and target, on each segment in the order of the motion."""

    scenario: Int[np.ndarray, "n"]  # the scenario's row in the plans
    target: Int[np.ndarray, "n"]  # target at the end of the segment
    x: Float[np.ndarray, "n N"]  # [rad or m]
    share: Float[np.ndarray, "n"]  # share of the way from the previous target [1]; 0: at the previous target

    @property
    def stays(self) -> Bool[np.ndarray, "n"]:
        """True for via points to which the arm moves while the tool stays at one place."""
        same = (np.diff(self.scenario, prepend=-1) == 0) & (np.diff(self.target, prepend=-1) == 0)
        return self.share == np.where(same, np.append(0.0, self.share[:-1]), 0.0)[: len(self.share)]

    @classmethod
    def none(cls, joints: int) -> "ViaPoints":
        """Return an empty table: every segment is a straight joint path."""
        return cls(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros((0, joints)), np.zeros(0))

    @classmethod
    def of(cls, segments: Sequence[tuple], joints: int) -> "ViaPoints":
        """Return the table for segments (scenario, target, configurations), given in any order.

        A fourth entry of such a tuple has the shares; by default the tool stays at the previous target.
        """
        if not segments:
            return cls.none(joints)
        segments = sorted(segments, key=lambda segment: segment[:2])
        scenario, target = (
            np.repeat([segment[k] for segment in segments], [len(segment[2]) for segment in segments]) for k in (0, 1)
        )
        x = np.concatenate([segment[2] for segment in segments])
        share = [segment[3] if len(segment) > 3 else np.zeros(len(segment[2])) for segment in segments]
        return cls(scenario.astype(np.int32), target.astype(np.int32), x, np.concatenate(share))

    def rows(self, which: Int[np.ndarray, "R"]) -> "ViaPoints":
        """Return the via points of some scenarios, which are renumbered in the order of `which`."""
        if not len(self.scenario) or not len(which):
            return ViaPoints.none(self.x.shape[1])
        first, last = (np.searchsorted(self.scenario, which, side) for side in ("left", "right"))
        numbers = np.repeat(np.arange(len(which), dtype=np.int32), last - first)
        before = np.cumsum(last - first) - (last - first)  # via points of the scenarios before each one
        picked = np.arange(len(numbers)) + np.repeat(first - before, last - first)
        return ViaPoints(numbers, self.target[picked], self.x[picked], self.share[picked])

    def counts(self, scenario: Int[np.ndarray, "n"], target: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
        """Return the number of via points on each of n segments."""
        width = 1 + max(self.target.max(initial=0), target.max(initial=0))
        own, places = self.scenario.astype(int) * width + self.target, scenario * width + target
        return np.searchsorted(own, places, "right") - np.searchsorted(own, places)

    def on_segment(self, scenario: int, target: int) -> Float[np.ndarray, "k N"]:
        """Return the via points on the segment to one target."""
        return self.x[self._rows_of(scenario, target)]

    def shares_on(self, scenario: int, target: int) -> Float[np.ndarray, "k"]:
        """Return the shares of the via points on the segment to one target."""
        return self.share[self._rows_of(scenario, target)]

    def _rows_of(self, scenario: int, target: int) -> Int[np.ndarray, "k"]:
        first, last = np.searchsorted(self.scenario, np.array([scenario, scenario + 1], self.scenario.dtype))
        return first + np.flatnonzero(self.target[first:last] == target)


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
