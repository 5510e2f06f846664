"""Via points: configurations between two rows of a plan that are not joined by a straight joint path."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class ViaPoints(NamedTuple):
    """Via points of S scenarios, in the order in which they are passed, sorted by scenario and target."""

    scenario: Int[np.ndarray, "n"]  # its row in the plans
    target: Int[np.ndarray, "n"]  # end of the segment
    x: Float[np.ndarray, "n N"]  # [rad or m]

    @classmethod
    def none(cls, joints: int) -> "ViaPoints":
        """Return no via points: every segment is a straight joint path."""
        return cls(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros((0, joints)))

    @classmethod
    def of(cls, segments: Sequence[tuple[int, int, Float[np.ndarray, "_ N"]]], joints: int) -> "ViaPoints":
        """Return via points from (scenario, target, configurations), in any order."""
        if not segments:
            return cls.none(joints)
        segments = sorted(segments, key=lambda segment: segment[:2])
        scenario, target = (
            np.repeat([segment[k] for segment in segments], [len(segment[2]) for segment in segments]) for k in (0, 1)
        )
        return cls(
            scenario.astype(np.int32), target.astype(np.int32), np.concatenate([segment[2] for segment in segments])
        )

    @classmethod
    def concatenate(cls, parts: "Sequence[ViaPoints]", rows: Sequence[int]) -> "ViaPoints":
        """Concatenate the via points of consecutive plans.

        Args:
            parts: The via points of each.
            rows: Number of scenarios in each.
        """
        first = np.concatenate([[0], np.cumsum(rows)[:-1]]).astype(np.int32)
        moved = [part._replace(scenario=part.scenario + before) for part, before in zip(parts, first, strict=True)]
        return cls(*(np.concatenate(column) for column in zip(*moved, strict=True)))

    def rows(self, which: Int[np.ndarray, "R"]) -> "ViaPoints":
        """Select scenarios by their rows, renumbered in the order of `which`."""
        if not len(self.scenario) or not len(which):
            return ViaPoints.none(self.x.shape[1])
        found = [(new, np.flatnonzero(self.scenario == old)) for new, old in enumerate(which.tolist())]
        picked = np.concatenate([rows for _, rows in found]).astype(int)
        numbers = np.repeat([new for new, _ in found], [len(rows) for _, rows in found])
        return ViaPoints(numbers.astype(np.int32), self.target[picked], self.x[picked])

    def on_segment(self, scenario: int, target: int) -> Float[np.ndarray, "k N"]:
        """Return the via points on the segment to one target."""
        first, last = np.searchsorted(self.scenario, np.array([scenario, scenario + 1], self.scenario.dtype))
        return self.x[first:last][self.target[first:last] == target]
