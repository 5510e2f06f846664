from . import build, grid, grid_axes, grid_points
from .cell_shapes import shapes_in_world
from .load_config import load_config, seeded, with_kinds

__all__ = [
    "build",
    "grid",
    "grid_axes",
    "grid_points",
    "load_config",
    "seeded",
    "shapes_in_world",
    "with_kinds",
]
