"""Registry of the formats by name."""

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
    """A file format of programs."""

    write: Callable[[TimedMotion, ControllerData], str]
    step_s: float | None  # default time step of samples; None: the motion's own configurations
    external_axes: bool = True  # False: of one arm alone, which stands in the world
    by_group: bool = False  # the joints have no names but places in `JointGroups`


FORMATS = {
    "csv": ProgramFormat(csv_text, 0.001),
    "ros": ProgramFormat(ros_yaml_text, 0.01),
    "ros-json": ProgramFormat(ros_json_text, 0.01),
    "jbi": ProgramFormat(jbi_text, None, external_axes=False),
    "jbi-pulses": ProgramFormat(jbi_pulses_text, None, by_group=True),
    "rapid": ProgramFormat(rapid_text, None, by_group=True),
    "urscript": ProgramFormat(urscript_text, 0.002, external_axes=False),
    "keyframes": ProgramFormat(keyframes_text, 0.01),
}


def format_of(name: str) -> ProgramFormat:
    """Return a format in FORMATS.

    Raises:
        InputError: For another name.
    """
    if name not in FORMATS:
        raise InputError(f"{name!r} is not a format of a program; valid: {', '.join(FORMATS)}")
    return FORMATS[name]


def program_text(format: str, timed: TimedMotion, controller: ControllerData) -> str:
    """Return the file of a program.

    Args:
        format: Name in FORMATS.
        timed: Samples of the motion.
        controller: The job's controller data.

    Raises:
        InputError: For an unknown format, for controller data that the format needs and `controller` lacks, for a
            motion without configurations, and for times that do not increase.
    """
    write = format_of(format).write
    if len(timed.x) == 0:
        raise InputError("a program needs configurations; this motion has none")
    if (late := np.flatnonzero(~(np.diff(timed.time_s) > 0))).size:
        raise InputError(f"configuration {late[0] + 1} comes no later than the one before; times must increase")
    return write(timed, controller)
