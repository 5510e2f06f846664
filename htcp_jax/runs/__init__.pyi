from . import (
    checkpoint,
    columns,
    failure_texts,
    finite,
    identity,
    input_files,
    labels,
    manifest,
    open,
    plan_folder,
    provenance,
    reachability_file,
    summary,
    sweep,
    tables,
    timing_file,
)
from .columns import Column
from .indexed import IndexedAxes, indexed_axes
from .motion_summary import MotionSummary, summarise_motion
from .open import PlanSet, open_plans
from .parameters import Parameters, of_job
from .run_folder import Run, open_run
from .running import RunningSummary
from .seam_order import SeamOrder

__all__ = [
    "Column",
    "IndexedAxes",
    "MotionSummary",
    "Parameters",
    "PlanSet",
    "Run",
    "RunningSummary",
    "SeamOrder",
    "checkpoint",
    "columns",
    "failure_texts",
    "finite",
    "identity",
    "indexed_axes",
    "input_files",
    "labels",
    "manifest",
    "of_job",
    "open",
    "open_plans",
    "open_run",
    "plan_folder",
    "provenance",
    "reachability_file",
    "summarise_motion",
    "summary",
    "sweep",
    "tables",
    "timing_file",
]
