from . import mounting, ranges, tolerance
from .place import PlaceProgress, place
from .placement_result import PlacementResult

__all__ = [
    "PlaceProgress",
    "PlacementResult",
    "mounting",
    "place",
    "ranges",
    "tolerance",
]
