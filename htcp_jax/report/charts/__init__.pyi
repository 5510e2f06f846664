from .along_path import clearance_along, joint_motion, joint_motion_by_joint, manipulability_along, stops, survival
from .motion_proof import proof_chart
from .placement import place_map
from .rates import success_rates
from .success import Axis, success, success_line, success_map, success_slices

__all__ = [
    "Axis",
    "clearance_along",
    "joint_motion",
    "joint_motion_by_joint",
    "manipulability_along",
    "place_map",
    "proof_chart",
    "stops",
    "success",
    "success_line",
    "success_map",
    "success_rates",
    "success_slices",
    "survival",
]
