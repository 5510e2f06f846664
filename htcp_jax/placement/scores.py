"""Evaluation of mountings: a sweep plans every seam at every mounting by one method.

A mounting is complete if a proven motion leads to the end of every seam. A planning method does not maximise clearance,
it only satisfies the margin. Complete mountings are therefore planned again with larger margins, as long as they stay
complete (`MountingPlanner.evaluate_raised`).

Results are saved shard by shard, as in any sweep, and are read if they exist, so an interrupted search can be resumed.
They do not depend on the machine that plans them.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.jobs import Sweep, load_sweep
from htcp_jax.motion import Plans
from htcp_jax.placement.clock import TimeOver
from htcp_jax.placement.place_file import CLEARANCE, Search
from htcp_jax.runs import Run

MARGIN = "margin_m"
# Settings of the quick plans: a narrower beam, no smoothing.
QUICK = ("settings.smooth=false", "settings.beam_width=16", "settings.min_beam_width=4", "settings.self_motions=8")
RAISED, FACTOR = 3, 3.0  # maximum number of larger margins; next margin / guaranteed clearance
# Function (sweep, method, folder) that plans or resumes a sweep, and times it if the cycle time is an objective.
Planner = Callable[[Sweep, str, Path], Run]


class MountingScores:
    """Results of one method for n mountings with k seams.

    Args:
        search: The search.
        run: The run with the plans.
        method: The method.
        values: Parameters of the mountings, each in its unit in the job.
        quick: True for quick plans, whose proofs of clearance are coarse.
        margin_m: Margin of each mounting; None: the job's.
        plans: Plans that replace the run's; None: the run's.
        objective: Objectives that replace those of the plans; None: those of the plans.
    """

    def __init__(
        self,
        search: Search,
        run: Run,
        method: str,
        values: Float[np.ndarray, "n d"],
        *,
        quick: bool = False,
        margin_m: Float[np.ndarray, "n"] | None = None,
        plans: Plans | None = None,
        objective: Float[np.ndarray, "n A"] | None = None,
    ):
        self.search, self.run, self.method, self.values, self.quick = search, run, method, values, quick
        self.seams = max(1, len(search.seams))
        self.margin_m = np.full(len(values), search.job.margin_m) if margin_m is None else margin_m
        if plans is not None:
            self.plans = plans
        if objective is not None:
            self.objective = objective

    @staticmethod
    def concatenate(parts: "Sequence[MountingScores]") -> "MountingScores":
        """Return the scores of all parts, which have the same method; of the runs, it has the first."""
        first = parts[0]
        if len(parts) == 1:
            return first
        plans = Plans.concatenate([part.plans for part in parts])
        values, margin, objective = (
            np.concatenate([getattr(part, name) for part in parts]) for name in ("values", "margin_m", "objective")
        )
        known = {"quick": first.quick, "margin_m": margin, "plans": plans, "objective": objective}
        return MountingScores(first.search, first.run, first.method, values, **known)

    @cached_property
    def plans(self) -> Plans:
        """Plans of all mountings, n k rows; the rows of a mounting's seams are consecutive."""
        return self.run.plans(self.method)

    @cached_property
    def done(self) -> Float[np.ndarray, "n k"]:
        """Share of each seam's targets to which a proven motion leads."""
        ends = self.plans.outcomes
        return (ends.executable / np.maximum(ends.targets, 1)).reshape(-1, self.seams)

    @cached_property
    def complete(self) -> Bool[np.ndarray, "n"]:
        """True if a proven motion leads to the end of every seam."""
        return self.plans.outcomes.can_be_driven.reshape(-1, self.seams).all(axis=1)

    @cached_property
    def objective(self) -> Float[np.ndarray, "n A"]:
        """Each objective's value at the worst seam; -inf if the mounting is not complete or the value is unknown."""
        found = np.stack(
            [OBJECTIVE_VALUES[name](self).reshape(-1, self.seams).min(axis=1) for name in self.search.file.objective], 1
        )
        return np.where(self.complete[:, None], found, -np.inf)

    @cached_property
    def clearance(self) -> Float[np.ndarray, "n"]:
        """Minimum clearance at a tracked target, over all seams [m]."""
        return _at_targets(self.plans).reshape(-1, self.seams).min(axis=1)

    @cached_property
    def guaranteed(self) -> Float[np.ndarray, "n"]:
        """Guaranteed clearance along the motions, over all seams [m]."""
        return _minimum_along(self.plans).reshape(-1, self.seams).min(axis=1)

    def with_guaranteed_clearance(self) -> "MountingScores":
        """Return the scores with the guaranteed clearance as that objective also for quick plans."""
        objective = self.objective.copy()
        for k, name in enumerate(self.search.file.objective):
            if name == CLEARANCE:
                objective[:, k] = np.where(self.complete, self.guaranteed, -np.inf)
        known = {"quick": self.quick, "margin_m": self.margin_m, "plans": self.plans, "objective": objective}
        return MountingScores(self.search, self.run, self.method, self.values, **known)

    def lost(self) -> list[str]:
        """Return the reason why each mounting is not complete, taken from its worst seam; empty if it is complete."""
        ends, worst = self.plans.outcomes, self.done.argmin(axis=1)
        rows = np.arange(len(self.values)) * self.seams + worst
        found = [ends.of(row) for row in rows.tolist()]
        return ["" if end.can_be_driven else end.reason for end in found]


def sweep_of(
    search: Search,
    values: Float[np.ndarray, "n d"],
    margin_m: Float[np.ndarray, "n"] | None = None,
    settings: Sequence[str] = (),
) -> Sweep:
    """Return a sweep over mountings and seams; the rows of a mounting's seams are consecutive.

    Each scenario uses the same random numbers as if its job were planned alone.

    Args:
        search: The search.
        values: Parameters of the mountings, each in its unit in the job.
        margin_m: Margin of each mounting; None: the job's.
        settings: Overrides of the job, applied before the search's own.

    Raises:
        InputError: If a value is invalid in the job.
    """
    first: dict[str, Any] = search.ranges.columns(values)
    if margin_m is not None:
        first[MARGIN] = margin_m.tolist()
    return replace(load_sweep({"grid": [first]}, search.config, (*settings, *search.overrides)), alone=True)


class MountingPlanner(NamedTuple):
    """Plans the mountings of a search, or reads existing plans from a folder, and returns their scores.

    In all methods, `values` are the parameters of the mountings, each in its unit in the job.
    """

    search: Search
    plan: Planner

    def evaluate(
        self,
        values: Float[np.ndarray, "n d"],
        method: str,
        folder: Path,
        margin_m: Float[np.ndarray, "n"] | None = None,
        settings: Sequence[str] = (),
    ) -> MountingScores:
        """Plan by one method; the margins are the job's or, if given, `margin_m` [m].

        Args:
            values: The mountings.
            method: The method.
            folder: The run folder.
            margin_m: Margin of each mounting; None: the job's.
            settings: Overrides of the job that make planning quicker; empty: none.

        Raises:
            InputError: As `runs.sweep.sweep`.
            Interrupted: As `runs.sweep.sweep`.
        """
        run = self.plan(sweep_of(self.search, values, margin_m, settings), method, folder)
        return MountingScores(self.search, run, method, values, quick=bool(settings), margin_m=margin_m)

    def evaluate_quickly(
        self, values: Float[np.ndarray, "n d"], folder: Path, margin_m: Float[np.ndarray, "n"] | None = None
    ) -> MountingScores:
        """Plan by the search's quick method, with the settings QUICK."""
        return self.evaluate(values, self.search.file.screen, folder, margin_m, QUICK)

    def evaluate_raised(
        self, values: Float[np.ndarray, "n d"], folder: Path, raised: Path, fits: Callable[[int], bool] = lambda _: True
    ) -> MountingScores:
        """Plan mountings quickly and return the plans with the largest margin that was found.

        The first margin is the job's. If clearance is an objective, complete mountings are planned again with larger
        margins as long as they stay complete.

        Args:
            values: The mountings.
            folder: The folder of the first plans.
            raised: The folder of the plans with larger margins.
            fits: Function that returns False if there is no time for a number of plans with larger margins.
        """
        found = self.evaluate_quickly(values, folder)
        going = found.complete if CLEARANCE in self.search.file.objective else np.zeros(len(values), bool)
        for k in range(RAISED):
            if not going.any() or not fits(found.seams * int(going.sum())):
                break
            margin = np.maximum(FACTOR * found.guaranteed, self.search.job.margin_m)[going]
            try:
                again = self.evaluate_quickly(values[going], raised / f"{folder.name}-{k}", margin)
            except TimeOver:
                break
            found, going = _with_better(found, again, going)
        return found

    def evaluate_lowered(
        self, values: Float[np.ndarray, "n d"], folder: Path, margins: Sequence[Float[np.ndarray, "n"]]
    ) -> MountingScores:
        """Return scores of quick plans, in which smaller and smaller margins are tried until a mounting is complete.

        Args:
            values: The mountings.
            folder: The folder of the sweeps, one per margin.
            margins: Margins in the order in which they are tried, each for all mountings [m]; the job's comes last.
        """
        least = np.full(len(values), self.search.job.margin_m)
        found, missing = None, np.ones(len(values), bool)
        for k, margin in enumerate([*margins, least]):
            if not missing.any():
                break
            again = self.evaluate_quickly(values[missing], folder / str(k), np.maximum(margin, least)[missing])
            found = again if found is None else _with_better(found, again, missing)[0]
            missing = ~found.complete
        return found


def _with_better(
    found: MountingScores, again: MountingScores, which: Bool[np.ndarray, "n"]
) -> tuple[MountingScores, Bool[np.ndarray, "n"]]:
    """Return `found` with results replaced by complete ones in `again`, and the mask of the replaced mountings.

    Args:
        found: Scores of n mountings.
        again: Scores of the mountings in `which`, planned with other margins.
        which: Mask of the mountings in `again`.
    """
    new = which.copy()
    new[which] = again.complete
    row = np.arange(len(which) * found.seams).reshape(-1, found.seams)
    row[new] = row.size + np.arange(which.sum() * found.seams).reshape(-1, found.seams)[again.complete]
    plans, margin = Plans.concatenate([found.plans, again.plans]).rows(row.ravel()), found.margin_m.copy()
    margin[new] = again.margin_m[again.complete]
    known = {"quick": True, "plans": plans, "margin_m": margin}
    return MountingScores(found.search, found.run, found.method, found.values, **known), new


def _clearance_objective(scores: MountingScores) -> np.ndarray:
    """Return the guaranteed clearance along the motions [m]; for quick plans, the clearance at the targets."""
    return _at_targets(scores.plans) if scores.quick else _minimum_along(scores.plans)


def _minimum_along(plans: Plans) -> np.ndarray:
    """Return each plan's minimum guaranteed clearance over the segments to executable targets [m]; inf if none."""
    return np.where(plans.executable, plans.segment_clearance, np.inf).min(axis=1)


def _at_targets(plans: Plans) -> np.ndarray:
    """Return each plan's minimum clearance at its tracked targets [m]; inf if there are none."""
    return np.where(plans.tracked, plans.clearance, np.inf).min(axis=1)


def _cycle_time(scores: MountingScores) -> np.ndarray:
    """Return the negated cycle time [s]; -inf if there is no motion to time."""
    rows = scores.run.timing(scores.method).timed
    times = np.full(len(scores.plans.status), -np.inf)
    times[rows["scenario"].to_numpy()] = -rows["cycle_time_s"].to_numpy()
    return times


def _joint_motion(scores: MountingScores) -> np.ndarray:
    """Return the negated joint motion along the path [rad]."""
    plans = scores.plans
    return -np.nansum(np.where(plans.tracked, plans.joint_step, 0.0), axis=1)


OBJECTIVE_VALUES = {CLEARANCE: _clearance_objective, "cycle time": _cycle_time, "joint motion": _joint_motion}
