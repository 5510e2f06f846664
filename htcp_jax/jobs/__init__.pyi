from . import build, grid_axes, seam_scenarios
from .batch import Batch, PlannerInputs
from .cell_shapes import shapes_in_world
from .draws import chosen_numbers, drawn_numbers
from .grid import Sweep, load_sweep, load_sweep_or_job
from .grid_points import points_of
from .load_config import load_config, seeded, source_of, with_kinds
from .resolve import resolve, with_weights
from .seam_keys import TargetTask, margin_of, seam_of_rows, tasks_of_targets

__all__ = [
    "Batch",
    "PlannerInputs",
    "Sweep",
    "TargetTask",
    "build",
    "chosen_numbers",
    "drawn_numbers",
    "grid_axes",
    "load_config",
    "load_sweep",
    "load_sweep_or_job",
    "margin_of",
    "points_of",
    "resolve",
    "seam_of_rows",
    "seam_scenarios",
    "seeded",
    "shapes_in_world",
    "source_of",
    "tasks_of_targets",
    "with_kinds",
    "with_weights",
]
