"""Larger lower bounds on the clearance of joint paths, from proofs of their parts.

The proof of a long path halves an interval only a few times to raise its bound. Here the part with the smallest bound
is cut, and its parts are proven.

The functions are generators. They yield what is to be proven, and receive one proven clearance per path, NaN where a
path is not proven. `together` runs many of them: in each round, one call proves what all of them have yielded.
"""

from collections.abc import Callable, Generator, Sequence
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

PARTS, CUTS = 8, 24  # number of parts of a path that are proven in its place, and how often, see `raised`
GAIN, RAISED = 1.02, 20  # factor by which a bound must rise, or no further one is raised; maximum number of bounds

Found = TypeVar("Found")
Proving = Generator[Any, Float[np.ndarray, "p"], Found]  # yields what is to be proven; returns the last parameter


def together(works: Sequence[Proving[Found]], prove: Callable[[list], Sequence[Float[np.ndarray, "_"]]]) -> list[Found]:
    """Run generators side by side; return their results in the same order.

    Args:
        works: The generators.
        prove: Function that returns the proven clearances for each element of a list of what was yielded [m].
    """
    results: dict[int, Found] = {}
    clearances: dict[int, Any] = dict.fromkeys(range(len(works)))  # a generator begins with None
    while clearances:
        yielded = {}
        for k, clearance in clearances.items():
            try:
                yielded[k] = works[k].send(clearance)
            except StopIteration as end:
                results[k] = end.value
        clearances = dict(zip(yielded, prove(list(yielded.values())), strict=True)) if yielded else {}
    return [results[k] for k in range(len(works))]


def raise_smallest(
    clearance: Float[np.ndarray, "n"], more: Callable[[int], Proving[float]], enough_m: float = np.inf
) -> Proving[None]:
    """Raise the smallest of several lower bounds in place [m], then the next one, while they rise by the factor GAIN.

    Args:
        clearance: The bounds; NaN where nothing is proven.
        more: Generator that returns a larger bound in place of the one at an index.
        enough_m: Bound above which none is raised [m].
    """
    for _ in range(RAISED if np.isfinite(clearance).any() else 0):
        k = int(np.nanargmin(clearance))
        if clearance[k] >= enough_m or not (found := (yield from more(k))) > GAIN * clearance[k]:
            break
        clearance[k] = found


def raised(
    parts: Callable[[Float[np.ndarray, "p"], Float[np.ndarray, "p"]], Any],
    clearance_m: float,
    enough_m: float = np.inf,
) -> Proving[float]:
    """Return a larger lower bound on the clearance of a joint path, after at most CUTS cuts [m].

    Args:
        parts: Function that returns what is to be proven for the parts of the path between given shares of it.
        clearance_m: The bound so far, which holds for all parts.
        enough_m: Bound above which no part is cut [m].
    """
    begin, end, clearance = np.zeros(1), np.ones(1), np.array([clearance_m])
    for _ in range(CUTS):
        k = int(clearance.argmin())
        if clearance[k] >= enough_m:
            break
        edges = np.linspace(begin[k], end[k], PARTS + 1)
        found = np.fmax((yield parts(edges[:-1], edges[1:])), clearance[k])
        new = (begin, edges[:-1]), (end, edges[1:]), (clearance, found)
        begin, end, clearance = (np.concatenate([np.delete(old, k), each]) for old, each in new)
    return float(clearance.min())
