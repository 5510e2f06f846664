"""The folder of a sweep's results.

    manifest.json                                     request, provenance and list of finished shards
    targets/<method>-<first>-<last>.parquet           rows of a shard, the scenarios <first> to <last>: see `columns`
    scenarios/<method>-<first>-<last>.parquet         one row per scenario of the shard: see `columns`
    timing/<method>.parquet                           times of a method's scenarios, if requested: see `timing_file`

A file is written under a temporary name and then renamed. A shard's file is valid only if the manifest lists it with
its size and SHA-256. The manifest is written after the files of a shard. If the process dies, a shard is therefore
either complete or not part of the run.
"""

import hashlib
import os
from collections.abc import Collection, Iterable, Sequence
from io import BufferedReader
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from pydantic import ValidationError

from htcp_jax.errors import InputError
from htcp_jax.io import arrays
from htcp_jax.jobs import grid_axes, points_of
from htcp_jax.motion import Plans
from htcp_jax.notebook import html_facts
from htcp_jax.runs import tables
from htcp_jax.runs.finite import check_table
from htcp_jax.runs.identity import other_format, recorded_config
from htcp_jax.runs.labels import labels_of, parameter_names, varied_columns
from htcp_jax.runs.manifest import (
    FORMAT,
    MANIFEST,
    TABLES,
    FileRecord,
    Manifest,
    Seconds,
    ShardRecord,
    missing_rows,
    shard_name,
)
from htcp_jax.runs.plan_folder import SUMMARY
from htcp_jax.runs.summary import summarise
from htcp_jax.runs.tables import empty_tables, plans_of, table_frame
from htcp_jax.runs.times import shard_table, time_table
from htcp_jax.runs.timing_file import Timing, read_timing, with_timing
from htcp_jax.spec import PlanConfig
from htcp_jax.system import files as io_files

if TYPE_CHECKING:
    import pandas


class Run:
    """Results of a sweep, read from its folder. The columns of its tables are described in `columns`."""

    def __init__(self, folder: Path, manifest: Manifest, keep: Any = None):
        self.folder, self.manifest = folder, manifest
        self._keep = keep  # reference that keeps a temporary folder from being deleted
        self._small: dict[str, pa.Table] = {}  # cached tables of scenarios, by file name

    def __repr__(self) -> str:
        state = "finished" if self.complete else "not finished"
        return f"Run({str(self.folder)!r}: {', '.join(self.methods)}; {self.manifest.count} scenarios, {state})"

    def _repr_html_(self) -> str:
        state = "finished" if self.complete else "not finished"
        facts = {method: self._describe(method) for method in self.methods}
        return html_facts(f"{self.manifest.name}: {self.manifest.count:,} scenarios, {state}", facts)

    def _describe(self, method: str) -> str:
        if all(shard.method != method for shard in self.manifest.shards):
            return "not planned yet"
        found = summarise(self.plans(method))
        return (
            f"{100 * found.success_rate:.2f} %: {found.tracked:,} of {found.targets:,} targets, "
            f"{found.complete:,} of {found.scenarios:,} scenarios complete, {found.step_ms:.2f} ms per target"
        )

    def frame(self, table: str = "scenarios", *methods: str) -> "pandas.DataFrame":
        """Return one of the run's tables as a pandas frame.

        Args:
            table: "scenarios", "targets", "shards" or "times". The last one has each scenario's share of its shard's
                times, by attempted targets; they are measurements only if a shard has one scenario.
            *methods: Names of methods; without names, all methods.

        Raises:
            InputError: See `targets`; also if the table is unknown or pandas is not installed.
        """
        if table not in (*TABLES, "shards", "times"):
            raise InputError(f"a run has no table {table!r}; valid: scenarios, targets, shards, times")
        if table == "shards":
            return table_frame((self.only(methods) if methods else self).shards())
        return table_frame(getattr(self, table)(*methods))

    def only(self, methods: Collection[str]) -> "Run":
        """Return the run of some of its methods; names of other methods are ignored."""
        shards = tuple(shard for shard in self.manifest.shards if shard.method in methods)
        kept = {"methods": tuple(name for name in self.methods if name in methods), "shards": shards}
        return Run(self.folder, self.manifest.model_copy(update=kept), self._keep)

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of all methods that have been requested."""
        return self.manifest.methods

    @property
    def complete(self) -> bool:
        """True if every method has planned every scenario up to the limit."""
        return not self.unfinished()

    def unfinished(self) -> dict[str, int]:
        """Return the number of scenarios left to plan, by method; finished methods are not included."""
        left = {method: sum(map(len, self.missing(method))) for method in self.methods}
        return {method: count for method, count in left.items() if count}

    @property
    def config(self) -> PlanConfig:
        """Configuration shared by all scenarios. The parameters that vary are columns of `scenarios()`."""
        return recorded_config(self.manifest.config, self.folder / MANIFEST)

    @property
    def varied(self) -> tuple[str, ...]:
        """Keys of the configuration that vary between scenarios, such as keys of robots, workpieces and settings.

        Keys that have columns in every run, such as margin_m, are not included.
        """
        return grid_axes.varied_keys([name for group in self.manifest.grid for axis in group["axes"] for name in axis])

    def points(self, full: bool = False) -> tuple[grid_axes.ScenarioPoint, ...]:
        """Return the scenarios with their complete configurations, by number, up to the last one to plan.

        Args:
            full: True also returns all later scenarios of the grid.

        Raises:
            InputError: If the grid in the manifest cannot be read.
        """
        config, grid = self.config, self.manifest.grid
        joints = [column.rpartition("_")[0] for column in self.manifest.joints]
        try:
            groups = tuple(grid_axes.from_record(group, joints) for group in grid)
            stated = frozenset(key for group in grid for key in group.get("stated", ()))
            points = points_of(str(self.folder / MANIFEST), config, groups, stated, len(joints))
            return tuple(islice(points, self.manifest.full if full else self.manifest.rows))
        except InputError:
            raise
        except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
            raise InputError(f"{self.folder / MANIFEST}: its grid cannot be read: {error!r}") from None

    def targets(self, *methods: str) -> pa.Table:
        """Return the table of targets, with one row per method, scenario and target.

        Args:
            *methods: Names of methods; without names, all methods.

        Raises:
            InputError: If the run has no results of a method, or if a file is missing or damaged.
        """
        return self._read("targets", methods)

    def scenarios(self, *methods: str) -> pa.Table:
        """Return the table of scenarios, with one row per method and scenario.

        If the run has been timed, the table includes the times, see `timing_file`.

        Args:
            *methods: Names of methods; without names, all methods.

        Raises:
            InputError: See `targets`; also if a file of times is damaged.
        """
        return with_timing(self.folder, self.manifest.shards, self._read("scenarios", methods))

    def shards(self) -> pa.Table:
        """Return one row per finished shard: its scenarios, its times, and what planned it; see `times.shard_table`."""
        return shard_table(self.manifest)

    def times(self, *methods: str) -> pa.Table:
        """Return one row per method and scenario: its share of the planning time, its seed, and the method's package.

        See `times.time_table`.

        Args:
            *methods: Names of methods; without names, all methods.

        Raises:
            InputError: See `targets`.
        """
        return time_table(self.manifest, self._read("scenarios", methods))

    def timing(self, method: str) -> Timing | None:
        """Return the times of a method; None if the method has not been timed.

        Raises:
            InputError: If the file of times is damaged.
        """
        return read_timing(self.folder, self.manifest.shards, method)

    def plans(self, method: str) -> Plans:
        """Return the plans of one method as arrays; row s is scenario s, up to the last one to plan.

        The status is NO_TARGET in scenarios that are not planned, and after the last target of shorter scenarios.

        Raises:
            InputError: See `targets`.
        """
        rows = self.targets(method), self._read("scenarios", (method,))
        seconds = self.manifest.seconds.get(method, Seconds()).of_plans
        try:
            return plans_of(*rows, self.manifest.rows, self.manifest.joints, seconds)
        except (IndexError, KeyError, ValueError) as error:
            raise InputError(f"{self.folder}: the rows of {method} do not belong to this run: {error}") from None

    def labels(self) -> dict[int, str]:
        """Return the label of every planned scenario, by number: its group and the values of the varied parameters.

        Raises:
            InputError: See `Run.targets`.
        """
        methods = tuple(dict.fromkeys(shard.method for shard in self.manifest.shards))
        rows = self._read("scenarios", methods)
        return labels_of(rows, varied_columns(self.manifest.grid, parameter_names(rows)).values())

    def result_files(self) -> dict[str, str]:
        """Return the SHA-256 of the files with targets of finished shards, by path in the folder."""
        files = (self.shard_files(shard)["targets"] for shard in self.manifest.shards)
        return {str(file.relative_to(self.folder)): record.sha256 for file, record in files}

    def missing(self, method: str) -> list[Sequence[int]]:
        """Return the scenarios that a method has not planned yet, see `missing_rows`."""
        return missing_rows(self.manifest, method)

    def shard_files(self, shard: ShardRecord) -> dict[str, tuple[Path, FileRecord]]:
        """Return the two files of a shard with their records, by name of their tables."""
        name = shard_name(shard.method, shard.first, shard.last)
        return {table: (self.folder / table / name, getattr(shard, table)) for table in TABLES}

    def _read(self, table: str, methods: Iterable[str]) -> pa.Table:
        for method in methods:
            if method not in self.methods:
                raise InputError(f"{self.folder} has no results of {method!r}; it has {', '.join(self.methods)}")
        wanted = tuple(methods) or self.methods
        order = sorted(
            (shard for shard in self.manifest.shards if shard.method in wanted),
            key=lambda shard: (wanted.index(shard.method), shard.first),
        )
        if not order:
            raise InputError(f"{self.folder} has no finished shard of {', '.join(wanted)} yet")
        schema = empty_tables(self.manifest.joints, self.varied)[table].schema
        rows = pa.concat_tables(self._read_shard(shard, table, schema) for shard in order)
        if all(shard.numbers is None for shard in order):
            return rows
        # shards with gaps contain scenarios between each other's
        place = {method: k for k, method in enumerate(wanted)}
        by_method = np.array([place[name] for name in rows["method"].to_pylist()])
        target = rows["target"].to_numpy() if table == "targets" else np.zeros(len(rows), int)
        return rows.take(pa.array(np.lexsort((target, rows["scenario"].to_numpy(), by_method))))

    def _read_shard(self, shard: ShardRecord, table: str, schema: pa.Schema) -> pa.Table:
        """Return the checked rows of one file. Files of scenarios are small and cached."""
        file, record = self.shard_files(shard)[table]
        if table != "scenarios":
            return self._checked(file, table, record, schema)
        if file.name not in self._small:
            self._small[file.name] = self._checked(file, table, record, schema)
        return self._small[file.name]

    def _checked(self, file: Path, table: str, record: FileRecord, schema: pa.Schema) -> pa.Table:
        rows = _read_parquet(file, record, schema)
        check_table(rows, table, file, self.manifest.joints)
        return rows


def open_run(folder: str | Path) -> Run:
    """Open the run in a folder. The run may be unfinished.

    Raises:
        InputError: If the folder contains no run, or if the manifest is damaged or of another version.
    """
    folder = Path(folder)
    try:
        raw = io_files.read_json(folder / MANIFEST, folder)
    except OSError as error:
        if isinstance(error, FileNotFoundError) and (folder / SUMMARY).exists():
            what = "contains a plan of htcp plan, not a run; open it with htcp view, htcp render or htcp validate"
            raise InputError(f"{folder} {what}") from None
        raise InputError(f"{folder} contains no run: cannot read {MANIFEST}: {error.strerror}") from None
    except InputError as error:
        what = io_files.cause(error, folder / MANIFEST)
        raise InputError(f"{folder / MANIFEST} is damaged or not a manifest of a run: {what}") from None
    if isinstance(raw, dict) and raw.get("format", FORMAT) != FORMAT:
        raise other_format(folder, f"{MANIFEST} has format {raw['format']}, not {FORMAT}")
    try:
        return Run(folder, Manifest.model_validate(raw))
    except ValidationError as error:
        where = ".".join(map(str, error.errors()[0]["loc"]))
        what = f"{where}: " if where else ""
        raise InputError(
            f"{folder / MANIFEST} is damaged or not a manifest of a run: {what}{error.errors()[0]['msg']}"
        ) from None


def file_fault(file: Path, record: FileRecord) -> str | None:
    """Return the fault of a table's file as text; None if the file has the recorded size and checksum."""
    try:
        with io_files.opened(file, file.parents[1]) as stream:
            return _fault_of(stream, record)
    except InputError as error:
        return str(error).removeprefix(f"{file}: ")
    except OSError as error:
        return f"cannot be read ({error.strerror})"


def _fault_of(stream: BufferedReader, record: FileRecord) -> str | None:
    if (size := os.fstat(stream.fileno()).st_size) != record.bytes:
        return f"has {size:,} bytes instead of {record.bytes:,}"
    if hashlib.file_digest(stream, "sha256").hexdigest() != record.sha256:
        return "was changed after it was written"
    return None


def _read_parquet(file: Path, record: FileRecord, schema: pa.Schema) -> pa.Table:
    if problem := file_fault(file, record):
        raise InputError(f"{file} {problem}; run the same sweep again to replan its scenarios")
    with io_files.opened(file, file.parents[1]) as stream:
        rows = arrays.read_parquet(stream, file, record.rows, exact=True)
    rows = tables.with_new_columns(rows, schema)
    followers = [name for name in rows.column_names if name.startswith(tables.FOLLOWER) and name not in schema.names]
    if not rows.drop_columns(followers).schema.equals(schema):
        raise other_format(file.parents[1], f"{file.parent.name}/{file.name} has other columns")
    if len(rows) != record.rows:
        raise InputError(f"{file} does not belong to this run: its number of rows differs")
    return rows
