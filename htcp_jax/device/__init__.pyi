from . import compile_cache, devices, lane_function, processes, tables
from .batching import Loop
from .chunks import by_chunks
from .executor import EXECUTABLES, Executor

__all__ = [
    "EXECUTABLES",
    "Executor",
    "Loop",
    "by_chunks",
    "compile_cache",
    "devices",
    "lane_function",
    "processes",
    "tables",
]
