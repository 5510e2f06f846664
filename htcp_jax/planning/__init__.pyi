from . import batch, extensions, inserted_goals, methods, registry
from .batch import Progress
from .method import Method, WarmUp

__all__ = [
    "Method",
    "Progress",
    "WarmUp",
    "batch",
    "extensions",
    "inserted_goals",
    "methods",
    "registry",
]
