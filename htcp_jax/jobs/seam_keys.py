"""Keys of a job that each of its seams may have, too: `task`, `margin_m` and `feed`. A seam's own come first."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Int

from htcp_jax.errors import InputError
from htcp_jax.model import PathFrames, Robot, RowError, Scenario, Task, Workpiece, task_of, with_goals
from htcp_jax.spec import PlanConfig, SeamConfig, TaskRowKind

VALUES = "towards, looks_at_m, cone_deg, within_deg, on, through_m, normal, direction, orientation and within_m"


def with_keys_of_only_seam(job: PlanConfig) -> PlanConfig:
    """Return the job of one seam with the seam's own keys as the job's; other jobs are not changed."""
    if len(job.workpiece.seams) != 1:
        return job
    (seam,) = job.workpiece.seams
    own = {"task": seam.task or job.task, "margin_m": margin_of(job, seam)}
    if seam.feed is not None:
        own["program"] = job.program.model_copy(update={"feed": seam.feed})
    seams = (seam.model_copy(update={"task": (), "margin_m": None, "feed": None}),)
    return job.model_copy(update={**own, "workpiece": job.workpiece.model_copy(update={"seams": seams})})


def margin_of(job: PlanConfig, seam: SeamConfig) -> float:
    """Return the required clearance on a seam [m]."""
    return job.margin_m if seam.margin_m is None else seam.margin_m


def with_goals_of_seams(
    scenario: Scenario, job: PlanConfig, task: Task, robot: Robot, workpiece: Workpiece
) -> Scenario:
    """Return the scenario with the goals of its task; on each seam, those of the seam's own task.

    Args:
        scenario: A scenario; its last targets are the points of the path.
        job: The job.
        task: The job's task.
        robot: The robot without the scenario's tool extension.
        workpiece: The scenario's workpiece.

    Raises:
        InputError: See `with_goals`; also if a seam's task has other kinds of rows than the job's.
    """
    seams = job.workpiece.seams
    if not any(seam.task for seam in seams):
        return with_goals(scenario, job.task, task, robot, workpiece)
    kept, before = None, len(scenario.targets) - len(workpiece.path)
    for rows, numbers in _by_task(job):
        try:
            if task_of(rows, robot, task.tolerance_m, task.tolerance_rad) != task:
                raise InputError(_difference(rows, job, task, robot))
            part, of_path = _some_seams(workpiece, numbers)
            targets = np.concatenate([scenario.targets[:before], scenario.targets[before:][of_path]])
            found = with_goals(replace(scenario, targets=targets), rows, task, robot, part).task_goals
        except RowError as error:
            raise InputError(f"seam {seams[numbers[0]].name!r}: {error.message('task.')}") from None
        except InputError as error:
            raise InputError(f"seam {seams[numbers[0]].name!r}: {error}") from None
        if found is None:
            return scenario
        kept = np.zeros((len(scenario.targets), found.shape[1])) if kept is None else kept
        kept[before + of_path] = found[before:]
        if not numbers[0]:
            kept[:before] = found[:before]
    return replace(scenario, task_goals=kept)


def with_margins_of_seams(scenario: Scenario, job: PlanConfig, workpiece: Workpiece) -> Scenario:
    """Return the scenario with the margins of its seams; unchanged if no seam has its own."""
    seams = job.workpiece.seams
    if all(seam.margin_m is None for seam in seams):
        return scenario
    margin = np.array([margin_of(job, seam) for seam in seams])
    on_segments = margin if job.margin_on == "segments" else np.zeros(len(seams))
    each = np.stack([margin, on_segments], axis=1)[seam_of_rows(workpiece)]
    before = len(scenario.targets) - len(each)
    return replace(scenario, seam_margins_m=np.concatenate([np.repeat(each[:1], before, axis=0), each]))


def seam_of_rows(workpiece: Workpiece) -> Int[np.ndarray, "T"]:
    """Return the number of the seam of each point of a path."""
    return np.searchsorted(workpiece.seam_begins, np.arange(len(workpiece.path)), "right")


def _by_task(job: PlanConfig) -> list[tuple[Sequence[TaskRowKind], list[int]]]:
    """Return the different tasks, each with the numbers of its seams."""
    found: list[tuple[Sequence[TaskRowKind], list[int]]] = []
    for number, seam in enumerate(job.workpiece.seams):
        rows = seam.task or job.task
        known = next((numbers for other, numbers in found if other == rows), None)
        if known is None:
            found.append((rows, [number]))
        else:
            known.append(number)
    return found


def _some_seams(workpiece: Workpiece, numbers: Sequence[int]) -> tuple[Workpiece, Int[np.ndarray, "k"]]:
    """Return the part with only some seams, and their rows in the path."""
    ends = list(pairwise([0, *workpiece.seam_begins, len(workpiece.path)]))
    rows = [np.arange(*ends[number]) for number in numbers]
    which, begins = np.concatenate(rows), np.cumsum([len(own) for own in rows])[:-1]
    frames = PathFrames(*(None if given is None else given[which] for given in workpiece.frames))
    return workpiece.with_path(workpiece.name, workpiece.path[which], frames, tuple(begins.tolist())), which


def _difference(rows: Sequence[TaskRowKind], job: PlanConfig, task: Task, robot: Robot) -> str:
    """Return text on how a seam's rows differ from the job's in more than values."""
    allowed = f"a seam's task has the rows of the job's task, with other values of {VALUES}"
    if len(rows) != len(task.parts):
        own, theirs = (", ".join(map(str, each)) or "none: the TCP is on the path" for each in (rows, job.task))
        return f"its task has the rows {own}; the job's: {theirs}; {allowed}"
    parts = task_of(rows, robot, task.tolerance_m, task.tolerance_rad).parts
    k = next(k for k, (own, part) in enumerate(zip(parts, task.parts, strict=True)) if own != part)
    row, other = rows[k], job.task[k] if job.task else None
    what = f"task.{k + 1} ({row}) is of another kind than the job's" + ("" if other is None else f" ({other})")
    limits = [getattr(each, "limit", None) is None for each in (row, other)]
    if other is not None and str(row) == str(other) and limits[0] != limits[1]:
        has = "no tolerance, but the job's has one", "a tolerance, but the job's has none"
        what = f"task.{k + 1} ({row}) has {has[limits[1]]}"
    return f"{what}; {allowed}, and a tolerance only where the job has one"
