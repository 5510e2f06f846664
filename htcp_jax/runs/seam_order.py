"""`SeamOrder`: the order of a plan's seams, as text and for files."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from htcp_jax.jobs import margin_of
from htcp_jax.motion import Plans, plans
from htcp_jax.sequencing import SeamSequence
from htcp_jax.spec import PlanConfig
from htcp_jax.status import NOT_TRIED

MOST_NAMED = 8  # more seams are counted in titles


class SeamVisit(NamedTuple):
    """A seam that is done."""

    name: str
    direction: str  # forward or backward
    first: int  # first target
    last: int  # last target
    air_move_s: float | None  # time of the air move to it, at the joints' full speed; None if the motion begins here
    clearance_m: float  # guaranteed clearance along the seam and the air move to it
    margin_m: float  # required clearance at its targets
    feed: str | None  # feed rate with its unit, as in the job; None: neither the seam nor the job has one


class SeamOrder(NamedTuple):
    """The seams in their order of work, and the reasons why others are missing."""

    visits: tuple[SeamVisit, ...]
    missing: dict[str, str]  # name of the seam -> reason
    time_s: float  # of the whole motion at the joints' full speed
    bound_s: float  # lower bound on this time for all orders of the seams' plans
    retract_clearance_m: float | None  # guaranteed clearance on the way back home; None without a home

    @classmethod
    def of(
        cls, job: PlanConfig, made: Plans, sequence: SeamSequence, missing: Mapping[str, plans.Outcome]
    ) -> "SeamOrder":
        """Return the order of a plan.

        Args:
            job: The job; its first seams are those that are done, in order.
            made: The plan of all seams.
            sequence: The order.
            missing: The outcome of each seam that is not done, by name.
        """
        seams = job.workpiece.seams[: len(sequence.visits)]
        bounds = [0, *made.seam_begins, made.status.shape[1]]
        times: list[float | None] = [move.time_s for move in sequence.moves]
        times = times if len(times) == len(seams) else [None, *times]
        visits = [
            SeamVisit(
                *(seam.name, seam.direction, a, b - 1, time, float(made.segment_clearance[0, a:b].min())),
                *(margin_of(job, seam), seam.feed or job.program.feed),
            )
            for seam, a, b, time in zip(seams, bounds, bounds[1:], times, strict=False)
        ]
        reasons = {name: _reason(end) for name, end in missing.items()}
        back = None if made.retract is None else float(made.retract.clearance.min())
        return cls(tuple(visits), reasons, *sequence[3:5], back)

    @classmethod
    def read(cls, record: Mapping[str, Any]) -> "SeamOrder":
        """Return the order in a mapping that `record` has made.

        Raises:
            TypeError: If it has other keys.
        """
        return cls(**{**record, "visits": tuple(SeamVisit(**visit) for visit in record["visits"])})

    @property
    def done(self) -> str:
        """Names of the seams that are done; of many, their number."""
        names = [visit.name for visit in self.visits]
        return f"{len(names)} seams" if len(names) > MOST_NAMED else ", ".join(names) or "no seam"

    def facts(self) -> dict[str, str]:
        """Return the order as text by label."""
        done = ", ".join(f"{visit.name} ({visit.direction})" for visit in self.visits) or "no seam"
        above = 100 * (self.time_s / self.bound_s - 1) if self.bound_s else 0.0
        if self.time_s > self.bound_s == 0:
            least = "no lower bound is known"
        elif above >= 0.05:
            least = f"at most {above:.1f} % above the shortest order"
        else:
            least = "no order of these plans is shorter"
        count = f"{len(self.visits)} of {len(self.visits) + len(self.missing)}"
        return {"seams": f"{count}: {done}", "order": f"{self.time_s:.3g} s at the joints' full speed; {least}"}

    def failure(self) -> dict[str, str]:
        """Return the reason for each missing seam, by label."""
        return {f"seam {name}": reason for name, reason in self.missing.items()}

    def record(self) -> dict[str, Any]:
        """Return the order as a mapping for JSON."""
        return {**self._asdict(), "visits": [visit._asdict() for visit in self.visits]}


def _reason(end: plans.Outcome) -> str:
    """Return the reason why a seam has no motion."""
    if end.status is None:
        return f"target {end.executable} of {end.targets}: {end.segment_status.message}"
    at = "" if end.status in NOT_TRIED else f"target {end.failed} of {end.targets}: "
    return f"{at}{end.status.message}"
