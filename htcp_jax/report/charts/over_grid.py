"""Charts of a quantity over the grid of scenarios: one line or one map per method."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from htcp_jax.report.charts.style import (
    colour_bar,
    heading,
    line_of,
    name_lines,
    new_figure,
    outer_labels,
    panels_with_maps,
    plain_axes,
)
from htcp_jax.report.charts.success import Axis, draw_map, place_values


class Measure(NamedTuple):
    """A quantity to draw."""

    title: str
    unit: str
    form: str  # format of a number, such as "{:.1f}"
    note: str
    scale: tuple[float, float] | None = None  # smallest and largest value of the colour scale; None: from the values


def over_line(
    values: Mapping[str, Float[np.ndarray, "C"]], axis: Axis, measure: Measure, joined: bool = True
) -> Figure:
    """Draw values over an axis of a grid, one line per method.

    Args:
        values: Values by method, in the unit of `measure`; NaN if unknown.
        axis: The axis.
        measure: The quantity.
        joined: False to draw points without lines, for random values of the axis.
    """
    figure = new_figure(4.2, measure.title, measure.note)
    axes = figure.subplots()
    at = place_values(axes, axis)
    for method, own in values.items():
        colour, style = line_of(method)
        axes.plot(at, own, color=colour, linestyle=style if joined else "none", marker="o", markersize=4, linewidth=1.8)
    axes.set_xlabel(axis.label)
    axes.set_ylabel(f"{measure.title.lower()} [{measure.unit}]")
    known = {method: own[np.isfinite(own)] for method, own in values.items()}
    name_lines(axes, {m: own[-1] for m, own in known.items() if own.size}, at[-1], measure.form)
    plain_axes(axes)
    return figure


def over_map(
    values: Mapping[str, Float[np.ndarray, "R C"]], rows: Axis, columns: Axis, measure: Measure, note: str = ""
) -> Figure:
    """Draw one small map of values per method.

    Args:
        values: Values by method, in the unit of `measure`; NaN if unknown; such cells are blank.
        rows: The axis of the rows, downwards.
        columns: The axis of the columns.
        measure: The quantity.
        note: Text to append to the measure's note, below the title.
    """
    note = f"{measure.note} {note}".strip()
    figure, panels, most = panels_with_maps(len(values), 0.6, rows.values, columns.values, measure.title, note)
    scale = _colour_scale(values, measure)
    for axes, (method, own) in zip(panels.flat, values.items(), strict=False):
        image = draw_map(
            axes, own, scale, rows, columns, lambda _, value: (measure.form.format(value), {"fontsize": 7.5})
        )
        mean = own[np.isfinite(own)]
        text = f"mean {measure.form.format(mean.mean())} {measure.unit}" if mean.size else "none timed"
        heading(axes, method, text, most)
    outer_labels(panels, len(values), columns.label, rows.label)
    ticks = () if measure.scale is None else [part * measure.scale[1] for part in (0, 0.25, 0.5, 0.75, 1)]
    colour_bar(figure, image, panels, measure.unit, ticks)
    return figure


def _colour_scale(values: Mapping[str, np.ndarray], measure: Measure) -> Normalize:
    """Return the colour scale.

    Its range is at least a tenth of the largest value, so that small differences have similar colours.
    """
    if measure.scale is not None:
        return Normalize(*measure.scale)
    known = np.concatenate([own[np.isfinite(own)] for own in values.values()])
    return Normalize(min(known.min(), 0.9 * known.max()), known.max()) if known.size else Normalize(0.0, 1.0)
