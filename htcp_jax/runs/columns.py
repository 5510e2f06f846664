"""Columns of all tables by key: heading, unit, format and description of each.

A column has the same heading, unit and format wherever it is shown: on the terminal, in the report and on the gate's
page. Its key consists of a quantity, a statistic and a unit: `clearance_min_mm` has the heading "clearance", with
"min mm" below. HEADINGS, COUNTED, UNIT_LINES and FORMATS contain what does not follow from the key. `of` selects
columns by key. `total`, `before_and_now` and `listed` return a column in the form that some tables need.

The columns of a run's Parquet files have descriptions, which `described` adds to the files' metadata. `TARGETS`
describes the table of targets, with one row per method, scenario and target. `SCENARIOS` describes the table of
scenarios (one row per method and scenario), `TIMING` the table of times (one row per scenario), and `MOUNTINGS` the
table of a placement search (one row per mounting), `SEGMENTS` the one of a proof
(one row per segment). Columns of joints, coordinates and varied keys have general descriptions.
"""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import pyarrow as pa

from htcp_jax.runs import parameters

WRITTEN_BY = b"htcp_jax"  # key of a file's metadata; its value is JSON with run, commit and versions
NOTHING, COUNT = "-", ",d"  # text of an unknown value; format of counts
FILE_UNITS = {  # in Parquet files, by the end of a column's name; longer ends come first
    "_rad_m2": "rad/m2", "_rad2": "rad2", "_m_s": "m/s", "_m_rad": "m/rad", "_rad": "rad", "_m": "m", "_s": "s",
    "_share": "1", "_deg": "deg",
}  # fmt: skip
UNITS = {"_mm_s": "mm/s", **FILE_UNITS, "_mm": "mm", "_ms": "ms", "_percent": "%"}
STATISTICS = "min", "q1", "mean", "median", "q3", "max", "low", "high"
HEADINGS = {  # of quantities, or of single columns
    "at": "scenario:",
    "begin_mm": "from",
    "better": "further",
    "beyond": "exceed it",
    "clearance_between": "clearance",
    "clearance_between_min_at": "scenario:",
    "clearance_less_cover": "less cover",
    "clearance_min_at": "scenario:",
    "clearance_off": "differs from plan",
    "command": "run by",
    "compile": "compiling",
    "complete_motions": "to the end",
    "complete_percent": "scenarios",
    "cost_common": "cost, common",
    "cpu_s": "processor",
    "cycle": "cycle time",
    "deepest": "worst on",
    "dwelling": "with dwells",
    "end_mm": "to",
    "feed": "lowest feed",
    "first_target": "first",
    "guaranteed": "guaranteed clearance",
    "held": "feed held",
    "last_target": "last",
    "line_deviation": "path deviation",
    "median_target": "median",
    "most": "allowed",
    "motion_end": "motion ends",
    "off": "error",
    "other": "compared with",
    "path_step": "joint step, on the path",
    "paths": "joint paths",
    "paths_blocked": "blocked",
    "paths_touching": "collide",
    "percent": "of all",
    "place": "at",
    "program_feed": "feed",
    "reached": "feed reached",
    "robot.model": "robot",
    "row": "row of the task",
    "run_s": "planning",
    "scenarios_blocked": "with a blocked step",
    "share": "of reachable",
    "short": "fall short",
    "speed_joint": "at",
    "speed_ratio": "joint speed",
    "step": "joint step, tracked",
    "step_ms": "time/target",
    "tcp_distance": "TCP distance",
    "tcp_error": "TCP error",
    "title": "name",
    "tracked_before": "tracked before it",
    "tracked_percent": "targets",
    "unit": "",
    "volume_ratio": "volume",
    "was": "before",
    "workpiece.cloud": "cloud",
    "worse": "earlier",
}
COUNTED = {  # columns of counts, by what they count
    "targets": ("tracked", "executable", "reachable", "not_excluded", "checked", "tracked_before", "after_recovery",
                "dwells"),
    "scenarios": ("complete", "complete_motions",
                  "more", "fewer", "equal", "short", "beyond", "scenarios_blocked",
                  "dwelling", "timed", "held", "worse", "better"),
    "steps": ("accepted", "blocked", "not_checked"),
    "in the plan": ("paths_blocked",),
    "": ("targets", "scenarios", "refuted", "paths", "paths_touching", "was", "now", "together", "planned"),
}  # fmt: skip
UNIT_LINES = {key: noun for noun, keys in COUNTED.items() for key in keys} | {
    **dict.fromkeys(("velocity_percent", "acceleration_percent", "jerk_percent", "torque_percent"), "max %"),
    **dict.fromkeys(("at", "clearance_min_at", "clearance_between_min_at"), "target"),
    **dict.fromkeys(("first_target", "median_target", "last_target"), "target"),
    **dict.fromkeys(("percent", "share"), "%"),
    "complete_percent": "complete %",
    "cost_common_rad2": "mean rad2",
    "off": "max",
    "speed_ratio_max": "of limit",
    "tracked_percent": "tracked %",
    "volume_ratio": "x hull",
}
FORMATS = {  # by unit, or of single columns; columns without a format contain text, which is aligned left
    **{"%": ".2f", "ms": ".2f", "s": ".2f", "mm/s": ".2f", "mm": ".3g", "deg": ".3g", "rad": ".3g", "rad2": ".3g"},
    **{"rad/m2": ",.0f", "m/rad": ".3f"},
    **dict.fromkeys((key for keys in COUNTED.values() for key in keys), COUNT),
    **dict.fromkeys(("scenario", "target", "waypoint", "first_target", "last_target", "rank", "own", "fitted"), "d"),
    **dict.fromkeys(("begin_mm", "end_mm", "volume_ratio", "percent", "share"), ".2f"),
    **dict.fromkeys(("cycle_mean_s", "speed_ratio_max"), ".3f"),
    **dict.fromkeys(("excess_mm", "outside_mm"), ".1f"),
    **dict.fromkeys(("off", "most", "tcp_error_max_mm"), ".4g"),
    "difference": "+,d",
    "median_target": ".0f",
    "place_percent": ".0f",
    "place_s": ".4g",
    "p": ".2g",
}

BOTH = {
    "method": "planning method",
    "scenario": "number of the scenario in the full grid",
    "tracked": "True if the target is tracked; in scenarios/: number of tracked targets",
}
TARGETS = BOTH | {
    "target": "number of the target; 0 is the start's TCP",
    "status": "name of a htcp_jax.status.Status",
    "clearance_m": "D, minimum clearance of all bodies; null if not tracked, as all values that depend on x",
    "residual_m": "distance of the TCP from the target",
    "orientation_error_rad": "largest angle from the task's orientations; null if the task has none",
    "iterations": "number of step QPs for the target; 0 if a backward plan needed none",
    "joint_step_rad": "|x_t - x_{t-1}|; for target 0, from the start",
    "path_clear": "True if the straight joint path from the previous row is clear; null if unknown",
    "segment_status": "htcp_jax.status.SegmentStatus of the segment from the previous row; null if not checked",
    "segment_clearance_m": "guaranteed clearance along this segment; null if not proven",
    "via_points": "configurations within this segment, concatenated; null for a straight joint path",
    "via_shares": "share of the segment at each via point; null for a straight joint path",
    "recovery": "0: none; k: recovery strategy k of the method; the number after the last: planned backwards",
    "manipulability_m_rad": "smallest singular value of the task's Jacobian, see motion.manipulability",
    "work_angle_deg": "work angle of the tool on the path; null if the task has no row tool_axis",
    "travel_angle_deg": "travel angle of the tool on the path; null if the task has no row tool_axis",
    "spin_deg": "spin of the tool on the path; null if the task has no row tool_axis",
    "dead_end_searches": "number of backward searches after a dead end at the target; null without one",
    "dead_end_configurations": "number of configurations sampled, extended or moved after the dead end",
    "dead_end_found": "number of clear configurations found at the target",
    "dead_end_connected": "number of these that a proven motion connects",
    "dead_end_wider": "number of forward searches from an earlier target, with a wider beam",
    "dead_end_excluded": "proven reason why no configuration is clear there: out of reach, tool, wrist, arm",
    "tcp": "position of the TCP in the world",
    "target_xyz": "position of the target in the world; never null",
}
SCENARIOS = BOTH | {
    "group": "group in the sweep file; null without groups",
    "targets": "number of targets",
    "executable": "number of targets to which a proven motion leads from the start",
    "complete": "True if all targets are tracked",
    "failed_target": "first target that is not tracked; null if complete",
    "failure": "status of the failed target; null if complete",
    "reason": "description of this status",
    "after_recovery": "number of targets tracked after a recovery",
    "blocked_paths": "number of tracked targets whose straight joint path from the previous row collides",
    "dwells": "number of targets of the executable motion at which the arm changes its configuration",
    "motion_cost_rad2": "cost of the executable motion, equation (3)",
    "path_step_max_rad": "largest joint step of the executable motion on the path",
    "curvature_max_rad_m2": "largest curvature of the executable joint path",
    "segment_clearance_min_m": "guaranteed clearance of the executable motion",
    "clearance_min_m": "minimum clearance at the tracked targets",
    "residual_max_m": "largest distance of the TCP from a tracked target",
    "joint_motion_rad": "sum of the joint steps between tracked targets",
    "rotation_x_rad": "rotation of the workpiece about world x, applied first",
    "rotation_y_rad": "rotation of the workpiece about world y",
    "rotation_z_rad": "rotation of the workpiece about world z",
    "shift": "translation of the workpiece along the world's axes",
    "tool_extension_m": "extension of the tool along its own z axis",
    "margin_m": "required clearance at a target",
    "path": "tool path: a seam of the duct, or the name of its file",
    "joint_step_max_rad": "largest travel of a joint (prismatic: m) between two targets of the executable path",
    "joint_step_target": "target at the end of the segment with this travel",
    "joint_step_joint": "joint with this travel",
    "start": "first configuration of the plan",
    "colliding_body": "body that collides, if no start was possible; null if none does",
    "colliding_with": "obstacle with which this body collides",
    "cause": "reason why no start was possible",
}
TIMING = {
    "scenario": BOTH["scenario"],
    "feed_m_s": "required feed",
    "cycle_time_s": "time from home over the path and back; null, as all below, if the motion ends early",
    "path_time_s": "part of the cycle time on the path, including dwells",
    "feed_held_share": "share of the path's length on which the feed is kept within 1 %",
    "feed_reached_m_s": "minimum feed between the path's run-up and its run-down; 0 if the arm stops there",
    "feed_reason": "cause of this minimum: stop, or the limit and its joint; null if the feed is kept",
    "feed_target": "target to which the motion leads at this minimum; null if the feed is kept",
    "velocity_share": "largest used share of the velocity limits on the path",
    "velocity_joint": "joint with that share",
    "acceleration_share": "largest used share of the acceleration limits on the path",
    "acceleration_joint": "joint with that share",
    "jerk_share": "largest used share of the jerk limits on the path",
    "jerk_joint": "joint with that share",
    "torque_share": "largest used share of the effort limits, on the complete motion; null if unknown",
    "torque_joint": "joint with that share",
}
MOUNTINGS = {
    "round": "round of the search that evaluated the mounting",
    "done": "mean over all paths of the share of targets to which a proven motion leads",
    "complete": "True if all targets are tracked",
    "lost": "reason why the mounting fails; null if it is complete",
}
SEGMENTS = {
    "segment": "number of the segment, from 0; it leads from one configuration of the file to the next",
    "line_begin": "line, row, point or key of the file with the configuration at which the segment begins",
    "line_end": "that of the configuration at which it ends",
    "kind": "kind of the motion to the segment's end, in files of this package; null if unknown",
    "begin_s": "time at its begin; null if the file has no times",
    "end_s": "time at its end",
    "verdict": "VALID, IN_COLLISION, BELOW_MARGIN, UNDECIDED; NOT_CHECKED in a file that has only poses",
    "cause": "of an undecided segment: TRACKING, CORNER, SUBDIVISION, MESH_POINTS; null for others",
    "clearance_m": "guaranteed clearance on all of the segment; null if it is not proven, or without obstacles",
    "place_share": "place at which the segment is refuted or undecided, from 0 at its begin to 1; null if proven",
    "deepest_share": "place of the deepest contact that was found; null, as all below, if none was searched",
    "body": "body of the robot at the deepest contact",
    "other": "obstacle, or other body of the robot, at the deepest contact",
    "depth_m": "depth of the deepest contact; below 0: distance at the nearest place that was found",
    "queries": "intervals that were checked",
}
TABLES = {"targets": TARGETS, "scenarios": SCENARIOS, "timing": TIMING, "mountings": MOUNTINGS, "segments": SEGMENTS}

# The only rules for values that are not finite: a value may be missing (null, or NaN in arrays) in the rows and columns
# that are not listed here. Infinity is never valid. `finite` applies these rules to all tables that are read.
ALWAYS, TRACKED, PROVEN = "in every row", "where a target is tracked", "where the segment is proven"
NEEDED = {  # rows in which a column must have a value
    "targets": dict.fromkeys((*BOTH, "target", "status", "iterations", "recovery", "target_xyz"), ALWAYS)
    | dict.fromkeys(("clearance_m", "residual_m", "joint_step_rad", "tcp", "x"), TRACKED)
    | {"segment_clearance_m": PROVEN},
    "scenarios": dict.fromkeys((*BOTH, "targets", "executable", "complete", "after_recovery", "blocked_paths"), ALWAYS)
    | dict.fromkeys((*parameters.ROTATIONS, "shift", parameters.TOOL, "margin_m", "path", "start"), ALWAYS)
    | dict.fromkeys(("clearance_min_m", "residual_max_m", "joint_motion_rad"), TRACKED),
    "timing": {"scenario": ALWAYS},
    "mountings": dict.fromkeys(("round", "done", "complete"), ALWAYS),
    "segments": dict.fromkeys(("segment", "line_begin", "line_end", "verdict", "queries"), ALWAYS),
}


class Column(NamedTuple):
    """Column of a table."""

    key: str  # name in CSV and JSON, including the unit
    heading: str
    unit: str = ""  # line below the heading: statistic and unit, or what is counted
    format: str = ""  # format of numbers; empty for a column of text, which is aligned left
    quiet: bool = False  # True for reference values, displayed in grey

    @property
    def title(self) -> str:
        """Heading with the unit, such as "clearance [min mm]"."""
        return f"{self.heading} [{self.unit}]" if self.unit else self.heading

    def text(self, value: Any) -> str:
        """Return a cell's value as text; a dash if it is unknown."""
        if unknown(value):
            return NOTHING
        return str(value) if isinstance(value, str) else format(value, self.format)


def unknown(value: Any) -> bool:
    """Return True if a cell's value is None or NaN."""
    return value is None or (isinstance(value, float) and math.isnan(value))


def column(key: str) -> Column:
    """Return the column with this key. A key with the prefix `paper_` is the paper's value of the column before it."""
    stem, unit = split_unit(key)
    quantity, _, statistic = stem.rpartition("_")
    if statistic not in STATISTICS:
        quantity, statistic = stem, ""
    of_paper = key.startswith("paper_")
    heading = "paper" if of_paper else HEADINGS.get(key, HEADINGS.get(quantity, quantity.replace("_", " ")))
    below = UNIT_LINES.get(key, f"{statistic} {unit}".strip())
    return Column(key, heading, below, FORMATS.get(key, FORMATS.get(unit, "")), of_paper)


def of(*keys: str | Column) -> tuple[Column, ...]:
    """Return the columns with these keys; a `Column` stands for itself."""
    return tuple(column(key) if isinstance(key, str) else key for key in keys)


def total(key: str) -> Column:
    """Return the column of a total, with the heading "of": it stands next to the column of which it is the total."""
    return column(key)._replace(heading="of", unit="")


def listed(key: str, noun: str) -> Column:
    """Return the column of a text that lists several values of a column, each with its number of `noun` in brackets."""
    return column(key)._replace(unit=f"({noun})", format="")


def before_and_now(*keys: str) -> tuple[Column, ...]:
    """Return two columns for each key of a comparison: the former value, whose key has the prefix `was_`, and the new.

    Both have the heading of the key's column.
    """
    pairs = []
    for now in of(*keys):
        unit = "" if now.format == COUNT else f" {now.unit}"
        pairs += [now._replace(key=f"was_{now.key}", unit=f"before{unit}"), now._replace(unit=f"now{unit}")]
    return tuple(pairs)


def split_unit(name: str) -> tuple[str, str]:
    """Return the stem and the unit of a column's name; the unit is "" if the name has none."""
    found = ((name.removesuffix(end), unit) for end, unit in UNITS.items() if name.endswith(end))
    return next(found, (name, ""))


def needed_in(column: str, table: str, joints: Sequence[str]) -> str | None:
    """Return the rows in which a column must have a value: ALWAYS, TRACKED or PROVEN; None if it may always be missing.

    Args:
        column: Name of the column.
        table: Name of the table in `TABLES`.
        joints: Names of the columns of x.
    """
    if column in joints or (table == "targets" and column.startswith("q_")):
        key = "x"
    elif column in parameters.start_columns(joints):
        key = "start"
    else:
        stem = column[:-4] if column.endswith(("_x_m", "_y_m", "_z_m")) else column
        key = "target_xyz" if stem == "target" != column else stem
    return NEEDED[table].get(key)


def described(rows: pa.Table, table: str, joints: Sequence[str], made: Mapping[str, Any]) -> pa.Table:
    """Return a table with metadata: the unit and description of each column, and the file's origin.

    Args:
        rows: The table.
        table: Its name in `TABLES`.
        joints: Names of the columns of the configuration x, see `tables.joint_columns`.
        made: The file's origin: run, commit and versions, as values for JSON.
    """
    fields = []
    for field in rows.schema:
        about = {"unit": unit_of(field.name, joints), "description": description_of(field.name, table, joints)}
        fields.append(field.with_metadata({name: text for name, text in about.items() if text}))
    return rows.cast(pa.schema(fields, {WRITTEN_BY: json.dumps(made)}))


def unit_of(column: str, joints: Sequence[str]) -> str:
    """Return the unit of a column from the end of its name; "" if the name has no unit.

    Args:
        column: Name of the column.
        joints: Names of the columns of x; they determine the units of the column of via points.
    """
    if column == "via_points":
        return ", ".join(dict.fromkeys(unit_of(name, joints) for name in joints))
    return next((unit for end, unit in FILE_UNITS.items() if column.endswith(end)), "")


def description_of(column: str, table: str, joints: Sequence[str]) -> str:
    """Return the description of a column; an unknown column is described as a varied key of the job.

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
    if table == "targets" and column.startswith("q_"):
        while (column := column.removeprefix("q_")) in joints:  # see `tables.follower_columns`
            pass
        return f"joint {column.rpartition('_')[0]}, which follows another joint; derived from the configuration x"
    for name, key in (("tcp", "tcp"), ("target", "target_xyz"), ("shift", "shift")):
        if key in texts and column == f"{name}_{axis}_m":
            return f"{texts[key]}: {axis}"
    if table == "mountings":
        return f"{column}: a value of the mounting, or an objective; null if it is not defined"
    return f"value of the job's key {column} in this scenario, as JSON"
