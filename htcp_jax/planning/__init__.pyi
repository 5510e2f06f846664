from . import batch, methods, registry
from .batch import Progress, start_clearance
from .method import Method

__all__ = [
    "Method",
    "Progress",
    "batch",
    "methods",
    "registry",
    "start_clearance",
]
