from . import build, grid, grid_axes, grid_points
from .cell_shapes import shapes_in_world
from .load_config import load_config, seeded, source_of, with_kinds
from .resolve import resolve, with_weights

__all__ = [
    "build",
    "grid",
    "grid_axes",
    "grid_points",
    "load_config",
    "resolve",
    "seeded",
    "shapes_in_world",
    "source_of",
    "with_kinds",
    "with_weights",
]
