"""Table of executable targets, dwells, cost and smoothness of a part's motions."""

import numpy as np

from htcp_jax.report.document import Table
from htcp_jax.report.groups import Part
from htcp_jax.runs import summary

MOTIONS = (
    "method", "tracked", "executable", "complete_motions", "dwells", "dwelling", "cost_median_rad2", "cost_common_rad2",
    "path_step_max_rad", "curvature_median_rad_m2", "curvature_max_rad_m2",
)  # fmt: skip
MEANING = (
    "Values are for the executable part of each plan. To the end: scenarios whose motion leads to the last target. "
    "Dwells are targets of the path at which the arm changes its configuration while the tool is at rest. Cost is the "
    "sum of the squared joint steps, equation (3): its median over the scenarios whose motion leads to the last "
    "target, and its geometric mean over {common}. Longest step: between two configurations on the path. Curvature: a "
    "scenario's largest second derivative |q''| of the configuration by the path's arc length, except at dwells."
)


def motion_table(part: Part) -> Table:
    """Return the table of executable targets, dwells, cost, longest step and curvature by method."""
    common = common_scenarios(part)
    return Table.of("motions", MOTIONS, [_motion_row(part, method, common) for method in part.plans])


def meaning(part: Part) -> str:
    """Return an explanation of the columns of `motion_table`."""
    count = int(common_scenarios(part).sum())
    scenarios = f"the {count:,} scenarios" if count else "the scenarios (there are none)"
    return MEANING.format(common=f"{scenarios} in which every method's motion does")


def common_scenarios(part: Part) -> np.ndarray:
    """Return the mask (S,) of the scenarios in which every method's motion leads to the last target."""
    return np.logical_and.reduce([plans.outcomes.can_be_driven for plans in part.plans.values()])


def _motion_row(part: Part, method: str, common: np.ndarray) -> dict:
    ends, found = part.plans[method].outcomes, part.motions[method]
    known, complete = ~np.isnan(found.dwells), ends.can_be_driven
    return {
        "method": method,
        "tracked": int(ends.tracked.sum()),
        "executable": int(ends.executable.sum()),
        "complete_motions": int(complete.sum()),
        "dwells": int(found.dwells[known].sum()) if known.any() else None,
        "dwelling": int((found.dwells[known] > 0).sum()) if known.any() else None,
        "cost_median_rad2": summary.reduced(np.median, found.motion_cost_rad2[complete]),
        "cost_common_rad2": summary.reduced(_geometric_mean, found.motion_cost_rad2[common]),
        "path_step_max_rad": summary.reduced(np.max, found.path_step_max_rad),
        "curvature_median_rad_m2": summary.reduced(np.median, found.curvature_max_rad_m2),
        "curvature_max_rad_m2": summary.reduced(np.max, found.curvature_max_rad_m2),
    }


def _geometric_mean(values: np.ndarray) -> float:
    return float(np.exp(np.log(values).mean())) if (values > 0).all() else 0.0
