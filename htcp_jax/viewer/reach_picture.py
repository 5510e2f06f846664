"""Picture of the workpiece, with the path's targets coloured by reach, from the side and from above."""

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
from htcp_jax.viewer.picture import draw_scale
from htcp_jax.viewer.viewpoints import View, view_from_side

PANELS, ACROSS = 12, 3  # maximum numbers of scenarios in a picture, and in a row
WIDE = 14.0  # width of the figure [inch]
MOST_POINTS = 30_000  # maximum number of the part's points that are drawn
ABOVE = View(np.array([1.0, 0, 0]), np.array([0.0, 1, 0]), np.array([0.0, 0, 1]))


class ReachPanel(NamedTuple):
    """One scenario's data for the picture; world [m]."""

    title: str
    cloud: Float[np.ndarray, "P 3"]  # points of the part
    targets: Float[np.ndarray, "T 3"]
    reach: Int[np.ndarray, "T"]  # values of `Reach`
    base: Float[np.ndarray, "3"]  # position of the arm's base


class _Look(NamedTuple):
    colour: str
    marker: str
    size: float  # marker area [points^2]


LOOKS = {  # in drawing order; both colour (also for colour-blind readers) and marker distinguish them
    Reach.REACHABLE: _Look("#1f6fb4", "o", 22),
    Reach.OUT_OF_REACH: _Look("#7c8791", "s", 24),
    Reach.TOOL: _Look("#c8102e", "X", 40),
    Reach.WRIST: _Look("#b5179e", "D", 26),
    Reach.ARM: _Look("#7a3b00", "v", 34),
    Reach.UNDECIDED: _Look("#f6c945", "^", 36),
}


def draw_reach(panels: Sequence[ReachPanel], title: str) -> Figure:
    """Draw the part and its targets: a single scenario from the side and from above, several from the side only.

    Args:
        panels: The scenarios; only the first PANELS are drawn.
        title: The title of the figure.

    Returns:
        The figure, to be saved with `figure.savefig(path)`.
    """
    shown = panels[:PANELS]
    views = [("from the side", None), ("from above", ABOVE)] if len(shown) == 1 else [("", None)]
    drawn = [(panel, heading, view) for panel in shown for heading, view in views]
    across = min(ACROSS, len(drawn))
    rows = -(-len(drawn) // across)
    drawn = [(panel, heading, view or _side_of(panel)) for panel, heading, view in drawn]
    wide = [_width(drawn[k]) for k in range(2)] if len(views) > 1 else None
    widths = wide or [min(_width(each) for each in drawn)] * across
    size = WIDE, 1.4 + rows * min(6.0 if across < ACROSS else 4.2, 1.07 * WIDE / sum(widths) + 0.4)
    figure = Figure(figsize=size, dpi=120, facecolor=PAPER, layout="constrained")
    FigureCanvasAgg(figure)
    figure.get_layout_engine().set(w_pad=0.12, h_pad=0.1, rect=(0, 0, 1, 1 - 0.5 / size[1]))
    more = f"; the first {len(shown)} of {len(panels)} scenarios" if len(shown) < len(panels) else ""
    title_at = {"x": 0.015, "y": 1 - 0.15 / size[1], "va": "top", "ha": "left"}
    figure.suptitle(title + more, color=INK, fontsize=16, fontweight="bold", **title_at)
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
    """Return a panel's width / height, at least 0.4."""
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
    draw_scale(axes)
