"""A mounting that completes the path, and its tolerance to placement error."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

RANKED, MOUNTINGS = "ranked.json", "mountings.parquet"  # of a search's folder, see `placement_result`
UNITS = {"clearance": ("mm", 1e3), "cycle time": ("s", -1.0), "joint motion": ("rad", -1.0)}  # for display


class MountingResults(NamedTuple):
    """Results of planning n mountings."""

    complete: Bool[np.ndarray, "n"]  # True if a proven motion leads to the end of every seam
    objective: Float[np.ndarray, "n A"]  # of each objective, larger is better; -inf if the mounting is not complete


class PlacementTolerance(NamedTuple):
    """Tolerance of one mounting to placement error."""

    together: float  # [1] for all parameters at once, in multiples of `perturbation`; 0: even the smallest level failed
    alone: Float[np.ndarray, "d"]  # for each parameter with the others fixed, in its own unit


class Mounting(NamedTuple):
    """A mounting that completes the path by a proven motion."""

    row: int  # of `confirmed`
    values: Float[np.ndarray, "d"]  # of the parameters, each in its unit in the job
    margin_m: float  # margin of its motions
    objective: Float[np.ndarray, "A"]  # of each objective, larger is better [m, or less than 0 s or rad]
    worst: Float[np.ndarray, "A"]  # worst case under perturbation [m, s or rad]; -inf: one fails, NaN: not known yet
    success_rate: float  # [1] success rate of the perturbed mountings; NaN: not known yet
    pareto_front: bool  # True if on the Pareto front
    tolerance: PlacementTolerance | None  # of the first few
