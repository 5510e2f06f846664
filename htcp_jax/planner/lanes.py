"""The engine's table: a lane a row, every column a numpy array. What holds for lanes holds for any tree of tables."""

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import jax
import numpy as np

from htcp_jax.clearance.linearisation import Linearisation, TaskRows
from htcp_jax.clearance.obstacles import ClearanceRows

MAIN = -1  # `candidate` of a lane that tracks for its scenario itself
# Phases; of a lane that is in a stage of its escape, the phase is the number of that stage. The last three are those of
# a lane that is planned backwards: postures are drawn at its lost target, carried back row by row, and checked.
NEW, TRACK, DRAWING, PUSHING, CHECKING = -2, -1, -3, -4, -5
BACKWARDS = DRAWING, PUSHING, CHECKING
ENTERING = -1  # `walked` of a lane that is not in the null space yet
KINDS = TaskRows, ClearanceRows
Tables = TypeVar("Tables")


class Lanes(NamedTuple):
    """Lanes, one row each."""

    scenario: np.ndarray
    target: np.ndarray
    candidate: np.ndarray  # MAIN, or the number of a candidate
    phase: np.ndarray  # NEW: to be linearised; TRACK: by step QPs; a stage of the escape; or of the way back
    iteration: np.ndarray  # step QPs at this target so far
    walked: np.ndarray  # ENTERING, or null-space steps so far
    x_previous: np.ndarray
    x_ref: np.ndarray
    linear: Linearisation

    @property
    def size(self) -> int:
        """How many lanes."""
        return len(self.scenario)


def new_lanes(sizes: tuple[int, int], scenario, target, x_previous, x_ref, candidate=MAIN) -> Lanes:
    """Lanes that start at x_ref (L, N); sizes: values that the task looks at, rows of the clearance."""
    lanes, n = x_ref.shape

    def column(value):
        return np.broadcast_to(np.asarray(value, np.int32), lanes).copy()

    linear = Linearisation(
        *(kind(np.zeros((lanes, rows)), np.zeros((lanes, rows, n))) for kind, rows in zip(KINDS, sizes, strict=True))
    )
    return Lanes(
        column(scenario), column(target), column(candidate), column(NEW), column(0), column(0),
        np.array(x_previous), np.array(x_ref), linear,
    )  # fmt: skip


def gather(tables: Tables, rows) -> Tables:
    """Some of the rows: the tables themselves where a mask leaves none out."""
    if isinstance(rows, np.ndarray) and rows.dtype == bool:
        if rows.all():
            return tables
        rows = np.flatnonzero(rows)  # counted once, not for every table
    return jax.tree.map(lambda table: table[rows], tables)


def concatenate(parts: Sequence[Tables]) -> Tables:
    """The rows of all parts, one or more."""
    return parts[0] if len(parts) == 1 else jax.tree.map(lambda *tables: np.concatenate(tables), *parts)


def scatter(tables: Tables, rows, new: Tables) -> Tables:
    """Copies of the tables with new rows in place of some."""

    def replaced(table, part):
        table = table.copy()
        table[rows] = part
        return table

    return jax.tree.map(replaced, tables, new)
