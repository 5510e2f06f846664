"""Conversion of the rows of a task list to the planner's: a task for a robot, and its goals at every target.

Before the path's first point the goals are interpolated evenly from the start's values to those of the first point, as
the tool's position is. So the start always satisfies its goal.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.model.arm_features import point_of
from htcp_jax.model.robot import Robot, lengthen_tool
from htcp_jax.model.scenario import Scenario
from htcp_jax.model.task import Task
from htcp_jax.model.task_list import TaskRow
from htcp_jax.model.task_row_kind import PlacedPath, TaskRowKind
from htcp_jax.model.task_rows import AxisTowards, PointAlong, Row, TaskPoint
from htcp_jax.model.workpiece import Workpiece

ON_PATH = (TaskRow(point="tcp", on="path"),)  # the paper's, and the default
DRAWS, FLAT = 8, 1e-6  # configurations for a task's rank; relative tolerance of singular values


def task_of(rows: Sequence[TaskRowKind], robot: Robot, tolerance_m: float = 1e-3, tolerance_rad: float = 2e-3) -> Task:
    """Return the task of the given rows for a robot; without rows, the paper's.

    Args:
        rows: Rows of the task list.
        robot: The robot, whose sites and bodies the rows may name.
        tolerance_m: Tolerance of the norm of the error.
        tolerance_rad: Tolerance of angles in it.

    Raises:
        InputError: For a name that the robot lacks, for more equalities than joints, and for a row that repeats or
            contradicts those before it.
    """
    parts: list[Row] = []
    for k, row in enumerate(rows or ON_PATH, 1):
        try:
            parts.append(row.part(robot))
        except InputError as error:
            raise InputError(f"task.{k}: {error}") from None
    task = Task(tuple(parts), tolerance_m, tolerance_rad)
    task.freedom(robot)
    for k in range(2, len(parts) + 1):
        if _jacobian_rank(robot, rows[:k], Task(tuple(parts[:k]))) < sum(part.equalities for part in parts[:k]):
            raise InputError(f"task.{k} ({rows[k - 1]}) repeats or contradicts the rows before it")
    return task


def follower_position(rows: Sequence[TaskRowKind], robot: Robot, x: Float[np.ndarray, "N"]) -> Float[np.ndarray, "3"]:
    """Return the position [m] of the point that follows the path; the TCP if no row names one.

    Args:
        rows: Rows of the task list.
        robot: The robot.
        x: The configuration [rad or m].

    Returns:
        The position in the world.

    Raises:
        InputError: For a name that the robot lacks.
    """
    row = next((row for row in rows if isinstance(row, TaskRow) and row.on == "path"), ON_PATH[0])
    point = point_of(robot, row.point, row.offset_m)
    part = PointAlong(point.link, point.vector, 3)
    return np.asarray(_VALUE(robot, jnp.asarray(x), Task((part,))))


def with_goals(
    scenario: Scenario, rows: Sequence[TaskRowKind], task: Task, robot: Robot, workpiece: Workpiece
) -> Scenario:
    """Return the scenario with the rows' goals at all of its targets.

    Args:
        scenario: A scenario; its last targets are the path.
        rows: Rows of the task list; without any, the paper's task.
        task: The rows' task, see `task_of`.
        robot: The robot without the scenario's tool extension.
        workpiece: The scenario's workpiece.

    Raises:
        InputError: For a path without the frames that the rows require, and for axes that contradict each other.
    """
    rows = rows or ON_PATH
    if task.parts == (TaskPoint(),) and rows[0].on == "path":
        return scenario
    robot, targets = lengthen_tool(robot, float(scenario.tool_extension_m)), scenario.targets
    rotate, translate = scenario.T_world_workpiece[:3, :3], scenario.T_world_workpiece[:3, 3]
    before = len(targets) - len(workpiece.path)
    posed = PlacedPath(rotate, translate, targets[before:], workpiece)
    _check_frames(rows, workpiece)
    start = np.array(_VALUE(robot, jnp.asarray(scenario.x_start), task))
    share = np.linspace(0.0, 1.0, before) if before > 1 else np.full(before, float(scenario.auto_start))
    columns, v, follows = [], 0, False
    for row, part in zip(rows, task.parts, strict=True):
        size = part.size
        wanted = row.goals(part, posed)
        leads = row.on == "path" and not follows
        eased = part.eased(start[v : v + size], wanted[0], share, targets[:before] if leads else None)
        columns.append(np.concatenate([eased, wanted]))
        v, follows = v + size, follows or leads
    _check_axes(rows, task, columns, before)
    return replace(scenario, task_goals=np.concatenate(columns, axis=1))


def _jacobian_rank(robot: Robot, rows: Sequence[TaskRowKind], task: Task) -> int:
    """Return the rank of the equalities' Jacobian: the largest one at some random configurations and goals."""
    rng = np.random.default_rng(0)
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    found = 0
    for x in rng.uniform(lower, upper, (DRAWS, len(lower))):
        goal = np.concatenate([row.drawn(part, rng) for row, part in zip(rows, task.parts, strict=True)])
        size = np.linalg.svd(_JACOBIAN(robot, jnp.asarray(x), jnp.asarray(goal), task), compute_uv=False)
        found = max(found, int((size > FLAT * size.max(initial=0.0)).sum()))
    return found


_VALUE = jax.jit(lambda robot, x, task: task.value(robot, x), static_argnums=2)
_JACOBIAN = jax.jit(lambda robot, x, goal, task: task.linear_at(robot, x, goal).jacobian, static_argnums=3)


# Checks


def _check_frames(rows: Sequence[TaskRowKind], workpiece: Workpiece) -> None:
    for k, row in enumerate(rows, 1):
        if "rotations" in row.uses and workpiece.frames.rotations is None:
            raise InputError(f"task.{k} ({row}): the path has no orientations; its file needs columns qw,qx,qy,qz")
        if row.frame == "path":
            square = np.linalg.norm(np.cross(workpiece.tangents, workpiece.normals), axis=1)
            if len(flat := np.flatnonzero(square < 1e-6)):
                raise InputError(
                    f"task.{k} ({row}): tangent and normal are parallel at point {flat[0] + 1} of the path"
                )


def _check_axes(rows: Sequence[TaskRowKind], task: Task, goals: Sequence[np.ndarray], before: int) -> None:
    """Raise InputError if the required angle between two axes of one link differs from the actual one."""
    parts = enumerate(task.parts)
    axes = {k: part for k, part in parts if isinstance(part, AxisTowards) and part.looks_from_m is None}
    for k, i in ((k, i) for k in axes for i in axes if i < k and axes[i].link == axes[k].link):
        between = np.arccos(np.clip(np.dot(axes[i].axis, axes[k].axis), -1.0, 1.0))
        requested = np.arccos(np.clip((goals[i][before:, :3] * goals[k][before:, :3]).sum(axis=1), -1.0, 1.0))
        most = sum(goals[j][before:, 3] if axes[j].cone else task.tolerance_rad for j in (i, k))
        if len(far := np.flatnonzero(np.abs(requested - between) > most)):
            has, wants = np.rad2deg(between), np.rad2deg(requested[far[0]])
            raise InputError(
                f"task.{i + 1} ({rows[i]}) and task.{k + 1} ({rows[k]}) contradict each other at point {far[0] + 1} of "
                f"the path: {has:.4g} degrees between the axes, {wants:.4g} between their directions"
            )
