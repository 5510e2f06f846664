from . import memo, obstruction
from .each_target import EachTarget, Reach
from .memo import Memo
from .obstruction import Obstruction
from .reachability import (
    PROOF_CELLS,
    RESOLUTION_RAD,
    Reachability,
    reachable_prefixes,
)
from .tool_clearance import ToolClearance, tool_clearances

__all__ = [
    "PROOF_CELLS",
    "RESOLUTION_RAD",
    "EachTarget",
    "Memo",
    "Obstruction",
    "Reach",
    "Reachability",
    "ToolClearance",
    "memo",
    "obstruction",
    "reachable_prefixes",
    "tool_clearances",
]
