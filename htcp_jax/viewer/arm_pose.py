"""Poses of the arm for the frames of a movie or the browser page, relative to the world or to the part.

Plans are relative to the root of the kinematic chain. If the part moves, this root is the part's link. `seen` then
transforms poses to the world, or keeps them relative to the part.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from htcp_jax.model import Robot, kinematics
from htcp_jax.model import robot as robots
from htcp_jax.motion import arm_poses as poses
from htcp_jax.viewer.colours import is_tool
from htcp_jax.viewer.viewpoints import SKIN_M, ShownBodies

AT_REST = np.eye(4)
THICK_M, MOST_FLAT = 0.01, 4  # radius above which a piece is thickened; fewer points than these are always


class ArmPose(NamedTuple):
    """Arm in one frame of a movie, with the last reached target (-1: none), and True during a dwell."""

    arm: kinematics.ArmShape
    target: int
    dwells: bool = False
    T_root: Float[np.ndarray, "4 4"] = AT_REST  # T_world_root: pose of the part's link if the part moves
    links: Float[np.ndarray, "K 4 4"] | None = None  # see `links_at`


def seen(pose: ArmPose, from_part: bool) -> ArmPose:
    """Return a pose for drawing, relative to the world or to the part.

    Args:
        pose: The pose; the arm is relative to the chain's root.
        from_part: True to draw a moving part at rest; False to draw the world at rest.
    """
    if from_part or pose.T_root is AT_REST:
        return pose._replace(T_root=AT_REST)
    links = None if pose.links is None else pose.T_root @ pose.links
    return pose._replace(arm=kinematics.ArmShape(*(moved(part, pose.T_root) for part in pose.arm)), links=links)


def moved(points: Float[np.ndarray, "*n 3"], T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "*n 3"]:
    """Return the points transformed by the pose T."""
    return points @ T[:3, :3].T + T[:3, 3]


def arm_poses(
    robot: Robot, x: Float[np.ndarray, "n N"], reached: Int[np.ndarray, "n"], dwells: Bool[np.ndarray, "n"]
) -> list[ArmPose]:
    """Return the poses of the arm at n configurations.

    Args:
        robot: The robot.
        x: The configurations [rad or m].
        reached: The last target reached at each configuration; -1 before the first target.
        dwells: True for configurations during a dwell.
    """
    arms = (kinematics.ArmShape(*arm) for arm in zip(*arms_at(robot, x), strict=True))
    known = arms, reached.tolist(), dwells.tolist(), roots_at(robot, x), links_at(robot, x)
    return [ArmPose(*frame) for frame in zip(*known, strict=True)]


def together(row: Sequence[ArmPose]) -> kinematics.ArmShape:
    """Return the arms of n poses, stacked along a first axis."""
    return kinematics.ArmShape(*map(np.stack, zip(*(pose.arm for pose in row), strict=True)))


def roots_at(robot: Robot, x: Float[np.ndarray, "n N"]) -> list[Float[np.ndarray, "4 4"]]:
    """Return T_world_root at n configurations; AT_REST if the part does not move."""
    if not robot.part_moves:
        return [AT_REST] * len(x)
    return list(poses.at(robot, x).T_world_root)


def arms_at(robot: Robot, x: Float[np.ndarray, "n N"]) -> kinematics.ArmShape:
    """Return the arm at n configurations."""
    return poses.at(robot, x).arm


def pieces_at(robot: Robot, x: Float[np.ndarray, "n N"]) -> list[dict[int, tuple[Float[np.ndarray, "_ 3"], float]]]:
    """Return the convex pieces at n configurations, by capsule: vertices [m] and the radius about them [m]."""
    pieces = robots.checked_pieces(robot)
    return [{k: (moved(vertices, T[k]), r) for k, (vertices, r) in pieces.items()} for T in links_at(robot, x)]


def links_at(robot: Robot, x: Float[np.ndarray, "n N"]) -> list[Float[np.ndarray, "K 4 4"] | None]:
    """Return the pose of each capsule's link at n configurations; None if no convex pieces are checked."""
    if robot.pieces is None:
        return [None] * len(x)
    return list(poses.at(robot, x).T_root_link)


def shown_bodies(robot: Robot, row: Sequence[ArmPose]) -> ShownBodies:
    """Return the bodies of the arm in n poses, to find out what they hide.

    Args:
        robot: The robot.
        row: The poses, in the frame in which they are drawn, see `seen`.
    """
    arm, pieces = together(row), robots.checked_pieces(robot)
    length = np.linalg.norm(arm.tip - arm.tcp, axis=-1, keepdims=True)  # of the bare tip
    tip = arm.tcp + np.minimum(SKIN_M / np.maximum(length, SKIN_M), 1) * (arm.tip - arm.tcp)
    found = ShownBodies(arm.p, arm.q, np.asarray(robot.capsule_radius), is_tool(robot), tip=tip)
    if not pieces:
        return found
    hulls = {k: _hull(*piece) for k, piece in pieces.items()}
    capsule = np.repeat(list(hulls), [len(own) for own in hulls.values()])
    triangles = [np.concatenate([moved(own, pose.links[k]) for k, own in hulls.items()]) for pose in row]
    return found._replace(triangles=np.stack(triangles), capsule=capsule)


def _hull(points: Float[np.ndarray, "V 3"], radius: float) -> Float[np.ndarray, "E 3 3"]:
    """Return the triangles of a piece's convex hull [m], thickened by its radius only if that is large."""
    if radius > THICK_M or len(points) < MOST_FLAT:
        octahedron = max(radius, THICK_M / 100) * np.concatenate([np.eye(3), -np.eye(3)])
        points = (points[:, None] + octahedron).reshape(-1, 3)
    return points[scipy.spatial.ConvexHull(points, qhull_options="QJ").simplices]  # joggled: it may be flat
