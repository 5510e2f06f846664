from . import obstruction
from .obstruction import Obstruction
from .reachability import PROOF_CELLS, RESOLUTION_RAD, Reachability, SearchStopped, nothing_found, reachable_prefixes

__all__ = [
    "PROOF_CELLS",
    "RESOLUTION_RAD",
    "Obstruction",
    "Reachability",
    "SearchStopped",
    "nothing_found",
    "obstruction",
    "reachable_prefixes",
]
