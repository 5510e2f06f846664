"""Conversion of plans to the rows of a run's two tables, of targets and of scenarios, and back.

The module `columns` describes the columns. The tables contain no run times, so that equal plans give equal files.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from htcp_jax.errors import InputError, install_command
from htcp_jax.io import arrays
from htcp_jax.jobs import grid_axes
from htcp_jax.model import Robot
from htcp_jax.motion import DeadEnds, Plans, Tried, ViaPoints, motion, start_cause
from htcp_jax.motion import plans as plan_arrays
from htcp_jax.runs import parameters
from htcp_jax.spec import TOOL_ANGLES
from htcp_jax.status import Exclusion, SegmentStatus, Status

if TYPE_CHECKING:
    import pandas

STATUSES = {status.name: int(status) for status in Status}
SEGMENT_STATUSES: dict[str | None, int] = {None: int(SegmentStatus.NOT_CHECKED)} | {
    x.name: int(x) for x in SegmentStatus
}
EXCLUSIONS: dict[str | None, Exclusion] = {None: Exclusion.NONE} | {x.words: x for x in Exclusion if x}
XYZ = "xyz"
FOLLOWER = "q_"  # start of the name of a column of a joint that follows another one
MANIPULABILITY = "manipulability_m_rad"
CAUSE = "colliding_body", "colliding_with", "cause"  # columns with the reason why a scenario could not begin
SHARES = "via_shares"
TRIED = tuple(f"dead_end_{name}" for name in Tried._fields)  # columns on dead ends; the last one is a text
STEPS = "joint_step_max_rad", "joint_step_target", "joint_step_joint"

LEAST_CELLS = 1_000_000  # scenarios times targets that any file may have; more only up to GROWTH times its rows


def joint_columns(robot: Robot) -> tuple[str, ...]:
    """Return the names of the columns of the configuration x, one per joint."""
    return _with_units(robot.joint_names, robot.sliding)


def follower_columns(robot: Robot, x: Float[np.ndarray, "*S N"]) -> dict[str, Float[np.ndarray, "*S"]]:
    """Return the columns of the joints that follow others, by name, at configurations x [rad or m].

    A name starts with `FOLLOWER`, more than once if a coordinate's column has the name already.
    """
    if robot.coupling is None:
        return {}
    own, which = robot.coupling, list(robot.followers)
    names = _with_units([own.joint_names[j] for j in which], [robot.slides[j] for j in which])
    taken = joint_columns(robot)

    def free(name: str) -> str:
        return free(FOLLOWER + name) if FOLLOWER + name in taken else FOLLOWER + name

    return {free(name): own.positions(x)[..., j] for j, name in zip(which, names, strict=True)}


def _with_units(names: Sequence[str], slides: Sequence[bool]) -> tuple[str, ...]:
    return tuple(f"{name}_{'m' if each else 'rad'}" for name, each in zip(names, slides, strict=True))


def target_table(
    method: str,
    numbers: np.ndarray,
    plans: Plans,
    joints: Sequence[str],
    manipulability: Float[np.ndarray, "S T"] | None = None,
    followers: Mapping[str, Float[np.ndarray, "S T"]] = MappingProxyType({}),
    angles: Float[np.ndarray, "S T 3"] | None = None,
) -> pa.Table:
    """Return the table of targets for one method, with one row per scenario and target.

    Args:
        method: Name of the method.
        numbers: Numbers of the scenarios (S,).
        plans: Plans of the scenarios.
        joints: Names of the columns of x, see `joint_columns`.
        manipulability: Manipulability at each target [m/rad]; None if unknown.
        followers: Columns of joints that follow others, see `follower_columns`.
        angles: Work angle, travel angle and spin of the tool at each target [degrees]; None if unknown.
    """
    s, t = np.nonzero(plans.exists)
    status, path_clear = plans.status[s, t], plans.path_clear[s, t]
    columns = {
        "method": pa.repeat(pa.scalar(method, pa.string()), len(s)),
        "scenario": pa.array(numbers[s], pa.int32()),
        "target": pa.array(t, pa.int32()),
        "tracked": pa.array(plans.tracked[s, t]),
        "status": _names(status, {int(code): code.name for code in Status}),
        "clearance_m": _doubles(plans.clearance[s, t]),
        "residual_m": _doubles(plans.residual[s, t]),
        "orientation_error_rad": _doubles(plans.orientation_error[s, t]),
        "iterations": pa.array(plans.iterations[s, t], pa.int32()),
        "joint_step_rad": _doubles(plans.joint_step[s, t]),
        "path_clear": pa.array(path_clear == 1, pa.bool_(), mask=path_clear < 0),
        # NOT_CHECKED is null
        "segment_status": _names(
            plans.segment_status[s, t], {code: name for name, code in reversed(SEGMENT_STATUSES.items())}
        ),
        "segment_clearance_m": _doubles(plans.segment_clearance[s, t]),
        "via_points": _via_point_column(plans.via_points, s, t, plans.via_points.x),
        "recovery": pa.array(plans.recovery[s, t], pa.int8()),
    }
    columns |= {name: _doubles(plans.x[s, t, k]) for k, name in enumerate(joints)}
    columns |= {name: _doubles(values[s, t]) for name, values in followers.items()}
    columns |= {name: _doubles(plans.tcp[s, t, k]) for k, name in enumerate(_axes("tcp"))}
    columns |= {name: _doubles(plans.target[s, t, k]) for k, name in enumerate(_axes("target"))}
    columns[SHARES] = _via_point_column(plans.via_points, s, t, plans.via_points.share[:, None])
    unknown = np.full(plans.exists.shape, np.nan)
    columns[MANIPULABILITY] = _doubles((unknown if manipulability is None else manipulability)[s, t])
    leans = (unknown,) * len(TOOL_ANGLES) if angles is None else np.moveaxis(angles, 2, 0)
    columns |= {name: _doubles(values[s, t]) for name, values in zip(TOOL_ANGLES, leans, strict=True)}
    ends, tried = plans.dead_ends, np.full((*plans.exists.shape, len(TRIED)), -1)
    tried[ends.scenario, ends.target] = np.stack(ends[2:], axis=-1)
    *numbers, reasons = tried[s, t].T
    columns |= {name: pa.array(at, pa.int32(), mask=at < 0) for name, at in zip(TRIED[:-1], numbers, strict=True)}
    columns[TRIED[-1]] = _names(reasons, {-1: None} | {int(reason): name for name, reason in EXCLUSIONS.items()})
    return pa.table(columns)


def scenario_table(
    method: str,
    points: Sequence[grid_axes.ScenarioPoint],
    plans: Plans,
    joints: Sequence[str],
    varied: Sequence[str] = (),
    causes: Mapping[int, start_cause.StartCause] = MappingProxyType({}),
) -> pa.Table:
    """Return the table of scenarios for one method, with one row for each of `points`.

    Args:
        method: Name of the method.
        points: The scenarios.
        plans: Plans of the scenarios.
        joints: Names of the columns of x, see `joint_columns`.
        varied: Varied keys that become additional columns, see `grid_axes.varied_keys`.
        causes: Reasons why scenarios could not begin, by index in `points`.
    """
    tracked, ends = plans.tracked, plans.outcomes
    columns = {
        "method": pa.array([method] * len(points), pa.string()),
        "scenario": pa.array([point.number for point in points], pa.int32()),
        "group": pa.array([point.group for point in points], pa.string()),
        "targets": pa.array(ends.targets, pa.int32()),
        "tracked": pa.array(ends.tracked, pa.int32()),
        "executable": pa.array(ends.executable, pa.int32()),
        **_end_columns(ends),
        "after_recovery": pa.array((plans.status == Status.TRACKED_AFTER_RECOVERY).sum(axis=1), pa.int32()),
        "blocked_paths": pa.array(ends.blocked_paths, pa.int32()),
        **_figures(points, plans),
        "clearance_min_m": _extreme(np.min, plans.clearance, tracked, np.inf),
        "residual_max_m": _extreme(np.max, plans.residual, tracked, -np.inf),
        "joint_motion_rad": pa.array(np.where(tracked, plans.joint_step, 0.0).sum(axis=1)),
    }
    columns |= _parameter_columns(points, plans.start, joints)
    columns |= {key: pa.array([point.varied[key] for point in points], pa.string()) for key in varied}
    columns |= _joint_steps(points, plans, joints)
    found = [causes.get(row) for row in range(len(points))]
    texts = [(each.body, each.other, each.description) if each else (None,) * len(CAUSE) for each in found]
    return pa.table(columns | {name: pa.array([t[k] for t in texts], pa.string()) for k, name in enumerate(CAUSE)})


def with_new_columns(rows: pa.Table, schema: pa.Schema) -> pa.Table:
    """Return a table with the columns of `schema` that are missing in runs from older versions; their values are null.

    If the shares of via points are null, the tool stays at the previous target during the via points.
    """
    later = (MANIPULABILITY, SHARES, *TOOL_ANGLES, *TRIED, *STEPS, *CAUSE)
    new = [name for name in later if name in schema.names and name not in rows.column_names]
    if not new:
        return rows
    for name in new:
        rows = rows.append_column(name, pa.nulls(len(rows), schema.field(name).type))
    return rows.select(schema.names) if set(rows.column_names) == set(schema.names) else rows


def _end_columns(ends: plan_arrays.Outcomes) -> dict[str, pa.Array]:
    """Return the columns complete, failed_target, failure and reason."""
    status = [Status(code) if code != plan_arrays.NO_TARGET else None for code in ends.status.tolist()]
    return {
        "complete": pa.array(ends.failed < 0),
        "failed_target": pa.array(ends.failed, pa.int32(), mask=ends.failed < 0),
        "failure": pa.array([each and each.name for each in status], pa.string()),
        "reason": pa.array([each and each.message for each in status], pa.string()),
    }


def _figures(points: Sequence[grid_axes.ScenarioPoint], plans: Plans) -> dict[str, pa.Array]:
    """Return the columns that contain the fields of `MotionFigures`."""
    found = motion.motion_figures(plans, np.array([point.config.on_path for point in points], int))
    columns = {name: _doubles(values) for name, values in found._asdict().items()}
    return columns | {"dwells": columns["dwells"].cast(pa.int32())}


def _joint_steps(points: Sequence[grid_axes.ScenarioPoint], plans: Plans, joints: Sequence[str]) -> dict[str, pa.Array]:
    """Return the columns in STEPS, which describe the largest travel of a joint between two targets."""
    found = motion.largest_joint_steps(plans, np.array([point.config.on_path for point in points], int))
    names = [joints[k].rpartition("_")[0] if k >= 0 else None for k in found.joint.tolist()]
    target = pa.array(found.target, pa.int32(), mask=found.target < 0)
    return dict(zip(STEPS, (_doubles(found.step), target, pa.array(names, pa.string())), strict=True))


def empty_tables(joints: Sequence[str], varied: Sequence[str] = ()) -> dict[str, pa.Table]:
    """Return the tables of targets and of scenarios without rows, by name; they serve as schemas."""
    plans = Plans.empty(np.zeros((0, len(joints))), np.zeros((0, 1, 3)))
    return {
        "targets": target_table("", np.zeros(0, int), plans, joints),
        "scenarios": scenario_table("", (), plans, joints, varied),
    }


def plans_of(
    targets: pa.Table, scenarios: pa.Table, count: int, joints: Sequence[str], seconds: Mapping[str, float]
) -> Plans:
    """Return the plans of scenarios 0 to `count` - 1 from one method's rows in both tables.

    A scenario without rows has no targets, as in `Plans.empty`.

    Args:
        targets: Rows of the method in the table of targets.
        scenarios: Rows of the method in the table of scenarios.
        count: Number of scenarios.
        joints: Names of the columns of x, see `joint_columns`.
        seconds: Times of the method, by field of `Plans` [s].

    Raises:
        IndexError: If a row has an invalid scenario or target, or if there are too few rows for these numbers.
        KeyError: If a status is unknown, or if a column is missing.
        ValueError: If a value has the wrong shape.
    """
    s, t = targets["scenario"].to_numpy(), targets["target"].to_numpy()
    if min(s.min(initial=0), t.min(initial=0)) < 0 or t.max(initial=0) >= len(targets):
        raise IndexError("a row has an invalid number of a scenario or a target; the file is damaged")
    if reason := sparse(count, int(t.max(initial=-1)) + 1, len(targets)):
        raise IndexError(reason)
    blank = np.full((count, int(t.max(initial=-1)) + 1, 3), plan_arrays.EMPTY["target"])
    plans = Plans.empty(_starts(scenarios, count, joints), blank, 0)._replace(**seconds)
    for name, column in READ.items():
        getattr(plans, name)[s, t] = _numpy(targets[column], plan_arrays.EMPTY[name])
    plans.segment_status[s, t] = [SEGMENT_STATUSES[name] for name in targets["segment_status"].to_pylist()]
    for array, names in ((plans.x, joints), (plans.tcp, _axes("tcp")), (plans.target, _axes("target"))):
        array[s, t] = np.stack([_numpy(targets[name], np.nan) for name in names], axis=1)
    lists = zip(s.tolist(), t.tolist(), *(targets[name].to_pylist() for name in ("via_points", SHARES)), strict=True)
    via_points = [_segment(*row, len(joints)) for row in lists if row[2]]
    ended = targets.filter(targets[TRIED[0]].is_valid())  # a small part of all rows
    rows = zip(*(ended[name].to_pylist() for name in ("scenario", "target", *TRIED)), strict=True)
    ends = {row[:2]: Tried(*(count or 0 for count in row[2:-1]), EXCLUSIONS[row[-1]]) for row in rows}
    return plans._replace(via_points=ViaPoints.of(via_points, len(joints)), dead_ends=DeadEnds.of(ends))


def sparse(scenarios: int, targets: int, rows: int) -> str | None:
    """Return the reason why arrays would be mostly empty, as text; None if they may be made.

    Args:
        scenarios: Number of scenarios in the arrays.
        targets: Number of targets in the arrays.
        rows: Number of rows in the table of targets.
    """
    if scenarios * targets <= max(LEAST_CELLS, arrays.GROWTH * rows):
        return None
    return f"{rows:,} rows are too few for {scenarios:,} scenarios with {targets:,} targets"


READ = {  # arrays of `Plans` that are read as they are, with their columns
    "clearance": "clearance_m", "residual": "residual_m", "orientation_error": "orientation_error_rad",
    "status": "status", "iterations": "iterations", "joint_step": "joint_step_rad", "recovery": "recovery",
    "path_clear": "path_clear", "segment_clearance": "segment_clearance_m",
}  # fmt: skip


def _segment(scenario: int, target: int, x: list[float], share: list[float] | None, joints: int) -> tuple:
    """Return the via points of one segment, as an argument for `ViaPoints.of`.

    Args:
        scenario: Row of the scenario.
        target: Target at the end of the segment.
        x: Values of the column via_points.
        share: Values of the column via_shares; None: all 0.
        joints: Number of joints.

    Raises:
        ValueError: If the number of shares differs from the number of via points.
    """
    found = np.array(x, float).reshape(-1, joints)
    shares = np.zeros(len(found)) if share is None else np.array(share, float)
    if len(shares) != len(found):
        raise ValueError(f"{len(found)} via points with {len(shares)} shares")
    return scenario, target, found, shares


def _names(codes: np.ndarray, names: Mapping[int, str | None]) -> pa.Array:
    """Return the names of codes; null if a code's name is None."""
    known = sorted(names)
    place = pa.array(np.searchsorted(known, codes), pa.int32())
    return pa.DictionaryArray.from_arrays(place, pa.array([names[code] for code in known], pa.string())).cast(
        pa.string()
    )


def _via_point_column(
    via_points: ViaPoints, s: np.ndarray, t: np.ndarray, values: Float[np.ndarray, "n k"]
) -> pa.Array:
    """Return a column with one list per row, of values at the via points on the segment to this row; null for none.

    Args:
        via_points: The via points.
        s: Scenario of each row; the rows are sorted by scenario and target, and have all segments with via points.
        t: Target of each row.
        values: Values at each via point, which are flattened.
    """
    kind = pa.list_(pa.float64())
    if not len(values):
        return pa.nulls(len(s), kind)
    counts = via_points.counts(s, t)
    ends = pa.array(np.append(0, np.cumsum(counts) * values.shape[1]), pa.int32())
    return pa.ListArray.from_arrays(ends, pa.array(values.ravel()), mask=pa.array(counts == 0))


def _starts(scenarios: pa.Table, count: int, joints: Sequence[str]) -> np.ndarray:
    """Return the first configuration of each plan (count, N); NaN for scenarios without a plan."""
    start, rows = np.full((count, len(joints)), np.nan), scenarios["scenario"].to_numpy()
    if rows.min(initial=0) < 0:
        raise IndexError("a row has an invalid number of a scenario; the file is damaged")
    start[rows] = np.stack([scenarios[name].to_numpy() for name in parameters.start_columns(joints)], axis=1)
    return start


def _axes(name: str) -> tuple[str, ...]:
    return tuple(f"{name}_{axis}_m" for axis in XYZ)


def table_frame(table: pa.Table) -> "pandas.DataFrame":
    """Return a table as a pandas frame. Columns of integers and booleans keep their type even if they contain nulls.

    Raises:
        InputError: If pandas is not installed.
    """
    try:
        import pandas
    except ImportError:
        raise InputError(f"frames need pandas: {install_command('notebooks')}") from None
    kinds = {pa.int8(): pandas.Int8Dtype(), pa.int32(): pandas.Int32Dtype(), pa.bool_(): pandas.BooleanDtype()}
    return table.to_pandas(types_mapper=kinds.get)


def _parameter_columns(
    points: Sequence[grid_axes.ScenarioPoint], start: np.ndarray, joints: Sequence[str]
) -> dict[str, pa.Array]:
    """Return the columns of parameters: start, pose, tool extension, margin and path; `start` has the shape (S, N)."""
    jobs = [point.config for point in points]
    given = parameters.columns([parameters.of_job(job) for job in jobs], start, joints)
    return {name: _doubles(values) for name, values in given.items()} | {
        "margin_m": _doubles([job.margin_m for job in jobs]),
        "path": pa.array([Path(job.workpiece.path).name for job in jobs], pa.string()),
    }


def _doubles(values) -> pa.Array:
    """Return an array of doubles in which NaN is null."""
    return pa.array(np.asarray(values, float), from_pandas=True)


def _extreme(reduce, values: np.ndarray, tracked: np.ndarray, neutral: float) -> pa.Array:
    found = reduce(np.where(tracked, values, neutral), axis=1, initial=neutral)
    return pa.array(found, mask=~tracked.any(axis=1))


def _numpy(column: pa.ChunkedArray, empty) -> np.ndarray:
    if pa.types.is_string(column.type):
        return np.array([STATUSES[name] for name in column.to_pylist()])
    if pa.types.is_boolean(column.type):
        column = column.cast(pa.int8())
    return column.fill_null(empty).to_numpy()
