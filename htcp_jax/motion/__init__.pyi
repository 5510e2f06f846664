from . import (
    arm_poses,
    configurations,
    joint_search,
    lane_inputs,
    manipulability,
    measured_rows,
    motion,
    motion_check,
    plans,
    raised_bounds,
    segment_tubes,
    smoothing,
    start_cause,
    step_functions,
    tool_cells,
    transfers,
)
from .collision_checker import CollisionChecker, prove_call
from .home import begin_at_home, leave_home, most_draws
from .motion import Motion
from .plans import Plans, Retract
from .problem import Execution, Problem
from .sparse_columns import DeadEnds, Tried, ViaPoints
from .start_check import start_contact

__all__ = [
    "CollisionChecker",
    "DeadEnds",
    "Execution",
    "Motion",
    "Plans",
    "Problem",
    "Retract",
    "Tried",
    "ViaPoints",
    "arm_poses",
    "begin_at_home",
    "configurations",
    "joint_search",
    "lane_inputs",
    "leave_home",
    "manipulability",
    "measured_rows",
    "most_draws",
    "motion",
    "motion_check",
    "plans",
    "prove_call",
    "raised_bounds",
    "segment_tubes",
    "smoothing",
    "start_cause",
    "start_contact",
    "step_functions",
    "tool_cells",
    "transfers",
]
