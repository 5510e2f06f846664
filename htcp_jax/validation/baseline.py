"""Baseline file of a run, with which later runs are compared; it has one line per scenario, for readable diffs.

nspace-sqp:                 # under `methods`
  tracked: 4372
  ...
  scenarios:
    0: 105 complete
            1: 73 QP_INFEASIBLE     # consecutive tracked targets, and the next target's status

    The numbers of tracked targets are the planner's own results. TCP errors and clearances are measured by MuJoCo
    only (`validate`), so that a wrong formula in the planner cannot confirm itself.
"""

from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import pyarrow as pa
import yaml
from pydantic import Field, model_validator

from htcp_jax.errors import InputError
from htcp_jax.motion import plans
from htcp_jax.runs import Run, identity, labels, reachability_file
from htcp_jax.runs import manifest as manifests
from htcp_jax.spec import read_yaml, strict_model
from htcp_jax.status import Status
from htcp_jax.system import output_files
from htcp_jax.validation import run_records
from htcp_jax.validation.result import MethodCheck, Refutation
from htcp_jax.validation.validate import validate_results as check_by_mujoco

COMPLETE = "complete"
DIGITS = 6  # decimals of millimetres in the file
BETWEEN, STEP_RAD = 2, 0.01  # minimum number of steps on a joint path between targets, and largest joint step
HEAD = """# Baseline of a run, with which `htcp gate` compares later runs. Written by --update; edit only `allow`.
"""

WholeNumber = Annotated[int, Field(ge=0)]
Millimetres = Annotated[float, Field(ge=0)]
Amount = WholeNumber | Annotated[str, Field(pattern=r"^\d{1,2}(\.\d+)? ?%$")]  # a number, or a share such as "0.5 %"
SHARE_ROUNDING = 1e-9  # 4 % of 25 is 1


class End(NamedTuple):
    """End of a scenario: its number of consecutive tracked targets, and the next target's status, or COMPLETE."""

    tracked: int
    status: str

    def __str__(self) -> str:
        return f"{self.tracked} {self.status}"


def _read_end(text: Any) -> End:
    count, _, status = str(text).partition(" ")
    if not count.isdecimal() or status not in (COMPLETE, *Status.__members__):
        raise ValueError(f"{text!r} is not the result of a scenario, such as '105 {COMPLETE}' or '73 QP_INFEASIBLE'")
    return End(int(count), status)


class Times(strict_model.FileSection):
    """Cycle times of a method's motions at one feed rate, from `htcp program --all`."""

    feed_m_s: float
    limits: dict[str, Any]  # joint and TCP limits, as in the job's section `program`
    held: WholeNumber  # number of scenarios in which the feed is held
    cycle_time_s: dict[WholeNumber, Annotated[float, Field(gt=0)]]  # by scenario with a motion to the last target

    def of_scenarios(self, numbers: Collection[int]) -> "Times":
        """Return the times of some scenarios, by their numbers; the number of held feeds is then None."""
        kept = {number: seconds for number, seconds in self.cycle_time_s.items() if number in numbers}
        return self.model_copy(update={"cycle_time_s": kept, "held": None})

    @property
    def cycle_mean_s(self) -> float | None:
        """Mean cycle time; None without any."""
        return sum(self.cycle_time_s.values()) / len(self.cycle_time_s) if self.cycle_time_s else None


class Scores(strict_model.FileSection):
    """A method's results in a run or a baseline."""

    tracked: WholeNumber
    targets: WholeNumber
    executable: WholeNumber  # number of tracked targets that a proven motion reaches; None in `of_scenarios`
    complete: WholeNumber  # number of complete scenarios
    tcp_error_max_mm: float | None  # this and the next two are over all tracked targets; None: no target
    clearance_min_mm: float | None
    # Minimum clearance less a mesh's covering radius; not in the file.
    clearance_less_cover_min_mm: float | None = Field(None, exclude=True)
    times: Times | None = None  # None if the run is not timed
    scenarios: dict[WholeNumber, str]  # an `End` as text, by scenario

    @property
    def ends(self) -> dict[int, End]:
        """Each scenario's end, by scenario."""
        return {number: _read_end(text) for number, text in self.scenarios.items()}

    def of_scenarios(self, numbers: Collection[int], targets: int) -> "Scores":
        """Return the results in some scenarios; the number of executable targets and that of held feeds become None.

        Args:
            numbers: Numbers of the scenarios.
            targets: Number of their targets.
        """
        kept = {number: text for number, text in self.scenarios.items() if number in numbers}
        ends = [_read_end(text) for text in kept.values()]
        times = self.times and self.times.of_scenarios(numbers)
        counts = {"tracked": sum(end.tracked for end in ends), "complete": sum(e.status == COMPLETE for e in ends)}
        unknown = {"executable": None}
        return self.model_copy(update={"scenarios": kept, "targets": targets, "times": times, **counts, **unknown})

    @model_validator(mode="after")
    def _adds_up(self) -> "Scores":
        ends = self.ends
        if self.tracked != sum(end.tracked for end in ends.values()):
            raise ValueError(f"tracked is {self.tracked}, which does not match the sum over its scenarios")
        if self.complete != sum(end.status == COMPLETE for end in ends.values()):
            raise ValueError(f"complete is {self.complete}, which does not match the number of its complete scenarios")
        return self


class ReachabilityScores(strict_model.FileSection):
    """Results of `htcp reachability`."""

    reachable: WholeNumber  # number of reachable targets
    resolution_rad: float | None  # angular resolution of the search; None: it used spread configurations
    seed: int

    @property
    def searched(self) -> str:
        """Resolution and seed of the search, as text."""
        spread = self.resolution_rad is None
        how = "spread configurations" if spread else f"a resolution of {self.resolution_rad:.3g} rad"
        return f"{how} and seed {self.seed}"


class Allowance(strict_model.FileSection):
    """Largest differences from the baseline with which a method passes."""

    targets: Amount = 0  # decrease of the total number of tracked targets
    more_targets: Amount | None = None  # increase of this number; None: any increase passes
    scenarios: Amount = 0  # number of scenarios that end earlier
    cycle_time_percent: Annotated[float, Field(ge=0)] = 1.0  # increase of a scenario's cycle time [%]
    tcp_error_mm: Millimetres = 0.05
    clearance_mm: Millimetres = 0.05

    def in_numbers(self, targets: int, scenarios: int) -> "Allowance":
        """Return the allowance with numbers in place of shares, which are rounded down, to at least 1.

        Args:
            targets: Number of a method's targets.
            scenarios: Number of scenarios.
        """
        of = {"targets": targets, "more_targets": targets, "scenarios": scenarios}
        given = {name: (getattr(self, name), total) for name, total in of.items()}
        shares = {name: (float(value[:-1]), total) for name, (value, total) in given.items() if isinstance(value, str)}
        return self.model_copy(
            update={
                name: max(1, int(percent * total / 100 + SHARE_ROUNDING)) for name, (percent, total) in shares.items()
            }
        )


class Allowances(strict_model.FileSection):
    """Allowed differences from the baseline, by machine.

    `here` applies to runs on the baseline's device and versions, where the same code gives identical results.
    `elsewhere` applies to all other runs, in which rounding may change a scenario close to a threshold. For example,
    with SSE 4.2 instead of AVX-512 one scenario lost one target, of 49 poses by nine methods.
    """

    here: Allowance = Allowance()
    elsewhere: Allowance = Allowance(targets="0.5 %", scenarios="4 %")


class Baseline(strict_model.FileSection):
    """Contents of a baseline file."""

    format: Literal[1] = 1
    sweep: str
    commit: str | None
    device: str
    dtype: str
    seed: int
    config_hash: str
    allow: Allowances = Allowances()
    versions: dict[str, str | None]
    xla_flags: str | None = None  # None: unknown, as in baselines of older versions
    plugins: dict[str, str] = Field(
        default_factory=dict
    )  # distribution and version of methods and kinds of other packages, by their names
    # SHA-256 of the code of methods and kinds of other packages, by their names; empty in baselines of older versions.
    code: dict[str, str] = Field(default_factory=dict, exclude_if=lambda value: not value)
    reachability: ReachabilityScores | None
    planned: dict[str, Any]  # configuration and grid of the run, see the function `planned`
    methods: dict[manifests.MethodName, Scores] = Field(min_length=1)

    @model_validator(mode="after")
    def _hash_is_of_planned(self) -> "Baseline":
        if identity.config_hash(self.planned) != self.config_hash:
            raise ValueError("config_hash does not match `planned`")
        return self

    @model_validator(mode="after")
    def _is_complete(self) -> "Baseline":
        first = next(iter(self.methods.values()))
        count = len(first.scenarios)
        for method, scores in self.methods.items():
            if sorted(scores.scenarios) != list(range(count)):
                raise ValueError(f"{method} must have the scenarios 0 to {count - 1}, like the first method")
            if scores.targets != first.targets:
                raise ValueError(f"{method} must have {first.targets} targets, like the first method")
        return self

    @model_validator(mode="after")
    def _states_what_is_planned(self) -> "Baseline":
        settings = self.planned.get("settings")
        if self.dtype != self.planned.get("dtype") or self.seed != (settings or {}).get("seed"):
            raise ValueError("seed or dtype does not match `planned`")
        return self

    def allowance(self, elsewhere: bool) -> Allowance:
        """Return the allowance in numbers, for this baseline's machine or for another one."""
        first = next(iter(self.methods.values()))
        chosen = self.allow.elsewhere if elsewhere else self.allow.here
        return chosen.in_numbers(first.targets, len(first.scenarios))

    def of_scenarios(self, numbers: Collection[int], targets: int) -> "Baseline":
        """Return the baseline of some scenarios, without the values that are known only for all of them.

        Args:
            numbers: Numbers of the scenarios.
            targets: Number of their targets.
        """
        methods = {name: scores.of_scenarios({*numbers}, targets) for name, scores in self.methods.items()}
        return self.model_copy(update={"methods": methods, "reachability": None})

    def only(self, methods: Collection[str]) -> "Baseline":
        """Return the baseline of some of its methods.

        Raises:
            InputError: If it lacks one of them.
        """
        if unknown := [name for name in methods if name not in self.methods]:
            raise InputError(f"the baseline has no method {unknown[0]!r}; valid: {', '.join(self.methods)}")
        return self.model_copy(update={"methods": {name: self.methods[name] for name in methods}})


class RunSummary(NamedTuple):
    """Results of a run, as far as they are known; `problems` contains the reasons why others are missing."""

    methods: dict[str, Scores]
    checks: dict[str, MethodCheck]
    refuted: tuple[Refutation, ...]
    reachability: ReachabilityScores | None
    problems: tuple[str, ...]
    other_scenarios: Mapping[str, tuple[str, ...]] = MappingProxyType(
        {}
    )  # faults of a method's records, see `run_records`


def summarise_run(run: Run, progress: Callable[[int, int], None] | None = None) -> RunSummary:
    """Read and validate a run, and return its results.

    Errors in the run's files are not raised, but listed in `problems`.

    Args:
        run: The run.
        progress: Function that is called with the number of validated plans and of all plans.
    """
    problems: list[str] = []

    def attempt(what: str, function: Callable) -> Any:
        try:
            return function()
        except (ValueError, LookupError, TypeError, OSError, pa.ArrowException) as error:  # InputError is a ValueError
            problems.append(f"{what}: {error}" if isinstance(error, InputError) else f"{what}: {error!r}")
        return None

    validated = partial(check_by_mujoco, run, between=BETWEEN, step_rad=STEP_RAD, only_claimed=True, progress=progress)
    found = attempt("not validated", validated)
    checks = found.methods if found else {}
    methods = {method: attempt(method, lambda m=method: _scores(run, m, checks.get(m))) for method in run.methods}
    reachability = attempt("reachability is not known", lambda: _reachability_scores(run))
    problems += attempt("manifest", lambda: run_records.manifest_faults(run)) or ()
    methods = {method: scores for method, scores in methods.items() if scores}
    faults = {m: attempt(m, lambda m=m: tuple(run_records.scenario_faults(run, m))) for m in methods}
    refuted = found.refuted if found else ()
    return RunSummary(
        methods, checks, refuted, reachability, tuple(problems), {m: lines for m, lines in faults.items() if lines}
    )


def read_baseline(file: Path) -> Baseline:
    """Read a baseline.

    Raises:
        InputError: If the file cannot be read, is damaged, or is not a baseline.
    """
    return strict_model.validate_model(read_yaml(file), Baseline, str(file))


def update_baseline(run: Run, file: Path, progress: Callable[[int, int], None] | None = None) -> Baseline:
    """Write a run's results into a baseline file; allowances of an existing baseline are kept.

    Args:
        run: The run.
        file: The baseline file; it stays unchanged if an error is raised.
        progress: Function that is called with the number of validated plans and of all plans.

    Raises:
        InputError: If the run is limited, incomplete, damaged, refuted by validation, or planned by more than one
            commit or device; if the existing file is not a baseline, belongs to another sweep, or contains methods that
            the run lacks; if the file cannot be written.
    """
    old = read_baseline(file) if file.exists() else None
    if reason := _reason_not_to_update(run, old):
        raise InputError(f"{run.folder} is not taken as the baseline: {reason}")
    found = summarise_run(run, progress)
    refuted = len({(one.method, one.scenario, one.target) for one in found.refuted})
    faults = [*found.problems]
    faults += [f"{labels.counted(refuted, 'tracked target')} refuted by MuJoCo"] if refuted else []
    faults += [line for lines in found.other_scenarios.values() for line in lines]
    if faults:
        raise InputError(f"{run.folder} is not taken as the baseline: {faults[0]}")
    manifest, (origin,) = run.manifest, run.manifest.planned_by
    updated = Baseline(
        sweep=manifest.name,
        commit=origin.get("commit"),
        device=origin["device"],
        dtype=manifest.dtype,
        seed=manifest.seed,
        config_hash=manifest.config_hash,
        allow=old.allow if old else Allowances(),
        versions=origin["versions"],
        xla_flags=origin.get("xla_flags"),
        plugins=manifest.plugins,
        code=manifest.code,
        reachability=found.reachability,
        planned=planned(manifest),
        methods=found.methods,
    )
    output_files.write_text(file, HEAD + yaml.dump(updated.model_dump(), Dumper=_Dumper, sort_keys=False, width=118))
    return updated


def planned(manifest: manifests.Manifest) -> dict:
    """Return the configuration and grid that identify a run, independent of where its files are."""
    return identity.identity(manifest.config, manifest.grid, manifest.dtype, manifest.files)


def _reason_not_to_update(run: Run, old: Baseline | None) -> str | None:
    manifest = run.manifest
    if manifest.count < manifest.full:
        return f"it is limited to {manifest.count} of {labels.counted(manifest.full, 'scenario')}"
    if not run.complete:
        return f"it is not complete, {_unplanned(run)}"
    if len(manifest.planned_by) != 1:
        return "it was planned by several commits, versions or devices; plan it again without changing them"
    if old and old.sweep != manifest.name:
        return f"the existing baseline is for the sweep {old.sweep}, this run is of {manifest.name}"
    if old and (lost := [method for method in old.methods if method not in run.methods]):
        return f"the existing baseline also has {', '.join(lost)}; plan these methods too, or delete the file"
    return None


def _unplanned(run: Run) -> str:
    left = {method: sum(map(len, run.missing(method))) for method in run.methods}
    return "; ".join(f"{method} lacks {labels.counted(count, 'scenario')}" for method, count in left.items() if count)


def _scores(run: Run, method: str, check: MethodCheck | None) -> Scores:
    found = run.plans(method).outcomes
    ends = {s: found.of(s) for s in np.flatnonzero(found.planned).tolist()}
    return Scores(
        tracked=int(found.tracked.sum()),
        targets=int(found.targets.sum()),
        executable=int(found.executable.sum()),
        complete=int(found.complete.sum()),
        tcp_error_max_mm=_rounded_or_none(check and check.tcp_error_max_mm),
        clearance_min_mm=_rounded_or_none(check and check.clearance_min_mm),
        clearance_less_cover_min_mm=_rounded_or_none(check and check.clearance_less_cover_min_mm),
        times=_program_times(run, method),
        scenarios={number: str(_end(end)) for number, end in ends.items()},
    )


def _program_times(run: Run, method: str) -> Times | None:
    if (found := run.timing(method)) is None:
        return None
    timed = found.timed
    cycle = zip(timed["scenario"].to_pylist(), timed["cycle_time_s"].to_pylist(), strict=True)
    cycle_time_s = {number: round(seconds, DIGITS) for number, seconds in sorted(cycle)}
    return Times(feed_m_s=found.feed_m_s, limits=found.limits, held=found.held, cycle_time_s=cycle_time_s)


def _end(found: plans.Outcome) -> End:
    return End(found.targets, COMPLETE) if found.complete else End(found.failed, found.status.name)


def _reachability_scores(run: Run) -> ReachabilityScores | None:
    """Return the results of `htcp reachability`; None if they are unknown, or if a part of the grid was chosen."""
    found = None if run.manifest.scenarios is not None else reachability_file.read_reachability(run)
    return found and ReachabilityScores(
        reachable=int(found.prefix.sum()), resolution_rad=found.resolution_rad, seed=found.seed
    )


def _rounded_or_none(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else round(value, DIGITS)


class _Dumper(yaml.SafeDumper):
    """YAML dumper with lists of numbers on one line."""

    def represent_list(self, data):
        return self.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=True)


_Dumper.add_representer(list, _Dumper.represent_list)
