"""Tables of a part's results, and of the runs' configurations."""

import dataclasses
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from jaxtyping import Int

from htcp_jax.motion import Plans, motion
from htcp_jax.motion import plans as plan_arrays
from htcp_jax.reachability import Reach
from htcp_jax.report.document import Column, Table
from htcp_jax.report.groups import Part
from htcp_jax.runs import summary, timing_file
from htcp_jax.spec import PlanConfig
from htcp_jax.status import SegmentStatus, Status

RESULTS = (
    Column("method", "method"),
    Column("success_percent", "success", "%", ".2f"),
    Column("tracked", "tracked", "targets", ",d"),
    Column("targets", "of", "", ",d"),
    Column("executable", "executable", "targets", ",d"),
    Column("executable_percent", "executable", "%", ".2f"),
    Column("complete", "complete", "scenarios", ",d"),
    Column("scenarios", "of", "", ",d"),
    Column("step_ms", "time/step", "ms", ".2f"),
    Column("tcp_distance_mean_mm", "TCP distance", "mm", ".4f"),
    Column("orientation_error_mean_deg", "orientation error", "deg", ".4f"),
    Column("clearance_min_mm", "clearance min", "mm", ".2g"),
    Column("clearance_mean_mm", "mean", "mm", ".2f"),
)
PAIRS = (
    Column("method", "method"),
    Column("other", "compared with"),
    Column("more", "more", "scenarios", ",d"),
    Column("fewer", "fewer", "scenarios", ",d"),
    Column("equal", "equal", "scenarios", ",d"),
    Column("p", "sign test", "p", ".2g"),
)
PAPER = (
    Column("method", "method"),
    Column("success_percent", "success", "%", ".2f"),
    Column("paper_success_percent", "paper", "%", ".2f", quiet=True),
    Column("step_ms", "time/step", "ms", ".2f"),
    Column("paper_step_ms", "paper", "ms", ".0f", quiet=True),
    Column("tcp_distance_mean_mm", "TCP distance", "mm", ".4f"),
    Column("paper_tcp_distance_mm", "paper", "mm", ".4f", quiet=True),
    Column("clearance_mean_mm", "safe distance", "mm", ".4f"),
    Column("paper_safe_distance_mm", "paper", "mm", ".4f", quiet=True),
)
REACH = (
    Column("reach", "reach"),
    Column("targets", "targets", "", ",d"),
    Column("percent", "of all", "%", ".1f"),
    Column("meaning", "meaning"),
)
REACHABILITY = (
    Column("method", "method"),
    Column("tracked", "tracked", "targets", ",d"),
    Column("reachable", "reachable", "targets", ",d"),
    Column("not_excluded", "not excluded", "targets", ",d"),
    Column("of_reachable_percent", "of reachable", "%", ".2f"),
    Column("short", "fall short", "scenarios", ",d"),
    Column("beyond", "exceed it", "scenarios", ",d"),
)
STEPS = (
    Column("method", "method"),
    Column("accepted", "accepted", "steps", ",d"),
    Column("blocked", "blocked", "steps", ",d"),
    Column("blocked_percent", "blocked", "%", ".2f"),
    Column("not_checked", "not checked", "steps", ",d"),
    Column("scenarios_blocked", "with a blocked step", "scenarios", ",d"),
    Column("tracked_before", "tracked before it", "targets", ",d"),
    Column("tracked_before_percent", "of all", "%", ".2f"),
    Column("after_recovery", "after recovery", "targets", ",d"),
    Column("step_median_rad", "median step", "rad", ".4f"),
    Column("step_max_rad", "longest", "rad", ".3f"),
)
STOPS = (
    Column("method", "method"),
    Column("reason", "reason"),
    Column("scenarios", "scenarios", "", ",d"),
    Column("first_target", "first", "target", "d"),
    Column("median_target", "median", "target", ".0f"),
    Column("last_target", "last", "target", "d"),
    Column("colliding_body", "colliding body (scenarios)"),
    Column("targets", "at targets (scenarios)"),
)
MOTION_ENDS = (
    Column("method", "method"),
    Column("reason", "motion ends"),
    Column("scenarios", "scenarios", "", ",d"),
    Column("median_target", "median", "target", ".0f"),
    Column("targets", "not executable", "targets", ",d"),
)
TIMES = (
    Column("method", "method"),
    Column("run_s", "planning", "s", ".2f"),
    Column("compile_s", "compiling", "s", ".2f"),
)


def results(part: Part) -> Table:
    """Return the table of results by method: counts, percentages, time per step, errors and clearance."""
    return without_empty(_table_of_rows("results", RESULTS, [_result(part, method) for method in part.plans]))


def pairs(part: Part) -> Table:
    """Return the table that compares every other method with the best one, which has the most executable targets.

    It counts the scenarios in which a method has more, fewer or equally many executable targets. The p-value is of
    the exact two-sided sign test over the scenarios that both have planned and in which they differ; None without any.
    """
    counts = {method: plans.executable.sum(axis=1) for method, plans in part.plans.items()}
    planned = {method: plans.outcomes.planned for method, plans in part.plans.items()}
    best = max(counts, key=lambda method: int(counts[method].sum()))
    rows = []
    for method in counts.keys() - {best}:
        apart = (counts[method] - counts[best])[planned[method] & planned[best]]
        more, fewer = int((apart > 0).sum()), int((apart < 0).sum())
        p = float(scipy.stats.binomtest(more, more + fewer).pvalue) if more + fewer else None
        equal = len(apart) - more - fewer
        rows.append({"method": method, "other": best, "more": more, "fewer": fewer, "equal": equal, "p": p})
    rows.sort(key=lambda row: list(counts).index(row["method"]))
    return _table_of_rows("pairs", PAIRS, rows)


def paper(part: Part) -> Table:
    """Return the table of our results and the paper's by method; no rows if the part's grid is not the paper's."""
    table = part.paper_table
    if table is None:
        return Table("paper", PAPER, ())
    rows = [
        _result(part, method)
        | {
            "paper_success_percent": theirs.success_percent,
            "paper_step_ms": 1e3 * theirs.step_s,
            "paper_tcp_distance_mm": theirs.tcp_distance_mm,
            "paper_safe_distance_mm": theirs.safe_distance_mm,
        }
        for method, theirs in table.rows.items()
        if method in part.plans
    ]
    return _table_of_rows("paper", PAPER, rows)


def _result(part: Part, method: str) -> dict:
    plans = part.plans[method]
    good, ends = plans.tracked, plans.outcomes
    tracked, targets, executable = (int(column.sum()) for column in (ends.tracked, ends.targets, ends.executable))
    return {
        "method": method,
        "success_percent": percent(tracked, targets),
        "tracked": tracked,
        "targets": targets,
        "executable": executable,
        "executable_percent": percent(executable, targets),
        "complete": int(ends.complete.sum()),
        "scenarios": int(ends.planned.sum()),
        "step_ms": 1e3 * part.step_s[method],
        "tcp_distance_mean_mm": _reduced_values(np.mean, 1e3 * plans.residual[good]),
        "orientation_error_mean_deg": float(angle.mean())
        if (angle := summary.orientation_errors_deg(plans)).size
        else None,
        "clearance_min_mm": _reduced_values(np.min, 1e3 * plans.clearance[good]),
        "clearance_mean_mm": _reduced_values(np.mean, 1e3 * plans.clearance[good]),
    }


def reachability_table(part: Part) -> Table:
    """Return the table of tracked and reachable targets by method; no rows if reachability is unknown."""
    rows = []
    for method, plans in part.plans.items() if part.reachability is not None else ():
        ends = plans.outcomes
        count, reachable = ends.tracked[ends.planned], part.reachability[ends.planned]
        rows.append(
            {
                "method": method,
                "tracked": int(count.sum()),
                "reachable": int(reachable.sum()),
                "not_excluded": None if part.not_excluded is None else int(part.not_excluded[ends.planned].sum()),
                "of_reachable_percent": percent(count.sum(), reachable.sum()),
                "short": int((count < reachable).sum()),
                "beyond": int((count > reachable).sum()),
            }
        )
    return _table_of_rows("reachability", REACHABILITY, rows)


def reach_table(part: Part) -> Table:
    """Return the table of the number of targets by reach; no rows if `htcp reachability --each` was not run."""
    judged = np.empty(0, int) if part.reach is None else part.reach[part.reach != Reach.NOT_JUDGED]
    counts = {reach: int((judged == reach).sum()) for reach in Reach}
    rows = [
        {"reach": reach.label, "targets": count, "percent": percent(count, judged.size), "meaning": reach.message}
        for reach, count in counts.items()
        if count
    ]
    return _table_of_rows("reach", REACH, rows)


def steps(part: Part) -> Table:
    """Return the table of accepted joint steps by method: number, blocked joint paths, and lengths."""
    return _table_of_rows("joint-steps", STEPS, [_step(part, method) for method in part.plans])


def _step(part: Part, method: str) -> dict:
    plans = part.plans[method]
    good, blocked, ends = plans.tracked, plans.blocked, plans.outcomes
    before = int((good & ~np.logical_or.accumulate(blocked, axis=1)).sum())
    return {
        "method": method,
        "accepted": int(good.sum()),
        "blocked": int(blocked.sum()),
        "blocked_percent": percent(blocked.sum(), good.sum()),
        "not_checked": int((good & (plans.path_clear < 0)).sum()),
        "scenarios_blocked": int(blocked.any(axis=1).sum()),
        "tracked_before": before,
        "tracked_before_percent": percent(before, ends.targets.sum()),
        "after_recovery": int((plans.status == Status.TRACKED_AFTER_RECOVERY).sum()),
        "step_median_rad": _reduced_values(np.median, plans.joint_step[good]),
        "step_max_rad": _reduced_values(np.max, plans.joint_step[good]),
    }


def stop_table(part: Part) -> Table:
    """Return the table of reasons why scenarios failed, by method, with the failed targets and the colliding bodies."""
    rows = []
    for method, plans in part.plans.items():
        ends = plans.outcomes
        for reason in reasons(plans):
            lost = np.flatnonzero(ends.status == reason)
            at = ends.failed[lost]
            rows.append(
                {
                    "method": method,
                    "reason": reason.words,
                    "scenarios": at.size,
                    "first_target": int(at.min()),
                    "median_target": float(np.median(at)),
                    "last_target": int(at.max()),
                    "colliding_body": _colliding_bodies(part, method, reason, part.numbers[lost].tolist()),
                    "targets": _tally(at),
                }
            )
    return without_empty(_table_of_rows("stops", STOPS, rows))


def _colliding_bodies(part: Part, method: str, reason: Status, numbers: Sequence[int]) -> str | None:
    """Return the colliding bodies in some scenarios as text, most frequent first; None if unknown.

    For scenarios in which no body collides, the text contains the reason why the search ended.

    Args:
        part: The part of the run.
        method: The method.
        reason: The reason why the scenarios failed.
        numbers: The numbers of the scenarios.
    """
    if reason == Status.TIP_BLOCKED:
        return f"bare tip ({len(numbers)})"
    causes = [cause for k in numbers if (cause := part.causes(method).get(k)) is not None]
    if causes:
        names = ("{colliding_body} with {colliding_with}" if each["colliding_body"] else "{cause}" for each in causes)
        counts = Counter(name.format(**each) for name, each in zip(names, causes, strict=True))
        return ", ".join(f"{name} ({count})" for name, count in counts.most_common())
    found = [known for k in numbers if (known := part.scene.colliding_bodies(method).get(k)) is not None]
    counts = Counter(each.cause(f"none: {reason.ended}") for each in found)
    return ", ".join(f"{body} ({count})" for body, count in counts.most_common()) or None


def motion_ends(part: Part) -> Table:
    """Return the table of reasons why tracked targets are not executable, by method.

    A reason is the motion check's result for the segment at which the motion ends. It counts for all tracked targets
    after this segment's start.
    """
    rows = []
    for method, plans in part.plans.items():
        ends = plans.outcomes
        lost = ends.tracked - ends.executable
        for segment_status in map(SegmentStatus, np.unique(ends.segment_status[lost > 0]).tolist()):
            here = (lost > 0) & (ends.segment_status == segment_status)
            at = float(np.median(ends.executable[here]))
            counts = {"scenarios": int(here.sum()), "median_target": at, "targets": int(lost[here].sum())}
            rows.append({"method": method, "reason": segment_status.words, **counts})
    return _table_of_rows("motion-ends", MOTION_ENDS, rows)


def scenarios(part: Part) -> Table:
    """Return the table of all scenarios, a row per scenario and method: parameters, results, times, reachability."""
    columns = [Column("scenario", "scenario", "", "d"), *(Column(name, name) for name in part.parameters)]
    columns += [Column("method", "method"), Column("tracked", "tracked", "", "d"), Column("targets", "of", "", "d")]
    columns += [Column("executable", "executable", "", "d")]
    columns += [Column(name, name) for name in motion.MotionFigures._fields]
    columns += [Column(name, name) for name in timing_file.COLUMNS if any(part.timing.values())]
    columns += [Column("end", "end"), Column("motion_end", "motion ends"), Column("colliding_body", "colliding body")]
    columns += [Column("reachable", "reachable", "", "d")]
    times = {method: {row["scenario"]: row for row in rows.to_pylist()} for method, rows in part.timing.items() if rows}
    rows, causes = [], {method: part.causes(method) for method in part.plans}
    for s, number in enumerate(part.numbers.tolist()):
        given = {name: values[s].item() for name, values in part.parameters.items()}
        for method, plans in part.plans.items():
            if (end := plans.outcome(s)).targets:
                count = {"tracked": end.tracked, "targets": end.targets, "executable": end.executable}
                blocked = part.scene.colliding_bodies(method).get(number)
                cause = causes[method].get(number, {}).get("cause")
                reachable = None if part.reachability is None else int(part.reachability[s])
                row = {"scenario": number, **given, "method": method, **count}
                what = {
                    "end": "complete" if end.status is None else end.status.words,
                    "motion_end": end.segment_status.words if end.executable < end.tracked else None,
                    "colliding_body": cause or (blocked and blocked.description),
                    "reachable": reachable,
                }
                figures = {name: values[s].item() for name, values in part.motions[method]._asdict().items()}
                rows.append({**times.get(method, {}).get(number, {}), **row, **figures, **what})
    return _table_of_rows("scenarios", columns, rows)


def times(part: Part) -> Table:
    """Return the table of planning times and compilation times by method, for the complete run."""
    seconds = {method: (plans.run_s, plans.compile_s) for method, plans in part.plans.items()}
    return _table_of_rows("times", TIMES, [{"method": m, "run_s": r, "compile_s": c} for m, (r, c) in seconds.items()])


def configuration_table(ran: Mapping[str, PlanConfig], presets: Mapping[str, PlanConfig]) -> Table:
    """Return the table of the configuration keys in which runs and shipped configurations differ.

    Args:
        ran: Configurations of the runs, by name.
        presets: Shipped configurations, by name.
    """
    flat = {name: _flat(config.model_dump()) for name, config in {**ran, **presets}.items()}
    keys = dict.fromkeys(key for config in flat.values() for key in config)
    differ = [key for key in keys if len({repr(config.get(key)) for config in flat.values()}) > 1]
    columns = [Column("key", "key"), *(Column(name, name, quiet=name in presets) for name in flat)]
    rows = [{"key": key, **{name: _cell_text(config.get(key)) for name, config in flat.items()}} for key in differ]
    return _table_of_rows("configuration", columns, rows)


NO_REASON = plan_arrays.NO_TARGET, Status.NOT_ATTEMPTED


def reasons(plans: Plans) -> list[Status]:
    """Return the statuses with which scenarios failed, in the order of their codes."""
    return [Status(code) for code in np.unique(plans.outcomes.status).tolist() if code not in NO_REASON]


def _tally(values: Int[np.ndarray, "n"]) -> str:
    """Return the values with their counts as text, such as '70, 71 (4), 72'."""
    found, counts = np.unique(values, return_counts=True)
    return ", ".join(f"{v} ({n})" if n > 1 else f"{v}" for v, n in zip(found, counts, strict=True))


def percent(k: int | np.integer, n: int | np.integer) -> float:
    """Return 100 k / n; NaN if n is 0."""
    return float(100 * k / n) if n else math.nan


def _reduced_values(reduce, values: np.ndarray) -> float:
    return float(reduce(values)) if values.size else math.nan


def _flat(raw: dict, prefix: str = "") -> dict:
    """Flatten a nested mapping to dotted keys, without the key `method`; settings may be a dataclass."""
    flat = {}
    for key, value in raw.items():
        value = dataclasses.asdict(value) if dataclasses.is_dataclass(value) else value
        if isinstance(value, dict):
            flat |= _flat(value, f"{prefix}{key}.")
        elif prefix + key != "method":
            flat[prefix + key] = value
    return flat


def _cell_text(value: Any) -> str:
    """Return a configuration value as text for a cell; a path is shortened to its file name."""
    if isinstance(value, str):
        return Path(value).name
    if isinstance(value, list | tuple):
        return ", ".join(map(_cell_text, value))
    if isinstance(value, dict):  # a body of the tool
        return " ".join(map(_cell_text, value.values()))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _table_of_rows(name: str, columns: Sequence[Column], rows: Sequence[dict]) -> Table:
    return Table(name, tuple(columns), tuple(tuple(row.get(column.key) for column in columns) for row in rows))


def without_empty(table: Table) -> Table:
    """Return the table without its columns in which all values are None."""
    keep = [k for k in range(len(table.columns)) if any(row[k] is not None for row in table.rows)]
    rows = tuple(tuple(row[k] for k in keep) for row in table.rows)
    return table._replace(columns=tuple(table.columns[k] for k in keep), rows=rows)


def config_differences(config: PlanConfig, other: PlanConfig) -> dict[str, str]:
    """Return the keys in which `config` differs from `other`, with `config`'s values as text."""
    theirs = _flat(other.model_dump())
    ours = _flat(config.model_dump())
    return {
        key: _cell_text(value) for key, value in ours.items() if key not in theirs or repr(value) != repr(theirs[key])
    }
