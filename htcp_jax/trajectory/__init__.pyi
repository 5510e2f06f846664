from .deviation import Deviation, FileMotion, deviations, joined_configurations, worst_deviation
from .displacement import in_padded_sizes, tcp_at
from .figures import ProgramFigures, Share, program_figures
from .file_motion import points_needed
from .formats.controller_limits import exceeded_limits
from .formats.parts import ProgramFile
from .formats.writers import FORMATS, format_of
from .joint_torques import PeakTorque
from .limits import own_rates, stated_limits
from .limits_file import check_ranges, limits_of_job, limits_overrides
from .plan_program import (
    UNCOUPLED,
    PlanProgram,
    program_of,
    program_of_plans,
    requested_feed,
    requested_feeds,
    with_program,
)
from .program import Program
from .run_timing import check_limits, time_run
from .timed_motion import TimedMotion

__all__ = [
    "FORMATS",
    "UNCOUPLED",
    "Deviation",
    "FileMotion",
    "PeakTorque",
    "PlanProgram",
    "Program",
    "ProgramFigures",
    "ProgramFile",
    "Share",
    "TimedMotion",
    "check_limits",
    "check_ranges",
    "deviations",
    "exceeded_limits",
    "format_of",
    "in_padded_sizes",
    "joined_configurations",
    "limits_of_job",
    "limits_overrides",
    "own_rates",
    "points_needed",
    "program_figures",
    "program_of",
    "program_of_plans",
    "requested_feed",
    "requested_feeds",
    "stated_limits",
    "tcp_at",
    "time_run",
    "with_program",
    "worst_deviation",
]
