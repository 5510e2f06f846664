"""Registry of the robot program formats by name."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.trajectory.controller_data import ControllerData
from htcp_jax.trajectory.formats.as_csv import csv_text
from htcp_jax.trajectory.formats.as_jbi import jbi_pulses_text, jbi_text
from htcp_jax.trajectory.formats.as_keyframes import keyframes_text
from htcp_jax.trajectory.formats.as_rapid import rapid_text
from htcp_jax.trajectory.formats.as_ros import ros_json_text, ros_yaml_text
from htcp_jax.trajectory.formats.as_urscript import urscript_text
from htcp_jax.trajectory.timed_motion import TimedMotion


class ProgramFormat(NamedTuple):
    """File format of robot programs."""

    write: Callable[[TimedMotion, ControllerData], str]
    step_s: float | None  # default time step of samples; None: the motion's own configurations
    external_axes: bool = True  # False: the format supports only an arm that is fixed in the world
    by_group: bool = False  # True: the format has no joint names, but orders joints as in `JointGroups`
    # joints of an arm with joints that follow others: those that it may contain, the default first
    axes: tuple[str, ...] = ("commanded",)


FORMATS = {
    "csv": ProgramFormat(csv_text, 0.001, axes=("commanded", "all")),
    "ros": ProgramFormat(ros_yaml_text, 0.01, axes=("commanded", "all")),
    "ros-json": ProgramFormat(ros_json_text, 0.01, axes=("commanded", "all")),
    "jbi": ProgramFormat(jbi_text, None, external_axes=False),
    "jbi-pulses": ProgramFormat(jbi_pulses_text, None, by_group=True),
    "rapid": ProgramFormat(rapid_text, None, by_group=True),
    "urscript": ProgramFormat(urscript_text, 0.002, external_axes=False),
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
            configurations, or if times do not increase.
    """
    write = format_of(format).write
    if len(timed.x) == 0:
        raise InputError("the motion has no configurations: no target is executable")
    if (late := np.flatnonzero(~(np.diff(timed.time_s) > 0))).size:
        raise InputError(
            f"the time of configuration {late[0] + 1} is not later than the previous one; times must increase"
        )
    return write(timed, controller)
