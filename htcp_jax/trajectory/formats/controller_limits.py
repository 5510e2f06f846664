"""Publicly known limits of controllers and drivers on the length of a program, with their sources.

Only what a public source states. Limits of memory, which depend on a controller's options, are not included.
"""

from typing import NamedTuple


class ControllerLimit(NamedTuple):
    """Maximum length of a program."""

    formats: tuple[str, ...]  # names of the formats
    most: int
    what: str  # what is counted
    whose: str  # whose limit
    source: str  # address


INFORM_LINES = ControllerLimit(
    ("jbi", "jbi-pulses"),
    9999,
    "lines in a job",
    "Yaskawa NX100",
    "https://www.easymanua.ls/motoman/nx-100/manual?p=77",
)
RAPID_LINES = ControllerLimit(
    ("rapid",),
    5000,
    "lines in a module",
    "default of RoboDK's post processor for ABB IRC5",
    "https://github.com/ros-industrial-attic/robodk_postprocessors",
)
LIMITS = (
    INFORM_LINES,
    RAPID_LINES,
    ControllerLimit(
        ("urscript",),
        1000,
        "targets in a script",
        "reported of a UR10",
        "https://github.com/ros-industrial/universal_robot/issues/411",
    ),
    ControllerLimit(
        ("urscript",),
        2500,
        "targets in a script",
        "reported of a UR5",
        "https://github.com/visose/Robots/issues/55",
    ),
    ControllerLimit(
        ("ros", "ros-json"),
        200,
        "points",
        "MotoROS2",
        "https://github.com/Yaskawa-Global/motoros2#maximum-length-of-trajectories",
    ),
    ControllerLimit(
        ("ros", "ros-json"), 100, "points", "abb_driver", "https://github.com/ros-industrial/abb_driver/issues/20"
    ),
)


def exceeded_limits(format: str, configurations: int) -> list[ControllerLimit]:
    """Return the known limits that a file exceeds and that cannot be satisfied by splitting it.

    Args:
        format: Name of the format.
        configurations: Number of configurations in the file.
    """
    split = (INFORM_LINES, RAPID_LINES)
    return [each for each in LIMITS if format in each.formats and each not in split and configurations > each.most]
