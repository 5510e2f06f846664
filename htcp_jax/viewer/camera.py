"""Camera of a plan: it faces the side that is cut open, as near as possible with everything in view."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.model import kinematics
from htcp_jax.viewer.colours import is_tool
from htcp_jax.viewer.replay import Replay
from htcp_jax.viewer.viewpoints import ABOVE_RAD, View, towards_camera

FILLED = 0.94  # largest share of the picture that the objects fill


class CameraPose(NamedTuple):
    """An upright camera; world [m]."""

    eye: Float[np.ndarray, "3"]
    look_at: Float[np.ndarray, "3"]  # in the middle of the view, at the depth of the objects' centre


def open_side(replay: Replay) -> View:
    """Side from which the cloud is cut open."""
    return replay.side.view


def kept_points(
    replay: Replay, share: float = 0.5, direction: Float[np.ndarray, "3"] | None = None
) -> Bool[np.ndarray, "P"]:
    """Mask of the cloud's points that remain after a cut.

    Args:
        replay: The plan.
        share: Share of the cloud's extent that is removed.
        direction: Unit direction from which it is removed; None: from the open side.
    """
    depth = replay.cloud @ (open_side(replay).near if direction is None else direction)
    return depth <= depth.max() - share * np.ptp(depth)


def camera_pose(
    replay: Replay, arms: kinematics.ArmShape, fovy_rad: float, aspect: float, close: bool = False
) -> CameraPose:
    """Camera that shows the cloud, the targets and n arms completely.

    Args:
        replay: The plan.
        arms: The arms.
        fovy_rad: Vertical field of view.
        aspect: Width of the picture by its height.
        close: True to show only the targets of the path, and only the tools of the arms.
    """
    toward = towards_camera(*replay.side, 0.0)
    azimuth = np.arctan2(-toward[1], -toward[0])
    on_tool = is_tool(replay.robot)
    bodies = on_tool if close else np.ones_like(on_tool)
    ends = np.concatenate([arms.p[:, bodies], arms.q[:, bodies]])
    radii = np.broadcast_to(np.asarray(replay.robot.capsule_radius)[bodies], ends.shape[:2])
    points = np.concatenate([replay.cloud, replay.target[replay.path if close else 0 :]])
    centres = np.concatenate([points, ends.reshape(-1, 3)])
    return nearest_camera(centres, np.append(np.zeros(len(points)), radii.ravel()), azimuth, fovy_rad, aspect)


def nearest_camera(
    centres: Float[np.ndarray, "n 3"], radii: Float[np.ndarray, "n"], azimuth: float, fovy_rad: float, aspect: float
) -> CameraPose:
    """Nearest camera that shows all spheres.

    Args:
        centres: Centres of the spheres, world [m].
        radii: Radii of the spheres [m].
        azimuth: Direction of the view about world z [rad]; it is inclined downwards by ABOVE_RAD.
        fovy_rad: Vertical field of view.
        aspect: Width of the picture by its height.
    """
    level = np.cos(ABOVE_RAD)
    ahead = np.array([level * np.cos(azimuth), level * np.sin(azimuth), -np.sin(ABOVE_RAD)])
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0])
    up = np.cross(right, ahead)
    across, depth = centres @ np.stack([right, up], axis=1), centres @ ahead
    slope = FILLED * np.tan(fovy_rad / 2) * np.array([aspect, 1.0])
    # |across - middle| + radius / cos <= (depth - own) slope, to all four sides and with the largest own depth
    reach = radii[:, None] * np.hypot(1, slope) - depth[:, None] * slope
    more, less = (reach + across).max(axis=0), (reach - across).max(axis=0)
    own, middle = -((more + less) / (2 * slope)).max(), (more - less) / 2
    line = middle[0] * right + middle[1] * up
    return CameraPose(line + own * ahead, line + depth.mean() * ahead)
