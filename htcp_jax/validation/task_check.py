"""The rows of a task looked at again, in plain numpy on poses by MuJoCo: how far off each is, and what is allowed.

Nothing of the planner's rows is used. Normals and tangents that the path's file does not have are the scene's.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from htcp_jax.scene.task_list import TaskRow
from htcp_jax.scene.workpiece import Workpiece
from htcp_jax.validation.mujoco_arm import Arm
from htcp_jax.validation.result import ROUNDING_M

HELD = TaskRow(point="tcp", on="path")


class RowCheck(NamedTuple):
    """One row at n points of the path, in metres or degrees."""

    row: TaskRow
    off: Float[np.ndarray, "n"]
    most: float

    def reason(self, number: int, k: int) -> str | None:
        """In words, why the row does not hold at the k-th of the points; None where it does."""
        if self.off[k] <= self.most + ROUNDING_M:
            return None
        off, most = self.factor * self.off[k], self.factor * self.most
        return f"task.{number} ({self.row}) is {off:.5g} {self.unit} off, {most:.4g} are allowed"

    @property
    def unit(self) -> str:
        """In which people are told."""
        return "mm" if self.row.point else "degrees"

    @property
    def factor(self) -> float:
        """To that unit."""
        return 1e3 if self.row.point else 1.0


class Place(NamedTuple):
    """Where the part is, and at which of its path's points the arm."""

    rotate: Float[np.ndarray, "3 3"]  # from the workpiece frame to the world
    translate: Float[np.ndarray, "3"]  # [m]
    workpiece: Workpiece
    point: Int[np.ndarray, "n"]

    def world(self, row: TaskRow, vector: Sequence[float], is_place: bool = False) -> Float[np.ndarray, "3"]:
        """A place or a direction that a row gives in numbers."""
        if row.frame != "workpiece":
            return np.array(vector)
        return self.rotate @ np.array(vector) + (self.translate if is_place else 0.0)


def check_rows(
    rows: Sequence[TaskRow],
    arm: Arm,
    x: Float[np.ndarray, "n N"],
    place: Place,
    tolerance_m: float,
    tolerance_rad: float,
) -> list[RowCheck]:
    """Every row at configurations x."""
    return [_check(row, arm, x, place, tolerance_m, float(np.rad2deg(tolerance_rad))) for row in rows or (HELD,)]


def in_cones(
    rows: Sequence[TaskRow], arm: Arm, x: Float[np.ndarray, "n N"], places: Sequence[Place], tolerance_rad: float
) -> Bool[np.ndarray, "n"]:
    """Whether every axis that is held about a direction is in its cone at one of the places, within the tolerance, at
    configurations x between them."""
    good = np.ones(len(x), bool)
    for row in rows:
        if row.axis is not None and row.looks_at_m is None and row.limit_deg is not None:
            off = np.minimum(*(_off_axis(row, arm, x, place) for place in places))
            good &= off <= np.deg2rad(row.limit_deg) + tolerance_rad + ROUNDING_M
    return good


def follower(rows: Sequence[TaskRow], arm: Arm, x: Float[np.ndarray, "n N"]) -> Float[np.ndarray, "n 3"]:
    """Where the point that follows the path is; the TCP where none does."""
    return _point(next((row for row in rows if row.on == "path"), HELD), arm, x)


def holds_tcp(rows: Sequence[TaskRow]) -> bool:
    """Whether the TCP is held on the path in all directions."""
    return not rows or any(replace(row, frame=HELD.frame) == HELD for row in rows)


def follows_all(rows: Sequence[TaskRow]) -> bool:
    """Whether the point that follows the path is held in all directions."""
    row = next((row for row in rows if row.on == "path"), None if rows else HELD)
    return row is not None and row.axes == "xyz" and row.within_m is None


def _check(row: TaskRow, arm: Arm, x: np.ndarray, place: Place, most_m: float, most_deg: float) -> RowCheck:
    if row.point is not None:
        off = _off_place(row, _point(row, arm, x), place)
        exact = row.within_m is None
        return RowCheck(row, np.linalg.norm(off, axis=1) if exact else np.abs(off).max(axis=1), row.within_m or most_m)
    off = _off_axis(row, arm, x, place) if row.axis is not None else _off_turn(row, arm, x, place)
    allowed = max(row.cone_deg or 0.0, row.within_deg or 0.0)
    return RowCheck(row, np.rad2deg(off), allowed or most_deg)


def _point(row: TaskRow, arm: Arm, x: np.ndarray) -> Float[np.ndarray, "n 3"]:
    origin, rotation = arm.frames(x, row.point)
    return origin + rotation @ np.array(row.offset_m)


def _off_place(row: TaskRow, point: np.ndarray, place: Place) -> Float[np.ndarray, "n k"]:
    """How far a point is from where it is to be, in the directions that count."""
    if row.on == "plane":
        normal = place.world(row, row.normal) / np.linalg.norm(row.normal)
        return ((point - place.world(row, row.through_m, True)) @ normal)[:, None]
    if row.on == "line":
        along = place.world(row, row.direction) / np.linalg.norm(row.direction)
        off = point - place.world(row, row.through_m, True)
        beside = off - (off @ along)[:, None] * along
        if row.within_m is None:
            return beside
        return beside @ np.linalg.svd(along[None])[2][1:].T
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


def _off_axis(row: TaskRow, arm: Arm, x: np.ndarray, place: Place) -> Float[np.ndarray, "n"]:
    """The angle between an axis and what it is turned to [rad]."""
    name, _, letter = row.axis.lstrip("-").rpartition(".")
    origin, rotation = arm.frames(x, name)
    axis = (-1.0 if row.axis.startswith("-") else 1.0) * rotation[:, :, "xyz".index(letter)]
    if row.looks_at_m is not None:
        to = place.world(row, row.looks_at_m, True) - origin
    elif isinstance(row.towards, str):
        own = place.workpiece.normals if row.towards.endswith("normal") else place.workpiece.tangents
        to = (-1.0 if row.towards.startswith("-") else 1.0) * own[place.point] @ place.rotate.T
    else:
        to = np.broadcast_to(place.world(row, row.towards), axis.shape)
    return np.arctan2(np.linalg.norm(np.cross(axis, to), axis=1), (axis * to).sum(axis=1))


def _off_turn(row: TaskRow, arm: Arm, x: np.ndarray, place: Place) -> Float[np.ndarray, "n"]:
    """The angle of the rotation between a frame and what it is to be [rad]."""
    _, rotation = arm.frames(x, row.of)
    if row.orientation == "path":
        wanted = place.rotate @ place.workpiece.frames.rotations[place.point]
    else:
        own = Rotation.from_quat(row.orientation, scalar_first=True).as_matrix()
        wanted = np.tile(place.rotate @ own if row.frame == "workpiece" else own, (len(x), 1, 1))
    return Rotation.from_matrix(wanted @ np.swapaxes(rotation, 1, 2)).magnitude() if len(x) else np.zeros(0)
