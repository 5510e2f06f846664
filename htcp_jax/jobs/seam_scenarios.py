"""Scenarios of a part's seams: all directions of each seam, and the whole in one order of work."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from htcp_jax.jobs import build
from htcp_jax.jobs.seam_keys import tasks_of_targets
from htcp_jax.jobs.seam_paths import points_of_seams
from htcp_jax.model import NOT_REFUSED, Robot, Scenario, Task, Workpiece, beyond_reach, interior_rule
from htcp_jax.model import scenario as scenarios
from htcp_jax.sequencing import Variants
from htcp_jax.spec import AUTO, PlanConfig, SeamConfig
from htcp_jax.status import Status

BEGINS = 4  # number of rows of a closed seam at which it may begin


class SeamScenarios(NamedTuple):
    """All variants of a job's seams as scenarios, see `sequencing.Variants`."""

    job: PlanConfig  # the job whose seams are the variants
    workpiece: Workpiece  # its path has the rows of all variants, as one seam: each scenario is a seam by itself
    scenarios: Scenario  # one for each variant
    variants: Variants
    tasks: list[Task]  # different tasks, by number in `Variants.task`
    before: list[tuple[int, int]]  # pairs of seams, the first of which must be done before the second


def seam_scenarios(job: PlanConfig, robot: Robot) -> SeamScenarios:
    """Return the scenarios of a resolved job with several seams.

    The motion begins at `home_rad`, or else at `start_rad` unless it is auto. A UserWarning states that the rule for
    the inside of the part is off although an inlet is given.

    Raises:
        InputError: See `build.workpiece_of` and `build.scenario_of`.
    """
    seams = job.workpiece.seams
    own, seam, reverse, is_allowed = list[SeamConfig](), list[int](), list[int](), list[bool]()
    for k, each in enumerate(seams):
        for begins_at in _begins(each):
            for direction, other in (("forward", 1), ("backward", -1)):
                reverse.append(len(own) + other)
                own.append(each.model_copy(update={"direction": direction, "begins_at": begins_at}))
                seam.append(k)
                is_allowed.append(each.direction in ("either", direction))
    job = _with_seams(job, own)
    workpiece = build.workpiece_of(job.workpiece, robot)
    whole = build.scenario_of(job, robot, workpiece, beyond_reach="record")
    rule = interior_rule(workpiece, whole)
    if job.workpiece.inlet_m is not None and job.workpiece.interior == "hull" and rule.startswith("off"):
        warnings.warn(f"workpiece.inlet_m is given, but the rule for the inside of the part is {rule}", stacklevel=2)
    bounds = [0, *workpiece.seam_begins, len(workpiece.path)]
    parts = [_rows(whole, robot, a, b) for a, b in pairwise(bounds)]
    names = [each.name for each in seams]
    before = [(names.index(name), k) for k, each in enumerate(seams) for name in each.after]
    workpiece = workpiece.with_path(workpiece.name, workpiece.path, workpiece.frames, ())
    tasks = tasks_of_targets(job, robot, np.arange(len(own)))
    number = np.argmax([each.here for each in tasks], axis=0)
    variants = Variants(np.array(seam), np.array(reverse), np.array(is_allowed), number)
    return SeamScenarios(job, workpiece, scenarios.stack(parts), variants, [each.task for each in tasks], before)


def in_order(
    found: SeamScenarios, robot: Robot, done: Sequence[int], missing: Sequence[int]
) -> tuple[PlanConfig, Workpiece, Scenario]:
    """Return the job with its seams in the order of work, with its workpiece and its only scenario.

    Args:
        found: The scenarios of the seams.
        robot: The job's robot.
        done: Variants of the seams that are done, in order.
        missing: Numbers of the seams that are not done; they follow.
    """
    first = [int(np.flatnonzero(found.variants.seam == seam)[0]) for seam in missing]
    job = _with_seams(found.job, [found.job.workpiece.seams[variant] for variant in [*done, *first]])
    points, begins = points_of_seams(job.workpiece)
    xyz = points.xyz - np.asarray(found.workpiece.origin)
    workpiece = found.workpiece.with_path(job.workpiece.path_label, xyz, points.frames, begins)
    workpiece = build.with_plates_of(job.workpiece, workpiece)
    return job, workpiece, build.scenario_of(job, robot, workpiece, beyond_reach="record")


def _begins(seam: SeamConfig) -> Sequence[int | None]:
    """Return the rows at which a seam may begin: of a closed one, if it has no `begins_at`, BEGINS in equal steps."""
    if not seam.closed or seam.begins_at is not None or seam.rows is None:
        return [seam.begins_at]
    count = seam.rows[1] - 1
    return sorted({k * count // BEGINS for k in range(BEGINS)})


def _with_seams(job: PlanConfig, seams: Sequence[SeamConfig]) -> PlanConfig:
    """Return the job with other seams, and with a start that the planner chooses."""
    part = job.workpiece.model_copy(update={"seams": tuple(seams)})
    home = job.begins_rad or None
    return job.model_copy(update={"workpiece": part, "start_rad": AUTO, "home_rad": home})


def _rows(whole: Scenario, robot: Robot, first: int, last: int) -> Scenario:
    """Return a scenario with some rows of another one's path; like every scenario's, its first target is repeated."""
    on_path = int(whole.on_path)
    rows = on_path + np.array([first] * on_path + list(range(first, last)))
    targets = whole.targets[rows]
    margins = whole.margin_m, whole.segment_margin_m
    if whole.seam_margins_m is not None:
        margins = whole.seam_margins_m[rows[-1]]
    is_far = beyond_reach(robot, targets, float(whole.tool_extension_m)).any()
    return replace(
        whole,
        targets=targets,
        margin_m=np.asarray(margins[0]),
        segment_margin_m=np.asarray(margins[1]),
        seam_margins_m=None,
        task_goals=None if whole.task_goals is None else whole.task_goals[rows],
        count=np.array(len(rows), np.int32),
        refused=np.array(Status.OUT_OF_REACH if is_far else NOT_REFUSED, np.int32),
    )
