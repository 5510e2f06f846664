from . import lanes, null_space, stages
from .engine import Engine
from .step_qps import StepQPs

__all__ = [
    "Engine",
    "StepQPs",
    "lanes",
    "null_space",
    "stages",
]
