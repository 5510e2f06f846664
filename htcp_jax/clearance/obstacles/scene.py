"""The scene: robot, obstacles and task that all scenarios of a plan share."""

from typing import NamedTuple

from htcp_jax.clearance.obstacles.obstacle import Obstacles, RowPairs, rows_of
from htcp_jax.model import Robot, Task
from htcp_jax.model import robot as robots
from htcp_jax.model import task as tasks
from htcp_jax.pytree import without_labels
from htcp_jax.types import Scalar


class Scene(NamedTuple):
    """Robot, obstacles and task that all scenarios of a plan share."""

    robot: Robot
    obstacles: Obstacles
    task: Task = tasks.TCP_POSITION

    @property
    def rows(self) -> RowPairs:
        """Both sides of each row of clearance, see `RowPairs`."""
        return rows_of(self.robot, self.obstacles)

    def without_labels(self) -> "Scene":
        """Return the scene without names and other data that only messages and files need.

        Functions are compiled for such a scene, so that other names do not cause another compilation.
        """
        return self._replace(robot=without_labels(self.robot), obstacles=tuple(map(without_labels, self.obstacles)))


def own_scene(scene: Scene, tool_extension_m: Scalar) -> Scene:
    """Return the scene with the tool lengthened by a scenario's extension [m]."""
    return scene._replace(robot=robots.lengthen_tool(scene.robot, tool_extension_m))
