"""Style of all charts: colours and line styles of methods, figures, axes, line labels."""

import colorsys
import math
import zlib
from collections.abc import Mapping, Sequence, Sized

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

INK, QUIET, RULE, PAPER = "#22303c", "#5d6b77", "#dfe3e6", "#ffffff"
WIDTH = 10.0  # width of every figure [inch]
ACROSS = 3  # maximum number of panels next to each other
LEAST_WIDTH, MOST_MAP = 6.0, 5.0  # minimum width of a figure with maps, maximum side of a single map [inch]
NOTE_CHARACTER = 0.083  # width of a character of a note [inch]
CHARACTERS = 10.5  # characters of a panel's heading per inch

LineStyle = str | tuple[float, tuple[float, ...]]  # as in matplotlib

LINES: dict[str, tuple[str, LineStyle]] = {
    "baseline": ("#5a5a5a", "-"),
    "cspace-sample": ("#e69f00", "--"),
    "nspace-sample": ("#d55e00", "--"),
    "nspace-sqp": ("#0072b2", "-"),
    "nspace-ip": ("#56b4e9", "-"),
    "nspace-cmaes": ("#009e73", "-"),
    "nspace-adam": ("#999933", "-"),
    "keep-clear": ("#cc79a7", "-."),
    "hybrid": ("#332288", "-."),
    "beam": ("#6e0a0a", "-"),
}
_OTHERS: dict[str, tuple[str, LineStyle]] = {}  # lines of the methods that are not in LINES and have been drawn
_STYLES: tuple[LineStyle, ...] = ":", (0, (6, 1.5)), (0, (4, 1.5, 1, 1.5)), (0, (1, 3))
_CHOICE, _APART = 64, 20  # number of colours to choose from; sufficient distance of two colours in CIELAB
_XYZ = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)  # of sRGB, IEC 61966-2-1


def line_of(method: str) -> tuple[str, LineStyle]:
    """Return colour and line style of a method.

    The name of a method that is not in LINES determines its colour, unless this is too close to a colour in use: then
    it is the first one that is far enough, or the farthest one. Line styles of these methods alternate.
    """
    if method in LINES:
        return LINES[method]
    if method not in _OTHERS:
        used = np.array([_lab(colour) for colour, _ in (*LINES.values(), *_OTHERS.values())])
        first, count = zlib.crc32(method.encode()) % _CHOICE, _CHOICE * (1 + len(_OTHERS) // (_CHOICE // 2))
        choice = [_other_colour((first + k) % count) for k in range(count)]
        apart = np.array([np.linalg.norm(used - _lab(colour), axis=1).min() for colour in choice])
        own = choice[int(np.argmax(np.minimum(apart, _APART)))]
        _OTHERS[method] = own, _STYLES[len(_OTHERS) % len(_STYLES)]
    return _OTHERS[method]


def _lab(colour: str) -> Float[np.ndarray, "3"]:
    """Return the coordinates of a colour in CIELAB, in which equal distances look equally large (CIE 1976)."""
    x, y, z = np.cbrt(_XYZ @ [_linear(each) for each in to_rgb(colour)] / _XYZ.sum(axis=1))
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def _other_colour(index: int) -> str:
    """Return the colour with an index: dark if even, light if odd; hues are a golden section apart and never repeat."""
    hue = (0.9 + index * 0.6180339887) % 1
    return to_hex(colorsys.hls_to_rgb(hue, 0.42 if index % 2 else 0.3, 0.65))


def ink_on(colour: tuple[float, ...]) -> str:
    """Return the text colour, INK or PAPER, with the greater contrast to a background.

    Args:
        colour: The background, as red, green and blue from 0 to 1; a fourth number is ignored.
    """
    light = _luminance(colour) + 0.05  # contrast and luminance as in the Web Content Accessibility Guidelines 2
    return INK if light**2 > (_luminance(to_rgb(INK)) + 0.05) * (_luminance(to_rgb(PAPER)) + 0.05) else PAPER


def _luminance(colour: tuple[float, ...]) -> float:
    return float(_XYZ[1] @ [_linear(each) for each in colour[:3]])


def _linear(share: float) -> float:
    """Return the light of a component of a colour, 0 to 1."""
    return share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4


def new_figure(height: float, title: str, note: str, width: float = WIDTH) -> Figure:
    """Make an empty figure with a title and a note.

    Args:
        height: Height of the figure [inch].
        title: The title.
        note: Text below the title on how to read the figure, one or more lines.
        width: Width of the figure [inch].
    """
    figure = Figure(figsize=(width, height), dpi=150, facecolor=PAPER, layout="constrained")
    FigureCanvasAgg(figure)
    space = (0.62 + 0.17 * note.count("\n")) / height
    figure.get_layout_engine().set(rect=(0.005, 0.01, 0.99, 1 - space - 0.01), w_pad=0.06, h_pad=0.06)
    figure.text(0.012, 1 - 0.1 / height, title, color=INK, fontsize=14, fontweight="bold", va="top")
    figure.text(0.012, 1 - 0.37 / height, note, color=QUIET, fontsize=10, va="top")
    return figure


def plain_axes(axes: Axes, grid: str = "y") -> None:
    """Style axes with grid lines along one axis and no box."""
    axes.grid(axis=grid, color=RULE, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(RULE)
    axes.tick_params(colors=INK, labelsize=9.5, length=0)
    axes.xaxis.label.set(color=QUIET, fontsize=10)
    axes.yaxis.label.set(color=QUIET, fontsize=10)


def heading(axes: Axes, name: str, figure_of_merit: str, most: int | None = None) -> None:
    """Write the heading of a panel.

    Args:
        axes: The panel.
        name: The name, above the left end.
        figure_of_merit: The panel's main value as text, above the right end.
        most: Maximum number of characters of both in one line; None: they fit.
    """
    name += "\n" * (most is not None and len(name) + len(figure_of_merit) > most)
    axes.set_title(name, loc="left", color=INK, fontsize=10.5, fontweight="bold")
    axes.set_title(figure_of_merit, loc="right", color=QUIET, fontsize=10)


def panels_by_method(
    count: int, row: float, rest: float, title: str, note: str, width: float = WIDTH
) -> tuple[Figure, np.ndarray]:
    """Make a figure with one panel per method, ACROSS next to each other, and return it with its panels.

    Args:
        count: The number of methods.
        row: Height of a row of panels [inch].
        rest: Height of everything else [inch].
        title: The title of the figure.
        note: One line below the title on how to read the figure.
        width: Width of the figure [inch].

    Returns:
        The figure, and its panels (rows, columns); panels after the last method are blank.
    """
    down = -(-count // ACROSS)
    figure = new_figure(down * row + rest, title, note, width)
    panels = figure.subplots(down, min(ACROSS, count), squeeze=False, sharex=True, sharey=True)
    for axes in panels.flat[count:]:
        axes.axis("off")
    return figure, panels


def panels_with_maps(
    count: int, cell: float, rows: Sized, columns: Sized, title: str, note: str
) -> tuple[Figure, np.ndarray, int]:
    """Make a figure with one map per method, see `panels_by_method`; it is as wide as its maps and its texts.

    Args:
        count: The number of maps.
        cell: Largest width of a column if there are several maps [inch]; a single map may be twice as wide.
        rows: The rows of a map.
        columns: The columns of a map.
        title: The title of the figure.
        note: One line below the title on how to read the figure.

    Returns:
        The figure, its panels, and the number of characters above a panel, see `heading`.
    """
    across = min(ACROSS, count)
    cell = min(2 * cell, MOST_MAP / max(len(rows), len(columns))) if count == 1 else cell
    side = min(WIDTH / across - 0.5, cell * len(columns) + 0.7)
    width = min(WIDTH, max(LEAST_WIDTH, NOTE_CHARACTER * len(note), across * (side + 0.5) + 1.2))
    figure, panels = panels_by_method(count, side * len(rows) / len(columns) + 0.4, 1.3, title, note, width)
    figure.set_layout_engine("compressed", **figure.get_layout_engine().get())  # the cells are square
    return figure, panels, int(CHARACTERS * side)


def colour_bar(figure: Figure, image: ScalarMappable, panels: np.ndarray, label: str, ticks: Sequence[float]) -> None:
    """Draw the colour scale at the right of all panels.

    Args:
        figure: The figure.
        image: The image with the scale.
        panels: The panels.
        label: Label of the scale.
        ticks: Values to mark; empty: chosen by matplotlib.
    """
    bar = figure.colorbar(image, ax=panels, fraction=0.02, pad=0.015, aspect=30)
    bar.outline.set_visible(False)
    if len(ticks):
        bar.set_ticks(ticks)
    bar.set_label(label, color=QUIET, fontsize=9)
    bar.ax.tick_params(colors=QUIET, labelsize=9, length=0)


def outer_labels(panels, used: int, below: str, left: str) -> None:
    """Set the outer axis labels of a grid of panels.

    Args:
        panels: The panels, (rows, columns).
        used: The number of panels in use.
        below: Label below the lowest panel of every column.
        left: Label at the left of every row.
    """
    across = panels.shape[1]
    for number, axes in enumerate(panels.flat[:used]):
        axes.xaxis.label.set(color=QUIET, fontsize=10)
        axes.yaxis.label.set(color=QUIET, fontsize=10)
        if number + across >= used:
            axes.set_xlabel(below)
            axes.tick_params(labelbottom=True)
        if number % across == 0:
            axes.set_ylabel(left)


def name_lines(axes: Axes, ends: Mapping[str, float], x: float | int, form: str) -> None:
    """Write each line's name and last value at its end; the labels are spread vertically so that none overlap.

    Args:
        axes: The axes.
        ends: The last value of each line, by method.
        x: The position of the lines' ends on the horizontal axis.
        form: The format of the values, such as "{:.0f}".
    """
    of_panel = axes.transScale + axes.transLimits
    heights = spread_labels({method: of_panel.transform((x, end))[1] for method, end in ends.items()}, 0.062)
    for method, height in heights.items():
        axes.annotate(
            f"{method}  {form.format(ends[method])}",
            (x, ends[method]),
            (1.05, height),
            textcoords="axes fraction",
            va="center",
            color=line_of(method)[0],
            fontsize=10,
            fontweight="bold",
            arrowprops={"arrowstyle": "-", "color": line_of(method)[0], "linewidth": 0.7, "relpos": (0, 0.5)},
        )


def spread_labels(heights: Mapping[str, float], gap: float) -> dict[str, float]:
    """Return the labels' heights moved apart to at least `gap`, in their order, within 0 to 1 if they fit."""
    order = sorted(heights, key=lambda name: heights[name])
    placed = {}
    floor = 0.0
    for name in order:
        placed[name] = max(heights[name], floor)
        floor = placed[name] + gap
    roof = 1.0
    for name in reversed(order):
        placed[name] = min(placed[name], roof)
        roof = placed[name] - gap
    return placed


def number_targets(axes: Axes, targets: int) -> None:
    """Limit a horizontal axis to the indices of targets, 0 to `targets` - 1, with integer ticks.

    Args:
        axes: The axes.
        targets: The number of targets.
    """
    axes.set_xlim(-0.01 * targets, 1.01 * targets - 1)
    ticks = MaxNLocator(integer=True).tick_values(0, max(targets - 1, 1))
    last = targets - 1 - np.diff(ticks).min() / 2  # later ones would overlap the number of the last target
    axes.set_xticks([*(tick for tick in ticks if 0 <= tick < last), targets - 1])


def decimal(axis) -> None:
    """Format a logarithmic axis with plain numbers, and with powers of ten where plain numbers would be long."""
    axis.set_major_locator(LogLocator(numticks=8))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(_tick_text))


def _tick_text(value: float, _position: int) -> str:
    power = round(math.log10(value))
    return f"{value:g}" if power >= -3 else f"$10^{{{power}}}$"
