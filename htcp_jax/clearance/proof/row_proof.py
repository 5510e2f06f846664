"""Proof that the rows of a task hold between two targets, on an interval of a straight joint path, to second order.

On a segment a row's goal lies between that of the previous target, 0, and that of this one, 1:

    a place       f_k = u_k p - o_k, its deviation in a direction by either: min f_k <= w and max f_k >= -w
    an axis       the angle to d_0, to d_1, or to the direction half way, is at most the limit
    a frame       the angle of the rotation to R_0, to R_1, or to the rotation half way, is at most the limit
    a view        the angle to the direction of the place is at most the limit

w is the band plus the tolerance of lengths; the limit is the half angle, half way at least half the turn from 0 to 1,
plus the tolerance of angles.

A row's slack is the displacement of the point [m], or of the vectors as a chord, that it still permits: a motion that
stays that close to the joint path satisfies the row, see `trajectory.rows_left`.

Where |g''| <= B within h of the middle m, g is within B h^2 / 2 of g(m) + (s - m) g'(m), the ends of which bound every
convex function of it. Angles are compared as chords, which are lengths of vectors: |a - d| = 2 sin(angle / 2), and of
rotation matrices sqrt(2) times that. Where the hinges turn by S in all per unit of s, |a''| <= S^2; of the direction
q / |q| to a place, |q| >= r, it is at most |q''| / r + 2 / sqrt(3) |q'|^2 / r^2.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance.proof.motion_bound import ROUNDING_M, point_bend_bound
from htcp_jax.model.robot import Robot
from htcp_jax.model.rotations import angle, axis_angle_matrix, rotation_vector
from htcp_jax.model.task import Task, feature_at
from htcp_jax.model.task_rows import AxisTowards, Feature, PointAlong, Row, TaskPoint, Turned
from htcp_jax.numerics import product, safe_norm
from htcp_jax.types import Array, Bool, Float, Joints, Scalar, Vector3

ROUNDING = 1e-12  # of a chord
HELD_ELSEWHERE = TaskPoint()  # the TCP at a place, which its tube constrains


class Slabs(NamedTuple):
    """Allowed region of a point: c directions and, for either target, the offsets along them and the deviation [m]."""

    across: Float[Array, "2 c 3"]
    offset: Float[Array, "2 c"]
    within: Float[Array, "2"]


class Chords(NamedTuple):
    """Allowed vectors of the arm: within a distance of one of k; axes of length 1, concatenated."""

    vectors: Float[Array, "k v"]
    radius: Float[Array, "k"]


class Look(NamedTuple):
    """The place that an axis points at [m], and the allowed deviation of the axis as a chord."""

    place: Vector3
    radius: Scalar


Between = Slabs | Chords | Look | None


class Left(NamedTuple):
    """Slack of a part, or of each of P, on an interval of a joint path."""

    left: Float[Array, "*P"]  # allowed deviation of its features' vectors from the path; negative: it may be violated
    broken: Bool[Array, "*P"]  # True: it is violated at the middle
    apart: Float[Array, "*P"]  # lower bound on the distance of the place that an axis points at [m]; inf: none


def between(task: Task, goals: Float[Array, "2 G"]) -> tuple[Between, ...]:
    """Return the constraint of every part of a task between two targets; None for the TCP at a place.

    Args:
        task: The task.
        goals: The goals of the two targets.
    """
    return tuple(
        None if part == HELD_ELSEWHERE else _BETWEEN[type(part)](task, part, goals[:, start : start + part.numbers])
        for start, part in zip(task.starts, task.parts, strict=True)
    )


def heeded(parts: tuple[Row, ...]) -> tuple[Row, ...]:
    """Return the parts of a task that `rows_left` covers."""
    return tuple(part for part in parts if part != HELD_ELSEWHERE)


def rows_left(
    robot: Robot, parts: tuple[Row, ...], asked: tuple[Between, ...], x: Joints, rates: Joints, half: Scalar
) -> Left:
    """Return the slack of each of the `heeded` parts on a straight joint path.

    Args:
        robot: The robot.
        parts: All parts of the task.
        asked: Their constraints, see `between`.
        x: The middle of the path x + s `rates` [rad or m].
        rates: Its derivative in s [rad or m].
        half: Largest |s|.
    """
    given = [(part, own) for part, own in zip(parts, asked, strict=True) if own is not None]
    found = [_LEFT[type(own)](robot, part.features, own, x, rates, half) for part, own in given]
    return Left(*(jnp.stack(each) for each in zip(*found, strict=True)))


def rows_hold(
    robot: Robot, parts: tuple[Row, ...], asked: tuple[Between, ...], x: Joints, rates: Joints, half: Scalar
) -> tuple[Bool[Array, "P"], Bool[Array, "P"]]:
    """Return True for parts proven to hold on the joint path of `rows_left`, and True for parts violated at x."""
    found = rows_left(robot, parts, asked, x, rates, half)
    return found.left >= 0, found.broken


# Constraints between two targets


def _point_between(task: Task, part: TaskPoint, goals: Float[Array, "2 g"]) -> Slabs:
    across = jnp.broadcast_to(jnp.eye(3)[jnp.array(part.axes)], (2, len(part.axes), 3))
    return Slabs(across, goals, jnp.full(2, task.tolerance_m))


def _along_between(task: Task, part: PointAlong, goals: Float[Array, "2 g"]) -> Slabs:
    each = goals[:, : 4 * part.count].reshape(2, part.count, 4)
    within = goals[:, -1] if part.band else jnp.zeros(2)
    return Slabs(each[..., :3], each[..., 3], within + task.tolerance_m)


def _axis_between(task: Task, part: AxisTowards, goals: Float[Array, "2 g"]) -> Chords | Look:
    limit = goals[:, 3] if part.cone else jnp.zeros(2)
    if part.looks_from_m is not None:
        return Look(goals[1, :3], _chord(limit[1] + task.tolerance_rad))
    a, b = goals[:, :3]
    both = a + b
    middle = jnp.where(safe_norm(both) > 1e-6, both / jnp.maximum(safe_norm(both), 1e-6), a)
    return Chords(jnp.stack([a, b, middle]), _chord(_limits(limit, angle(a, b)) + task.tolerance_rad))


def _turn_between(task: Task, part: Turned, goals: Float[Array, "2 g"]) -> Chords:
    a, b = goals[:, :9].reshape(2, 3, 3)
    limit = goals[:, 9] if part.cone else jnp.zeros(2)
    vector = rotation_vector(product(b, a.T))
    size = safe_norm(vector)
    axis = jnp.where(size > 0, vector, jnp.array([1.0, 0.0, 0.0])) / jnp.where(size > 0, size, 1.0)
    middle = product(axis_angle_matrix(axis[None], 0.5 * size[None])[0], a)
    radius = np.sqrt(2) * _chord(_limits(limit, size) + task.tolerance_rad)
    return Chords(jnp.stack([a.T, b.T, middle.T]).reshape(3, 9), radius)


_BETWEEN = {TaskPoint: _point_between, PointAlong: _along_between, AxisTowards: _axis_between, Turned: _turn_between}


def _limits(limit: Float[Array, "2"], turn: Scalar) -> Float[Array, "3"]:
    """Return the half angles about both ends of a turn, and half way."""
    return jnp.append(limit, jnp.maximum(limit.mean(), 0.5 * turn))


def _chord(half_angle: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Return the chord of a half angle in a circle of radius 1; infinite from half a turn on."""
    return jnp.where(half_angle < np.pi, 2 * jnp.sin(0.5 * half_angle), jnp.inf)


# Slack


def _in_slabs(robot: Robot, features: tuple[Feature], own: Slabs, x: Joints, rates: Joints, half: Scalar) -> Left:
    [feature] = features
    point, speed = _moving(robot, x, rates, feature)
    bend = _bend(robot, x, rates, half, feature, point)
    slack = half * jnp.abs(_along(own, speed)) + 0.5 * half * half * bend
    off, within = _along(own, point) - own.offset, own.within[:, None]
    above, below = within - (off + slack + ROUNDING_M), (off - slack - ROUNDING_M) + within
    left = jnp.minimum(jnp.max(above, axis=0), jnp.max(below, axis=0))
    broken = jnp.all(off > within, axis=0) | jnp.all(off < -within, axis=0)
    return Left(jnp.min(left), jnp.any(broken), jnp.inf)


def _in_chords(
    robot: Robot, features: tuple[Feature, ...], own: Chords, x: Joints, rates: Joints, half: Scalar
) -> Left:
    moving = [_moving(robot, x, rates, feature) for feature in features]
    now, ahead = (jnp.concatenate(each) for each in zip(*moving, strict=True))
    bend = np.sqrt(len(features)) * _turning(robot, rates) ** 2
    off = now[None] - own.vectors
    most = _farthest(off, half * ahead) + 0.5 * half * half * bend + ROUNDING
    return Left(jnp.max(own.radius - most), jnp.all(safe_norm(off) > own.radius), jnp.inf)


def _in_look(
    robot: Robot, features: tuple[Feature, Feature], own: Look, x: Joints, rates: Joints, half: Scalar
) -> Left:
    axis, eye = features

    def off(x):
        ahead = own.place - feature_at(robot, x, eye)
        return feature_at(robot, x, axis) - ahead / jnp.maximum(safe_norm(ahead), 1e-12)

    here, rate = jax.jvp(off, (x,), (rates,))
    point, speed = _moving(robot, x, rates, eye)
    bend = _bend(robot, x, rates, half, eye, point)
    fastest = safe_norm(speed) + half * bend
    nearest = safe_norm(own.place - point) - half * fastest
    apart = jnp.maximum(nearest, 1e-12)
    bend = _turning(robot, rates) ** 2 + bend / apart + 2 / np.sqrt(3) * (fastest / apart) ** 2
    most = _farthest(here[None], half * rate)[0] + 0.5 * half * half * bend + ROUNDING
    left = jnp.where(nearest > 0, own.radius - most, -1.0)
    left = jnp.where(jnp.isfinite(own.radius), left, jnp.inf)
    return Left(left, safe_norm(here) > own.radius, nearest)


_LEFT = {Slabs: _in_slabs, Chords: _in_chords, Look: _in_look}


def _moving(robot: Robot, x: Joints, rates: Joints, feature: Feature) -> tuple[Vector3, Vector3]:
    """Return a feature's position or direction, and its velocity."""
    return jax.jvp(partial(feature_at, robot, feature=feature), (x,), (rates,))


def _bend(robot: Robot, x: Joints, rates: Joints, half: Scalar, feature: Feature, point: Vector3) -> Scalar:
    link = len(robot.slides) - 1 if feature.link is None else feature.link
    return point_bend_bound(robot, x, rates, half * jnp.abs(rates), point[None], jnp.array([link]))[0]


def _turning(robot: Robot, rates: Joints) -> Scalar:
    """Return the sum of the hinges' turns [rad]."""
    return jnp.sum(jnp.where(np.array(robot.slides), 0.0, jnp.abs(rates)))


def _farthest(off: Float[Array, "k v"], move: Float[Array, "v"]) -> Float[Array, "k"]:
    return jnp.maximum(safe_norm(off + move[None]), safe_norm(off - move[None]))


def _along(own: Slabs, vector: Vector3) -> Float[Array, "2 c"]:
    return jnp.sum(own.across * vector[None, None], axis=2)
