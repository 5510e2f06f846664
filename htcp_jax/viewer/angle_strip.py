"""Plot of a tool's work angle, travel angle and spin along a path, with the ranges that the task allows."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from htcp_jax.spec import TOOL_ANGLES, ToolAxisRow
from htcp_jax.viewer.colours import INK

COLOURS = "#1f6fb2", "#c0392b", "#7a8791"  # work angle, travel angle, spin


def draw_angles(axes: Axes, rows: Sequence[tuple[slice, ToolAxisRow]], angles: Float[np.ndarray, "T 3"]) -> None:
    """Draw the angles over the target index; a band is an allowed range. A free spin is not drawn.

    Args:
        axes: The axes.
        rows: Targets of each seam that limits the angles, and the row that limits them.
        angles: Work angle, travel angle and spin at each target [degrees]; NaN where unknown.
    """
    for k, (name, colour) in enumerate(zip(TOOL_ANGLES, COLOURS, strict=True)):
        label: str | None = name.removesuffix("_deg").replace("_", " ")
        for here, row in rows:
            if name == TOOL_ANGLES[-1] and getattr(row, name) == "free":
                continue
            axes.plot(range(here.start, here.stop), angles[here, k], color=colour, linewidth=1.4, label=label)
            label = None
            if isinstance(getattr(row, name), tuple):
                ends = [here.start - 0.5, here.stop - 0.5]
                axes.fill_between(ends, *row.bounds_deg(name), color=colour, alpha=0.12, linewidth=0)
    axes.set_xlim(-1, len(angles))
    axes.set_xlabel("target", color=INK)
    axes.grid(axis="y", color="#dfe3e6", linewidth=0.8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="lower left", frameon=False, ncols=3, bbox_to_anchor=(0.36, 1.0), borderaxespad=0.2)
    axes.set_title("Angles of the tool [degrees], bands: allowed", color=INK, fontsize=11, loc="left", y=1.0)
