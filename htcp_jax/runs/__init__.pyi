from . import (
    columns,
    identity,
    input_files,
    labels,
    manifest,
    motion_summary,
    open,
    parameters,
    plan_folder,
    provenance,
    reachability_file,
    summary,
    sweep,
    tables,
    timing_file,
)
from .columns import Column
from .open import PlanSet, open_plans
from .run_folder import Run, open_run
from .running import RunningSummary

__all__ = [
    "Column",
    "PlanSet",
    "Run",
    "RunningSummary",
    "columns",
    "identity",
    "input_files",
    "labels",
    "manifest",
    "motion_summary",
    "open",
    "open_plans",
    "open_run",
    "parameters",
    "plan_folder",
    "provenance",
    "reachability_file",
    "summary",
    "sweep",
    "tables",
    "timing_file",
]
