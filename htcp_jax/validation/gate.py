"""Regression gate: comparison of a run with a baseline. Missing data fail; planning time is not compared.

A method fails if

- its rows are of other scenarios than the manifest's grid, or contradict each other or the manifest;
- its number of tracked or executable targets decreases, or its number of scenarios that end earlier increases, by more
  than the baseline's `allow` permits;
- it tracks more targets in total than `allow.more_targets` permits, a limit for results that must be reproduced;
- it tracks a smaller share of the reachable targets;
- MuJoCo refutes a tracked target: the TCP error is above the tolerance, the arm collides at the target or at samples of
  the motion to it, or a saved value is wrong;
- the baseline has times and, in the run, fewer scenarios hold the feed, fewer have a time, more take longer than
  allowed, or the feed rate or the limits differ;
- its largest TCP error or its minimum clearance is worse than in the baseline by more than allowed;
- the run lacks the method, one of its scenarios, or one of these figures.

Each of these conditions is a `GateCheck`. Improvements pass and are listed, so that the baseline can be updated.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from htcp_jax.errors import InputError
from htcp_jax.runs import Run, identity, manifest, summary
from htcp_jax.runs import labels as run_labels
from htcp_jax.status import Status
from htcp_jax.validation.baseline import (
    COMPLETE,
    Allowance,
    Baseline,
    End,
    RunSummary,
    Scores,
    Times,
    planned,
    summarise_run,
)

ROUNDING = 1e-9  # tolerance for rounding of percentages and millimetres
RUN, REACHABILITY = "run", "reachability"  # used instead of a method's name in checks that belong to no method
SCENARIOS, TRACKED, EXECUTABLE, ENDS, SHARE, MUJOCO, TIMES, TCP_ERROR, CLEARANCE = CHECKS = (
    *("scenarios present", "tracked targets", "executable targets", "scenarios ending earlier", "reachable share"),
    *("validation by MuJoCo", "times", "largest TCP error", "minimum clearance"),
)


class Origin(NamedTuple):
    """Commit, device, package versions, XLA's flags and plugins with which a run was planned."""

    commit: str | None
    device: str | None
    versions: dict[str, str | None]
    xla_flags: str | None = None  # None: unknown
    plugins: Mapping[str, str] = MappingProxyType({})  # distribution and version, as in `Manifest.plugins`

    def __str__(self) -> str:
        commit, sign, changes = (self.commit or "unknown").partition("+")
        known = [f"{name} {version}" for name, version in self.versions.items() if version]
        known += [f"{added} from {package}" for added, package in self.plugins.items()]
        return f"{', '.join([f'commit {commit[:12]}{sign}{changes}', *known])}; {self.device}"


class GateCheck(NamedTuple):
    """Result of one comparison for one method."""

    method: str
    name: str  # one of CHECKS if the check belongs to a method
    failures: tuple[str, ...] = ()  # reasons of failure as text; empty: the check passed
    compared: bool = True  # False if the baseline or the run has no values to compare


class ChangedOutcome(NamedTuple):
    """A scenario with another outcome in the run than in the baseline."""

    method: str
    scenario: int
    was: End
    now: End
    label: str  # number and varied parameters of the scenario

    @property
    def worse(self) -> bool:
        """True if the run tracks fewer targets than the baseline."""
        return self.now.tracked < self.was.tracked

    @property
    def better(self) -> bool:
        """True if the run tracks more targets than the baseline."""
        return self.now.tracked > self.was.tracked

    @property
    def target(self) -> int:
        """First target with another result than in the baseline."""
        return min(self.was.tracked, self.now.tracked)

    @property
    def reason(self) -> str:
        """Message on the status of `target` in the run, or in the baseline if the run tracks more targets there."""
        status = self.was.status if self.better else self.now.status
        return Status[status].message if status != COMPLETE else COMPLETE

    def __str__(self) -> str:
        where = f"{self.method}, scenario {self.label}: the first difference is at target {self.target}"
        counts = f"{self.was.tracked} tracked in the baseline, {self.now.tracked} now"
        return f"{where}; {counts}; {'the baseline' if self.better else 'the run'} ended there: {self.reason}"


class GateRow(NamedTuple):
    """Figures of one method, or of reachability, in the baseline (prefix `was_`) and in the run; None if unknown."""

    method: str
    was_tracked: int | None
    tracked: int | None
    targets: int | None
    worse: int | None
    better: int | None
    gained: int | None  # number of scenarios that are complete only in the run
    lost: int | None  # number of scenarios that are complete only in the baseline
    p: float | None  # probability of such a split by chance, see `summary.sign_test`
    was_share: float | None  # tracked share of the reachable targets [%]
    share: float | None
    was_tcp_error_max_mm: float | None
    tcp_error_max_mm: float | None
    was_clearance_min_mm: float | None
    clearance_min_mm: float | None
    clearance_less_cover_min_mm: float | None  # in the run, minus the covering radius of a mesh
    was_held: int | None  # number of scenarios in which the feed is held
    held: int | None
    was_cycle_mean_s: float | None  # mean over the scenarios with a time
    cycle_mean_s: float | None
    verdict: str

    @property
    def complete_scenarios(self) -> str:
        """Sentence on the gained and lost complete scenarios; "" if there are none."""
        if self.p is None:
            return ""
        counts = f"{run_labels.counted(self.gained, 'complete scenario')} gained, {self.lost} lost"
        return f"{self.method}: {counts}; probability of such a split by chance {self.p:.2g}"


class GateVerdict(NamedTuple):
    """Result of the gate; `failures` and `improvements` are sentences."""

    passed: bool
    sweep: str
    baseline: Origin
    run: tuple[Origin, ...]  # one for each part in which the run was planned
    elsewhere: bool  # True if the run's device, versions or XLA_FLAGS differ from the baseline's
    allow: Allowance  # in numbers
    rows: tuple[GateRow, ...]
    checks: tuple[GateCheck, ...]
    changed: tuple[ChangedOutcome, ...]  # worse outcomes first
    failures: tuple[str, ...]
    improvements: tuple[str, ...]  # sentences on better or new results, which pass
    notes: tuple[str, ...] = ()  # sentences on other XLA_FLAGS, and other packages and code of methods and kinds


def compare(run: Run, baseline: Baseline, progress: Callable[[int, int], None] | None = None) -> GateVerdict:
    """Compare a run with a baseline.

    Args:
        run: The run.
        baseline: The baseline.
        progress: Function that is called with the number of validated plans and of all plans.

    If scenarios of the grid were chosen, only these are compared; a note says so.

    Raises:
        InputError: If the baseline belongs to another sweep or configuration.
    """
    differing = identity.identity_differences(baseline.planned, planned(run.manifest))
    if run.manifest.name != baseline.sweep:
        differing.append(f"the sweep was {baseline.sweep}, now {run.manifest.name}")
    if differing:
        more = f" (and {len(differing) - 1} more)" if differing[1:] else ""
        raise InputError(
            f"{run.folder} was planned with another job than the baseline: {differing[0]}{more}; "
            "if that is intended, write a new baseline with --update"
        )
    found, notes = summarise_run(run, progress), []
    if (chosen := run.manifest.scenarios) is not None:
        baseline = baseline.of_scenarios(chosen, run.manifest.targets)
        left = "numbers of executable targets and of held feeds, and reachability, are not compared"
        notes = [f"the run is {run.manifest.part}; {left}"]
    used = sorted({shard.planned_by for shard in run.manifest.shards})
    plugins = manifest.plugins_for(run.manifest.plugins, baseline.methods)
    verdict = _compare(baseline, found, tuple(_origin(run.manifest.planned_by[k], plugins) for k in used))
    labels = run.labels() if verdict.changed else {}
    changed = (one._replace(label=run_labels.named_scenario(one.scenario, labels)) for one in verdict.changed)
    notes += [*_other_software(verdict.baseline, verdict.run, plugins), *_other_code(baseline, run.manifest)]
    return verdict._replace(changed=tuple(changed), notes=tuple(notes))


def unreadable_run(baseline: Baseline, reason: str) -> GateVerdict:
    """Return the verdict on a run that cannot be read: every method of the baseline is missing."""
    return _compare(baseline, RunSummary({}, {}, (), None, (reason,)), ())


def _compare(baseline: Baseline, found: RunSummary, run: tuple[Origin, ...]) -> GateVerdict:
    plugins = manifest.plugins_for(baseline.plugins, baseline.methods)
    was = Origin(baseline.commit, baseline.device, baseline.versions, baseline.xla_flags, plugins)
    elsewhere = any(_machine(one) != _machine(was) or _other_flags(was, one) for one in run)
    allow = baseline.allowance(elsewhere)
    checks, rows, changed = [GateCheck(RUN, "files", found.problems)], [], []
    for method, scores in baseline.methods.items():
        own = [] if (now := found.methods.get(method)) is None else _changed(method, scores, now)
        lines = _lines(baseline, found, method, own, allow)
        checks += [GateCheck(method, name, tuple(lines[name] or ()), lines[name] is not None) for name in CHECKS]
        verdict = "FAILED" if any(lines.values()) else "better" if _is_improved(own) else "ok"
        changed += own
        rows.append(_gate_row(baseline, found, method, own, verdict))
    if baseline.reachability is not None:
        wrong = _reachability_shortfall(baseline, found, allow)
        checks.append(GateCheck(REACHABILITY, "reachable targets", tuple(wrong)))
        rows.append(_reachability_row(baseline, found, "FAILED" if wrong else "ok"))
    failures = [f"{check.method}: {line}" for check in checks for line in check.failures]
    better = [f"{method} is not in the baseline" for method in found.methods if method not in baseline.methods]
    gains = {row.method: row.tracked - row.was_tracked for row in rows if _tracks_more(row)}
    better += [f"{method} tracks {run_labels.counted(gain, 'target')} more" for method, gain in gains.items()]
    changed.sort(key=lambda one: (not one.worse, one.better))
    groups = map(tuple, (rows, checks, changed, failures, better))
    return GateVerdict(not failures, baseline.sweep, was, run, elsewhere, allow, *groups)


def _origin(planned_by: dict, plugins: Mapping[str, str]) -> Origin:
    commit, device, flags = (planned_by.get(name) for name in ("commit", "device", "xla_flags"))
    return Origin(commit, device, planned_by.get("versions") or {}, flags, plugins)


def _machine(origin: Origin) -> tuple:
    return origin.device, {name: version for name, version in origin.versions.items() if name != "htcp_jax"}


def _other_flags(was: Origin, now: Origin) -> bool:
    return None not in (was.xla_flags, now.xla_flags) and was.xla_flags != now.xla_flags


def _other_software(was: Origin, run: tuple[Origin, ...], plugins: Mapping[str, str]) -> tuple[str, ...]:
    """Return sentences on XLA_FLAGS and on packages of methods and kinds that differ from the baseline's."""
    flags = dict.fromkeys(one.xla_flags for one in run if _other_flags(was, one))
    notes = [f"XLA_FLAGS was {was.xla_flags!r} in the baseline, now {own!r}" for own in flags]
    names = [name for name in {**was.plugins, **plugins} if was.plugins.get(name) != plugins.get(name)]
    versions = [(name, *(of.get(name, "an unknown package") for of in (was.plugins, plugins))) for name in names]
    return *notes, *(f"the {name} came from {before} in the baseline, now from {now}" for name, before, now in versions)


def _other_code(baseline: Baseline, now: manifest.Manifest) -> list[str]:
    """Return sentences on methods and kinds with other code than the baseline's, from a package of the same version."""
    names = manifest.other_code(manifest.plugins_for(baseline.code, baseline.methods), now.code)
    same = {name: baseline.plugins.get(name) for name in names if baseline.plugins.get(name) == now.plugins.get(name)}
    return [
        f"the code of the {name} differs from the baseline's" + (f", {package} in both" if package else "")
        for name, package in same.items()
    ]


def _changed(method: str, was: Scores, now: Scores) -> list[ChangedOutcome]:
    both = ((number, end, now.ends.get(number)) for number, end in was.ends.items())
    return [ChangedOutcome(method, number, a, b, str(number)) for number, a, b in both if b is not None and a != b]


def _is_improved(changed: list[ChangedOutcome]) -> bool:
    return any(one.better for one in changed)


def _tracks_more(row: GateRow) -> bool:
    return None not in (row.tracked, row.was_tracked) and row.tracked > row.was_tracked


def _lines(
    baseline: Baseline, found: RunSummary, method: str, changed: list[ChangedOutcome], allow: Allowance
) -> dict[str, list[str] | None]:
    """Return a method's failures as text, by check; None for a check without values to compare."""
    was, now = baseline.methods[method], found.methods.get(method)
    if now is None:
        return dict.fromkeys(CHECKS) | {SCENARIOS: ["missing"]}
    lines: dict[str, list[str] | None] = {name: [] for name in CHECKS}
    lines[EXECUTABLE] = None if was.executable is None else []
    others, lost = list(found.other_scenarios.get(method, ())), [n for n in was.scenarios if n not in now.scenarios]
    if lost:
        missing = f"{len(lost)} of {run_labels.counted(len(was.scenarios), 'scenario')} missing, the first is {lost[0]}"
        others = [missing, *others]
    elif now.targets != was.targets:
        others += [f"other scenarios: they have {now.targets:,} targets, {was.targets:,} in the baseline"]
    lines[SCENARIOS] = others
    counts = [(TRACKED, was.tracked, now.tracked), (EXECUTABLE, was.executable, now.executable)]
    counts = [(name, before, after) for name, before, after in counts if before is not None]
    for name, before, after in counts:
        if (fewer := before - after) > allow.targets:
            what = f"{run_labels.counted(fewer, 'target')} fewer {name.split()[0]}"
            lines[name] = [f"{what}, {after} of {was.targets}; allowed decrease: {allow.targets}"]
    if allow.more_targets is not None and (more := now.tracked - was.tracked) > allow.more_targets:
        gained = f"{run_labels.counted(more, 'target')} more tracked, {now.tracked} of {was.targets}"
        lines[TRACKED] = [f"{gained}; allowed increase: {allow.more_targets}"]
    if (worse := sum(one.worse for one in changed)) > allow.scenarios:
        lines[ENDS] = [f"{run_labels.counted(worse, 'scenario')} ended earlier; allowed: {allow.scenarios}"]
    was_share, share = _reachable_share(was, baseline.reachability), _reachable_share(now, found.reachability)
    if was_share is None or share is None:
        lines[SHARE] = None
    elif share < was_share - 100 * allow.targets / baseline.reachability.reachable - ROUNDING:
        lines[SHARE] = [f"{share:.2f} % of the reachable targets are tracked, {was_share:.2f} % in the baseline"]
    if refuted := [one for one in found.refuted if one.method == method]:
        first = f"the first in scenario {refuted[0].scenario} at target {refuted[0].target}: {refuted[0].reason}"
        refuted = {(one.scenario, one.target) for one in refuted}  # a target may be refuted for several reasons
        lines[MUJOCO] = [f"{run_labels.counted(len(refuted), 'tracked target')} refuted by MuJoCo, {first}"]
    lines[TIMES] = None if was.times is None else _times_broken(was.times, now.times, allow)
    bounds = (
        (TCP_ERROR, was.tcp_error_max_mm, now.tcp_error_max_mm, 1, allow.tcp_error_mm),
        (CLEARANCE, was.clearance_min_mm, now.clearance_min_mm, -1, allow.clearance_mm),
    )
    for name, before, after, sign, allowed in bounds:
        if before is None:
            lines[name] = None
        elif after is None:
            lines[name] = [f"the {name} is missing"]
        elif not sign * (after - before) <= allowed + ROUNDING:  # also for NaN
            lines[name] = [
                f"the {name} is {after:.4g} mm, {before:.4g} mm in the baseline; allowed change: {allowed:g} mm"
            ]
    return lines


def _times_broken(was: Times, now: Times | None, allow: Allowance) -> list[str]:
    if now is None:
        return ["its times are missing; run htcp program --all"]
    if (was.feed_m_s, was.limits) != (now.feed_m_s, now.limits):
        return ["not comparable: timed with another feed or other limits than the baseline"]
    wrong, may = [], 1 + allow.cycle_time_percent / 100
    if was.held is not None and (fewer := was.held - now.held) > allow.scenarios:
        wrong.append(
            f"{run_labels.counted(fewer, 'scenario')} fewer with the feed held, {now.held} of {len(now.cycle_time_s)}"
        )
    if len(lost := sorted(was.cycle_time_s.keys() - now.cycle_time_s.keys())) > allow.scenarios:
        wrong.append(f"{run_labels.counted(len(lost), 'scenario')} without a time, the first is {lost[0]}")
    both = was.cycle_time_s.keys() & now.cycle_time_s.keys()
    slower = {number: now.cycle_time_s[number] / was.cycle_time_s[number] for number in sorted(both)}
    slower = {number: by for number, by in slower.items() if not by <= may + ROUNDING}
    if len(slower) > allow.scenarios:
        worst = max(slower, key=lambda number: slower[number])
        seconds = f"{now.cycle_time_s[worst]:.4g} s, {was.cycle_time_s[worst]:.4g} s in the baseline"
        longer = f"{run_labels.counted(len(slower), 'scenario')} over {allow.cycle_time_percent:g} % longer"
        wrong.append(f"{longer}, most of all scenario {worst}: {seconds}")
    return wrong


def _reachability_shortfall(baseline: Baseline, found: RunSummary, allow: Allowance) -> list[str]:
    was, now = baseline.reachability, found.reachability
    if now is None:
        return ["missing; run htcp reachability"]
    if now.searched != was.searched:
        return [f"not comparable: searched with {now.searched}, the baseline with {was.searched}"]
    if (fewer := was.reachable - now.reachable) > allow.targets:
        return [f"{run_labels.counted(fewer, 'target')} fewer reachable; allowed decrease: {allow.targets}"]
    return []


def _reachable_share(scores: Scores | None, reachability) -> float | None:
    return 100 * scores.tracked / reachability.reachable if scores and reachability and reachability.reachable else None


def _gate_row(
    baseline: Baseline, found: RunSummary, method: str, changed: list[ChangedOutcome], verdict: str
) -> GateRow:
    was, now = baseline.methods[method], found.methods.get(method)
    gained = sum(one.now.status == COMPLETE != one.was.status for one in changed)
    lost = sum(one.was.status == COMPLETE != one.now.status for one in changed)
    return GateRow(
        method=method,
        targets=was.targets,
        worse=now and sum(one.worse for one in changed),
        better=now and sum(one.better for one in changed),
        gained=now and gained,
        lost=now and lost,
        p=summary.sign_test(gained, lost),
        was_share=_reachable_share(was, baseline.reachability),
        share=_reachable_share(now, found.reachability),
        **_before_and_now(was, now, "tracked", "tcp_error_max_mm", "clearance_min_mm"),
        clearance_less_cover_min_mm=now and now.clearance_less_cover_min_mm,
        **_before_and_now(was.times, was.times and now and now.times, "held", "cycle_mean_s"),
        verdict=verdict,
    )


def _before_and_now(was: Scores | Times | None, now: Scores | Times | None, *names: str) -> dict[str, Any]:
    """Return values of the baseline, with the prefix `was_`, and of the run, by name; None if unknown."""
    before = {f"was_{name}": was and getattr(was, name) for name in names}
    return before | {name: now and getattr(now, name) for name in names}


def _reachability_row(baseline: Baseline, found: RunSummary, verdict: str) -> GateRow:
    nothing = dict.fromkeys(GateRow._fields)
    reachable = found.reachability and found.reachability.reachable
    targets = next(iter(baseline.methods.values())).targets
    counts = {"was_tracked": baseline.reachability.reachable, "tracked": reachable, "targets": targets}
    return GateRow(**(nothing | {"method": REACHABILITY, **counts, "verdict": verdict}))
