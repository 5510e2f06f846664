from .job_controller import JobController, JointGroups, controller_of, coupled_axes, joint_groups
from .motion_file import INTERPOLATIONS, MotionFile, polynomials
from .reading import MOTION_FORMATS, read_motion

__all__ = [
    "INTERPOLATIONS",
    "MOTION_FORMATS",
    "JobController",
    "JointGroups",
    "MotionFile",
    "controller_of",
    "coupled_axes",
    "joint_groups",
    "polynomials",
    "read_motion",
]
