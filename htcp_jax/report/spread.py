"""Tables of the rates of complete scenarios with their confidence, and of quartiles over a part's scenarios."""

import numpy as np

from htcp_jax.report.document import Table
from htcp_jax.report.groups import Part
from htcp_jax.runs import columns, summary, timing_file

QUARTILES = {"q1": 0.25, "median": 0.5, "q3": 0.75}
RATES = (
    "method",
    "criterion",
    "scenarios",
    columns.total("planned"),
    "rate_percent",
    "rate_low_percent",
    "rate_high_percent",
)
CRITERIA = {"complete": "complete", "can_be_driven": "executable to the last target"}  # by field of `Outcomes`
SPREAD = (
    "method",
    *(f"{name}_{quartile}_{unit}" for name, unit in (("executable", "percent"), ("joint_motion", "rad"),
                                                    ("planning", "ms"), ("processor", "ms"), ("cycle", "s"))
      for quartile in QUARTILES),
)  # fmt: skip
MEANING = (
    "Low and high: 95 % confidence interval (Wilson) of the "
    "rate, if the scenarios are a random sample. Neighbours in a regular grid are similar; there it is only a guide."
)
MEANING_OF_SPREAD = (
    "Quartiles over the scenarios: a quarter of them is below q1, half below the median, a quarter above q3. {}: only "
    "the scenarios that are executable to the last target. "
)
MEASURED = "Planning and processor time of a scenario are measured: each scenario was planned alone."
SHARED = (
    "Planning and processor time of a scenario are its share of the time of the scenarios planned together with it, by "
    "attempted targets. Run htcp sweep with --shard 1 to measure each scenario."
)


def scenario_rates(part: Part) -> Table:
    """Return the table of scenarios that meet each of CRITERIA, with confidence intervals of the rates."""
    rows = []
    for method, plans in part.plans.items():
        ends = plans.outcomes
        planned = int(ends.planned.sum())
        for name, criterion in CRITERIA.items():
            count = int(getattr(ends, name).sum())
            low, high = summary.rate_interval(count, planned)
            rates = {"rate": count / planned, "rate_low": low, "rate_high": high}
            row = {"method": method, "criterion": criterion, "scenarios": count, "planned": planned}
            rows.append(row | {f"{key}_percent": 100 * rate for key, rate in rates.items()})
    return Table.of("scenario-rates", RATES, rows, "Scenarios")


def spread(part: Part) -> Table:
    """Return the table of quartiles over the scenarios: executable targets, joint motion, times."""
    return Table.of(
        "spread", SPREAD, [_spread(part, method) for method in part.plans], "Spread over the scenarios"
    ).without_empty()


def meaning_of_spread(part: Part) -> str:
    """Return an explanation of the table `spread`."""
    alone = all(row["together"] == 1 for rows in part.times.values() for row in rows.values())
    driven = "Joint motion and cycle time" if any(part.timing.values()) else "Joint motion"
    return MEANING_OF_SPREAD.format(driven) + (MEASURED if alone else SHARED)


def _spread(part: Part, method: str) -> dict:
    ends = part.plans[method].outcomes
    planned, done = ends.planned, ends.can_be_driven
    motion = np.where(part.plans[method].tracked, part.plans[method].joint_step, 0.0).sum(axis=1)
    values = {
        "executable_{}_percent": 100 * ends.executable[planned] / ends.targets[planned],
        "joint_motion_{}_rad": motion[done],
    }
    times = list(part.times[method].values())
    for key, name in (("planning_{}_ms", "run_s"), ("processor_{}_ms", "cpu_s")):
        values[key] = 1e3 * np.array([row[name] for row in times], float)
    if (timed := part.timing[method]) is not None:
        values["cycle_{}_s"] = timing_file.column(timed, "cycle_time_s")
    row = {"method": method}
    for key, found in values.items():
        known = found[np.isfinite(found)]
        row |= {key.format(q): float(np.quantile(known, at)) if known.size else None for q, at in QUARTILES.items()}
    return row
