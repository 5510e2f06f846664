"""The engine's table: one lane per row, every column a numpy array."""

from typing import NamedTuple

import numpy as np

from htcp_jax.clearance import ClearanceRows
from htcp_jax.clearance.obstacles import linearisation

MAIN = -1  # `candidate` of a scenario's main lane, which is not a candidate
# Phases; the phase of a lane in a recovery stage is the stage's number. The last three are for lanes planned
# backwards: configurations are drawn at the failed target, moved back from target to target, and checked.
NEW, TRACK, DRAWING, PUSHING, CHECKING = -2, -1, -3, -4, -5
BACKWARDS = DRAWING, PUSHING, CHECKING
ENTERING = -1  # `null_space_steps` of a lane before its first null-space step
KINDS = linearisation.TaskRows, ClearanceRows


class Lanes(NamedTuple):
    """Table of lanes, one per row."""

    scenario: np.ndarray
    target: np.ndarray
    candidate: np.ndarray  # MAIN, or the number of a candidate
    phase: np.ndarray  # NEW: to be linearised; TRACK: step QPs; else a recovery stage, or a phase of planning backwards
    iteration: np.ndarray  # number of step QPs at this target so far
    null_space_steps: np.ndarray  # number of null-space steps so far, or ENTERING
    x_previous: np.ndarray  # configurations at the previous target [rad or m]
    x_ref: np.ndarray  # current configurations [rad or m]
    linear: linearisation.Linearisation  # task and clearance at x_ref to first order

    @property
    def size(self) -> int:
        """Number of lanes."""
        return len(self.scenario)


def new_lanes(sizes: tuple[int, int], scenario, target, x_previous, x_ref, candidate=MAIN) -> Lanes:
    """Return lanes that start at x_ref.

    Args:
        sizes: Number of values in the task, and of clearance rows.
        scenario: Rows of the scenarios (L,).
        target: Indices of the targets (L,).
        x_previous: Configurations at the previous targets (L, N) [rad or m].
        x_ref: Configurations to start at (L, N) [rad or m].
        candidate: MAIN, or the candidates' numbers (L,).
    """
    lanes, n = x_ref.shape

    def column(value):
        return np.broadcast_to(np.asarray(value, np.int32), lanes).copy()

    linear = linearisation.Linearisation(
        *(kind(np.zeros((lanes, rows)), np.zeros((lanes, rows, n))) for kind, rows in zip(KINDS, sizes, strict=True))
    )
    return Lanes(
        column(scenario), column(target), column(candidate), column(NEW), column(0), column(0),
        np.array(x_previous), np.array(x_ref), linear,
    )  # fmt: skip
