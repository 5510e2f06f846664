"""Tolerance of a mounting to placement error: perturbed mountings, each planned anew.

A perturbation changes all parameters at once, within a box of millimetres for lengths and degrees for angles. A
mounting tolerates a box if every perturbed mounting that is tested, in a box a fifth wider, is complete: a proven
motion leads to the end of every seam.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from htcp_jax.placement.mounting import MountingResults, PlacementTolerance
from htcp_jax.placement.place_file import Search
from htcp_jax.placement.search import even

TRIED = 16  # number of perturbations of each confirmed mounting
LEVELS = 0.5, 1.0, 2.0, 4.0  # tested levels of perturbation, in multiples of `perturbation`
FEW, MORE = 16, 64  # number of perturbed mountings per level, and maximum number at the reported level
WIDER = 1.2  # width of the tested box / the reported box

Evaluate = Callable[[Float[np.ndarray, "n d"], Path], MountingResults]  # function that plans mountings into a folder


def box(search: Search) -> Float[np.ndarray, "d"]:
    """Return the largest perturbation of each parameter, in its unit in the job."""
    perturbation = search.file.perturbation
    return np.array([axis.perturbed(1e-3 * perturbation.mm, perturbation.deg) for axis in search.ranges.axes])


def perturbed(
    search: Search, values: Float[np.ndarray, "n d"], folder: Path, evaluate: Evaluate
) -> list[MountingResults]:
    """Return the results of each mounting under TRIED perturbations within `perturbation`.

    Args:
        search: The search.
        values: Parameters of the mountings, each in its unit in the job.
        folder: The folder of the plans.
        evaluate: Function that plans the perturbed mountings.
    """
    shifts = _shifts(search, TRIED, 1) * box(search)
    return _scores_of(search, values, shifts, folder, evaluate)


def tolerances(
    search: Search, values: Float[np.ndarray, "n d"], folder: Path, evaluate: Evaluate
) -> list[PlacementTolerance]:
    """Return the tolerance of each mounting.

    Levels of perturbation are tried in increasing order; a mounting that fails at one is not tried at the next.

    Args:
        search: The search.
        values: Parameters of the mountings, each in its unit in the job.
        folder: The folder of the plans, one sweep per level.
        evaluate: Function that plans the perturbed mountings.
    """
    half, shifts = box(search), WIDER * box(search) * _shifts(search, MORE, 2)
    together, going = np.zeros(len(values)), np.arange(len(values))
    for level in LEVELS:
        own = _scores_of(search, values[going], level * shifts[:FEW], folder / f"all-{level:g}", evaluate)
        going = going[[one.complete.all() for one in own]]
        together[going] = level
        if not len(going):
            break
    for lower, level in reversed(list(zip((0.0, *LEVELS), LEVELS, strict=False))):
        if len(going := np.flatnonzero(together == level)):
            own = _scores_of(search, values[going], level * shifts[FEW:], folder / f"more-{level:g}", evaluate)
            together[going] = np.where([one.complete.all() for one in own], level, lower)
    alone = np.zeros(values.shape)
    steps = np.array(LEVELS)
    d = len(half)
    shifts = np.concatenate([sign * level * half * np.eye(d) for level in steps for sign in (-1, 1)])
    for k, one in enumerate(_scores_of(search, values, shifts, folder / "alone", evaluate)):
        fine = one.complete.reshape(len(steps), 2, d).all(axis=1)
        kept = np.logical_and.accumulate(fine, axis=0).sum(axis=0)
        alone[k] = np.append(0.0, steps)[kept] * half
    return [PlacementTolerance(float(a), b) for a, b in zip(together, alone, strict=True)]


def most_tried(dimensions: int) -> int:
    """Return the maximum number of perturbed mountings for the tolerances of one mounting."""
    return len(LEVELS) * (MORE + 2 * dimensions)


def _shifts(search: Search, count: int, key: int) -> Float[np.ndarray, "n d"]:
    """Return `count` shifts in the cube [-1, 1]^d; every second one is a corner, where mountings fail first."""
    shifts = 2 * even(len(search.ranges.axes), 0, count, search.file.seed + key) - 1
    shifts[::2] = np.where(shifts[::2] < 0, -1.0, 1.0)
    return shifts


def _scores_of(
    search: Search, values: Float[np.ndarray, "n d"], shifts: Float[np.ndarray, "m d"], folder: Path, evaluate: Evaluate
) -> list[MountingResults]:
    """Return the results of each mounting under every shift, all planned in one sweep."""
    every = (values[:, None] + shifts).reshape(-1, values.shape[1])
    parts = (np.split(part, len(values)) for part in evaluate(every, folder))
    return [MountingResults(*part) for part in zip(*parts, strict=True)]
