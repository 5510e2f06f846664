from . import batch, extensions, methods, registry
from .batch import Progress
from .inserted_goals import LostPlace, lost_place
from .method import Method, WarmUp

__all__ = [
    "LostPlace",
    "Method",
    "Progress",
    "WarmUp",
    "batch",
    "extensions",
    "lost_place",
    "methods",
    "registry",
]
