"""Configurations of the arm in the frames of a movie or of the page."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.device import EXECUTABLES
from htcp_jax.model import Robot, kinematics
from htcp_jax.pytree import without_labels


class ArmPose(NamedTuple):
    """The arm in one frame, the last target it has reached, -1 before the first, and True if it dwells there."""

    arm: kinematics.ArmShape
    target: int
    dwells: bool = False


def arm_poses(
    robot: Robot, x: Float[np.ndarray, "n N"], reached: Int[np.ndarray, "n"], dwells: Bool[np.ndarray, "n"]
) -> list[ArmPose]:
    """Frames of the arm at n configurations.

    Args:
        robot: The robot.
        x: The configurations [rad or m].
        reached: The last target reached at each, -1 before the first.
        dwells: True if the arm dwells there.
    """
    arms = (kinematics.ArmShape(*arm) for arm in zip(*arms_at(robot, x), strict=True))
    return [ArmPose(*frame) for frame in zip(arms, reached.tolist(), dwells.tolist(), strict=True)]


def together(row: Sequence[ArmPose]) -> kinematics.ArmShape:
    """Stack the arms in n frames."""
    return kinematics.ArmShape(*map(np.stack, zip(*(pose.arm for pose in row), strict=True)))


def arms_at(robot: Robot, x: Float[np.ndarray, "n N"]) -> kinematics.ArmShape:
    """The arm at n configurations."""
    shape = EXECUTABLES.call(kinematics.capsules_and_tcp, without_labels(robot), x)
    return kinematics.ArmShape(*map(np.asarray, shape))
