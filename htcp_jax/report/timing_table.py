"""Table of the cycle times and feed rates of motions, a row per method."""

import math
from collections.abc import Sequence

import numpy as np
import pyarrow as pa

from htcp_jax.report.document import Column, Table, unknown
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


def _reduced_column(reduce, rows: pa.Table, name: str) -> float:
    values = timing_file.column(rows, name)
    values = values[~np.isnan(values)]
    return float(reduce(values)) if values.size else math.nan
