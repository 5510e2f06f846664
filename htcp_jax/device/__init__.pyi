from . import devices, kept_executables, lane_function, processes, tables
from .batching import Loop, Remembering
from .chunks import by_chunks
from .executor import Executor

__all__ = [
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
