"""Seams in pictures: lines of targets that do not lead from seam to seam, and the seams' names."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from htcp_jax.motion import Plans
from htcp_jax.viewer.colours import INK, PAPER

MOST_NAMED = 12  # of more seams, only as many are named, evenly spread
FONT_PT = 9.0
BEHIND = {"facecolor": PAPER, "edgecolor": "none", "alpha": 0.75, "pad": 1}


def draw_lines(axes: Axes, points: Float[np.ndarray, "T 2"], plans: Plans) -> None:
    """Draw a thin line through the points of the targets of each seam.

    Args:
        axes: The axes.
        points: Point of each target.
        plans: The plans.
    """
    for a, b in pairwise([0, *plans.seam_begins, len(points)]):
        axes.plot(*points[a:b].T, color=INK, linewidth=0.6, alpha=0.5, zorder=4)


def draw_names(axes: Axes, points: Float[np.ndarray, "T 2"], plans: Plans, names: Sequence[str]) -> None:
    """Write the names of seams next to their middle points.

    Args:
        axes: The axes.
        points: Point of each target.
        plans: The plans.
        names: Names of all seams.
    """
    look = {"textcoords": "offset points", "color": INK, "fontsize": FONT_PT, "zorder": 6.2, "bbox": BEHIND}
    ends = np.array([0, *plans.seam_begins, len(points)])
    for first, name in _named(plans, names):
        middle = (first + ends[ends > first][0] - 1) // 2
        axes.annotate(name, points[middle], (4, 4), **look)


def draw_begins(axes: Axes, plans: Plans, names: Sequence[str]) -> None:
    """Draw a thin vertical line at the first target of each seam, with the seam's name at the bottom.

    Args:
        axes: Axes over the targets.
        plans: The plans.
        names: Names of all seams.
    """
    for first in plans.seam_begins:
        axes.axvline(first - 0.5, color=INK, linewidth=0.6, alpha=0.35, zorder=1)
    look = {"xycoords": axes.get_xaxis_transform(), "textcoords": "offset points", "color": INK, "fontsize": FONT_PT}
    for first, name in _named(plans, names):
        axes.annotate(name, (max(first - 0.5, -1), 0), (3, 3), **look, zorder=4, bbox=BEHIND)


def without_air_moves(values: Float[np.ndarray, "T"], plans: Plans) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of targets and their values as the points of one line per seam, with NaN between them."""
    index, begins = np.arange(len(values), dtype=float), list(plans.seam_begins)
    return np.insert(index, begins, np.nan), np.insert(values, begins, np.nan)


def _named(plans: Plans, names: Sequence[str]) -> list[tuple[int, str]]:
    """Return the first target and the name of each seam that is named."""
    every = list(zip([0, *plans.seam_begins], names, strict=False))
    chosen = np.unique(np.linspace(0, len(every) - 1, min(len(every), MOST_NAMED)).round().astype(int)) if every else []
    return [every[k] for k in chosen]
