"""Evaluation of mountings: each is planned with every seam, by one planner, as the scenarios of a sweep.

A mounting is complete if a proven motion leads to the end of every seam. A planner only keeps the margin that it is
given and does not maximise clearance. So a complete mounting is planned again with a larger margin, as long as that
succeeds (`evaluate_raised`).

Results are on disk like those of any sweep, shard by shard, and are read if they exist. So a killed search resumes from
there, and results do not depend on the machine that plans them.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.jobs import grid as grids
from htcp_jax.motion import Plans
from htcp_jax.placement.place_file import CLEARANCE, Search
from htcp_jax.runs import Run

MARGIN = "margin_m"
# Settings of the quick plans: fewer configurations at a target, no smoothing.
QUICK = ("settings.smooth=false", "settings.beam_width=16", "settings.min_beam_width=4", "settings.self_motions=8")
RAISED, FACTOR = 3, 3.0  # largest number of raises of a margin, and the next margin over the guaranteed clearance
# Plans a grid by a method into a folder, or resumes it, and times it if the cycle time is an objective.
Planner = Callable[[grids.Sweep, str, Path], Run]


class MountingScores:
    """Results of one method for n mountings with k seams.

    Args:
        search: The search.
        run: The run that holds the plans.
        method: The method.
        values: Parameters of the mountings, each in its unit in the job.
        quick: True for quick plans, whose proofs of clearance are coarse.
        plans: The plans, in place of the run's.
    """

    def __init__(
        self,
        search: Search,
        run: Run,
        method: str,
        values: Float[np.ndarray, "n d"],
        *,
        quick: bool = False,
        plans: Plans | None = None,
    ):
        self.search, self.run, self.method, self.values, self.quick = search, run, method, values, quick
        self.seams = max(1, len(search.seams))
        if plans is not None:
            self.plans = plans

    @cached_property
    def plans(self) -> Plans:
        """Plans, one row per mounting and seam, the seam moving fastest."""
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
        """Each objective's value in the worst seam; -inf if the mounting is not complete or the value is unknown."""
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

    def lost(self) -> list[str]:
        """Reason why each mounting is not complete, by its worst seam; empty if it is complete."""
        ends, worst = self.plans.outcomes, self.done.argmin(axis=1)
        rows = np.arange(len(self.values)) * self.seams + worst
        found = [ends.of(row) for row in rows.tolist()]
        return ["" if end.can_be_driven else end.reason for end in found]


def sweep_of(
    search: Search,
    values: Float[np.ndarray, "n d"],
    margin_m: Float[np.ndarray, "n"] | None = None,
    settings: Sequence[str] = (),
) -> grids.Sweep:
    """Build a sweep over mountings and seams.

    Each scenario draws the same random numbers as a job that is planned alone.

    Args:
        search: The search.
        values: Parameters of the mountings, each in its unit in the job.
        margin_m: Margin of each mounting; None: the job's.
        settings: Overrides of the job, applied before the search's own.

    Raises:
        InputError: For values that the job refuses.
    """
    first: dict[str, Any] = search.ranges.columns(values)
    if margin_m is not None:
        first[MARGIN] = margin_m.tolist()
    grid = [first, {"workpiece.path": list(search.seams)}] if search.seams else [first]
    return replace(grids.load_sweep({"grid": grid}, search.config, (*settings, *search.overrides)), alone=True)


def evaluate(
    search: Search,
    plan: Planner,
    values: Float[np.ndarray, "n d"],
    method: str,
    folder: Path,
    margin_m: Float[np.ndarray, "n"] | None = None,
    settings: Sequence[str] = (),
) -> MountingScores:
    """Plan mountings, resume planning them, or read their plans from the folder.

    Args:
        search: The search.
        plan: The planner of the sweep.
        values: Parameters of the mountings, each in its unit in the job.
        method: The method.
        folder: The run folder.
        margin_m: Margin of each mounting; None: the job's.
        settings: Overrides of the job that make the plans quick; empty: none.

    Raises:
        InputError: As `runs.sweep.sweep`.
        Interrupted: As `runs.sweep.sweep`.
    """
    run = plan(sweep_of(search, values, margin_m, settings), method, folder)
    return MountingScores(search, run, method, values, quick=bool(settings))


def evaluate_raised(
    search: Search, plan: Planner, values: Float[np.ndarray, "n d"], folder: Path, raised: Path
) -> MountingScores:
    """Plan mountings quickly and return the plans with the largest margin that was found.

    The first margin is the job's. If clearance is an objective, complete mountings are planned again with larger
    margins as long as they stay complete.

    Args:
        search: The search.
        plan: The planner of the sweeps.
        values: Parameters of the mountings, each in its unit in the job.
        folder: The folder of the first plans.
        raised: The folder of the plans with larger margins.
    """
    found = evaluate(search, plan, values, search.file.screen, folder, settings=QUICK)
    going = found.complete if CLEARANCE in search.file.objective else np.zeros(len(values), bool)
    for k in range(RAISED):
        if not going.any():
            break
        margin = np.maximum(FACTOR * found.guaranteed, search.job.margin_m)[going]
        again = evaluate(search, plan, values[going], search.file.screen, raised / f"{folder.name}-{k}", margin, QUICK)
        found, going = _with_better(found, again, going)
    return found


def evaluate_lowered(
    search: Search,
    plan: Planner,
    values: Float[np.ndarray, "n d"],
    folder: Path,
    margins: Sequence[Float[np.ndarray, "n"]],
) -> MountingScores:
    """Plan mountings quickly with smaller and smaller margins until they are complete.

    Args:
        search: The search.
        plan: The planner of the sweeps.
        values: Parameters of the mountings, each in its unit in the job.
        folder: The folder of the sweeps, one per margin.
        margins: Margins in the order in which they are tried, each for all mountings [m]; the job's comes last.
    """
    least = np.full(len(values), search.job.margin_m)
    found, missing = None, np.ones(len(values), bool)
    for k, margin in enumerate([*margins, least]):
        if not missing.any():
            break
        own = np.maximum(margin, least)[missing]
        again = evaluate(search, plan, values[missing], search.file.screen, folder / str(k), own, QUICK)
        found = again if found is None else _with_better(found, again, missing)[0]
        missing = ~found.complete
    return found


def _with_better(
    found: MountingScores, again: MountingScores, which: Bool[np.ndarray, "n"]
) -> tuple[MountingScores, Bool[np.ndarray, "n"]]:
    """Put complete results of `again`, which planned the mask `which`, into `found`; return it and their mask."""
    new = which.copy()
    new[which] = again.complete
    row = np.arange(len(which) * found.seams).reshape(-1, found.seams)
    row[new] = row.size + np.arange(which.sum() * found.seams).reshape(-1, found.seams)[again.complete]
    plans = Plans.concatenate([found.plans, again.plans]).rows(row.ravel())
    return MountingScores(found.search, found.run, found.method, found.values, quick=True, plans=plans), new


def _clearance_objective(scores: MountingScores) -> np.ndarray:
    """Guaranteed clearance along the motions [m]; of quick plans, whose proofs are coarse, that at the targets."""
    return _at_targets(scores.plans) if scores.quick else _minimum_along(scores.plans)


def _minimum_along(plans: Plans) -> np.ndarray:
    """Minimum guaranteed clearance over the segments to executable targets of each plan [m]; inf if there are none."""
    return np.where(plans.executable, plans.segment_clearance, np.inf).min(axis=1)


def _at_targets(plans: Plans) -> np.ndarray:
    """Minimum clearance of each plan at a tracked target [m]; inf if there are none."""
    return np.where(plans.tracked, plans.clearance, np.inf).min(axis=1)


def _cycle_time(scores: MountingScores) -> np.ndarray:
    """Negative cycle time [s]; -inf if there is no motion to time."""
    rows = scores.run.timing(scores.method).timed
    times = np.full(len(scores.plans.status), -np.inf)
    times[rows["scenario"].to_numpy()] = -rows["cycle_time_s"].to_numpy()
    return times


def _joint_motion(scores: MountingScores) -> np.ndarray:
    """Negative joint motion along the path [rad]."""
    plans = scores.plans
    return -np.nansum(np.where(plans.tracked, plans.joint_step, 0.0), axis=1)


OBJECTIVE_VALUES = {CLEARANCE: _clearance_objective, "cycle time": _cycle_time, "joint motion": _joint_motion}
