from . import obstruction
from .obstruction import Obstruction
from .reachability import PROOF_CELLS, RESOLUTION_RAD, Reachability, Stopped, nothing_found, reachable_prefixes

__all__ = [
    "PROOF_CELLS",
    "RESOLUTION_RAD",
    "Obstruction",
    "Reachability",
    "Stopped",
    "nothing_found",
    "obstruction",
    "reachable_prefixes",
]
