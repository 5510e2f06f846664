"""Data of a robot controller that a program file needs in addition to the motion: names, numbers and tables."""

import datetime
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.io.motions import EncoderScale, JointGroups
from htcp_jax.trajectory.timed_motion import TimedMotion


class UserFrame(NamedTuple):
    """Numbered user frame of the controller, with the TCP's poses and arm configuration flags at n samples."""

    number: int
    T_frame_tcp: Float[np.ndarray, "n 4 4"]  # [m]
    # Arm configuration flags, which select one of the IK solutions: six numbers, 0 or 1, in the order of INFORM's
    # RCONF: no flip, lower arm, rear, and R, T and S of 180 degrees or more.
    flags: Int[np.ndarray, "n 6"]


BEGIN = -1  # row before the first one


class PlannedTcp(NamedTuple):
    """Planned TCP, and the name of the frame to which its pose is relative."""

    frame: str
    T_frame_tcp: Float[np.ndarray, "4 4"]  # [m]


class SeamSpan(NamedTuple):
    """Rows of a file between which the tool follows a seam."""

    name: str
    first: int  # row of the seam's first point
    last: int  # row of its last point; `first` for a seam of one point


class ProcessOutputs(NamedTuple):
    """Digital outputs, by number or name, and the values to which a program sets them."""

    on: tuple[tuple[int | str, bool], ...] = ()  # at the first point of each seam
    off: tuple[tuple[int | str, bool], ...] = ()  # at the last point of each seam, and at the program's begin


class ControllerData(NamedTuple):
    """Controller data of a job; a format raises InputError if an entry that it needs is missing."""

    name: str  # name of the program
    slides: tuple[bool, ...]  # True for sliding joints
    speed: Float[np.ndarray, "N"] | None = None  # the controller's full joint speeds [rad/s or m/s]
    tool: int = 0  # the tool's number at the controller
    tool_name: str | None = None  # the tool's name at the controller; None: derived from the number
    tcp: PlannedTcp | None = None
    coupled: tuple[tuple[int, int], ...] = ()  # indices of a coupled axis and of the joint that is added to it
    user_frame: UserFrame | None = None
    pulses: EncoderScale | None = None
    groups: JointGroups | None = None  # None: all joints are the robot's
    date: datetime.datetime | None = None  # date to write into the file
    control_step_s: float = 0.002  # time step of the controller
    # index of each joint of the model file, counted over the motion's joints and then `locked`; None: same order
    in_file: tuple[int, ...] | None = None
    locked: Mapping[str, float] = MappingProxyType({})  # values of joints that do not move [rad or m], by name
    seams: tuple[SeamSpan, ...] = ()  # seams in the file, in order
    process: ProcessOutputs = ProcessOutputs()
    j3_from: str = "upper_arm"  # where joint 3 of a FANUC arm is counted from: "upper_arm" or "horizontal"

    def outputs_after(self, row: int) -> list[tuple[int | str, bool]]:
        """Return the outputs that are set at a row of the file, in order; at row BEGIN those before any motion."""
        if row == BEGIN:
            return list(self.process.off) if self.seams else []
        ends = [seam for seam in self.seams if seam.last == row] if self.process.off else []
        begins = [seam for seam in self.seams if seam.first == row] if self.process.on else []
        points = [seam for seam in begins if seam in ends]
        before = [output for seam in ends if seam not in points for output in self.process.off]
        return [*before, *(output for _ in begins for output in self.process.on),
                *(output for _ in points for output in self.process.off)]  # fmt: skip

    @property
    def rows_with_outputs(self) -> frozenset[int]:
        """Rows of the file at which outputs are set."""
        begins = {seam.first for seam in self.seams} if self.process.on else set()
        return frozenset(begins | ({seam.last for seam in self.seams} if self.process.off else set()))

    @property
    def joint_groups(self) -> JointGroups:
        """The joint groups; if `groups` is None, the robot's group contains all joints."""
        return self.groups or JointGroups(tuple(range(len(self.slides))))


# Line in the header of formats that contain joint values for controllers of one manufacturer.
CHECK_AXES = (
    "Joint values are those of the model; check signs, zeros and coupled axes (parallel linkages) against the "
    "controller."
)


def header(timed: TimedMotion, *more: str, outputs: bool = False) -> list[str]:
    """Return the lines of a file's header, one sentence per line.

    Args:
        timed: Samples in the file.
        more: The format's own sentences.
        outputs: True if the file sets the outputs of `program.process`.
    """
    signals = "other signals than those of program.process" if outputs else "signals (process on and off, gas, gripper)"
    duration_s = timed.time_s[-1] - timed.time_s[0]
    return [
        f"{len(timed.x)} configurations of {len(timed.joint_names)} joints, {duration_s:.3f} s.",
        "Not in this file: tool data (TCP, mass, centre of gravity), frames (where base, user frame and part are), "
        f"{signals}, safety (limits, zones, stops, what to do on contact).",
        "The motion to the first configuration, and any other path or timing than this one, is not proven clear.",
        *more,
    ]
