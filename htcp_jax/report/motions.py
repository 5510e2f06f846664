"""Table of executable targets, dwells, cost and smoothness of a part's motions."""

import math

import numpy as np

from htcp_jax.report.document import Column, Table
from htcp_jax.report.groups import Part

MOTIONS = (
    Column("method", "method"),
    Column("tracked", "tracked", "targets", ",d"),
    Column("executable", "executable", "targets", ",d"),
    Column("complete_motions", "complete", "motions", ",d"),
    Column("dwells", "dwells", "targets", ",d"),
    Column("dwelling", "in", "scenarios", ",d"),
    Column("cost_median_rad2", "cost", "median rad2", ".3g"),
    Column("cost_common_rad2", "cost, common", "mean rad2", ".3g"),
    Column("path_step_max_rad", "longest step", "rad", ".3f"),
    Column("curvature_median_rad_m2", "curvature", "median rad/m2", ",.0f"),
    Column("curvature_max_rad_m2", "largest", "rad/m2", ",.0f"),
)
MEANING = (
    "Values are for the executable part of each plan. Dwells are targets of the path at which the arm changes its "
    "configuration while the tool is at rest. Cost is the sum of the squared joint steps, equation (3): its median "
    "over the scenarios whose motion leads to the last target, and its geometric mean over {common}. Longest step: "
    "between two configurations on the path. Curvature: a scenario's largest second derivative |q''| of the "
    "configuration by the path's arc length, except at dwells."
)


def motion_table(part: Part) -> Table:
    """Return the table of executable targets, dwells, cost, longest step and curvature by method."""
    common = common_scenarios(part)
    rows = [_motion_row(part, method, common) for method in part.plans]
    return Table("motions", MOTIONS, tuple(tuple(row[column.key] for column in MOTIONS) for row in rows))


def meaning(part: Part) -> str:
    """Return an explanation of the columns of `motion_table`."""
    count = int(common_scenarios(part).sum())
    scenarios = f"the {count:,} scenarios" if count else "the scenarios (there are none)"
    return MEANING.format(common=f"{scenarios} in which every method's motion does")


def common_scenarios(part: Part) -> np.ndarray:
    """Return the mask (S,) of the scenarios in which every method's motion leads to the last target."""
    return np.logical_and.reduce([_can_be_driven(part, method) for method in part.plans])


def _motion_row(part: Part, method: str, common: np.ndarray) -> dict:
    ends, found = part.plans[method].outcomes, part.motions[method]
    known, complete = ~np.isnan(found.dwells), _can_be_driven(part, method)
    return {
        "method": method,
        "tracked": int(ends.tracked.sum()),
        "executable": int(ends.executable.sum()),
        "complete_motions": int(complete.sum()),
        "dwells": int(found.dwells[known].sum()) if known.any() else None,
        "dwelling": int((found.dwells[known] > 0).sum()) if known.any() else None,
        "cost_median_rad2": _reduced(np.median, found.motion_cost_rad2[complete]),
        "cost_common_rad2": _reduced(_geometric_mean, found.motion_cost_rad2[common]),
        "path_step_max_rad": _reduced(np.max, found.path_step_max_rad),
        "curvature_median_rad_m2": _reduced(np.median, found.curvature_max_rad_m2),
        "curvature_max_rad_m2": _reduced(np.max, found.curvature_max_rad_m2),
    }


def _can_be_driven(part: Part, method: str) -> np.ndarray:
    return part.plans[method].outcomes.can_be_driven


def _geometric_mean(values: np.ndarray) -> float:
    return float(np.exp(np.log(values).mean())) if (values > 0).all() else 0.0


def _reduced(reduce, values: np.ndarray) -> float:
    """Apply `reduce` to the values that are not NaN; return NaN if there are none."""
    known = values[~np.isnan(values)]
    return float(reduce(known)) if known.size else math.nan
