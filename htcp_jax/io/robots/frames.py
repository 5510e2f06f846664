"""Poses of frames as 4 x 4 matrices, and names of joints."""

import mujoco
import numpy as np


def frame(position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    """Return a pose (4, 4) from a position (3,) [m] and a unit quaternion (4,), w first."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, quaternion)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation.reshape(3, 3), position
    return pose


def turned_frame(axis: np.ndarray, angle: float) -> np.ndarray:
    """Return the pose (4, 4) of a frame that is turned about an axis (3,) by an angle [rad]."""
    quaternion = np.zeros(4)
    mujoco.mju_axisAngle2Quat(quaternion, axis, angle)
    return frame(np.zeros(3), quaternion)


def shifted_frame(offset: np.ndarray) -> np.ndarray:
    """Return the pose (4, 4) of a frame that is shifted by (3,) [m]."""
    pose = np.eye(4)
    pose[:3, 3] = offset
    return pose


def joint_name(model: mujoco.MjModel, joint: int) -> str:
    """Return the joint's own name, or joint1, joint2, ... by its index in the model."""
    return model.joint(joint).name or f"joint{joint + 1}"
