"""Text about a plan that ends early: the reason, the clearance next to the one aimed at, and the next command."""

import math
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from htcp_jax.errors import mm_text
from htcp_jax.model import Workpiece, denser_spacing, surface
from htcp_jax.motion import Tried, plans
from htcp_jax.planning import RefusedSegment
from htcp_jax.settings import Settings
from htcp_jax.spec import PlanConfig
from htcp_jax.status import SegmentStatus, Status

MEASURED = Status.PATH_BLOCKED, Status.RECOVERY_EXHAUSTED  # statuses after which segments to the target are measured
WIDER_TUBE = 5.0  # a larger tolerance is suggested up to so many times the present one
MORE_EFFORT, MOST_EFFORT = 4.0, 8.0  # factor on `settings.effort` that is suggested, up to the second value


def arguments(config: str | Path | Mapping[str, Any] | None, overrides: Sequence[str] | Mapping[str, Any] = ()) -> str:
    """Return a job as arguments of a command, such as "job.yaml --set margin_m=0.001".

    Args:
        config: The job file or example; None: the default job, the example duct. A mapping has no file and is called
            JOB.
        overrides: Changes to the job, by key or as "key=value".
    """
    name = ["duct"] if config is None else ["JOB" if isinstance(config, Mapping) else str(config)]
    changes = overrides.items() if isinstance(overrides, Mapping) else (each.partition("=")[::2] for each in overrides)
    return shlex.join([*name, *(part for key, value in changes for part in ("--set", f"{key}={value}"))])


def reason(end: plans.Outcome, refused: RefusedSegment | None) -> str:
    """Return the reason why a plan ends, without what the row `segment` says if there is one."""
    if end.status == Status.PATH_BLOCKED and refused is not None:
        return "clear configurations were found there, but no segment to one of them was accepted"
    if end.status == Status.RECOVERY_EXHAUSTED and refused is not None and refused.verdict == SegmentStatus.VALID:
        return "the search accepted no configuration there, although a clear one exists"
    return end.status.message


def attempts(tried: Tried, settings: Settings) -> str:
    """Return the attempts after a dead end, and the rule by which they ended."""
    if tried.excluded:
        return tried.description
    return (
        f"{tried.description}; such a search ends after at most {settings.effort:g} (settings.effort) times the "
        "configurations used before it"
    )


def aim(refused: RefusedSegment, job: PlanConfig) -> dict[str, str]:
    """Return a line if the clearance at the target is between the margin and what the search aims at; else {}.

    Args:
        refused: The segment to the target.
        job: The job.
    """
    name, above_m = _aim_above(job)
    found_m, margin_m = refused.end_clearance_m, refused.margin_m
    if not margin_m <= found_m < margin_m + above_m:
        return {}
    return {
        "clearance there": f"{1e3 * found_m:.3g} mm, between the {1e3 * margin_m:g} mm that margin_m requires and the "
        f"{1e3 * (margin_m + above_m):g} mm at which the search aims (settings.{name})"
    }


def coarse_mesh(covering_radius_m: float, lack_m: float) -> dict[str, str]:
    """Return a line about a lack of clearance that denser points on the part's mesh may end, see `denser_spacing`.

    Args:
        covering_radius_m: The covering radius of the points, which is subtracted from every clearance.
        lack_m: The required clearance minus the measured one.
    """
    return {
        "points on the mesh": f"their covering radius, {mm_text(covering_radius_m)}, is subtracted from every "
        f"clearance to the part, and {mm_text(lack_m)} are lacking here: denser points may suffice"
    }


def denser_mesh(workpiece: Workpiece, lack_m: float) -> dict[str, str]:
    """Return `coarse_mesh` and a line with the spacing to try; {} if no spacing suffices, see `denser_spacing`."""
    if (spacing := denser_spacing(workpiece, lack_m)) is None:
        return {}
    first = {"try first": f"--set {surface.KEY}={spacing:g}, which covers the part's mesh more densely"}
    return coarse_mesh(workpiece.covering_radius_m, lack_m) | first


def subtracted(workpiece: Workpiece, clearance_m: float) -> str:
    """Return how much the points on the part's mesh cost and, if this is more than what remains, a denser spacing.

    Args:
        workpiece: The part. The covering radius of its points is subtracted from every clearance.
        clearance_m: The minimum clearance, after it is subtracted.
    """
    cover_m = workpiece.covering_radius_m
    text = f"{mm_text(cover_m)} are subtracted for the gaps between them"
    if cover_m <= clearance_m or (spacing := denser_spacing(workpiece, cover_m / 2)) is None:
        return text
    return f"{text}, at most {mm_text(spacing / 2)} with --set {surface.KEY}={spacing:g}"


def next_step(
    end: plans.Outcome,
    refused: RefusedSegment | None,
    dead_ends: Mapping[int, Tried],
    job: PlanConfig,
    given: str,
    spacing_m: float | None = None,
    start_m: float | None = None,
) -> dict[str, str]:
    """Return a line with one command to run next, for a plan that ends early; {} if none is known.

    Args:
        end: How the plan ends.
        refused: The segment to the failed target, if it was measured.
        dead_ends: Attempts after dead ends, by target.
        job: The job.
        given: The job as arguments of a command.
        spacing_m: Spacing of points on the part's mesh at which the plan may succeed; None if no spacing helps.
        start_m: Largest clearance found at the first target, if no configuration there was valid; else None.
    """
    if spacing_m is not None:
        return {"next": _planned(given, f"{surface.KEY}={spacing_m:g}", "covers the part's mesh more densely")}
    each = " ".join(filter(None, ["htcp reachability", given, "--each"]))
    is_near = start_m is not None and start_m >= job.margin_m / 2
    if end.status == Status.HOME_NOT_JOINED or (end.status == Status.NO_START and is_near):
        change = f"settings.seed={job.settings.seed + 1}"
        return {"next": _planned(given, change, "tries other random configurations")}
    if end.status == Status.NO_START and start_m is not None:
        digit = 10.0 ** math.floor(math.log10(start_m / 2))
        change = f"margin_m={math.floor(start_m / 2 / digit) * digit:.1g}"
        return {
            "next": _planned(
                given, change, "requires at most half of what was found there; other places may be tighter"
            )
        }
    if end.status == Status.NO_START:
        return {"next": f"{each}   searches longer, or proves that nothing reaches a target; htcp place moves the part"}
    if end.status not in MEASURED:
        return {}
    is_excluded = any(own.excluded for target, own in dead_ends.items() if target >= (end.failed or 0))
    if is_excluded or (change := _change(end, refused, job)) is None:
        return {"next": f"{each}   tests every target, and names what prevents it; htcp place moves the part"}
    return {"next": _planned(given, *change)}


def _planned(given: str, change: str, why: str) -> str:
    """Return the command that plans with one key changed, and what the change does."""
    words, key = shlex.split(given), change.partition("=")[0]  # the job, then pairs of --set and KEY=VALUE
    job = words[: words.index("--set")] if "--set" in words else words
    kept = [each for each in words[len(job) + 1 :: 2] if each.partition("=")[0] != key]
    changes = [word for each in (*kept, change) for word in ("--set", each)]
    return f"{shlex.join(['htcp', 'plan', *job, *changes])}   {why}"


def _change(end: plans.Outcome, refused: RefusedSegment | None, job: PlanConfig) -> tuple[str, str] | None:
    """Return the change of one key that is the most likely to help, and what it does; None if none is."""
    settings, by_beam = job.settings, job.method == "beam"
    is_clear = refused is not None and refused.verdict == SegmentStatus.VALID
    if refused is not None and is_clear:
        name, above_m = _aim_above(job)
        if refused.end_clearance_m < refused.margin_m + above_m:
            return f"settings.{name}=0", "accepts every clearance of at least the margin"
    if refused is not None and refused.leaves_path and refused.tube_m < refused.off_m <= WIDER_TUBE * refused.tube_m:
        wider_mm = -(-1.1e4 * refused.off_m // 1) / 10  # a tenth more, in tenths of a millimetre
        return f"settings.path_tolerance_m={wider_mm / 1e3:g}", f"allows the tool {wider_mm:g} mm between targets"
    if not by_beam:
        return "method=beam", "keeps several configurations at each target"
    if settings.effort and end.status == Status.RECOVERY_EXHAUSTED and not is_clear:
        return None  # it is not known whether any configuration is clear there
    if settings.effort < MOST_EFFORT:
        more = min(MOST_EFFORT, MORE_EFFORT * settings.effort) or Settings().effort
        return f"settings.effort={more:g}", "searches longer after the dead end"
    if not settings.transfers and job.start_rad != "auto":
        return "settings.transfers=true", "may begin in another configuration"
    return None


def _aim_above(job: PlanConfig) -> tuple[str, float]:
    """Return the setting of the clearance above the margin at which the search aims, and its value [m]."""
    name = "beam_aim_m" if job.method == "beam" else "aim_above_m"
    return name, getattr(job.settings, name)
