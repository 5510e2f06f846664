"""Section of the report on the cycle times and feed rates of a part's motions, with charts."""

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from htcp_jax.report.charts.over_grid import Measure, over_line, over_map
from htcp_jax.report.charts.success import Axis
from htcp_jax.report.document import Block, Heading, Table
from htcp_jax.report.groups import Part
from htcp_jax.report.timing_table import MEANING, timing_row, timing_table
from htcp_jax.runs import columns, timing_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TIMED = "cycle-time", "feed-held"  # names of the charts
CYCLE = Measure(
    "Cycle time",
    "s",
    "{:.1f}",
    "From home along the path and back, in seconds; blank without a motion to the last target.",
)
HELD = Measure(
    "Feed held", "%", "{:.1f}", "Share of the path's length on which the feed is held within 1 %.", (0.0, 100.0)
)


def timing(part: Part) -> Table:
    """Return the table of cycle times and feed rates by method; no rows if no method is timed."""
    rows = [timing_row(method, rows) for method, rows in part.timing.items() if rows is not None]
    return timing_table(rows)


def timing_section(part: Part, made: Table, level: int) -> list[Block]:
    """Return the section on cycle times and feed, without its charts: table, reasons of feed drops.

    It is empty without times.

    Args:
        part: The part of the run.
        made: The part's table, see `timing`.
        level: Level of the heading.
    """
    if not made.rows:
        return []
    return [
        Heading(level, "Cycle time and feed"),
        f"Timed at {' and '.join(dict.fromkeys(part.timed_with.values()))}. {MEANING}",
        made,
        *_reason_sentences(part),
    ]


def _reason_sentences(part: Part) -> list[str]:
    """Return a sentence with the reasons of feed drops, most frequent first; [] if there are none."""
    reasons: dict[str, int] = {}
    for rows in filter(None, part.timing.values()):
        for reason in filter(None, rows["feed_reason"].to_pylist()):
            reasons[reason] = reasons.get(reason, 0) + 1
    if not reasons:
        return []
    reported = sorted(reasons.items(), key=lambda item: (-item[1], item[0]))
    text = (
        f"Causes of a lower feed, with the numbers of scenarios: {', '.join(f'{name} ({n})' for name, n in reported)}."
    )
    return [f"{text}{_low_manipulability(part)}"]


def _low_manipulability(part: Part) -> str:
    """Return a sentence on the manipulability at the targets with the lowest feed; empty if it is unknown."""
    there, everywhere = [np.empty(0)], [np.empty(0)]
    for method, at in feed_targets(part).items():
        rows = np.flatnonzero(at >= 0)
        values = part.manipulability[method]
        there, everywhere = [*there, values[rows, at[rows]]], [*everywhere, values[rows].ravel()]
    low, every = (values[np.isfinite(values)] for values in map(np.concatenate, (there, everywhere)))
    if not len(low):
        return ""
    return (
        f" At the target with the lowest feed, the median manipulability over these scenarios is {np.median(low):.3g} "
        f"m/rad; over all of their targets it is {np.median(every):.3g} m/rad."
    )


def feed_targets(part: Part) -> dict[str, np.ndarray]:
    """Return each scenario's target with the lowest feed, (S,), by timed method; -1 if there is none."""
    return {
        method: np.nan_to_num(values, nan=-1).astype(int) for method, values in _values(part, "feed_target").items()
    }


def timing_charts(part: Part) -> dict[str, tuple[Callable[[], "Figure"], str]]:
    """Return functions that draw the charts of TIMED, and the charts' alternative texts; empty without times."""
    if not (part.axes and any(part.timing.values())):
        return {}
    held = {method: 100 * values for method, values in _values(part, "feed_held_share").items()}
    given = zip(TIMED, (CYCLE, HELD), (_values(part, "cycle_time_s"), held), strict=True)
    return {
        name: (partial(_draw, part, measure, values), f"{measure.title} of the scenarios over the grid, by method")
        for name, measure, values in given
    }


def _draw(part: Part, measure: Measure, values: dict[str, np.ndarray]) -> "Figure":
    """Draw a line per method over a single axis, or a map per method over the first two axes."""
    chosen = list(part.axes)[:2]
    axes = [Axis(columns.column(name).title, part.axes[name].tolist()) for name in chosen]
    given = {method: part.cells(own, chosen) for method, own in values.items()}
    if len(axes) == 1:
        return over_line(given, axes[0], measure, joined=not part.is_drawn(chosen[0]))
    return over_map(given, *axes, measure, "Means over the other axes." if len(part.axes) > 2 else "")


def _values(part: Part, name: str) -> dict[str, np.ndarray]:
    """Return a column of the times, (S,), by timed method, in the order of the part's scenarios; NaN if unknown."""
    found = {}
    for method, rows in part.timing.items():
        if rows is not None:
            known = dict(zip(rows["scenario"].to_pylist(), timing_file.column(rows, name).tolist(), strict=True))
            found[method] = np.array([known.get(number, math.nan) for number in part.numbers.tolist()])
    return found
