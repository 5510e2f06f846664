"""Times that `htcp program --all` and `htcp sweep --feed` write into a run: timing/<method>.parquet, a row a scenario.

`columns.TIMING` describes the columns. The file's metadata contain its settings and the hashes of the timed results:
rows for outdated results are ignored.
"""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from htcp_jax.errors import InputError
from htcp_jax.io import files
from htcp_jax.runs.columns import WRITTEN_BY, described

TIMING = "timing"
FEED_HELD_SHARE = 0.99  # share of the path's length from which a scenario keeps its feed
LIMITS = "velocity", "acceleration", "jerk"
SCHEMA = pa.schema(
    [
        ("scenario", pa.int32()),
        *((name, pa.float64()) for name in ("feed_m_s", "cycle_time_s", "path_time_s")),
        *((name, pa.float64()) for name in ("feed_held_share", "feed_reached_m_s")),
        ("feed_reason", pa.string()),
        ("feed_target", pa.int32()),
        *(
            (f"{limit}_{what}", kind)
            for limit in (*LIMITS, "torque")
            for what, kind in (("share", pa.float64()), ("joint", pa.string()))
        ),
    ]
)
COLUMNS = tuple(SCHEMA.names[1:])


@runtime_checkable
class ResultShard(Protocol):
    """Required attributes of a shard of results; a manifest's `ShardRecord` has them."""

    method: str
    first: int
    last: int
    targets: Any  # with its SHA-256


class Timing(NamedTuple):
    """The times of one method's scenarios."""

    feed_m_s: float
    limits: dict[str, Any]  # the job's keys in `program`
    rows: pa.Table  # by scenario, including those without a motion

    @property
    def words(self) -> str:
        """Settings as text.

        "20 mm/s; limits: velocity by the model, full speed in 0.2 s, full acceleration in 0.1 s".
        """
        own = [name for name in LIMITS if self.limits.get(name) is not None]
        given = f"{', '.join(own)} by the job" if own else ""
        model = "" if "velocity" in own else "velocity by the model"
        rest = [f"full {name} in {self.limits[f'full_{name}_s']:g} s" for name in ("speed", "acceleration")]
        kept = [text for text, by in zip(rest, LIMITS[1:], strict=True) if by not in own]
        return f"{1e3 * self.feed_m_s:g} mm/s; limits: {', '.join(filter(None, (given, model, *kept)))}"

    @property
    def timed(self) -> pa.Table:
        """Rows of scenarios with a motion to their last target."""
        return self.rows.filter(pc.is_valid(self.rows["cycle_time_s"]))

    @property
    def held(self) -> int:
        """Number of scenarios that keep their feed on at least FEED_HELD_SHARE of their path."""
        return int((column(self.timed, "feed_held_share") >= FEED_HELD_SHARE).sum())


def column(rows: pa.Table, name: str) -> np.ndarray:
    """Return the numbers in a column, NaN for null."""
    return rows[name].to_numpy().astype(float)


def timing_file(folder: Path, method: str) -> Path:
    """Return the file of a method's times."""
    return folder / TIMING / f"{method}.parquet"


def read_timing(folder: Path, shards: Iterable[ResultShard], method: str) -> Timing | None:
    """Read the times of a method's current results; None without any.

    Args:
        folder: The run folder.
        shards: Its shards.
        method: Name of the method.

    Raises:
        InputError: For a damaged file.
    """
    file = timing_file(folder, method)
    if not file.exists():
        return None
    try:
        with files.opened(file, folder, files.LARGEST) as stream:
            rows = files.read_parquet(stream, file)
        made = json.loads(rows.schema.metadata[WRITTEN_BY])
        if "feed_target" not in rows.column_names:  # of an older version
            after = SCHEMA.get_field_index("feed_target")
            rows = rows.add_column(after, SCHEMA.field(after), pa.nulls(len(rows), pa.int32()))
        rows = rows.cast(SCHEMA)
        known = _of_results(shards, method, made["results"])
        there = [number in known for number in rows["scenario"].to_pylist()]
        return Timing(float(made["feed_m_s"]), dict(made["limits"]), rows.filter(pa.array(there, pa.bool_())))
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError) as error:
        what = " ".join(str(error).split())
        raise InputError(f"{file} is damaged: {what}; without it, htcp program --all creates it again") from None


def timing_bytes(timing: Timing, shards: Iterable[ResultShard], method: str) -> bytes:
    """Return the file's contents."""
    of = set(timing.rows["scenario"].to_pylist())
    results = [s.targets.sha256 for s in shards if s.method == method and not of.isdisjoint(_scenario_numbers(s))]
    made = {"feed_m_s": timing.feed_m_s, "limits": timing.limits, "results": results}
    rows = described(timing.rows.sort_by("scenario"), TIMING, (), made)
    return files.parquet_bytes(rows, write_page_checksum=True)


def with_timing(folder: Path, shards: Iterable[ResultShard], scenarios: pa.Table) -> pa.Table:
    """Add columns of times to rows of the table of scenarios, if any of the methods has been timed.

    Args:
        folder: The run folder.
        shards: Its shards.
        scenarios: Rows of the table.

    Raises:
        InputError: As `read_timing` does.
    """
    methods = dict.fromkeys(scenarios["method"].to_pylist())
    found = {method: known for method in methods if (known := read_timing(folder, shards, method)) is not None}
    if not found:
        return scenarios
    rows = pa.concat_tables(timing.rows for timing in found.values())
    names = [method for method, timing in found.items() for _ in range(len(timing.rows))]
    places = {key: k for k, key in enumerate(zip(names, rows["scenario"].to_pylist(), strict=True))}
    keys = zip(scenarios["method"].to_pylist(), scenarios["scenario"].to_pylist(), strict=True)
    rows = rows.take(pa.array([places.get(key) for key in keys], pa.int64()))
    for name in COLUMNS:
        scenarios = scenarios.append_column(SCHEMA.field(name), rows[name])
    return scenarios


def _of_results(shards: Iterable[ResultShard], method: str, results: list[str]) -> set[int]:
    """Return the scenarios whose results are unchanged."""
    kept = [s for s in shards if s.method == method and s.targets.sha256 in results]
    return {number for shard in kept for number in _scenario_numbers(shard)}


def _scenario_numbers(shard: ResultShard) -> range:
    return range(shard.first, shard.last + 1)
