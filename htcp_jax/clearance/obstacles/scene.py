"""The scene: what all scenarios of a plan share, the robot, its obstacles and its task."""

from typing import NamedTuple

from htcp_jax.clearance.obstacles.obstacle import Obstacles, Rows, rows_of
from htcp_jax.model.robot import Robot, lengthen_tool
from htcp_jax.model.task import TCP_POSITION, Task
from htcp_jax.types import Scalar


class Scene(NamedTuple):
    """What all scenarios of a plan share."""

    robot: Robot
    obstacles: Obstacles
    task: Task = TCP_POSITION

    @property
    def rows(self) -> Rows:
        """What the rows of clearance are between."""
        return rows_of(self.robot, self.obstacles)


def own_scene(scene: Scene, tool_extension_m: Scalar) -> Scene:
    """The scene with a scenario's own tool."""
    return scene._replace(robot=lengthen_tool(scene.robot, tool_extension_m))
