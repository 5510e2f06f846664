from . import (
    bisection,
    branch_exclusion,
    error_bound,
    error_pairs,
    error_scene,
    exclusion,
    joint_path,
    known_rows,
    margin,
    motion_proof,
    row_proof,
)
from .motion_bound import OUTSIDE_M, ROUNDING_M, arm_points, lever_bounds

__all__ = [
    "OUTSIDE_M",
    "ROUNDING_M",
    "arm_points",
    "bisection",
    "branch_exclusion",
    "error_bound",
    "error_pairs",
    "error_scene",
    "exclusion",
    "joint_path",
    "known_rows",
    "lever_bounds",
    "margin",
    "motion_proof",
    "row_proof",
]
