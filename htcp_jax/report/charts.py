"""Charts of sweep results, in one style. Every function returns a matplotlib Figure; a notebook displays it.

Results come as a mapping from method to array, S scenarios by T targets, as in `Plans`:

    charts.survival({"baseline": plans_a.status, "nspace-sqp": plans_b.status})

A status below zero marks a target that does not exist or a scenario that is not planned yet. Colours are
distinguishable for colour-blind readers and never carry a meaning alone: methods also differ in line style, and each
line has its name; reasons differ in marker; the cells of a map show their number. Drawing needs no screen.
"""

from htcp_jax.report.path_charts import clearance_along, joint_motion, joint_motion_by_joint, stops, survival
from htcp_jax.report.success_charts import Axis, success, success_line, success_map, success_slices

__all__ = [
    "Axis",
    "clearance_along",
    "joint_motion",
    "joint_motion_by_joint",
    "stops",
    "success",
    "success_line",
    "success_map",
    "success_slices",
    "survival",
]
