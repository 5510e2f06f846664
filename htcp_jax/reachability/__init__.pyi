from . import obstruction
from .each_target import EachTarget, Reach
from .obstruction import Obstruction
from .reachability import (
    PROOF_CELLS,
    RESOLUTION_RAD,
    Reachability,
    SearchStopped,
    initial_reachability,
    reachable_prefixes,
)

__all__ = [
    "PROOF_CELLS",
    "RESOLUTION_RAD",
    "EachTarget",
    "Obstruction",
    "Reach",
    "Reachability",
    "SearchStopped",
    "initial_reachability",
    "obstruction",
    "reachable_prefixes",
]
