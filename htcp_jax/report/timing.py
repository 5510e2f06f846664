"""Section of the report on the cycle times and feed rates of a part's motions, with charts."""

import math

import numpy as np

from htcp_jax.report.charts.over_grid import Measure, over_line, over_map
from htcp_jax.report.charts.success import Axis
from htcp_jax.report.document import Block, Heading, Picture, Table
from htcp_jax.report.groups import Part
from htcp_jax.report.timing_table import MEANING, timing_row, timing_table
from htcp_jax.runs import columns, timing_file

CYCLE = Measure(
    "Cycle time", "s", "{:.1f}", "From home along the path and back, in seconds; blank if no motion is complete."
)
HELD = Measure(
    "Feed held", "%", "{:.1f}", "Share of the path's length on which the feed is held within 1 %.", (0.0, 100.0)
)


def timing(part: Part) -> Table:
    """Return the table of cycle times and feed rates by method; no rows if no method is timed."""
    rows = [timing_row(method, rows) for method, rows in part.timing.items() if rows is not None]
    return timing_table(rows)


def timing_section(part: Part, made: Table, prefix: str, level: int) -> list[Block]:
    """Return the section on cycle times and feed: table, reasons of feed drops, and charts; empty without times.

    Args:
        part: The part of the run.
        made: The part's table, see `timing`.
        prefix: Prefix of the pictures' names.
        level: Level of the heading.
    """
    if not made.rows:
        return []
    return [
        Heading(level, "Cycle time and feed"),
        f"Timed at {' and '.join(dict.fromkeys(part.timed_with.values()))}. {MEANING}",
        made,
        *_reason_sentences(part),
        *_charts(part, prefix),
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


def _charts(part: Part, prefix: str) -> list[Picture]:
    if not part.axes:
        return []
    axes = {name: Axis(columns.column(name).title, values.tolist()) for name, values in part.axes.items()}
    return [
        _chart(part, axes, measure, values, f"{prefix}{name}")
        for measure, name, values in (
            (CYCLE, "cycle-time", _values(part, "cycle_time_s")),
            (HELD, "feed-held", {m: 100 * v for m, v in _values(part, "feed_held_share").items()}),
        )
    ]


def _chart(part: Part, axes: dict[str, Axis], measure: Measure, values: dict[str, np.ndarray], name: str) -> Picture:
    """Draw a line per method over a single axis, or a map per method over the first two axes."""
    chosen = list(axes)[:2]
    given = {method: part.cells(own, chosen) for method, own in values.items()}
    alt = f"{measure.title} of the scenarios over the grid, by method"
    if len(axes) == 1:
        return Picture(name, over_line(given, axes[chosen[0]], measure), alt)
    note = "Means over the other axes." if len(axes) > 2 else ""
    return Picture(name, over_map(given, axes[chosen[0]], axes[chosen[1]], measure, note), alt)


def _values(part: Part, name: str) -> dict[str, np.ndarray]:
    """Return a column of the times, (S,), by timed method, in the order of the part's scenarios; NaN if unknown."""
    found = {}
    for method, rows in part.timing.items():
        if rows is not None:
            known = dict(zip(rows["scenario"].to_pylist(), timing_file.column(rows, name).tolist(), strict=True))
            found[method] = np.array([known.get(number, math.nan) for number in part.numbers.tolist()])
    return found
