from . import devices, kept_executables, lane_function, processes, tables
from .batching import Loop, Remembering
from .chunks import by_chunks
from .compilations import COMPILATIONS
from .executor import LOADING, Executor

__all__ = [
    "COMPILATIONS",
    "LOADING",
    "Executor",
    "Loop",
    "Remembering",
    "by_chunks",
    "devices",
    "kept_executables",
    "lane_function",
    "processes",
    "tables",
]
