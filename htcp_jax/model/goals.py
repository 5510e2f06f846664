"""Conversion of the rows of a task list to the planner's: a task for a robot, and its goals at every target.

Before the path's first point the goals are interpolated evenly from the start's values to those of the first point, as
the tool's position is. So the start always satisfies its goal.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp

from htcp_jax.errors import InputError
from htcp_jax.model.robot import ArmFrame, Robot, lengthen_tool
from htcp_jax.model.rotations import least_turn
from htcp_jax.model.scenario import Scenario
from htcp_jax.model.task import Task
from htcp_jax.model.task_list import TaskRow
from htcp_jax.model.task_rows import AIM_RAD, AxisTowards, PointAlong, Row, TaskPoint, Turned
from htcp_jax.model.workpiece import Workpiece

ON_PATH = (TaskRow(point="tcp", on="path"),)  # the paper's, and the default
TCP = ArmFrame("tcp", None, (0.0, 0.0, 0.0), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
DRAWS, FLAT = 8, 1e-6  # configurations for a task's rank; relative tolerance of singular values
SLACK = 1e-6  # [rad]


class Posed(NamedTuple):
    """A workpiece's pose and its path in the world."""

    rotate: Float[np.ndarray, "3 3"]  # of the workpiece
    translate: Float[np.ndarray, "3"]  # [m]
    path: Float[np.ndarray, "T 3"]  # [m]
    workpiece: Workpiece


def task_of(rows: Sequence[TaskRow], robot: Robot, tolerance_m: float = 1e-3, tolerance_rad: float = 2e-3) -> Task:
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
            parts.append(_part(row, robot))
        except InputError as error:
            raise InputError(f"task.{k}: {error}") from None
    task = Task(tuple(parts), tolerance_m, tolerance_rad)
    task.freedom(robot)
    for k in range(2, len(parts) + 1):
        if _rank(robot, Task(tuple(parts[:k]))) < sum(part.equalities for part in parts[:k]):
            raise InputError(f"task.{k} ({rows[k - 1]}) asks for what the rows before it fix already, or the opposite")
    return task


def follower(rows: Sequence[TaskRow], robot: Robot, x: Float[np.ndarray, "N"]) -> Float[np.ndarray, "3"]:
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
    row = next((row for row in rows if row.on == "path"), ON_PATH[0])
    part = PointAlong(*_place(row, robot), 3)
    return np.asarray(_VALUE(robot, jnp.asarray(x), Task((part,))))


def with_goals(scenario: Scenario, rows: Sequence[TaskRow], task: Task, robot: Robot, workpiece: Workpiece) -> Scenario:
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
    posed = Posed(rotate, translate, targets[before:], workpiece)
    _check_frames(rows, workpiece)
    start = np.array(_VALUE(robot, jnp.asarray(scenario.x_start), task))
    share = np.linspace(0.0, 1.0, before) if before > 1 else np.full(before, float(scenario.auto_start))
    columns, v, follows = [], 0, False
    for row, part in zip(rows, task.parts, strict=True):
        size = sum(len(feature.rows) for feature in part.features)
        wanted = _wanted(row, part, posed)
        leads = row.on == "path" and not follows
        eased = _eased(part, start[v : v + size], wanted[0], share, targets[:before] if leads else None)
        columns.append(np.concatenate([eased, wanted]))
        v, follows = v + size, follows or leads
    _check_axes(rows, task, columns, before)
    return replace(scenario, goals=np.concatenate(columns, axis=1))


# Kinds of rows
def _part(row: TaskRow, robot: Robot) -> Row:
    if row.orientation is not None:
        frame = _frame(row.of, robot, "frame")
        return Turned(frame.link, frame.columns, cone=row.limit_deg is not None)
    if row.axis is not None:
        name, k, sign = row.axis_of
        frame = _frame(name, robot, "axis")
        axis = tuple(sign * value for value in frame.columns[k])
        looks_from = None if row.looks_at_m is None else frame.origin_m
        return AxisTowards(frame.link, axis, looks_from, cone=row.limit_deg is not None)
    link, offset = _place(row, robot)
    if row.on in ("plane", "line"):
        return PointAlong(link, offset, 1 if row.on == "plane" else 2, row.within_m is not None)
    of_world = (row.frame == "world" or row.axes == "xyz") and row.within_m is None  # xyz is the same in every frame
    if of_world and not (link is None and any(offset)):
        return TaskPoint(link, offset, tuple("xyz".index(axis) for axis in row.axes))
    return PointAlong(link, offset, len(row.axes), row.within_m is not None)


def _place(row: TaskRow, robot: Robot) -> tuple[int | None, tuple[float, float, float]]:
    """Return the link of a row's point and the point's position in its frame."""
    frame = _frame(row.point, robot, "point")
    place = np.array(frame.origin_m) + np.array(frame.columns).T @ np.array(row.offset_m)
    return frame.link, tuple(place.tolist())


def _frame(name: str, robot: Robot, what: str) -> ArmFrame:
    known = {frame.name: frame for frame in (*robot.frames, TCP)}
    if name not in known:
        raise InputError(f"no {what} {name!r} on {robot.name}; valid: {', '.join(sorted(known))}")
    return known[name]


def _rank(robot: Robot, task: Task) -> int:
    """Return the rank of the equalities' Jacobian: the largest one at some random configurations and goals."""
    rng = np.random.default_rng(0)
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    found = 0
    for x in rng.uniform(lower, upper, (DRAWS, len(lower))):
        goal = np.concatenate([_drawn(part, rng) for part in task.parts])
        size = np.linalg.svd(_JACOBIAN(robot, jnp.asarray(x), jnp.asarray(goal), task), compute_uv=False)
        found = max(found, int((size > FLAT * size.max(initial=0.0)).sum()))
    return found


def _drawn(part: Row, rng: np.random.Generator) -> np.ndarray:
    if isinstance(part, Turned):
        return np.append(Rotation.random(rng=rng).as_matrix().ravel(), np.ones(int(part.cone)))
    if isinstance(part, PointAlong):
        square = np.linalg.qr(rng.normal(size=(3, 3)))[0][: part.count]
        return np.append(np.column_stack([square, rng.normal(size=part.count)]).ravel(), np.ones(int(part.band)))
    drawn = rng.normal(size=part.numbers)
    return drawn / np.linalg.norm(drawn[:3]) if isinstance(part, AxisTowards) else drawn


_VALUE = jax.jit(lambda robot, x, task: task.value(robot, x), static_argnums=2)
_JACOBIAN = jax.jit(lambda robot, x, goal, task: task.linear_at(robot, x, goal).jacobian, static_argnums=3)


# Goals on the path
def _wanted(row: TaskRow, part: Row, posed: Posed) -> Float[np.ndarray, "T g"]:
    """Return the goals of one part at the points of the path."""
    count = len(posed.path)
    if isinstance(part, TaskPoint):
        return _places(row, posed)[:, list(part.axes)]
    if isinstance(part, PointAlong):
        across = _across(row, posed)
        offsets = np.einsum("tkj,tj->tk", across, _places(row, posed))
        rows = np.concatenate([across, offsets[:, :, None]], axis=2).reshape(count, -1)
        return np.column_stack([rows, np.full(count, row.within_m)]) if part.band else rows
    found = _rotations(row, posed).reshape(count, 9) if isinstance(part, Turned) else _directions(row, posed)
    return np.column_stack([found, np.full(count, np.deg2rad(row.limit_deg))]) if part.cone else found


def _places(row: TaskRow, posed: Posed) -> Float[np.ndarray, "T 3"]:
    if row.on == "path":
        return posed.path
    place = row.through_m if row.on in ("plane", "line") else row.on
    return np.tile(_in_world(row, np.array(place), posed, is_place=True), (len(posed.path), 1))


def _across(row: TaskRow, posed: Posed) -> Float[np.ndarray, "T k 3"]:
    """Return the directions in which a point is constrained."""
    count = len(posed.path)
    if row.on == "plane":
        normal = _in_world(row, np.array(row.normal), posed)
        return np.tile(normal / np.linalg.norm(normal), (count, 1, 1))
    if row.on == "line":
        along = _in_world(row, np.array(row.direction), posed)
        return np.tile(np.linalg.svd(along[None])[2][1:], (count, 1, 1))
    if row.frame == "path":
        x, z = (directions @ posed.rotate.T for directions in (posed.workpiece.tangents, posed.workpiece.normals))
        x = x - (x * z).sum(axis=1, keepdims=True) * z
        x = x / np.linalg.norm(x, axis=1, keepdims=True)
        axes = np.stack([x, np.cross(z, x), z], axis=1)
    else:
        axes = np.tile(posed.rotate.T if row.frame == "workpiece" else np.eye(3), (count, 1, 1))
    return axes[:, ["xyz".index(axis) for axis in row.axes]]


def _directions(row: TaskRow, posed: Posed) -> Float[np.ndarray, "T 3"]:
    """Return the required directions of an axis; for a row with looks_at_m, the place."""
    count = len(posed.path)
    if row.looks_at_m is not None:
        return np.tile(_in_world(row, np.array(row.looks_at_m), posed, is_place=True), (count, 1))
    if isinstance(row.towards, str):
        own = posed.workpiece.normals if row.towards.endswith("normal") else posed.workpiece.tangents
        return (-1.0 if row.towards.startswith("-") else 1.0) * own @ posed.rotate.T
    direction = _in_world(row, np.array(row.towards), posed)
    return np.tile(direction / np.linalg.norm(direction), (count, 1))


def _rotations(row: TaskRow, posed: Posed) -> Float[np.ndarray, "T 3 3"]:
    if row.orientation == "path":
        return posed.rotate @ posed.workpiece.frames.rotations
    own = Rotation.from_quat(row.orientation, scalar_first=True).as_matrix()
    return np.tile(posed.rotate @ own if row.frame == "workpiece" else own, (len(posed.path), 1, 1))


def _in_world(row: TaskRow, vector: np.ndarray, posed: Posed, is_place: bool = False) -> Float[np.ndarray, "3"]:
    if row.frame != "workpiece":
        return vector
    return posed.rotate @ vector + (posed.translate if is_place else 0.0)


# Goals before the path
def _eased(
    part: Row,
    start: Float[np.ndarray, "v"],
    first: Float[np.ndarray, "g"],
    share: Float[np.ndarray, "A"],
    places: Float[np.ndarray, "A 3"] | None,
) -> Float[np.ndarray, "A g"]:
    """Return the goals of one part before the path.

    Args:
        part: The part.
        start: Its features at the start.
        first: Its goal at the path's first point.
        share: Fraction of the interpolation at each target.
        places: Positions of the point that follows the path [m]; None for other parts.
    """
    goals = np.tile(first, (len(share), 1))
    if isinstance(part, TaskPoint):
        wanted = start + share[:, None] * (first - start)
        return wanted if places is None else places[:, list(part.axes)]
    if isinstance(part, PointAlong):
        across = first[: 4 * part.count].reshape(part.count, 4)
        at_start = across[:, :3] @ start
        eased = at_start + share[:, None] * (across[:, 3] - at_start)
        goals[:, 3 : 4 * part.count : 4] = eased if places is None else places @ across[:, :3].T
    elif part.cone:
        short = max(float(-part.room(jnp.asarray(start), jnp.asarray(first))[0]), 0.0)
        goals[:, -1] += (1.0 - share) * (short + 2 * AIM_RAD) + SLACK * (share < 1.0)
    elif isinstance(part, Turned):
        both = Rotation.from_matrix(np.stack([start.reshape(3, 3).T, first.reshape(3, 3)]))
        goals = Slerp([0.0, 1.0], both)(share).as_matrix().reshape(-1, 9)
    elif part.looks_from_m is not None:
        there = start[3:6] + np.linalg.norm(first - start[3:6]) * start[:3]
        goals = there + share[:, None] * (first - there)
    else:
        turn = least_turn(start[:3], first)
        goals = Rotation.from_rotvec(share[:, None] * turn).apply(np.array(start[:3]))
    return goals


# Checks


def _check_frames(rows: Sequence[TaskRow], workpiece: Workpiece) -> None:
    for k, row in enumerate(rows, 1):
        if "rotations" in row.uses and workpiece.frames.rotations is None:
            raise InputError(f"task.{k} ({row}): the path has no orientations; its file needs columns qw,qx,qy,qz")
        if row.frame == "path":
            square = np.linalg.norm(np.cross(workpiece.tangents, workpiece.normals), axis=1)
            if len(flat := np.flatnonzero(square < 1e-6)):
                raise InputError(
                    f"task.{k} ({row}): tangent and normal are parallel at point {flat[0] + 1} of the path"
                )


def _check_axes(rows: Sequence[TaskRow], task: Task, goals: Sequence[np.ndarray], before: int) -> None:
    """Raise InputError if the required angle between two axes of one link differs from the actual one."""
    parts = task.parts
    axes = [k for k, part in enumerate(parts) if isinstance(part, AxisTowards) and part.looks_from_m is None]
    for k, i in ((k, i) for k in axes for i in axes if i < k and parts[i].link == parts[k].link):
        between = np.arccos(np.clip(np.dot(parts[i].axis, parts[k].axis), -1.0, 1.0))
        asked = np.arccos(np.clip((goals[i][before:, :3] * goals[k][before:, :3]).sum(axis=1), -1.0, 1.0))
        most = sum(goals[j][before:, 3] if parts[j].cone else task.tolerance_rad for j in (i, k))
        if len(far := np.flatnonzero(np.abs(asked - between) > most)):
            has, wants = np.rad2deg(between), np.rad2deg(asked[far[0]])
            raise InputError(
                f"task.{i + 1} ({rows[i]}) and task.{k + 1} ({rows[k]}) contradict each other at point {far[0] + 1} of "
                f"the path: {has:.4g} degrees are between the axes, {wants:.4g} between what they are turned to"
            )
