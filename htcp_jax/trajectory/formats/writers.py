"""Registry of the robot program formats by name."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.trajectory.controller_data import ControllerData
from htcp_jax.trajectory.formats.as_csv import csv_text
from htcp_jax.trajectory.formats.as_jbi import jbi_files, jbi_pulses_files, jbi_pulses_text, jbi_text
from htcp_jax.trajectory.formats.as_keyframes import keyframes_text
from htcp_jax.trajectory.formats.as_krl import krl_text
from htcp_jax.trajectory.formats.as_ls import ls_text
from htcp_jax.trajectory.formats.as_rapid import rapid_files, rapid_text
from htcp_jax.trajectory.formats.as_ros import ros_json_text, ros_yaml_text
from htcp_jax.trajectory.formats.as_urscript import urscript_text
from htcp_jax.trajectory.formats.parts import ProgramFile
from htcp_jax.trajectory.timed_motion import LINEAR, QUINTIC, TimedMotion


class ProgramFormat(NamedTuple):
    """File format of robot programs."""

    write: Callable[[TimedMotion, ControllerData], str]
    step_s: float | None  # default time step of samples; None: the motion's own configurations
    external_axes: bool = True  # False: the format supports only an arm that is fixed in the world
    by_group: bool = False  # True: the format has no joint names, but orders joints as in `JointGroups`
    # joints of an arm with joints that follow others: those that it may contain, the default first
    axes: tuple[str, ...] = ("commanded",)
    joined: tuple[str, ...] = (LINEAR,)  # how players join samples, see `deviation`
    files: Callable[[TimedMotion, ControllerData], list[ProgramFile]] | None = None  # None: the format has one file
    outputs: bool = False  # True: the format can set digital outputs
    whole_corners: bool = False  # True: a rounded corner may extend to the middles of its legs


FORMATS = {
    "csv": ProgramFormat(csv_text, 0.001, axes=("commanded", "all"), joined=(LINEAR, QUINTIC)),
    "ros": ProgramFormat(ros_yaml_text, 0.01, axes=("commanded", "all"), joined=(LINEAR, QUINTIC)),
    "ros-json": ProgramFormat(ros_json_text, 0.01, axes=("commanded", "all"), joined=(LINEAR, QUINTIC)),
    "jbi": ProgramFormat(jbi_text, None, external_axes=False, files=jbi_files, outputs=True),
    "jbi-pulses": ProgramFormat(jbi_pulses_text, None, by_group=True, files=jbi_pulses_files, outputs=True),
    "rapid": ProgramFormat(rapid_text, None, by_group=True, files=rapid_files, outputs=True),
    "krl": ProgramFormat(krl_text, None, by_group=True, outputs=True),
    "ls": ProgramFormat(ls_text, None, by_group=True, outputs=True, whole_corners=True),
    "urscript": ProgramFormat(urscript_text, 0.002, external_axes=False, outputs=True),
    "keyframes": ProgramFormat(keyframes_text, 0.01, axes=("all",)),
}


def format_of(name: str) -> ProgramFormat:
    """Return the format with a name in FORMATS.

    Raises:
        InputError: If the name is unknown.
    """
    if name not in FORMATS:
        raise InputError(f"{name!r} is not a program format; valid: {', '.join(FORMATS)}")
    return FORMATS[name]


def program_text(format: str, timed: TimedMotion, controller: ControllerData) -> str:
    """Return the text of a program's file.

    Args:
        format: Name of the format in FORMATS.
        timed: Samples of the motion.
        controller: The job's controller data.

    Raises:
        InputError: If the format is unknown, if controller data that the format needs are missing, if the motion has no
            configurations, if times do not increase, or if one job of INFORM cannot have so many lines.
    """
    write = format_of(format).write
    _check_times(timed)
    return write(timed, controller)


def program_files(format: str, timed: TimedMotion, controller: ControllerData) -> list[ProgramFile]:
    """Return the files of a program: one, or a main file and its parts if the format limits a file's length.

    Args:
        format: Name of the format in FORMATS.
        timed: Samples of the motion.
        controller: The job's controller data.

    Raises:
        InputError: As `program_text` raises it, except for too many lines.
    """
    own = format_of(format)
    _check_times(timed)
    if own.files is None:
        return [ProgramFile("", own.write(timed, controller), range(len(timed.x)))]
    return own.files(timed, controller)


def _check_times(timed: TimedMotion) -> None:
    if len(timed.x) == 0:
        raise InputError("the motion has no configurations: no target is executable")
    if (late := np.flatnonzero(~(np.diff(timed.time_s) > 0))).size:
        raise InputError(
            f"the time of configuration {late[0] + 1} is not later than the previous one; times must increase"
        )
