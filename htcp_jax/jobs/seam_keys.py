"""Keys of a job that each of its seams may have, too: `task`, `margin_m` and `feed`. A seam's own come first."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from htcp_jax.errors import InputError
from htcp_jax.model import PathFrames, Robot, RowError, Scenario, Task, Workpiece, task_of, with_goals
from htcp_jax.model import scenario as scenarios
from htcp_jax.spec import PlanConfig, SeamConfig, TaskRowKind


class TargetTask(NamedTuple):
    """A task, and the targets that it constrains."""

    task: Task
    rows: tuple[TaskRowKind, ...]  # the task as the job writes it; of seams with other values, that of the first one
    here: Bool[np.ndarray, "T"]  # True for its targets

    def in_scenario(self, scenario: Scenario) -> Scenario:
        """Return a scenario with the goals of this task; other targets have the goal of its first one."""
        found = scenarios.with_goals_of(scenario, self.task.numbers)
        if self.here.all() or found.task_goals is None:
            return found
        first = found.task_goals[np.argmax(self.here)]
        return replace(found, task_goals=np.where(self.here[:, None], found.task_goals, first))


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
    scenario: Scenario, job: PlanConfig, robot: Robot, workpiece: Workpiece, task: Task | None = None
) -> Scenario:
    """Return the scenario with the goals of the job's task; on each seam, those of the seam's own task.

    Args:
        scenario: A scenario; its last targets are the points of the path.
        job: The job.
        robot: The robot without the scenario's tool extension.
        workpiece: The scenario's workpiece.
        task: The task of the job's own rows, if it is known.

    Raises:
        InputError: See `task_of` and `with_goals`; for a seam's own task with the seam's name.
    """
    by_rows = _by_rows(job, robot, task)
    if len(by_rows) == 1:
        ((rows, task, numbers),) = by_rows
        with _naming(job, numbers):
            return with_goals(scenario, rows, task, robot, workpiece)
    before, found = len(scenario.targets) - len(workpiece.path), list[tuple[np.ndarray, np.ndarray]]()
    for rows, task, numbers in by_rows:
        part, of_path = _some_seams(workpiece, numbers)
        targets = np.concatenate([scenario.targets[:before], scenario.targets[before:][of_path]])
        with _naming(job, numbers):
            goals = with_goals(replace(scenario, targets=targets), rows, task, robot, part).goals
        approach = np.arange(before if 0 in numbers else 0)
        found.append((np.concatenate([approach, before + of_path]), goals[before - len(approach) :]))
    kept = np.zeros((len(scenario.targets), max(task.numbers for _, task, _ in by_rows)))
    for here, goals in found:
        kept[here, : goals.shape[1]] = goals
    return replace(scenario, task_goals=kept)


def tasks_of_targets(job: PlanConfig, robot: Robot, seam: Int[np.ndarray, "T"]) -> list[TargetTask]:
    """Return the tasks of a path that differ in more than values: one, unless seams have rows of other kinds.

    Args:
        job: The job.
        robot: The robot.
        seam: Number of each target's seam.

    Raises:
        InputError: See `task_of`.
    """
    found = dict[Task, TargetTask]()
    for rows, task, numbers in _by_rows(job, robot):
        here = np.isin(seam, numbers)
        known = found.setdefault(task, TargetTask(task, tuple(rows), here))
        found[task] = known._replace(here=known.here | here)
    return list(found.values())


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


def _by_rows(
    job: PlanConfig, robot: Robot, known_task: Task | None = None
) -> list[tuple[Sequence[TaskRowKind], Task, list[int]]]:
    """Return the different lists of rows, each with its task and the numbers of its seams; a path is seam 0."""
    by_rows = list[tuple[Sequence[TaskRowKind], list[int]]]()
    for number, rows in enumerate(job.tasks):
        known = next((numbers for other, numbers in by_rows if other == rows), None)
        if known is None:
            by_rows.append((rows, [number]))
        else:
            known.append(number)
    found = []
    for rows, numbers in by_rows:
        with _naming(job, numbers):
            task = known_task if rows == job.task else None
            task = task or task_of(rows, robot, job.settings.tolerance_m, job.settings.tolerance_rad)
        found.append((rows, task, numbers))
    return found


@contextmanager
def _naming(job: PlanConfig, numbers: Sequence[int]) -> Iterator[None]:
    """Name a task's rows by their keys in the job, such as task.2, in errors, and the seam if the task is its own."""
    seams = job.workpiece.seams
    name = f"seam {seams[numbers[0]].name!r}: " if seams and seams[numbers[0]].task else ""
    try:
        yield
    except RowError as error:
        raise InputError(f"{name}{error.message('task.')}") from None
    except InputError as error:
        raise InputError(f"{name}{error}") from None


def _some_seams(workpiece: Workpiece, numbers: Sequence[int]) -> tuple[Workpiece, Int[np.ndarray, "k"]]:
    """Return the part with only some seams, and their rows in the path."""
    ends = list(pairwise([0, *workpiece.seam_begins, len(workpiece.path)]))
    rows = [np.arange(*ends[number]) for number in numbers]
    which, begins = np.concatenate(rows), np.cumsum([len(own) for own in rows])[:-1]
    frames = PathFrames(*(None if given is None else given[which] for given in workpiece.frames))
    return workpiece.with_path(workpiece.name, workpiece.path[which], frames, tuple(begins.tolist())), which
