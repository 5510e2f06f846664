"""Progress of a placement search: its stages, and the number of plans in each."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from htcp_jax.placement.place_file import CLEARANCE, Search
from htcp_jax.placement.scores import RAISED, MountingScores
from htcp_jax.placement.tolerance import TRIED, most_tried
from htcp_jax.runs import Run
from htcp_jax.runs import sweep as sweeps

MARGINS = 1.7, 1.4, 1.2, 1.05, 0.95, 0.8, 0.5  # margins tried for a confirmed motion / the quick plan's clearance
LOWERED = 0.8, 0.4  # margins tried for a perturbed mounting / the mounting's own, before the job's margin
TOLERANCES = 3  # number of mountings whose tolerances are determined
STAGES = {
    "rounds": "search",
    "raised": "search",
    "confirmed": "confirm",
    "perturbed": "perturb",
    "tolerance": "tolerance",
}


class PlaceProgress(NamedTuple):
    """Progress of a search."""

    stage: str  # one of STAGES
    scenarios: int  # plans of this stage so far
    of: int | None  # maximum number of plans of this stage; None: limited by time only
    complete: int  # number of complete mountings found so far
    best: float  # first objective's best value so far; -inf: none
    sweep: sweeps.SweepProgress | None = None  # progress of the current sweep
    most: dict[str, int | None] | None = None  # see `most_plans`
    kept: int = 0  # number of plans that were in the folder at the beginning


def most_plans(search: Search) -> dict[str, int | None]:
    """Return the maximum number of plans of each stage; None if only the time is limited."""
    file, k = search.file, max(1, len(search.seams))
    is_raised = CLEARANCE in file.objective
    scenarios, objectives = file.within.scenarios, len(file.objective)
    best = objectives * -(-file.best // objectives)  # the same number for each objective
    return {
        "search": None if scenarios is None else scenarios // k * k * (1 + RAISED * is_raised),
        "confirm": k * best * (len(MARGINS) if is_raised else 1),
        "perturb": k * best * TRIED * (1 + len(LOWERED) * is_raised),
        "tolerance": k * min(TOLERANCES, best) * most_tried(len(search.ranges.axes)),
    }


class ProgressReporter:
    """Counter of the plans and complete mountings of the current stage, which reports them as progress."""

    def __init__(self, search: Search, progress: Callable[[PlaceProgress], None] | None, kept: int):
        self._stage, self._progress, self._most, self._kept = "search", progress, most_plans(search), kept
        self._scenarios, self._complete, self._best = 0, 0, -np.inf

    def begin(self, stage: str) -> None:
        """Begin a stage: if it is a new one, reset its counts."""
        if stage != self._stage:
            self._stage, self._scenarios = stage, 0

    def planned(self, run: Run) -> None:
        """Add the number of plans in a finished sweep."""
        self._scenarios += run.manifest.count

    def evaluated(self, found: MountingScores) -> None:
        """Add a finished round's complete mountings, and update the best objective."""
        self._complete += int(found.complete.sum())
        self._best = max(self._best, float(found.objective[:, 0].max(initial=-np.inf)))

    def sweep(self, now: sweeps.SweepProgress) -> None:
        """Report the progress of the current sweep."""
        if self._progress is not None:
            done = self._scenarios + min(now.scenarios_done, now.scenarios)
            counts = done, self._most[self._stage], self._complete, self._best
            self._progress(PlaceProgress(self._stage, *counts, now, self._most, self._kept))
