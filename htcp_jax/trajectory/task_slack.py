"""Slack of a job's task at the legs of a motion, if the task constrains more than the TCP's position."""

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.jobs import build
from htcp_jax.model import Robot
from htcp_jax.motion import Motion
from htcp_jax.spec import PlanConfig
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
    """Return the slack with the slack of the job's task added; legs off the path have unlimited slack.

    If the task does not constrain the TCP's position, the TCP's distance from its line is not limited.

    Args:
        left: Slack without the task.
        job: The job.
        robot: The robot with the job's tool.
        motion: The motion.
        goals: Goals of the task at each target, see `Scenario`.
        targets: Positions of the targets, world [m]; required for via points between targets.

    Raises:
        InputError: If a row of the task has no bound between two configurations.
    """
    task = build.task_of_job(job, robot)
    if task.sampled:
        names = ", ".join(row.name for row, part in zip(job.task, task.parts, strict=True) if part.sampled)
        raise InputError(
            f"no program: the task row kind {names} does not set `rate`, so the row cannot be proven for a motion that "
            "deviates from the plan; set `rate` in the kind"
        )
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
