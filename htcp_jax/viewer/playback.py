"""Playback of a plan: the arm at the targets and along the segments between them, through the via points."""

import numpy as np
from jaxtyping import Float

from htcp_jax.model import kinematics
from htcp_jax.status import Kind
from htcp_jax.viewer.arm_pose import ArmPose, arm_poses, arms_at
from htcp_jax.viewer.replay import Replay

STRIDE_M = 0.04  # maximum displacement of a point of the arm between consecutive poses


def pose_at(replay: Replay, target: int) -> ArmPose:
    """Return the pose of the arm at a target."""
    return ArmPose(replay.arm_at(target), target, T_root=replay.T_root[target], links=replay.links[target])


def poses_along(replay: Replay) -> list[ArmPose]:
    """Return the arm's poses up to the last tracked target, interpolated along the straight joint paths.

    No point of the arm moves by more than STRIDE_M between consecutive poses.
    """
    motion = replay.motion
    if not len(motion.x):
        return [pose_at(replay, 0)]
    leads = motion.target + (motion.kind == Kind.DWELL)
    come = np.where(np.append(np.diff(leads) != 0, True), leads, leads - 1)  # a segment's last row is at its target
    starts_at_0 = len(motion.x) > 1 and (motion.x[0] == motion.x[1]).all() and come[1] == 0
    first = int(starts_at_0)
    x, come, turns = motion.x[first:], come[first:], motion.kind[first:] == Kind.DWELL
    points = _moving_points(arms_at(replay.robot, x))
    moved = np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=1, initial=0.0)
    counts = np.maximum(1, np.ceil(moved / STRIDE_M)).astype(int)
    legs = zip(x, x[1:], counts, strict=False)
    x = np.concatenate([x[:1], *(np.linspace(a, b, n + 1)[1:] for a, b, n in legs)])
    reached = np.concatenate([come[:1], np.repeat(come[:-1], counts)])
    reached[np.cumsum(counts)] = come[1:]
    dwells = np.append(False, np.repeat(turns[1:], counts))
    return arm_poses(replay.robot, x, reached, dwells)


def _moving_points(shape: kinematics.ArmShape) -> Float[np.ndarray, "n P 3"]:
    """Return the points of the arm whose displacement limits the step between poses."""
    return np.concatenate([shape.p, shape.q, shape.tcp[:, None]], axis=1)
