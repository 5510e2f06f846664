"""Cycle times and feed rates of a part's motions: a table and charts; empty if not timed."""

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
    "Cycle time is from home over the path and back, of the scenarios with a motion to their last target. Feed held: "
    f"within 1 % over {100 * timing_file.FEED_HELD_SHARE:g} % of the path's length. Feed reached: the minimum between "
    "the path's run-up and its run-down, 0 where the arm stops between. "
    "Velocity, acceleration, jerk: of the limits, on the path; torque: of the efforts, all along."
)
CYCLE = Measure(
    "Cycle time", "s", "{:.1f}", "From home over the path and back, in seconds; blank where no motion leads to the end."
)
HELD = Measure(
    "Feed held", "%", "{:.1f}", "Share of the path's length where the feed is held within 1 %.", (0.0, 100.0)
)


def timing(part: Part) -> Table:
    """Table of the times of each method's scenarios; no rows if there are none."""
    rows = [timing_row(method, rows) for method, rows in part.timing.items() if rows is not None]
    return timing_table(rows)


def timing_table(rows: Sequence[dict]) -> Table:
    """Make the table of rows by `timing_row`, without empty columns."""
    known = tuple(c for c in COLUMNS if not all(unknown(row[c.key]) for row in rows))
    return Table("timing", known, tuple(tuple(row[c.key] for c in known) for row in rows))


def timing_row(method: str, rows: pa.Table) -> dict:
    """Summarise one method's times; `rows` as in `timing_file`, one per scenario."""
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
    """Section on the times: table, reasons of feed drops, and charts over the grid; empty without times.

    Args:
        part: The part of the run.
        made: Its table, see `timing`.
        prefix: Start of the pictures' names.
        level: Level of the heading.
        label: Function for the label of a parameter.
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
    """Sentence with the reasons of feed drops, the most frequent first."""
    reasons: dict[str, int] = {}
    for rows in filter(None, part.timing.values()):
        for reason in filter(None, rows["feed_reason"].to_pylist()):
            reasons[reason] = reasons.get(reason, 0) + 1
    if not reasons:
        return []
    reported = sorted(reasons.items(), key=lambda item: (-item[1], item[0]))
    text = f"Where the feed is not reached, it is because of {', '.join(f'{name} ({n})' for name, n in reported)}."
    return [f"{text}{_low_manipulability(part)}"]


def _low_manipulability(part: Part) -> str:
    """Sentence on the manipulability where the feeds are lowest; empty if it is unknown."""
    there, everywhere = [np.empty(0)], [np.empty(0)]
    for method, at in feed_targets(part).items():
        rows = np.flatnonzero(at >= 0)
        values = part.manipulability[method]
        there, everywhere = [*there, values[rows, at[rows]]], [*everywhere, values[rows].ravel()]
    low, every = (values[np.isfinite(values)] for values in map(np.concatenate, (there, everywhere)))
    if not len(low):
        return ""
    return (
        f" At the lowest feed the manipulability is {np.median(low):.3g} m/rad in the median of these scenarios, at "
        f"all of their targets {np.median(every):.3g} m/rad."
    )


def feed_targets(part: Part) -> dict[str, np.ndarray]:
    """Target at which each scenario's feed is lowest (S,), by method that is timed; -1 if it is held or not known."""
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
    """Draw a line over one axis, or maps over the first two axes, with means over the others."""
    chosen = list(axes)[:2]
    given = {method: part.cells(own, chosen) for method, own in values.items()}
    alt = f"{measure.title} of the scenarios over the grid, by method"
    if len(axes) == 1:
        return Picture(name, over_line(given, axes[chosen[0]], measure), alt)
    note = "Means over the other axes." if len(axes) > 2 else ""
    return Picture(name, over_map(given, axes[chosen[0]], axes[chosen[1]], measure, note), alt)


def _values(part: Part, name: str) -> dict[str, np.ndarray]:
    """Column (S,) of each method that is timed, in the order of the part's scenarios."""
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
