"""Independent check of a task's rows, in numpy with poses from MuJoCo: deviation and tolerance of each row.

The code is independent of the planner's implementation of the rows.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import singledispatch
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from htcp_jax.settings import Settings
from htcp_jax.spec import (
    TCP_ON_PATH,
    AxisRow,
    BuiltInRow,
    OrientationRow,
    PlanConfig,
    PointRow,
    TaskRowKind,
    ToolAxisRow,
    path_row,
    with_arrays,
)
from htcp_jax.validation.mujoco_arm import MujocoArm
from htcp_jax.validation.result import ROUNDING_M
from htcp_jax.validation.scene_rules import WorkpieceData
from htcp_jax.validation.tool_angle_check import PathAxes, angle_deviations, path_axes


class RowCheck(NamedTuple):
    """Deviation from one row of the task at n points of the path, and its tolerance, in metres or degrees."""

    row: TaskRowKind  # where seams have their own tasks, the row of the first point
    off: Float[np.ndarray, "n"] | None  # deviation; None if the row's kind has no independent check
    most: Float[np.ndarray, "n"]  # infinite at points whose task lacks the row
    number: int = 1  # of the row in its task, counted from 1

    @property
    def key(self) -> tuple[int, type]:
        """Number and class of the row; checks with the same key are of one row, with other values at each point."""
        return self.number, type(self.row)

    @property
    def label(self) -> str:
        """The row's number and its text, such as "task.2 (axis tcp.z)"."""
        return f"task.{self.number} ({self.row})"

    def reason(self, k: int) -> str | None:
        """Return a sentence on the row's violation at the k-th point; None if the row is satisfied."""
        if self.off is None or self.off[k] <= self.most[k] + ROUNDING_M:
            return None
        off, most = self.factor * self.off[k], self.factor * self.most[k]
        return f"{self.label} deviates by {off:.5g} {self.unit}, {most:.4g} are allowed"

    @property
    def unit(self) -> str:
        """Unit in which the deviation is displayed: mm or degrees."""
        return "degrees" if self.row.angular else "mm"

    @property
    def factor(self) -> float:
        """Factor from the deviation to `unit`."""
        return 1.0 if self.row.angular else 1e3

    @property
    def unchecked(self) -> bool:
        """True if the row's kind has no independent check."""
        return self.off is None


class Between(NamedTuple):
    """Places between points of a path, whose directions are interpolated."""

    frames: Float[np.ndarray, "n 3 3"]  # orientations of the path's frame, in the part
    ends: tuple[Int[np.ndarray, "n"], Int[np.ndarray, "n"]]  # points before and after
    share: Float[np.ndarray, "n"]  # 0 at the point before, 1 at the point after
    workpiece: WorkpieceData  # with the points


class PartPose(NamedTuple):
    """Pose of the part, and indices of n points on its path."""

    rotate: Float[np.ndarray, "3 3"]  # from the workpiece frame to the world
    translate: Float[np.ndarray, "3"]  # [m]
    workpiece: WorkpieceData
    point: Int[np.ndarray, "n"]
    between: Between | None = None  # if the places are between points of the path

    @property
    def frames(self) -> Float[np.ndarray, "n 3 3"]:
        """Orientations of the path's frame in the world at the points: x along the tangent, z along the normal."""
        own = path_frames(self.workpiece) if self.between is None else self.between.frames
        return self.rotate @ own[self.point]

    def axes(self, row: ToolAxisRow) -> PathAxes:
        """Return the directions from which a row's angles are measured."""
        if self.between is None or row.plate is None:
            plates = None if row.plate is None else self.workpiece.plates[self.point] @ self.rotate.T
            return path_axes(row, self.frames, plates)
        frames, plates = path_frames(self.between.workpiece), self.between.workpiece.plates
        a, b = (path_axes(row, frames[end[self.point]], plates[end[self.point]]) for end in self.between.ends)
        share = self.between.share[self.point]
        return PathAxes(self.frames, (1 - share) * a.zero + share * b.zero, b.sense)

    def world(self, row: PointRow | AxisRow, vector: Sequence[float], is_place: bool = False) -> Float[np.ndarray, "3"]:
        """Return a position or direction that a row contains as numbers, transformed to the world.

        Args:
            row: The row, which determines the frame of the numbers.
            vector: The position [m] or direction.
            is_place: True for a position.
        """
        if row.frame != "workpiece":
            return np.array(vector)
        return self.rotate @ np.array(vector) + (self.translate if is_place else 0.0)


class PosedArm(NamedTuple):
    """An arm in n configurations."""

    arm: MujocoArm
    x: Float[np.ndarray, "n N"]  # [rad or m]

    def frames(self, name: str) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"]]:
        """Return the origins [m] and rotations of a frame."""
        return self.arm.frames(self.x, name)

    def from_world(self, value: Float[np.ndarray, "*v"]) -> Float[np.ndarray, "n *v"]:
        """Return a direction or an orientation that is fixed in the workshop, for each configuration."""
        if self.arm.root:
            return self.frames("world")[1] @ value
        return np.tile(value, (len(self.x), *[1] * value.ndim))


def part_between(
    rows: Sequence[TaskRowKind],
    rotate: Float[np.ndarray, "3 3"],
    translate: Float[np.ndarray, "3"],
    workpiece: WorkpieceData,
    point: Int[np.ndarray, "n"],
    share: Float[np.ndarray, "n"],
) -> PartPose:
    """Return the part's pose with n points between points of its path; normals and tangents are interpolated.

    Args:
        rows: Rows of the task; only directions used by a row are interpolated.
        rotate: Rotation from the workpiece frame to the world.
        translate: Translation from the workpiece frame to the world [m].
        workpiece: The part.
        point: Index of the path's point at the end of each segment.
        share: Position on the segment: 0 at the previous point, 1 at `point`.
    """
    before = point - 1 + (share == 1.0)  # at a point of the path, the point's values are used without rounding errors
    after = np.where(share == 0.0, before, point)

    def turned(table: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "n 3"]:
        a, b = table[before], table[after]
        square, cosine = np.cross(a, b), (a * b).sum(axis=1)
        sine = np.linalg.norm(square, axis=1)
        turn = square * (np.arctan2(sine, cosine) / np.maximum(sine, 1e-12))[:, None]
        return Rotation.from_rotvec(share[:, None] * turn).apply(a) if len(a) else a

    uses = {name for row in rows for name in row.uses}
    rotations = workpiece.rotations
    if "rotations" in uses and len(point):
        both = Rotation.from_matrix(rotations[after] @ np.swapaxes(rotations[before], 1, 2)).as_rotvec()
        rotations = Rotation.from_rotvec(share[:, None] * both).as_matrix() @ rotations[before]
    between = None
    if {"normals", "tangents"} <= uses and len(point):
        frames = path_frames(workpiece)
        both = Rotation.from_matrix(frames[after] @ np.swapaxes(frames[before], 1, 2)).as_rotvec()
        frames = Rotation.from_rotvec(share[:, None] * both).as_matrix() @ frames[before]
        between = Between(frames, (before, after), share, workpiece)
    a, b = workpiece.path[before], workpiece.path[after]
    own = replace(
        workpiece,
        path=a + share[:, None] * (b - a),
        given_normals=turned(workpiece.normals) if "normals" in uses else None,
        given_tangents=turned(workpiece.tangents) if "tangents" in uses else None,
        rotations=rotations,
    )
    return PartPose(rotate, translate, own, np.arange(len(point)), between)


def path_frames(workpiece: WorkpieceData) -> Float[np.ndarray, "T 3 3"]:
    """Return the orientations of the path's frame in the part: x along the tangent, z along the normal."""
    x, z = workpiece.tangents, workpiece.normals
    y = np.cross(z, x)
    y = y / np.linalg.norm(y, axis=1, keepdims=True)
    return np.stack([np.cross(y, z), y, z], axis=2)


def tasks_at(
    job: PlanConfig, workpiece: WorkpieceData, point: Int[np.ndarray, "n"]
) -> Iterator[tuple[Sequence[TaskRowKind], Int[np.ndarray, "k"]]]:
    """Yield the rows of each task, and the positions in `point` of those points of the path that it applies to.

    Args:
        job: The job.
        workpiece: The part.
        point: Indices of points of the path.
    """
    if not any(seam.task for seam in job.workpiece.seams):
        yield job.task, np.arange(len(point))
        return
    number = np.searchsorted(workpiece.seam_begins, point, "right")
    for seam in np.unique(number).tolist():
        yield job.tasks[seam], np.flatnonzero(number == seam)


def joined_rows(parts: Sequence[tuple[list[RowCheck], Int[np.ndarray, "k"]]], count: int) -> list[RowCheck]:
    """Return the checks of the rows of several tasks at all points, from those at the points of each task.

    Args:
        parts: The checks of each task's rows, and the positions of its points.
        count: Number of all points.
    """
    if len(parts) == 1:
        return parts[0][0]
    found = dict[tuple[int, type], RowCheck]()
    for rows, which in parts:
        for row in rows:
            first = RowCheck(row.row, np.zeros(count), np.full(count, np.inf), row.number)
            whole = found.setdefault(row.key, first)
            whole.most[which] = row.most
            if row.off is None or whole.off is None:
                found[row.key] = whole._replace(off=None)
            else:
                whole.off[which] = row.off
    return list(found.values())


def check_rows(
    rows: Sequence[TaskRowKind],
    arm: MujocoArm,
    x: Float[np.ndarray, "n N"],
    place: PartPose,
    tolerance_m: float,
    tolerance_rad: float,
) -> list[RowCheck]:
    """Return the check of every row at configurations on the path.

    Args:
        rows: Rows of the task; if empty, the TCP must be on the path.
        arm: The arm.
        x: Configurations [rad or m].
        place: The part's pose, and the point of the path for each configuration.
        tolerance_m: Tolerance of position rows without a tolerance of their own [m].
        tolerance_rad: Tolerance of direction rows without a tolerance of their own [rad].
    """
    posed, most_deg = PosedArm(arm, x), float(np.rad2deg(tolerance_rad))
    return [
        _check_row(row, posed, place, tolerance_m, most_deg)._replace(number=number)
        for number, row in enumerate(rows or (TCP_ON_PATH,), 1)
    ]


def hold_between(
    rows: Sequence[TaskRowKind],
    arm: MujocoArm,
    x: Float[np.ndarray, "n N"],
    before: PartPose,
    here: PartPose,
    settings: Settings,
) -> Bool[np.ndarray, "R n"]:
    """Return a mask of rows by configurations, True where a row is satisfied between two points of the path.

    There a row's requirement lies between its requirements at both points. Rows that constrain the TCP to the path are
    True, because `from_line` checks them. For other positions of the TCP the tolerance is `tube_m`.

    Args:
        rows: Rows of the task.
        arm: The arm.
        x: Configurations on the segments [rad or m].
        before: The part's pose, and the point of the path before each configuration.
        here: The part's pose, and the point of the path after each configuration.
        settings: Settings with the tolerances.
    """
    masks = [_holds_between(row, PosedArm(arm, x), (before, here), settings) for row in rows]
    return np.array(masks, bool).reshape(len(rows), len(x))


def path_follower(rows: Sequence[TaskRowKind], arm: MujocoArm, x: Float[np.ndarray, "n N"]) -> Float[np.ndarray, "n 3"]:
    """Return the position of the point that follows the path, world [m]; the TCP if no row defines one.

    Args:
        rows: Rows of the task.
        arm: The arm.
        x: Configurations [rad or m].
    """
    return _point(path_row(rows) or TCP_ON_PATH, PosedArm(arm, x))


def holds_tcp(rows: Sequence[TaskRowKind]) -> bool:
    """Return True if a row of the task constrains the TCP to the path in all directions."""
    return not rows or any(isinstance(row, PointRow) and replace(row, frame="world") == TCP_ON_PATH for row in rows)


def follows_all(rows: Sequence[TaskRowKind]) -> bool:
    """Return True if the point that follows the path is constrained exactly and in all directions."""
    row = path_row(rows or (TCP_ON_PATH,))
    return row is not None and row.axes == "xyz" and row.within_m is None


def _check_row(row: TaskRowKind, arm: PosedArm, place: PartPose, most_m: float, most_deg: float) -> RowCheck:
    if isinstance(row, ToolAxisRow):
        exact, outside = np.rad2deg(angle_deviations(row, arm.frames(row.axis_of[0])[1], place.axes(row)))
        return RowCheck(row, np.where(outside > 0, outside + most_deg, exact), np.full(len(arm.x), most_deg))
    off, limit = _deviation(row, arm, place), row.limit if isinstance(row, BuiltInRow) else None
    off = np.rad2deg(off) if row.angular and off is not None else off
    return RowCheck(row, off, np.full(len(arm.x), limit or (most_deg if row.angular else most_m)))


@singledispatch
def _deviation(row: TaskRowKind, arm: PosedArm, *places: PartPose) -> Float[np.ndarray, "n"] | None:
    """Return the deviation from a row [m or rad]; None without a check.

    The method `deviation` of a class of another package computes it. Between two targets the result is the smallest
    deviation from three goals: at both targets, and halfway between them.
    """
    given = [_along_path(row, place) for place in places]
    if len(given) == 2:
        given.append({name: 0.5 * (given[0][name] + given[1][name]) for name in row.along})
    found = np.full(len(arm.x), np.inf)
    for values in given if row.along else given[:1]:
        own = with_arrays(row)
        vars(own).update(values)
        if (off := own.deviation(arm.frames)) is None:
            return None
        found = np.minimum(found, off)
    return found


@_deviation.register
def _point_deviation(row: PointRow, arm: PosedArm, place: PartPose) -> Float[np.ndarray, "n"]:
    off = _off_place(row, _point(row, arm), place)
    return np.linalg.norm(off, axis=1) if row.within_m is None else np.abs(off).max(axis=1)


@_deviation.register
def _turn_deviation(row: AxisRow | OrientationRow, arm: PosedArm, place: PartPose) -> Float[np.ndarray, "n"]:
    return _angle(_actual(row, arm), _required(row, arm, place))


@singledispatch
def _holds_between(
    row: TaskRowKind, arm: PosedArm, places: tuple[PartPose, PartPose], settings: Settings
) -> Bool[np.ndarray, "n"]:
    most = settings.tolerance_rad if row.angular else settings.tolerance_m
    off = _deviation(row, arm, *places)
    return np.ones(len(arm.x), bool) if off is None else off <= most + ROUNDING_M


@_holds_between.register
def _point_holds_between(
    row: PointRow, arm: PosedArm, places: tuple[PartPose, PartPose], settings: Settings
) -> Bool[np.ndarray, "n"]:
    if replace(row, on="path", frame="world") != TCP_ON_PATH or row.is_on_surface:
        point, most = _point(row, arm), (row.within_m or 0.0) + settings.tolerance_m + ROUNDING_M
        off = [_off_place(row, point, place) for place in places]
        return ((np.minimum(*off) <= most) & (np.maximum(*off) >= -most)).all(axis=1)
    if row.follows_path:
        return np.ones(len(arm.x), bool)
    return _deviation(row, arm, places[1]) <= settings.tube_m + ROUNDING_M


@_holds_between.register
def _turn_holds_between(
    row: AxisRow | OrientationRow, arm: PosedArm, places: tuple[PartPose, PartPose], settings: Settings
) -> Bool[np.ndarray, "n"]:
    """Return a mask, True where an axis or a frame is oriented as required at an end or in the middle of a segment.

    In the middle, the tolerance is at least half of the rotation between the ends. A position at which an axis points
    is fixed along the segment.
    """
    limit, tolerance = np.deg2rad(row.limit or 0.0), settings.tolerance_rad + ROUNDING_M
    now, a, b = _actual(row, arm), *(_required(row, arm, place) for place in places)
    good = (_angle(now, a) <= limit + tolerance) | (_angle(now, b) <= limit + tolerance)
    return good | (_angle(now, _middle(a, b)) <= np.maximum(limit, 0.5 * _angle(a, b)) + tolerance)


@_holds_between.register
def _angles_hold_between(
    row: ToolAxisRow, arm: PosedArm, places: tuple[PartPose, PartPose], settings: Settings
) -> Bool[np.ndarray, "n"]:
    """Return a mask, True where the angles are as required at an end or in the middle of a segment.

    In the middle, each angle may deviate from its centre by half of the rotation between the ends.
    """
    a, b = (place.axes(row) for place in places)
    turn, still = _angle(a.frames, b.frames) + np.abs(b.zero - a.zero), np.zeros(len(arm.x))
    middle = PathAxes(_middle(a.frames, b.frames), 0.5 * (a.zero + b.zero), a.sense)
    most = settings.tolerance_rad + ROUNDING_M
    rotation = arm.frames(row.axis_of[0])[1]
    off = [
        angle_deviations(row, rotation, *each).max(axis=0) for each in ((a, still), (b, still), (middle, 0.5 * turn))
    ]
    return np.min(off, axis=0) <= most


def _along_path(row: TaskRowKind, place: PartPose) -> dict[str, Float[np.ndarray, "n 3"]]:
    """Return those of the path's points, tangents and normals that a row uses, in the world, by name."""
    own, named = place.workpiece, {"place": "path", "tangent": "tangents", "normal": "normals"}
    return {
        name: getattr(own, named[name])[place.point] @ place.rotate.T + (place.translate if name == "place" else 0.0)
        for name in row.along
    }


def _point(row: PointRow, arm: PosedArm) -> Float[np.ndarray, "n 3"]:
    origin, rotation = arm.frames(row.point)
    return origin + rotation @ np.array(row.offset_m)


def _off_place(row: PointRow, point: np.ndarray, place: PartPose) -> Float[np.ndarray, "n k"]:
    """Return the deviation of a point from its required position in the k constrained directions [m]."""
    if row.on == "plane":
        normal = place.world(row, row.normal) / np.linalg.norm(row.normal)
        return ((point - place.world(row, row.through_m, True)) @ normal)[:, None]
    if row.on == "line":
        along = place.world(row, row.direction) / np.linalg.norm(row.direction)
        off = point - place.world(row, row.through_m, True)
        return off @ np.linalg.svd(along[None])[2][1:].T
    if row.on == "path":
        off = point - (place.workpiece.path[place.point] @ place.rotate.T + place.translate)
    else:
        off = point - place.world(row, row.on, True)
    if row.frame == "path":
        off = np.einsum("nji,nj->ni", place.frames, off)
    elif row.frame == "workpiece":
        off = off @ place.rotate
    return off[:, ["xyz".index(letter) for letter in row.axes]]


@singledispatch
def _actual(row: AxisRow, arm: PosedArm) -> Float[np.ndarray, "n 3"]:
    """Return the direction of an axis, or the orientations of a frame as rotation matrices.

    For the path's normal or tangent, it is the direction in the world, which the path's must match.
    """
    if row.is_of_path:
        return arm.from_world(np.array(row.towards))
    name, k, sign = row.axis_of
    return sign * arm.frames(name)[1][:, :, k]


@_actual.register
def _actual_orientation(row: OrientationRow, arm: PosedArm) -> Float[np.ndarray, "n 3 3"]:
    return arm.frames(row.of)[1]


@singledispatch
def _required(row: AxisRow, arm: PosedArm, place: PartPose) -> Float[np.ndarray, "n 3"]:
    """Return the required direction of an axis, not normalised, or the required orientations of a frame."""
    if row.looks_at_m is not None:
        return place.world(row, row.looks_at_m, True) - arm.frames(row.axis_of[0])[0]
    if (name := row.along_path) is not None:
        on_part = place.workpiece.normals if name.endswith("normal") else place.workpiece.tangents
        return (-1.0 if name.startswith("-") else 1.0) * on_part[place.point] @ place.rotate.T
    if row.frame == "path":
        return place.frames @ np.array(row.towards)
    direction = place.world(row, row.towards)
    return arm.from_world(direction) if row.frame == "world" else np.tile(direction, (len(arm.x), 1))


@_required.register
def _required_orientation(row: OrientationRow, arm: PosedArm, place: PartPose) -> Float[np.ndarray, "n 3 3"]:
    if row.orientation == "path":
        return place.rotate @ place.workpiece.rotations[place.point]
    rotation = Rotation.from_quat(row.orientation, scalar_first=True).as_matrix()
    if row.frame == "workpiece":
        return np.tile(place.rotate @ rotation, (len(arm.x), 1, 1))
    return arm.from_world(rotation)


def _angle(a: Float[np.ndarray, "n *v"], b: Float[np.ndarray, "n *v"]) -> Float[np.ndarray, "n"]:
    """Return the angles between directions, or between orientations, in pairs [rad]."""
    if a.ndim == 2:
        return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))
    return Rotation.from_matrix(b @ np.swapaxes(a, 1, 2)).magnitude() if len(a) else np.zeros(0)


def _middle(a: Float[np.ndarray, "n *v"], b: Float[np.ndarray, "n *v"]) -> Float[np.ndarray, "n *v"]:
    """Return the directions, not normalised, or the orientations halfway between two, in pairs."""
    if a.ndim == 2:
        return a / np.linalg.norm(a, axis=1)[:, None] + b / np.linalg.norm(b, axis=1)[:, None]
    both = Rotation.from_matrix(b @ np.swapaxes(a, 1, 2)).as_rotvec() if len(a) else np.zeros((0, 3))
    return Rotation.from_rotvec(0.5 * both).as_matrix() @ a
