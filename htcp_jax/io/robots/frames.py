"""Poses of frames as 4 x 4 matrices."""

import mujoco
import numpy as np


def frame(position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    """Return a pose (4, 4) from a position (3,) [m] and a unit quaternion (4,), w first."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, quaternion)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation.reshape(3, 3), position
    return pose


def body_frame(model: mujoco.MjModel, body: int) -> np.ndarray:
    """Return the pose (4, 4) of a body in its parent's frame, in the model's initial configuration."""
    return frame(model.body_pos[body], model.body_quat[body])


def site_frame(model: mujoco.MjModel, site: int) -> np.ndarray:
    """Return the pose (4, 4) of a site in its body's frame."""
    return frame(model.site_pos[site], model.site_quat[site])


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
