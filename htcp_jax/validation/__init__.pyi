from . import gate
from .baseline import Baseline, bless, read_baseline
from .result import STEP_RAD, Validation
from .timed_check import check_timed
from .validate import record, validate, write_validation

__all__ = [
    "STEP_RAD",
    "Baseline",
    "Validation",
    "bless",
    "check_timed",
    "gate",
    "read_baseline",
    "record",
    "validate",
    "write_validation",
]
