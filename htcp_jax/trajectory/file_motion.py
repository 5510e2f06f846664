"""Configurations in a program's file: samples at a time step, the motion's own ones, or at most N of them."""

from typing import Literal

from htcp_jax.errors import InputError
from htcp_jax.model import Robot
from htcp_jax.spec import PlanConfig
from htcp_jax.trajectory.deviation import FileMotion
from htcp_jax.trajectory.fewer_points import fewer_points, fewest_points
from htcp_jax.trajectory.formats.writers import format_of
from htcp_jax.trajectory.program import Program
from htcp_jax.trajectory.timed_motion import STRAIGHT

MaxPoints = int | Literal["fewest"] | None  # "fewest": as few as keep the path's tolerance; None: no limit


def file_motion(
    robot: Robot,
    program: Program,
    job: PlanConfig,
    format: str,
    step_s: float | None = None,
    max_points: MaxPoints = None,
) -> FileMotion:
    """Return the configurations that a format contains, and how its player joins them.

    With `max_points` they are chosen by `fewer_points`, unless the format has no more of them anyway.

    Args:
        robot: The robot with the job's tool.
        program: The program.
        job: The job.
        format: Name of the format in `writers.FORMATS`.
        step_s: Time between samples; None: the format's default, see `writers.ProgramFormat`.
        max_points: Maximum number of configurations; None: those of the time step, as with "fewest" if no number of
            points is found, see `points_needed`.

    Raises:
        InputError: If the format does not support the time step, if both a time step and `max_points` are given, or if
            the program stops at more than `max_points` configurations.
    """
    own, control_step_s = format_of(format), _control_step_s(job, format)
    if own.step_s is None and step_s is not None:
        raise InputError(f"{format} contains only the configurations of the motion; omit the time step")
    if step_s is not None and max_points is not None:
        raise InputError("--max-points chooses the times of the configurations; omit the time step")
    if max_points == "fewest":
        max_points = points_needed(robot, program, job, format)
    if own.step_s is None:
        file = FileMotion(program.at_configurations(), (STRAIGHT,))
        if max_points is None or len(file.timed.x) <= max_points:
            return file
    else:
        every = step_s or control_step_s or own.step_s
        if max_points is None or program.duration_s / every + 2 <= max_points:
            return FileMotion(program.timed(every), own.joined)
    return fewer_points(robot, program, max_points, own.joined, control_step_s)


def points_needed(robot: Robot, program: Program, job: PlanConfig, format: str) -> int | None:
    """Return the smallest number of points found with which a file keeps the path's tolerance, see `fewest_points`.

    Args:
        robot: The robot with the job's tool.
        program: The program.
        job: The job.
        format: Name of the format in `writers.FORMATS`.
    """
    joined = format_of(format).joined
    return fewest_points(robot, program, job.settings.tube_m, joined, _control_step_s(job, format))


def _control_step_s(job: PlanConfig, format: str) -> float | None:
    """Return the step of which a format's times must be multiples [s]; None: any times."""
    return job.program.control_step_s if format == "urscript" else None
