"""Conversion of a job's task rows, `task_list.TaskRow`, to the planner's rows and their goals at every target."""

import numpy as np
import scipy
from jaxtyping import Float

from htcp_jax.model.arm_features import frame_of, point_of
from htcp_jax.model.built_in_rows import AxisTowards, FrameOrientation, PointAlong
from htcp_jax.model.robot import Robot
from htcp_jax.model.task_list import DIRECTIONS, TaskRow
from htcp_jax.model.task_row_kind import PlacedPath
from htcp_jax.model.task_rows import Row, TaskPoint


def row_of_task(row: TaskRow, robot: Robot) -> Row:
    """Return the planner's row for a row of a job's task.

    Raises:
        InputError: For a name that the robot lacks.
    """
    seen_from = robot.world if robot.part_moves and row.is_in_world else None
    if row.orientation is not None:
        frame = frame_of(robot, row.of)
        return FrameOrientation(frame.link, frame.columns, row.limit_deg is not None, seen_from)
    if row.axis is not None:
        if row.is_of_path:  # the same angle, written as a world direction that must point along the path's direction
            axis = np.array(row.towards) / np.linalg.norm(row.towards) @ np.array(robot.world.columns)
            return AxisTowards(robot.world.link, tuple(axis.tolist()), cone=row.limit_deg is not None)
        name, k, sign = row.axis_of
        frame = frame_of(robot, name, "axis")
        axis = tuple(sign * value for value in frame.columns[k])
        looks_from = None if row.looks_at_m is None else frame.origin_m
        return AxisTowards(frame.link, axis, looks_from, row.limit_deg is not None, seen_from)
    link, offset, *_ = point_of(robot, row.point, row.offset_m)
    if row.on in ("plane", "line"):
        return PointAlong(link, offset, 1 if row.on == "plane" else 2, row.within_m is not None)
    of_world = (row.frame == "world" or row.axes == "xyz") and row.within_m is None  # all frames are then equivalent
    if of_world and not (link is None and any(offset)):
        return TaskPoint(link, offset, tuple("xyz".index(axis) for axis in row.axes))
    return PointAlong(link, offset, len(row.axes), row.within_m is not None)


def goals_of_row(row: TaskRow, part: Row, posed: PlacedPath) -> Float[np.ndarray, "T g"]:
    """Return the goals of a task row at the T points of the path, in the format of `part`."""
    count = len(posed.path)
    if isinstance(part, TaskPoint):
        return _places(row, posed)[:, list(part.axes)]
    if isinstance(part, PointAlong):
        across = _across(row, posed)
        offsets = np.einsum("tkj,tj->tk", across, _places(row, posed))
        rows = np.concatenate([across, offsets[:, :, None]], axis=2).reshape(count, -1)
        return np.column_stack([rows, np.full(count, row.within_m)]) if part.band else rows
    found = _rotations(row, posed).reshape(count, 9) if isinstance(part, FrameOrientation) else _directions(row, posed)
    return np.column_stack([found, np.full(count, np.deg2rad(row.limit_deg))]) if part.inequalities else found


def _places(row: TaskRow, posed: PlacedPath) -> Float[np.ndarray, "T 3"]:
    if row.on == "path":
        return posed.path
    place = row.through_m if row.on in ("plane", "line") else row.on
    return np.tile(_in_world(row, np.array(place), posed, is_place=True), (len(posed.path), 1))


def _across(row: TaskRow, posed: PlacedPath) -> Float[np.ndarray, "T k 3"]:
    """Return the k directions in which a point is constrained, at the T points of the path."""
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


def _directions(row: TaskRow, posed: PlacedPath) -> Float[np.ndarray, "T 3"]:
    """Return the required directions of an axis in the world; for a row with looks_at_m, the place to point at [m]."""
    count = len(posed.path)
    if row.looks_at_m is not None:
        return np.tile(_in_world(row, np.array(row.looks_at_m), posed, is_place=True), (count, 1))
    if (name := row.axis if row.is_of_path else row.towards) in DIRECTIONS:
        own = posed.workpiece.normals if name.endswith("normal") else posed.workpiece.tangents
        return (-1.0 if name.startswith("-") else 1.0) * own @ posed.rotate.T
    direction = _in_world(row, np.array(row.towards), posed)
    return np.tile(direction / np.linalg.norm(direction), (count, 1))


def _rotations(row: TaskRow, posed: PlacedPath) -> Float[np.ndarray, "T 3 3"]:
    if row.orientation == "path":
        return posed.rotate @ posed.workpiece.frames.rotations
    own = scipy.spatial.transform.Rotation.from_quat(row.orientation, scalar_first=True).as_matrix()
    return np.tile(posed.rotate @ own if row.frame == "workpiece" else own, (len(posed.path), 1, 1))


def _in_world(row: TaskRow, vector: np.ndarray, posed: PlacedPath, is_place: bool = False) -> Float[np.ndarray, "3"]:
    if row.frame != "workpiece":
        return vector
    return posed.rotate @ vector + (posed.translate if is_place else 0.0)
