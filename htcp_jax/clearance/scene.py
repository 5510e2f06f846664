"""The scene: what all scenarios of a plan share, the robot, its obstacles and its task; and both to first order."""

from typing import NamedTuple

from htcp_jax.clearance.obstacle import Posed, Rows
from htcp_jax.clearance.obstacles import ClearanceRows, Obstacles, clearance_rows, rows_of
from htcp_jax.scene.robot import Robot, lengthen_tool
from htcp_jax.scene.task import TCP_POSITION, Task
from htcp_jax.types import Array, Float, Joints, Scalar


class Scene(NamedTuple):
    """What all scenarios of a plan share."""

    robot: Robot
    obstacles: Obstacles
    task: Task = TCP_POSITION

    @property
    def rows(self) -> Rows:
        """What the rows of clearance are between."""
        return rows_of(self.robot, self.obstacles)


class TaskRows(NamedTuple):
    """The task at one configuration, to first order."""

    value: Float[Array, "M"]  # what the target is compared with [m]
    jacobian: Float[Array, "M N"]


class Linearisation(NamedTuple):
    """Task and clearance at one configuration, to first order."""

    task: TaskRows
    clearance: ClearanceRows


def own_scene(scene: Scene, tool_extension_m: Scalar) -> Scene:
    """The scene with a scenario's own tool."""
    return scene._replace(robot=lengthen_tool(scene.robot, tool_extension_m))


def linearise(robot: Robot, obstacles: Obstacles, where: Posed, x: Joints, task: Task = TCP_POSITION) -> Linearisation:
    """Task and clearance at x [rad or m], with their Jacobian and gradients; `where` is a scenario, or another `Posed`.

    Equation (7) and the clearance rows of CFS (section on workspace inequality constraints). The default task is the
    TCP's position. Raises InputError for an x of another shape.
    """
    rows = TaskRows(task.value(robot, x), task.jacobian(robot, x))
    return Linearisation(rows, clearance_rows(robot, obstacles, where, x))
