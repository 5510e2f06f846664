"""Manipulability along plans: the smallest singular value of the task's Jacobian, which is 0 at singularities.

It is the task's speed in the worst direction for a joint velocity of length 1: for a feed rate v in this direction, the
joints need |dx/dt| >= v / manipulability. Unlike that of Yoshikawa's product of all singular values, its unit does not
depend on the number of rows. Source: Klein and Blaho, Dexterity measures for the design and control of kinematically
redundant manipulators, International Journal of Robotics Research 6(2), 1987, section 2.3.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.clearance import Scene
from htcp_jax.device import Executor, devices, lane_function
from htcp_jax.model import Robot, Task, TaskLinear
from htcp_jax.settings import Settings


class _AtTarget(NamedTuple):
    """Inputs of a lane."""

    target: jax.Array  # the task's goal
    tool_extension_m: jax.Array  # extension of the robot's tool


def manipulability(
    robot: Robot,
    task: Task,
    x: Float[np.ndarray, "n N"],
    goals: Float[np.ndarray, "n G"],
    tool_extension_m: Float[np.ndarray, "n"] | float = 0.0,
) -> Float[np.ndarray, "n"]:
    """Return the smallest singular value of the task's Jacobian at configurations [m/rad; for slides without a unit].

    Angles that the task constrains are scaled to lengths: `tolerance_rad` corresponds to `tolerance_m`, as in the
    residual.

    Args:
        robot: The robot.
        task: The task.
        x: Configurations [rad or m]; NaN where there are none.
        goals: The task's goal at each configuration [m].
        tool_extension_m: Extension of the robot's tool: one for all configurations, or one per configuration.

    Returns:
        The values; NaN where x is NaN, and for a task without equations.
    """
    found, known = np.full(len(x), np.nan), np.isfinite(x).all(axis=1)
    if task.rows and known.any():
        lanes = _AtTarget(goals[known], np.broadcast_to(np.asarray(tool_extension_m, float), len(x))[known])
        rows = Executor(Scene(robot, (), task), Settings(), threads=devices.cores())(JACOBIAN, lanes, x[known])
        found[known] = np.linalg.svd(task.own_rows(rows).jacobian, compute_uv=False)[:, -1]
    return found


def along(
    robot: Robot,
    tasks: Sequence[tuple[Task, Bool[np.ndarray, "T"]]],
    x: Float[np.ndarray, "T N"],
    goals: Float[np.ndarray, "T G"],
) -> Float[np.ndarray, "T"]:
    """Return `manipulability` at all targets of a plan, whose seams may have different tasks.

    Args:
        robot: The robot with its tool.
        tasks: The tasks, each with True for its targets.
        x: Configurations at the targets [rad or m]; NaN where there are none.
        goals: Goals at the targets, see `Scenario.task_goals` [m].
    """
    found = np.full(len(x), np.nan)
    for task, here in tasks:
        found[here] = manipulability(robot, task, x[here], goals[here, : task.numbers])
    return found


def _linear(settings, scene: Scene, lane: _AtTarget, x) -> TaskLinear:
    """Return the task's rows to first order at x."""
    return scene.task.linear_at(scene.robot, x, lane.target)


SIZES = lane_function.STEP._replace(cpu=lane_function.BatchSize(4096, 1))  # a lane takes less time than a call
JACOBIAN = lane_function.LaneFunction("task_jacobian", _linear, SIZES, any_cone=True)
