from .job_controller import (
    EncoderScale,
    JobController,
    JointGroups,
    controller_of,
    coupled_axes,
    encoder_scale,
    joint_groups,
    values_per_joint,
)
from .motion_file import INTERPOLATIONS, MotionFile, polynomials
from .reading import MOTION_FORMATS, read_motion

__all__ = [
    "INTERPOLATIONS",
    "MOTION_FORMATS",
    "EncoderScale",
    "JobController",
    "JointGroups",
    "MotionFile",
    "controller_of",
    "coupled_axes",
    "encoder_scale",
    "joint_groups",
    "polynomials",
    "read_motion",
    "values_per_joint",
]
