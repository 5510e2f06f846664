"""The numbers that sum up plans: the paper's table, with the counts behind each percentage."""

from typing import NamedTuple

import numpy as np

from htcp_jax.planner.plans import Plans, is_tracked
from htcp_jax.status import Status


class Failure(NamedTuple):
    """Where a scenario ended."""

    scenario: int
    target: int
    status: Status


class Summary(NamedTuple):
    """What S scenarios with T targets each came to.

    Distances are over the tracked targets, NaN where there are none; a step is one attempted target.
    """

    scenarios: int
    complete: int  # scenarios with every target tracked
    targets: int  # S x T
    tracked: int
    after_escape: int  # of the tracked
    blocked_paths: int  # tracked targets whose straight joint path from the row before is known to collide
    success_rate: float  # tracked / targets
    step_ms: float  # run time per attempted target, compilation apart
    compile_s: float
    run_s: float
    tcp_distance_mean_mm: float
    tcp_distance_max_mm: float
    clearance_min_mm: float
    clearance_mean_mm: float
    joint_motion_rad: float  # sum of |x_t - x_{t-1}|
    failures: tuple[Failure, ...]  # one for each scenario that is not complete


def summarise(plans: Plans) -> Summary:
    """The summary of `plans`. Targets with a status below zero do not exist, or are not planned yet."""
    exists, tracked = plans.status >= 0, is_tracked(plans.status)
    attempted = int((exists & (plans.status != Status.NOT_ATTEMPTED)).sum())
    residual_mm, clearance_mm = 1e3 * plans.residual[tracked], 1e3 * plans.clearance[tracked]
    return Summary(
        scenarios=int(exists.any(axis=1).sum()),
        complete=int(((tracked == exists).all(axis=1) & exists.any(axis=1)).sum()),
        targets=int(exists.sum()),
        tracked=int(tracked.sum()),
        after_escape=int((plans.status == Status.TRACKED_AFTER_ESCAPE).sum()),
        blocked_paths=int((plans.path_clear[tracked] == 0).sum()),
        success_rate=_or_nan(np.mean, tracked[exists]),
        step_ms=1e3 * plans.run_s / attempted if attempted else np.nan,
        compile_s=float(plans.compile_s),
        run_s=float(plans.run_s),
        tcp_distance_mean_mm=_or_nan(np.mean, residual_mm),
        tcp_distance_max_mm=_or_nan(np.max, residual_mm),
        clearance_min_mm=_or_nan(np.min, clearance_mm),
        clearance_mean_mm=_or_nan(np.mean, clearance_mm),
        joint_motion_rad=float(plans.joint_step[tracked].sum()),
        failures=failures(plans.status),
    )


def failures(status: np.ndarray) -> tuple[Failure, ...]:
    """The first target that is not tracked, of every scenario that has one; `status` is (S, T)."""
    missed = (status >= 0) & ~is_tracked(status)
    return tuple(
        Failure(int(s), int(t), Status(int(status[s, t]))) for s, t in enumerate(missed.argmax(axis=1)) if missed[s, t]
    )


def _or_nan(reduce, values: np.ndarray) -> float:
    return float(reduce(values)) if values.size else np.nan
