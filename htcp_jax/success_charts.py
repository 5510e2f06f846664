"""Charts of how much each method tracks: in all, and scenario by scenario over the grid. See `charts`."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, PowerNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from htcp_jax.chart_style import (
    INK,
    PAPER,
    QUIET,
    WIDTH,
    blank_the_rest,
    heading,
    line_of,
    name_lines,
    new_figure,
    outer_labels,
    plain_axes,
)

TRACKED = LinearSegmentedColormap.from_list("tracked", ["#fbf3e4", "#d8dfd6", "#8fb8cf", "#3f82b5", "#0d3f6e"])
CONTRAST = 2.5  # exponent of the colour scale: most scenarios get far, so the upper end needs the most colours
MOST_NUMBERS, MOST_NAMES = 15, 12  # along a side of a map


class Axis(NamedTuple):
    """One axis of a grid of scenarios."""

    label: str  # with its unit
    values: Sequence[float] | Sequence[str]

    @property
    def names(self) -> list[str]:
        """The values as texts."""
        return [value if isinstance(value, str) else f"{value:.6g}" for value in self.values]


def success(
    tracked: Mapping[str, int],
    of: Mapping[str, int],
    *,
    paper: Mapping[str, float] | None = None,
    ceiling: int | None = None,
    title: str = "Success by method",
) -> Figure:
    """Tracked targets in percent, a bar a method with its counts, `tracked` of `of`; beside it the paper's percentage
    where `paper` has one, and the ceiling, a count of targets known to be reachable, as a line."""
    figure = new_figure(0.42 * len(tracked) + 1.5, title, _success_note(paper, ceiling))
    axes = figure.subplots()
    for y, method in enumerate(tracked):
        percent = 100 * tracked[method] / of[method]
        axes.barh(y, percent, height=0.62, color=line_of(method)[0])
        text = f"{percent:.2f} %  ({tracked[method]:,} of {of[method]:,})"
        axes.annotate(text, (101.5, y), va="center", color=INK, fontsize=9.5, annotation_clip=False)
        if paper and method in paper:
            axes.plot(paper[method], y, marker="D", color=PAPER, markeredgecolor=INK, markersize=7, clip_on=False)
    if ceiling is not None:
        axes.axvline(100 * ceiling / max(of.values()), color=INK, linewidth=1.2, linestyle=(0, (4, 2)))
    axes.set_yticks(range(len(tracked)), list(tracked))
    axes.set(xlim=(0, 100), ylim=(len(tracked) - 0.5, -0.5))
    axes.set_xlabel("tracked targets [%]")
    plain_axes(axes, grid="x")
    return figure


def success_map(
    tracked: Mapping[str, Float[np.ndarray, "R C"]],
    rows: Axis,
    columns: Axis,
    targets: int,
    *,
    title: str = "Success by scenario",
    note: str = "",
) -> Figure:
    """A small map a method: the tracked targets of `targets`, rows down and columns across; NaN where not planned."""
    across = min(3, len(tracked))
    down = -(-len(tracked) // across)
    side = min(WIDTH / across - 0.5, 0.42 * len(columns.values) + 0.7) * len(rows.values) / len(columns.values)
    figure = new_figure(down * (side + 0.4) + 1.3, title, f"Tracked targets of {targets}. {note}".strip())
    panels = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
    for axes, method in zip(panels.flat, tracked, strict=False):
        image = _map(axes, tracked[method], rows, columns, targets)
        heading(axes, method, _share(tracked[method], targets))
    blank_the_rest(panels, len(tracked))
    outer_labels(panels, len(tracked), columns.label, rows.label)
    _scale(figure, image, panels, targets)
    return figure


def success_slices(
    tracked: Mapping[str, Float[np.ndarray, "L R C"]],
    slices: Axis,
    rows: Axis,
    columns: Axis,
    targets: int,
    *,
    title: str = "Success by scenario",
    note: str = "",
) -> Figure:
    """A row of small maps a method, one for every value of the axis `slices`."""
    across, down = len(slices.values), len(tracked)
    side = (WIDTH - 1.8) / across * len(rows.values) / len(columns.values)
    figure = new_figure(down * (side + 0.1) + 1.4, title, f"Tracked targets of {targets}. {note}".strip())
    panels = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
    for axes, name in zip(panels[0], slices.names, strict=True):
        axes.set_title(f"{slices.label.split(' [')[0]} = {name}", color=QUIET, fontsize=10)
    for line, (method, cube) in zip(panels, tracked.items(), strict=True):
        for axes, layer in zip(line, cube, strict=True):
            image = _map(axes, layer, rows, columns, targets)
        line[0].set_ylabel(f"{method}\n{_share(cube, targets)}", color=INK, fontweight="bold", fontsize=10)
    figure.supxlabel(f"across: {columns.label};  down: {rows.label}", color=QUIET, fontsize=10)
    _scale(figure, image, panels, targets)
    return figure


def success_line(
    tracked: Mapping[str, Float[np.ndarray, "C"]],
    axis: Axis,
    targets: int,
    *,
    title: str = "Success by scenario",
    note: str = "",
) -> Figure:
    """Tracked targets over the only axis of a grid, or over a list of scenarios, a line a method."""
    figure = new_figure(4.2, title, f"Tracked targets of {targets}. {note}".strip())
    axes = figure.subplots()
    words = isinstance(axis.values[0], str)
    at = range(len(axis.values)) if words else axis.values
    if words:
        axes.set_xticks(at, axis.names)
    for method, values in tracked.items():
        colour, style = line_of(method)
        axes.plot(at, values, color=colour, linestyle=style, marker="o", markersize=4, linewidth=1.8)
    axes.set_xlabel(axis.label)
    axes.set_ylim(0, 1.03 * targets)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    known = {method: values[np.isfinite(values)] for method, values in tracked.items()}
    name_lines(axes, {method: values[-1] for method, values in known.items() if values.size}, at[-1], "{:.0f}")
    plain_axes(axes)
    return figure


def _map(axes: Axes, values: Float[np.ndarray, "R C"], rows: Axis, columns: Axis, targets: int):
    """One map; the number stands in every cell, where there is room."""
    image = axes.imshow(values, cmap=TRACKED, norm=PowerNorm(CONTRAST, 0, targets), aspect="equal")
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value) and max(values.shape) <= MOST_NUMBERS:
            style = {"color": PAPER if value > 0.82 * targets else INK, "ha": "center", "va": "center", "fontsize": 8}
            text = f"{value:.0f}" if value == round(value) else f"{value:.1f}"
            axes.annotate(text, (column, row), fontweight="bold" if value == targets else "normal", **style)
    for axis, given in ((axes.xaxis, columns), (axes.yaxis, rows)):
        every = -(-len(given.values) // MOST_NAMES)
        axis.set_ticks(range(0, len(given.values), every), given.names[::every])
    axes.tick_params(colors=QUIET, labelsize=8.5, length=0)
    axes.set_xticks(np.arange(len(columns.values) - 1) + 0.5, minor=True)
    axes.set_yticks(np.arange(len(rows.values) - 1) + 0.5, minor=True)
    axes.grid(which="minor", color=PAPER, linewidth=1.5)
    axes.tick_params(which="minor", length=0)
    axes.spines[:].set_visible(False)
    return image


def _scale(figure: Figure, image, panels, targets: int) -> None:
    bar = figure.colorbar(image, ax=panels, fraction=0.02, pad=0.015, aspect=30)
    bar.outline.set_visible(False)
    bar.set_ticks([0, *(round(part * targets) for part in (0.5, 0.75, 0.9)), targets])
    bar.ax.tick_params(colors=QUIET, labelsize=9, length=0)


def _share(values: Float[np.ndarray, "*n"], targets: int) -> str:
    """The mean in percent, over what is planned."""
    known = values[np.isfinite(values)]
    return f"{100 * known.mean() / targets:.2f} %" if known.size else "not planned"


def _success_note(paper: Mapping[str, float] | None, ceiling: int | None) -> str:
    parts = ["Diamond: the paper's figure."] if paper else []
    parts += ["Dashed: what is known to be reachable."] if ceiling is not None else []
    return " ".join(parts)
