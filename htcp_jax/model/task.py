"""The task: M equations that constrain the arm at a target, equation (1), and B inequalities.

    error(x) = 0        M rows, with the Jacobian -d error / dx, M x N; the paper's are target - Gamma(x) of the TCP
    slack(x) >= 0       B rows: cones and bands

The kinds of rows are in `task_rows`. A row compares features of the arm, whose `value` depends only on x, with the
numbers of a target's goal. If N - M = 0, the arm has no redundancy and no null space. This module alone defines errors
and their tolerances.
"""

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.model.built_in_rows import AxisTowards
from htcp_jax.model.kinematics import (
    direction_jacobians,
    directions,
    jacobian,
    point_jacobians,
    point_positions,
    tcp_position,
)
from htcp_jax.model.robot import ArmFrame, Robot
from htcp_jax.model.task_rows import XYZ, Feature, Row, TaskPoint
from htcp_jax.numerics import product, safe_norm
from htcp_jax.types import Anywhere, Array, Float, Int, Joints, Scalar

Numbers = Anywhere | np.generic | float | bool
EXACT = 1e-9  # [m or rad]; smaller violations of an inequality are rounding


class TaskLinear(NamedTuple):
    """A task at one configuration, to first order; angles are converted to lengths, see `Task`."""

    error: Float[Array, "M"]  # the error that a step must remove [m]
    jacobian: Float[Array, "M N"]  # [m/rad or m/m]; the paper's Jac(x)
    slack: Float[Array, "B"]  # slack minus the small distance inside the inequality at which a step aims [m]
    gradient: Float[Array, "B N"]  # gradient of the slack [m/rad or m/m]


@jax.tree_util.register_static
@dataclass(frozen=True)
class Task:
    """The constraint on the arm: its rows and their tolerances. A task is static in JAX; its goals are data.

    Angles are converted to lengths by the factor tolerance_m / tolerance_rad. One number, the residual [m], then
    measures how far a configuration is from satisfying the task.
    """

    parts: tuple[Row, ...] = (TaskPoint(),)
    tolerance_m: float = 1e-3  # tolerance of the norm of the error
    tolerance_rad: float = 2e-3  # tolerance of angles

    @property
    def rows(self) -> int:
        """Number of equations, M."""
        return sum(part.equalities for part in self.parts)

    @property
    def bands(self) -> int:
        """Number of inequalities, B."""
        return sum(part.inequalities for part in self.parts)

    @property
    def values(self) -> int:
        """Number of coordinates of all features, V."""
        return sum(len(feature.rows) for feature in self._features)

    @property
    def numbers(self) -> int:
        """Number of coordinates of a goal, G."""
        return sum(part.numbers for part in self.parts)

    @property
    def sampled(self) -> bool:
        """True if a row has no bound on its error between two configurations: edges are then checked at samples."""
        return any(part.sampled for part in self.parts)

    @property
    def is_points(self) -> bool:
        """True if all rows are world coordinates of points; a goal then consists of these coordinates."""
        return all(isinstance(part, TaskPoint) for part in self.parts)

    @property
    def holds_tcp(self) -> bool:
        """True if the TCP's position is a row of the task."""
        return TaskPoint() in self.parts

    def tcp_place(self, goal: Float[Anywhere, "*S G"]) -> Float[Anywhere, "*S 3"]:
        """Return the TCP position in a goal, in the world [m]; only for a task with `holds_tcp`."""
        start = self.starts[self.parts.index(TaskPoint())]
        return goal[..., start : start + 3]

    def interpolated(
        self,
        goals: Float[np.ndarray, "n 2 G"],
        share: Float[np.ndarray, "n"],
        places: Float[np.ndarray, "n 2 3"] | None = None,
    ) -> Float[np.ndarray, "n G"]:
        """Interpolate goals between two targets: positions linearly, directions and frames by rotation.

        Args:
            goals: Goals at both targets.
            share: Share of the segment from the first target to the second [1].
            places: Positions of the targets, world [m]; None: unknown.
        """
        parts = zip(self.parts, self.starts, strict=True)
        return np.concatenate(
            [part.interpolated(goals[..., at : at + part.numbers], share, places) for part, at in parts], axis=1
        )

    def turn(self, goals: Float[np.ndarray, "n 2 G"], least: bool = False) -> Float[np.ndarray, "n"]:
        """Return the largest angle, over all rows, between the orientations that two goals require [rad].

        Args:
            goals: The two goals.
            least: True to subtract the half angles of both goals' cones: by the rest the arm must turn.
        """
        parts = zip(self.parts, self.starts, strict=True)
        return np.max([part.turn(goals[..., at : at + part.numbers], least) for part, at in parts], axis=0)

    @cached_property
    def for_either(self) -> "Task":
        """The task of compiled functions that serve axes with and without a cone, see `AxisTowards.is_either`."""
        parts = (part.either if isinstance(part, AxisTowards) else part for part in self.parts)
        return replace(self, parts=tuple(parts))

    def of_link(self, link: int, other: int) -> tuple["Task", Int[np.ndarray, "g"], tuple[int, ...]]:
        """Return the rows that depend only on the pose of one link, as rows about a link of another robot.

        Args:
            link: The link; it carries the TCP.
            other: The link of the other robot that replaces it.

        Returns:
            The task, the indices of its numbers in a goal of this task, and the rows, counted from 1, that it lacks.
        """
        parts, numbers, missing = [], [], []
        for k, (part, start) in enumerate(zip(self.parts, self.starts, strict=True), 1):
            if any(each.link not in (link, None) or each.seen_from is not None for each in part.features):
                missing.append(k)
                continue
            moved = {}
            for field in fields(part):
                value = getattr(part, field.name)
                if field.name == "link" and value is not None:
                    moved["link"] = other
                elif isinstance(value, ArmFrame) and value.link is not None:
                    moved[field.name] = value._replace(link=other)
            parts.append(replace(part, **moved))
            numbers += range(start, start + part.numbers)
        return replace(self, parts=tuple(parts)), np.array(numbers, int), tuple(missing)

    @property
    def optional(self) -> int:
        """Number of equations whose rows may be 0, see `for_either`."""
        return sum(part.equalities for part in self.parts if isinstance(part, AxisTowards) and part.is_either)

    def own_rows(self, every: TaskLinear) -> TaskLinear:
        """Return the rows that this task has, of tables of all rows of `for_either` (n, rows, ...)."""
        pairs = [*zip(self.parts, self.for_either.parts, strict=True)]
        equations = np.repeat([own.equalities > 0 for own, _ in pairs], [each.equalities for _, each in pairs])
        others = np.repeat([own.inequalities > 0 for own, _ in pairs], [each.inequalities for _, each in pairs])
        return TaskLinear(*(each[:, equations] for each in every[:2]), *(each[:, others] for each in every[2:]))

    @property
    def starts(self) -> tuple[int, ...]:
        """Index of each row's first number in a goal."""
        return tuple(np.cumsum([0, *(part.numbers for part in self.parts[:-1])]).tolist())

    @property
    def _features(self) -> tuple[Feature, ...]:
        return tuple(feature for part in self.parts for feature in part.features)

    def freedom(self, robot: Robot) -> int:
        """Return the dimension of the null space, D = N - M, where M does not count optional equations.

        Raises:
            InputError: For more equations than joints.
        """
        joints, rows = robot.dof, self.rows - self.optional
        if rows > joints:
            raise InputError(f"the task has {rows} equations, more than the {joints} joints of robot {robot.name}")
        return joints - rows

    def value(self, robot: Robot, x: Joints) -> Float[Array, "V"]:
        """Return the coordinates of the arm's features at x [rad or m]: points [m], directions without a unit."""
        return _concatenated([_rows_of_feature(feature, feature_at(robot, x, feature)) for feature in self._features])

    def jacobian(self, robot: Robot, x: Joints) -> Float[Array, "V N"]:
        """Return d value / dx [m/rad or m/m; 1/rad for directions]."""
        return _concatenated(
            [_rows_of_feature(feature, _feature_jacobian(robot, x, feature)) for feature in self._features]
        )

    def linear(self, value: Float[Array, "V"], slopes: Float[Array, "V N"], goal: Float[Array, "G"]) -> TaskLinear:
        """Return the rows to first order, equation (7).

        Args:
            value: The features' value: points [m], and directions without a unit.
            slopes: The features' Jacobian [m/rad or m/m, of directions 1/rad].
            goal: The goal, in the format of the rows, in metres and without a unit.
        """
        if self.is_points:
            return TaskLinear(goal - value, slopes, jnp.zeros(0), jnp.zeros((0, slopes.shape[1])))
        error, slack = self.error(value, goal), self._slack(value, goal) - self._together("aim", value, goal)
        return TaskLinear(
            error,
            product(-jax.jacfwd(self.error)(value, goal), slopes),
            slack,
            product(jax.jacfwd(self._slack)(value, goal), slopes),
        )

    def linear_at(self, robot: Robot, x: Joints, goal: Float[Array, "G"]) -> TaskLinear:
        """Return the rows to first order at x [rad or m].

        Args:
            robot: The robot.
            x: The configuration.
            goal: The goal, in the format of the rows, in metres and without a unit.
        """
        return self.linear(self.value(robot, x), self.jacobian(robot, x), goal)

    def error(self, value: Float[Array, "V"], goal: Float[Array, "G"]) -> Float[Array, "M"]:
        """Return the error Delta C = C_next - C_ref of equation (9) [m]; angles are converted to lengths."""
        return goal - value if self.is_points else self._together("error", value, goal)

    def slack(self, value: Float[Array, "V"], goal: Float[Array, "G"]) -> Scalar:
        """Return the smallest slack of all bands and cones [m]; infinite if the task has none."""
        return jnp.min(self._slack(value, goal), initial=jnp.inf)

    def residual(self, value: Float[Array, "V"], goal: Float[Array, "G"]) -> Scalar:
        """Return the residual [m]: the norm of the error.

        If a band or cone is violated, the violation and the tolerance are added.
        """
        off = safe_norm(self.error(value, goal))
        if not self.bands:
            return off
        broken = -self.slack(value, goal)
        return jnp.where(broken > EXACT, off + broken + self.tolerance_m, off)

    @property
    def holds_angles(self) -> bool:
        """True if an axis or a frame is an equality, so that the residual is not only a distance."""
        return any(part.angular and part.equalities for part in self.parts)

    def errors(self, robot: Robot, x: Joints, goal: Float[Array, "G"]) -> tuple[Scalar, Scalar]:
        """Return the two parts of the residual: the points' distance from their goals [m], the largest angle [rad]."""
        value, v = self.value(robot, x), 0
        lengths, angles = [jnp.zeros(0)], [jnp.zeros(())]
        for start, part in zip(self.starts, self.parts, strict=True):
            size = part.size
            error = part.error(value[v : v + size], goal[start : start + part.numbers])
            (angles if part.angular else lengths).append(safe_norm(error) if part.angular else error)
            v += size
        return safe_norm(jnp.concatenate(lengths)), jnp.max(jnp.stack(angles))

    def residual_at(self, robot: Robot, x: Joints, goal: Float[Array, "G"]) -> Scalar:
        """Return the residual at x [m]."""
        return self.residual(self.value(robot, x), goal)

    def least_turn(self, robot: Robot, rotation: Float[Array, "3 3"], goal: Float[Array, "G"]) -> Scalar:
        """Return a lower bound on the angle by which the last link must rotate to satisfy every row [rad].

        Only rows that depend solely on the last link's orientation are considered. The bound is valid because a
        rotation by an angle changes the direction of no axis by more than this angle.

        Args:
            robot: The robot.
            rotation: The link's initial orientation in the world.
            goal: The goal, in the format of the rows.
        """
        found = [jnp.zeros(())]
        for start, part in zip(self.starts, self.parts, strict=True):
            if part.turns and all(_turns_with_last(robot, feature) for feature in part.features):
                axes = [product(rotation, _fixed(robot, feature)[0]) for feature in part.features]
                value, own = jnp.concatenate(axes), goal[start : start + part.numbers]
                found += [-each for each in part.slack(value, own)] if part.inequalities else []
                found += [safe_norm(part.error(value, own)) - self.tolerance_rad] if part.equalities else []
        return jnp.max(jnp.stack(found))

    @property
    def fine_m(self) -> float:
        """Residual at which inverse kinematics stops [m]: a tenth of the tolerance."""
        return 0.1 * self.tolerance_m

    def reached(self, residual: Numbers) -> Numbers:
        """Return True where the residual [m] is within the tolerance; elementwise, numpy or JAX."""
        return residual <= self.tolerance_m

    def is_satisfied(self, clearance: Numbers, residual: Numbers, margin_m: Numbers) -> Numbers:
        """Return True where a configuration is accepted; elementwise, numpy or JAX.

        This is the only acceptance test, on the host and on the device: D > 0, D >= margin_m, and a residual within the
        tolerance. A margin of 0 requires D > 0, as in the paper: contact is not accepted.

        Args:
            clearance: The clearance D [m].
            residual: The residual [m].
            margin_m: Required clearance.
        """
        return (clearance > 0) & (clearance >= margin_m) & self.reached(residual)

    def _slack(self, value: Array, goal: Array) -> Float[Array, "B"]:
        return self._together("slack", value, goal)

    def _together(self, what: str, value: Array, goal: Array) -> Array:
        """Return the quantity `what` of all rows, concatenated; angles are converted to lengths."""
        found, v, g = [], 0, 0
        for part in self.parts:
            size = part.size
            rows = getattr(part, what)(value[v : v + size], goal[g : g + part.numbers])
            found.append(rows * (self.tolerance_m / self.tolerance_rad) if part.angular else rows)
            v, g = v + size, g + part.numbers
        return _concatenated(found)


TCP_POSITION = Task()  # the paper's task


def feature_at(robot: Robot, x: Joints, feature: Feature) -> Float[Array, "3"]:
    """Return all three coordinates of a feature in the world: a position [m] or a unit direction.

    If the part moves, coordinates are in the frame of the part's link. A direction with `seen_from` is in that frame.
    """
    if _is_tcp(feature):
        return tcp_position(robot, x)
    vector, links = _fixed(robot, feature)
    found = (directions if feature.is_direction else point_positions)(robot, x, vector[None], links)[0]
    return found if feature.seen_from is None else product(_axes(robot, x, feature.seen_from), found)


def _feature_jacobian(robot: Robot, x: Joints, feature: Feature) -> Float[Array, "3 N"]:
    if _is_tcp(feature):
        return jacobian(robot, x)
    of = direction_jacobians if feature.is_direction else point_jacobians
    vector, links = _fixed(robot, feature)
    if feature.seen_from is None:
        return of(robot, x, feature_at(robot, x, feature)[None], links)[0]
    found, axes = directions(robot, x, vector[None], links), _axes(robot, x, feature.seen_from)
    turning = direction_jacobians(robot, x, axes, 3 * (feature.seen_from.link,))
    return product(axes, of(robot, x, found, links)[0]) + jnp.sum(found[:, :, None] * turning, axis=1)


def _is_tcp(feature: Feature) -> bool:
    return feature.link is None and not feature.is_direction and not any(feature.vector)


def _axes(robot: Robot, x: Joints, frame: ArmFrame) -> Float[Array, "3 3"]:
    """Return a frame's axes at x, one per row."""
    return directions(robot, x, jnp.asarray(frame.columns), 3 * (frame.link,))


def _turns_with_last(robot: Robot, feature: Feature) -> bool:
    last = feature.link in (None, robot.tcp_link)
    return last and feature.is_direction and feature.seen_from is None


def _fixed(robot: Robot, feature: Feature) -> tuple[Float[Array, "3"], tuple[int]]:
    """Return a feature's vector in the frame of its link, and the link; features of the TCP are on the last link."""
    vector = jnp.asarray(feature.vector)
    if feature.link is not None:
        return vector, (feature.link,)
    T = robot.T_link_tcp
    turned = product(T[:3, :3], vector)
    return (turned if feature.is_direction else turned + T[:3, 3]), (robot.tcp_link,)


def _rows_of_feature(feature: Feature, rows: Array) -> Array:
    return rows if feature.rows == XYZ else rows[jnp.asarray(feature.rows)]


def _concatenated(parts: list[Array]) -> Array:
    return parts[0] if len(parts) == 1 else jnp.concatenate(parts)
