"""Progress of a placement search: its stages, and the number of plans in each."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from htcp_jax.placement.mounting import UNITS
from htcp_jax.placement.place_file import CLEARANCE, Search
from htcp_jax.placement.scores import RAISED, MountingScores
from htcp_jax.placement.tolerance import TRIED, most_tried
from htcp_jax.runs import Run
from htcp_jax.runs import sweep as sweeps

MARGINS = 1.7, 1.4, 1.2, 1.05, 0.95, 0.8, 0.5  # margins tried for a confirmed motion / the quick plan's clearance
LOWERED = 0.8, 0.4  # margins tried for a perturbed mounting / the mounting's own, before the job's margin
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
    news: tuple[str, ...] = ()  # lines about mountings that are better than all before


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
        "tolerance": k * min(file.tolerances, best) * most_tried(len(search.ranges.axes)),
    }


class ProgressReporter:
    """Counter of the plans and complete mountings of the current stage, which reports them as progress."""

    def __init__(self, search: Search, progress: Callable[[PlaceProgress], None] | None, kept: int):
        self._search, self._stage, self._progress, self._most, self._kept = (
            search, "search", progress, most_plans(search), kept,
        )  # fmt: skip
        self._scenarios, self._mountings, self._complete, self._best, self._confirmed = 0, 0, 0, -np.inf, -np.inf

    def begin(self, stage: str) -> None:
        """Begin a stage: if it is a new one, reset its counts."""
        if stage != self._stage:
            self._stage, self._scenarios = stage, 0

    def planned(self, run: Run) -> None:
        """Add the number of plans in a finished sweep."""
        self._scenarios += run.manifest.count

    def evaluated(self, found: MountingScores) -> None:
        """Add a finished round's complete mountings, update the best objective, and report better mountings."""
        news = []
        for k in np.flatnonzero(found.complete).tolist():
            if (value := float(found.objective[k, 0])) > self._best:
                self._best = value
                news.append(f"mounting {self._mountings + k + 1} is complete: {self._text(value, found.values[k])}")
        self._mountings += len(found.values)
        self._complete += int(found.complete.sum())
        self._report(tuple(news))

    def confirmed(self, found: MountingScores) -> None:
        """Report a confirmed mounting, whose plans with several margins are given, if it is better than all before."""
        k = int(found.objective[:, 0].argmax())
        if (value := float(found.objective[k, 0])) > self._confirmed:
            self._confirmed = value
            self._report((f"confirmed as a proven motion: {self._text(value, found.values[k])}",))

    def _text(self, value: float, values: np.ndarray) -> str:
        """Return the first objective of a mounting and its parameters."""
        name = self._search.file.objective[0]
        unit, factor = UNITS[name]
        shown = [(axis.shown, v) for axis, v in zip(self._search.ranges.axes, values.tolist(), strict=True)]
        parameters = ", ".join(f"{one.name} {v * one.scale:.4g} {one.unit}".rstrip() for one, v in shown)
        return f"{name} {factor * value:.3g} {unit}; {parameters}"

    def _report(self, news: tuple[str, ...], sweep: sweeps.SweepProgress | None = None, more: int = 0) -> None:
        if self._progress is not None and (news or sweep):
            counts = self._scenarios + more, self._most[self._stage], self._complete, self._best
            self._progress(PlaceProgress(self._stage, *counts, sweep, self._most, self._kept, news))

    def sweep(self, now: sweeps.SweepProgress) -> None:
        """Report the progress of the current sweep."""
        self._report((), now, min(now.scenarios_done, now.scenarios))
