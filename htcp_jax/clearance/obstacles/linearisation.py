"""Task and clearance at one configuration, to first order: the data of a step QP."""

from typing import NamedTuple

import jax.numpy as jnp

from htcp_jax.clearance.obstacles.obstacle import HasWorkpiecePose, Obstacles
from htcp_jax.clearance.obstacles.obstacles import ClearanceRows, clearance_rows
from htcp_jax.model import Robot, Task
from htcp_jax.model import task as tasks
from htcp_jax.types import Array, Float, Joints


class TaskRows(NamedTuple):
    """The task at one configuration, to first order."""

    value: Float[Array, "V"]  # the features, which are compared with the goals [m]
    jacobian: Float[Array, "V N"]


class Linearisation(NamedTuple):
    """Task and clearance at one configuration, to first order."""

    task: TaskRows
    clearance: ClearanceRows  # all rows, or the one of the smallest distance


def linearise(
    robot: Robot,
    obstacles: Obstacles,
    where: HasWorkpiecePose,
    x: Joints,
    task: Task = tasks.TCP_POSITION,
    smallest: bool = False,
) -> Linearisation:
    """Return task and clearance at x, with their Jacobian and gradients.

    Equations (6) and (7) for the task, (8), the convex feasible set, for the clearance.

    Args:
        robot: The robot.
        obstacles: The obstacles.
        where: A scenario, or another `HasWorkpiecePose`.
        x: The configuration [rad or m].
        task: The task; by default the TCP's position.
        smallest: True: only the clearance row of the smallest distance, which costs less.

    Raises:
        InputError: For an x of another shape.
    """
    held = TaskRows(task.value(robot, x), task.jacobian(robot, x))
    rows = clearance_rows(robot, obstacles, where, x, smallest)
    if smallest:
        body = jnp.argmin(rows.distance)
        rows = ClearanceRows(rows.distance[body][None], rows.gradient[body][None])
    return Linearisation(held, rows)
