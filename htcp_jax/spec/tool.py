"""A tool that a job mounts on its robot, without changes to the model file."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.types import Triple

ZERO = (0.0, 0.0, 0.0)
LARGEST = 1e6  # largest length [m]; the rounding of larger ones exceeds the tolerance


@dataclass(frozen=True)
class ToolBody:
    """A capsule of the tool, by the ends of its axis in the flange's frame [m]; a sphere if p_m = q_m.

    Raises:
        InputError: For a number that is not finite, and for a radius that is not positive.
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
    """A tool that is mounted on the flange; all values are in the flange's frame, which is the TCP without a tool.

    Attributes:
        tip_m: Position of the TCP.
        tip_rpy_rad: Orientation of the TCP, whose z axis points out of the tool.
        bodies: Collision bodies. `robot.lengthen_tool` moves these bodies, and lengthens the first one. If there are
            none, the capsules of the flange's own body are treated as the tool.

    Raises:
        InputError: For a number that is not finite, and for two bodies with the same name.
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
                raise InputError(f"two bodies are named {name!r}; names must be unique")


def pose(position_m: Triple, rpy_rad: Triple) -> Float[np.ndarray, "4 4"]:
    """Return the pose of a frame at `position_m`, rotated by roll, pitch and yaw.

    The rotations are about the fixed axes x, then y, then z, as in a URDF.
    """
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy_rad), np.sin(rpy_rad)
    T = np.eye(4)
    T[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [0.0 - sp, cp * sr, cp * cr],  # never -0.0: multiplying by a frame without rotation then changes no bit
    ]
    T[:3, 3] = position_m
    return T


def _check_triple(name: str, value: Triple) -> None:
    if len(value) != 3 or not all(math.isfinite(number) and abs(number) <= LARGEST for number in value):
        raise InputError(f"{name} is {list(value)}; it must be three finite numbers")
