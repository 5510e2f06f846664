"""Plot of a tool's work angle, travel angle and spin along a path, with the ranges that the task allows."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from htcp_jax.spec import TOOL_ANGLES, ToolAxisRow
from htcp_jax.viewer.colours import INK

COLOURS = "#1f6fb2", "#c0392b", "#7a8791"  # work angle, travel angle, spin


def draw_angles(axes: Axes, rows: Sequence[tuple[int, ToolAxisRow]], angles: Float[np.ndarray, "T 3"]) -> None:
    """Draw the angles over the target index; a band is an allowed range. A free spin is not drawn.

    Args:
        axes: The axes.
        rows: First target of each seam, and the row with its allowed angles. All rows limit the same angles.
        angles: Work angle, travel angle and spin at each target [degrees]; NaN where unknown.
    """
    ends = [*(first for first, _ in rows[1:]), len(angles)]
    for k, (name, colour) in enumerate(zip(TOOL_ANGLES, COLOURS, strict=True)):
        if name == TOOL_ANGLES[-1] and getattr(rows[0][1], name) == "free":
            continue
        for (first, row), end in zip(rows, ends, strict=True):
            words = name.removesuffix("_deg").replace("_", " ") if row is rows[0][1] and not first else None
            axes.plot(range(first, end), angles[first:end, k], color=colour, linewidth=1.4, label=words)
            if isinstance(getattr(row, name), tuple):
                axes.fill_between(
                    [first - 0.5, end - 0.5], *row.bounds_deg(name), color=colour, alpha=0.12, linewidth=0
                )
    axes.set_xlim(-1, len(angles))
    axes.set_xlabel("target", color=INK)
    axes.grid(axis="y", color="#dfe3e6", linewidth=0.8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="lower left", frameon=False, ncols=3, bbox_to_anchor=(0.36, 1.0), borderaxespad=0.2)
    axes.set_title("Angles of the tool [degrees], bands: allowed", color=INK, fontsize=11, loc="left", y=1.0)
