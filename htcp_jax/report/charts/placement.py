"""Charts of a placement search: map of the planned mountings, and Pareto front of two objectives.

```python
place_map(read_search("out/duct"))
```
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from htcp_jax.placement import ranges
from htcp_jax.report.charts.style import INK, PAPER, QUIET, new_figure, plain_axes
from htcp_jax.report.place_tables import SearchTable

OBJECTIVE = LinearSegmentedColormap.from_list("objective", ["#a9d6c9", "#3f9fae", "#1f6396", "#12305e"])
OBJECTIVE = OBJECTIVE.with_extremes(bad=OBJECTIVE(0.6))  # bad: unknown values, such as the cycle time without a motion
SHARE = LinearSegmentedColormap.from_list("share", ["#dfe3e6", "#c3cad0", "#6f7c88"])
NEARLY, LOST, RANK = "#e69f00", "#b9c0c6", "#c2185b"
NEAR = 0.9  # minimum share of executable targets in a nearly complete mounting
HOLLOW = "hollow"
MARKS = "x", "+", "1", "2", "3", "4"  # markers of the reasons of failure, the most frequent reason first
MOST_PARAMETERS, MOST_NUMBERS = 8, 9

APART = 0.1  # minimum distance of two numbers / panel width; a number closer to an earlier one is omitted


class Ending(NamedTuple):
    """Result that mountings have in common, with their number, and the marker and colour that show it."""

    words: str
    count: int
    mark: str
    colour: str | tuple


def place_map(found: SearchTable, colliding_bodies: Mapping[str, int] | None = None) -> Figure:
    """Draw every planned mounting over every pair of parameters, for at most eight parameters.

    Complete and nearly complete mountings have their own markers; the marker of all others shows the reason of failure.
    Ranked mountings are ringed, and the first ranks numbered.

    Args:
        found: The results of the search.
        colliding_bodies: Colliding bodies, with their counts in a sample of the failed mountings.
    """
    shown = found.parameters[:MOST_PARAMETERS]
    d, m = len(shown), max(1, min(len(shown), MOST_PARAMETERS) - 1)
    wide, half = (2, 1) if m == 1 else (m, m // 2)
    figure = new_figure(5.2 if m == 1 else 8.8, f"Placement search: {found.name}", _note(found))
    grid = figure.add_gridspec(m, wide)
    ticks = 3 if m > 3 else 5
    for row in range(m):
        for column in range(row + 1):
            axes = figure.add_subplot(grid[row, column])
            _panel(axes, found, column, row + 1 if d > 1 else None)
            _label_axis(axes, shown[column], shown[row + 1] if d > 1 else None, row == m - 1, column == 0, ticks)
    _draw_lists(figure, grid[0, 1] if m == 1 else grid[:half, half:], found, colliding_bodies)
    return figure


def place_pareto_front(found: SearchTable) -> Figure:
    """Draw the ranked mountings by two objectives, numbered, and the Pareto front."""
    note = "Numbers: rank. Line: Pareto front. Tails: worst case when perturbed by up to "
    figure = new_figure(5.2, f"Two objectives: {found.name}", f"{note}{found.perturbed}.")
    axes = figure.subplots()
    x, y = found.objective.T
    for start, end in zip(found.objective, found.worst, strict=True):
        if np.isfinite(end).all():
            axes.plot([start[0], end[0]], [start[1], end[1]], color=LOST, linewidth=1.2, alpha=0.7, zorder=1)
    axes.scatter(x[~found.pareto_front], y[~found.pareto_front], color=LOST, s=46, zorder=3)
    order = np.flatnonzero(found.pareto_front)[np.argsort(x[found.pareto_front], kind="stable")]
    axes.plot(x[order], y[order], color=RANK, linewidth=1.5, marker="o", markersize=7, zorder=4)
    for number, at in enumerate(found.objective, 1):
        bold = "bold" if found.pareto_front[number - 1] else "normal"
        axes.annotate(str(number), at, (6, 5), textcoords="offset points", color=INK, fontsize=9, fontweight=bold)
    axes.set(xlabel=found.objective_name(0), ylabel=found.objective_name(1))
    plain_axes(axes, grid="both")
    return figure


def _note(found: SearchTable) -> str:
    reported = f"{len(found.values):,} mountings. Incomplete ones are darker the more targets are executable."
    if len(found.ranked):
        reported += " Ring: proven motion; number: rank."
    more = len(found.parameters) - MOST_PARAMETERS
    return reported if more <= 0 else f"{reported}\nNot drawn: {more} more parameters."


def _panel(axes: Axes, found: SearchTable, column: int, row: int | None) -> None:
    """Draw the mountings over two parameters, or over one parameter and the share of executable targets.

    Args:
        axes: The panel.
        found: The results of the search.
        column: Index of the horizontal parameter.
        row: Index of the vertical parameter; None: the vertical axis is the share of executable targets.
    """
    points = found.values[:, [column, column if row is None else row]].copy()
    ranked = found.ranked[:, [column, column if row is None else row]].copy()
    if row is None:
        points[:, 1], ranked[:, 1] = 100 * found.done, 100
    size = float(np.clip(9000 / len(points), 3, 26))
    nearly = _nearly(found)
    for reason, mark in _marks(found).items():
        which = np.array([words == reason for words in found.lost]) & ~nearly
        look = {"c": found.done[which], "cmap": SHARE, "norm": Normalize(0, NEAR), "marker": mark}
        axes.scatter(*points[which].T, **look, s=size, linewidths=0.8, zorder=1)
    axes.scatter(*points[nearly].T, facecolors="none", edgecolors=NEARLY, s=size, linewidths=0.8, zorder=2)
    order = np.flatnonzero(found.complete)[np.argsort(found.left[found.complete, 0], kind="stable")]
    look = {"c": found.left[order, 0], "cmap": OBJECTIVE, "norm": _norm(found), "plotnonfinite": True}
    axes.scatter(*points[order].T, **look, s=size, linewidths=0, zorder=3)
    axes.scatter(*ranked.T, facecolors="none", edgecolors=RANK, s=2.2 * size + 8, linewidths=1.0, zorder=4)
    _number_ranks(axes, ranked, points)


def _number_ranks(axes: Axes, ranked: Float[np.ndarray, "r 2"], points: Float[np.ndarray, "n 2"]) -> None:
    """Write the numbers of the first ranks, except a number that would cover a better rank's."""
    low, high = points.min(axis=0), points.max(axis=0)
    width = np.where(high > low, high - low, 1.0)
    taken: list[np.ndarray] = []
    for number, at in enumerate(ranked[:MOST_NUMBERS], 1):
        place = (at - low) / width
        if all(np.abs(place - other).max() >= APART for other in taken):
            taken.append(place)
            look = {"color": RANK, "fontsize": 8, "fontweight": "bold", "zorder": 6}
            text = axes.annotate(str(number), at, (4.5, 3), textcoords="offset points", **look)
            text.set_path_effects([withStroke(linewidth=2.5, foreground=PAPER)])


def _label_axis(
    axes: Axes, below: ranges.ShownParameter, left: ranges.ShownParameter | None, lowest: bool, first: bool, ticks: int
) -> None:
    plain_axes(axes, grid="both")
    axes.tick_params(labelsize=8.5, colors=QUIET, labelbottom=lowest, labelleft=first)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(ticks))
    axes.margins(0.04)
    for label in (axes.xaxis.label, axes.yaxis.label):
        label.set_fontsize(10 if ticks > 3 else 9)
    axes.set_xlabel(below.label if lowest else "")
    axes.set_ylabel(("targets [%]" if left is None else left.label) if first else "")


def _draw_lists(
    figure: Figure, place: SubplotSpec, found: SearchTable, colliding_bodies: Mapping[str, int] | None
) -> None:
    """Draw the counts of results, of mountings that complete each seam and of colliding bodies, and a colour scale."""
    lists = {"mountings": _result_counts(found)}
    if len(found.seams) > 1:
        lists["each seam alone"] = [Ending(name, count, "s", OBJECTIVE(0.6)) for name, count in found.seams.items()]
    if colliding_bodies:
        reported = f"colliding body ({sum(colliding_bodies.values())} failed)"
        lists[reported] = [Ending(body, count, "s", LOST) for body, count in colliding_bodies.items()]
    inner = place.subgridspec(len(lists) + 1, 1, height_ratios=(*(len(each) + 0.6 for each in lists.values()), 0.35))
    for number, (head, endings) in enumerate(lists.items()):
        _draw_bars(figure.add_subplot(inner[number]), head, endings)
    _draw_scale(figure, figure.add_subplot(inner[len(lists)]), found)


def _draw_scale(figure: Figure, axes: Axes, found: SearchTable) -> None:
    """Draw the colour scale of the objective, or of the share of executable targets if no mounting is complete."""
    works = found.complete.any()
    if works and not np.isfinite(found.left[:, 0]).any():
        axes.axis("off")
        return
    colours = ScalarMappable(_norm(found), OBJECTIVE) if works else ScalarMappable(Normalize(0, 100 * NEAR), SHARE)
    bar = figure.colorbar(colours, cax=axes, orientation="horizontal")
    bar.outline.set_visible(False)
    axes.tick_params(colors=QUIET, labelsize=8.5, length=0)
    axes.set_xlabel(found.objective_name(0) if works else "targets [%]", color=QUIET, fontsize=9)


def _draw_bars(axes: Axes, head: str, endings: Sequence[Ending]) -> None:
    largest = max(1, *(each.count for each in endings))
    for y, (_, count, mark, colour) in enumerate(endings):
        axes.barh(y, count, height=0.6, color=colour, linewidth=0)
        look = {"facecolors": "none", "edgecolors": colour} if mark == HOLLOW else {"color": colour, "marker": mark}
        axes.scatter(-0.05 * largest, y, s=26, clip_on=False, linewidths=1.0, **look)
        axes.annotate(f" {count:,}", (count, y), va="center", color=INK, fontsize=8.5)
    axes.set_title(head, loc="right", color=INK, fontsize=9.5, fontweight="bold")  # it may be wider than the panel
    axes.set_yticks(range(len(endings)), [each.words for each in endings])
    axes.set(xlim=(0, 1.15 * largest), ylim=(len(endings) - 0.5, -0.5), xticks=[])
    axes.spines[:].set_visible(False)
    axes.tick_params(colors=INK, labelsize=8.5, length=0, pad=16)


def _result_counts(found: SearchTable) -> list[Ending]:
    """Return the counts of complete, of nearly complete, and of all other mountings by reason of failure."""
    nearly = _nearly(found)
    ends = [Ending("complete", int(found.complete.sum()), "o", OBJECTIVE(0.6))]
    ends.append(Ending(f"nearly complete: {100 * NEAR:.0f} % of the targets", int(nearly.sum()), HOLLOW, NEARLY))
    counts = Counter(words for words, near in zip(found.lost, nearly.tolist(), strict=True) if words and not near)
    return ends + [Ending(words, counts[words], mark, LOST) for words, mark in _marks(found).items() if counts[words]]


def _marks(found: SearchTable) -> dict[str, str]:
    """Return the marker of each reason of failure, most frequent reason first; rare reasons share the last marker."""
    reasons = [words for words, _ in Counter(filter(None, found.lost)).most_common()]
    return {words: MARKS[min(k, len(MARKS) - 1)] for k, words in enumerate(reasons)}


def _nearly(found: SearchTable) -> Bool[np.ndarray, "n"]:
    return ~found.complete & (found.done >= NEAR)


def _norm(found: SearchTable) -> Normalize:
    known = found.left[found.complete, 0]
    known = known[np.isfinite(known)]
    return Normalize(known.min(), known.max()) if known.size else Normalize(0, 1)
