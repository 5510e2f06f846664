from . import batch, inserted_goals, methods, registry
from .batch import Progress
from .method import Method, WarmUp

__all__ = [
    "Method",
    "Progress",
    "WarmUp",
    "batch",
    "inserted_goals",
    "methods",
    "registry",
]
