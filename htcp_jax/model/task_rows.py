"""Kinds of rows of a task: the features of the arm that each compares with its goal, and their errors.

Features are points and directions that are fixed to a link. From their values and the numbers of its goal at one
target, a row computes the deviation (`error`, an equality) or the slack (`room`, an inequality, violated below 0).
Kinds are static; goals are data, so a cone's angle may differ from scenario to scenario.

Errors of angles are rotation vectors, the logarithm map (Lynch and Park, Modern Robotics, section 3.2.3) [rad].
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import jax.numpy as jnp

from htcp_jax.errors import InputError
from htcp_jax.model.rotations import angle, axis_error, rotation_vector
from htcp_jax.numerics import product, safe_norm
from htcp_jax.types import Array, Float, Triple, Vector3

XYZ = (0, 1, 2)
AIM_RAD, AIM_M = 1e-3, 2e-4  # distance inside an inequality at which a step aims, as rows are linearised,
AIM_SHARE = 0.25  # but at most this share of the tolerance


class Feature(NamedTuple):
    """A point or a direction of the arm, in the world."""

    link: int | None  # to which it is fixed; None: the TCP's frame
    vector: Triple  # in that frame: of a point [m], of a direction of length 1
    is_direction: bool = False
    rows: tuple[int, ...] = XYZ  # the coordinates in use


@dataclass(frozen=True)
class TaskPoint:
    """A point of the arm and its constrained world coordinates; a goal is these coordinates [m].

    Raises:
        InputError: For no coordinates, for others than 0, 1, 2, and for an offset of the TCP.
    """

    link: int | None = None  # to which it is fixed; None: the TCP
    offset_m: Triple = (0.0, 0.0, 0.0)  # in the frame of the link; the TCP has none
    axes: tuple[int, ...] = XYZ  # of the world: 0, 1, 2 are x, y, z

    inequalities: ClassVar[int] = 0
    angular: ClassVar[bool] = False

    def __post_init__(self):
        if not self.axes or sorted(set(self.axes)) != list(self.axes) or not set(self.axes) <= set(XYZ):
            raise InputError(f"the axes of a task point are {self.axes}; valid: some of 0, 1, 2, in this order")
        if self.link is None and any(self.offset_m):
            raise InputError("the TCP has no offset of its own: name the link that the point is fixed to")

    @property
    def features(self) -> tuple[Feature, ...]:
        """The point."""
        return (Feature(self.link, self.offset_m, rows=self.axes),)

    @property
    def equalities(self) -> int:
        """Number of equations: one per coordinate."""
        return len(self.axes)

    @property
    def numbers(self) -> int:
        """Number of coordinates of a goal."""
        return len(self.axes)

    def error(self, value: Float[Array, "m"], goal: Float[Array, "m"]) -> Float[Array, "m"]:
        """Return the vector from the point to its goal [m]."""
        return goal - value

    def room(self, value: Float[Array, "m"], goal: Float[Array, "m"]) -> Float[Array, "0"]:
        """Return an empty array: there are no inequalities."""
        return jnp.zeros(0)

    aim = room


@dataclass(frozen=True)
class PointAlong:
    """A point of the arm that is constrained in `count` directions u: u p = offset, or within a band about that.

    A goal is u and the offset [m] of each direction and, with a band, its half width [m].
    """

    link: int | None
    offset_m: Triple
    count: int
    band: bool = False

    angular: ClassVar[bool] = False

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

    def room(self, value: Vector3, goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the slack to both sides of the band [m]."""
        if not self.band:
            return jnp.zeros(0)
        ahead = self._ahead(value, goal)
        return jnp.concatenate([goal[-1] - ahead, goal[-1] + ahead])

    def aim(self, value: Vector3, goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the distance inside the band at which a step aims [m]."""
        return jnp.broadcast_to(jnp.minimum(AIM_M, AIM_SHARE * goal[-1]), (self.inequalities,))

    def _ahead(self, point: Vector3, goal: Float[Array, "g"]) -> Float[Array, "count"]:
        each = goal[: 4 * self.count].reshape(self.count, 4)
        return each[:, 3] - product(each[:, :3], point)


@dataclass(frozen=True)
class AxisTowards:
    """An axis of the arm turned in a direction, or from `looks_from_m` towards a place: exactly, or within a cone.

    A goal is the direction, or the place [m], and with a cone its half angle [rad].
    """

    link: int | None
    axis: Triple  # of length 1, in the frame of the link
    looks_from_m: Triple | None = None  # origin of the view, in the frame of the link; None: no place
    cone: bool = True

    angular: ClassVar[bool] = True

    @property
    def features(self) -> tuple[Feature, ...]:
        """The axis and, if it points at a place, the point `looks_from_m`."""
        axis = Feature(self.link, self.axis, is_direction=True)
        return (axis,) if self.looks_from_m is None else (axis, Feature(self.link, self.looks_from_m))

    @property
    def equalities(self) -> int:
        """Number of equations: two without a cone, as an axis may turn about itself."""
        return 0 if self.cone else 2

    @property
    def inequalities(self) -> int:
        """Number of inequalities: one with a cone."""
        return int(self.cone)

    @property
    def numbers(self) -> int:
        """Number of coordinates of a goal."""
        return 3 + self.cone

    def error(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "m"]:
        """Return the rotation vector from axis to direction [rad], as two components perpendicular to the direction."""
        if self.cone:
            return jnp.zeros(0)
        return axis_error(value[:3], self._direction(value, goal))

    def room(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the angle from the axis to the cone [rad]."""
        if not self.cone:
            return jnp.zeros(0)
        return (goal[3] - angle(value[:3], self._direction(value, goal)))[None]

    def aim(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the angle inside the cone at which a step aims [rad]."""
        return jnp.broadcast_to(jnp.minimum(AIM_RAD, AIM_SHARE * goal[-1]), (self.inequalities,))

    def _direction(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Vector3:
        if self.looks_from_m is None:
            return goal[:3]
        ahead = goal[:3] - value[3:6]
        return ahead / jnp.maximum(safe_norm(ahead), 1e-12)


@dataclass(frozen=True)
class Turned:
    """A frame of the arm turned to a rotation: exactly, or within an angle.

    A goal is the rotation matrix, row by row, and with a tolerance the angle [rad].
    """

    link: int | None
    columns: tuple[Triple, Triple, Triple] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))  # the frame's axes
    cone: bool = False

    angular: ClassVar[bool] = True

    @property
    def features(self) -> tuple[Feature, ...]:
        """The three axes of the frame."""
        return tuple(Feature(self.link, column, is_direction=True) for column in self.columns)

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

    def room(self, value: Float[Array, "9"], goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the angle tolerance less the angle to the goal's rotation [rad]."""
        return (goal[-1] - safe_norm(self._to_go(value, goal)))[None] if self.cone else jnp.zeros(0)

    def aim(self, value: Float[Array, "9"], goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the angle inside the tolerance at which a step aims [rad]."""
        return jnp.broadcast_to(jnp.minimum(AIM_RAD, AIM_SHARE * goal[-1]), (self.inequalities,))

    def _to_go(self, value: Float[Array, "9"], goal: Float[Array, "g"]) -> Vector3:
        return rotation_vector(product(goal[:9].reshape(3, 3), value.reshape(3, 3)))  # value: the axes are rows


Row = TaskPoint | PointAlong | AxisTowards | Turned
