"""Table of the cycle times and feed rates of motions, a row per method."""

from collections.abc import Sequence

import numpy as np
import pyarrow as pa

from htcp_jax.report.document import Table
from htcp_jax.runs import columns, summary, timing_file

COLUMNS = (
    "method", "timed", columns.total("scenarios"), "cycle_min_s", "cycle_median_s", "cycle_max_s", "held",
    "held_min_percent", "reached_min_mm_s", "velocity_percent", "acceleration_percent", "jerk_percent",
    "torque_percent",
)  # fmt: skip
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
    return Table.of("timing", COLUMNS, rows).without_empty()


def timing_row(method: str, rows: pa.Table) -> dict:
    """Return a method's row in the table of cycle times and feed rates, by column key; unknown values are None.

    Args:
        method: The method.
        rows: Rows as in `timing_file`, one per scenario.
    """
    timed = rows.filter(pa.array(~np.isnan(timing_file.column(rows, "cycle_time_s"))))
    names = "cycle_time_s", "feed_held_share", "feed_reached_m_s", *(f"{name}_share" for name in SHARES)
    cycle, held, reached, *shares = (timing_file.column(timed, name) for name in names)
    row = {
        "method": method,
        "timed": len(timed),
        "scenarios": len(rows),
        "cycle_min_s": summary.reduced(np.min, cycle),
        "cycle_median_s": summary.reduced(np.median, cycle),
        "cycle_max_s": summary.reduced(np.max, cycle),
        "held": int((held >= timing_file.FEED_HELD_SHARE).sum()),
        "held_min_percent": 100 * summary.reduced(np.min, held),
        "reached_min_mm_s": 1e3 * summary.reduced(np.min, reached),
    }
    row |= {f"{name}_percent": 100 * summary.reduced(np.max, each) for name, each in zip(SHARES, shares, strict=True)}
    return {key: None if columns.unknown(value) else value for key, value in row.items()}
