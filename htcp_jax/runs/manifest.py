"""Schema of manifest.json in a run folder: the run's identity, and its finished files."""

from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field, model_validator

from htcp_jax.io import strict_model
from htcp_jax.jobs import grid_axes
from htcp_jax.registry import NAME
from htcp_jax.runs.identity import config_hash, identity

MANIFEST, FORMAT = "manifest.json", 1
TABLES = ("targets", "scenarios")

MethodName = Annotated[str, Field(pattern=f"^{NAME.pattern}$")]  # part of file names
Count = Annotated[int, Field(ge=0, lt=2**53)]
Scenarios = Annotated[int, Field(ge=0, le=grid_axes.MOST)]


class FileRecord(strict_model.FileSection):
    """Expected rows, size and checksum of a file."""

    rows: Count
    bytes: Count
    sha256: str


class ShardRecord(strict_model.FileSection):
    """A finished shard: scenarios `first` to `last` by one method."""

    method: MethodName
    first: Scenarios
    last: Scenarios
    tracked: Count  # targets
    compile_s: float
    run_s: float
    planned_by: Count  # index in the manifest's list of that name
    targets: FileRecord
    scenarios: FileRecord


class Seconds(strict_model.FileSection):
    """Wall time of one method."""

    compile_s: float = 0.0
    run_s: float = 0.0


class Manifest(strict_model.FileSection):
    """Content of manifest.json.

    Config, grid, dtype and files identify the run; `writer` never mixes two.
    """

    format: Literal[1] = FORMAT
    name: str  # of the sweep
    config: dict[str, Any]  # a PlanConfig; names of files are absolute
    grid: tuple[dict[str, Any], ...]
    dtype: str
    files: dict[str, str]  # SHA-256 of the files that config and grid name
    config_hash: str
    seed: int
    joints: tuple[str, ...]  # columns of x in the tables
    targets: Count  # of all scenarios together
    full: Scenarios  # scenarios of the complete grid
    limit: int | None  # of scenarios, as requested
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


def spans(manifest: Manifest) -> list[Span]:
    """Return the ranges of scenarios in a run's shards."""
    step, count = manifest.shard_scenarios, manifest.count
    return [Span(first, min(first + step, count) - 1) for first in range(0, count, step)]


def shard_name(method: str, span: Span) -> str:
    """Return the name of a shard's files."""
    return f"{method}-{span.first:06d}-{span.last:06d}.parquet"
