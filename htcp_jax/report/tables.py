"""Tables of a part's results, and of the runs' configurations."""

import dataclasses
import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from htcp_jax.motion import Plans, motion
from htcp_jax.motion import plans as plan_arrays
from htcp_jax.reachability import Reach
from htcp_jax.report.document import Table
from htcp_jax.report.groups import Part
from htcp_jax.runs import Column, columns, summary, timing_file
from htcp_jax.spec import PlanConfig
from htcp_jax.status import SegmentStatus, Status

ALL_METHODS = "all methods"  # label of the row with the compilation time
RESULTS = (
    "method", "tracked_percent", "tracked", columns.total("targets"), "executable", "executable_percent",
    "complete_percent", "complete", columns.total("scenarios"), "step_ms", "tcp_distance_mean_mm",
    "orientation_error_mean_deg", "clearance_min_mm", "clearance_mean_mm",
)  # fmt: skip
PAPER = (
    "method", "tracked_percent", "paper_tracked_percent", "step_ms", "paper_step_ms", "tcp_distance_mean_mm",
    "paper_tcp_distance_mm", "clearance_mean_mm", "paper_safe_distance_mm",
)  # fmt: skip
COMPARED = "criterion", "more", "fewer", "equal", "test", "p"
PAIRED = {  # criteria of paired comparisons: field of `Outcomes`, and name of the test
    "executable targets": ("executable", "sign test"),
    "complete": ("complete", "McNemar"),
    "executable to the last target": ("can_be_driven", "McNemar"),
}
STEPS = (
    "method", "accepted", "blocked", "blocked_percent", "not_checked", "scenarios_blocked", "tracked_before",
    "tracked_before_percent", "after_recovery", "step_median_rad", "step_max_rad",
)  # fmt: skip
STOPS = (
    "method", "reason", "scenarios", "first_target", "median_target", "last_target",
    *(columns.listed(key, "scenarios") for key in ("cause", "targets")),
)  # fmt: skip


def results(part: Part) -> Table:
    """Return the table of results by method: counts, percentages, time per step, errors and clearance."""
    return Table.of("results", RESULTS, [_result(part, method) for method in part.plans]).without_empty()


def pairs(part: Part) -> Table:
    """Return the table that compares every other method with the one that has the most executable targets."""
    counts = {method: int(plans.executable.sum()) for method, plans in part.plans.items()}
    best = max(counts, key=lambda method: counts[method])
    others = {method: plans for method, plans in part.plans.items() if method != best}
    rows = [
        {"method": method, "other": best} | row
        for method, plans in others.items()
        for row in compared(plans, part.plans[best])
    ]
    which = "the method" if [*counts.values()].count(counts[best]) == 1 else "one of the methods"
    title = f"Compared with {best}, {which} with the most executable targets"
    return Table.of("pairs", ("method", "other", *COMPARED), rows, title)


def between_runs(parts: Sequence[Part]) -> Table:
    """Return the table that compares each method with itself in another run of the same grid."""
    rows = []
    for one, other in itertools.combinations(parts, 2):
        if one.grid_name != other.grid_name:
            continue
        _, own, theirs = np.intersect1d(one.numbers, other.numbers, return_indices=True)
        for method in (method for method in one.plans if method in other.plans and own.size):
            found = compared(one.plans[method].rows(own), other.plans[method].rows(theirs))
            rows += [{"method": method, "run": one.name, "other": other.name} | row for row in found]
    return Table.of("between-runs", ("method", "run", "other", *COMPARED), rows, "Compared between runs")


def compared(plans: Plans, other: Plans) -> list[dict]:
    """Return the paired comparisons of two methods' plans of the same scenarios, one per criterion, by column key.

    More, fewer, equal: number of scenarios in which `plans` have a larger, smaller or equal value of the criterion than
    `other`, among those that both have planned. p is of the exact two-sided test; None if no scenario differs.
    """
    both = plans.outcomes.planned & other.outcomes.planned
    rows = []
    for criterion, (field, test) in PAIRED.items():
        values = (getattr(each.outcomes, field)[both].astype(int) for each in (plans, other))
        apart = np.subtract(*values)
        more, fewer = int((apart > 0).sum()), int((apart < 0).sum())
        counts = {"more": more, "fewer": fewer, "equal": len(apart) - more - fewer}
        rows.append({"criterion": criterion, **counts, "test": test, "p": summary.sign_test(more, fewer)})
    return rows


def paper(part: Part) -> Table:
    """Return the table of our results and the paper's by method; no rows if the part's grid is not the paper's."""
    table = part.paper_table
    if table is None:
        return Table.of("paper", PAPER, ())
    rows = [
        _result(part, method)
        | {
            "paper_tracked_percent": theirs.success_percent,
            "paper_step_ms": 1e3 * theirs.step_s,
            "paper_tcp_distance_mm": theirs.tcp_distance_mm,
            "paper_safe_distance_mm": theirs.safe_distance_mm,
        }
        for method, theirs in table.rows.items()
        if method in part.plans
    ]
    return Table.of("paper", PAPER, rows)


def _result(part: Part, method: str) -> dict:
    return result_row(method, summary.summarise(part.plans[method])) | {"step_ms": 1e3 * part.step_s[method]}


def result_row(method: str, found: summary.Summary) -> dict:
    """Return a method's row in the tables of results, by column key."""
    return found._asdict() | {
        "method": method,
        "tracked_percent": percent(found.tracked, found.targets),
        "executable_percent": percent(found.executable, found.targets),
        "complete_percent": percent(found.complete, found.scenarios),
        "blocked": found.blocked_paths,
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
    keys = "method", "tracked", "reachable", "not_excluded", "of_reachable_percent", "short", "beyond"
    return Table.of("reachability", keys, rows)


def reach_table(part: Part) -> Table:
    """Return the table of the number of targets by reach; no rows if `htcp reachability --each` was not run."""
    rows = () if part.reach is None else reach_rows(part.reach)
    return Table.of("reach", ("reach", "targets", "percent", "meaning"), rows)


def reach_rows(reach: Int[np.ndarray, "S T"]) -> list[dict]:
    """Return the rows of a table of the number of targets by reach, by column key.

    Args:
        reach: Values of `Reach`; targets that are not classified do not count.
    """
    known = reach[reach != Reach.NOT_JUDGED]
    counts = {each: int((known == each).sum()) for each in Reach}
    return [
        {"value": each, "reach": each.label, "targets": n, "percent": percent(n, known.size), "meaning": each.message}
        for each, n in counts.items()
        if n
    ]


def steps(part: Part) -> Table:
    """Return the table of accepted joint steps by method: number, blocked joint paths, and lengths."""
    return Table.of("joint-steps", STEPS, [_step(part, method) for method in part.plans], "Joint steps")


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
        "step_median_rad": summary.reduced(np.median, plans.joint_step[good]),
        "step_max_rad": summary.reduced(np.max, plans.joint_step[good]),
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
                    "cause": _causes(part, method, reason, part.numbers[lost].tolist()),
                    "targets": _tally(at),
                }
            )
    return Table.of("stops", STOPS, rows).without_empty()


def _causes(part: Part, method: str, reason: Status, numbers: Sequence[int]) -> str | None:
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
    counts = Counter(each.cause(reason.ended) for each in found)
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
    return Table.of("motion-ends", ("method", "reason", "scenarios", "median_target", "targets"), rows, "Motion ends")


def scenarios(part: Part) -> Table:
    """Return the table of all scenarios, a row per scenario and method: parameters, results, times, reachability."""
    keys = ["scenario", *part.parameters, "method", "tracked", "targets", "executable", *motion.MotionFigures._fields]
    keys += [name for name in timing_file.COLUMNS if any(part.timing.values())]
    keys += ["end", "motion_end", "cause", "reachable", "run_s", "cpu_s", "together", "seed", "package"]
    times = {method: {row["scenario"]: row for row in rows.to_pylist()} for method, rows in part.timing.items() if rows}
    rows, causes = [], {method: part.causes(method) for method in part.plans}
    for s, number in enumerate(part.numbers.tolist()):
        given = {name: values[s].item() for name, values in part.parameters.items()}
        for method, plans in part.plans.items():
            end, blocked = plans.outcome(s), part.scene.colliding_bodies(method).get(number)
            cause = causes[method].get(number, {}).get("cause") or (blocked and blocked.description)
            row = {name: values[s].item() for name, values in part.motions[method]._asdict().items()}
            row |= given | times.get(method, {}).get(number, {}) | end._asdict()
            row |= part.times[method].get(number, {}) | {"cause": cause}
            row["end"] = "complete" if end.status is None else end.status.words
            row["motion_end"] = end.segment_status.words if end.executable < end.tracked else None
            row["reachable"] = None if part.reachability is None else int(part.reachability[s])
            rows += [row] if end.targets else []
    return Table.of("scenarios", keys, rows)


def times(part: Part) -> Table:
    """Return the table of planning times by method, and of the compilation for all methods, for the complete run.

    Methods share programs, and all are compiled before the first one plans, so no method has a time of its own.
    """
    rows = [{"method": method, "run_s": plans.run_s, "cpu_s": plans.cpu_s} for method, plans in part.plans.items()]
    compilation = {"method": ALL_METHODS, "compile_s": sum(plans.compile_s for plans in part.plans.values())}
    return Table.of("times", ("method", "run_s", "cpu_s", "compile_s"), [*rows, compilation]).without_empty()


def configuration_table(ran: Mapping[str, PlanConfig], presets: Mapping[str, PlanConfig]) -> Table:
    """Return the table of the configuration keys in which runs and shipped configurations differ.

    Args:
        ran: Configurations of the runs, by name.
        presets: Shipped configurations, by name.
    """
    flat = {name: _flat(config.model_dump()) for name, config in {**ran, **presets}.items()}
    keys = dict.fromkeys(key for config in flat.values() for key in config)
    differ = [key for key in keys if len({repr(config.get(key)) for config in flat.values()}) > 1]
    of_runs = [Column(name, name, quiet=name in presets) for name in flat]
    rows = [{"key": key, **{name: _cell_text(config.get(key)) for name, config in flat.items()}} for key in differ]
    return Table.of("configuration", ["key", *of_runs], rows)


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


def with_qp_of(config: PlanConfig, other: PlanConfig) -> PlanConfig:
    """Return `other` with the QP solver of `config` if `auto` selected it, which is no difference from `auto`."""
    if config.settings.qp not in (other.settings.on(platform).qp for platform in ("cpu", "gpu")):
        return other
    return other.model_copy(update={"settings": dataclasses.replace(other.settings, qp=config.settings.qp)})


def config_differences(config: PlanConfig, other: PlanConfig) -> dict[str, str]:
    """Return the keys in which `config` differs from `other`, with `config`'s values as text, see `with_qp_of`."""
    theirs = _flat(with_qp_of(config, other).model_dump())
    ours = _flat(config.model_dump())
    return {
        key: _cell_text(value) for key, value in ours.items() if key not in theirs or repr(value) != repr(theirs[key])
    }
