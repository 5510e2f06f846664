"""Chart of the share of scenarios that a method completes, over parameters that are drawn at random. See `charts`."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from htcp_jax.report.charts.style import ACROSS, QUIET, line_of, new_figure, plain_axes
from htcp_jax.runs import labels, summary

BINS, LEAST = 10, 10  # maximum number of bins of a parameter, and minimum number of scenarios in a bin
MARKERS = "osD^vP"  # of the methods, in their order
LARGEST_TEXT = 14  # maximum characters of a text below a panel


def success_rates(
    done: Mapping[str, Float[np.ndarray, "S"]],
    parameters: Mapping[str, np.ndarray],
    *,
    title: str = "Scenarios executable to the last target",
) -> Figure:
    """Draw the share of scenarios that are executable to the last target, one panel per parameter.

    Numbers are in at most BINS bins with about equal numbers of different values: as many as leave LEAST scenarios in
    each, and at least one. At most BINS values that occur several times, and other parameters, have a bin for each
    value. A vertical line is the 95 % confidence interval of the bin's rate (Wilson).

    Args:
        done: 1 for scenarios that are executable to the last target, 0 for others, NaN if not planned [1], by method.
        parameters: Values in the scenarios (S,), by label.
        title: The title of the figure.
    """
    planned = np.isfinite(list(done.values())).any(axis=0)
    bins = {label: _bins(values, int(planned.sum())) for label, values in parameters.items()}
    sizes = np.concatenate([np.bincount(bin_of[planned], minlength=len(at)) for bin_of, at in bins.values()])
    least, most = int(sizes.min()), int(sizes.max())
    size = labels.counted(most, "scenario") if least == most else f"{least} to {most} scenarios"
    note = f"Point: a bin of {size} with similar values, at their mean. Vertical: 95 % confidence interval (Wilson)."
    across = 2 if len(parameters) == 4 else min(ACROSS, len(parameters))
    down = -(-len(parameters) // across)
    figure = new_figure(down * 2.9 + 1.3, title, note)
    panels = figure.subplots(down, across, squeeze=False, sharey=True)
    for axes in panels.flat[len(parameters) :]:
        axes.axis("off")
    for axes, (label, values) in zip(panels.flat, parameters.items(), strict=False):
        bin_of, at = bins[label]
        for k, (method, own) in enumerate(done.items()):
            colour, style = line_of(method)
            rates = [_rate(own[bin_of == each]) for each in range(len(at))]
            rate, low, high = 100 * np.array(rates).T
            more = min(2.2 * len(done), 7) * (1 - (k + 1) / len(done))  # later methods are on top, and smaller
            axes.vlines(at, low, high, color=colour, linewidth=1.4 + more, alpha=0.45)
            drawn = {"color": colour, "linestyle": style, "marker": MARKERS[k % len(MARKERS)], "label": method}
            axes.plot(at, rate, markersize=4.5 + more, linewidth=1.4 + 0.3 * more, **drawn)
        if values.dtype.kind not in "if":
            names = [str(value)[:LARGEST_TEXT] for value in np.unique(values)]
            axes.set_xticks(at, names, rotation=90 if len("".join(names)) > 5 * LARGEST_TEXT / across else 0)
        elif np.ptp(values) > 0:  # the range of all values, also of a single bin
            axes.xaxis.set_major_locator(MaxNLocator(12 // across))
            axes.set_xlim(values.min() - 0.02 * np.ptp(values), values.max() + 0.02 * np.ptp(values))
        axes.set_xlabel(label)
        axes.set_ylim(-3, 103)
        plain_axes(axes)
    for line in panels:
        line[0].set_ylabel("scenarios to the last target [%]")
    lines, names = panels[0, 0].get_legend_handles_labels()
    figure.legend(lines, names, loc="outside lower center", ncols=6, frameon=False, labelcolor=QUIET)
    return figure


def _bins(values: np.ndarray, planned: int) -> tuple[np.ndarray, Float[np.ndarray, "B"]]:
    """Return the bin of each scenario, and the places of the bins: means of their values, or 0, 1, ... for texts.

    Args:
        values: Values in the scenarios (S,).
        planned: Number of planned scenarios.
    """
    levels, index = np.unique(values, return_inverse=True)
    if values.dtype.kind not in "if":
        return index, np.arange(len(levels), dtype=float)
    repeated = len(levels) <= BINS and len(levels) < len(values)
    count = len(levels) if repeated else min(BINS, len(levels), max(1, planned // LEAST))
    parts = np.array_split(np.arange(len(levels)), count)
    bin_of = np.repeat(np.arange(len(parts)), [len(part) for part in parts])[index]
    return bin_of, np.array([values[bin_of == each].mean() for each in range(len(parts))])


def _rate(done: Float[np.ndarray, "n"]) -> tuple[float, float, float]:
    """Return the share of the planned scenarios that are done, and its confidence interval; NaN if none is planned."""
    known = done[np.isfinite(done)]
    count = int(known.sum())
    return (count / known.size, *summary.rate_interval(count, known.size)) if known.size else (np.nan,) * 3
