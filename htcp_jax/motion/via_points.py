"""Via points: configurations on a segment between two rows of a plan that is not one straight joint path.

On the path, the tool is at a share of the way from the previous target to the segment's target at each via point.
Between via points with equal shares the tool stays at one place while the arm changes its configuration. Otherwise the
tool moves along the line, see `planning.inserted_goals`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int


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
        found = [(new, np.flatnonzero(self.scenario == old)) for new, old in enumerate(which.tolist())]
        picked = np.concatenate([rows for _, rows in found]).astype(int)
        numbers = np.repeat([new for new, _ in found], [len(rows) for _, rows in found])
        return ViaPoints(numbers.astype(np.int32), self.target[picked], self.x[picked], self.share[picked])

    def on_segment(self, scenario: int, target: int) -> Float[np.ndarray, "k N"]:
        """Return the via points on the segment to one target."""
        return self.x[self._rows_of(scenario, target)]

    def shares_on(self, scenario: int, target: int) -> Float[np.ndarray, "k"]:
        """Return the shares of the via points on the segment to one target."""
        return self.share[self._rows_of(scenario, target)]

    def _rows_of(self, scenario: int, target: int) -> Int[np.ndarray, "k"]:
        first, last = np.searchsorted(self.scenario, np.array([scenario, scenario + 1], self.scenario.dtype))
        return first + np.flatnonzero(self.target[first:last] == target)
