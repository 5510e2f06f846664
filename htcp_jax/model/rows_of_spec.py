"""Conversion of a job's task rows to the planner's rows, and the rows' goals at every target.

`row_of` and `goals_of` have one implementation for each class of built-in rows (`spec.task_list`). All other classes
are of other packages (`spec.task_row_kind.TaskRowKind`) and become a `GivenRow`.
"""

from dataclasses import dataclass
from functools import singledispatch
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.model.arm_features import axis_of, frame_of, point_of
from htcp_jax.model.built_in_rows import AxisTowards, FrameOrientation, PointAlong
from htcp_jax.model.robot import ArmFrame, Robot
from htcp_jax.model.rotations import turned_directions
from htcp_jax.model.row_bounds import RateBound
from htcp_jax.model.task_rows import Feature, Row, TaskPoint, eased_offsets, mixed
from htcp_jax.model.tool_angles import Limits, ToolAngles
from htcp_jax.model.workpiece import Workpiece
from htcp_jax.numerics import safe_norm
from htcp_jax.spec import (
    PATH_VALUES,
    Angle,
    AxisRow,
    BuiltInRow,
    OrientationRow,
    PointRow,
    Slot,
    TaskRowKind,
    Template,
    ToolAxisRow,
    numbers_of,
    template_of,
)
from htcp_jax.types import Array, Scalar


class PlacedPath(NamedTuple):
    """A workpiece's pose and its path in the world."""

    rotate: Float[np.ndarray, "3 3"]  # rotation of the workpiece
    translate: Float[np.ndarray, "3"]  # its translation [m]
    path: Float[np.ndarray, "T 3"]  # points of the path in the world [m]
    workpiece: Workpiece

    def along(self, name: str) -> Float[np.ndarray, "T 3"]:
        """Return the path's points [m], tangents or normals in the world, by the name in `PATH_VALUES`."""
        return self.path if name == "place" else getattr(self.workpiece, PATH_VALUES[name]) @ self.rotate.T

    @property
    def axes(self) -> Float[np.ndarray, "T 3 3"]:
        """The axes of the path's frame in the world, as rows: x along the tangent, y = z x x, z along the normal."""
        x, z = self.along("tangent"), self.along("normal")
        x = x - (x * z).sum(axis=1, keepdims=True) * z
        x = x / np.linalg.norm(x, axis=1, keepdims=True)
        return np.stack([x, np.cross(z, x), z], axis=1)

    def in_world(self, spec: BuiltInRow, vector: Any, is_place: bool = False) -> Float[np.ndarray, "3"]:
        """Return a position [m] or direction in the world, from its numbers in a row, which are in the row's frame."""
        if spec.frame != "workpiece":
            return np.array(vector)
        return self.rotate @ np.array(vector) + (self.translate if is_place else 0.0)


@singledispatch
def row_of(spec: TaskRowKind, robot: Robot) -> Row:
    """Return the planner's row for a row of a task and a robot.

    Args:
        spec: The row as written in a job.
        robot: The robot.

    Raises:
        InputError: For a name that the robot lacks; for a position in the world if the part moves; and for a class with
            an invalid `along`, or a wrong number of errors or slacks.
    """
    if unknown := [name for name in spec.along if name not in PATH_VALUES]:
        raise InputError(f"along of {spec.name} has {unknown[0]!r}; valid: {', '.join(PATH_VALUES)}")
    template = template_of(spec)
    template = Template(template.kind, (*template.fields, *((name, Slot((3,))) for name in spec.along)))
    features = tuple(spec.features(robot))
    for method, name in (("error", "equalities"), ("slack", "inequalities")):
        shape, count = np.shape(_evaluated(template, method, features)), getattr(spec, name)
        if shape != (count,):
            raise InputError(
                f"{method} of {spec.name} returns the shape {shape}; with {name} = {count} it must be ({count},)"
            )
    if not spec.equalities + spec.inequalities:
        raise InputError(f"{spec.name}: `equalities` and `inequalities` are both 0; set one of them")
    return GivenRow(template, features)


@row_of.register
def _point_row(spec: PointRow, robot: Robot) -> Row:
    if robot.part_moves and spec.is_in_world:
        raise InputError("frame is world, but the part moves; valid for a position: workpiece, path")
    link, offset, *_ = point_of(robot, spec.point, spec.offset_m)
    band = spec.limit is not None
    if spec.is_on_surface:
        return PointAlong(link, offset, 1 if spec.on == "plane" else 2, band)
    of_world = (spec.frame == "world" or spec.axes == "xyz") and not band  # all frames are then equivalent
    if of_world and not (link is None and any(offset)):
        return TaskPoint(link, offset, tuple("xyz".index(axis) for axis in spec.axes))
    return PointAlong(link, offset, len(spec.axes), band)


@row_of.register
def _axis_row(spec: AxisRow, robot: Robot) -> Row:
    if robot.part_moves and spec.is_in_world and spec.looks_at_m is not None:
        raise InputError("frame is world, but the part moves; valid for a position: workpiece")
    cone = spec.limit is not None
    if spec.is_of_path:  # the same angle, written as a world direction that must point along the path's direction
        direction = np.array(spec.towards)
        direction = direction / np.linalg.norm(direction) @ np.array(robot.world.columns)
        return AxisTowards(robot.world.link, tuple(direction.tolist()), cone=cone)
    axis = axis_of(robot, spec.axis)
    looks_from = None if spec.looks_at_m is None else frame_of(robot, spec.axis_of[0]).origin_m
    return AxisTowards(axis.link, axis.vector, looks_from, cone, _seen_from(spec, robot))


@row_of.register
def _orientation_row(spec: OrientationRow, robot: Robot) -> Row:
    frame = frame_of(robot, spec.of)
    return FrameOrientation(frame.link, frame.columns, spec.limit is not None, _seen_from(spec, robot))


@row_of.register
def _tool_axis_row(spec: ToolAxisRow, robot: Robot) -> Row:
    name, k, sign = spec.axis_of
    frame = frame_of(robot, name, "axis")
    h, x = -sign * np.array(frame.columns[k]), np.array(frame.columns[(k + 1) % 3])
    columns = tuple(h.tolist()), tuple(x.tolist()), tuple(np.cross(h, x).tolist())
    work, travel, spin = (_limits(value) for _, value in spec.angles())
    return ToolAngles(frame._replace(columns=columns), (work, travel, spin))


def _limits(value: Angle) -> Limits:
    if value == "free":
        return "free"
    return "range" if isinstance(value, tuple) else "value"


def _seen_from(spec: AxisRow | OrientationRow, robot: Robot) -> ArmFrame | None:
    return robot.world if robot.part_moves and spec.is_in_world else None


@singledispatch
def goals_of(spec: TaskRowKind, row: Row, placed: PlacedPath) -> Float[np.ndarray, "T g"]:
    """Return the goals of a row at the T points of a path [m, rad, or of length 1].

    Args:
        spec: The row as written in a job.
        row: The planner's row, from `row_of`.
        placed: The path.
    """
    count = len(placed.path)  # the offsets, the last columns, are 0 on the path, see `GivenRow`
    columns = [np.tile(numbers_of([spec]), (count, 1)), *map(placed.along, spec.along)]
    return np.column_stack([*columns, np.zeros((count, spec.equalities + spec.inequalities))])


@goals_of.register
def _point_goals(spec: PointRow, row: Row, placed: PlacedPath) -> Float[np.ndarray, "T g"]:
    count, places = len(placed.path), placed.path
    if not spec.follows_path:
        place = placed.in_world(spec, spec.through_m if spec.is_on_surface else spec.on, is_place=True)
        places = np.tile(place, (count, 1))
    if isinstance(row, TaskPoint):
        return places[:, list(row.axes)]
    across = _across(spec, placed)
    offsets = np.einsum("tkj,tj->tk", across, places)
    goals = np.concatenate([across, offsets[:, :, None]], axis=2).reshape(count, -1)
    return _with_limit(goals, spec)


@goals_of.register
def _axis_goals(spec: AxisRow, row: Row, placed: PlacedPath) -> Float[np.ndarray, "T g"]:
    if (name := spec.along_path) is not None:
        on_part = placed.workpiece.normals if name.endswith("normal") else placed.workpiece.tangents
        directions = (-1.0 if name.startswith("-") else 1.0) * on_part @ placed.rotate.T
    elif spec.looks_at_m is not None:  # the place to point at [m]
        directions = np.tile(placed.in_world(spec, spec.looks_at_m, is_place=True), (len(placed.path), 1))
    else:
        direction = placed.in_world(spec, spec.towards)
        direction = direction / np.linalg.norm(direction)
        directions = direction @ placed.axes if spec.frame == "path" else np.tile(direction, (len(placed.path), 1))
    return _with_limit(directions, spec) if spec.limit else np.column_stack([directions, np.zeros(len(directions))])


@goals_of.register
def _orientation_goals(spec: OrientationRow, row: Row, placed: PlacedPath) -> Float[np.ndarray, "T g"]:
    if spec.orientation == "path":
        rotations = placed.rotate @ placed.workpiece.frames.rotations
    else:
        rotation = scipy.spatial.transform.Rotation.from_quat(spec.orientation, scalar_first=True).as_matrix()
        rotation = placed.rotate @ rotation if spec.frame == "workpiece" else rotation
        rotations = np.tile(rotation, (len(placed.path), 1, 1))
    return _with_limit(rotations.reshape(len(placed.path), 9), spec)


@goals_of.register
def _tool_axis_goals(spec: ToolAxisRow, row: Row, placed: PlacedPath) -> Float[np.ndarray, "T g"]:
    count, axes = len(placed.path), placed.axes
    bounds = np.array([(0, 0) if value == "free" else spec.bounds_deg(name) for name, value in spec.angles()])
    bounds = np.tile(np.deg2rad(bounds).ravel(), (count, 1))
    if spec.plate is not None:
        surface, sign = _plate_angles(placed, axes, spec.plate)
        bounds[:, :2] = np.sort(surface[:, None] + sign[:, None] * bounds[:, :2], axis=1)
    offsets = np.zeros((count, row.equalities + row.inequalities))
    return np.column_stack([np.swapaxes(axes, 1, 2).reshape(count, 9), bounds, offsets])


def angles_of(spec: ToolAxisRow, value: Float[np.ndarray, "T 9"], placed: PlacedPath) -> Float[np.ndarray, "T 3"]:
    """Return work angle, travel angle and spin [rad] of a tool at the T points of a path.

    Args:
        spec: The row as written in a job.
        value: Directions h, x and y of the tool, see `ToolAngles`.
        placed: The path.
    """
    axes = placed.axes
    t, b, n = np.moveaxis(axes, 1, 0)
    h, x, y = np.moveaxis(value.reshape(-1, 3, 3), 1, 0)
    pairs = [((p * u).sum(axis=1), (q * v).sum(axis=1)) for p, u, q, v in ((h, b, h, n), (h, -t, h, n), (y, t, x, t))]
    angles = np.stack([np.arctan2(*pair) for pair in pairs], axis=1)
    if spec.plate is not None:
        surface, sign = _plate_angles(placed, axes, spec.plate)
        angles[:, 0] = (sign * (angles[:, 0] - surface) + np.pi) % (2 * np.pi) - np.pi
    return angles


def _plate_angles(
    placed: PlacedPath, axes: Float[np.ndarray, "T 3 3"], plate: int
) -> tuple[Float[np.ndarray, "T"], Float[np.ndarray, "T"]]:
    """Return the work angle of the direction from the seam along one plate of a fillet [rad].

    Args:
        placed: The path.
        axes: See `PlacedPath.axes`.
        plate: Index of the plate, 0 or 1.

    Returns:
        The angle, and 1 where the work angle increases from there into the free space, else -1.
    """
    t, b, n = np.moveaxis(axes, 1, 0)
    normals = placed.workpiece.frames.plates @ placed.rotate.T
    normal = normals[:, plate]
    along = np.cross(normal, t)
    along *= np.sign((along * normals[:, 1 - plate]).sum(axis=1, keepdims=True))  # away from the other plate
    surface = np.arctan2((along * b).sum(axis=1), (along * n).sum(axis=1))
    return surface, np.sign((normal * b).sum(axis=1) * np.cos(surface) - (normal * n).sum(axis=1) * np.sin(surface))


def drawn_goal(spec: TaskRowKind, row: Row, rng: np.random.Generator) -> Float[np.ndarray, "g"]:
    """Return a random goal of a row, for checks of the task's rank.

    For a class of another package: the row's own numbers, with random vectors for the path's place and directions.
    """
    if isinstance(spec, BuiltInRow):
        return row.drawn(rng)
    random = rng.normal(size=(len(spec.along), 3))
    random /= np.linalg.norm(random, axis=1, keepdims=True)
    return np.concatenate([numbers_of([spec]), random.ravel(), np.zeros(spec.equalities + spec.inequalities)])


@dataclass(frozen=True)
class GivenRow(Row):
    """A row of a `TaskRowKind` of another package.

    A goal is the kind's numbers, then one offset per error and slack. The offsets are 0 on the path. On the approach
    they begin at values by which the start satisfies the row, and decrease to 0.
    """

    template: Template
    features: tuple[Feature, ...] = ()

    @property
    def kind(self) -> type[TaskRowKind]:
        """Class of the row's kind."""
        return self.template.kind

    @property
    def angular(self) -> bool:
        """True if errors and slacks are angles."""
        return self.kind.angular

    @property
    def sampled(self) -> bool:
        """True if the kind has no bound between two configurations."""
        return self.kind.rate is None

    @property
    def equalities(self) -> int:
        """Number of equations."""
        return self.kind.equalities

    @property
    def inequalities(self) -> int:
        """Number of inequalities."""
        return self.kind.inequalities

    @property
    def numbers(self) -> int:
        """Number of coordinates of a goal."""
        return self.template.size + self.equalities + self.inequalities

    def error(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "m"]:
        """Return the kind's error minus the goal's error offset."""
        first = self.template.size
        return self._own(goal).error(value) - goal[first : first + self.equalities]

    def slack(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the kind's slack plus the goal's slack offset."""
        return self._own(goal).slack(value) + goal[self.template.size + self.equalities :]

    def aim(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the distance inside the inequalities at which a step aims [m or rad]."""
        return self._own(goal).aim(value)

    def between(self, goals: Float[Array, "2 g"], tolerance_m: float, tolerance_rad: float) -> RateBound:
        """Return the allowed region: satisfied by goal 0, by goal 1, or by their mean."""
        tolerance = tolerance_rad if self.angular else tolerance_m

        def by(goal: Float[Array, "g"], value: Float[Array, "v"]) -> Scalar:
            off = tolerance - safe_norm(self.error(value, goal)) if self.equalities else jnp.inf
            return jnp.minimum(off, jnp.min(self.slack(value, goal), initial=jnp.inf) + tolerance)

        def slack(value: Float[Array, "v"]) -> Scalar:
            return jnp.max(jnp.stack([by(goal, value) for goal in (goals[0], 0.5 * (goals[0] + goals[1]), goals[1])]))

        return RateBound(slack, tuple(feature.is_direction for feature in self.features), self.kind.rate)

    def eased(self, start, first, share, places):
        """Return the first goal with offsets that decrease to 0; with the first offsets the start satisfies the row."""
        return eased_offsets(self, start, first, share)

    def interpolated(self, goals, share, places=None):
        """Interpolate the goals' numbers linearly, and tangents and normals by rotation."""
        found, first = mixed(goals, share), 0
        for name, value in self.template.fields:
            if isinstance(value, Slot):
                own = slice(first, first + int(np.prod(value.shape)))
                if name in PATH_VALUES and name != "place":
                    found[:, own] = turned_directions(goals[:, 0, own], goals[:, 1, own], share)
                first = own.stop
        return found

    def _own(self, goal: Float[Array, "g"]) -> TaskRowKind:
        return self.template.with_numbers(goal[: self.template.size])


def _evaluated(template: Template, what: str, features: tuple[Feature, ...]) -> np.ndarray:
    """Evaluate a kind's error or slack at arbitrary values, to determine its shape."""
    size = sum(len(feature.rows) for feature in features)
    return np.asarray(getattr(template.with_numbers(jnp.ones(template.size)), what)(jnp.full(size, 0.5)))


def _across(spec: PointRow, placed: PlacedPath) -> Float[np.ndarray, "T k 3"]:
    """Return the k directions in which a point is constrained, at the T points of the path."""
    count = len(placed.path)
    if spec.on == "plane":
        normal = placed.in_world(spec, spec.normal)
        return np.tile(normal / np.linalg.norm(normal), (count, 1, 1))
    if spec.on == "line":
        along = placed.in_world(spec, spec.direction)
        return np.tile(np.linalg.svd(along[None])[2][1:], (count, 1, 1))
    if spec.frame == "path":
        axes = placed.axes
    else:
        axes = np.tile(placed.rotate.T if spec.frame == "workpiece" else np.eye(3), (count, 1, 1))
    return axes[:, ["xyz".index(axis) for axis in spec.axes]]


def _with_limit(goals: Float[np.ndarray, "T g"], spec: BuiltInRow) -> Float[np.ndarray, "T h"]:
    """Return the goals of an inequality with a last column, its limit [m or rad]; those of an equality unchanged."""
    if spec.limit is None:
        return goals
    return np.column_stack([goals, np.full(len(goals), np.deg2rad(spec.limit) if spec.angular else spec.limit)])
