"""Slack of a job's task next to the legs of a motion, if it constrains more than the TCP's position."""

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.jobs import PlanConfig, build
from htcp_jax.model import Robot
from htcp_jax.motion import Motion
from htcp_jax.status import Kind
from htcp_jax.trajectory.blends import MotionSlack
from htcp_jax.trajectory.row_slack import slack_of_rows


def with_rows(
    left: MotionSlack,
    job: PlanConfig,
    robot: Robot,
    motion: Motion,
    goals: Float[np.ndarray, "T G"],
    targets: Float[np.ndarray, "T 3"] | None = None,
) -> MotionSlack:
    """Add the slack of the job's task next to each leg, unlimited off the path.

    If the task does not constrain the TCP's position, the TCP has no tube.

    robot: with the job's tool; goals: goals of the task at each target, see `Scenario`; targets: their positions, world
    [m], for via points between them. Raises InputError for a task with a row that has no bound between two
    configurations.
    """
    task = build.task_of_job(job, robot)
    if task.sampled:
        names = ", ".join(row.name for row, part in zip(job.task, task.parts, strict=True) if part.sampled)
        raise InputError(f"no program: the task row {names} states no rate, so it cannot be proven next to the motion")
    target, kind = motion.target[1:], motion.kind[1:]
    before = np.where(kind == Kind.DWELL, target, np.maximum(target - 1, 0))
    on = np.isin(kind, (Kind.PROCESS, Kind.DWELL))
    ends = np.stack([goals[before], goals[target]], axis=1)
    if motion.span is not None:
        inner = np.flatnonzero(on & (np.abs(motion.span[1:] - 0.5) < 0.5).any(axis=1))
        end = target[inner] + (kind[inner] == Kind.DWELL)
        both = np.stack([end - 1, end], axis=1)
        places = None if targets is None else targets[both]
        for side in (0, 1):
            ends[inner, side] = task.interpolated(goals[both], motion.span[1:][inner, side], places)
    rows = slack_of_rows(task, robot, motion.x, ends, on)
    return left._replace(tube=left.tube if task.holds_tcp else np.full_like(left.tube, np.inf), rows=rows)
