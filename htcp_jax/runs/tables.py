"""The two tables of a run: conversion of plans to rows, and back.

`columns` describes their columns. The tables contain no run times: the same seed writes the same bytes.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io import files
from htcp_jax.jobs import grid_axes
from htcp_jax.model import Robot
from htcp_jax.motion import Plans, Tried, ViaPoints, dead_ends, motion, start_cause
from htcp_jax.motion import plans as plan_arrays
from htcp_jax.runs import parameters
from htcp_jax.status import Exclusion, SegmentStatus, Status

if TYPE_CHECKING:
    import pandas

STATUSES = {status.name: int(status) for status in Status}
SEGMENT_STATUSES: dict[str | None, int] = {None: int(SegmentStatus.NOT_CHECKED)} | {
    x.name: int(x) for x in SegmentStatus
}
EXCLUSIONS: dict[str | None, Exclusion] = {None: Exclusion.NONE} | {x.words: x for x in Exclusion if x}
XYZ = "xyz"
MANIPULABILITY = "manipulability_m_rad"
CAUSE = "colliding_body", "colliding_with", "cause"  # columns of scenarios that could not begin
SHARES = "via_shares"
TRIED = tuple(f"dead_end_{name}" for name in Tried._fields)  # the last one is a text
STEPS = "joint_step_max_rad", "joint_step_target", "joint_step_joint"

LEAST_CELLS = 1_000_000  # scenarios times targets that any file may expand to; or GROWTH times its rows


def joint_columns(robot: Robot) -> tuple[str, ...]:
    """Return the names of the columns of x."""
    units = ["m" if slides else "rad" for slides in robot.slides]
    return tuple(f"{name}_{unit}" for name, unit in zip(robot.joint_names, units, strict=True))


def target_table(
    method: str,
    numbers: np.ndarray,
    plans: Plans,
    joints: Sequence[str],
    manipulability: Float[np.ndarray, "S T"] | None = None,
) -> pa.Table:
    """Return the rows of existing targets.

    Args:
        method: Name of the method.
        numbers: Numbers of the scenarios (S,).
        plans: Their plans.
        joints: Names of the columns of x, see `joint_columns`.
        manipulability: At each target [m/rad]; None if unknown.
    """
    s, t = np.nonzero(plans.exists)
    status, path_clear = plans.status[s, t], plans.path_clear[s, t]
    columns = {
        "method": pa.array([method] * len(s), pa.string()),
        "scenario": pa.array(numbers[s], pa.int32()),
        "target": pa.array(t, pa.int32()),
        "tracked": pa.array(plans.tracked[s, t]),
        "status": pa.array([Status(code).name for code in status.tolist()], pa.string()),
        "clearance_m": _doubles(plans.clearance[s, t]),
        "residual_m": _doubles(plans.residual[s, t]),
        "orientation_error_rad": _doubles(plans.orientation_error[s, t]),
        "iterations": pa.array(plans.iterations[s, t], pa.int32()),
        "joint_step_rad": _doubles(plans.joint_step[s, t]),
        "path_clear": pa.array(path_clear == 1, pa.bool_(), mask=path_clear < 0),
        "segment_status": pa.array(
            [_segment_status_name(code) for code in plans.segment_status[s, t].tolist()], pa.string()
        ),
        "segment_clearance_m": _doubles(plans.segment_clearance[s, t]),
        "via_points": _via_point_column(plans, s, t, plans.via_points.on_segment),
        "recovery": pa.array(plans.recovery[s, t], pa.int8()),
    }
    columns |= {name: _doubles(plans.x[s, t, k]) for k, name in enumerate(joints)}
    columns |= {name: _doubles(plans.tcp[s, t, k]) for k, name in enumerate(_axes("tcp"))}
    columns |= {name: _doubles(plans.target[s, t, k]) for k, name in enumerate(_axes("target"))}
    columns[SHARES] = _via_point_column(plans, s, t, plans.via_points.shares_on)
    unknown = np.full(len(s), np.nan)
    columns[MANIPULABILITY] = _doubles(unknown if manipulability is None else manipulability[s, t])
    ends, tried = plans.dead_ends, np.full((*plans.exists.shape, len(TRIED)), -1)
    tried[ends.scenario, ends.target] = np.stack(ends[2:], axis=-1)
    *numbers, reasons = tried[s, t].T
    columns |= {name: pa.array(at, pa.int32(), mask=at < 0) for name, at in zip(TRIED[:-1], numbers, strict=True)}
    columns[TRIED[-1]] = pa.array([Exclusion(k).words if k > 0 else None for k in reasons.tolist()], pa.string())
    return pa.table(columns)


def scenario_table(
    method: str,
    points: Sequence[grid_axes.ScenarioPoint],
    plans: Plans,
    joints: Sequence[str],
    varied: Sequence[str] = (),
    causes: Mapping[int, start_cause.StartCause] = MappingProxyType({}),
) -> pa.Table:
    """Return the rows of scenarios, in the order of `points`.

    Args:
        method: Name of the method.
        points: The scenarios.
        plans: Their plans.
        joints: Names of the columns of x, see `joint_columns`.
        varied: Keys that vary and are no column of every run.
        causes: Reasons of scenarios that could not begin, by their place in `points`.
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
    """Return rows with nulls in the columns of `schema` that runs from older versions lack.

    Without shares the tool stays at the target before.
    """
    later = (MANIPULABILITY, SHARES, *TRIED, *STEPS, *CAUSE)
    new = [name for name in later if name in schema.names and name not in rows.column_names]
    if not new:
        return rows
    for name in new:
        rows = rows.append_column(name, pa.nulls(len(rows), schema.field(name).type))
    return rows.select(schema.names) if set(rows.column_names) == set(schema.names) else rows


def _end_columns(ends: plan_arrays.Outcomes) -> dict[str, pa.Array]:
    """Return the columns on completion: complete, the failed target, its status and the reason."""
    status = [Status(code) if code != plan_arrays.NO_TARGET else None for code in ends.status.tolist()]
    return {
        "complete": pa.array(ends.failed < 0),
        "failed_target": pa.array(ends.failed, pa.int32(), mask=ends.failed < 0),
        "failure": pa.array([each and each.name for each in status], pa.string()),
        "reason": pa.array([each and each.message for each in status], pa.string()),
    }


def _figures(points: Sequence[grid_axes.ScenarioPoint], plans: Plans) -> dict[str, pa.Array]:
    """Return the columns of `MotionFigures`."""
    found = motion.motion_figures(plans, np.array([point.config.on_path for point in points], int))
    columns = {name: _doubles(values) for name, values in found._asdict().items()}
    return columns | {"dwells": columns["dwells"].cast(pa.int32())}


def _joint_steps(points: Sequence[grid_axes.ScenarioPoint], plans: Plans, joints: Sequence[str]) -> dict[str, pa.Array]:
    """Return the columns of STEPS."""
    found = motion.largest_joint_steps(plans, np.array([point.config.on_path for point in points], int))
    names = [joints[k].rpartition("_")[0] if k >= 0 else None for k in found.joint.tolist()]
    target = pa.array(found.target, pa.int32(), mask=found.target < 0)
    return dict(zip(STEPS, (_doubles(found.step), target, pa.array(names, pa.string())), strict=True))


def empty_tables(joints: Sequence[str], varied: Sequence[str] = ()) -> dict[str, pa.Table]:
    """Return both tables without rows, for their schemas."""
    plans = Plans.empty(np.zeros((0, len(joints))), np.zeros((0, 1, 3)))
    return {
        "targets": target_table("", np.zeros(0, int), plans, joints),
        "scenarios": scenario_table("", (), plans, joints, varied),
    }


def plans_of(
    targets: pa.Table, scenarios: pa.Table, count: int, joints: Sequence[str], compile_s: float, run_s: float
) -> Plans:
    """Return the plans of scenarios 0 to `count` - 1 from one method's rows in both tables.

    Missing rows are as in `Plans.empty`, without targets.

    Args:
        targets: Rows of the method's targets.
        scenarios: Rows of its scenarios.
        count: Number of scenarios.
        joints: Names of the columns of x, see `joint_columns`.
        compile_s: For `Plans.compile_s`.
        run_s: For `Plans.run_s`.

    Raises:
        IndexError: For rows of other scenarios, and for too few rows for their numbers.
        KeyError: For unknown statuses, and for missing columns.
        ValueError: For values of other shapes.
    """
    s, t = targets["scenario"].to_numpy(), targets["target"].to_numpy()
    if min(s.min(initial=0), t.min(initial=0)) < 0 or t.max(initial=0) >= len(targets):
        raise IndexError("a row of no scenario or no target")
    if count * (int(t.max(initial=-1)) + 1) > max(LEAST_CELLS, files.GROWTH * len(targets)):
        raise IndexError(f"{len(targets):,} rows of {count:,} scenarios with {t.max() + 1:,} targets; too few to open")
    blank = np.full((count, int(t.max(initial=-1)) + 1, 3), plan_arrays.EMPTY["target"])
    plans = Plans.empty(_starts(scenarios, count, joints), blank, 0)._replace(compile_s=compile_s, run_s=run_s)
    for name in _READ:
        getattr(plans, name)[s, t] = _numpy(targets[_COLUMN.get(name, name)], plan_arrays.EMPTY[name])
    plans.segment_status[s, t] = [SEGMENT_STATUSES[name] for name in targets["segment_status"].to_pylist()]
    for array, names in ((plans.x, joints), (plans.tcp, _axes("tcp")), (plans.target, _axes("target"))):
        array[s, t] = np.stack([_numpy(targets[name], np.nan) for name in names], axis=1)
    lists = zip(s.tolist(), t.tolist(), *(targets[name].to_pylist() for name in ("via_points", SHARES)), strict=True)
    via_points = [_segment(*row, len(joints)) for row in lists if row[2]]
    ended = targets.filter(targets[TRIED[0]].is_valid())  # few of all rows
    rows = zip(*(ended[name].to_pylist() for name in ("scenario", "target", *TRIED)), strict=True)
    ends = {row[:2]: Tried(*(count or 0 for count in row[2:-1]), EXCLUSIONS[row[-1]]) for row in rows}
    return plans._replace(via_points=ViaPoints.of(via_points, len(joints)), dead_ends=dead_ends.DeadEnds.of(ends))


_READ = (
    *("clearance", "residual", "orientation_error", "status", "iterations", "joint_step", "recovery", "path_clear"),
    "segment_clearance",
)
_COLUMN = {
    "clearance": "clearance_m", "residual": "residual_m", "joint_step": "joint_step_rad",
    "orientation_error": "orientation_error_rad", "segment_clearance": "segment_clearance_m",
}  # fmt: skip


def _segment(scenario: int, target: int, x: list[float], share: list[float] | None, joints: int) -> tuple:
    """Return a segment of `ViaPoints.of`.

    Raises:
        ValueError: For another number of shares than of configurations.
    """
    found = np.reshape(x, (-1, joints))
    shares = np.zeros(len(found)) if share is None else np.array(share, float)
    if len(shares) != len(found):
        raise ValueError(f"{len(found)} via points with {len(shares)} shares")
    return scenario, target, found, shares


def _segment_status_name(code: int) -> str | None:
    return None if code == SegmentStatus.NOT_CHECKED else SegmentStatus(code).name


def _via_point_column(
    plans: Plans, s: np.ndarray, t: np.ndarray, on_segment: Callable[[int, int], np.ndarray]
) -> pa.Array:
    """Return a column of the via points on the segment to each row, flattened."""
    kind = pa.list_(pa.float64())
    if not len(plans.via_points.x):
        return pa.nulls(len(s), kind)
    lists = [on_segment(*row).ravel().tolist() or None for row in zip(s.tolist(), t.tolist(), strict=True)]
    return pa.array(lists, kind)


def _starts(scenarios: pa.Table, count: int, joints: Sequence[str]) -> np.ndarray:
    """Return the first configurations of the plans (count, N); NaN for scenarios without a plan."""
    start, rows = np.full((count, len(joints)), np.nan), scenarios["scenario"].to_numpy()
    if rows.min(initial=0) < 0:
        raise IndexError("a row of no scenario")
    start[rows] = np.stack([scenarios[name].to_numpy() for name in parameters.start_columns(joints)], axis=1)
    return start


def _axes(name: str) -> tuple[str, ...]:
    return tuple(f"{name}_{axis}_m" for axis in XYZ)


def table_frame(table: pa.Table) -> "pandas.DataFrame":
    """Return the table as a pandas frame; integers and booleans keep their type with nulls.

    Raises:
        InputError: Without pandas, which comes with the extra `notebooks`.
    """
    try:
        import pandas
    except ImportError:
        raise InputError("frames need pandas: pip install 'htcp_jax[notebooks]'") from None
    kinds = {pa.int8(): pandas.Int8Dtype(), pa.int32(): pandas.Int32Dtype(), pa.bool_(): pandas.BooleanDtype()}
    return table.to_pandas(types_mapper=kinds.get)


def _parameter_columns(
    points: Sequence[grid_axes.ScenarioPoint], start: np.ndarray, joints: Sequence[str]
) -> dict[str, pa.Array]:
    """Return the columns of varied parameters; start: first configurations of the plans (S, N)."""
    jobs = [point.config for point in points]
    given = parameters.columns([parameters.of_job(job) for job in jobs], start, joints)
    return {name: _doubles(values) for name, values in given.items()} | {
        "margin_m": _doubles([job.margin_m for job in jobs]),
        "path": pa.array([Path(job.workpiece.path).name for job in jobs], pa.string()),
    }


def _doubles(values) -> pa.Array:
    """Return doubles with NaN as null."""
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
