"""Camera for a plan: it faces the open side of the workpiece, as near as possible with all objects in view."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.viewer.arm_pose import AT_REST, ArmPose, moved, seen, together
from htcp_jax.viewer.colours import is_tool
from htcp_jax.viewer.playback import pose_at
from htcp_jax.viewer.replay import Replay
from htcp_jax.viewer.viewpoints import View, Viewpoint

FILLED = 0.94  # maximum share of the picture's width or height that the objects fill
AROUND, LEAST_AROUND_M = 0.5, 0.05  # distance from the path's box in a close view: share of its diagonal, and minimum


class CameraPose(NamedTuple):
    """Position and direction of an upright camera; world [m]."""

    eye: Float[np.ndarray, "3"]
    look_at: Float[np.ndarray, "3"]  # point in the middle of the view, at the objects' mean depth


def viewpoint_of(replay: Replay, from_part: bool = True, side: int = 0) -> Viewpoint:
    """Return a side from which the plan is drawn.

    Args:
        replay: The plan.
        from_part: True for the side relative to the part, False for the side in the world.
        side: 0 for the best side, 1 for the second.
    """
    return (replay.sides if from_part else replay.sides_in_world)[side]


def open_side(replay: Replay, from_part: bool = True) -> View:
    """Return the best side's view.

    Args:
        replay: The plan.
        from_part: True for the side relative to the part, False for the side in the world.
    """
    return viewpoint_of(replay, from_part).view


def middle_root(replay: Replay, from_part: bool) -> Float[np.ndarray, "4 4"]:
    """Return T_world_root for drawing the cloud: of the middle tracked target, or the identity relative to the part."""
    return AT_REST if from_part else replay.T_root[max(replay.tracked, 1) // 2]


def floor_height(replay: Replay, from_part: bool) -> float:
    """Return the height at which the floor is drawn [m]: the cell's, else below all objects and at most 0."""
    if replay.fixtures.floor_m is not None and not replay.robot.part_moves:
        return replay.fixtures.floor_m
    poses = [seen(pose_at(replay, target), from_part) for target in range(len(replay.target))]
    arms, cloud = together(poses), moved(replay.cloud, middle_root(replay, from_part))
    low = (np.minimum(arms.p, arms.q)[..., 2] - np.asarray(replay.robot.capsule_radius)).min()
    return float(min(0.0, cloud[:, 2].min(), low))


def kept_points(
    replay: Replay, share: float = 0.5, direction: Float[np.ndarray, "3"] | None = None
) -> Bool[np.ndarray, "P"]:
    """Return the mask of the cloud's points that remain after a cut.

    Args:
        replay: The plan.
        share: Share of the cloud's extent that is removed.
        direction: Unit direction from the cloud's centre to the removed side; None: the part's axis towards the open
            side.
    """
    near = viewpoint_of(replay).axis.direction if direction is None else direction
    return replay.cloud @ near <= cut_plane(replay, share, near)


def cut_plane(replay: Replay, share: float, near: Float[np.ndarray, "3"]) -> float:
    """Return the offset of the plane at which the workpiece is cut [m].

    Args:
        replay: The plan.
        share: Share of the cloud's extent that is removed.
        near: Unit direction from the cloud's centre to the removed side.
    """
    depth = replay.cloud @ near
    return float(depth.max() - share * np.ptp(depth))


def camera_pose(
    replay: Replay,
    poses: Sequence[ArmPose],
    fovy_rad: float,
    aspect: float,
    close: bool = False,
    from_part: bool = False,
    side: int = 0,
) -> CameraPose:
    """Return the nearest camera with the cloud, the targets and the arm in n poses completely in view.

    Args:
        replay: The plan.
        poses: The poses, relative to the chain's root.
        fovy_rad: Vertical field of view [rad].
        aspect: Width / height of the picture.
        close: True to leave the arm's links, the targets before the path and points of the cloud far from it out of
            account.
        from_part: True to draw a moving part at rest; False to draw the world at rest.
        side: See `viewpoint_of`.
    """
    poses = [seen(pose, from_part) for pose in poses]
    arms, toward = together(poses), viewpoint_of(replay, from_part, side).toward
    on_tool = is_tool(replay.robot)
    bodies = on_tool if close else np.ones_like(on_tool)
    ends = np.concatenate([arms.p[:, bodies], arms.q[:, bodies]])
    radii = np.broadcast_to(np.asarray(replay.robot.capsule_radius)[bodies], ends.shape[:2])
    cloud, path = replay.cloud, replay.target[replay.path if close else 0 :]
    if close and len(path):
        low, high = path.min(axis=0), path.max(axis=0)
        wide = np.maximum(AROUND * np.linalg.norm(high - low), LEAST_AROUND_M)
        cloud = cloud[((cloud >= low - wide) & (cloud <= high + wide)).all(axis=1)]
    points = np.concatenate([cloud, path])
    if any(pose.T_root is not AT_REST for pose in poses):  # includes the moving part's bounding box in all poses
        box = np.array(list(itertools.product(*np.stack([points.min(axis=0), points.max(axis=0)], axis=1))))
        points = np.concatenate([moved(box, pose.T_root) for pose in poses])
    centres = np.concatenate([points, ends.reshape(-1, 3)])
    return nearest_camera(centres, np.append(np.zeros(len(points)), radii.ravel()), -toward, fovy_rad, aspect)


def nearest_camera(
    centres: Float[np.ndarray, "n 3"],
    radii: Float[np.ndarray, "n"],
    ahead: Float[np.ndarray, "3"],
    fovy_rad: float,
    aspect: float,
) -> CameraPose:
    """Return the nearest camera with all spheres completely in view.

    Args:
        centres: Centres of the spheres, world [m].
        radii: Radii of the spheres [m].
        ahead: Unit direction in which the camera looks; not vertical.
        fovy_rad: Vertical field of view [rad].
        aspect: Width / height of the picture.
    """
    right = np.array([ahead[1], -ahead[0], 0]) / np.hypot(*ahead[:2])
    up = np.cross(right, ahead)
    across, depth = centres @ np.stack([right, up], axis=1), centres @ ahead
    slope = FILLED * np.tan(fovy_rad / 2) * np.array([aspect, 1.0])
    # |across - middle| + radius / cos <= (depth - own) slope, on all four sides; own: the camera's depth, maximised
    reach = radii[:, None] * np.hypot(1, slope) - depth[:, None] * slope
    more, less = (reach + across).max(axis=0), (reach - across).max(axis=0)
    own, middle = -((more + less) / (2 * slope)).max(), (more - less) / 2
    line = middle[0] * right + middle[1] * up
    return CameraPose(line + own * ahead, line + depth.mean() * ahead)
