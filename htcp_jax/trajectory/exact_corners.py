"""Corners at which a program must be exact, of formats that round corners by an unknown amount."""

import numpy as np

from htcp_jax.model import Robot
from htcp_jax.status import Kind
from htcp_jax.trajectory.displacement import tcp_at
from htcp_jax.trajectory.timed_motion import TimedMotion

SHARE = 0.5  # share of the path's tolerance that a rounded corner may use


def with_exact_corners(robot: Robot, timed: TimedMotion, tolerance_m: float) -> TimedMotion:
    """Return the motion with `blended` 0 at corners of the path where a rounded corner may leave it by too much.

    A corner may be rounded between the middles of its legs. The TCP then is at most as far from the legs as the corner
    is from the line between these middles.

    Args:
        robot: The robot with the job's tool.
        timed: The configurations in the file.
        tolerance_m: The path's tolerance.
    """
    blended = np.ones(len(timed.x)) if timed.blended is None else timed.blended.copy()
    inner = np.arange(1, len(timed.x) - 1)
    inner = inner[(timed.kind[inner] == Kind.PROCESS) & (timed.kind[inner + 1] == Kind.PROCESS)]
    if len(inner):
        middles = [0.5 * (timed.x[inner] + timed.x[inner + other]) for other in (-1, 1)]
        corner, a, b = np.split(tcp_at(robot, np.concatenate([timed.x[inner], *middles]))[0], 3)
        along = np.clip(((corner - a) * (b - a)).sum(1) / np.maximum(((b - a) ** 2).sum(1), 1e-300), 0, 1)
        off = np.linalg.norm(corner - a - along[:, None] * (b - a), axis=1)
        blended[inner[off > SHARE * tolerance_m]] = 0.0
    return timed._replace(blended=blended)
