from . import build, config, config_file, examples, feed, given_kinds, grid, grid_axes, grid_points
from .config import PlanConfig
from .load_config import load_config, seeded, with_kinds

__all__ = [
    "PlanConfig",
    "build",
    "config",
    "config_file",
    "examples",
    "feed",
    "given_kinds",
    "grid",
    "grid_axes",
    "grid_points",
    "load_config",
    "seeded",
    "with_kinds",
]
