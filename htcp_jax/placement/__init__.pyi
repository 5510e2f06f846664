from . import mounting, ranges, tolerance
from .place import place
from .placement_result import PlacementResult
from .progress import PlaceProgress

__all__ = [
    "PlaceProgress",
    "PlacementResult",
    "mounting",
    "place",
    "ranges",
    "tolerance",
]
