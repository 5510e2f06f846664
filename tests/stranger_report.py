"""Every number of a sweep's report, computed from the run's files by a script that knows nothing of this package.

It reads the Parquet files with pyarrow and manifest.json, uses numpy, and follows the descriptions on the page "Read a
report". Texts that are no numbers are not computed: names of colliding bodies, and the paper's values.
"""

import json
import math
from collections import Counter
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

Z = 1.959963984540054  # of a two-sided confidence of 95 %
QUARTILES = {"q1": 25, "median": 50, "q3": 75}
SHARES = "velocity", "acceleration", "jerk", "torque"
HELD = 0.99


def report_of(folder):
    """Rows of each of the report's tables, by the name of its CSV file."""
    run = Files(Path(folder))
    tables = {
        name: [] for name in ("results", "scenario-rates", "motions", "motion-ends", "stops", "joint-steps", "times")
    }
    tables |= {"spread": [], "best": [], "timing": []}
    for method in run.methods:
        for name in tables:
            made = globals()[f"{name.replace('-', '_')}_of"](run, method)
            tables[name] += made if isinstance(made, list) else [made]
    tables["times"].append({"method": "all methods", "compile_s": sum(m["compile_s"] for m in run.shards)})
    tables["pairs"] = pairs_of(run)
    tables["paper"] = tables["results"]
    tables["scenarios"] = [scenario_of(run, m, s) for s in run.numbers for m in run.methods if s in run.rows[m]]
    return tables


class Files:
    """The rows of a run."""

    def __init__(self, folder):
        self.manifest = json.loads((folder / "manifest.json").read_text())
        self.methods, self.shards = self.manifest["methods"], self.manifest["shards"]

        def read(table):
            rows = [
                row for file in sorted((folder / table).glob("*.parquet")) for row in pq.read_table(file).to_pylist()
            ]
            return {m: [row for row in rows if row["method"] == m] for m in self.methods}

        self.rows = {m: {row["scenario"]: row for row in rows} for m, rows in read("scenarios").items()}
        self.targets = read("targets")
        for rows in self.targets.values():
            rows.sort(key=lambda row: (row["scenario"], row["target"]))
        self.numbers = sorted({s for rows in self.rows.values() for s in rows})
        self.timing = {
            m: {row["scenario"]: row for row in pq.read_table(file).to_pylist()}
            for m in self.methods
            if (file := folder / "timing" / f"{m}.parquet").exists()
        }
        self.groups = {m: {s: [] for s in rows} for m, rows in self.rows.items()}
        for m in self.methods:
            for row in self.targets[m]:
                self.groups[m][row["scenario"]].append(row)

    def column(self, method, name):
        """Values of the table of scenarios without those that are missing."""
        return known(row[name] for row in self.rows[method].values())

    def attempted(self, method, scenario):
        row = self.rows[method][scenario]
        return row["targets"] if row["complete"] else row["failed_target"] + 1

    def is_driven(self, method, scenario):
        row = self.rows[method][scenario]
        return row["executable"] == row["targets"]

    def seconds(self, method, scenario, name):
        """Share of the shard's time, by attempted targets."""
        (shard,) = (s for s in self.shards if s["method"] == method and scenario in numbers_of(s))
        total = sum(self.attempted(method, s) for s in numbers_of(shard))
        return None if name not in shard else shard[name] * self.attempted(method, scenario) / total

    def total_s(self, method, name):
        return sum(shard[name] for shard in self.shards if shard["method"] == method)


def numbers_of(shard):
    return shard.get("numbers") or range(shard["first"], shard["last"] + 1)


def known(values):
    return np.array([value for value in values if value is not None], float)


def or_none(reduce, values):
    return float(reduce(values)) if len(values) else None


def words(name):
    return name.replace("_", " ").lower()


def tally(values):
    return ", ".join(f"{value} ({n})" if n > 1 else f"{value}" for value, n in sorted(Counter(values).items()))


def results_of(run, method):
    rows, tracked = run.rows[method].values(), [row for row in run.targets[method] if row["tracked"]]
    counts = {name: sum(row[name] for row in rows) for name in ("tracked", "targets", "executable", "complete")}
    angles = known(row["orientation_error_rad"] for row in tracked)
    clearance = 1e3 * known(row["clearance_m"] for row in tracked)
    return counts | {
        "method": method,
        "scenarios": len(rows),
        "tracked_percent": 100 * counts["tracked"] / counts["targets"],
        "executable_percent": 100 * counts["executable"] / counts["targets"],
        "complete_percent": 100 * counts["complete"] / len(rows),
        "step_ms": 1e3 * run.total_s(method, "run_s") / sum(run.attempted(method, s) for s in run.rows[method]),
        "tcp_distance_mean_mm": or_none(np.mean, 1e3 * known(row["residual_m"] for row in tracked)),
        "orientation_error_mean_deg": or_none(np.mean, np.degrees(angles)),
        "clearance_min_mm": or_none(np.min, clearance),
        "clearance_mean_mm": or_none(np.mean, clearance),
    }


def scenario_rates_of(run, method):
    n, made = len(run.rows[method]), []
    complete = sum(row["complete"] for row in run.rows[method].values())
    driven = sum(run.is_driven(method, s) for s in run.rows[method])
    for criterion, k in (("complete", complete), ("executable to the last target", driven)):
        p = k / n
        middle, half = p + Z * Z / (2 * n), Z * math.sqrt((p * (1 - p) + Z * Z / (4 * n)) / n)
        row = {"method": method, "criterion": criterion, "scenarios": k, "planned": n, "rate_percent": 100 * p}
        bounds = {"low": middle - half, "high": middle + half}
        made.append(row | {f"rate_{end}_percent": 100 * value / (1 + Z * Z / n) for end, value in bounds.items()})
    return made


def pairs_of(run):
    counts = {m: {s: row["executable"] for s, row in rows.items()} for m, rows in run.rows.items()}
    best, made = max(counts, key=lambda m: sum(counts[m].values())), []
    for method in counts:
        both = counts[method].keys() & counts[best].keys()
        criteria = {
            "executable targets": ("sign test", lambda m, s: run.rows[m][s]["executable"]),
            "complete": ("McNemar", lambda m, s: run.rows[m][s]["complete"]),
            "executable to the last target": ("McNemar", run.is_driven),
        }
        for criterion, (test, value) in criteria.items() if method != best else ():
            more = sum(value(method, s) > value(best, s) for s in both)
            fewer = sum(value(method, s) < value(best, s) for s in both)
            row = {"method": method, "other": best, "criterion": criterion, "more": more, "fewer": fewer, "test": test}
            made.append(row | {"equal": len(both) - more - fewer, "p": chance_of(more, fewer)})
    return made


def chance_of(one, other):
    """Probability of a split at least as uneven if both sides are equally likely; None without any."""
    tail = sum(math.comb(one + other, k) for k in range(min(one, other) + 1))
    return min(1.0, 2 * tail / 2 ** (one + other)) if one + other else None


def spread_of(run, method):
    done = [s for s in run.rows[method] if run.is_driven(method, s)]
    values = {
        "executable_{}_percent": [100 * row["executable"] / row["targets"] for row in run.rows[method].values()],
        "joint_motion_{}_rad": [run.rows[method][s]["joint_motion_rad"] for s in done],
        "planning_{}_ms": [1e3 * run.seconds(method, s, "run_s") for s in run.rows[method]],
        "processor_{}_ms": [1e3 * run.seconds(method, s, "cpu_s") for s in run.rows[method]],
        "cycle_{}_s": known(row["cycle_time_s"] for row in run.timing.get(method, {}).values()),
    }
    quartiles = {
        key.format(q): or_none(lambda own, at=at: np.percentile(own, at), found)
        for key, found in values.items()
        for q, at in QUARTILES.items()
    }
    return {"method": method} | quartiles


def best_of(run, method):
    made = []
    for s, rows in run.groups[method].items():
        whole = run.rows[method][s]
        if driven := rows[: whole["executable"]]:
            row = {"executable": len(driven), "clearance_min_mm": 1e3 * min(each["clearance_m"] for each in driven)}
            row |= whole | row | {"joint_motion_rad": sum(each["joint_step_rad"] for each in driven)}
            made.append(row)
    made.sort(key=lambda r: (-r["executable"] / r["targets"], -r["clearance_min_mm"], r["joint_motion_rad"]))
    return made[:3]


def motions_of(run, method):
    done = [row for s, row in run.rows[method].items() if run.is_driven(method, s)]
    common = [s for s in run.numbers if all(s in run.rows[m] and run.is_driven(m, s) for m in run.methods)]
    costs = known(run.rows[method][s]["motion_cost_rad2"] for s in common)
    dwells = run.column(method, "dwells")
    curvature = run.column(method, "curvature_max_rad_m2")
    return {
        "method": method,
        "tracked": int(run.column(method, "tracked").sum()),
        "executable": int(run.column(method, "executable").sum()),
        "complete_motions": len(done),
        "dwells": int(dwells.sum()) if len(dwells) else None,
        "dwelling": int((dwells > 0).sum()) if len(dwells) else None,
        "cost_median_rad2": or_none(np.median, known(row["motion_cost_rad2"] for row in done)),
        "cost_common_rad2": math.prod(costs) ** (1 / len(costs)) if len(costs) else None,
        "path_step_max_rad": or_none(np.max, run.column(method, "path_step_max_rad")),
        "curvature_median_rad_m2": or_none(np.median, curvature),
        "curvature_max_rad_m2": or_none(np.max, curvature),
    }


def motion_ends_of(run, method):
    ends = {}
    for s, whole in run.rows[method].items():
        if whole["executable"] < whole["tracked"]:
            status = run.groups[method][s][whole["executable"]]["segment_status"] or "NOT_CHECKED"
            ends.setdefault(words(status), []).append(whole)
    return [
        {
            "method": method,
            "reason": reason,
            "scenarios": len(rows),
            "median_target": float(np.median([row["executable"] for row in rows])),
            "targets": sum(row["tracked"] - row["executable"] for row in rows),
        }
        for reason, rows in ends.items()
    ]


def stops_of(run, method):
    ends = {}
    for row in run.rows[method].values():
        if not row["complete"]:
            ends.setdefault(words(row["failure"]), []).append(row["failed_target"])
    return [
        {
            "method": method,
            "reason": reason,
            "scenarios": len(at),
            "first_target": min(at),
            "median_target": float(np.median(at)),
            "last_target": max(at),
            "targets": tally(at),
        }
        for reason, at in ends.items()
    ]


def joint_steps_of(run, method):
    accepted = [row for row in run.targets[method] if row["tracked"]]
    blocked = [row for row in accepted if row["path_clear"] is False]
    before = 0
    for rows in run.groups[method].values():
        stop = next((k for k, row in enumerate(rows) if row["tracked"] and row["path_clear"] is False), len(rows))
        before += sum(row["tracked"] for row in rows[:stop])
    steps = known(row["joint_step_rad"] for row in accepted)
    return {
        "method": method,
        "accepted": len(accepted),
        "blocked": len(blocked),
        "blocked_percent": 100 * len(blocked) / len(accepted) if accepted else None,
        "not_checked": sum(row["path_clear"] is None for row in accepted),
        "scenarios_blocked": len({row["scenario"] for row in blocked}),
        "tracked_before": before,
        "tracked_before_percent": 100 * before / len(run.targets[method]),
        "after_recovery": int(run.column(method, "after_recovery").sum()),
        "step_median_rad": or_none(np.median, steps),
        "step_max_rad": or_none(np.max, steps),
    }


def times_of(run, method):
    return {"method": method, "run_s": run.total_s(method, "run_s"), "cpu_s": run.total_s(method, "cpu_s")}


def timing_of(run, method):
    if method not in run.timing:
        return []
    rows = run.timing[method].values()
    timed = [row for row in rows if row["cycle_time_s"] is not None]
    held = known(row["feed_held_share"] for row in timed)
    cycle = [row["cycle_time_s"] for row in timed]
    row = {"method": method, "timed": len(timed), "scenarios": len(rows), "held": int((held >= HELD).sum())}
    row |= {f"cycle_{name}_s": or_none(getattr(np, name), cycle) for name in ("min", "median", "max")}
    row["held_min_percent"] = or_none(np.min, 100 * held)
    row["reached_min_mm_s"] = or_none(np.min, 1e3 * known(row["feed_reached_m_s"] for row in timed))
    for name in SHARES:
        row[f"{name}_percent"] = or_none(np.max, 100 * known(each[f"{name}_share"] for each in timed))
    return row


def scenario_of(run, method, scenario):
    row, timed = run.rows[method][scenario], run.timing.get(method, {}).get(scenario, {})
    (together,) = (len(numbers_of(s)) for s in run.shards if s["method"] == method and scenario in numbers_of(s))
    times = {name: run.seconds(method, scenario, name) for name in ("run_s", "cpu_s")}
    end = {"end": "complete" if row["complete"] else words(row["failure"]), "together": together}
    return row | timed | times | end | {"seed": run.manifest["seed"]}
