"""Arm configuration flags of a Yaskawa arm, as in INFORM's RCONF, which select one of the IK solutions.

Known only for the built-in GP50, whose controller's angles are q = (s, l - pi/2, -u, -r, -b, -t), see its model. By the
NX100's manual, section Manipulator Types: flip if r is within 90 degrees of 0 or of a full turn; r, t and s are 180
degrees or more outside (-180, 180]; front or rear by the S axis, upper or lower arm by the L and U axes. The meaning of
the last two behind the S axis is only in the manual's figures, so the flags are unknown there.
"""

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.errors import InputError
from htcp_jax.jobs import config
from htcp_jax.model import Robot, kinematics

SHOULDER, ELBOW, WRIST = 1, 2, 4  # joints with frame origins on the L, U and B axes


def arm_flags(arm: config.RobotConfig, robot: Robot, x: Float[np.ndarray, "n N"]) -> Int[np.ndarray, "n 6"]:
    """Return the flags at configurations: 1 for no flip, lower arm, rear, and r, t and s of 180 degrees or more, or 0.

    Args:
        arm: The job's arm.
        robot: The arm, loaded.
        x: Configurations [rad].

    Raises:
        InputError: For another arm than the GP50, and if the arm is not in front of its S axis.
    """
    if not arm.is_gp50:
        raise InputError(
            f"jbi: the arm configuration flags (RCONF) of {robot.name} are not known; jbi-pulses needs none"
        )
    s, r, t = x[:, 0], -x[:, 3], -x[:, 5]
    lower = ~_elbow_is_up(robot, x)
    no_flip = np.cos(r) < 0
    return np.stack([no_flip, lower, np.zeros(len(x), bool), *map(_beyond_half_turn, (r, t, s))], axis=1).astype(int)


def _beyond_half_turn(angle: Float[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
    return (angle <= -np.pi) | (angle > np.pi)


def _elbow_is_up(robot: Robot, x: Float[np.ndarray, "n N"]) -> Bool[np.ndarray, "n"]:
    """Return True if the U axis lies above the line from the L axis to the wrist.

    Raises:
        InputError: If the wrist or the TCP is behind the S axis.
    """
    at = np.asarray(jax.vmap(kinematics.link_poses, (None, 0))(robot, x))[:, :, :3, 3][:, [SHOULDER, ELBOW, WRIST]]
    tcp = np.asarray(jax.vmap(kinematics.tcp_position, (None, 0))(robot, x))
    base = np.asarray(robot.T_parent_joint)[0]
    points = (np.concatenate([at, tcp[:, None]], axis=1) - base[:3, 3]) @ base[:3, :3]
    ahead = points[..., 0] * np.cos(x[:, :1]) + points[..., 1] * np.sin(x[:, :1])
    if (behind := ~(ahead[:, 2:] > 0).all(axis=1)).any():
        k = int(behind.argmax())
        raise InputError(
            f"jbi: configuration {k} is behind the S axis, its flags (RCONF) are not known; jbi-pulses needs none"
        )
    up = points[..., 2]
    return (ahead[:, 2] - ahead[:, 0]) * (up[:, 1] - up[:, 0]) > (up[:, 2] - up[:, 0]) * (ahead[:, 1] - ahead[:, 0])
