"""Summary of plans: the values of the paper's tables, and the counts from which they are computed."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from htcp_jax.motion import Plans
from htcp_jax.motion import plans as plan_arrays
from htcp_jax.status import Status

CONFIDENCE = 0.95  # of confidence intervals


class Failure(NamedTuple):
    """The first target of a scenario that is not tracked."""

    scenario: int
    target: int
    status: Status


class Summary(NamedTuple):
    """Counts, times and errors over S scenarios.

    Distances and errors are those of the tracked targets; NaN if no target is tracked.
    """

    scenarios: int
    complete: int  # number of scenarios with all targets tracked
    targets: int  # number of targets of all scenarios
    tracked: int  # number of tracked targets
    executable: int  # number of tracked targets to which a proven motion leads
    after_recovery: int  # number of targets tracked after a recovery
    blocked_paths: int  # number of tracked targets whose straight joint path from the previous target collides
    success_rate: float  # tracked / targets
    step_ms: float  # planning time per attempted target, without compilation
    compile_s: float  # compilation time
    run_s: float  # planning time without compilation
    tcp_distance_mean_mm: float
    tcp_distance_max_mm: float
    orientation_error_mean_deg: float | None  # None if the task constrains no orientation
    orientation_error_max_deg: float | None  # None if the task constrains no orientation
    clearance_min_mm: float
    clearance_mean_mm: float
    joint_motion_rad: float  # sum of |x_t - x_{t-1}| over the tracked targets
    failures: tuple[Failure, ...]  # one for each scenario that is not complete


def summarise(plans: Plans) -> Summary:
    """Return the summary of plans. Padding after a scenario's last target is ignored."""
    tracked, ends = plans.tracked, plans.outcomes
    residual_mm, clearance_mm = 1e3 * plans.residual[tracked], 1e3 * plans.clearance[tracked]
    angle_deg = orientation_errors_deg(plans)
    return Summary(
        scenarios=int(ends.planned.sum()),
        complete=int(ends.complete.sum()),
        targets=int(ends.targets.sum()),
        tracked=int(ends.tracked.sum()),
        executable=int(ends.executable.sum()),
        after_recovery=int((plans.status == Status.TRACKED_AFTER_RECOVERY).sum()),
        blocked_paths=int(ends.blocked_paths.sum()),
        success_rate=reduced(np.mean, tracked[plans.exists]),
        step_ms=1e3 * plans.step_s,
        compile_s=float(plans.compile_s),
        run_s=float(plans.run_s),
        tcp_distance_mean_mm=reduced(np.mean, residual_mm),
        tcp_distance_max_mm=reduced(np.max, residual_mm),
        orientation_error_mean_deg=float(angle_deg.mean()) if angle_deg.size else None,
        orientation_error_max_deg=float(angle_deg.max()) if angle_deg.size else None,
        clearance_min_mm=reduced(np.min, clearance_mm),
        clearance_mean_mm=reduced(np.mean, clearance_mm),
        joint_motion_rad=float(plans.joint_step[tracked].sum()),
        failures=_failures(ends),
    )


def orientation_errors_deg(plans: Plans) -> Float[np.ndarray, "n"]:
    """Return the orientation errors of all targets that have one [deg]."""
    return np.rad2deg(plans.orientation_error[~np.isnan(plans.orientation_error)])


def _failures(ends: plan_arrays.Outcomes) -> tuple[Failure, ...]:
    """Return the first target that is not tracked, for every scenario that has one."""
    found = (ends.of(s) for s in np.flatnonzero(ends.failed >= 0).tolist())
    return tuple(Failure(end.scenario, end.failed, end.status) for end in found)


def sign_test(better: int, worse: int) -> float | None:
    """Return the probability of a split at least as uneven by chance, if better and worse are equally likely.

    This is the exact two-sided sign test. For scenarios that one of two methods completes it is McNemar's exact test.

    Args:
        better: Number of scenarios with a better result.
        worse: Number of scenarios with a worse result.

    Returns:
        The p-value, a share [1]; None if both numbers are 0.
    """
    return float(scipy.stats.binomtest(better, better + worse).pvalue) if better + worse else None


def rate_interval(count: int, scenarios: int) -> tuple[float, float]:
    """Return the confidence interval of a rate, by Wilson, with the probability CONFIDENCE; shares [1].

    Args:
        count: Number of scenarios that meet the criterion.
        scenarios: Number of all scenarios, at least 1.
    """
    low, high = scipy.stats.binomtest(count, scenarios).proportion_ci(CONFIDENCE, method="wilson")
    return float(low), float(high)


def reduced(reduce: Callable[..., Any], values: Float[np.ndarray, "n"]) -> float:
    """Apply a function to the values that are not NaN; return NaN if there are none.

    Args:
        reduce: Function of an array, such as `numpy.max`.
        values: The values.

    Returns:
        The result, in the unit of the values.
    """
    known = values[~np.isnan(values)]
    return float(reduce(known)) if known.size else np.nan
