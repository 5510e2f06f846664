from . import devices, kept_executables, lane_function, processes, tables
from .batching import Loop
from .chunks import by_chunks
from .executor import EXECUTABLES, Executor

__all__ = [
    "EXECUTABLES",
    "Executor",
    "Loop",
    "by_chunks",
    "devices",
    "kept_executables",
    "lane_function",
    "processes",
    "tables",
]
