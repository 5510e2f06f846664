from . import batch, inserted_goals, methods, registry
from .batch import Progress, start_clearance
from .method import Method

__all__ = [
    "Method",
    "Progress",
    "batch",
    "inserted_goals",
    "methods",
    "registry",
    "start_clearance",
]
