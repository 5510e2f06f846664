"""Styles for pictures of a plan: marker styles by target status, and colours of the arm, the wall and curves."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int8

from htcp_jax.model import Robot
from htcp_jax.motion import plans
from htcp_jax.status import Kind, SegmentStatus, Status

LINKS, TOOL, INK, PAPER, FAILED = "#8d99a6", "#3c6e71", "#22303c", "#ffffff", "#c8102e"
NEAREST, DWELL, HERE = "#b5179e", "#0b8f6a", "#f6c945"  # colours of the minimum clearance, dwells, the displayed target
WALL = "#8a7a5f", "#d9cfba", "#efe9dc"  # colours of the wall at the cut, halfway, and at the largest depth
OUTSIDE = "#a3917a"  # colour of the wall's outside
FIXTURE = "#5b7fb4"  # colour of other obstacles
NORMAL = "#7a4fbf"  # colour of the path's normals
QUIET, RULE = "#5d6b77", "#dfe3e6"  # colours of text next to a plot, and of grid lines
KINDS = {
    Kind.TRANSFER: "#8d99a6",
    Kind.APPROACH: "#b8860b",
    Kind.PROCESS: "#1f6fb4",
    Kind.DWELL: DWELL,
    Kind.RETRACT: "#a0569c",
}
JOINTS = "#0072b2 #e69f00 #009e73 #d55e00 #56b4e9 #cc79a7 #999933 #332288".split()  # colours in joint order


class TargetStyle(NamedTuple):
    """Marker style of the targets with one status; colours are safe for colour-blind readers."""

    name: str
    where: Bool[np.ndarray, "T"]
    colour: str
    size: float  # marker area [points^2]
    marker: str


def target_styles(status: Int8[np.ndarray, "T"]) -> list[TargetStyle]:
    """Return a marker style for each status of the targets; the failed target's is last, so it is drawn on top."""
    failed = ~plans.is_tracked(status) & (status != Status.NOT_ATTEMPTED)
    return [
        TargetStyle("not attempted", status == Status.NOT_ATTEMPTED, "#9aa3ab", 10, "o"),
        TargetStyle("tracked", status == Status.TRACKED, "#1f6fb4", 16, "o"),
        TargetStyle("tracked after a recovery", status == Status.TRACKED_AFTER_RECOVERY, "#e8890c", 34, "D"),
        TargetStyle("failed", failed, FAILED, 130, "X"),
    ]


def verdict_styles(verdict: Int8[np.ndarray, "T"]) -> list[TargetStyle]:
    """Return a marker style for each verdict on the segments to a file's configurations; refuted ones are last."""
    undecided, proven = verdict == SegmentStatus.UNDECIDED, verdict == SegmentStatus.VALID
    return [
        TargetStyle("proven", proven, "#1f6fb4", 16, "o"),
        TargetStyle("undecided", undecided, "#e8890c", 34, "D"),
        TargetStyle("refuted", ~proven & ~undecided, FAILED, 34, "X"),
    ]


def is_tool(robot: Robot) -> Bool[np.ndarray, "K"]:
    """Return a mask of the robot's capsules, True for the tool's."""
    return np.asarray(robot.on_tool).any(axis=1)


def joint_colour(joint: int) -> str:
    """Return the colour of a joint's curve; colours repeat if there are more joints than colours."""
    return JOINTS[joint % len(JOINTS)]


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, of a colour given as "#rrggbb"."""
    return tuple(int(colour[k : k + 2], 16) for k in (1, 3, 5))
