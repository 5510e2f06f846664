"""A motion's file with what is needed to read it, and the rows that a format's reader returns."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, NoReturn, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.errors import InputError
from htcp_jax.io.motions.job_controller import EncoderScale, JointGroups
from htcp_jax.model import Robot

DEG = np.pi / 180
ANGLES = {"rad": 1.0, "deg": DEG}
LENGTHS = {"m": 1.0, "mm": 1e-3}
LARGEST = 1e100  # numbers of this magnitude or more count as infinite
ROBOT_AXES = 6
MOST_LISTED = 300  # maximum number of characters of a list of names in a message


@runtime_checkable
class Controller(Protocol):
    """Controller data that a file's joint values need; `trajectory.ControllerData` has these fields."""

    @property
    def coupled(self) -> tuple[tuple[int, int], ...]:
        """Indices of coupled axes and of the joints that are added to them."""

    @property
    def pulses(self) -> EncoderScale | None:
        """Encoder scale."""

    @property
    def groups(self) -> JointGroups | None:
        """Joint groups; None: all joints are the robot's."""

    @property
    def in_file(self) -> tuple[int, ...] | None:
        """Index of each joint of the model file, counted over the robot's joints, its followers and `locked`."""

    @property
    def locked(self) -> Mapping[str, float]:
        """Values of joints that do not move [rad or m], by name."""

    @property
    def j3_from(self) -> str:
        """Origin of the count of a FANUC arm's joint 3: "upper_arm" or "horizontal"."""


class Source(NamedTuple):
    """A motion's file, its content, and what it is read for."""

    file: Path
    data: bytes
    robot: Robot
    controller: Controller
    unit: str | None  # of angles: "deg" or "rad"; None: as the file or its format states
    joints: tuple[str, ...] = ()  # names in the file of the robot's joints, in their order; empty: the robot's names

    @property
    def text(self) -> str:
        """The content as text.

        Raises:
            InputError: If it is not UTF-8.
        """
        try:
            return self.data.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            line = self.data.count(b"\n", 0, error.start) + 1
            raise InputError(f"{self.file}, line {line}: it is not UTF-8 text") from None

    def fail(self, line: int, message: str) -> NoReturn:
        """Raise an InputError that names a line.

        Raises:
            InputError: Always.
        """
        self.fail_at(f"line {line}", message)

    def fail_at(self, place: str, message: str) -> NoReturn:
        """Raise an InputError that names a place in the file, such as "point 3".

        Raises:
            InputError: Always.
        """
        raise InputError(f"{self.file}, {place}: {message}")

    def check_unit(self, format: str, holds: str) -> None:
        """Check the requested unit of angles against the one of a format.

        Raises:
            InputError: If they differ.
        """
        if self.unit is not None and self.unit != holds:
            raise InputError(f"{self.file}: {format} holds {holds}; --unit {self.unit} contradicts that")

    def check_joints(self) -> None:
        """Check the names of joints that are stated for the file.

        Raises:
            InputError: For another number of names than the robot has joints, and for a name that is empty or repeated.
        """
        given, robot = self.joints, self.robot
        if len(given) != robot.dof:
            own = f"{robot.name} has {robot.dof} joints: {listed(robot.joint_names)}"
            raise InputError(f"--joints has {len(given)} names: {listed(given)}; {own}")
        if wrong := [name for name in given if not name or given.count(name) > 1]:
            what = f"{wrong[0]!r} {given.count(wrong[0])} times" if wrong[0] else "an empty name"
            raise InputError(f"--joints has {what}; a different name is needed for each of {listed(robot.joint_names)}")

    def renamed(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return names in the file with the robot's names in place of those in `joints`.

        Raises:
            InputError: If the file lacks one of them.
        """
        if lacking := [name for name in self.joints if name not in names]:
            raise InputError(f"{self.file}: --joints names {listed(lacking)}; names in the file: {listed(names)}")
        own = dict(zip(self.joints, self.robot.joint_names, strict=False))
        return tuple(own.get(name, name) for name in names)

    def advice(self, names: Sequence[str]) -> str:
        """Return text that advises to pass --joints with names of the file; "" if their number is not the robot's."""
        if self.joints or len(names) != self.robot.dof:
            return ""
        option = ",".join(f'"{name}"' if "," in name else name for name in names)
        return f"; if these are the joints in the robot's order, pass --joints {shlex.quote(option)}"

    def check_robot(self, holder: str) -> None:
        """Check that the job's group of the robot has six joints, as a format for robots with six axes needs.

        Args:
            holder: What has the values of the robot's axes in the format.

        Raises:
            InputError: If it has another number of joints.
        """
        if (count := len(self.groups[0])) != ROBOT_AXES:
            raise InputError(
                f"{self.file}: a robot of {count} joints; {holder} has {ROBOT_AXES}; set program.groups to the joints "
                "of robot, base and station"
            )

    def check_uncoupled(self, format: str) -> None:
        """Check that the job couples no axes, which only RAPID's writer and reader support.

        Raises:
            InputError: If it does.
        """
        if self.controller.coupled:
            raise InputError(f"{self.file}: {format} does not support program.coupled; remove the key, or use rapid")

    @property
    def groups(self) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]:
        """Indices of the joints of robot, base and station."""
        if (groups := self.controller.groups) is None:
            return tuple(range(self.robot.dof)), (), ()
        return groups.robot, groups.base, groups.station


class Rows(NamedTuple):
    """Rows of a file, with values in the file's units."""

    names: tuple[str, ...]  # joints of the M columns
    values: Float[np.ndarray, "n M"]  # in the file's units
    line: Int[np.ndarray, "n"]
    scale: Float[np.ndarray, "M"] | None = None  # units of the columns [rad or m]; None: 1
    time_s: Float[np.ndarray, "n"] | None = None
    velocity: Float[np.ndarray, "n M"] | None = None  # [rad/s or m/s]
    acceleration: Float[np.ndarray, "n M"] | None = None  # [rad/s2 or m/s2]
    corner_m: Float[np.ndarray, "n"] | None = None
    kind: tuple[str, ...] | None = None
    interpolation: str = "linear"  # as the format's controller runs it
    notes: tuple[str, ...] = ()
    poses: Float[np.ndarray, "n 4 4"] | None = None  # [m]
    counted: str = "line"  # what `line` counts
    relative_rounding: float | None = None  # of numbers that are not written in decimals [1]
    corner_share: Float[np.ndarray, "n 2"] | None = None  # see `MotionFile`


def listed(names: Sequence[str]) -> str:
    """Return names as text, cut if it is long."""
    text = ", ".join(names)
    return text if len(text) <= MOST_LISTED else f"{text[:MOST_LISTED]}..."


def corners(radii_m: Sequence[float]) -> Float[np.ndarray, "n"] | None:
    """Return the radii of corners as an array; None if all are 0."""
    return np.array(radii_m, float) if any(radii_m) else None


def elapsed(durations_s: Sequence[float | None]) -> Float[np.ndarray, "n"] | None:
    """Return the times from the first configuration [s]; None if a duration after the first one is unknown.

    Args:
        durations_s: Duration of the move to each configuration [s]; None: unknown. The first one is not used.
    """
    known = [each for each in durations_s[1:] if each is not None]
    return np.cumsum([0.0, *known]) if len(known) == len(durations_s) - 1 and known else None
