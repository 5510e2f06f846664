"""Kinds of task rows that a job can list: points along directions, axes, and orientations.

Errors of angles are rotation vectors, the logarithm map (Lynch and Park, Modern Robotics, section 3.2.3) [rad].
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from htcp_jax.model.robot import ArmFrame
from htcp_jax.model.rotations import (
    angle,
    axis_error,
    frame_turns,
    least_turn,
    rotation_vector,
    turned_directions,
    turned_frames,
)
from htcp_jax.model.row_bounds import Region, Slabs, ViewTarget, allowed_axes, allowed_frames, chord
from htcp_jax.model.task_rows import AIM_SHARE, SLACK, Feature, Row, mixed
from htcp_jax.numerics import product, safe_norm
from htcp_jax.spec import AIM_M, AIM_RAD
from htcp_jax.types import Array, Float, Triple, Vector3


@dataclass(frozen=True)
class PointAlong(Row):
    """A point p of the arm, constrained in `count` directions u: u p = offset, or within a band about the offset.

    A goal contains each direction u with its offset [m] and, with a band, its half width [m].
    """

    link: int | None  # link to which the point is fixed; None: the TCP's frame
    offset_m: Triple  # position of the point in that frame
    count: int
    band: bool = False

    @property
    def features(self) -> tuple[Feature, ...]:
        """The point."""
        return (Feature(self.link, self.offset_m),)

    @property
    def equalities(self) -> int:
        """Number of equations: one per direction, without a band."""
        return 0 if self.band else self.count

    @property
    def inequalities(self) -> int:
        """Number of inequalities: two per direction, with a band."""
        return 2 * self.count if self.band else 0

    @property
    def numbers(self) -> int:
        """Number of coordinates of a goal."""
        return 4 * self.count + self.band

    def error(self, value: Vector3, goal: Float[Array, "g"]) -> Float[Array, "m"]:
        """Return the remaining distance in each direction [m]."""
        return jnp.zeros(0) if self.band else self._ahead(value, goal)

    def slack(self, value: Vector3, goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the slack to both sides of the band [m]."""
        if not self.band:
            return jnp.zeros(0)
        ahead = self._ahead(value, goal)
        return jnp.concatenate([goal[-1] - ahead, goal[-1] + ahead])

    def aim(self, value: Vector3, goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the distance inside the band at which a step aims [m]."""
        return jnp.broadcast_to(jnp.minimum(AIM_M, AIM_SHARE * goal[-1]), (self.inequalities,))

    def between(self, goals: Float[Array, "2 g"], tolerance_m: float, tolerance_rad: float) -> Slabs:
        """Return the region of positions within the band and the tolerance."""
        each = goals[:, : 4 * self.count].reshape(2, self.count, 4)
        within = goals[:, -1] if self.band else jnp.zeros(2)
        return Slabs(each[..., :3], each[..., 3], within + tolerance_m)

    def drawn(self, rng: np.random.Generator) -> Float[np.ndarray, "g"]:
        """Return a random goal: orthonormal directions, and offsets."""
        square = np.linalg.qr(rng.normal(size=(3, 3)))[0][: self.count]
        return np.append(np.column_stack([square, rng.normal(size=self.count)]).ravel(), np.ones(int(self.band)))

    def eased(self, start, first, share, places):
        """Interpolate the offsets from the start's offsets to those of the first goal.

        With `places`, the offsets are computed from these positions.
        """
        goals = np.tile(first, (len(share), 1))
        across = first[: 4 * self.count].reshape(self.count, 4)
        at_start = across[:, :3] @ start
        eased = at_start + share[:, None] * (across[:, 3] - at_start)
        goals[:, 3 : 4 * self.count : 4] = eased if places is None else places @ across[:, :3].T
        return goals

    def interpolated(self, goals, share, places=None):
        """Interpolate directions by rotation; the offsets follow the line between the targets' positions."""
        found = mixed(goals, share)
        each = goals[..., : 4 * self.count].reshape(-1, 2, self.count, 4)
        a, b = each[:, 0, :, :3].reshape(-1, 3), each[:, 1, :, :3].reshape(-1, 3)
        if np.array_equal(a, b):
            return found
        u = turned_directions(a, b, np.repeat(share, self.count)).reshape(-1, self.count, 3)
        places = np.zeros((len(goals), 2, 3)) if places is None else places
        off = mixed(each[..., 3] - np.einsum("ntcx,ntx->ntc", each[..., :3], places), share)
        offset = np.einsum("ncx,nx->nc", u, mixed(places, share)) + off
        found[:, : 4 * self.count] = np.concatenate([u, offset[..., None]], axis=2).reshape(len(goals), -1)
        return found

    def _ahead(self, point: Vector3, goal: Float[Array, "g"]) -> Float[Array, "count"]:
        each = goal[: 4 * self.count].reshape(self.count, 4)
        return each[:, 3] - product(each[:, :3], point)


@dataclass(frozen=True)
class AxisTowards(Row):
    """An axis of the arm that must point in a direction, or from `looks_from_m` at a place: exactly, or within a cone.

    A goal is the direction, or the place [m], and the cone's half angle [rad], 0 without a cone.
    """

    link: int | None  # link to which the axis is fixed; None: the TCP's frame
    axis: Triple  # unit vector in that frame
    looks_from_m: Triple | None = None  # origin of the axis in that frame; None: the goal is a direction
    cone: bool = True
    seen_from: ArmFrame | None = None  # frame of a goal's direction; None: the chain's root
    # True: compiled functions serve both, with a cone if the goal has a half angle. With one, errors are 0; else the
    # slack is infinite
    is_either: bool = False

    angular: ClassVar[bool] = True
    turns: ClassVar[bool] = True

    @property
    def either(self) -> "AxisTowards":
        """The row for which the goal decides whether there is a cone."""
        return replace(self, cone=True, is_either=True)

    @property
    def is_view(self) -> bool:
        """True if the axis points at a place."""
        return self.looks_from_m is not None

    @property
    def features(self) -> tuple[Feature, ...]:
        """The axis; if it points at a place, also the point `looks_from_m`."""
        axis = Feature(self.link, self.axis, is_direction=True, seen_from=self.seen_from)
        return (axis,) if self.looks_from_m is None else (axis, Feature(self.link, self.looks_from_m))

    @property
    def equalities(self) -> int:
        """Number of equations: two without a cone, as the arm may rotate about the axis."""
        if self.is_either:
            return 2
        return 0 if self.cone else 2

    @property
    def inequalities(self) -> int:
        """Number of inequalities: one with a cone."""
        return int(self.cone)

    @property
    def numbers(self) -> int:
        """Number of coordinates of a goal."""
        return 4

    def error(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "m"]:
        """Return the rotation vector from axis to direction [rad], as two components perpendicular to the direction."""
        if not self.equalities:
            return jnp.zeros(0)
        found = axis_error(value[:3], self._direction(value, goal))
        return jnp.where(goal[3] > 0, 0.0, found) if self.is_either else found

    def slack(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the cone's half angle minus the angle from the axis to the direction [rad]."""
        if not self.cone:
            return jnp.zeros(0)
        found = (goal[3] - angle(value[:3], self._direction(value, goal)))[None]
        return jnp.where(goal[3] > 0, found, jnp.inf) if self.is_either else found

    def aim(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the angle inside the cone at which a step aims [rad]."""
        return jnp.broadcast_to(jnp.minimum(AIM_RAD, AIM_SHARE * goal[-1]), (self.inequalities,))

    def between(self, goals: Float[Array, "2 g"], tolerance_m: float, tolerance_rad: float) -> Region:
        """Return the region of directions within the cones and the tolerance."""
        limit = goals[:, 3] if self.cone else jnp.zeros(2)
        if self.looks_from_m is not None:
            return ViewTarget(goals[1, :3], chord(limit[1] + tolerance_rad))
        return allowed_axes(*goals[:, :3], limit, tolerance_rad)

    def drawn(self, rng: np.random.Generator) -> Float[np.ndarray, "g"]:
        """Return a random goal."""
        drawn = rng.normal(size=3 + self.cone)
        return np.append(drawn / np.linalg.norm(drawn[:3]), np.zeros(int(not self.cone)))

    def eased(self, start, first, share, places):
        """Interpolate the direction, or the place, from the start to the first goal; a cone is widened instead."""
        if self.cone:
            return _wider(self, start, first, share)
        if self.looks_from_m is not None:
            there = start[3:6] + np.linalg.norm(first[:3] - start[3:6]) * start[:3]
            eased = there + share[:, None] * (first[:3] - there)
        else:
            turn = least_turn(start[:3], first[:3])
            eased = scipy.spatial.transform.Rotation.from_rotvec(share[:, None] * turn).apply(np.array(start[:3]))
        return np.column_stack([eased, np.zeros(len(eased))])

    def interpolated(self, goals, share, places=None):
        """Interpolate directions by rotation, and a place that the axis points at linearly."""
        found = mixed(goals, share)
        if self.looks_from_m is None:
            found[:, :3] = turned_directions(goals[:, 0, :3], goals[:, 1, :3], share)
        return found

    def turn(self, goals, least=False):
        """Return the angle between the directions of two goals [rad]; 0 if the axis points at a place."""
        if self.looks_from_m is not None:
            return np.zeros(len(goals))
        a, b = goals[:, 0, :3], goals[:, 1, :3]
        found = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))
        return np.maximum(found - least * goals[..., 3:].sum(axis=(1, 2)), 0.0)

    def _direction(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Vector3:
        if self.looks_from_m is None:
            return goal[:3]
        ahead = goal[:3] - value[3:6]
        return ahead / jnp.maximum(safe_norm(ahead), 1e-12)


@dataclass(frozen=True)
class FrameOrientation(Row):
    """A frame of the arm that must have a given rotation: exactly, or within an angle.

    A goal is the rotation matrix, row by row, and with a tolerance its angle [rad].
    """

    link: int | None  # link to which the frame is fixed; None: the TCP's frame
    columns: tuple[Triple, Triple, Triple] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))  # the frame's axes
    cone: bool = False
    seen_from: ArmFrame | None = None  # frame of a goal's rotation; None: the chain's root

    angular: ClassVar[bool] = True
    turns: ClassVar[bool] = True

    @property
    def features(self) -> tuple[Feature, ...]:
        """The three axes of the frame."""
        axes = (Feature(self.link, column, is_direction=True, seen_from=self.seen_from) for column in self.columns)
        return tuple(axes)

    @property
    def equalities(self) -> int:
        """Number of equations: three without a tolerance."""
        return 0 if self.cone else 3

    @property
    def inequalities(self) -> int:
        """Number of inequalities: one with a tolerance."""
        return int(self.cone)

    @property
    def numbers(self) -> int:
        """Number of coordinates of a goal."""
        return 9 + self.cone

    def error(self, value: Float[Array, "9"], goal: Float[Array, "g"]) -> Float[Array, "m"]:
        """Return the rotation vector from the frame to the goal's rotation [rad]."""
        return jnp.zeros(0) if self.cone else self._to_go(value, goal)

    def slack(self, value: Float[Array, "9"], goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the angle tolerance minus the angle to the goal's rotation [rad]."""
        return (goal[-1] - safe_norm(self._to_go(value, goal)))[None] if self.cone else jnp.zeros(0)

    def aim(self, value: Float[Array, "9"], goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the angle inside the tolerance at which a step aims [rad]."""
        return jnp.broadcast_to(jnp.minimum(AIM_RAD, AIM_SHARE * goal[-1]), (self.inequalities,))

    def between(self, goals: Float[Array, "2 g"], tolerance_m: float, tolerance_rad: float) -> Region:
        """Return the region of frames within the angles and the tolerance."""
        limit = goals[:, 9] if self.cone else jnp.zeros(2)
        return allowed_frames(*goals[:, :9].reshape(2, 3, 3), limit, tolerance_rad)

    def drawn(self, rng: np.random.Generator) -> Float[np.ndarray, "g"]:
        """Return a random rotation."""
        return np.append(scipy.spatial.transform.Rotation.random(rng=rng).as_matrix().ravel(), np.ones(int(self.cone)))

    def eased(self, start, first, share, places):
        """Interpolate the rotation from the start to the first goal; an angle tolerance is widened instead."""
        if self.cone:
            return _wider(self, start, first, share)
        transform = scipy.spatial.transform
        both = transform.Rotation.from_matrix(np.stack([start.reshape(3, 3).T, first.reshape(3, 3)]))
        return transform.Slerp([0.0, 1.0], both)(share).as_matrix().reshape(-1, 9)

    def interpolated(self, goals, share, places=None):
        """Interpolate the rotation matrices of the goals by rotation, and an angle tolerance linearly."""
        found, each = mixed(goals, share), goals[..., :9].reshape(-1, 2, 3, 3)
        found[:, :9] = turned_frames(each[:, 0], each[:, 1], share).reshape(-1, 9)
        return found

    def turn(self, goals, least=False):
        """Return the angle between the rotations of two goals [rad]."""
        each = goals[..., :9].reshape(-1, 2, 3, 3)
        found = np.linalg.norm(frame_turns(each[:, 0], each[:, 1]), axis=1)
        return np.maximum(found - least * goals[..., 9:].sum(axis=(1, 2)), 0.0)

    def _to_go(self, value: Float[Array, "9"], goal: Float[Array, "g"]) -> Vector3:
        return rotation_vector(product(goal[:9].reshape(3, 3), value.reshape(3, 3)))  # value: the axes are rows


def _wider(
    row: Row, start: Float[np.ndarray, "v"], first: Float[np.ndarray, "g"], share: Float[np.ndarray, "A"]
) -> Float[np.ndarray, "A g"]:
    """Return the first goal with other half angles: they decrease from one that the start satisfies to the goal's."""
    goals = np.tile(first, (len(share), 1))
    short = max(-float(np.asarray(_SLACK(row, np.asarray(start), np.asarray(first)))[0]), 0.0)
    goals[:, -1] += (1.0 - share) * (short + 2 * AIM_RAD) + SLACK * (share < 1.0)
    return goals


_SLACK = jax.jit(lambda row, value, goal: row.slack(value, goal), static_argnums=0)
