"""The two tables of a run: plans to rows, and rows back to plans.

`targets`: one row per method, scenario and target.

    method         string
    scenario       int32    its number: its place in the full grid
    target         int32    from 0, the start's own TCP
    tracked        bool
    status         string   name of a htcp_jax.status.Status
    clearance_m    double   D, smallest over capsules and points; null where not tracked, as is all that follows of x
    residual_m     double   |TCP - target|
    iterations     int32    step QPs solved for the target; 0 where a plan made backwards pushed it there
    joint_step_rad double   |x_t - x_{t-1}|
    path_clear     bool     straight joint path from the row before; null where unknown
    escape         int8     0 none, k: stage k of the method's escapes; one beyond its last: planned backwards from a
                            posture drawn at a later target, see `planner.backwards`
    <joint>_rad    double   configuration x, a column a joint (<joint>_m where it slides)
    tcp_x_m ...    double   tool centre point, world; three columns
    target_x_m ... double   where it should be, world; never null

`scenarios`: one row per method and scenario.

    method, scenario        as above
    group          string   of the sweep file; null where it has none
    targets        int32    that the scenario has
    tracked        int32    of them
    complete       bool     all of them
    failed_target  int32    the first that is not tracked; null where complete, as are the two that follow
    failure        string   its status
    reason         string   that status in words
    after_escape   int32    tracked targets that took an escape
    blocked_paths  int32    tracked targets whose joint path from the row before collides
    clearance_min_m, residual_max_m, joint_motion_rad    double, over the tracked targets
    start_<joint>_rad ..., rotation_x_rad, rotation_y_rad, rotation_z_rad    double
    shift_x_m ..., tool_extension_m, margin_m    double
    path           string   the tool path: "weld" or the name of its file
    robot.model, settings.alpha_rad ...    string   any other key in which the sweep's scenarios may differ, as JSON

Columns hold results alone, no times: the same seed writes the same bytes.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from htcp_jax.errors import InputError
from htcp_jax.jobs.grid_axes import Point
from htcp_jax.planner.plans import Plans, is_tracked
from htcp_jax.scene.robot import Robot
from htcp_jax.status import Status

if TYPE_CHECKING:
    import pandas

NO_TARGET = -1  # status in plans read back: a row beyond a scenario's last target, or not planned yet
STATUSES = {status.name: int(status) for status in Status}
XYZ = "xyz"


def joint_columns(robot: Robot) -> tuple[str, ...]:
    """The names of the columns of x."""
    units = ["m" if slides else "rad" for slides in robot.slides]
    return tuple(f"{name}_{unit}" for name, unit in zip(robot.joint_names, units, strict=True))


def target_table(method: str, numbers: np.ndarray, count: np.ndarray, plans: Plans, joints: Sequence[str]) -> pa.Table:
    """Rows of targets; `numbers` and `count` (S,) are the scenarios' numbers and how many targets each has."""
    s, t = np.nonzero(np.arange(plans.status.shape[1])[None, :] < count[:, None])
    status, path_clear = plans.status[s, t], plans.path_clear[s, t]
    columns = {
        "method": pa.array([method] * len(s), pa.string()),
        "scenario": pa.array(numbers[s], pa.int32()),
        "target": pa.array(t, pa.int32()),
        "tracked": pa.array(is_tracked(status)),
        "status": pa.array([Status(code).name for code in status.tolist()], pa.string()),
        "clearance_m": _doubles(plans.clearance[s, t]),
        "residual_m": _doubles(plans.residual[s, t]),
        "iterations": pa.array(plans.iterations[s, t], pa.int32()),
        "joint_step_rad": _doubles(plans.joint_step[s, t]),
        "path_clear": pa.array(path_clear == 1, pa.bool_(), mask=path_clear < 0),
        "escape": pa.array(plans.escape[s, t], pa.int8()),
    }
    columns |= {name: _doubles(plans.x[s, t, k]) for k, name in enumerate(joints)}
    columns |= {f"tcp_{axis}_m": _doubles(plans.tcp[s, t, k]) for k, axis in enumerate(XYZ)}
    columns |= {f"target_{axis}_m": _doubles(plans.target[s, t, k]) for k, axis in enumerate(XYZ)}
    return pa.table(columns)


def scenario_table(
    method: str,
    points: Sequence[Point],
    count: np.ndarray,
    plans: Plans,
    joints: Sequence[str],
    varied: Sequence[str] = (),
) -> pa.Table:
    """Rows of scenarios, in the order of `points`. count (S,): how many targets each has; varied: keys that vary and
    have no column of their own."""
    exists = np.arange(plans.status.shape[1])[None, :] < count[:, None]
    tracked = is_tracked(plans.status) & exists
    missed = exists & ~tracked
    failed, complete = missed.argmax(axis=1), ~missed.any(axis=1)
    failures = [
        None if done else Status(int(row[k])) for done, row, k in zip(complete, plans.status, failed, strict=True)
    ]
    columns = {
        "method": pa.array([method] * len(points), pa.string()),
        "scenario": pa.array([point.number for point in points], pa.int32()),
        "group": pa.array([point.group for point in points], pa.string()),
        "targets": pa.array(count, pa.int32()),
        "tracked": pa.array(tracked.sum(axis=1), pa.int32()),
        "complete": pa.array(complete),
        "failed_target": pa.array(failed, pa.int32(), mask=complete),
        "failure": pa.array([status and status.name for status in failures], pa.string()),
        "reason": pa.array([status and status.message for status in failures], pa.string()),
        "after_escape": pa.array(((plans.status == Status.TRACKED_AFTER_ESCAPE) & exists).sum(axis=1), pa.int32()),
        "blocked_paths": pa.array((tracked & (plans.path_clear == 0)).sum(axis=1), pa.int32()),
        "clearance_min_m": _extreme(np.min, plans.clearance, tracked, np.inf),
        "residual_max_m": _extreme(np.max, plans.residual, tracked, -np.inf),
        "joint_motion_rad": pa.array(np.where(tracked, plans.joint_step, 0.0).sum(axis=1)),
    }
    columns |= _parameters(points, joints)
    return pa.table(columns | {key: pa.array([point.varied[key] for point in points], pa.string()) for key in varied})


def empty_tables(joints: Sequence[str], varied: Sequence[str] = ()) -> dict[str, pa.Table]:
    """Both tables without rows, for their schemas."""
    shape, none = (0, 1), np.zeros(0, int)
    names = {"x": (len(joints),), "tcp": (3,), "target": (3,)}
    plans = Plans(**{name: np.zeros((*shape, *names.get(name, ())), int) for name in Plans._fields})
    return {
        "targets": target_table("", none, none, plans, joints),
        "scenarios": scenario_table("", (), none, plans, joints, varied),
    }


def plans_of(targets: pa.Table, scenarios: int, joints: Sequence[str], compile_s: float, run_s: float) -> Plans:
    """Plans of scenarios 0 to `scenarios` - 1 from one method's rows. Rows that the table lacks have the status
    NO_TARGET. Raises IndexError, KeyError or ValueError for rows of other scenarios and for unknown statuses."""
    s, t = targets["scenario"].to_numpy(), targets["target"].to_numpy()
    if min(s.min(initial=0), t.min(initial=0)) < 0 or t.max(initial=0) >= len(targets):
        raise IndexError("a row of no scenario or no target")
    shape = scenarios, int(t.max(initial=-1)) + 1

    def filled(names: str | Sequence[str], empty, dtype) -> np.ndarray:
        """One column as (S, T), several as (S, T, columns)."""
        single = isinstance(names, str)
        values = [_numpy(targets[name], empty) for name in ([names] if single else names)]
        table = np.full((*shape, len(values)), empty, dtype)
        table[s, t] = np.stack(values, axis=1)
        return table[..., 0] if single else table

    return Plans(
        x=filled(joints, np.nan, float),
        tcp=filled([f"tcp_{axis}_m" for axis in XYZ], np.nan, float),
        target=filled([f"target_{axis}_m" for axis in XYZ], np.nan, float),
        clearance=filled("clearance_m", np.nan, float),
        residual=filled("residual_m", np.nan, float),
        status=filled("status", NO_TARGET, np.int8),
        iterations=filled("iterations", 0, np.int32),
        joint_step=filled("joint_step_rad", np.nan, float),
        escape=filled("escape", 0, np.int8),
        path_clear=filled("path_clear", -1, np.int8),
        compile_s=compile_s,
        run_s=run_s,
    )


def frame_of(table: pa.Table) -> "pandas.DataFrame":
    """The table as a pandas frame; whole numbers and truths stay what they are where some are null.

    Raises InputError without pandas, which comes with the extra `notebooks`.
    """
    try:
        import pandas
    except ImportError:
        raise InputError("frames need pandas: pip install 'htcp_jax[notebooks]'") from None
    kinds = {pa.int8(): pandas.Int8Dtype(), pa.int32(): pandas.Int32Dtype(), pa.bool_(): pandas.BooleanDtype()}
    return table.to_pandas(types_mapper=kinds.get)


def _parameters(points: Sequence[Point], joints: Sequence[str]) -> dict[str, pa.Array]:
    """What a grid may vary, a column each."""
    jobs = [point.config for point in points]
    parts = [job.workpiece for job in jobs]
    columns = {f"start_{name}": _doubles([job.start_rad[k] for job in jobs]) for k, name in enumerate(joints)}
    columns |= {
        "rotation_x_rad": _doubles([part.rotation_x_rad for part in parts]),
        "rotation_y_rad": _doubles([part.rotation_y_rad for part in parts]),
        "rotation_z_rad": _doubles([part.rotation_z_rad for part in parts]),
    }
    columns |= {f"shift_{axis}_m": _doubles([part.shift_m[k] for part in parts]) for k, axis in enumerate(XYZ)}
    return columns | {
        "tool_extension_m": _doubles([job.robot.tool_extension_m for job in jobs]),
        "margin_m": _doubles([job.margin_m for job in jobs]),
        "path": pa.array([Path(part.path).name for part in parts], pa.string()),
    }


def _doubles(values) -> pa.Array:
    """Doubles with NaN as null."""
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
