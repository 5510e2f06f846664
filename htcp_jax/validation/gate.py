"""The regression gate: a run held against a baseline. Whatever is missing or unreadable fails; time never counts.

A method fails when

- it tracks fewer targets in all, or more of its scenarios end earlier, than the baseline's `allow` permits;
- it tracks a smaller share of the targets that are known to be reachable;
- MuJoCo refutes a tracked target: the TCP is off by more than the tolerance, the arm touches, the record is wrong;
- where the baseline has times, at the same feed and limits: fewer of its scenarios hold their feed or have a time, or
  more of them take longer than is allowed;
- its largest TCP error or its smallest clearance is worse than the baseline's by more than is allowed;
- the run lacks it, one of its scenarios, or one of these figures.

What is better passes and is listed, so that somebody blesses it.
"""

from collections.abc import Callable
from typing import NamedTuple

from htcp_jax.errors import InputError
from htcp_jax.runs.identity import differences
from htcp_jax.runs.run_folder import Run
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

ROUNDING = 1e-9  # of percentages and millimetres


class ChangedOutcome(NamedTuple):
    """A scenario that does not end as it did."""

    method: str
    scenario: int
    was: End
    now: End

    @property
    def worse(self) -> bool:
        """True if fewer targets are tracked than before."""
        return self.now.tracked < self.was.tracked

    @property
    def better(self) -> bool:
        """True if more targets are tracked than before."""
        return self.now.tracked > self.was.tracked

    @property
    def target(self) -> int:
        """The first that differs."""
        return min(self.was.tracked, self.now.tracked)

    @property
    def reason(self) -> str:
        """What became of that target, in the run or, where that got further, in the baseline."""
        status = self.was.status if self.better else self.now.status
        return Status[status].message if status != COMPLETE else COMPLETE


class Row(NamedTuple):
    """One method, or what is reachable: the baseline's figure and the run's. None where there is none."""

    method: str
    was_tracked: int | None
    tracked: int | None
    targets: int | None
    worse: int | None
    better: int | None
    was_share: float | None  # of the reachable targets [%]
    share: float | None
    was_tcp_error_max_mm: float | None
    tcp_error_max_mm: float | None
    was_clearance_min_mm: float | None
    clearance_min_mm: float | None
    was_held: int | None  # scenarios that hold their feed
    held: int | None
    was_cycle_mean_s: float | None  # over the scenarios that have a time
    cycle_mean_s: float | None
    verdict: str


class Verdict(NamedTuple):
    """The outcome. `failures` and `improvements` are sentences."""

    passed: bool
    elsewhere: bool  # whether the run was planned on another device, or with other versions, than the baseline
    allow: Allowance
    rows: tuple[Row, ...]
    changed: tuple[ChangedOutcome, ...]  # the worse ones first
    failures: tuple[str, ...]
    improvements: tuple[str, ...]  # what is better or not in the baseline; it passes


def judge(run: Run, baseline: Baseline, progress: Callable[[int, int], None] | None = None) -> Verdict:
    """Hold the run against the baseline. progress: called with the plans validated and their number.

    Raises InputError when the baseline is of another sweep or configuration: there is nothing to compare then.
    """
    if differing := differences(baseline.planned, planned(run.manifest)):
        more = f" (and {len(differing) - 1} more)" if differing[1:] else ""
        raise InputError(
            f"{run.folder} was not planned as the baseline was: {differing[0]}{more}; "
            "where that is meant, --bless a new one"
        )
    elsewhere = _elsewhere(run, baseline)
    allow = baseline.allow.elsewhere if elsewhere else baseline.allow.here
    found = summarise_run(run, progress)
    failures, improvements = list(found.problems), []
    rows, changed = [], []
    for method, was in baseline.methods.items():
        own = [] if (now := found.methods.get(method)) is None else _changed(method, was, now)
        wrong = ["missing"] if now is None else _shortfalls(baseline, found, method, own, allow)
        failures += [f"{method}: {line}" for line in wrong]
        changed += own
        rows.append(_row(baseline, found, method, own, "FAILED" if wrong else "better" if _better(own) else "ok"))
    if baseline.reachability is not None:
        wrong = _reachability_shortfall(baseline, found, allow)
        failures += wrong
        rows.append(_reachability_row(baseline, found, "FAILED" if wrong else "ok"))
    improvements += [f"{method} is not in the baseline" for method in found.methods if method not in baseline.methods]
    improvements += [f"{row.method} tracks {row.tracked - row.was_tracked} targets more" for row in rows if _more(row)]
    changed.sort(key=lambda one: (not one.worse, one.better))
    return Verdict(not failures, elsewhere, allow, tuple(rows), tuple(changed), tuple(failures), tuple(improvements))


def _elsewhere(run: Run, baseline: Baseline) -> bool:
    def origin(device: str, versions: dict) -> tuple:
        return device, {name: version for name, version in versions.items() if name != "htcp_jax"}

    here = origin(baseline.device, baseline.versions)
    return any(origin(one.get("device"), one.get("versions") or {}) != here for one in run.manifest.planned_by)


def _changed(method: str, was: Scores, now: Scores) -> list[ChangedOutcome]:
    both = ((number, end, now.ends.get(number)) for number, end in was.ends.items())
    return [ChangedOutcome(method, number, a, b) for number, a, b in both if b is not None and a != b]


def _better(changed: list[ChangedOutcome]) -> bool:
    return any(one.better for one in changed)


def _more(row: Row) -> bool:
    return None not in (row.tracked, row.was_tracked) and row.tracked > row.was_tracked


def _shortfalls(
    baseline: Baseline, found: RunSummary, method: str, changed: list[ChangedOutcome], allow: Allowance
) -> list[str]:
    """In words, what a method fails by."""
    was, now = baseline.methods[method], found.methods[method]
    wrong = []
    if lost := [number for number in was.scenarios if number not in now.scenarios]:
        wrong.append(f"{len(lost)} of {len(was.scenarios)} scenarios are missing, {lost[0]} the first")
    if (fewer := was.tracked - now.tracked) > allow.targets:
        wrong.append(f"{fewer} targets fewer are tracked, {now.tracked} of {was.targets}; {allow.targets} may be lost")
    if was.executable is not None and (fewer := was.executable - (now.executable or 0)) > allow.targets:
        wrong.append(
            f"{fewer} targets fewer are executable, {now.executable} of {was.targets}; {allow.targets} may be lost"
        )
    if (worse := sum(one.worse for one in changed)) > allow.scenarios:
        wrong.append(f"{worse} scenarios end earlier; {allow.scenarios} may")
    was_share, share = _share(was, baseline.reachability), _share(now, found.reachability)
    if was_share is not None and share is not None:
        if share < was_share - 100 * allow.targets / baseline.reachability.reachable - ROUNDING:
            wrong.append(f"{share:.2f} % of the reachable targets are tracked, {was_share:.2f} % before")
    if refuted := [one for one in found.refuted if one.method == method]:
        first = f"the first in scenario {refuted[0].scenario} at target {refuted[0].target}: {refuted[0].reason}"
        wrong.append(f"{len(refuted)} tracked targets are refuted by MuJoCo, {first}")
    return wrong + _times_broken(was.times, now.times, allow) + _bounds_broken(was, now, allow)


def _times_broken(was: Times | None, now: Times | None, allow: Allowance) -> list[str]:
    if was is None:
        return []
    if now is None:
        return ["its times are missing; htcp program --all writes them into the run's folder"]
    if (was.feed_m_s, was.limits) != (now.feed_m_s, now.limits):
        return ["timed with another feed or other limits than the baseline's; not to be compared"]
    wrong, may = [], 1 + allow.cycle_time_percent / 100
    if (fewer := was.held - now.held) > allow.scenarios:
        wrong.append(f"{fewer} scenarios fewer hold their feed, {now.held} of {len(now.cycle_time_s)}")
    if len(lost := sorted(was.cycle_time_s.keys() - now.cycle_time_s.keys())) > allow.scenarios:
        wrong.append(f"{len(lost)} scenarios have no time any more, {lost[0]} the first")
    both = was.cycle_time_s.keys() & now.cycle_time_s.keys()
    slower = {number: now.cycle_time_s[number] / was.cycle_time_s[number] for number in sorted(both)}
    slower = {number: by for number, by in slower.items() if by > may + ROUNDING}
    if len(slower) > allow.scenarios:
        worst = max(slower, key=lambda number: slower[number])
        seconds = f"{now.cycle_time_s[worst]:.4g} s, {was.cycle_time_s[worst]:.4g} s before"
        text = f"{len(slower)} scenarios take over {allow.cycle_time_percent:g} % longer, {worst} the most: {seconds}"
        wrong.append(text)
    return wrong


def _bounds_broken(was: Scores, now: Scores, allow: Allowance) -> list[str]:
    bounds = (
        ("tcp_error_max_mm", "largest TCP error", 1, allow.tcp_error_mm),
        ("clearance_min_mm", "smallest clearance", -1, allow.clearance_mm),
    )
    wrong = []
    for name, words, sign, room in bounds:
        before, after = getattr(was, name), getattr(now, name)
        if before is not None and after is None:
            wrong.append(f"the {words} is missing")
        elif before is not None and sign * (after - before) > room + ROUNDING:
            wrong.append(f"the {words} is {after:.4g} mm, {before:.4g} mm before; it may move by {room:g} mm")
    return wrong


def _reachability_shortfall(baseline: Baseline, found: RunSummary, allow: Allowance) -> list[str]:
    was, now = baseline.reachability, found.reachability
    if now is None:
        return ["reachability: missing; htcp reachability writes it into the run's folder"]
    if now.searched != was.searched:
        return [f"reachability: searched with {now.searched}, the baseline's with {was.searched}; not to be compared"]
    if was.reachable - now.reachable > allow.targets:
        return [
            f"reachability: {was.reachable - now.reachable} targets fewer are reachable; {allow.targets} may be lost"
        ]
    return []


def _share(scores: Scores | None, reachability) -> float | None:
    return 100 * scores.tracked / reachability.reachable if scores and reachability and reachability.reachable else None


def _row(baseline: Baseline, found: RunSummary, method: str, changed: list[ChangedOutcome], verdict: str) -> Row:
    was, now = baseline.methods[method], found.methods.get(method)
    return Row(
        method=method,
        was_tracked=was.tracked,
        tracked=now and now.tracked,
        targets=was.targets,
        worse=now and sum(one.worse for one in changed),
        better=now and sum(one.better for one in changed),
        was_share=_share(was, baseline.reachability),
        share=_share(now, found.reachability),
        was_tcp_error_max_mm=was.tcp_error_max_mm,
        tcp_error_max_mm=now and now.tcp_error_max_mm,
        was_clearance_min_mm=was.clearance_min_mm,
        clearance_min_mm=now and now.clearance_min_mm,
        **_time_columns(was.times, now and now.times),
        verdict=verdict,
    )


def _time_columns(was: Times | None, now: Times | None) -> dict[str, int | float | None]:
    """Of a row; without any where the baseline has no times."""
    now = was and now
    return {
        "was_held": was and was.held,
        "held": now and now.held,
        "was_cycle_mean_s": was and _mean(was),
        "cycle_mean_s": now and _mean(now),
    }


def _mean(times: Times) -> float | None:
    return sum(times.cycle_time_s.values()) / len(times.cycle_time_s) if times.cycle_time_s else None


def _reachability_row(baseline: Baseline, found: RunSummary, verdict: str) -> Row:
    nothing = dict.fromkeys(Row._fields)
    reachable = found.reachability and found.reachability.reachable
    targets = next(iter(baseline.methods.values())).targets
    counts = {"was_tracked": baseline.reachability.reachable, "tracked": reachable, "targets": targets}
    return Row(**(nothing | {"method": "reachability", **counts, "verdict": verdict}))
