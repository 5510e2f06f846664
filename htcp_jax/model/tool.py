"""A tool that a job mounts on its robot, without changes to the model file."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.types import Triple

ZERO = (0.0, 0.0, 0.0)
LARGEST = 1e6  # [m]; beyond, the tolerance is lost to rounding


@dataclass(frozen=True)
class ToolBody:
    """A capsule of the tool, or with p_m = q_m a sphere: ends of its axis in the flange's frame [m].

    Raises:
        InputError: For a number that is not finite and a radius that is not positive.
    """

    name: str
    p_m: Triple
    q_m: Triple
    radius_m: float

    def __post_init__(self):
        _check_triple("p_m", self.p_m)
        _check_triple("q_m", self.q_m)
        if not 0 < self.radius_m <= LARGEST:
            raise InputError(f"radius_m of {self.name!r} is {self.radius_m} m; it must be more than zero and finite")


@dataclass(frozen=True)
class Tool:
    """A tool on the flange, the frame that would be the TCP without it; all in that frame.

    Attributes:
        tip_m: Position of the TCP.
        tip_rpy_rad: Orientation of the TCP, whose z axis points out of the tool.
        bodies: Collision bodies; a longer tool (`robot.lengthen_tool`) moves them, and lengthens the first. Without
            any, the capsules of the flange's own body are the tool.

    Raises:
        InputError: For a number that is not finite and two bodies of one name.
    """

    tip_m: Triple = ZERO
    tip_rpy_rad: Triple = ZERO
    bodies: tuple[ToolBody, ...] = ()

    def __post_init__(self):
        _check_triple("tip_m", self.tip_m)
        _check_triple("tip_rpy_rad", self.tip_rpy_rad)
        names = [body.name for body in self.bodies]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two bodies are called {name!r}")


def pose(position_m: Triple, rpy_rad: Triple) -> Float[np.ndarray, "4 4"]:
    """Return a frame at `position_m`, rotated by roll, pitch and yaw.

    They are about the fixed axes x, then y, then z, as in a URDF.
    """
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy_rad), np.sin(rpy_rad)
    T = np.eye(4)
    T[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [0.0 - sp, cp * sr, cp * cr],  # never -0.0: a frame without rotation changes no bit of another
    ]
    T[:3, 3] = position_m
    return T


def _check_triple(name: str, value: Triple) -> None:
    if len(value) != 3 or not all(math.isfinite(number) and abs(number) <= LARGEST for number in value):
        raise InputError(f"{name} is {list(value)}; three finite numbers are needed")
