from . import gate
from .baseline import Baseline, read_baseline, update_baseline
from .result import STEP_RAD, Validation
from .timed_check import check_timed
from .validate import validate_results, validation_record, write_validation

__all__ = [
    "STEP_RAD",
    "Baseline",
    "Validation",
    "check_timed",
    "gate",
    "read_baseline",
    "update_baseline",
    "validate_results",
    "validation_record",
    "write_validation",
]
