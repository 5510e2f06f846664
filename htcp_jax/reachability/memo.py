"""Memoisation of a search: results at targets that an earlier, interrupted search may have computed already.

A search is a sequence of steps with names. A step computes results at some targets, each by itself: they depend on the
earlier steps of the same scenario, but neither on other scenarios nor on the targets that are computed together.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float, Int

Pairs = Int[np.ndarray, "n 2"]  # rows of scenarios, and indices of targets
Results = Float[np.ndarray, "n w"]
Compute = Callable[[Int[np.ndarray, "m"]], Results]  # function that computes the results at some of the pairs
# Function (step, pairs, width, compute) that returns a step's results at pairs, `width` numbers for each. It calls
# `compute` with the indices of the pairs whose results are not known.
Memo = Callable[[str, Pairs, int, Compute], Results]


def compute_all(step: str, pairs: Pairs, width: int, compute: Compute) -> Results:
    """Compute the results at all pairs: the `Memo` of a search that has no earlier results."""
    return compute(np.arange(len(pairs)))


def of_rows(memo: Memo, rows: Int[np.ndarray, "S"]) -> Memo:
    """Return the `Memo` of S scenarios whose rows in `memo` are `rows`."""
    return lambda step, pairs, *how: memo(step, np.column_stack([rows[pairs[:, 0]], pairs[:, 1]]), *how)


def of_step(memo: Memo, step: str) -> Memo:
    """Return the `Memo` of the parts of a step, whose names are added to its own."""
    return lambda part, *how: memo(f"{step}, {part}", *how)


def in_chunks(memo: Memo, together: int) -> Memo:
    """Return a `Memo` that computes the results at no more than `together` pairs at a time."""

    def chunked(step: str, pairs: Pairs, width: int, compute: Compute) -> Results:
        chunks = np.split(np.arange(len(pairs)), range(together, len(pairs), together))
        each = [memo(step, pairs[own], width, lambda which, own=own: compute(own[which])) for own in chunks]
        return np.concatenate(each)

    return chunked


def padded(configurations: Sequence[Float[np.ndarray, "_ N"]], most: int, joints: int) -> Float[np.ndarray, "n w"]:
    """Return up to `most` configurations at each of n targets as one row per target, filled up with NaN."""
    rows = np.full((len(configurations), most, joints), np.nan)
    for row, own in zip(rows, configurations, strict=True):
        row[: len(own)] = own
    return rows.reshape(len(rows), -1)


def unpadded(rows: Float[np.ndarray, "n w"], joints: int) -> list[Float[np.ndarray, "_ N"]]:
    """Return the configurations of each row of `padded`."""
    every = rows.reshape(len(rows), -1, joints)
    return [own[~np.isnan(own).any(axis=1)] for own in every]
