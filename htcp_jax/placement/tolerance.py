"""How far a mounting may be off before a seam is lost: disturbed mountings, every one planned anew.

What is off is off in all parameters at once: lengths by up to so many millimetres, angles by up to so many degrees. A
tolerance is stated where every disturbed mounting that was tried in a box a fifth wider is complete.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from htcp_jax.placement.mounting import Answer, Tolerance
from htcp_jax.placement.place_file import Search
from htcp_jax.placement.search import even

TRIED = 32  # disturbed mountings about each of the confirmed
LEVELS = 0.5, 1.0, 2.0, 4.0  # of what a mounting may be off, that are looked at
MORE = 96  # disturbed mountings a level
WIDER = 1.2  # than what is stated

Judge = Callable[[Float[np.ndarray, "n d"], Path], Answer]  # plans mountings anew into a folder


def box(search: Search) -> Float[np.ndarray, "d"]:
    """Half the width of the box in which a mounting may be off, in the units of its parameters."""
    off = search.file.off
    return np.array([axis.disturbed(1e-3 * off.mm, off.deg) for axis in search.ranges.axes])


def disturbed(search: Search, values: Float[np.ndarray, "n d"], folder: Path, judge: Judge) -> list[Answer]:
    """What mountings come to when they are off by up to `off`, one by one."""
    shifts = _shifts(search, TRIED, 1) * box(search)
    return _judged(search, values, shifts, folder, judge)


def tolerances(search: Search, values: Float[np.ndarray, "n d"], folder: Path, judge: Judge) -> list[Tolerance]:
    """Of mountings, one by one. The levels are gone through from the smallest; who fails at one is tried no more."""
    half, going = box(search), np.arange(len(values))
    together = np.zeros(len(values))
    for level in LEVELS:
        shifts = WIDER * level * half * _shifts(search, MORE, 2)
        found = _judged(search, values[going], shifts, folder / f"all-{level:g}", judge)
        going = going[[one.complete.all() for one in found]]
        together[going] = level
        if not len(going):
            break
    alone = np.zeros(values.shape)
    steps = np.array(LEVELS)
    d = len(half)
    shifts = np.concatenate([sign * level * half * np.eye(d) for level in steps for sign in (-1, 1)])
    for k, one in enumerate(_judged(search, values, shifts, folder / "alone", judge)):
        fine = one.complete.reshape(len(steps), 2, d).all(axis=1)
        kept = np.logical_and.accumulate(fine, axis=0).sum(axis=0)
        alone[k] = np.append(0.0, steps)[kept] * half
    return [Tolerance(float(a), b) for a, b in zip(together, alone, strict=True)]


def _shifts(search: Search, count: int, key: int) -> Float[np.ndarray, "n d"]:
    """Within the unit cube about 0: half of them corners of it, where mountings are lost first."""
    d = len(search.ranges.axes)
    inside = 2 * even(d, 0, count, search.file.seed + key) - 1
    corners = np.sign(inside[: count // 2])
    return np.concatenate([np.where(corners == 0, 1.0, corners), inside[count // 2 :]])


def _judged(
    search: Search, values: Float[np.ndarray, "n d"], shifts: Float[np.ndarray, "m d"], folder: Path, judge: Judge
) -> list[Answer]:
    """Each mounting with every shift: all in one sweep."""
    every = (values[:, None] + shifts).reshape(-1, values.shape[1])
    parts = (np.split(part, len(values)) for part in judge(every, folder))
    return [Answer(*part) for part in zip(*parts, strict=True)]
