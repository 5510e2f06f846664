"""Independent check of a task's rows, in numpy with poses from MuJoCo: deviation and tolerance of each row.

The code is independent of the planner's implementation of the rows.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from htcp_jax.model import TaskRow, task_row_kind
from htcp_jax.settings import Settings
from htcp_jax.spec import with_arrays
from htcp_jax.validation.mujoco_arm import MujocoArm
from htcp_jax.validation.result import ROUNDING_M
from htcp_jax.validation.scene_rules import WorkpieceData

HELD = TaskRow(point="tcp", on="path")


class RowCheck(NamedTuple):
    """Deviation from one row of the task at n points of the path, and its tolerance, in metres or degrees."""

    row: task_row_kind.TaskRowKind
    off: Float[np.ndarray, "n"]  # deviation; NaN if not checked at this point
    most: float

    def reason(self, number: int, k: int) -> str | None:
        """Return a sentence on the row's violation at the k-th point; None if the row is satisfied."""
        if not self.off[k] > self.most + ROUNDING_M:
            return None
        off, most = self.factor * self.off[k], self.factor * self.most
        return f"task.{number} ({self.row}) deviates by {off:.5g} {self.unit}, {most:.4g} are allowed"

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
        return bool(np.isnan(self.off).any())


class PartPose(NamedTuple):
    """Pose of the part, and indices of n points on its path."""

    rotate: Float[np.ndarray, "3 3"]  # from the workpiece frame to the world
    translate: Float[np.ndarray, "3"]  # [m]
    workpiece: WorkpieceData
    point: Int[np.ndarray, "n"]

    def world(self, row: TaskRow, vector: Sequence[float], is_place: bool = False) -> Float[np.ndarray, "3"]:
        """Return a position or direction that a row contains as numbers, transformed to the world.

        Args:
            row: The row, which determines the frame of the numbers.
            vector: The position [m] or direction.
            is_place: True for a position.
        """
        if row.frame != "workpiece":
            return np.array(vector)
        return self.rotate @ np.array(vector) + (self.translate if is_place else 0.0)


def part_between(
    rows: Sequence[task_row_kind.TaskRowKind],
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
    a, b = workpiece.path[before], workpiece.path[after]
    own = replace(
        workpiece,
        path=a + share[:, None] * (b - a),
        given_normals=turned(workpiece.normals) if "normals" in uses else None,
        given_tangents=turned(workpiece.tangents) if "tangents" in uses else None,
        rotations=rotations,
    )
    return PartPose(rotate, translate, own, np.arange(len(point)))


def check_rows(
    rows: Sequence[task_row_kind.TaskRowKind],
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
    return [_check_row(row, arm, x, place, tolerance_m, float(np.rad2deg(tolerance_rad))) for row in rows or (HELD,)]


def hold_between(
    rows: Sequence[task_row_kind.TaskRowKind],
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
    good = np.ones((len(rows), len(x)), bool)
    for own, row in zip(good, rows, strict=True):
        if not isinstance(row, TaskRow):
            most = settings.tolerance_rad if row.angular else settings.tolerance_m
            own[:] = ~(_off_kind(row, arm, x, (before, here)) > most + ROUNDING_M)
        elif row.point is None:
            own[:] = _turned_between(row, arm, x, (before, here), settings.tolerance_rad + ROUNDING_M)
        elif not _is_tcp_at_place(row):
            point, most = _point(row, arm, x), (row.within_m or 0.0) + settings.tolerance_m + ROUNDING_M
            off = [_off_place(row, point, place) for place in (before, here)]
            own[:] = ((np.minimum(*off) <= most) & (np.maximum(*off) >= -most)).all(axis=1)
        elif row.on != "path":
            off = _off_place(row, _point(row, arm, x), here)
            own[:] = np.linalg.norm(off, axis=1) <= settings.tube_m + ROUNDING_M
    return good


def path_follower(
    rows: Sequence[task_row_kind.TaskRowKind], arm: MujocoArm, x: Float[np.ndarray, "n N"]
) -> Float[np.ndarray, "n 3"]:
    """Return the position of the point that follows the path, world [m]; the TCP if no row defines one.

    Args:
        rows: Rows of the task.
        arm: The arm.
        x: Configurations [rad or m].
    """
    return _point(next((row for row in rows if row.on == "path"), HELD), arm, x)


def holds_tcp(rows: Sequence[task_row_kind.TaskRowKind]) -> bool:
    """Return True if a row of the task constrains the TCP to the path in all directions."""
    return not rows or any(isinstance(row, TaskRow) and replace(row, frame=HELD.frame) == HELD for row in rows)


def follows_all(rows: Sequence[task_row_kind.TaskRowKind]) -> bool:
    """Return True if the point that follows the path is constrained exactly and in all directions."""
    row = next((row for row in rows if isinstance(row, TaskRow) and row.on == "path"), None if rows else HELD)
    return row is not None and row.axes == "xyz" and row.within_m is None


def _check_row(
    row: task_row_kind.TaskRowKind, arm: MujocoArm, x: np.ndarray, place: PartPose, most_m: float, most_deg: float
) -> RowCheck:
    if not isinstance(row, TaskRow):
        off = _off_kind(row, arm, x, (place,))
        return RowCheck(row, np.rad2deg(off) if row.angular else off, most_deg if row.angular else most_m)
    if row.point is not None:
        off = _off_place(row, _point(row, arm, x), place)
        exact = row.within_m is None
        return RowCheck(row, np.linalg.norm(off, axis=1) if exact else np.abs(off).max(axis=1), row.within_m or most_m)
    off = _off_axis(row, arm, x, place) if row.axis is not None else _off_turn(row, arm, x, place)
    allowed = max(row.cone_deg or 0.0, row.within_deg or 0.0)
    return RowCheck(row, np.rad2deg(off), allowed or most_deg)


def _off_kind(
    row: task_row_kind.TaskRowKind, arm: MujocoArm, x: np.ndarray, places: tuple[PartPose, ...]
) -> Float[np.ndarray, "n"]:
    """Return the deviation from a row whose kind is defined in another package [m or rad]; NaN without a check.

    The row's method `deviation` computes it. Between two targets the result is the smallest deviation from three goals:
    at both targets, and halfway between them.
    """
    given = [_along_path(row, place) for place in places]
    if len(given) == 2:
        given.append({name: 0.5 * (given[0][name] + given[1][name]) for name in row.along})
    found = np.full(len(x), np.inf)
    for values in given if row.along else given[:1]:
        own = with_arrays(row)
        vars(own).update(values)
        if (off := own.deviation(lambda name: arm.frames(x, name))) is None:
            return np.full(len(x), np.nan)
        found = np.minimum(found, off)
    return found


def _along_path(row: task_row_kind.TaskRowKind, place: PartPose) -> dict[str, Float[np.ndarray, "n 3"]]:
    """Return those of the path's points, tangents and normals that a row uses, in the world, by name."""
    own, named = place.workpiece, {"place": "path", "tangent": "tangents", "normal": "normals"}
    return {
        name: getattr(own, named[name])[place.point] @ place.rotate.T + (place.translate if name == "place" else 0.0)
        for name in row.along
    }


def _point(row: TaskRow, arm: MujocoArm, x: np.ndarray) -> Float[np.ndarray, "n 3"]:
    origin, rotation = arm.frames(x, row.point)
    return origin + rotation @ np.array(row.offset_m)


def _off_place(row: TaskRow, point: np.ndarray, place: PartPose) -> Float[np.ndarray, "n k"]:
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
        own = place.workpiece
        x, z = (directions[place.point] @ place.rotate.T for directions in (own.tangents, own.normals))
        y = np.cross(z, x)
        y = y / np.linalg.norm(y, axis=1, keepdims=True)
        off = np.stack([(off * axis).sum(axis=1) for axis in (np.cross(y, z), y, z)], axis=1)
    elif row.frame == "workpiece":
        off = off @ place.rotate
    return off[:, ["xyz".index(letter) for letter in row.axes]]


def _off_axis(row: TaskRow, arm: MujocoArm, x: np.ndarray, place: PartPose) -> Float[np.ndarray, "n"]:
    """Return the angle between an axis and its required direction [rad]."""
    return _angle(_axis_direction(row, arm, x, place), _turned_to(row, arm, x, place))


def _axis_direction(row: TaskRow, arm: MujocoArm, x: np.ndarray, place: PartPose) -> Float[np.ndarray, "n 3"]:
    if row.is_of_path:
        return _of_path(row.axis, place)
    name, k, sign = row.axis_of
    _, rotation = arm.frames(x, name)
    return sign * rotation[:, :, k]


def _of_path(name: str, place: PartPose) -> Float[np.ndarray, "n 3"]:
    """Return the path's normals or tangents in the world, by their name in a row such as "-path.normal"."""
    own = place.workpiece.normals if name.lstrip("-") == "path.normal" else place.workpiece.tangents
    return (-1.0 if name.startswith("-") else 1.0) * own[place.point] @ place.rotate.T


def _turned_to(row: TaskRow, arm: MujocoArm, x: np.ndarray, place: PartPose) -> Float[np.ndarray, "n 3"]:
    """Return the required direction of an axis, not normalised."""
    if row.looks_at_m is not None:
        origin, _ = arm.frames(x, row.axis_of[0])
        return place.world(row, row.looks_at_m, True) - origin
    if isinstance(row.towards, str):
        return _of_path(row.towards, place)
    direction = place.world(row, row.towards)
    if arm.root and row.frame == "world":
        return arm.frames(x, "world")[1] @ direction
    return np.broadcast_to(direction, (len(x), 3))


def _angle(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))


def _off_turn(row: TaskRow, arm: MujocoArm, x: np.ndarray, place: PartPose) -> Float[np.ndarray, "n"]:
    """Return the rotation angle between a frame and its required orientation [rad]."""
    _, rotation = arm.frames(x, row.of)
    return _turn_angle(rotation, _orientation(row, arm, x, place))


def _orientation(row: TaskRow, arm: MujocoArm, x: np.ndarray, place: PartPose) -> Float[np.ndarray, "n 3 3"]:
    """Return the required orientation of a frame, as rotation matrices."""
    if row.orientation == "path":
        return place.rotate @ place.workpiece.rotations[place.point]
    own = Rotation.from_quat(row.orientation, scalar_first=True).as_matrix()
    if arm.root and row.frame == "world":
        return arm.frames(x, "world")[1] @ own
    return np.tile(place.rotate @ own if row.frame == "workpiece" else own, (len(x), 1, 1))


def _turn_angle(a: Float[np.ndarray, "n 3 3"], b: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n"]:
    return Rotation.from_matrix(b @ np.swapaxes(a, 1, 2)).magnitude() if len(a) else np.zeros(0)


def _turned_between(
    row: TaskRow, arm: MujocoArm, x: np.ndarray, places: tuple[PartPose, PartPose], tolerance_rad: float
) -> Bool[np.ndarray, "n"]:
    """Return a mask, True where an axis or a frame is oriented as required at an end or in the middle of a segment.

    In the middle, the tolerance is at least half of the rotation between the ends. A position at which an axis points
    is fixed along the segment.
    """
    limit = np.deg2rad(row.limit_deg or 0.0)
    if row.axis is None:
        (_, now), off = arm.frames(x, row.of), _turn_angle
        a, b = (_orientation(row, arm, x, place) for place in places)
        both = Rotation.from_matrix(b @ np.swapaxes(a, 1, 2)).as_rotvec() if len(x) else np.zeros((0, 3))
        middle = Rotation.from_rotvec(0.5 * both).as_matrix() @ a
    else:
        now, ends, off = _axis_direction(row, arm, x, places[1]), _turned_to, _angle
        if row.is_of_path:  # between two targets, the path's direction is interpolated
            now, ends = _turned_to(row, arm, x, places[1]), _axis_direction
        a, b = (ends(row, arm, x, place) for place in places)
        middle = a / np.linalg.norm(a, axis=1)[:, None] + b / np.linalg.norm(b, axis=1)[:, None]
    good = (off(now, a) <= limit + tolerance_rad) | (off(now, b) <= limit + tolerance_rad)
    return good | (off(now, middle) <= np.maximum(limit, 0.5 * off(a, b)) + tolerance_rad)


def _is_tcp_at_place(row: TaskRow) -> bool:
    return replace(row, on=HELD.on, frame=HELD.frame) == HELD and row.on not in ("plane", "line")
