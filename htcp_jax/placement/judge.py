"""Mountings, judged: each is planned with every seam, by one planner, as the scenarios of a sweep.

A mounting is complete if a proven motion leads to the end of every seam. How much clearance there is, no planner says
by itself: it keeps the margin that it is given. So a complete mounting is planned again with a larger margin, as long
as that succeeds (`judge_raised`).

What is judged is on disk as any sweep is, shard by shard. Asked for again it is read, so a search that was killed goes
on from there, and where it is planned has no influence on it.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.jobs.grid import Sweep, load_sweep
from htcp_jax.motion.plans import Plans
from htcp_jax.placement.place_file import CLEARANCE, Search
from htcp_jax.runs.run_folder import Run

MARGIN = "margin_m"
# Settings of the plans that judge and perturb mountings: fewer configurations at a target, no smoothing.
QUICK = ("settings.smooth=false", "settings.front=16", "settings.thin_front=4", "settings.walks=8")
RAISED, FACTOR = 3, 3.0  # how often a margin is raised at most, and by what over the clearance that was proven
# Plans a grid by a method into a folder, or goes on with it, and gives it time where the cycle time is an aim.
Planner = Callable[[Sweep, str, Path], Run]


class Judged:
    """n mountings with k seams by one method. Larger is better in all that is spare."""

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
        """A row a mounting and seam, the seam moving fastest."""
        return self.run.plans(self.method)

    @cached_property
    def done(self) -> Float[np.ndarray, "n k"]:
        """Share of each seam's targets to which a proven motion leads."""
        ends = self.plans.outcomes
        return (ends.executable / np.maximum(ends.targets, 1)).reshape(-1, self.seams)

    @cached_property
    def complete(self) -> Bool[np.ndarray, "n"]:
        """True where a proven motion leads to the end of every seam."""
        return self.plans.outcomes.can_be_driven.reshape(-1, self.seams).all(axis=1)

    @cached_property
    def spare(self) -> Float[np.ndarray, "n A"]:
        """Each aim's value in the worst seam; -inf where a mounting is not complete or nothing is known."""
        found = np.stack([AIMS[name](self).reshape(-1, self.seams).min(axis=1) for name in self.search.file.spare], 1)
        return np.where(self.complete[:, None], found, -np.inf)

    @cached_property
    def clearance(self) -> Float[np.ndarray, "n"]:
        """Minimum clearance at a tracked target, over all seams [m]."""
        return _at_targets(self.plans).reshape(-1, self.seams).min(axis=1)

    @cached_property
    def guaranteed(self) -> Float[np.ndarray, "n"]:
        """Clearance that is proven all along the motions, over all seams [m]."""
        return _along(self.plans).reshape(-1, self.seams).min(axis=1)

    def lost(self) -> list[str]:
        """Why each mounting is not complete, in words, by its worst seam; empty where it is."""
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
    """The grid of some mountings with every seam; each scenario draws the random numbers of a job planned by itself.

    margin_m: each one's own; None: the job's. settings: changes of the job that come before the search's own. Raises
    InputError for values that the job refuses."""
    first: dict[str, Any] = search.ranges.columns(values)
    if margin_m is not None:
        first[MARGIN] = margin_m.tolist()
    grid = [first, {"workpiece.path": list(search.seams)}] if search.seams else [first]
    return replace(load_sweep({"grid": grid}, search.config, (*settings, *search.overrides)), alone=True)


def judge(
    search: Search,
    plan: Planner,
    values: Float[np.ndarray, "n d"],
    method: str,
    folder: Path,
    margin_m: Float[np.ndarray, "n"] | None = None,
    settings: Sequence[str] = (),
) -> Judged:
    """Plan mountings, or go on with it, or read them. Raises InputError and Interrupted as `runs.sweep` does."""
    run = plan(sweep_of(search, values, margin_m, settings), method, folder)
    return Judged(search, run, method, values, quick=bool(settings))


def judge_raised(search: Search, plan: Planner, values: Float[np.ndarray, "n d"], folder: Path, raised: Path) -> Judged:
    """Mountings planned quickly with the job's margin, and again with larger ones as long as they stay complete, if
    clearance is an aim. The plans are those with the largest margin. raised: the folder of the later plans."""
    found = judge(search, plan, values, search.file.screen, folder, settings=QUICK)
    going = found.complete if CLEARANCE in search.file.spare else np.zeros(len(values), bool)
    for k in range(RAISED):
        if not going.any():
            break
        margin = np.maximum(FACTOR * found.guaranteed, search.job.margin_m)[going]
        again = judge(search, plan, values[going], search.file.screen, raised / f"{folder.name}-{k}", margin, QUICK)
        found, going = _better(found, again, going)
    return found


def judge_lowered(
    search: Search,
    plan: Planner,
    values: Float[np.ndarray, "n d"],
    folder: Path,
    margins: Sequence[Float[np.ndarray, "n"]],
) -> Judged:
    """Mountings planned quickly with each of some margins [m] until they are complete, at last with the job's."""
    least = np.full(len(values), search.job.margin_m)
    found, missing = None, np.ones(len(values), bool)
    for k, margin in enumerate([*margins, least]):
        if not missing.any():
            break
        own = np.maximum(margin, least)[missing]
        again = judge(search, plan, values[missing], search.file.screen, folder / str(k), own, QUICK)
        found = again if found is None else _better(found, again, missing)[0]
        missing = ~found.complete
    return found


def _better(found: Judged, again: Judged, which: Bool[np.ndarray, "n"]) -> tuple[Judged, Bool[np.ndarray, "n"]]:
    """What is found with those of `which` replaced that are complete in `again`, and which these are."""
    new = which.copy()
    new[which] = again.complete
    row = np.arange(len(which) * found.seams).reshape(-1, found.seams)
    row[new] = row.size + np.arange(which.sum() * found.seams).reshape(-1, found.seams)[again.complete]
    plans = Plans.concatenate([found.plans, again.plans]).rows(row.ravel())
    return Judged(found.search, found.run, found.method, found.values, quick=True, plans=plans), new


def _clearance(judged: Judged) -> np.ndarray:
    """Clearance that is proven all along; of quick plans, whose proofs are coarse, the minimum at the targets [m]."""
    return _at_targets(judged.plans) if judged.quick else _along(judged.plans)


def _along(plans: Plans) -> np.ndarray:
    """The least clearance that is proven on the way to any executable target of each plan [m]; inf where none is."""
    return np.where(plans.executable, plans.way_clearance, np.inf).min(axis=1)


def _at_targets(plans: Plans) -> np.ndarray:
    """Minimum clearance of each plan at a tracked target [m]; inf where none is."""
    return np.where(plans.tracked, plans.clearance, np.inf).min(axis=1)


def _cycle_time(judged: Judged) -> np.ndarray:
    """The program's, less than 0 [s]; -inf where there is no motion to give time to."""
    rows = judged.run.timing(judged.method).timed
    times = np.full(len(judged.plans.status), -np.inf)
    times[rows["scenario"].to_numpy()] = -rows["cycle_time_s"].to_numpy()
    return times


def _joint_motion(judged: Judged) -> np.ndarray:
    """How far the joints go along the path, less than 0 [rad]."""
    plans = judged.plans
    return -np.nansum(np.where(plans.tracked, plans.joint_step, 0.0), axis=1)


AIMS = {CLEARANCE: _clearance, "cycle time": _cycle_time, "joint motion": _joint_motion}
