from .displacement import in_padded_sizes, tcp_at
from .figures import ProgramFigures, Share, program_figures
from .formats.writers import FORMATS, format_of
from .joint_torques import PeakTorque
from .limits import stated_limits
from .limits_file import check_ranges, limits_of_job, limits_overrides
from .plan_program import PlanProgram, program_of, program_of_plans, requested_feed, with_program
from .program import Program
from .run_timing import check_limits, time_run
from .timed_motion import TimedMotion

__all__ = [
    "FORMATS",
    "PeakTorque",
    "PlanProgram",
    "Program",
    "ProgramFigures",
    "Share",
    "TimedMotion",
    "check_limits",
    "check_ranges",
    "format_of",
    "in_padded_sizes",
    "limits_of_job",
    "limits_overrides",
    "program_figures",
    "program_of",
    "program_of_plans",
    "requested_feed",
    "stated_limits",
    "tcp_at",
    "time_run",
    "with_program",
]
