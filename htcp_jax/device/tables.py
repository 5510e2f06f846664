"""Tables with one lane per row, in any tree of numpy arrays."""

from collections.abc import Iterator, Sequence
from typing import TypeVar

import jax
import numpy as np

Tables = TypeVar("Tables")

PORTION = 16384  # number of rows of the largest table of a lane function


def gather(tables: Tables, rows) -> Tables:
    """Return some rows of the tables; the tables themselves, not copies, if a mask selects all rows."""
    if not isinstance(rows, np.ndarray):
        return jax.tree.map(lambda table: table[rows], tables)
    if rows.dtype == bool:
        if rows.all():
            return tables
        rows = np.flatnonzero(rows)  # computed once, not for every table
    return jax.tree.map(lambda table: table.take(rows, axis=0), tables)  # takes half the time of table[rows]


def portions(tables: Tables) -> Iterator[Tables]:
    """Yield the tables in chunks of PORTION rows, to limit the memory of results computed from a chunk."""
    for first in range(0, len(jax.tree.leaves(tables)[0]), PORTION):
        yield gather(tables, slice(first, first + PORTION))


def concatenate(parts: Sequence[Tables]) -> Tables:
    """Return the rows of one or more parts as one tree of tables."""
    return parts[0] if len(parts) == 1 else jax.tree.map(lambda *tables: np.concatenate(tables), *parts)


def interleaved(parts: Sequence[Tables]) -> Tables:
    """Return the rows of n parts in their original order; part k has the original rows k, k + n, k + 2 n and so on."""
    whole = concatenate(parts)
    count = len(jax.tree.leaves(whole)[0])
    order = np.concatenate([np.arange(number, count, len(parts)) for number in range(len(parts))])
    return gather(whole, np.argsort(order))


def gather_from(places: Sequence[tuple[Tables, np.ndarray]]) -> Tables:
    """Return the rows at some places, in the order of the places; a place is a tree of tables and some of its rows.

    Each table is indexed only once, even if several places are in it.
    """
    found: dict[int, tuple[Tables, list[int]]] = {}
    for place, (tables, _) in enumerate(places):
        found.setdefault(id(tables), (tables, []))[1].append(place)
    parts = [gather(tables, np.concatenate([places[place][1] for place in own])) for tables, own in found.values()]
    lengths = np.array([len(rows) for _, rows in places])
    ends = np.cumsum(lengths)
    order = [np.arange(ends[place] - lengths[place], ends[place]) for _, own in found.values() for place in own]
    return gather(concatenate(parts), np.argsort(np.concatenate(order)))


def scatter(tables: Tables, rows, new: Tables) -> Tables:
    """Return copies of the tables with some rows replaced."""

    def replaced(table, part):
        table = table.copy()
        table[rows] = part
        return table

    return jax.tree.map(replaced, tables, new)


def pad(table: np.ndarray, capacity: int, filled: int) -> np.ndarray:
    """Return the table with `capacity` rows; new rows up to `filled` are copies of the first row, which is valid.

    Rows from `filled` on are not set and must not be read.
    """
    lanes = len(table)
    if lanes == capacity:
        return table
    padded = np.empty((capacity, *table.shape[1:]), table.dtype)
    padded[:lanes] = table
    padded[lanes:filled] = table[0]
    return padded
