"""Table and charts of the cycle times and feed rates of a part's motions."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pyarrow as pa

from htcp_jax.report.charts.over_grid import Measure, over_line, over_map
from htcp_jax.report.charts.success import Axis
from htcp_jax.report.document import Block, Column, Heading, Picture, Table, unknown
from htcp_jax.report.groups import Part
from htcp_jax.runs import timing_file

COLUMNS = (
    Column("method", "method"),
    Column("timed", "timed", "scenarios", ",d"),
    Column("scenarios", "of", "", ",d"),
    Column("cycle_min_s", "cycle time", "min s", ".2f"),
    Column("cycle_median_s", "cycle time", "median s", ".2f"),
    Column("cycle_max_s", "cycle time", "max s", ".2f"),
    Column("held", "feed held", "scenarios", ",d"),
    Column("held_min_percent", "feed held", "min %", ".2f"),
    Column("reached_min_mm_s", "feed reached", "min mm/s", ".2f"),
    Column("velocity_percent", "velocity", "max %", ".1f"),
    Column("acceleration_percent", "acceleration", "max %", ".1f"),
    Column("jerk_percent", "jerk", "max %", ".1f"),
    Column("torque_percent", "torque", "max %", ".1f"),
)
SHARES = *timing_file.LIMITS, "torque"
MEANING = (
    "Cycle time: from home along the path and back, for the scenarios with a motion to their last target. Feed held: "
    f"scenarios with the feed within 1 % over at least {100 * timing_file.FEED_HELD_SHARE:g} % of the path's length, "
    "and the lowest share of this length. Feed reached: the lowest feed between run-up and run-down, 0 if the arm "
    "stops there. Velocity, acceleration, jerk: largest share of the limits, on the path. Torque: largest share of the "
    "joints' efforts, over the complete cycle."
)
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


def timing_table(rows: Sequence[dict]) -> Table:
    """Return the table of cycle times and feed rates with the given rows, see `timing_row`, without empty columns."""
    known = tuple(c for c in COLUMNS if not all(unknown(row[c.key]) for row in rows))
    return Table("timing", known, tuple(tuple(row[c.key] for c in known) for row in rows))


def timing_row(method: str, rows: pa.Table) -> dict:
    """Return a method's row in the table of cycle times and feed rates, by column key.

    Args:
        method: The method.
        rows: Rows as in `timing_file`, one per scenario.
    """
    timed = rows.filter(pa.array(~np.isnan(timing_file.column(rows, "cycle_time_s"))))
    cycle, held = timing_file.column(timed, "cycle_time_s"), timing_file.column(timed, "feed_held_share")
    most = {name: 100 * _reduced_column(np.max, timed, f"{name}_share") for name in SHARES}
    return {
        "method": method,
        "timed": len(timed),
        "scenarios": len(rows),
        "cycle_min_s": _reduced_column(np.min, timed, "cycle_time_s"),
        "cycle_median_s": float(np.median(cycle)) if len(cycle) else math.nan,
        "cycle_max_s": _reduced_column(np.max, timed, "cycle_time_s"),
        "held": int((held >= timing_file.FEED_HELD_SHARE).sum()),
        "held_min_percent": 100 * _reduced_column(np.min, timed, "feed_held_share"),
        "reached_min_mm_s": 1e3 * _reduced_column(np.min, timed, "feed_reached_m_s"),
        **{f"{name}_percent": value for name, value in most.items()},
    }


def timing_section(part: Part, made: Table, prefix: str, level: int, label: Callable[[str], str]) -> list[Block]:
    """Return the section on cycle times and feed: table, reasons of feed drops, and charts; empty without times.

    Args:
        part: The part of the run.
        made: The part's table, see `timing`.
        prefix: Prefix of the pictures' names.
        level: Level of the heading.
        label: Function that returns the label of a parameter.
    """
    if not made.rows:
        return []
    return [
        Heading(level, "Cycle time and feed"),
        f"Timed at {' and '.join(dict.fromkeys(part.timed_with.values()))}. {MEANING}",
        made,
        *_reason_sentences(part),
        *_charts(part, prefix, label),
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


def _charts(part: Part, prefix: str, label: Callable[[str], str]) -> list[Picture]:
    if not part.axes:
        return []
    axes = {name: Axis(label(name), values.tolist()) for name, values in part.axes.items()}
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


def _reduced_column(reduce, rows: pa.Table, name: str) -> float:
    values = timing_file.column(rows, name)
    values = values[~np.isnan(values)]
    return float(reduce(values)) if values.size else math.nan
