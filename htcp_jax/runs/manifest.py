"""Schema of manifest.json in a run folder: the run's identity, and its finished files."""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from itertools import groupby, pairwise
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field, model_validator

from htcp_jax.jobs import drawn_numbers, grid_axes
from htcp_jax.runs.identity import config_hash, identity
from htcp_jax.spec import NAME, strict_model

MANIFEST, FORMAT = "manifest.json", 1
LISTED = 12  # maximum number of scenarios that a text lists
TABLES = ("targets", "scenarios")
METHOD_NOUN = "method"  # of the keys of `Manifest.plugins` that name methods

MethodName = Annotated[str, Field(pattern=f"^{NAME.pattern}$")]  # it is part of file names
Count = Annotated[int, Field(ge=0, lt=2**53)]
Scenarios = Annotated[int, Field(ge=0, le=grid_axes.MOST)]
Pair = tuple[float, float]


class FileRecord(strict_model.FileSection):
    """Number of rows, size and checksum that a result file must have."""

    rows: Count
    bytes: Count
    sha256: str


class ShardRecord(strict_model.FileSection):
    """A finished shard: one method on the scenarios `first` to `last`, both included, or on `numbers` between them."""

    method: MethodName
    first: Scenarios
    last: Scenarios
    numbers: Annotated[tuple[Scenarios, ...] | None, Field(exclude_if=lambda value: value is None)] = None
    tracked: Count  # number of tracked targets
    compile_s: float  # compilation time
    run_s: float  # planning time without compilation
    cpu_s: Annotated[float | None, Field(exclude_if=lambda value: value is None)] = None  # processor time, see `Plans`
    planned_by: Count  # index in the manifest's list `planned_by`
    # Number of CPU cores that the planning process and those that it started could use; None: unknown.
    cores: Annotated[int | None, Field(exclude_if=lambda value: value is None)] = None
    targets: FileRecord
    scenarios: FileRecord

    @property
    def is_consistent(self) -> bool:
        """True if `numbers`, if given, ascend from `first` to `last`."""
        given = self.numbers
        return given is None or (_ascends(given) and (given[0], given[-1]) == (self.first, self.last))

    @property
    def scenario_numbers(self) -> Sequence[int]:
        """Numbers of the shard's scenarios, in order."""
        return range(self.first, self.last + 1) if self.numbers is None else self.numbers


class DrawnAxis(strict_model.FileSection):
    """Distribution from which the manifest's seed draws the values of a random axis; the values are in its grid."""

    group: Annotated[str | None, Field(exclude_if=lambda value: value is None)] = None
    parameter: str  # such as start_rad.joint3
    relative: bool  # True if the values are offsets
    uniform: Annotated[Pair | None, Field(exclude_if=lambda value: value is None)] = None  # lower and upper bound
    normal: Annotated[Pair | None, Field(exclude_if=lambda value: value is None)] = None  # mean, standard deviation
    count: Scenarios  # number of values

    def text(self, seed: int) -> str:
        """The axis as text, such as "start_rad.joint3: uniform in [-0.1, 0.1], 200 values, seed 11"."""
        name = self.parameter if self.group is None else f"{self.group}, {self.parameter}"
        return f"{name}: {'offsets ' if self.relative else ''}{self._shape}, {self.count:,} values, seed {seed}"

    @property
    def distribution_text(self) -> str:
        """The distribution as text, such as "drawn uniform in [-0.1, 0.1]" or "drawn, offsets uniform in [-1, 1]"."""
        return f"drawn{', offsets' if self.relative else ''} {self._shape}"

    @property
    def _shape(self) -> str:
        a, b = self.uniform or self.normal or (0.0, 0.0)
        return f"uniform in [{a:g}, {b:g}]" if self.uniform else f"normal, mean {a:g}, standard deviation {b:g}"


class Seconds(strict_model.FileSection):
    """Total compilation time, planning time and processor time of one method [s]."""

    compile_s: float = 0.0
    run_s: float = 0.0
    cpu_s: Annotated[float | None, Field(exclude_if=lambda value: value is None)] = None  # None: unknown

    @property
    def of_plans(self) -> dict[str, float]:
        """The times as fields of `Plans`."""
        return {
            "compile_s": self.compile_s,
            "run_s": self.run_s,
            "cpu_s": math.nan if self.cpu_s is None else self.cpu_s,
        }


class Manifest(strict_model.FileSection):
    """Content of manifest.json.

    The fields config, grid, dtype and files identify the run. `writer` adds shards only to the run with this identity.
    Facts that differ between equal runs are in this file only: the date, the times and the number of cores.
    """

    format: Literal[1] = FORMAT
    name: str  # name of the sweep
    # Date and time of the run's first start, in UTC (ISO 8601); None: unknown, as in runs of older versions.
    started: Annotated[str | None, Field(exclude_if=lambda value: value is None)] = None
    config: dict[str, Any]  # a PlanConfig; file names are absolute
    grid: tuple[dict[str, Any], ...]
    drawn: Annotated[tuple[DrawnAxis, ...], Field(exclude_if=lambda value: not value)] = ()  # random axes of the grid
    dtype: str
    files: dict[str, str]  # SHA-256 of the files that config and grid name
    config_hash: str
    seed: int
    joints: tuple[str, ...]  # names of the columns of x in the tables, one per joint
    targets: Count  # number of targets of all scenarios to plan
    full: Scenarios  # number of scenarios in the complete grid
    limit: int | None  # requested maximum number of scenarios; None: all
    count: Scenarios  # number of scenarios to plan, the first ones of the grid, or `scenarios`
    scenarios: Annotated[tuple[Scenarios, ...] | None, Field(exclude_if=lambda value: value is None)] = None
    is_sample: Annotated[bool, Field(exclude_if=lambda value: not value)] = False  # drawn by `jobs.drawn_numbers`
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
        if self.scenarios is not None and (not _ascends(self.scenarios) or len(self.scenarios) != self.count):
            raise ValueError("scenarios must be `count` ascending numbers")
        chosen, planned = {*self.numbers}, {}
        for shard in self.shards:
            known = shard.method in self.methods and shard.planned_by < len(self.planned_by)
            numbers = {*shard.scenario_numbers}
            if not (known and numbers and shard.is_consistent and numbers <= chosen):
                raise ValueError(f"a shard of {shard.method} does not fit into the run")
            if shard.scenarios.rows != len(numbers) or shard.tracked > shard.targets.rows:
                raise ValueError(f"a shard of {shard.method} has an impossible number of rows")
            if not planned.setdefault(shard.method, set()).isdisjoint(numbers):
                raise ValueError(f"a shard of {shard.method} does not fit into the run")
            planned[shard.method] |= numbers
        return self

    @property
    def numbers(self) -> Sequence[int]:
        """Numbers of the scenarios to plan, in order."""
        return range(self.count) if self.scenarios is None else self.scenarios

    def is_drawn_from(self, full: int) -> bool:
        """Return True if the scenarios are those that the seed draws from a grid of `full` scenarios."""
        return self.scenarios == drawn_numbers(self.seed, self.count, full)

    @property
    def part(self) -> str:
        """The planned part of the grid as text, such as "the first 20 of 125 scenarios"; "" for all scenarios."""
        if self.scenarios is None:
            return f"the first {self.count:,} of {self.full:,} scenarios" if self.count < self.full else ""
        if self.is_sample:
            return f"a random sample of {self.count:,} of {self.full:,} scenarios, seed {self.seed}"
        listed = ", ".join(map(str, self.scenarios[:LISTED])) + (", ..." if self.count > LISTED else "")
        return f"{self.count:,} of {self.full:,} scenarios, by number: {listed}"

    @property
    def rows(self) -> int:
        """Number of rows of arrays in which row s is scenario s, up to the last scenario to plan."""
        return self.numbers[-1] + 1 if self.count else 0


def plugins_for(plugins: Mapping[str, str], methods: Collection[str]) -> dict[str, str]:
    """Return the entries of `Manifest.plugins` for kinds and for some methods, without those of other methods."""
    named = {added: added.rpartition(" ") for added in plugins}
    return {added: plugins[added] for added, (noun, _, name) in named.items() if noun != METHOD_NOUN or name in methods}


def other_code(code: Mapping[str, str], other: Mapping[str, str]) -> list[str]:
    """Return the entries of `Manifest.code` that are in both mappings with different hashes."""
    return [added for added, sha256 in code.items() if other.get(added, sha256) != sha256]


class Span(NamedTuple):
    """Numbers of a shard's first and last scenario."""

    first: int
    last: int


def missing_rows(manifest: Manifest, method: str) -> list[Sequence[int]]:
    """Return the scenarios that a method has not planned yet, in order, as indices in `Manifest.numbers`.

    They are in ranges of consecutive scenarios. If scenarios of the grid have been chosen, in this call or earlier,
    they are in one list, as such ranges would be short.
    """
    planned = {number for shard in manifest.shards if shard.method == method for number in shard.scenario_numbers}
    if manifest.scenarios is not None or any(shard.numbers is not None for shard in manifest.shards):
        rows = tuple(row for row, number in enumerate(manifest.numbers) if number not in planned)
        return [rows] if rows else []
    spans: list[Sequence[int]] = []
    first = 0
    for done, numbers in groupby(manifest.numbers, planned.__contains__):
        end = first + sum(1 for _ in numbers)
        spans += [] if done else [range(first, end)]
        first = end
    return spans


def shard_name(method: str, first: int, last: int) -> str:
    """Return the name of a shard's files, the same in both folders of tables.

    Args:
        method: Name of the method.
        first: Number of the first scenario.
        last: Number of the last scenario.
    """
    return f"{method}-{first:06d}-{last:06d}.parquet"


def _ascends(numbers: Sequence[int]) -> bool:
    """Return True for a list of ascending numbers that is not empty."""
    return bool(numbers) and all(a < b for a, b in pairwise(numbers))


def is_shard_name(name: str, methods: Collection[str]) -> bool:
    """Return True for names that `shard_name` returns for one of the methods."""
    found = re.fullmatch(r"(.+)-\d{6,}-\d{6,}\.parquet", name)
    return found is not None and found[1] in methods
