"""A timed curve as arrays: what every program file is written from."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Int8


class Timed(NamedTuple):
    """n instants of a motion of N joints; the times rise, and the arm stands at both ends."""

    time_s: Float[np.ndarray, "n"]
    x: Float[np.ndarray, "n N"]  # [rad or m]
    velocity: Float[np.ndarray, "n N"]  # [rad/s or m/s]
    acceleration: Float[np.ndarray, "n N"]  # [rad/s2 or m/s2]
    kind: Int8[np.ndarray, "n"]  # `status.Kind`: what the arm does then
    joint_names: tuple[str, ...]
    target: Int[np.ndarray, "n"]  # to which it is on its way
