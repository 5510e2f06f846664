"""Picture of the part with every target on its path coloured by its reach, from the side and from above."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from htcp_jax.reachability import Reach
from htcp_jax.viewer.colours import INK, PAPER, WALL
from htcp_jax.viewer.viewpoints import View, view_from_side

PANELS, ACROSS = 12, 3  # most scenarios in one picture, and in a row
MOST_POINTS = 30_000  # of the part
ABOVE = View(np.array([1.0, 0, 0]), np.array([0.0, 1, 0]), np.array([0.0, 0, 1]))


class ReachPanel(NamedTuple):
    """One scenario of the picture; world [m]."""

    title: str
    cloud: Float[np.ndarray, "P 3"]  # points of the part
    targets: Float[np.ndarray, "T 3"]
    reach: Int[np.ndarray, "T"]  # numbers of `Reach`
    base: Float[np.ndarray, "3"]  # the arm's


class _Look(NamedTuple):
    colour: str
    marker: str
    size: float  # [points^2]


LOOKS = {  # drawn in this order; distinguished by colour (for colour-blind readers, too) and by marker
    Reach.REACHABLE: _Look("#1f6fb4", "o", 22),
    Reach.OUT_OF_REACH: _Look("#7c8791", "s", 24),
    Reach.TOOL: _Look("#c8102e", "X", 40),
    Reach.WRIST: _Look("#b5179e", "D", 26),
    Reach.ARM: _Look("#7a3b00", "v", 34),
    Reach.UNDECIDED: _Look("#f6c945", "^", 36),
}


def draw_reach(panels: Sequence[ReachPanel], title: str) -> Figure:
    """Draw the part with its targets: one scenario from the side and from above, several from the side.

    Args:
        panels: The scenarios, of which the first PANELS are drawn.
        title: The title of the figure.

    Returns:
        The figure, to be saved with `figure.savefig(path)`.
    """
    shown = panels[:PANELS]
    views = [("from the side", None), ("from above", ABOVE)] if len(shown) == 1 else [("", None)]
    drawn = [(panel, heading, view) for panel in shown for heading, view in views]
    across = min(ACROSS, len(drawn))
    rows = -(-len(drawn) // across)
    size = 14, 1.6 + rows * (6.0 if across < ACROSS else 4.2)
    figure = Figure(figsize=size, dpi=120, facecolor=PAPER, layout="constrained")
    FigureCanvasAgg(figure)
    figure.get_layout_engine().set(w_pad=0.12, h_pad=0.1, rect=(0, 0, 1, 1))
    more = f"; the first {len(shown)} of {len(panels)} scenarios" if len(shown) < len(panels) else ""
    figure.suptitle(title + more, color=INK, fontsize=16, fontweight="bold", x=0.015, ha="left")
    drawn = [(panel, heading, view or _side_of(panel)) for panel, heading, view in drawn]
    wide = [_width(*drawn[k::2]) for k in range(2)] if len(views) > 1 else None
    axes = figure.subplots(rows, across, squeeze=False, width_ratios=wide).reshape(-1)
    for each in axes:
        each.axis("off")
    for each, (panel, heading, view) in zip(axes, drawn, strict=False):
        _draw(each, panel, view)
        each.set_title(" ".join(filter(None, (panel.title, heading))), color=INK, fontsize=11, loc="left")
    count = {reach: sum(int((panel.reach == reach).sum()) for panel in panels) for reach in LOOKS}
    handles = [
        Line2D([], [], linestyle="", marker=look.marker, markersize=np.sqrt(look.size) * 1.3, markeredgecolor=PAPER,
               color=look.colour, label=f"{reach.label} ({count[reach]:,})")
        for reach, look in LOOKS.items() if count[reach]
    ]  # fmt: skip
    handles.append(Line2D([], [], linestyle="", marker="+", markersize=9, color=INK, label="arm's base"))
    figure.legend(handles=handles, loc="outside lower left", ncols=7, frameon=False, fontsize=10, labelcolor=INK)
    return figure


def _side_of(panel: ReachPanel) -> View:
    return view_from_side(panel.cloud if len(panel.cloud) else panel.targets, panel.targets)


def _width(drawn: tuple[ReachPanel, str, View]) -> float:
    """Return a panel's width for equal heights, without unit; at least 0.4."""
    panel, _, view = drawn
    wide, high = np.ptp(view.flat(np.concatenate([panel.cloud, panel.targets, panel.base[None]])), axis=0)
    return float(np.clip(wide / max(high, 1e-6), 0.4, 2.5))


def _draw(axes: Axes, panel: ReachPanel, view: View) -> None:
    cloud = panel.cloud[:: -(-len(panel.cloud) // MOST_POINTS) or 1]
    cloud = cloud[np.argsort(cloud @ view.near)]
    axes.scatter(*view.flat(cloud).T, color=WALL[1], s=1.2, linewidths=0, rasterized=True, zorder=1)
    flat = view.flat(panel.targets)
    for order, (reach, look) in enumerate(LOOKS.items()):
        own = flat[panel.reach == reach]
        style = {"color": look.colour, "s": look.size, "marker": look.marker, "linewidths": 0.6, "edgecolors": PAPER}
        axes.scatter(*own.T, zorder=3 + order, **style)
    base = view.flat(panel.base[None])
    axes.scatter(*base.T, color=INK, marker="+", s=90, linewidths=1.6, zorder=12)
    axes.set_aspect("equal", anchor="NW")
    axes.margins(0.06)
    axes.autoscale_view()
    _draw_scale(axes)


def _draw_scale(axes: Axes) -> None:
    """Draw a scale bar below everything, within the panel's width."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    length = 10.0 ** np.floor(np.log10((right - left) / 2))
    y = bottom - 0.05 * (top - bottom)
    axes.plot([left, left + length], [y, y], color=INK, linewidth=3, solid_capstyle="butt", zorder=6)
    style = {"textcoords": "offset points", "va": "center", "color": INK}
    axes.annotate(f"{length:g} m", (left + length, y), (5, 0), **style)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom - 0.1 * (top - bottom), top)
