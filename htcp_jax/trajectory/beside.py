"""What a program needs beside its motion: names, numbers and tables of the controller that will run it."""

import datetime
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.trajectory.timed import Timed


class UserFrame(NamedTuple):
    """Where the TCP is, in a frame that the controller knows by number."""

    number: int
    T_frame_tcp: Float[np.ndarray, "n 4 4"]  # [m]
    # Of the arm's postures that share such a pose, which: six numbers, 0 or 1, in the order of INFORM's RCONF (no flip,
    # lower arm, rear, and R, T and S of 180 degrees or more).
    form: Int[np.ndarray, "n 6"]


class Pulses(NamedTuple):
    """How a controller counts."""

    per_unit: Float[np.ndarray, "N"]  # [1/rad or 1/m]; negative where the controller's joint turns the other way
    zero: Float[np.ndarray, "N"]  # joint values at which it counts 0 [rad or m]
    source: str  # of these numbers, in words


class Beside(NamedTuple):
    """What the job says beside the motion. A format that lacks something asks for it."""

    name: str  # of the program
    slides: tuple[bool, ...]  # which joints do
    speed: Float[np.ndarray, "N"] | None = None  # the controller's full joint speeds [rad/s or m/s]
    tool: int = 0  # its number at the controller
    user_frame: UserFrame | None = None
    pulses: Pulses | None = None
    date: datetime.datetime | None = None  # to stand in the file
    control_step_s: float = 0.002  # of the controller


def header(timed: Timed, *more: str) -> list[str]:
    """What every file says of itself, a sentence a line. more: what its format does not hold, either."""
    duration_s = timed.time_s[-1] - timed.time_s[0]
    return [
        f"{len(timed.x)} postures of {len(timed.joint_names)} joints, {duration_s:.3f} s.",
        "Not in this file: tool data (TCP, mass, centre of gravity), frames (where base, user frame and part are), "
        "signals (process on and off, gas, gripper), safety (limits, zones, stops, what to do on contact).",
        "The way to the first posture, and any other course or time than these, is not proven clear.",
        *more,
    ]
