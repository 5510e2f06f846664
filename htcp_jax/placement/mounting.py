"""Data of a mounting that completes the path, and of its tolerance to placement error."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

RANKED, MOUNTINGS = "ranked.json", "mountings.parquet"  # files in a search's folder, see `placement_result`
UNITS = {"clearance": ("mm", 1e3), "cycle time": ("s", -1.0), "joint motion": ("rad", -1.0)}  # display unit, factor


class MountingResults(NamedTuple):
    """Results of planning n mountings."""

    complete: Bool[np.ndarray, "n"]  # True if a proven motion leads to the end of every seam
    objective: Float[np.ndarray, "n A"]  # larger is better; -inf if the mounting is not complete


class PlacementTolerance(NamedTuple):
    """Tolerance of a mounting to placement error: the largest tested perturbation at which it stays complete."""

    together: float  # for all parameters at once, in multiples of `perturbation` [1]; 0: the smallest level failed
    alone: Float[np.ndarray, "d"]  # for each parameter with all others fixed, in the parameter's unit


class PartDepth(NamedTuple):
    """Depth of the part in a solid of the cell, less the depth in the job as given."""

    depth_m: float = 0.0
    solid: str = ""  # name of the solid; "": none


class Mounting(NamedTuple):
    """A mounting that completes the path by a proven motion."""

    row: int  # row in the results of the stage `confirmed`
    values: Float[np.ndarray, "d"]  # parameters, each in the job's unit
    margin_m: float  # margin with which its motions were planned
    objective: Float[np.ndarray, "A"]  # objectives, larger is better [m; s or rad, negated]
    worst: Float[np.ndarray, "A"]  # worst when perturbed [m; s or rad, negated]; -inf: one failed, NaN: unknown
    success_rate: float  # share of perturbed mountings that complete the path [1]; NaN: unknown
    pareto_front: bool  # True if on the Pareto front
    tolerance: PlacementTolerance | None  # None if it was not determined
    inside: PartDepth = PartDepth()  # the part in a solid of the cell
