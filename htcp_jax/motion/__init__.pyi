from . import (
    collision_checker,
    front,
    home,
    kernels,
    lane_inputs,
    motion,
    motion_check,
    plans,
    posture_tree,
    smoothing,
    transfers,
)
from .collision_checker import CollisionChecker
from .knots import Knots
from .motion import Motion
from .plans import Plans
from .problem import Problem

__all__ = [
    "CollisionChecker",
    "Knots",
    "Motion",
    "Plans",
    "Problem",
    "collision_checker",
    "front",
    "home",
    "kernels",
    "lane_inputs",
    "motion",
    "motion_check",
    "plans",
    "posture_tree",
    "smoothing",
    "transfers",
]
