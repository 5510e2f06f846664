from . import figures, of_plan
from .formats.writers import FORMATS, format_of
from .loads import Load
from .nudge import tcp_at
from .of_plan import OfPlan
from .program import Program
from .timed import Timed
from .whole_run import check_limits, time_run

__all__ = [
    "FORMATS",
    "Load",
    "OfPlan",
    "Program",
    "Timed",
    "check_limits",
    "figures",
    "format_of",
    "of_plan",
    "tcp_at",
    "time_run",
]
