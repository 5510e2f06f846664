"""Poses of the arm for the frames of a movie or the browser page, relative to the world or to the part.

Plans are relative to the root of the kinematic chain. If the part moves, this root is the part's link. `seen` then
transforms poses to the world, or keeps them relative to the part.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.model import Robot, kinematics
from htcp_jax.model import robot as robots
from htcp_jax.motion import arm_poses as poses

AT_REST = np.eye(4)


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
