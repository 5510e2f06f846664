"""The formats by name."""

from collections.abc import Callable

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.program.as_csv import csv_text
from htcp_jax.program.as_jbi import jbi_pulses_text, jbi_text
from htcp_jax.program.as_keyframes import keyframes_text
from htcp_jax.program.as_ros import ros_json_text, ros_yaml_text
from htcp_jax.program.as_urscript import urscript_text
from htcp_jax.program.beside import Beside
from htcp_jax.program.timed import Timed

FORMATS: dict[str, Callable[[Timed, Beside], str]] = {
    "csv": csv_text,
    "ros-yaml": ros_yaml_text,
    "ros-json": ros_json_text,
    "jbi": jbi_text,
    "jbi-pulses": jbi_pulses_text,
    "urscript": urscript_text,
    "mujoco": keyframes_text,
}


def program_text(format: str, timed: Timed, beside: Beside) -> str:
    """The file of a program, in one of FORMATS.

    Raises InputError for an unknown format, for what a format needs and `beside` lacks, for a motion without postures,
    and for times that do not increase.
    """
    if format not in FORMATS:
        raise InputError(f"{format!r} is no format of a program; valid: {', '.join(FORMATS)}")
    if len(timed.x) == 0:
        raise InputError("a program needs postures; this motion has none")
    if (late := np.flatnonzero(~(np.diff(timed.time_s) > 0))).size:
        raise InputError(f"posture {late[0] + 1} comes no later than the one before; times must increase")
    return FORMATS[format](timed, beside)
