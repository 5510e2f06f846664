"""Sets of configurations: selection of those that are far apart, and trees.

Among configurations close to each other, `dispersed` selects only the best. It works on many searches at once: rows
with the same number belong to one search, and searches do not influence each other. A `Tree` has tables with one row
per node.
"""

from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from htcp_jax.numerics import ragged_rows

NO_PARENT = -1
BLOCK = 64  # number of rows that `first_apart` compares at a time


def dispersed(
    x: Float[np.ndarray, "n N"],
    search: Int[np.ndarray, "n"],
    most: int,
    apart: float,
    known: tuple[Float[np.ndarray, "m N"], Int[np.ndarray, "m"]] | None = None,
) -> Int[np.ndarray, "k"]:
    """Return the indices of up to `most` configurations per search, all at least `apart` from each other.

    Among configurations close to each other, the first is selected. Configurations close to a known one are not
    selected. If more than `most` remain, farthest-point selection selects among them.

    Args:
        x: Configurations [rad], search by search, best first.
        search: Number of each row's search, 0 or more.
        most: Maximum number of configurations per search.
        apart: Minimum distance [rad].
        known: Configurations that are already selected, and the numbers of their searches.

    Returns:
        The indices in the order of the rows.
    """
    count, every, number = 0, x, search
    if known is not None:
        count, every, number = len(known[1]), np.concatenate([known[0], x]), np.concatenate([known[1], search])
    order = np.argsort(number, kind="stable")  # in each search, known configurations come first
    kept = np.empty(len(every), bool)
    kept[order] = _kept_apart(every[order], number[order], order < count, apart)
    places = order[kept[order] & (order >= count)] - count
    first = np.flatnonzero(np.diff(search[places], prepend=-1))
    lengths = np.diff(np.append(first, len(places)))
    many = np.flatnonzero(lengths > most)
    if len(many):
        chosen = np.ones(len(places), bool)
        group, nth = ragged_rows(lengths[many])
        rows = first[many][group] + nth
        chosen[rows] = _farthest_first(x[places[rows]], group, nth, most, apart) >= 0
        places = places[chosen]
    return places


def _farthest_first(
    x: Float[np.ndarray, "n N"], group: Int[np.ndarray, "n"], nth: Int[np.ndarray, "n"], most: int, apart: float
) -> Int[np.ndarray, "n"]:
    """Return each row's place in the order of farthest-point selection in its group, from 0; -1 if it is not selected.

    The first row of a group is selected first.

    Args:
        x: Configurations [rad].
        group: Number of each row's group, 0 or more, in ascending order.
        nth: Number of each row in its group.
        most: Maximum number of rows per group.
        apart: Minimum distance [rad].
    """
    row = np.zeros((group[-1] + 1, nth.max() + 1), int)
    row[group, nth] = np.arange(len(x))
    joints, every = _by_joint(x, row), np.arange(len(row))
    place, distance = np.full(row.shape, -1), np.full(row.shape, -1.0)  # distance -1: there is no such row
    distance[group, nth] = np.inf
    farthest = np.zeros(len(row), int)
    for k in range(most):
        going = distance[every, farthest] >= apart
        place[every[going], farthest[going]] = k
        distance = np.minimum(distance, _distance(joints, joints[:, every, farthest, None]))
        farthest = np.argmax(distance, axis=1)
    return place[group, nth]


def _by_joint(x: Float[np.ndarray, "n N"], row: Int[np.ndarray, "G K"]) -> Float[np.ndarray, "N G K"]:
    """Return a table of configurations for each joint, as NumPy is faster along long axes."""
    return np.stack([x[:, joint][row] for joint in range(x.shape[1])])


def _distance(a: Float[np.ndarray, "N G #K"], b: Float[np.ndarray, "N G #K"]) -> Float[np.ndarray, "G K"]:
    """Return the distances of configurations [rad]."""
    apart = a - b
    return np.sqrt(np.square(apart, out=apart).sum(axis=0))


def _kept_apart(
    x: Float[np.ndarray, "n N"], search: Int[np.ndarray, "n"], known: np.ndarray, apart: float
) -> np.ndarray:
    """Return True for the rows to keep: the known ones, and those that are not near an earlier kept row.

    Rows must be sorted by search. The k-th rows of all searches are compared at once.
    """
    first = np.flatnonzero(np.diff(search, prepend=-1))
    count = np.diff(np.append(first, len(x)))
    by_count = np.argsort(-count, kind="stable")
    first, count = first[by_count], count[by_count]
    row = first[:, None] + np.arange(count.max(initial=0))  # rows of each search's k-th configuration
    row = np.minimum(row, len(x) - 1)
    joints, kept = _by_joint(x, row), known[row]
    for k in range(row.shape[1]):
        longer = np.searchsorted(-count, -k, side="left")  # number of searches with more than k rows
        if not kept[:longer, k].all():
            away = _distance(joints[:, :longer, :k], joints[:, :longer, k : k + 1])
            kept[:longer, k] |= ~((away < apart) & kept[:longer, :k]).any(axis=1)
    found = np.zeros(len(x), bool)
    there = np.arange(row.shape[1]) < count[:, None]
    found[row[there]] = kept[there]
    return found


def farthest_first(x: Float[np.ndarray, "n N"], first: int, most: int, apart: float) -> list[int]:
    """Return the indices of up to `most` rows of x by farthest-point selection, starting with row `first`.

    Args:
        x: Configurations [rad].
        first: Index of the first row.
        most: Maximum number of rows.
        apart: Minimum distance [rad].
    """
    order = np.append(first, np.delete(np.arange(len(x)), first))
    place = _farthest_first(x[order], np.zeros_like(order), np.arange(len(x)), most, apart)
    return order[np.argsort(place, kind="stable")[(place < 0).sum() :]].tolist()


def first_apart(
    x: Float[np.ndarray, "n N"], group: Int[np.ndarray, "n"] | int, most: int, apart: float, norm: float = 2
) -> Int[np.ndarray, "k"]:
    """Return the indices of up to `most` rows of x per group: in order, each at least `apart` from all kept so far.

    Args:
        x: Configurations [rad].
        group: Number of each row's group, 0 or more, in ascending order; one number if all rows are in one group.
        most: Maximum number of rows per group.
        apart: Minimum distance [rad].
        norm: Order of the norm, as in `numpy.linalg.norm`.
    """
    begin = np.flatnonzero(np.diff(np.broadcast_to(group, len(x)), prepend=-1))
    length = np.diff(np.append(begin, len(x)))
    kept = np.full((len(begin), most), len(x))  # row len(x) is far from all others
    x, count, place = np.vstack([x, np.full_like(x[:1], np.inf)]), np.zeros(len(begin), int), np.arange(BLOCK)
    for first in range(0, length.max(initial=0), BLOCK):  # the first rows are often enough
        going = np.flatnonzero((count < most) & (first < length))
        block = x[np.minimum(begin[going, None] + first + place, len(x) - 2)]
        left = first + place < length[going, None]
        for k in range(count[going].max(initial=0)):
            left &= np.linalg.norm(block - x[kept[going, k], None], norm, axis=2) >= apart
        while len(going):
            more = left.any(axis=1) & (count[going] < most)
            going, block, left = going[more], block[more], left[more]
            best = np.argmax(left, axis=1)
            kept[going, count[going]] = begin[going] + first + best
            count[going] += 1
            left &= np.linalg.norm(block - block[np.arange(len(going)), best, None], norm, axis=2) >= apart
    return kept[kept < len(x) - 1]


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
