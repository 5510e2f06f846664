"""Task and clearance at one configuration, to first order: the data of a step QP."""

from typing import NamedTuple

import jax.numpy as jnp

from htcp_jax.clearance.obstacles.obstacle import HasWorkpiecePose, Obstacles
from htcp_jax.clearance.obstacles.obstacles import ClearanceRows, clearance_rows
from htcp_jax.model import TCP_POSITION, Robot, Task
from htcp_jax.types import Array, Float, Joints


class TaskRows(NamedTuple):
    """The task at one configuration, to first order."""

    value: Float[Array, "V"]  # C(x): points [m] and directions of the arm that are compared with the goals
    jacobian: Float[Array, "V N"]  # d value / dx [m/rad or m/m; 1/rad for directions]


class Linearisation(NamedTuple):
    """Task and clearance at one configuration, to first order."""

    task: TaskRows
    clearance: ClearanceRows  # all rows, or only the one with the smallest distance


def linearise(
    robot: Robot,
    obstacles: Obstacles,
    where: HasWorkpiecePose,
    x: Joints,
    task: Task = TCP_POSITION,
    smallest: bool = False,
) -> Linearisation:
    """Return task and clearance at x, with the task's Jacobian and the clearance's gradients.

    The task is linearised by equations (6) and (7), the clearance by (8), the convex feasible set.

    Args:
        robot: The robot.
        obstacles: The obstacles.
        where: A scenario, or another `HasWorkpiecePose`.
        x: The configuration [rad or m].
        task: The task; by default the TCP's position.
        smallest: True to return only the clearance row with the smallest distance, which costs less.

    Raises:
        InputError: If x does not have one value per joint.
    """
    held = TaskRows(task.value(robot, x), task.jacobian(robot, x))
    rows = clearance_rows(robot, obstacles, where, x, smallest)
    if smallest:
        body = jnp.argmin(rows.distance)
        rows = ClearanceRows(rows.distance[body][None], rows.gradient[body][None])
    return Linearisation(held, rows)
