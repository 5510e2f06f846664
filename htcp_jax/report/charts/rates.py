"""Chart of the share of scenarios that a method completes, over parameters that are drawn at random. See `charts`."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from htcp_jax.report.charts.style import ACROSS, QUIET, line_of, new_figure, plain_axes
from htcp_jax.runs import summary

BINS = 10  # maximum number of bins of a parameter
LARGEST_TEXT = 14  # maximum characters of a text below a panel


def success_rates(
    done: Mapping[str, Float[np.ndarray, "S"]],
    parameters: Mapping[str, np.ndarray],
    *,
    title: str = "Scenarios executable to the last target",
) -> Figure:
    """Draw the share of scenarios that are executable to the last target, one panel per parameter.

    Numbers are in at most BINS bins with about equal numbers of different values, other parameters have a bin for each
    value. A vertical line is the 95 % confidence interval of the bin's rate (Wilson).

    Args:
        done: 1 for scenarios that are executable to the last target, 0 for others, NaN if not planned [1], by method.
        parameters: Values in the scenarios (S,), by label.
        title: The title of the figure.
    """
    note = "Point: a bin of scenarios with similar values, at their mean. Line: 95 % confidence interval (Wilson)."
    across = 2 if len(parameters) == 4 else min(ACROSS, len(parameters))
    down = -(-len(parameters) // across)
    figure = new_figure(down * 2.9 + 1.3, title, note)
    panels = figure.subplots(down, across, squeeze=False, sharey=True)
    for axes in panels.flat[len(parameters) :]:
        axes.axis("off")
    for axes, (label, values) in zip(panels.flat, parameters.items(), strict=False):
        bin_of, at = _bins(values)
        width = 0.012 * (np.ptp(at) or 1.0)
        for k, (method, own) in enumerate(done.items()):
            colour, style = line_of(method)
            rates = [_rate(own[bin_of == each]) for each in range(len(at))]
            rate, low, high = 100 * np.array(rates).T
            x = at + width * (k - (len(done) - 1) / 2)  # next to the other methods'
            axes.vlines(x, low, high, color=colour, linewidth=1.4, alpha=0.55)
            axes.plot(x, rate, color=colour, linestyle=style, marker="o", markersize=4.5, linewidth=1.4, label=method)
        if values.dtype.kind not in "if":
            names = [str(value)[:LARGEST_TEXT] for value in np.unique(values)]
            axes.set_xticks(at, names, rotation=90 if len("".join(names)) > 5 * LARGEST_TEXT / across else 0)
        axes.set_xlabel(label)
        axes.set_ylim(-3, 103)
        plain_axes(axes)
    for line in panels:
        line[0].set_ylabel("scenarios to the last target [%]")
    lines, names = panels[0, 0].get_legend_handles_labels()
    figure.legend(lines, names, loc="outside lower center", ncols=6, frameon=False, labelcolor=QUIET)
    return figure


def _bins(values: np.ndarray) -> tuple[np.ndarray, Float[np.ndarray, "B"]]:
    """Return the bin of each scenario, and the places of the bins: means of their values, or 0, 1, ... for texts."""
    levels, index = np.unique(values, return_inverse=True)
    if values.dtype.kind not in "if":
        return index, np.arange(len(levels), dtype=float)
    parts = np.array_split(np.arange(len(levels)), min(BINS, len(levels)))
    bin_of = np.repeat(np.arange(len(parts)), [len(part) for part in parts])[index]
    return bin_of, np.array([values[bin_of == each].mean() for each in range(len(parts))])


def _rate(done: Float[np.ndarray, "n"]) -> tuple[float, float, float]:
    """Return the share of the planned scenarios that are done, and its confidence interval; NaN if none is planned."""
    known = done[np.isfinite(done)]
    count = int(known.sum())
    return (count / known.size, *summary.rate_interval(count, known.size)) if known.size else (np.nan,) * 3
