from . import batch, extensions, methods, registry
from .batch import Progress
from .inserted_goals import LostPlace, lost_place
from .method import Method, WarmUp
from .refused_segment import RefusedSegment, refused_segment

__all__ = [
    "LostPlace",
    "Method",
    "Progress",
    "RefusedSegment",
    "WarmUp",
    "batch",
    "extensions",
    "lost_place",
    "methods",
    "refused_segment",
    "registry",
]
