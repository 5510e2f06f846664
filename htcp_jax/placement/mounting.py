"""A mounting that does the whole work, and how far it may be off."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

RANKED, MOUNTINGS = "ranked.json", "mountings.parquet"  # of a search's folder, see `placed`
UNITS = {"clearance": ("mm", 1e3), "cycle time": ("s", -1.0), "joint motion": ("rad", -1.0)}  # as a person reads them


class Answer(NamedTuple):
    """What n mountings come to."""

    complete: Bool[np.ndarray, "n"]  # whether a proven motion leads to the end of every seam
    spare: Float[np.ndarray, "n A"]  # of each aim, larger is better; -inf where a mounting is not complete


class Tolerance(NamedTuple):
    """Of one mounting."""

    together: float  # [1] how often `off` all parameters may be off at once; 0: not even the least that was tried
    alone: Float[np.ndarray, "d"]  # by how much each one may be, with the others as they are, in its own unit


class Mounting(NamedTuple):
    """One that does the whole work, as a proven motion."""

    row: int  # of `confirmed`
    values: Float[np.ndarray, "d"]  # of the parameters, each in its unit in the job
    margin_m: float  # that its motions are planned with
    spare: Float[np.ndarray, "A"]  # of each aim, larger is better [m, or less than 0 s or rad]
    worst: Float[np.ndarray, "A"]  # the worst disturbed mounting's [m, s or rad]; -inf: one is lost, NaN: not known yet
    held: float  # [1] share of the disturbed mountings that are complete; NaN: not known yet
    front: bool  # whether none of the others is better in every aim
    tolerance: Tolerance | None  # of the first few
