"""Poses of the arm for drawing, by one executable for any number of configurations.

The lane function is in the core, so that its executable is found without tracing, see `cache_key`.
"""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from htcp_jax.clearance import Scene
from htcp_jax.device import Executor, lane_function
from htcp_jax.model import Robot, kinematics
from htcp_jax.settings import Settings


class ArmPoses(NamedTuple):
    """The arm at one or several configurations, in the frame of the chain's root."""

    arm: kinematics.ArmShape
    T_world_root: Float[np.ndarray, "*n 4 4"]  # pose of the root in the workshop [m]
    T_root_link: Float[np.ndarray, "*n K 4 4"]  # pose of each capsule's link [m]


class _Lane(NamedTuple):
    """Inputs of a lane."""

    tool_extension_m: jax.Array  # extension of the robot's tool


def at(robot: Robot, x: Float[np.ndarray, "n N"]) -> ArmPoses:
    """Return the arm at n >= 1 configurations [rad or m]."""
    found = Executor(Scene(robot, ()), Settings())(ARM_POSES, _Lane(np.zeros(len(x))), x)
    p, q, T = (table[:, : len(robot.capsule_link)] for table in (found.arm.p, found.arm.q, found.T_root_link))
    return found._replace(arm=found.arm._replace(p=p, q=q), T_root_link=T)


def _pose(settings, scene: Scene, lane: _Lane, x) -> ArmPoses:
    robot = scene.robot
    return ArmPoses(kinematics.arm_shape(robot, x), kinematics.root_pose(robot, x), kinematics.body_poses(robot, x))


ARM_POSES = lane_function.LaneFunction("arm_poses", _pose, lane_function.STEP)
