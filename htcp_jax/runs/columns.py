"""Units and descriptions of the columns in a run's Parquet files; the files carry them, see `described`.

`TARGETS` is for the table of targets, one row per method, scenario and target; `SCENARIOS` for that of scenarios, one
row per method and scenario; `TIMING` for that of times, one row per scenario; `MOUNTINGS` for that of a search for
mountings, one row per mounting. Columns of joints, of axes and of varied keys have general descriptions. Units follow
the names: clearance_m is in metres.
"""

import json
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import pyarrow as pa

from htcp_jax.runs import parameters

WRITTEN_BY = b"htcp_jax"  # key of a file's metadata: run, commit and versions, as JSON

BOTH = {
    "method": "planning method",
    "scenario": "number of the scenario in the full grid",
    "tracked": "True if the target is tracked; in the table of scenarios, their number",
}
TARGETS = MappingProxyType(
    BOTH
    | {
        "target": "number of the target, from 0, the start's own TCP",
        "status": "name of a htcp_jax.status.Status",
        "clearance_m": "smallest distance of all bodies, D; null if not tracked, as are all values that depend on x",
        "residual_m": "distance of the TCP from the target",
        "orientation_error_rad": "largest angle from the task's orientations; null if it has none",
        "iterations": "step QPs solved for the target; 0 if a plan made backwards pushed it there",
        "joint_step_rad": "|x_t - x_{t-1}|, the start before target 0",
        "path_clear": "True if the straight joint path from the row before is clear; null if unknown",
        "segment_status": "name of a htcp_jax.status.SegmentStatus, of the segment from the row before, or null",
        "segment_clearance_m": "guaranteed clearance along that segment; null if it is not proven",
        "via_points": "configurations on that segment, one after the other; null for a straight joint path",
        "via_shares": "share of the way from the target before at each via point; null for a straight joint path",
        "recovery": "0: none; k: recovery strategy k of the method; one beyond its last: planned backwards",
        "manipulability_m_rad": "smallest singular value of the task's Jacobian, see motion.manipulability",
        "dead_end_searches": "searches backwards after a dead end at the target; null without one, as the next five",
        "dead_end_configurations": "configurations sampled, extended or moved after it",
        "dead_end_found": "clear configurations found at the target",
        "dead_end_connected": "of these, connected by a proven motion",
        "dead_end_wider": "searches forwards from an earlier target, with a wider beam",
        "dead_end_excluded": "why none is clear there, if that is proven: out of reach, tool, wrist, arm",
        "tcp": "tool centre point, world",
        "target_xyz": "target, world; never null",
    }
)
SCENARIOS = MappingProxyType(
    BOTH
    | {
        "group": "group in the sweep's file; null without groups",
        "targets": "number of targets",
        "executable": "number of targets to which a proven motion leads from the start",
        "complete": "True if all targets are tracked",
        "failed_target": "first target that is not tracked; null if complete, as are failure and reason",
        "failure": "status of that target",
        "reason": "message of that status",
        "after_recovery": "number of targets tracked after a recovery",
        "blocked_paths": "number of tracked targets whose straight joint path from the row before collides",
        "dwells": "number of targets at which the arm changes its configuration; executable part, as are the next four",
        "motion_cost_rad2": "cost of the motion, equation (3)",
        "path_step_max_rad": "largest joint step on the path",
        "curvature_max_rad_m2": "largest curvature of the joint path",
        "segment_clearance_min_m": "guaranteed clearance of the motion",
        "clearance_min_m": "minimum clearance at the tracked targets",
        "residual_max_m": "largest distance of the TCP from a tracked target",
        "joint_motion_rad": "sum of the joint steps between tracked targets",
        "rotation_x_rad": "rotation of the workpiece about world x, which comes first",
        "rotation_y_rad": "rotation of the workpiece about world y",
        "rotation_z_rad": "rotation of the workpiece about world z",
        "shift": "shift of the workpiece along the world's axes",
        "tool_extension_m": "extension of the tool along its own z axis",
        "margin_m": "required clearance at a target",
        "path": "tool path: a seam of the duct, or the name of its file",
        "joint_step_max_rad": "largest travel of a joint between two targets of the path (m of a slide); as dwells",
        "joint_step_target": "target at the end of that segment",
        "joint_step_joint": "joint with that travel",
        "start": "first configuration of the plan",
        "colliding_body": "body that collides if no start was possible; null if none does, as is colliding_with",
        "colliding_with": "obstacle that it collides with",
        "cause": "reason why no start was possible",
    }
)
TIMING = MappingProxyType(
    {
        "scenario": BOTH["scenario"],
        "feed_m_s": "required feed",
        "cycle_time_s": "time from home over the path and back; null without a motion to the end, as is the rest",
        "path_time_s": "part of it on the path, with dwells",
        "feed_held_share": "share of the path's length on which the feed is held within 1 %",
        "feed_reached_m_s": "minimum feed between the path's run-up and its run-down; 0 if the arm stops there",
        "feed_reason": "cause of the minimum: stop, or the limit and its joint; null if the feed is held",
        "feed_target": "target that the motion leads to at the minimum; null if the feed is held",
        "velocity_share": "largest used share of the velocity limits on the path",
        "velocity_joint": "joint with that share",
        "acceleration_share": "largest used share of the acceleration limits on the path",
        "acceleration_joint": "joint with that share",
        "jerk_share": "largest used share of the jerk limits on the path",
        "jerk_joint": "joint with that share",
        "torque_share": "largest used share of the effort limits, on the complete motion; null if not known",
        "torque_joint": "joint with that share",
    }
)
MOUNTINGS = MappingProxyType(
    {
        "round": "round of the search that evaluated the mounting",
        "done": "share of the targets that are tracked, over all paths",
        "complete": "True if all targets are tracked",
        "lost": "reason why the mounting fails; null if it is complete",
    }
)
TABLES = MappingProxyType({"targets": TARGETS, "scenarios": SCENARIOS, "timing": TIMING, "mountings": MOUNTINGS})
UNITS = MappingProxyType(  # by the end of a column's name; longer ends first
    {"_rad_m2": "rad/m2", "_rad2": "rad2", "_m_s": "m/s", "_m_rad": "m/rad"}
    | {"_rad": "rad", "_m": "m", "_s": "s", "_share": "1"}
)


def described(rows: pa.Table, table: str, joints: Sequence[str], made: Mapping[str, Any]) -> pa.Table:
    """Return the rows with metadata: unit and description of each column, and the file's origin.

    Args:
        rows: Rows of a table.
        table: Its name in `TABLES`.
        joints: Names of the columns of x, see `tables.joint_columns`.
        made: The file's origin: run, commit, versions.
    """
    fields = []
    for field in rows.schema:
        about = {"unit": unit_of(field.name, joints), "description": description_of(field.name, table, joints)}
        fields.append(field.with_metadata({name: text for name, text in about.items() if text}))
    return rows.cast(pa.schema(fields, {WRITTEN_BY: json.dumps(made)}))


def unit_of(column: str, joints: Sequence[str]) -> str:
    """Return a column's unit by the end of its name; empty without one.

    Args:
        column: Name of the column.
        joints: Names of the columns of x; via points have their units.
    """
    if column == "via_points":
        return ", ".join(dict.fromkeys(unit_of(name, joints) for name in joints))
    return next((unit for end, unit in UNITS.items() if column.endswith(end)), "")


def description_of(column: str, table: str, joints: Sequence[str]) -> str:
    """Return a column's description; that of a key that the sweep varies if it is none of the table's own.

    Args:
        column: Name of the column.
        table: Name of the table in `TABLES`.
        joints: Names of the columns of x.
    """
    texts, axis = TABLES[table], column[-3:-2]
    if column in joints:
        return f"configuration x: joint {column.rpartition('_')[0]}"
    if column in parameters.start_columns(joints):
        return f"{texts['start']}: joint {column.removeprefix('start_').rpartition('_')[0]}"
    if column in texts:
        return texts[column]
    for name, key in (("tcp", "tcp"), ("target", "target_xyz"), ("shift", "shift")):
        if key in texts and column == f"{name}_{axis}_m":
            return f"{texts[key]}: {axis}"
    if table == "mountings":
        return f"{column}: a value of the mounting, or an objective; null if it is not defined"
    return f"value of the job's key {column} in this scenario, as JSON"
