"""Controller data that a program needs in addition to its motion: names, numbers and tables."""

import datetime
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.trajectory.timed_motion import TimedMotion


class UserFrame(NamedTuple):
    """A numbered frame of the controller, with poses of the TCP in it."""

    number: int
    T_frame_tcp: Float[np.ndarray, "n 4 4"]  # [m]
    # Arm configuration flags, which select one of the IK solutions: six numbers, 0 or 1, in the order of INFORM's RCONF
    # (no flip, lower arm, rear, and R, T and S of 180 degrees or more).
    flags: Int[np.ndarray, "n 6"]


class Pulses(NamedTuple):
    """Encoder scale of a controller."""

    per_unit: Float[np.ndarray, "N"]  # [1/rad or 1/m]; negative for an opposite direction of rotation
    zero: Float[np.ndarray, "N"]  # joint values at 0 pulses [rad or m]
    source: str  # of these numbers, as text


class JointGroups(NamedTuple):
    """Columns of a motion's joints in the controller's groups, each in the controller's order."""

    robot: tuple[int, ...]
    base: tuple[int, ...] = ()  # axes that carry the robot
    station: tuple[int, ...] = ()  # axes of the positioner

    @property
    def external(self) -> tuple[int, ...]:
        """Columns of all joints that are not the robot's."""
        return self.base + self.station


class ControllerData(NamedTuple):
    """The job's controller data. A format raises InputError for missing entries that it needs."""

    name: str  # of the program
    slides: tuple[bool, ...]  # True for sliding joints
    speed: Float[np.ndarray, "N"] | None = None  # the controller's full joint speeds [rad/s or m/s]
    tool: int = 0  # its number at the controller
    user_frame: UserFrame | None = None
    pulses: Pulses | None = None
    groups: JointGroups | None = None  # None: all joints are the robot's
    date: datetime.datetime | None = None  # to write into the file
    control_step_s: float = 0.002  # of the controller
    in_file: tuple[int, ...] | None = None  # the joints and the locked ones in the order of the file; None: the same
    locked: Mapping[str, float] = MappingProxyType({})  # positions of joints that do not move [rad or m]

    @property
    def joint_groups(self) -> JointGroups:
        """The groups; without any, all joints are the robot's."""
        return self.groups or JointGroups(tuple(range(len(self.slides))))


def header(timed: TimedMotion, *more: str) -> list[str]:
    """Return the header of every file, one sentence per line; `more` are further sentences of the format."""
    duration_s = timed.time_s[-1] - timed.time_s[0]
    return [
        f"{len(timed.x)} configurations of {len(timed.joint_names)} joints, {duration_s:.3f} s.",
        "Not in this file: tool data (TCP, mass, centre of gravity), frames (where base, user frame and part are), "
        "signals (process on and off, gas, gripper), safety (limits, zones, stops, what to do on contact).",
        "The motion to the first configuration, and any other path or timing than this one, is not proven clear.",
        *more,
    ]
