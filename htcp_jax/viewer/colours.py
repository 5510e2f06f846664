"""Styles that pictures of a plan share: targets by status, and the colours of the arm, the wall and the curves."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int8

from htcp_jax.model import Robot
from htcp_jax.motion import plans
from htcp_jax.status import Kind, Status

LINKS, TOOL, INK, PAPER, FAILED = "#8d99a6", "#3c6e71", "#22303c", "#ffffff", "#c8102e"
NEAREST, DWELL, HERE = "#b5179e", "#0b8f6a", "#f6c945"  # minimum clearance, dwells, the displayed target
WALL = "#8a7a5f", "#d9cfba", "#efe9dc"  # at the cut, and lighter with depth
OUTSIDE = "#a3917a"  # of the wall
FIXTURE = "#5b7fb4"  # other obstacles
NORMAL = "#7a4fbf"  # of the path
QUIET, RULE = "#5d6b77", "#dfe3e6"  # text next to a plot, lines behind it
KINDS = {
    Kind.TRANSFER: "#8d99a6",
    Kind.APPROACH: "#b8860b",
    Kind.PROCESS: "#1f6fb4",
    Kind.DWELL: DWELL,
    Kind.RETRACT: "#a0569c",
}
JOINTS = "#0072b2", "#e69f00", "#009e73", "#d55e00", "#56b4e9", "#cc79a7", "#999933", "#332288"  # in order


class TargetStyle(NamedTuple):
    """Targets of one status, distinguished by colour (for colour-blind readers, too) and by marker."""

    name: str
    where: Bool[np.ndarray, "T"]
    colour: str
    size: float  # [points^2]
    marker: str


def target_styles(status: Int8[np.ndarray, "T"]) -> list[TargetStyle]:
    """Styles of the targets by status; the failed one last, on top."""
    failed = ~plans.is_tracked(status) & (status != Status.NOT_ATTEMPTED)
    return [
        TargetStyle("not attempted", status == Status.NOT_ATTEMPTED, "#9aa3ab", 10, "o"),
        TargetStyle("tracked", status == Status.TRACKED, "#1f6fb4", 16, "o"),
        TargetStyle("tracked after a recovery", status == Status.TRACKED_AFTER_RECOVERY, "#e8890c", 34, "D"),
        TargetStyle("failed", failed, FAILED, 130, "X"),
    ]


def is_tool(robot: Robot) -> Bool[np.ndarray, "K"]:
    """Mask of the tool's capsules."""
    return np.asarray(robot.on_tool).any(axis=1)


def joint_colour(joint: int) -> str:
    """Colour of the joint's curve; repeated for an arm with many joints."""
    return JOINTS[joint % len(JOINTS)]


def rgb(colour: str) -> tuple[int, int, int]:
    """Convert #rrggbb to three numbers up to 255."""
    return tuple(int(colour[k : k + 2], 16) for k in (1, 3, 5))
