"""Reach of each target by itself, independent of other targets: reachable, excluded with a reason, or undecided.

A target is reachable if a collision-free configuration was found at it. First, configurations are carried over from the
nearest reachable targets, re-anchored and pushed clear. If this fails, the target is searched at a coarse resolution
(`configuration_search`). Then proofs of exclusion are tried. Targets that are still undecided are searched at the
requested resolution.

At an excluded target every configuration is proven to collide (`motion.tool_cells`). The reason is the smallest set of
bodies that the proof needs (`motion.tool_cells`): none (out of reach), the tool, the link before it (wrist), or the
arm.
"""

import itertools
import threading
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from functools import partial
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float, Int

from htcp_jax.model import Scenario
from htcp_jax.motion import lane_inputs, tool_cells
from htcp_jax.reachability.configuration_search import CARRIED, ConfigurationSearch
from htcp_jax.reachability.memo import Memo, Pairs, compute_all
from htcp_jax.status import Exclusion

TOGETHER, SEARCHED = 64, 4  # numbers of targets per call, for carrying over and for searches
STEP_NAMES = {  # of the steps that may take long
    "carried": "carrying configurations over",
    "coarse": "coarse search",
    "proofs": "proofs of exclusion",
    "fine": "fine search",
}
COARSER = 4  # resolution of the first search, as a multiple of the requested resolution

Mapped = Callable[[Callable[[Pairs], tuple], Sequence[Pairs]], list[tuple]]  # map over chunks, by threads


class Reach(IntEnum):
    """Result for one target; stored as int8. Targets that are not on the path are NOT_JUDGED."""

    NOT_JUDGED = -1
    REACHABLE = 0
    OUT_OF_REACH = Exclusion.OUT_OF_REACH
    TOOL = Exclusion.TOOL
    WRIST = Exclusion.WRIST
    ARM = Exclusion.ARM
    UNDECIDED = 5

    @property
    def words(self) -> str:
        """The name as text, for files: "out of reach"."""
        return self.name.lower().replace("_", " ")

    @property
    def label(self) -> str:
        """The name for tables and pictures: "excluded: out of reach"."""
        is_excluded = Reach.REACHABLE < self < Reach.UNDECIDED
        return f"excluded: {self.words}" if is_excluded else self.words

    @property
    def message(self) -> str:
        """One-line description of the result."""
        return _MESSAGES[self] if self in _MESSAGES else f"excluded: {Exclusion(self).message}"


_MESSAGES = {
    Reach.NOT_JUDGED: "not on the path",
    Reach.REACHABLE: "a clear configuration was found",
    Reach.UNDECIDED: "no clear configuration was found, and no proof excludes one",
}


class EachTarget(NamedTuple):
    """Results for each of T targets in S scenarios."""

    reach: Int[np.ndarray, "S T"]  # numbers of `Reach`
    clearance_m: Float[np.ndarray, "S T"]  # largest clearance found at an undecided target, -inf if none; else NaN
    x: Float[np.ndarray, "S T N"]  # clear configuration, or the clearest if undecided [rad or m]; NaN: none found

    @property
    def first_excluded(self) -> Int[np.ndarray, "S"]:
        """Index of the first excluded target in each scenario; T if there is none."""
        is_excluded = (self.reach > Reach.REACHABLE) & (self.reach < Reach.UNDECIDED)
        return np.where(is_excluded.any(axis=1), is_excluded.argmax(axis=1), self.reach.shape[1])


class TargetJudge:
    """Classifies every target on the path by itself; the result does not depend on the chunk that a target is in.

    Args:
        search: The search for configurations.
        scenarios: S stacked scenarios.
        x: Known collision-free configurations [rad or m]; NaN elsewhere.
        seed: Seed of the random moves.
        mapped: Function that maps a function over chunks of targets.
        progress: Function that is called with the numbers of finished targets and of all targets of a step, and the
            step's name.
        memo: Results of an earlier, interrupted search.
    """

    def __init__(
        self,
        search: ConfigurationSearch,
        scenarios: Scenario,
        x: Float[np.ndarray, "S T N"],
        seed: int,
        mapped: Mapped,
        progress: Callable[[int, int, str], None],
        memo: Memo = compute_all,
    ):
        self._search, self._scenarios, self._seed = search, scenarios, seed
        self._mapped, self._progress, self._memo = mapped, progress, memo
        index = np.arange(scenarios.targets.shape[1])
        on_path = (index >= scenarios.on_path[:, None]) & (index < scenarios.count[:, None])
        self.x, self.clearance_m = np.where(on_path[..., None], x, np.nan), np.full(on_path.shape, -np.inf)
        self.reach = np.where(on_path, Reach.UNDECIDED, Reach.NOT_JUDGED).astype(np.int8)
        self.reach[~np.isnan(self.x).any(axis=2)] = Reach.REACHABLE

    def judge(self, resolution_rad: float, proof_cells: int) -> EachTarget:
        """Classify the targets.

        Args:
            resolution_rad: Resolution of the tool's orientations.
            proof_cells: Maximum number of cells per proof, see `motion.tool_cells.excluded`; 0: no proofs.
        """
        self._carry_over("carried")
        if self._search.checker.task.holds_tcp:
            self._search_open("coarse", COARSER * resolution_rad)
            self._carry_over("carried after coarse")
        if proof_cells:
            self._each("proofs", partial(self._excluded, proof_cells), self._open(), TOGETHER // 4)
        self._search_open("fine", resolution_rad)
        self._carry_over("carried after fine")
        is_open = self.reach == Reach.UNDECIDED
        known_at = (self.reach == Reach.REACHABLE) | (is_open & (self.clearance_m > -np.inf))
        clearance_m, x = np.where(is_open, self.clearance_m, np.nan), np.where(known_at[..., None], self.x, np.nan)
        return EachTarget(self.reach, clearance_m, x)

    def _carry_over(self, step: str) -> None:
        """Carry configurations over from the nearest reachable targets until no further target is reached."""
        tried: dict[tuple[int, int], tuple[int, ...]] = {}
        for number in itertools.count():
            near = {pair: own for pair, own in self._nearest().items() if tried.get(pair) != own}
            if not near:
                return
            tried |= near
            before = (self.reach == Reach.REACHABLE).sum()
            self._each(f"{step}, {number}", partial(self._carried, near), np.array(list(near)), TOGETHER)
            if (self.reach == Reach.REACHABLE).sum() == before:
                return

    def _search_open(self, step: str, resolution_rad: float) -> None:
        """Search the undecided targets at a resolution of the tool's orientations."""
        self._each(step, partial(self._searched, resolution_rad), self._open(), SEARCHED)

    def _open(self) -> Pairs:
        return np.argwhere(self.reach == Reach.UNDECIDED)

    def _each(self, step: str, function: Callable[[Pairs], tuple], pairs: Pairs, together: int) -> None:
        """Store the results of a function at pairs: the reach and, if clearer, a configuration and its clearance."""
        chunks = [pairs[first : first + together] for first in range(0, len(pairs), together)]
        finished, lock = list[int](), threading.Lock()
        name = STEP_NAMES.get(step, STEP_NAMES["carried"])
        if chunks:
            self._progress(0, len(pairs), name)

        def work(own: Pairs) -> None:
            compute = lambda which: np.column_stack(function(own[which]))  # noqa: E731
            results = self._memo(f"each, {step}", own, 2 + self.x.shape[2], compute)
            reach, clearance_m, x = results[:, 0], results[:, 1], results[:, 2:]
            at = tuple(own.T)
            better = (reach == Reach.REACHABLE) | (clearance_m > self.clearance_m[at])
            self.reach[at], self.x[at] = reach, np.where(better[:, None], x, self.x[at])
            self.clearance_m[at] = np.where(better, clearance_m, self.clearance_m[at])
            with lock:
                finished.append(len(own))
                self._progress(sum(finished), len(pairs), name)

        self._mapped(work, chunks)

    def _inputs(self, pairs: Pairs) -> lane_inputs.LaneInputs:
        return lane_inputs.lane_inputs(self._scenarios, *pairs.T, seed=self._seed)

    def _nearest(self) -> dict[tuple[int, int], tuple[int, ...]]:
        """Return undecided pair -> nearest reachable targets, for scenarios with reachable targets."""
        found = {}
        for s in np.unique(self._open()[:, 0]).tolist():
            reached, left = (np.flatnonzero(self.reach[s] == one) for one in (Reach.REACHABLE, Reach.UNDECIDED))
            if not len(reached):
                continue
            targets = self._scenarios.targets[s]
            near = scipy.spatial.cKDTree(targets[reached]).query(
                targets[left], k=range(1, min(CARRIED, len(reached)) + 1)
            )[1]
            found |= {(s, t): tuple(own) for t, own in zip(left.tolist(), reached[near].tolist(), strict=True)}
        return found

    def _carried(self, near: Mapping[tuple[int, int], tuple[int, ...]], pairs: Pairs) -> tuple:
        beam = [self.x[s, list(near[s, t])] for s, t in pairs.tolist()]
        return self._reached(pairs, self._search.carried(self._inputs(pairs), beam))

    def _searched(self, resolution_rad: float, pairs: Pairs) -> tuple:
        inputs = self._inputs(pairs)
        here = self._search.search(inputs, resolution_rad).at
        reach, _, x = self._reached(pairs, self._search.searched(inputs, here))
        is_reached = reach == Reach.REACHABLE
        return reach, here.clearance[:, 0], np.where(is_reached[:, None], x, here.x[:, 0])

    def _reached(self, pairs: Pairs, clear: Sequence[Float[np.ndarray, "_ N"]]) -> tuple:
        x = np.stack([own[0] if len(own) else np.full(self.x.shape[2], np.nan) for own in clear])
        found = ~np.isnan(x).any(axis=1)
        return np.where(found, Reach.REACHABLE, Reach.UNDECIDED), np.where(found, np.inf, -np.inf), x

    def _excluded(self, cells: int, pairs: Pairs) -> tuple:
        executor, robot = self._search.checker.executor, self._search.robot
        found = tool_cells.exclusions(executor, robot, self._inputs(pairs), cells)
        reach = np.where(found == Exclusion.NONE, Reach.UNDECIDED, found)
        return reach, np.full(len(pairs), -np.inf), np.full((len(pairs), self.x.shape[2]), np.nan)
