from . import arrays, motions, parts, robots
from .cell import THIN_M, files_of_cell, load_cell, read_meshes, thickness_m

__all__ = [
    "THIN_M",
    "arrays",
    "files_of_cell",
    "load_cell",
    "motions",
    "parts",
    "read_meshes",
    "robots",
    "thickness_m",
]
