"""What all scenarios of a plan share."""

from typing import NamedTuple

from htcp_jax.clearance.obstacles import Obstacle
from htcp_jax.scene.robot import Robot, lengthen_tool
from htcp_jax.types import Scalar


class Scene(NamedTuple):
    """What all scenarios of a plan share."""

    robot: Robot
    obstacle: Obstacle


def own_scene(scene: Scene, tool_extension_m: Scalar) -> Scene:
    """The scene with a scenario's own tool."""
    return Scene(lengthen_tool(scene.robot, tool_extension_m), scene.obstacle)
