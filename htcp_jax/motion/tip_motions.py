"""Motions of the tool's bare tip along straight joint paths: those on which it passes through a wall.

The tip is checked at PLACES - 1 places of a path, and if it may travel more than TIP_STEP_M in between, also at as many
places as this step requires. Paths are divided into shorter and shorter intervals, and only places in intervals in
which the tip may pass through a wall are tested: both ends of the tip stay near the lines between their positions at an
interval's ends. The walls that may be passed through are known from the longer interval.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.clearance.obstacles import NearWalls, TipGuard
from htcp_jax.device import Executor, tables
from htcp_jax.model import kinematics
from htcp_jax.motion.lane_inputs import LaneInputs
from htcp_jax.motion.step_functions import TIP
from htcp_jax.numerics import ragged_rows

PLACES = 100  # number of equal intervals of a path at whose ends the tip is checked
PARTS = 1, 4, 5, 5  # numbers of parts into which intervals are divided, to 1 / PLACES of a path
TIP_STEP_M = 0.5e-3  # largest travel of the tip between two places
FEW = 4  # number of these steps in an interval that is not divided further


class Intervals(NamedTuple):
    """Intervals of paths in which the tip may pass through a wall."""

    path: Int[np.ndarray, "n"]  # row of the path
    whole: Int[np.ndarray, "n"]  # number of steps of the path, the unit of `begin` and `end`
    begin: Int[np.ndarray, "n"]
    end: Int[np.ndarray, "n"]
    tips: Float[np.ndarray, "n 2 2 3"]  # both ends of the tip at `begin` and at `end` [m]


class TipMotions:
    """Motions of the bare tip along n straight joint paths from a to b [rad or m]."""

    def __init__(
        self,
        executor: Executor,
        guard: TipGuard,
        bounds: kinematics.TipBounds,
        inputs: LaneInputs,
        a: Float[np.ndarray, "n N"],
        b: Float[np.ndarray, "n N"],
    ):
        self._executor, self._guard, self._is_rigid = executor, guard, bounds.is_rigid
        self._inputs, self._a, self._b = inputs, a, b
        bounds, moves = bounds.between(a, b), (bounds.turned(b - a), np.abs(inputs.tool_extension_m))
        self._steps = np.ceil(bounds.travel_m(*moves) / TIP_STEP_M).astype(int)
        self._bulge_m = bounds.bulge_m(*moves)

    def passing(self) -> Int[np.ndarray, "k"]:
        """Return the paths on which the tip passes through a wall."""
        path = np.arange(len(self._a))
        now, near = self._intervals(path, np.full_like(path, PLACES), path * 0, np.full_like(path, PLACES)), None
        for parts in PARTS:
            now, near = self._divided(now, near, parts)
            if not len(now.path):
                return now.path
        found = self._passing_in(now, near)
        rest = ~np.isin(now.path, found) & (self._steps[now.path] > PLACES)
        now, near = tables.gather(now, rest), near.only(rest)
        steps = self._steps[now.path]
        now = self._intervals(now.path, steps, now.begin * steps // PLACES, -(-now.end * steps // PLACES))
        while (now.end - now.begin).max(initial=0) > FEW:
            now, near = self._divided(now, near, FEW)
        return np.append(found, self._passing_in(now, near))

    def _divided(self, now: Intervals, near: NearWalls | None, parts: int) -> tuple[Intervals, NearWalls]:
        """Return the parts of intervals in which the tip may pass through a wall, and these walls."""
        place = now.begin[:, None] + (now.end - now.begin)[:, None] * np.arange(parts + 1) // parts
        within = self._tips(now.path.repeat(parts - 1), place[:, 1:-1].ravel(), now.whole.repeat(parts - 1))
        within = within.reshape(len(place), parts - 1, 2, 3)
        tips = np.concatenate([now.tips[:, :1], within, now.tips[:, 1:]], axis=1)
        tips = np.stack([tips[:, :-1], tips[:, 1:]], axis=2).reshape(-1, 2, 2, 3)  # at both ends of each part
        path, whole = now.path.repeat(parts), now.whole.repeat(parts)
        now = Intervals(path, whole, place[:, :-1].ravel(), place[:, 1:].ravel(), tips)
        away = self._bulge_m[path] * ((now.end - now.begin) / whole) ** 2
        near = near and near.each(np.full(len(place), parts))
        near = self._guard.near_walls(tips, away, self._is_rigid, near)
        is_open = np.zeros(len(path), bool)
        is_open[near.tip] = True
        return tables.gather(now, is_open), near.only(is_open)

    def _intervals(
        self,
        path: Int[np.ndarray, "n"],
        whole: Int[np.ndarray, "n"],
        begin: Int[np.ndarray, "n"],
        end: Int[np.ndarray, "n"],
    ) -> Intervals:
        """Return intervals with the tips at both ends."""
        tips = self._tips(path.repeat(2), np.stack([begin, end], axis=1).ravel(), whole.repeat(2))
        return Intervals(path, whole, begin, end, tips.reshape(-1, 2, 2, 3))

    def _passing_in(self, now: Intervals, near: NearWalls) -> Int[np.ndarray, "k"]:
        """Return the paths on which the tip passes through a wall at a place in an interval, but the path's ends."""
        begin, end = np.maximum(now.begin, 1), np.minimum(now.end, now.whole - 1)
        counts = end - begin + 1
        row, nth = ragged_rows(counts)
        if not len(row):
            return row
        tips = self._tips(now.path[row], begin[row] + nth, now.whole[row])
        return np.unique(now.path[row[self._guard.passes(tips[:, 0], tips[:, 1], near.each(counts))]])

    def _tips(
        self, path: Int[np.ndarray, "m"], place: Int[np.ndarray, "m"], whole: Int[np.ndarray, "m"]
    ) -> Float[np.ndarray, "m 2 3"]:
        """Return the tip's ends [m] at places on paths."""
        if not len(path):
            return np.zeros((0, 2, 3))
        x = self._a[path] + (place / whole)[:, None] * (self._b[path] - self._a[path])
        return self._executor(TIP, tables.gather(self._inputs, path), x)
