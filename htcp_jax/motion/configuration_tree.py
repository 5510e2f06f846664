"""Trees of configurations in tables with one row per node."""

from typing import Any

import jax
import numpy as np
from jaxtyping import Int

NO_PARENT = -1


class Tree:
    """A tree of nodes, each with one parent, in tables that grow as needed."""

    def __init__(self, table: Any):
        self._table, self._count = table, len(table.parent)

    def __len__(self) -> int:
        return self._count

    def add(self, nodes: Any) -> Int[np.ndarray, "m"]:
        """Add nodes to the tree and return the indices of their rows."""
        first, count = self._count, self._count + len(nodes.parent)
        if count == first:
            return np.arange(first, count)  # the caller's first table, with the root, may be read-only
        if count > len(self._table.parent):
            self._table = jax.tree.map(lambda column: _longer(column[:first], 2 * count), self._table)

        def write(column, new):
            column[first:count] = new

        jax.tree.map(write, self._table, nodes)
        self._count = count
        return np.arange(first, count)

    def path(self, row: int) -> Int[np.ndarray, "k"]:
        """Return the indices of the rows from the root to a node."""
        rows, parent = [row], self._table.parent
        while (row := int(parent[row])) != NO_PARENT:
            rows.append(row)
        return np.array(rows[::-1])


def _longer(column: np.ndarray, length: int) -> np.ndarray:
    longer = np.empty((length, *column.shape[1:]), column.dtype)
    longer[: len(column)] = column
    return longer
