from . import (
    arm_poses,
    collision_checker,
    configurations,
    dead_ends,
    home,
    lane_inputs,
    manipulability,
    motion,
    motion_check,
    plans,
    smoothing,
    start_cause,
    start_check,
    step_functions,
    tool_cells,
    transfers,
)
from .collision_checker import CollisionChecker
from .dead_ends import Tried
from .execution import Execution
from .motion import Motion
from .plans import Plans
from .problem import Problem
from .via_points import ViaPoints

__all__ = [
    "CollisionChecker",
    "Execution",
    "Motion",
    "Plans",
    "Problem",
    "Tried",
    "ViaPoints",
    "arm_poses",
    "collision_checker",
    "configurations",
    "dead_ends",
    "home",
    "lane_inputs",
    "manipulability",
    "motion",
    "motion_check",
    "plans",
    "smoothing",
    "start_cause",
    "start_check",
    "step_functions",
    "tool_cells",
    "transfers",
]
