"""Time-parameterised motion as samples."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from htcp_jax.status import Kind

LINEAR, QUINTIC, STRAIGHT = "linear", "quintic", "straight"  # how players join configurations, see `deviation`

DECIMALS = 9  # of numbers in files


class TimedMotion(NamedTuple):
    """Samples of a motion: configurations, velocities and accelerations with their times."""

    time_s: Float[np.ndarray, "n"]  # increasing times
    x: Float[np.ndarray, "n N"]  # [rad or m]
    velocity: Float[np.ndarray, "n N"]  # [rad/s or m/s]
    acceleration: Float[np.ndarray, "n N"]  # [rad/s2 or m/s2]
    kind: Int8[np.ndarray, "n"]  # `status.Kind` of the segment from the previous row
    target: Int[np.ndarray, "n"]  # target to which the row leads
    joint_names: tuple[str, ...]
    span: Float[np.ndarray, "n 2"] | None = None  # shares of the segment [1], see `Motion`
    # Share of the longer leg next to each configuration in which the program blends its corner; None: unknown.
    blended: Float[np.ndarray, "n"] | None = None  # [1]

    @property
    def is_process(self) -> Bool[np.ndarray, "n"]:
        """True for rows to which the tool follows the path, or stays on it."""
        return np.isin(self.kind, (Kind.PROCESS, Kind.DWELL))

    @property
    def rounded(self) -> "TimedMotion":
        """The motion in steps of 1e-9 rad, m and s, as in files of decimal numbers."""
        numbers = self.time_s, self.x, self.velocity, self.acceleration
        return TimedMotion(*(np.round(values, DECIMALS) + 0.0 for values in numbers), *self[4:])
