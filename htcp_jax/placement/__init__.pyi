from . import mounting, ranges, tolerance
from .place import PlaceProgress, place
from .placed import Placed

__all__ = [
    "PlaceProgress",
    "Placed",
    "mounting",
    "place",
    "ranges",
    "tolerance",
]
