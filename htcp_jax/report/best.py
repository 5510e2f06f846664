"""Table and picture of each method's best scenarios."""

import textwrap

import numpy as np

from htcp_jax.report.document import Block, Picture, Table
from htcp_jax.report.groups import Part
from htcp_jax.runs import columns

BEST = 3  # number of scenarios per method
MOST_IN_TITLE, TITLE_LINE = 4, 95  # maximum parameters in a picture's title, and characters of its lines
RANKED = (
    "The best scenarios of each method, sorted by executable targets, then by minimum clearance, then by joint motion."
)


def best_scenarios(part: Part) -> Table:
    """Return the table of each method's best scenarios, at most BEST per method, with the parameters that vary.

    Scenarios are sorted by the share of executable targets (largest first), then by minimum clearance (largest first),
    then by joint motion (smallest first).
    """
    own = part.varied
    varied = [
        columns.column(name)._replace(format=".6g" if values.dtype.kind == "f" else "") for name, values in own.items()
    ]
    figures = "executable", columns.total("targets"), "clearance_min_mm", "joint_motion_rad"
    keys = "method", "scenario", *varied, *figures
    rows = []
    for method in part.plans:
        for s, *figures in ranked(part, method)[:BEST]:
            given = [values[s].item() for values in own.values()]
            rows.append((method, int(part.numbers[s]), *given, *figures))
    return Table("best", columns.of(*keys), tuple(rows))


def ranked(part: Part, method: str) -> list[tuple[int, int, int, float, float]]:
    """Return the scenarios in which a method has executable targets, best first.

    Returns:
        For each scenario: its row in the part, the number of executable targets, the number of all targets, the
        minimum clearance [mm], and the joint motion [rad].
    """
    plans = part.plans[method]
    good, targets = plans.executable, plans.outcomes.targets
    rows = []
    for s in np.flatnonzero(good.any(axis=1)).tolist():
        least = 1e3 * float(plans.clearance[s, good[s]].min())
        rows.append((s, int(good[s].sum()), int(targets[s]), least, float(plans.joint_step[s, good[s]].sum())))
    return sorted(rows, key=lambda row: (-row[1] / row[2], -row[3], row[4], row[0]))


def best_of_all(part: Part, table: Table, prefix: str) -> list[Block]:
    """Return the section on the best scenarios: the table, and a picture of the best one.

    Args:
        part: The part of the run.
        table: The part's table from `best_scenarios`.
        prefix: Prefix of the picture's name.
    """
    found = [(rows[0], method) for method in part.plans if (rows := ranked(part, method))]
    if not found:
        return []
    (s, count, targets, least, _), method = min(found, key=lambda it: (-it[0][1] / it[0][2], -it[0][3], it[0][4]))
    number = int(part.numbers[s])
    scenario = f"Scenario {number} by {method}"
    what, title = (f"{scenario}: {label}".removesuffix(": ") for label in (part.label(s), part.label(s, MOST_IN_TITLE)))
    figure = part.scene.picture(number, method, _wrapped(title))
    if figure is None:
        return [RANKED, table, f"There is no picture of the cell: {part.scene.problem}."]
    alt = f"{what}; {count} of {targets} targets executable, minimum clearance {least:.3g} mm"
    return [RANKED, table, f"{alt}.", Picture(f"{prefix}cell", figure, alt)]


def _wrapped(title: str) -> str:
    """Return a title in lines of at most TITLE_LINE characters, broken after commas."""
    parts = title.replace(" ", "\N{NO-BREAK SPACE}").replace(",\N{NO-BREAK SPACE}", ", ")
    return "\n".join(textwrap.wrap(parts, TITLE_LINE)).replace("\N{NO-BREAK SPACE}", " ")
