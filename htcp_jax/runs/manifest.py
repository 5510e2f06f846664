"""Schema of manifest.json in a run folder: the run's identity, and its finished files."""

import re
from collections.abc import Collection
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field, model_validator

from htcp_jax.jobs import grid_axes
from htcp_jax.runs.identity import config_hash, identity
from htcp_jax.spec import NAME, strict_model

MANIFEST, FORMAT = "manifest.json", 1
TABLES = ("targets", "scenarios")

MethodName = Annotated[str, Field(pattern=f"^{NAME.pattern}$")]  # it is part of file names
Count = Annotated[int, Field(ge=0, lt=2**53)]
Scenarios = Annotated[int, Field(ge=0, le=grid_axes.MOST)]


class FileRecord(strict_model.FileSection):
    """Number of rows, size and checksum that a result file must have."""

    rows: Count
    bytes: Count
    sha256: str


class ShardRecord(strict_model.FileSection):
    """A finished shard: one method on the scenarios `first` to `last`, both included."""

    method: MethodName
    first: Scenarios
    last: Scenarios
    tracked: Count  # number of tracked targets
    compile_s: float  # compilation time
    run_s: float  # planning time without compilation
    planned_by: Count  # index in the manifest's list `planned_by`
    targets: FileRecord
    scenarios: FileRecord


class Seconds(strict_model.FileSection):
    """Total compilation time and planning time of one method [s]."""

    compile_s: float = 0.0
    run_s: float = 0.0


class Manifest(strict_model.FileSection):
    """Content of manifest.json.

    The fields config, grid, dtype and files identify the run. `writer` adds shards only to the run with this identity.
    """

    format: Literal[1] = FORMAT
    name: str  # name of the sweep
    config: dict[str, Any]  # a PlanConfig; file names are absolute
    grid: tuple[dict[str, Any], ...]
    dtype: str
    files: dict[str, str]  # SHA-256 of the files that config and grid name
    config_hash: str
    seed: int
    joints: tuple[str, ...]  # names of the columns of x in the tables, one per joint
    targets: Count  # number of targets of all scenarios to plan
    full: Scenarios  # number of scenarios in the complete grid
    limit: int | None  # requested maximum number of scenarios; None: all
    count: Scenarios  # number of scenarios to plan, the first ones of the grid
    shard_scenarios: Annotated[int | None, Field(exclude=True)] = None  # without effect; written by older versions
    methods: tuple[MethodName, ...]
    seconds: dict[str, Seconds] = Field(default_factory=dict)  # times by method
    planned_by: tuple[dict[str, Any], ...] = ()  # provenance of shards: commit, versions, device, XLA_FLAGS
    code: dict[str, str] = Field(default_factory=dict)  # SHA-256 of methods and kinds of other packages
    plugins: dict[str, str] = Field(default_factory=dict)  # distribution and version of these packages
    shards: tuple[ShardRecord, ...] = ()

    @model_validator(mode="after")
    def _agrees_with_itself(self) -> "Manifest":
        if self.config_hash != config_hash(identity(self.config, self.grid, self.dtype, self.files)):
            raise ValueError("config_hash does not match the contents")
        ends: dict[str, int] = {}
        for shard in sorted(self.shards, key=lambda shard: shard.first):
            known = shard.method in self.methods and shard.planned_by < len(self.planned_by)
            if not (known and ends.get(shard.method, -1) < shard.first <= shard.last < self.count):
                raise ValueError(f"a shard of {shard.method} does not fit into the run")
            if shard.scenarios.rows != shard.last - shard.first + 1 or shard.tracked > shard.targets.rows:
                raise ValueError(f"a shard of {shard.method} has an impossible number of rows")
            ends[shard.method] = shard.last
        return self


class Span(NamedTuple):
    """Range of scenarios, `first` to `last`, both included."""

    first: int
    last: int


def missing_spans(manifest: Manifest, method: str) -> list[Span]:
    """Return the ranges of scenarios that a method has not planned yet, in order."""
    known = sorted((shard.first, shard.last) for shard in manifest.shards if shard.method == method)
    firsts, lasts = [0, *(last + 1 for _, last in known)], [*(first - 1 for first, _ in known), manifest.count - 1]
    return [Span(first, last) for first, last in zip(firsts, lasts, strict=True) if first <= last]


def shard_name(method: str, span: Span) -> str:
    """Return the name of a shard's files, the same in both folders of tables."""
    return f"{method}-{span.first:06d}-{span.last:06d}.parquet"


def is_shard_name(name: str, methods: Collection[str]) -> bool:
    """Return True for names that `shard_name` returns for one of the methods."""
    found = re.fullmatch(r"(.+)-\d{6,}-\d{6,}\.parquet", name)
    return found is not None and found[1] in methods
