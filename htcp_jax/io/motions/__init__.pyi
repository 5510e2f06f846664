from .job_controller import JobController, controller_of
from .motion_file import INTERPOLATIONS, MotionFile, polynomials
from .reading import MOTION_FORMATS, read_motion

__all__ = [
    "INTERPOLATIONS",
    "MOTION_FORMATS",
    "JobController",
    "MotionFile",
    "controller_of",
    "polynomials",
    "read_motion",
]
