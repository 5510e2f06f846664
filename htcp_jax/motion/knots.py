"""Postures that an arm passes on its way from one row of a plan to the next, where that is no straight joint path."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Knots(NamedTuple):
    """Of S scenarios; in the order in which they are passed, scenario by scenario and target by target."""

    scenario: Int[np.ndarray, "n"]  # its row in the plans
    target: Int[np.ndarray, "n"]  # to which the way leads
    x: Float[np.ndarray, "n N"]  # [rad or m]

    @classmethod
    def none(cls, joints: int) -> "Knots":
        """Every way is a straight joint path."""
        return cls(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros((0, joints)))

    @classmethod
    def of(cls, ways: Sequence[tuple[int, int, Float[np.ndarray, "_ N"]]], joints: int) -> "Knots":
        """Of (scenario, target, postures), in any order."""
        if not ways:
            return cls.none(joints)
        ways = sorted(ways, key=lambda way: way[:2])
        scenario, target = (np.repeat([way[k] for way in ways], [len(way[2]) for way in ways]) for k in (0, 1))
        return cls(scenario.astype(np.int32), target.astype(np.int32), np.concatenate([way[2] for way in ways]))

    @classmethod
    def concatenate(cls, parts: "Sequence[Knots]", rows: Sequence[int]) -> "Knots":
        """Of plans that are put one after the other; rows: how many scenarios each has."""
        first = np.concatenate([[0], np.cumsum(rows)[:-1]]).astype(np.int32)
        moved = [part._replace(scenario=part.scenario + before) for part, before in zip(parts, first, strict=True)]
        return cls(*(np.concatenate(column) for column in zip(*moved, strict=True)))

    def rows(self, which: Int[np.ndarray, "R"]) -> "Knots":
        """Those of some scenarios, by their rows; they are numbered as they are asked for."""
        if not len(self.scenario) or not len(which):
            return Knots.none(self.x.shape[1])
        found = [(new, np.flatnonzero(self.scenario == old)) for new, old in enumerate(which.tolist())]
        picked = np.concatenate([rows for _, rows in found]).astype(int)
        numbers = np.repeat([new for new, _ in found], [len(rows) for _, rows in found])
        return Knots(numbers.astype(np.int32), self.target[picked], self.x[picked])

    def on_the_way(self, scenario: int, target: int) -> Float[np.ndarray, "k N"]:
        """Those on the way to one target."""
        first, last = np.searchsorted(self.scenario, np.array([scenario, scenario + 1], self.scenario.dtype))
        return self.x[first:last][self.target[first:last] == target]
