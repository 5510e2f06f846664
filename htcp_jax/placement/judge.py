"""Mountings, judged: each is planned with every seam, by one planner, as the scenarios of a sweep.

What is judged is on disk as any sweep is, shard by shard. Asked for again it is read, so a search that was killed goes
on from there, and where it is planned has no influence on it.
"""

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.jobs.grid import Sweep, load_sweep
from htcp_jax.placement.place_file import Search
from htcp_jax.planner.plans import Plans
from htcp_jax.runs.run_folder import Run
from htcp_jax.status import Status

MARGIN = "margin_m"
# Plans a grid by a method into a folder, or goes on with it, and gives it time where the cycle time is an aim.
Planner = Callable[[Sweep, str, Path], Run]


class Judged:
    """n mountings with k seams by one method. Larger is better in all that is spare."""

    def __init__(self, search: Search, run: Run, method: str, values: Float[np.ndarray, "n d"]):
        self.search, self.run, self.method, self.values = search, run, method, values
        self.seams = max(1, len(search.seams))

    @cached_property
    def plans(self) -> Plans:
        """A row a mounting and seam, the seam moving fastest."""
        return self.run.plans(self.method)

    @cached_property
    def done(self) -> Float[np.ndarray, "n k"]:
        """Which share of its targets each seam is tracked at."""
        ends = self.plans.outcomes
        return (ends.tracked / np.maximum(ends.targets, 1)).reshape(-1, self.seams)

    @cached_property
    def complete(self) -> Bool[np.ndarray, "n"]:
        """Whether every target of every seam is tracked."""
        return self.plans.outcomes.complete.reshape(-1, self.seams).all(axis=1)

    @cached_property
    def driven(self) -> Bool[np.ndarray, "n"]:
        """Whether a proven motion leads along the whole of every seam."""
        return self.plans.outcomes.can_be_driven.reshape(-1, self.seams).all(axis=1)

    @cached_property
    def spare(self) -> Float[np.ndarray, "n A"]:
        """Of each aim what is left, the worst seam's; -inf where a mounting is not complete or nothing is known."""
        found = np.stack([AIMS[name](self).reshape(-1, self.seams).min(axis=1) for name in self.search.file.spare], 1)
        return np.where(self.complete[:, None], found, -np.inf)

    @cached_property
    def clearance(self) -> Float[np.ndarray, "n"]:
        """The least clearance at a target that is tracked, over all seams [m]."""
        return _at_targets(self.plans).reshape(-1, self.seams).min(axis=1)

    def lost(self) -> list[str]:
        """Why each mounting is not complete, in words, by its worst seam; empty where it is."""
        ends, worst = self.plans.outcomes, self.done.argmin(axis=1)
        rows = np.arange(len(self.values)) * self.seams + worst
        return ["" if ends.of(row).status is None else Status(ends.of(row).status).words for row in rows.tolist()]


def sweep_of(search: Search, values: Float[np.ndarray, "n d"], margin_m: Float[np.ndarray, "n"] | None = None) -> Sweep:
    """The grid of some mountings with every seam. margin_m: that each asks for; None: the job's. Raises InputError for
    values that the job refuses."""
    first: dict[str, Any] = search.ranges.columns(values)
    if margin_m is not None:
        first[MARGIN] = margin_m.tolist()
    grid = [first, {"workpiece.path": list(search.seams)}] if search.seams else [first]
    return load_sweep({"grid": grid}, search.config, search.overrides)


def judge(
    search: Search,
    plan: Planner,
    values: Float[np.ndarray, "n d"],
    method: str,
    folder: Path,
    margin_m: Float[np.ndarray, "n"] | None = None,
) -> Judged:
    """Plan mountings, or go on with it, or read them. Raises InputError and Interrupted as `runs.sweep` does."""
    return Judged(search, plan(sweep_of(search, values, margin_m), method, folder), method, values)


def _clearance(judged: Judged) -> np.ndarray:
    """The least that is proven all along; of a plan that is no motion the least at its targets [m]."""
    plans, is_confirmed = judged.plans, judged.method == judged.search.file.confirm
    proven = np.where(plans.executable, plans.way_clearance, np.inf).min(axis=1)
    return np.where(plans.outcomes.can_be_driven & is_confirmed, proven, _at_targets(plans))


def _at_targets(plans: Plans) -> np.ndarray:
    """The least clearance of each plan at a target that is tracked [m]; inf where none is."""
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


AIMS = {"clearance": _clearance, "cycle time": _cycle_time, "joint motion": _joint_motion}
