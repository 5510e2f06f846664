from . import (
    arm_poses,
    collision_checker,
    configurations,
    home,
    lane_inputs,
    manipulability,
    motion,
    motion_check,
    plans,
    smoothing,
    sparse_columns,
    start_cause,
    start_check,
    step_functions,
    tool_cells,
    transfers,
)
from .collision_checker import CollisionChecker
from .motion import Motion
from .plans import Plans
from .problem import Execution, Problem
from .sparse_columns import Tried, ViaPoints

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
    "home",
    "lane_inputs",
    "manipulability",
    "motion",
    "motion_check",
    "plans",
    "smoothing",
    "sparse_columns",
    "start_cause",
    "start_check",
    "step_functions",
    "tool_cells",
    "transfers",
]
