"""Charts of sweep results, in one style. Every function returns a matplotlib Figure; a notebook shows it as it is.

Results come as a mapping from method to array, S scenarios by T targets, as in `Plans`:

    charts.survival({"baseline": plans_a.status, "nspace-sqp": plans_b.status})

A status below zero marks a target that does not exist or a scenario that is not planned yet. Colours are told apart
by colour-blind eyes and never carry a meaning alone: methods differ in line style too, and each line has its name;
reasons differ in marker; the cells of a map hold their number. Drawing needs no screen.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Int8
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
    decimal,
    heading,
    line_of,
    name_lines,
    new_figure,
    outer_labels,
    plain_axes,
)
from htcp_jax.metrics import is_tracked
from htcp_jax.status import Status

TRACKED = LinearSegmentedColormap.from_list("tracked", ["#fbf3e4", "#d8dfd6", "#8fb8cf", "#3f82b5", "#0d3f6e"])
CONTRAST = 2.5  # exponent of the colour scale: most scenarios get far, so the upper end needs the most colours

REASONS = {
    Status.QP_INFEASIBLE: ("#e69f00", "s"),
    Status.ITERATION_LIMIT: ("#0072b2", "o"),
    Status.ESCAPE_EXHAUSTED: ("#d55e00", "D"),
    Status.PATH_BLOCKED: ("#aa4499", "^"),
    Status.QP_FAILED: ("#000000", "X"),
}


class Axis(NamedTuple):
    """One axis of a grid of scenarios."""

    label: str  # with its unit
    values: Sequence[float]


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
        heading(axes, method, f"{100 * np.nanmean(tracked[method]) / targets:.2f} %")
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
    for axes, value in zip(panels[0], slices.values, strict=True):
        axes.set_title(f"{slices.label.split(' [')[0]} = {value:.6g}", color=QUIET, fontsize=10)
    for line, (method, cube) in zip(panels, tracked.items(), strict=True):
        for axes, layer in zip(line, cube, strict=True):
            image = _map(axes, layer, rows, columns, targets)
        line[0].set_ylabel(
            f"{method}\n{100 * np.nanmean(cube) / targets:.2f} %", color=INK, fontweight="bold", fontsize=10
        )
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
    for method, values in tracked.items():
        colour, style = line_of(method)
        axes.plot(axis.values, values, color=colour, linestyle=style, marker="o", markersize=4, linewidth=1.8)
    axes.set_xlabel(axis.label)
    axes.set_ylim(0, 1.03 * targets)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    name_lines(axes, {m: v[-1] for m, v in tracked.items()}, axis.values[-1], "{:.0f}")
    plain_axes(axes)
    return figure


# Along the path


def survival(
    status: Mapping[str, Int8[np.ndarray, "S T"]],
    *,
    ceiling: Int[np.ndarray, "S"] | None = None,
    title: str = "How far the scenarios get",
) -> Figure:
    """The number of scenarios that track each target, over the target's index; a scenario ends at its first failure.

    ceiling: the longest prefix of targets known to be reachable, of each scenario.
    """
    note = "Scenarios that track the target; a scenario ends at its first failure."
    figure = new_figure(4.6, title, note + (" Dashed: what is known to be reachable." if ceiling is not None else ""))
    axes = figure.subplots()
    scenarios, targets = next(iter(status.values())).shape
    if ceiling is not None:
        reachable = (ceiling[:, None] > np.arange(targets)[None, :]).sum(axis=0)
        axes.step(range(targets), reachable, where="mid", color=INK, linewidth=1.1, linestyle=(0, (4, 2)))
    ends = {}
    for method, table in status.items():
        alive = (is_tracked(table) & (table >= 0)).sum(axis=0)
        colour, style = line_of(method)
        axes.step(range(targets), alive, where="mid", color=colour, linestyle=style, linewidth=2)
        ends[method] = alive[-1]
    axes.set(xlim=(0, targets - 1), ylim=(0, 1.03 * scenarios))
    axes.set_xlabel("target")
    axes.set_ylabel(f"scenarios of {scenarios}")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    name_lines(axes, ends, targets - 1, "{:.0f}")
    plain_axes(axes)
    return figure


def stops(status: Mapping[str, Int8[np.ndarray, "S T"]], *, title: str = "Where and why scenarios end") -> Figure:
    """A marker for every target at which scenarios of a method fail: its shape and colour tell the reason, its area
    their number."""
    figure = new_figure(0.55 * len(status) + 1.9, title, "A marker's area is the number of scenarios that end there.")
    axes = figure.subplots()
    targets = next(iter(status.values())).shape[1]
    found = {reason for table in status.values() for reason in REASONS if (table == reason).any()}
    shown = [reason for reason in REASONS if reason in found]
    for y, table in enumerate(status.values()):
        lanes = [reason for reason in shown if (table == reason).any()]
        for lane, reason in enumerate(lanes):
            counts = (table == reason).sum(axis=0)
            at = np.flatnonzero(counts)
            colour, marker = REASONS[reason]
            style = {"color": colour, "marker": marker, "alpha": 0.75, "edgecolors": PAPER, "linewidths": 0.6}
            height = y + 0.6 * ((lane + 0.5) / len(lanes) - 0.5)
            axes.scatter(at, np.full(len(at), height), s=22 * counts[at] + 14, zorder=3, clip_on=False, **style)
        where = {"xycoords": ("axes fraction", "data"), "va": "center"}
        axes.annotate(_ended(table), (1.015, y), color=QUIET, fontsize=9, **where)
    for reason in shown:
        colour, marker = REASONS[reason]
        axes.scatter([], [], color=colour, marker=marker, s=46, label=_words(reason))
    if shown:
        axes.legend(loc="lower left", bbox_to_anchor=(-0.01, 1.0), ncols=len(shown), frameon=False, labelcolor=INK)
    axes.set_yticks(range(len(status)), list(status))
    axes.set(xlim=(-1, targets), ylim=(len(status) - 0.5, -0.5))
    axes.set_xlabel("target")
    plain_axes(axes, grid="x")
    return figure


def clearance_along(
    clearance_m: Mapping[str, Float[np.ndarray, "S T"]],
    *,
    title: str = "Clearance along the path",
) -> Figure:
    """The clearance D of the scenarios that track each target, a panel a method: smallest, median, and the band that
    holds the middle eight tenths."""
    across = min(3, len(clearance_m))
    down = -(-len(clearance_m) // across)
    note = "Line: median over the scenarios that track the target. Band: 10 to 90 %. Dots: the smallest."
    figure = new_figure(2.35 * down + 1.1, title, note)
    panels = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
    for axes, (method, values) in zip(panels.flat, clearance_m.items(), strict=False):
        colour = line_of(method)[0]
        low, middle, high, least = _over_scenarios(1e3 * values)
        index = np.arange(len(middle))
        axes.fill_between(index, low, high, color=colour, alpha=0.22, linewidth=0)
        axes.plot(index, middle, color=colour, linewidth=1.9)
        axes.plot(index, least, color=INK, linestyle="none", marker=".", markersize=3)
        axes.set_yscale("log")
        heading(axes, method, f"mean {1e3 * np.nanmean(values):.3g} mm" if np.isfinite(values).any() else "")
        plain_axes(axes)
    decimal(panels[0, 0].yaxis)
    blank_the_rest(panels, len(clearance_m))
    outer_labels(panels, len(clearance_m), "target", "clearance [mm]")
    return figure


def joint_motion(
    joint_step_rad: Mapping[str, Float[np.ndarray, "S T"]],
    *,
    title: str = "Joint motion",
) -> Figure:
    """How far the joints move from one target to the next, |x_t - x_{t-1}|: for every method the distribution over all
    accepted steps, and the median over scenarios along the path."""
    note = "Left: median, middle half, middle nine tenths and longest of all accepted steps. Right: median by target."
    figure = new_figure(max(3.4, 0.42 * len(joint_step_rad) + 1.6), title, note)
    spread, along = figure.subplots(1, 2, width_ratios=(1, 1.1))
    for y, (method, values) in enumerate(joint_step_rad.items()):
        colour, style = line_of(method)
        steps = values[np.isfinite(values) & (values > 0)]
        if steps.size:
            low, first, middle, third, high = np.quantile(steps, (0.05, 0.25, 0.5, 0.75, 0.95))
            spread.plot([low, high], [y, y], color=colour, linewidth=1.5, linestyle=style)
            spread.plot([first, third], [y, y], color=colour, linewidth=8, solid_capstyle="butt", alpha=0.75)
            spread.plot(middle, y, marker="o", color=PAPER, markeredgecolor=INK, markersize=6)
            spread.plot(steps.max(), y, marker="|", color=INK, markersize=11, markeredgewidth=1.6)
        along.plot(_over_scenarios(values)[1], color=colour, linestyle=style, linewidth=1.4)
    spread.set_yticks(range(len(joint_step_rad)), list(joint_step_rad))
    spread.set(ylim=(len(joint_step_rad) - 0.5, -0.5), xscale="log", xlabel="joint step [rad]")
    along.set(yscale="log", xlabel="target", ylabel="joint step [rad]")
    along.set_ylim(bottom=spread.get_xlim()[0])
    decimal(spread.xaxis)
    decimal(along.yaxis)
    plain_axes(spread, grid="x")
    plain_axes(along)
    return figure


def _map(axes: Axes, values: Float[np.ndarray, "R C"], rows: Axis, columns: Axis, targets: int):
    """One map; the number stands in every cell."""
    image = axes.imshow(values, cmap=TRACKED, norm=PowerNorm(CONTRAST, 0, targets), aspect="equal")
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value):
            style = {"color": PAPER if value > 0.82 * targets else INK, "ha": "center", "va": "center", "fontsize": 8}
            text = f"{value:.0f}" if value < targets else f"{targets}"
            axes.annotate(text, (column, row), fontweight="bold" if value == targets else "normal", **style)
    axes.set_xticks(range(len(columns.values)), [f"{value:g}" for value in np.round(columns.values, 6)])
    axes.set_yticks(range(len(rows.values)), [f"{value:g}" for value in np.round(rows.values, 6)])
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


def _over_scenarios(values: Float[np.ndarray, "S T"]) -> Float[np.ndarray, "4 T"]:
    """Tenth percentile, median, ninetieth and smallest of every column's finite values; NaN where there is none."""
    summary = np.full((4, values.shape[1]), np.nan)
    for column in range(values.shape[1]):
        known = values[np.isfinite(values[:, column]), column]
        if known.size:
            summary[:, column] = *np.quantile(known, (0.1, 0.5, 0.9)), known.min()
    return summary


def _success_note(paper: Mapping[str, float] | None, ceiling: int | None) -> str:
    parts = ["Diamond: the paper's figure."] if paper else []
    parts += ["Dashed: what is known to be reachable."] if ceiling is not None else []
    return " ".join(parts)


def _words(reason: Status) -> str:
    return reason.name.replace("_", " ").lower()


def _ended(table: Int8[np.ndarray, "S T"]) -> str:
    complete = (is_tracked(table) | (table < 0)).all(axis=1) & (table >= 0).any(axis=1)
    planned = (table >= 0).any(axis=1)
    return f"{int(complete.sum())} of {int(planned.sum())} complete"
