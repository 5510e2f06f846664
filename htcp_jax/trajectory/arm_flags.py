"""Arm configuration flags of a Yaskawa arm, as in INFORM's RCONF, which select one of the IK solutions.

The flags are known only for the built-in GP50. Its controller's angles s, l, u, r, b, t are given by q = (s, l - pi/2,
-u, -r, -b, -t), see the GP50's model. According to the NX100's manual, section Manipulator Types, the wrist is flipped
if r is within 90 degrees of 0 or of a full turn; r, t and s count as 180 degrees or more outside (-180, 180]; the S
axis separates front and rear, and the L and U axes separate upper and lower arm. Behind the S axis the manual defines
upper and lower arm only by figures, so the flags are unknown there.
"""

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.errors import InputError
from htcp_jax.model import Robot, kinematics
from htcp_jax.spec import config

JOINTS = 6
SHOULDER, ELBOW, WRIST = 1, 2, 4  # indices of the joints whose frame origins are on the L, U and B axes


def arm_flags(arm: config.RobotConfig, robot: Robot, x: Float[np.ndarray, "n N"]) -> Int[np.ndarray, "n 6"]:
    """Return the six flags at n configurations, 0 or 1.

    The flags are, in this order: no flip, lower arm, rear, and r, t and s of 180 degrees or more.

    Args:
        arm: The job's section of the arm.
        robot: The loaded arm.
        x: Configurations [rad].

    Raises:
        InputError: If the arm is not a GP50, or not in front of its S axis.
    """
    if not arm.is_gp50 or x.shape[1] != JOINTS:  # a GP50 on a rail has more joints
        raise InputError(
            f"jbi: arm configuration flags (RCONF) are implemented for the GP50 only; for {robot.name}, use jbi-pulses"
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
            f"jbi: configuration {k} is behind the S axis, where its flags (RCONF) are not implemented; use jbi-pulses"
        )
    up = points[..., 2]
    return (ahead[:, 2] - ahead[:, 0]) * (up[:, 1] - up[:, 0]) > (up[:, 2] - up[:, 0]) * (ahead[:, 1] - ahead[:, 0])
