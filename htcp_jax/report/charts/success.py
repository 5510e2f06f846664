"""Charts of tracked and executable targets: by method, and by scenario over the grid. See `charts`."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator

from htcp_jax.report.charts.style import (
    INK,
    PAPER,
    QUIET,
    WIDTH,
    colour_bar,
    heading,
    ink_on,
    line_of,
    name_lines,
    new_figure,
    outer_labels,
    panels_with_maps,
    plain_axes,
)
from htcp_jax.runs import summary

_COLOURS = (0, "#fbf3e4"), (0.113, "#d8dfd6"), (0.395, "#8fb8cf"), (0.694, "#3f82b5"), (1, "#0d3f6e")
TRACKED = LinearSegmentedColormap.from_list("tracked", _COLOURS)  # positions by the colours' distances in CIELAB
MOST_NUMBERS, MOST_NAMES = 15, 12  # maximum numbers of cells and of axis values along a map's side that are written
LONGEST, LEVEL = 14, 6  # maximum characters of an axis value, and of one that is written horizontally below a map
MAP_CHARACTERS = 36  # maximum characters of all values below a map, if they are written horizontally
HATCHES = "", "///", "...", "xxx", "\\\\\\"  # of the runs, in their order
LINE_CHARACTERS = 80  # maximum characters of all values below a line chart, if they are written horizontally


class Axis(NamedTuple):
    """Axis of a grid of scenarios."""

    label: str  # label of the axis, with the unit
    values: Sequence[float] | Sequence[str]  # in the label's unit

    @property
    def names(self) -> list[str]:
        """Values as texts: "no. 1", "no. 2", ... if one of them is longer than LONGEST characters."""
        return list(self.numbered) or self._full_names

    @property
    def numbered(self) -> dict[str, str]:
        """Values that are written as numbers, by their name; empty if they are written in full."""
        if max(map(len, self._full_names)) <= LONGEST:
            return {}
        return {f"no. {k}": str(value) for k, value in enumerate(self.values, 1)}

    @property
    def _full_names(self) -> list[str]:
        names = [value if isinstance(value, str) else f"{value:.6g}" for value in self.values]
        if isinstance(self.values[0], str) or max(map(len, names)) <= LEVEL + 1:
            return names
        short = [f"{value:.3g}" for value in self.values]  # random values have many digits
        return short if len(set(short)) == len(names) else names


def success(
    tracked: Mapping[str, int],
    of: Mapping[str, int],
    *,
    executable: Mapping[str, int] | None = None,
    complete: Mapping[str, tuple[int, int]] | None = None,
    paper: Mapping[str, float] | None = None,
    reachability: int | None = None,
    methods: Mapping[str, str] | None = None,
    runs: Mapping[str, str] | None = None,
    title: str = "",
) -> Figure:
    """Draw the shares of tracked targets and of complete scenarios in percent, two bars per method with its counts.

    Args:
        tracked: Number of tracked targets by method.
        of: Number of all targets by method.
        executable: Number of targets to which a proven motion leads, by method; the bar is pale for all other tracked
            targets.
        complete: Number of complete scenarios and of all scenarios, by method; drawn as a narrow bar, with the 95 %
            confidence interval (Wilson). None: only the targets are drawn.
        paper: The paper's percentage of tracked targets, by method; drawn as a diamond.
        reachability: Number of targets known to be reachable; drawn as a dashed line.
        methods: The method of each bar, which determines its colour, if the keys above are other names.
        runs: The run of each bar, which determines its hatching, if there are several runs.
        title: The title of the figure; empty: what is drawn.
    """
    executable = tracked if executable is None else executable
    cut = any(executable[method] < tracked[method] for method in tracked)
    measures = ["targets tracked", *(["scenarios complete"] if complete else [])]
    row, rest = (0.62, 1.7) if complete else (0.42, 1.5)
    note = _success_note(paper, reachability, cut, bool(complete))
    title = title or f"{' and '.join(measures).capitalize()}, by method{' and run' if runs else ''}"
    figure = new_figure(row * len(tracked) + rest, title, note)
    axes, hatching = figure.subplots(), _hatching(runs or {})
    middle, height = (-0.17, 0.4) if complete else (0, 0.62)  # of the bar of the targets
    for y, method in enumerate(tracked):
        percent = 100 * tracked[method] / of[method]
        open_ = 100 * executable[method] / of[method]
        colour = line_of(method if methods is None else methods[method])[0]
        style = {"color": colour, "hatch": hatching.get(method), "edgecolor": PAPER, "linewidth": 0}
        axes.barh(y + middle, percent, height=height, alpha=0.3, **style)
        axes.barh(y + middle, open_, height=height, **style)
        text = f"{percent:.2f} %  ({tracked[method]:,} of {of[method]:,})"
        text += f", executable {open_:.2f} %" if cut else ""
        written = {"va": "center", "color": INK, "fontsize": 9.5, "annotation_clip": False}
        axes.annotate(f"targets {text}" if complete else text, (101.5, y + middle), **written)
        if complete:
            count, scenarios = complete[method]
            rate, low, high = (100 * x for x in (count / scenarios, *summary.rate_interval(count, scenarios)))
            axes.barh(y + 0.22, rate, height=0.22, **style)
            for colour, wide in ((PAPER, 4.5), (INK, 1.4)):  # with a light edge, for the part on a dark bar
                axes.plot((low, high), (y + 0.22,) * 2, color=colour, linewidth=wide, clip_on=False)
            text = f"scenarios {rate:.2f} %  ({count:,} of {scenarios:,}), {low:.1f} to {high:.1f} %"
            axes.annotate(text, (101.5, y + 0.24), **written)
        if paper and method in paper:
            axes.plot(
                paper[method], y + middle, marker="D", color=PAPER, markeredgecolor=INK, markersize=7, clip_on=False
            )
    if reachability is not None:
        axes.axvline(100 * reachability / max(of.values()), color=INK, linewidth=1.2, linestyle=(0, (4, 2)))
    axes.set_yticks(range(len(tracked)), list(tracked))
    axes.set(xlim=(0, 100), ylim=(len(tracked) - 0.5, -0.5))
    axes.set_xlabel(f"{', '.join(measures)} [%]")
    plain_axes(axes, grid="x")
    return figure


def _hatching(runs: Mapping[str, str]) -> dict[str, str]:
    """Return the hatching of each bar: none for the first run, another one for each later run."""
    order = list(dict.fromkeys(runs.values()))
    return {bar: HATCHES[k % len(HATCHES)] * (1 + k // len(HATCHES)) for bar in runs for k in [order.index(runs[bar])]}


def success_map(
    tracked: Mapping[str, Float[np.ndarray, "R C"]],
    rows: Axis,
    columns: Axis,
    targets: int,
    *,
    executable: Mapping[str, Float[np.ndarray, "R C"]] | None = None,
    title: str = "Targets by scenario",
    note: str = "",
) -> Figure:
    """Draw one small map of the scenarios per method, coloured by tracked targets.

    Args:
        tracked: Mean number of tracked targets in each cell [1], by method; NaN where not planned.
        rows: The axis of the rows, downwards.
        columns: The axis of the columns.
        targets: Number of targets in a scenario.
        executable: Mean number of targets to which a proven motion leads [1], by method. If any is smaller than
            `tracked`, colours and numbers show it, and the number of tracked targets is in brackets.
        title: The title of the figure.
        note: Text to append to the note below the title.
    """
    shown = tracked if executable is None else executable
    note = f"{_counted(tracked, shown, targets)} {note}".strip()
    figure, panels, most = panels_with_maps(len(tracked), 0.42, rows.values, columns.values, title, note)
    for axes, method in zip(panels.flat, tracked, strict=False):
        image = _draw_map(axes, shown[method], tracked[method], rows, columns, targets)
        heading(axes, method, _percent_pair(shown[method], tracked[method], targets), most)
    outer_labels(panels, len(tracked), columns.label, rows.label)
    _draw_colour_bar(figure, image, panels, targets, has_not_executable(tracked, shown))
    return figure


def success_slices(
    tracked: Mapping[str, Float[np.ndarray, "L R C"]],
    slices: Axis,
    rows: Axis,
    columns: Axis,
    targets: int,
    *,
    executable: Mapping[str, Float[np.ndarray, "L R C"]] | None = None,
    title: str = "Targets by scenario",
    note: str = "",
) -> Figure:
    """Draw a row of small maps per method, one map for every value of a third axis; see `success_map`.

    Args:
        tracked: Mean number of tracked targets in each cell [1], by method; NaN where not planned.
        slices: The axis with one map for each of its values.
        rows: The axis of the rows, downwards.
        columns: The axis of the columns.
        targets: Number of targets in a scenario.
        executable: Mean number of targets to which a proven motion leads [1], by method.
        title: The title of the figure.
        note: Text to append to the note below the title.
    """
    shown = tracked if executable is None else executable
    across, down = len(slices.values), len(tracked)
    side = (WIDTH - 1.8) / across * len(rows.values) / len(columns.values)
    figure = new_figure(down * (side + 0.1) + 1.4, title, f"{_counted(tracked, shown, targets)} {note}".strip())
    panels = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
    stem, _, unit = slices.label.partition(" [")
    parts = "\n" if max(map(len, slices.names)) > LEVEL else " "
    for axes, name in zip(panels[0], slices.names, strict=True):
        axes.set_title(f"{stem} ={parts}{name} {unit.rstrip(']')}".strip(), color=QUIET, fontsize=10)
    for line, (method, cube) in zip(panels, tracked.items(), strict=True):
        for axes, layer, whole in zip(line, shown[method], cube, strict=True):
            image = _draw_map(axes, layer, whole, rows, columns, targets)
        share = _percent_pair(shown[method], cube, targets)
        line[0].set_ylabel(f"{method}\n{share}", color=INK, fontweight="bold", fontsize=10)
    figure.supxlabel(f"across: {columns.label};  down: {rows.label}", color=QUIET, fontsize=10)
    _draw_colour_bar(figure, image, panels, targets, has_not_executable(tracked, shown))
    return figure


def success_line(
    tracked: Mapping[str, Float[np.ndarray, "C"]],
    axis: Axis,
    targets: int,
    *,
    executable: Mapping[str, Float[np.ndarray, "C"]] | None = None,
    reachability: Float[np.ndarray, "C"] | None = None,
    title: str = "Targets by scenario",
    note: str = "",
) -> Figure:
    """Draw tracked targets over an axis of a grid, or over a list of scenarios, one line per method.

    Args:
        tracked: Mean number of tracked targets at each value of the axis [1], by method; NaN where not planned.
        axis: The axis.
        targets: Number of targets in a scenario.
        executable: Mean number of targets to which a proven motion leads [1], by method. If any is smaller than
            `tracked`, the line shows it, and a faint line shows the tracked targets.
        reachability: Mean number of targets known to be reachable [1]; drawn as a dashed line.
        title: The title of the figure.
        note: Text to append to the note below the title.
    """
    shown = tracked if executable is None else executable
    cut = has_not_executable(tracked, shown)
    lines = f"Of {targets} targets, those to which a proven motion leads from the start; faint: tracked targets."
    notes = lines if cut else f"Tracked targets of {targets}.", note, *dashed_note(reachability)
    figure = new_figure(4.2, title, " ".join(filter(None, notes)))
    axes = figure.subplots()
    at = place_values(axes, axis)
    if reachability is not None:
        axes.plot(at, reachability, color=INK, linewidth=1.2, linestyle=(0, (4, 2)), zorder=3)
    for method, values in shown.items():
        colour, style = line_of(method)
        if not np.array_equal(values, tracked[method], equal_nan=True):
            axes.plot(at, tracked[method], color=colour, linestyle=":", linewidth=1.2, alpha=0.6)
        axes.plot(at, values, color=colour, linestyle=style, marker="o", markersize=4, linewidth=1.8)
    axes.set_xlabel(axis.label)
    axes.set_ylabel(_counted_targets(cut))
    axes.set_ylim(0, 1.03 * targets)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    known = {method: values[np.isfinite(values)] for method, values in shown.items()}
    name_lines(axes, {method: values[-1] for method, values in known.items() if values.size}, at[-1], "{:.0f}")
    plain_axes(axes)
    return figure


def place_values(axes: Axes, axis: Axis) -> Sequence[float]:
    """Return the positions of an axis's values below a line; texts are written there, upwards if they would overlap.

    Args:
        axes: The axes of the line.
        axis: The axis.

    Returns:
        The positions, in the unit of the axis; 0, 1, ... for texts.
    """
    if not isinstance(axis.values[0], str):
        return axis.values
    upwards = len(axis.names) * max(map(len, axis.names)) > LINE_CHARACTERS
    axes.set_xticks(range(len(axis.names)), axis.names, rotation=90 if upwards else 0)
    return range(len(axis.names))


def _draw_map(
    axes: Axes,
    values: Float[np.ndarray, "R C"],
    whole: Float[np.ndarray, "R C"],
    rows: Axis,
    columns: Axis,
    targets: int,
):
    """Draw one map, with a number in every cell if there is space.

    Args:
        axes: The panel.
        values: Number of targets in each cell.
        whole: Number of tracked targets in each cell, written in brackets if it differs.
        rows: The axis of the rows.
        columns: The axis of the columns.
        targets: Number of targets in a scenario.
    """

    def text_of(cell, value):
        more = whole[cell]
        text = _short_number(value) if more == value else f"{_short_number(value)}\n({_short_number(more)})"
        weight = "bold" if value == targets else "normal"
        return text, {"fontsize": 8 if more == value else 7, "fontweight": weight}

    return draw_map(axes, values, Normalize(0, targets), rows, columns, text_of)


def draw_map(
    axes: Axes,
    values: Float[np.ndarray, "R C"],
    scale: Normalize,
    rows: Axis,
    columns: Axis,
    text_of: Callable[[tuple[int, ...], float], tuple[str, dict[str, Any]]],
) -> AxesImage:
    """Draw a map, with a text in every cell if there is space, and return its image.

    Args:
        axes: The panel.
        values: Value of each cell, in the unit of the scale; NaN: blank.
        scale: The colour scale.
        rows: The axis of the rows.
        columns: The axis of the columns.
        text_of: Function that returns the text of a cell and its style, for the indices of the cell and its value
            [in the unit of the scale].
    """
    image = axes.imshow(values, cmap=TRACKED, norm=scale, aspect="equal")
    for cell, value in np.ndenumerate(values):
        if np.isfinite(value) and max(values.shape) <= MOST_NUMBERS:
            text, style = text_of(cell, value)
            axes.annotate(text, cell[::-1], color=ink_on(image.to_rgba(value)), ha="center", va="center", **style)
    frame_map(axes, rows, columns)
    return image


def frame_map(axes: Axes, rows: Axis, columns: Axis) -> None:
    """Label the rows and the columns of a map, and draw white lines between them.

    Args:
        axes: The axes of the map.
        rows: The axis of the rows.
        columns: The axis of the columns.
    """
    for axis, given in ((axes.xaxis, columns), (axes.yaxis, rows)):
        every = -(-len(given.values) // MOST_NAMES)
        axis.set_ticks(range(0, len(given.values), every), given.names[::every])
    if max(map(len, columns.names)) > min(LEVEL, MAP_CHARACTERS / min(len(columns.values), MOST_NAMES)):
        axes.tick_params(axis="x", rotation=90)
    axes.tick_params(colors=QUIET, labelsize=8.5, length=0)
    axes.set_xticks(np.arange(len(columns.values) - 1) + 0.5, minor=True)
    axes.set_yticks(np.arange(len(rows.values) - 1) + 0.5, minor=True)
    axes.grid(which="minor", color=PAPER, linewidth=1.5)
    axes.tick_params(which="minor", length=0)
    axes.spines[:].set_visible(False)


def _draw_colour_bar(figure: Figure, image, panels, targets: int, cut: bool) -> None:
    ticks = sorted({round(part * targets) for part in (0, 0.25, 0.5, 0.75, 1)})
    colour_bar(figure, image, panels, _counted_targets(cut), ticks)


def _counted_targets(cut: bool) -> str:
    return "executable targets" if cut else "tracked targets"


def _short_number(value: float) -> str:
    return f"{value:.0f}" if value == round(value) else f"{value:.1f}"


def has_not_executable(
    tracked: Mapping[str, Float[np.ndarray, "..."] | Int[np.ndarray, "..."]],
    shown: Mapping[str, Float[np.ndarray, "..."] | Int[np.ndarray, "..."]],
) -> bool:
    """Return True if any scenario has tracked targets that are not executable.

    Args:
        tracked: Number of tracked targets, or of the scenarios that track each target, by method [1].
        shown: The same numbers of executable targets [1].
    """
    return any(not np.array_equal(tracked[method], shown[method], equal_nan=True) for method in tracked)


def _counted(tracked: Mapping[str, np.ndarray], shown: Mapping[str, np.ndarray], targets: int) -> str:
    if not has_not_executable(tracked, shown):
        return f"Tracked targets of {targets}."
    return f"Of {targets} targets, those to which a proven motion leads; in brackets: tracked targets."


def _percent_pair(shown: np.ndarray, tracked: np.ndarray, targets: int) -> str:
    if np.array_equal(shown, tracked, equal_nan=True):
        return _mean_percent(tracked, targets)
    return f"{_mean_percent(shown, targets)} ({_mean_percent(tracked, targets)})"


def _mean_percent(values: Float[np.ndarray, "*n"], targets: int) -> str:
    """Return the mean over the planned scenarios in percent, as text."""
    known = values[np.isfinite(values)]
    return f"{100 * known.mean() / targets:.2f} %" if known.size else "not planned"


def _success_note(paper: Mapping[str, float] | None, reachability: int | None, cut: bool, has_scenarios: bool) -> str:
    bars = "Wide bar: targets tracked. Narrow bar: scenarios complete, with their 95 % confidence interval (Wilson)."
    parts = ["Pale: tracked, but not executable."] if cut else []
    parts += ["Diamond: the paper's figure."] if paper else []
    note = " ".join([*parts, *dashed_note(reachability)])
    return f"{bars}\n{note}".strip() if has_scenarios else note


def dashed_note(reachability: object) -> list[str]:
    """Return the note on the dashed line of reachable targets; [] if reachability is None."""
    return [] if reachability is None else ["Dashed: targets known to be reachable."]
