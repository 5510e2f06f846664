"""Joint motion of a file, and the polynomials of its segments."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

INTERPOLATIONS = ("linear", "cubic", "quintic")


class MotionFile(NamedTuple):
    """Joint motion of a file, as its controller or tool runs it.

    For each of n configurations the robot's N joints are those of `robot.joint_names`, in this order.
    """

    x: Float[np.ndarray, "n N"]  # configurations [rad or m]
    time_s: Float[np.ndarray, "n"] | None  # increasing times; None: the file has none
    velocity: Float[np.ndarray, "n N"] | None  # [rad/s or m/s]; None: the file has none
    acceleration: Float[np.ndarray, "n N"] | None  # [rad/s2 or m/s2]; None: the file has none
    # radius of the zone or blend of the TCP around each configuration; None: the file has none, no corner is cut
    corner_m: Float[np.ndarray, "n"] | None
    line: Int[np.ndarray, "n"]  # line, point, key or row of each configuration in the file, from 1, for messages
    kind: tuple[str, ...] | None  # column `kind` of files that this package wrote; None: the file has none
    interpolation: str  # between configurations: "linear", "cubic" or "quintic"
    format: str  # name of the format
    notes: tuple[str, ...]  # assumptions of the reader and what it did not use, one sentence each
    poses: Float[np.ndarray, "n 4 4"] | None = None  # the TCP's, of formats with poses only [m]; `x` has no rows then
    counted: str = "line"  # what `line` counts: "line", "point", "key" or "row"
    # shares of the leg before and of the leg after each configuration in which its corner is rounded [1], at most half;
    # None: the file has none
    corner_share: Float[np.ndarray, "n 2"] | None = None


def polynomials(motion: MotionFile) -> Float[np.ndarray, "m K N"]:
    """Return the coefficients of each segment, x(s) = sum_i c[k, i] s^i for 0 <= s <= 1.

    Segment k leads from configuration k to k + 1. K is 2 for linear interpolation. It is 4 for cubic and 6 for quintic
    Hermite interpolation, which keep velocities, or velocities and accelerations, at the ends (Biagiotti and
    Melchiorri, Trajectory Planning for Automatic Machines and Robots, sections 2.1.2 and 2.1.3).

    Args:
        motion: The motion [rad or m].

    Raises:
        ValueError: If the motion lacks times or derivatives that its interpolation needs.
    """
    x = motion.x
    d = np.diff(x, axis=0)
    if motion.interpolation == "linear":
        return np.stack([x[:-1], d], axis=1)
    if motion.time_s is None or motion.velocity is None:
        raise ValueError("cubic and quintic interpolation need times and velocities")
    h = np.diff(motion.time_s)[:, None]
    v0, v1 = h * motion.velocity[:-1], h * motion.velocity[1:]
    if motion.interpolation == "cubic":
        return np.stack([x[:-1], v0, 3 * d - 2 * v0 - v1, v0 + v1 - 2 * d], axis=1)
    if motion.acceleration is None:
        raise ValueError("quintic interpolation needs accelerations")
    a0, a1 = h**2 * motion.acceleration[:-1], h**2 * motion.acceleration[1:]
    return np.stack(
        [
            x[:-1],
            v0,
            0.5 * a0,
            10 * d - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1,
            -15 * d + 8 * v0 + 7 * v1 + 1.5 * a0 - a1,
            6 * d - 3 * (v0 + v1) - 0.5 * (a0 - a1),
        ],
        axis=1,
    )
