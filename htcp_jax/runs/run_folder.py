"""The folder of a sweep's results. Everything in it is written aside and moved into place whole.

    manifest.json                                     what was asked for, what computed it, what is there
    targets/<method>-<first>-<last>.parquet           rows of the scenarios <first> to <last>: a shard
    scenarios/<method>-<first>-<last>.parquet         see run_tables for the columns

A file counts only if the manifest lists it and its size and SHA-256 are as listed. The manifest is written after
the files of a shard, so a shard is in the run wholly or not at all, whenever the process dies.
"""

import hashlib
from collections.abc import Iterable
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import Field, ValidationError, model_validator

from htcp_jax.errors import InputError
from htcp_jax.jobs.config import PlanConfig, Section, validate
from htcp_jax.jobs.grid import MOST
from htcp_jax.jobs.grid_axes import from_record, varied_keys
from htcp_jax.jobs.grid_points import Point, points_of
from htcp_jax.notebook import html_facts
from htcp_jax.planner.plans import Plans
from htcp_jax.planner.registry import NAME
from htcp_jax.runs.identity import config_hash, identity
from htcp_jax.runs.plan_folder import SUMMARY
from htcp_jax.runs.summary import summarise
from htcp_jax.runs.tables import empty_tables, frame_of, plans_of

if TYPE_CHECKING:
    import pandas

MANIFEST = "manifest.json"
TABLES = ("targets", "scenarios")

MethodName = Annotated[str, Field(pattern=f"^{NAME.pattern}$")]  # it stands in names of files
Count = Annotated[int, Field(ge=0, lt=2**53)]
Scenarios = Annotated[int, Field(ge=0, le=MOST)]


class FileRecord(Section):
    """What a file must be to count."""

    rows: Count
    bytes: Count
    sha256: str


class ShardRecord(Section):
    """A finished shard: scenarios `first` to `last` by one method."""

    method: MethodName
    first: Scenarios
    last: Scenarios
    tracked: Count  # targets
    compile_s: float
    run_s: float
    planned_by: Count  # place in the manifest's list of that name
    targets: FileRecord
    scenarios: FileRecord


class Seconds(Section):
    """Wall time of one method."""

    compile_s: float = 0.0
    run_s: float = 0.0


class Manifest(Section):
    """manifest.json. Config, grid, dtype and files say which run it is; `run_writer` never mixes two."""

    format: Literal[1] = 1
    name: str  # of the sweep
    config: dict[str, Any]  # a PlanConfig; names of files are absolute
    grid: tuple[dict[str, Any], ...]
    dtype: str
    files: dict[str, str]  # SHA-256 of the files that config and grid name
    config_hash: str
    seed: int
    joints: tuple[str, ...]  # columns of x in the tables
    targets: Count  # of all scenarios together
    full: Scenarios  # scenarios of the whole grid
    limit: int | None  # of scenarios, as asked for
    count: Scenarios  # scenarios to plan: the first of the grid
    shard_scenarios: Annotated[int, Field(gt=0)]
    methods: tuple[MethodName, ...]
    seconds: dict[str, Seconds] = Field(default_factory=dict)  # per method
    planned_by: tuple[dict[str, Any], ...] = ()  # commit, versions, device
    shards: tuple[ShardRecord, ...] = ()

    @model_validator(mode="after")
    def _agrees_with_itself(self) -> "Manifest":
        if self.config_hash != config_hash(identity(self.config, self.grid, self.dtype, self.files)):
            raise ValueError("config_hash is not that of what it holds")
        seen = set()
        for shard in self.shards:
            place = shard.method, shard.first
            last = min(shard.first + self.shard_scenarios, self.count) - 1
            known = shard.method in self.methods and shard.planned_by < len(self.planned_by)
            if not known or shard.first % self.shard_scenarios or shard.last != last or place in seen:
                raise ValueError(f"a shard of {shard.method} has no place in it")
            if shard.scenarios.rows != last - shard.first + 1 or shard.tracked > shard.targets.rows:
                raise ValueError(f"a shard of {shard.method} has other rows than scenarios")
            seen.add(place)
        return self


class Span(NamedTuple):
    """Scenarios `first` to `last`."""

    first: int
    last: int


class Run:
    """Results of a sweep, read from its folder; see run_tables for the columns of the tables."""

    def __init__(self, folder: Path, manifest: Manifest, keep: Any = None):
        self.folder, self.manifest = folder, manifest
        self._keep = keep  # a temporary folder lives as long as its run

    def __repr__(self) -> str:
        state = "complete" if self.complete else "not complete"
        return f"Run({str(self.folder)!r}: {', '.join(self.methods)}; {self.manifest.count} scenarios, {state})"

    def _repr_html_(self) -> str:
        state = "complete" if self.complete else "not complete"
        facts = {method: self._told(method) for method in self.methods}
        return html_facts(f"{self.manifest.name}: {self.manifest.count:,} scenarios, {state}", facts)

    def _told(self, method: str) -> str:
        if all(shard.method != method for shard in self.manifest.shards):
            return "not planned yet"
        found = summarise(self.plans(method))
        return (
            f"{100 * found.success_rate:.2f} %: {found.tracked:,} of {found.targets:,} targets, "
            f"{found.complete:,} of {found.scenarios:,} scenarios complete, {found.step_ms:.2f} ms a step"
        )

    def frame(self, table: str = "scenarios", *methods: str) -> "pandas.DataFrame":
        """One of the two tables, scenarios or targets, of all methods or of those named, as a pandas frame.

        Raises InputError as `targets` does, for another table, and without pandas.
        """
        if table not in TABLES:
            raise InputError(f"a run has no table {table!r}; valid: scenarios, targets")
        return frame_of(self.scenarios(*methods) if table == "scenarios" else self.targets(*methods))

    @property
    def methods(self) -> tuple[str, ...]:
        """Methods asked for so far."""
        return self.manifest.methods

    @property
    def complete(self) -> bool:
        """Whether every method has planned every scenario up to the limit."""
        return not self.unfinished()

    def unfinished(self) -> dict[str, int]:
        """The methods that have scenarios left to plan, and how many."""
        left = {method: sum(last - first + 1 for first, last in self.missing(method)) for method in self.methods}
        return {method: count for method, count in left.items() if count}

    @property
    def config(self) -> PlanConfig:
        """What all scenarios share; a scenario's own parameters are columns of `scenarios()`."""
        return validate(self.manifest.config, PlanConfig, str(self.folder / MANIFEST))

    @property
    def varied(self) -> tuple[str, ...]:
        """Keys of the configuration in which scenarios may differ, but for the parameters that any run has columns of:
        robots, workpieces, settings."""
        return varied_keys(name for group in self.manifest.grid for axis in group["axes"] for name in axis)

    def points(self) -> tuple[Point, ...]:
        """The scenarios with their configurations, as if each were planned alone. Raises InputError for a manifest
        whose grid cannot be read."""
        config, grid = self.config, self.manifest.grid
        joints = [column.rpartition("_")[0] for column in self.manifest.joints]
        try:
            groups = tuple(from_record(group, joints) for group in grid)
            stated = frozenset(key for group in grid for key in group.get("stated", ()))
            return tuple(islice(points_of(str(self.folder / MANIFEST), config, groups, stated), self.manifest.count))
        except InputError:
            raise
        except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
            raise InputError(f"{self.folder / MANIFEST}: its grid cannot be read: {error!r}") from None

    def targets(self, *methods: str) -> pa.Table:
        """One row per method, scenario and target, of all methods or of those named.

        Raises InputError for a method that the run lacks, and naming a file that is missing or damaged.
        """
        return self._read("targets", methods)

    def scenarios(self, *methods: str) -> pa.Table:
        """One row per method and scenario. Raises InputError as `targets` does."""
        return self._read("scenarios", methods)

    def plans(self, method: str) -> Plans:
        """The plans of one method as arrays; S = `manifest.count`, row s is scenario s. Where scenarios are not
        planned yet, or have fewer targets than others, the status is -1. Raises InputError as `targets` does."""
        rows, seconds = self.targets(method), self.manifest.seconds.get(method, Seconds())
        try:
            return plans_of(rows, self.manifest.count, self.manifest.joints, seconds.compile_s, seconds.run_s)
        except (IndexError, KeyError, ValueError) as error:
            raise InputError(f"{self.folder}: the rows of {method} are not of this run: {error}") from None

    def missing(self, method: str) -> list[Span]:
        """The shards that are still to be planned."""
        there = {(shard.first, shard.last) for shard in self.manifest.shards if shard.method == method}
        return [span for span in spans(self.manifest) if span not in there]

    def shard_files(self, shard: ShardRecord) -> dict[str, tuple[Path, FileRecord]]:
        """The two files of a shard by the names of their tables."""
        name = shard_name(shard.method, Span(shard.first, shard.last))
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
        return pa.concat_tables(_read_parquet(*self.shard_files(shard)[table], schema) for shard in order)


def open_run(folder: str | Path) -> Run:
    """The run in `folder`, also while it is being planned. Raises InputError for a folder that holds none."""
    folder = Path(folder)
    try:
        text = (folder / MANIFEST).read_bytes()
    except OSError as error:
        if isinstance(error, FileNotFoundError) and (folder / SUMMARY).exists():
            told = "holds a plan of htcp plan, no run; htcp view, htcp render and htcp validate open it"
            raise InputError(f"{folder} {told}") from None
        raise InputError(f"{folder} holds no run: cannot read {MANIFEST}: {error.strerror}") from None
    try:
        return Run(folder, Manifest.model_validate_json(text))
    except ValidationError as error:
        where = ".".join(map(str, error.errors()[0]["loc"]))
        what = f"{where}: " if where else ""
        raise InputError(
            f"{folder / MANIFEST} is damaged or no manifest of a run: {what}{error.errors()[0]['msg']}"
        ) from None


def spans(manifest: Manifest) -> list[Span]:
    """How the scenarios of a run are cut into shards."""
    step, count = manifest.shard_scenarios, manifest.count
    return [Span(first, min(first + step, count) - 1) for first in range(0, count, step)]


def shard_name(method: str, span: Span) -> str:
    """Name of a shard's files."""
    return f"{method}-{span.first:06d}-{span.last:06d}.parquet"


def fault(file: Path, record: FileRecord) -> str | None:
    """What is wrong with a file; None when it is as recorded."""
    try:
        return _fault_of(file.read_bytes(), record)
    except OSError as error:
        return f"cannot be read ({error.strerror})"


def _fault_of(data: bytes, record: FileRecord) -> str | None:
    if len(data) != record.bytes:
        return f"has {len(data):,} bytes instead of {record.bytes:,}"
    if hashlib.sha256(data).hexdigest() != record.sha256:
        return "has other contents than were written"
    return None


def _read_parquet(file: Path, record: FileRecord, schema: pa.Schema) -> pa.Table:
    try:
        data = file.read_bytes()
    except OSError as error:
        problem = f"cannot be read ({error.strerror})"
    else:
        problem = _fault_of(data, record)
    if problem:
        raise InputError(f"{file} {problem}; the same sweep plans its scenarios again")
    try:
        rows = pq.read_table(pa.BufferReader(data))
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{file} is no Parquet file: {' '.join(str(error).split())}") from None
    if not rows.schema.equals(schema) or len(rows) != record.rows:
        raise InputError(f"{file} is not a file of this run: it has other columns or another number of rows")
    return rows
