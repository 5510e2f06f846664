"""File timing/<method>.parquet of a run, which `htcp program --all` and `htcp sweep --feed` write.

The file has one row per scenario; `columns.TIMING` describes its columns. Its metadata contain the feed rate, the
limits, and the hashes of the timed results. If a result has changed since it was timed, its rows are ignored.
"""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from htcp_jax.errors import InputError
from htcp_jax.io import arrays
from htcp_jax.runs.columns import WRITTEN_BY, described
from htcp_jax.runs.finite import check_table
from htcp_jax.system import files

TIMING = "timing"
FEED_HELD_SHARE = 0.99  # a scenario keeps its feed if it is reached on at least this share of the path's length
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
SEAM_FEEDS = "seam_feeds"  # key of `Timing.limits`: feeds by the seam's name [m/s]


@runtime_checkable
class ResultShard(Protocol):
    """Attributes that a shard of results must have, as a `ShardRecord` of a manifest has."""

    method: str
    targets: Any  # a `FileRecord`; only its SHA-256 is used

    @property
    def scenario_numbers(self) -> Sequence[int]:
        """Numbers of its scenarios."""
        ...


class Timing(NamedTuple):
    """The times of one method's scenarios."""

    feed_m_s: float  # required feed rate; with feeds by seam, the largest one
    limits: dict[str, Any]  # joint limits and other keys of the job's section `program`, and SEAM_FEEDS
    rows: pa.Table  # one row per scenario, including scenarios without a complete motion

    @property
    def words(self) -> str:
        """The feed rate and the limits as text.

        Example: "20 mm/s; limits: velocity by the model, full speed in 0.2 s, full acceleration in 0.1 s".
        """
        own = [name for name in LIMITS if self.limits.get(name) is not None]
        given = f"{', '.join(own)} by the job" if own else ""
        model = "" if "velocity" in own else "velocity by the model"
        rest = [f"full {name} in {self.limits[f'full_{name}_s']:g} s" for name in ("speed", "acceleration")]
        kept = [text for text, by in zip(rest, LIMITS[1:], strict=True) if by not in own]
        seams = self.limits.get(SEAM_FEEDS, {})
        feeds = f"{1e3 * min(seams.values()):g} to " if seams else ""
        feeds += f"{1e3 * self.feed_m_s:g} mm/s{' by seam' if seams else ''}"
        return f"{feeds}; limits: {', '.join(filter(None, (given, model, *kept)))}"

    @property
    def timed(self) -> pa.Table:
        """Rows of the scenarios with a motion to the last target; only these have times."""
        return self.rows.filter(pc.is_valid(self.rows["cycle_time_s"]))

    @property
    def held(self) -> int:
        """Number of scenarios that keep their feed on at least FEED_HELD_SHARE of their path."""
        return int((column(self.timed, "feed_held_share") >= FEED_HELD_SHARE).sum())


def column(rows: pa.Table, name: str) -> np.ndarray:
    """Return the numbers in a column of times; null becomes NaN."""
    return rows[name].to_numpy().astype(float)


def timing_file(folder: Path, method: str) -> Path:
    """Return the path of the file with the times of a method."""
    return folder / TIMING / f"{method}.parquet"


def read_timing(folder: Path, shards: Iterable[ResultShard], method: str) -> Timing | None:
    """Return the times of a method's current results; None if the method has not been timed.

    Args:
        folder: The run folder.
        shards: The run's shards.
        method: Name of the method.

    Raises:
        InputError: If the file is damaged.
    """
    file = timing_file(folder, method)
    if not file.exists():
        return None
    try:
        with files.opened(file, folder, files.LARGEST) as stream:
            rows = arrays.read_parquet(stream, file)
        made = json.loads(rows.schema.metadata[WRITTEN_BY])
        if "feed_target" not in rows.column_names:  # written by an older version
            after = SCHEMA.get_field_index("feed_target")
            rows = rows.add_column(after, SCHEMA.field(after), pa.nulls(len(rows), pa.int32()))
        rows = rows.cast(SCHEMA)
        check_table(rows, TIMING, file)
        known = _of_results(shards, method, made["results"])
        there = [number in known for number in rows["scenario"].to_pylist()]
        if not 0 < float(made["feed_m_s"]) < files.LARGEST_NUMBER:
            raise ValueError(f"feed_m_s is {made['feed_m_s']}; {files.NOT_FINITE}")
        return Timing(float(made["feed_m_s"]), dict(made["limits"]), rows.filter(pa.array(there, pa.bool_())))
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError) as error:
        what = " ".join(str(error).split())
        raise InputError(f"{file} is damaged: {what}; delete it and run htcp program --all again") from None


def timing_bytes(timing: Timing, shards: Iterable[ResultShard], method: str) -> bytes:
    """Return the content of the file with the times of a method."""
    of = set(timing.rows["scenario"].to_pylist())
    results = [s.targets.sha256 for s in shards if s.method == method and not of.isdisjoint(s.scenario_numbers)]
    made = {"feed_m_s": timing.feed_m_s, "limits": timing.limits, "results": results}
    rows = described(timing.rows.sort_by("scenario"), TIMING, (), made)
    return arrays.parquet_bytes(rows, write_page_checksum=True)


def with_timing(folder: Path, shards: Iterable[ResultShard], scenarios: pa.Table) -> pa.Table:
    """Return rows of the table of scenarios, with columns of times if any of their methods has been timed.

    Args:
        folder: The run folder.
        shards: The run's shards.
        scenarios: Rows of the table.

    Raises:
        InputError: If a file of times is damaged.
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
    """Return the numbers of the scenarios whose results have not changed since they were timed.

    Args:
        shards: The run's shards.
        method: Name of the method.
        results: SHA-256 of the timed results.
    """
    kept = [s for s in shards if s.method == method and s.targets.sha256 in results]
    return {number for shard in kept for number in shard.scenario_numbers}
