"""A motion with time."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Int8


class Timed(NamedTuple):
    """Postures that an arm passes, and when."""

    time_s: Float[np.ndarray, "n"]  # increasing
    x: Float[np.ndarray, "n N"]  # [rad or m]
    velocity: Float[np.ndarray, "n N"]  # [rad/s or m/s]
    acceleration: Float[np.ndarray, "n N"]  # [rad/s2 or m/s2]
    kind: Int8[np.ndarray, "n"]  # `status.Kind`: what the arm does on its way to this row from the one before
    target: Int[np.ndarray, "n"]  # to which the row leads
    joint_names: tuple[str, ...]
