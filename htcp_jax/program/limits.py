"""How fast joints may move: velocity, acceleration and jerk, each a column a joint."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.scene.robot import Robot

FULL_SPEED_S, FULL_ACCELERATION_S = 0.2, 0.1


class Limits(NamedTuple):
    """Of N joints, either way."""

    velocity: Float[np.ndarray, "N"]  # [rad/s or m/s]
    acceleration: Float[np.ndarray, "N"]  # [rad/s2 or m/s2]
    jerk: Float[np.ndarray, "N"]  # [rad/s3 or m/s3]

    def shares(
        self,
        velocity: Float[np.ndarray, "n N"],
        acceleration: Float[np.ndarray, "n N"],
        jerk: Float[np.ndarray, "n N"],
    ) -> Float[np.ndarray, "n M"]:
        """By how much time must be stretched at n instants for each of M = 3 N limits to be kept, joint by joint; 1 or
        less where it is."""
        v, a, j = np.abs(velocity), np.abs(acceleration), np.abs(jerk)
        found = [v / self.velocity, np.sqrt(a / self.acceleration), np.cbrt(j / self.jerk)]
        return np.stack(found, axis=2).reshape(len(v), -1)


def joint_limits(
    robot: Robot, full_speed_s: float = FULL_SPEED_S, full_acceleration_s: float = FULL_ACCELERATION_S
) -> Limits:
    """Those of an arm: its own accelerations where the model states them, else full speed in `full_speed_s`; full
    acceleration in `full_acceleration_s`.

    Raises InputError for a joint without a velocity limit, and for times that are not above 0.
    """
    for name, value in (("full_speed_s", full_speed_s), ("full_acceleration_s", full_acceleration_s)):
        if not 0 < value < np.inf:
            raise InputError(f"{name} is {value}, a time above 0 s is needed")
    velocity = np.asarray(robot.speed, float)
    for name, speed in zip(robot.joint_names, velocity, strict=True):
        if not 0 < speed < np.inf:
            raise InputError(
                f"{robot.name} has no velocity limit of joint {name}; its <numeric> speed gives one a joint"
            )
    own = np.asarray(robot.acceleration, float)
    acceleration = np.where(np.isfinite(own), own, velocity / full_speed_s)
    return Limits(velocity, acceleration, acceleration / full_acceleration_s)
