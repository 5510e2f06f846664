from . import figures, plan_program
from .displacement import tcp_at
from .formats.writers import FORMATS, format_of
from .joint_torques import PeakTorque
from .limits_file import check_ranges, limits_of_job, limits_overrides
from .plan_program import PlanProgram
from .program import Program
from .run_timing import check_limits, time_run
from .timed_motion import TimedMotion

__all__ = [
    "FORMATS",
    "PeakTorque",
    "PlanProgram",
    "Program",
    "TimedMotion",
    "check_limits",
    "check_ranges",
    "figures",
    "format_of",
    "limits_of_job",
    "limits_overrides",
    "plan_program",
    "tcp_at",
    "time_run",
]
