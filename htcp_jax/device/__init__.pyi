from . import compile_cache, devices, kernel, processes, tables
from .batching import Loop
from .programs import Kernels
from .stretches import by_stretches

__all__ = [
    "Kernels",
    "Loop",
    "by_stretches",
    "compile_cache",
    "devices",
    "kernel",
    "processes",
    "tables",
]
