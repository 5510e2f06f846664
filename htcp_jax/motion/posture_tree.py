"""The postures of a roadmap: clear, on target, each connected to a root by proven motions; tables with a row each."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.device.tables import gather

NO_PARENT = -1
LEAST = 4096  # rows that a table has room for


class Posture(NamedTuple):
    """Where a lane is, and how it stands to its target; or many of them, a row each."""

    x: jax.Array  # [rad or m]
    clearance: jax.Array  # [m]
    residual: jax.Array  # [m]
    tcp: jax.Array  # world [m]


class Nodes(NamedTuple):
    """Postures, and the way to each from its parent."""

    at: Posture
    target: Int[np.ndarray, "n"]
    parent: Int[np.ndarray, "n"]  # its row; NO_PARENT of a root
    walked: Bool[np.ndarray, "n"]  # whether it is passed on a walk in its target's null space, or was fed to its target
    step_qps: Int[np.ndarray, "n"]
    dwells: Int[np.ndarray, "n"]  # changes of posture on the path so far
    cost: Float[np.ndarray, "n"]  # of the way so far, equation (3): the sum of |x_{t+1} - x_t|^2 [rad2]


class Tree:
    """Nodes with a parent each, in tables that grow."""

    def __init__(self, table: Any):
        self._table, self._count = table, len(table.parent)

    def __len__(self) -> int:
        return self._count

    def add(self, nodes: Any) -> Int[np.ndarray, "m"]:
        """Add nodes and return their rows."""
        first, count = self._count, self._count + len(nodes.parent)
        if count > len(self._table.parent):
            self._table = jax.tree.map(lambda column: _longer(column[:first], 2 * count), self._table)

        def write(column, new):
            column[first:count] = new

        jax.tree.map(write, self._table, nodes)
        self._count = count
        return np.arange(first, count)

    def path(self, row: int) -> Int[np.ndarray, "k"]:
        """Return the rows from the root to a node."""
        rows, parent = [row], self._table.parent
        while (row := int(parent[row])) != NO_PARENT:
            rows.append(row)
        return np.array(rows[::-1])


class BeamTree(Tree):
    """All postures of some searches. Those that lead nowhere are forgotten in time."""

    def __init__(self, joints: int):
        at = Posture(*(np.empty((LEAST, *shape)) for shape in ((joints,), (), (), (3,))))
        whole = (np.empty(LEAST, kind) for kind in (np.int32, np.int64, bool, np.int32, np.int32))
        super().__init__(Nodes(at, *whole, np.empty(LEAST)))
        self._count, self._kept = 0, LEAST

    @property
    def x(self) -> Float[np.ndarray, "n N"]:
        """The postures [rad or m]."""
        return self._table.at.x[: self._count]

    @property
    def target(self) -> Int[np.ndarray, "n"]:
        """At which each of them is."""
        return self._table.target[: self._count]

    def nodes(self, rows: Int[np.ndarray, "m"]) -> Nodes:
        """Some of them."""
        return gather(self._table, rows)

    def plant(self, at: Posture, target: int) -> Int[np.ndarray, "m"]:
        """Roots at a target; returns their rows."""
        none = np.full(len(at.x), NO_PARENT)
        return self.add(Nodes(at, none * 0 + target, none, none > 0, none * 0, none * 0, np.zeros(len(none))))

    def grow(
        self, parent: Int[np.ndarray, "m"], at: Posture, target, step_qps=0, walked: bool = False, dwells=0
    ) -> Int[np.ndarray, "m"]:
        """A child of each parent, at a target; returns their rows. walked: see `Nodes`. dwells: changes of posture that
        begin on the way from the parent."""
        step, zero = at.x - self.x[parent], np.zeros_like(parent)
        dwells = self._table.dwells[parent] + dwells
        cost = self._table.cost[parent] + (step * step).sum(axis=1)
        return self.add(Nodes(at, zero + target, parent, np.full(len(parent), walked), zero + step_qps, dwells, cost))

    @property
    def is_overgrown(self) -> bool:
        """Whether there are twice as many as when the tree was pruned last."""
        return self._count > 2 * self._kept

    def prune(self, rows: Int[np.ndarray, "m"]) -> Int[np.ndarray, "n"]:
        """Forget all but these and their ancestors; returns the new row of each that was there."""
        alive, parent = np.zeros(self._count, bool), self._table.parent
        while len(rows):
            alive[rows] = True
            rows = np.unique(parent[rows])
            rows = rows[rows != NO_PARENT]
            rows = rows[~alive[rows]]
        moved = np.cumsum(alive) - 1
        kept = gather(self._table, np.flatnonzero(alive))
        kept.parent[:] = np.where(kept.parent == NO_PARENT, NO_PARENT, moved[kept.parent])
        self._table, self._count = kept, len(kept.parent)
        self._kept = max(LEAST, self._count)
        return moved


def _longer(column: np.ndarray, room: int) -> np.ndarray:
    longer = np.empty((room, *column.shape[1:]), column.dtype)
    longer[: len(column)] = column
    return longer
