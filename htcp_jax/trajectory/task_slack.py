"""Slack of the tasks of a job's seams at the legs of a motion, if a task constrains more than the TCP's position."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.jobs import TargetTask
from htcp_jax.model import Robot
from htcp_jax.motion import Motion
from htcp_jax.status import Kind
from htcp_jax.trajectory.blends import MotionSlack
from htcp_jax.trajectory.row_slack import RowSlacks, slack_of_rows


def with_rows(
    left: MotionSlack,
    tasks: Sequence[TargetTask],
    robot: Robot,
    motion: Motion,
    goals: Float[np.ndarray, "T G"],
    targets: Float[np.ndarray, "T 3"] | None = None,
) -> MotionSlack:
    """Return the slack with the slack of the job's tasks added; legs off the path have unlimited slack.

    If a task does not constrain the TCP's position, the TCP's distance from its line is not limited.

    Args:
        left: Slack without the tasks.
        tasks: The tasks of the job's seams.
        robot: The robot with the job's tool.
        motion: The motion.
        goals: Goals of the tasks at each target, see `Scenario`.
        targets: Positions of the targets, world [m]; required for via points between targets.

    Raises:
        InputError: If a row of a task has no bound between two configurations.
    """
    target, kind = motion.target[1:], motion.kind[1:]
    before = np.where(kind == Kind.DWELL, target, np.maximum(target - 1, 0))
    on = np.isin(kind, (Kind.PROCESS, Kind.DWELL))
    tube, slacks = left.tube.copy(), list[RowSlacks]()
    for task, written, here in tasks:
        if task.sampled:
            names = ", ".join(row.name for row, part in zip(written, task.parts, strict=True) if part.sampled)
            raise InputError(
                f"no program: the task row kind {names} does not set `rate`, so the row cannot be proven for a motion "
                "that deviates from the plan; set `rate` in the kind"
            )
        own_goals, own = goals[:, : task.numbers], on & here[target]
        ends = np.stack([own_goals[before], own_goals[target]], axis=1)
        if motion.span is not None:
            inner = np.flatnonzero(own & (np.abs(motion.span[1:] - 0.5) < 0.5).any(axis=1))
            end = target[inner] + (kind[inner] == Kind.DWELL)
            both = np.stack([end - 1, end], axis=1)
            places = None if targets is None else targets[both]
            for side in (0, 1):
                ends[inner, side] = task.interpolated(own_goals[both], motion.span[1:][inner, side], places)
        if (rows := slack_of_rows(task, robot, motion.x, ends, own)) is not None:
            slacks.append(rows)
        if not task.holds_tcp:
            tube[here[target]] = np.inf
    return left._replace(tube=tube, rows=RowSlacks.together(slacks))
