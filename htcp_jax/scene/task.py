"""The task: M equations that hold the end of the arm where the path wants it, equation (7).

    error(x) = target - value(x) = 0        with the Jacobian d value / dx, M x N

A row is a world coordinate of a point of the arm; the paper's task is the three of the TCP. Several points, or fewer
coordinates, make other tasks. With N - M = 0 the arm has no freedom left, and no null space. Nobody else forms an
error, or says when it is small enough.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.numerics import safe_norm
from htcp_jax.scene.kinematics import jacobian, point_jacobians, point_positions, tcp_position
from htcp_jax.scene.robot import Robot
from htcp_jax.types import Anywhere, Array, Float, Joints, Scalar

XYZ = (0, 1, 2)
Numbers = Anywhere | np.generic | float | bool


@dataclass(frozen=True)
class TaskPoint:
    """A point of the arm and the world coordinates of it that are held. Raises InputError for none, or for others."""

    link: int | None = None  # that it is fixed to; None: the TCP
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # in the frame of the link; the TCP has none
    axes: tuple[int, ...] = XYZ  # of the world: 0, 1, 2 are x, y, z

    def __post_init__(self):
        if not self.axes or sorted(set(self.axes)) != list(self.axes) or not set(self.axes) <= set(XYZ):
            raise InputError(f"the axes of a task point are {self.axes}; valid: some of 0, 1, 2, in this order")
        if self.link is None and any(self.offset_m):
            raise InputError("the TCP has no offset of its own: name the link that the point is fixed to")

    def position(self, robot: Robot, x: Joints) -> Float[Array, "m"]:
        """Its coordinates that are held [m]."""
        if self.link is None:
            return self._held(tcp_position(robot, x))
        return self._held(point_positions(robot, x, jnp.asarray(self.offset_m)[None], (self.link,))[0])

    def jacobian(self, robot: Robot, x: Joints) -> Float[Array, "m N"]:
        """Their derivatives [m/rad or m/m]."""
        if self.link is None:
            return self._held(jacobian(robot, x))
        point = point_positions(robot, x, jnp.asarray(self.offset_m)[None], (self.link,))
        return self._held(point_jacobians(robot, x, point, (self.link,))[0])

    def _held(self, rows: Array) -> Array:
        return rows if self.axes == XYZ else rows[jnp.asarray(self.axes)]


@jax.tree_util.register_static
@dataclass(frozen=True)
class Task:
    """The constraint on the arm: the points that it holds, and how near is near enough. Static: a target is data."""

    points: tuple[TaskPoint, ...] = (TaskPoint(),)
    tolerance_m: float = 1e-3  # of the norm of the error

    @property
    def rows(self) -> int:
        """M."""
        return sum(len(point.axes) for point in self.points)

    def freedom(self, robot: Robot) -> int:
        """D = N - M, the dimension of the null space. Raises InputError for more rows than joints."""
        joints = len(robot.slides)
        if self.rows > joints:
            raise InputError(f"the task has {self.rows} rows, the robot {robot.name} has {joints} joints")
        return joints - self.rows

    def value(self, robot: Robot, x: Joints) -> Float[Array, "M"]:
        """What the target is compared with [m]."""
        return _joined([point.position(robot, x) for point in self.points])

    def jacobian(self, robot: Robot, x: Joints) -> Float[Array, "M N"]:
        """d value / dx [m/rad or m/m]; the paper's Jac(x)."""
        return _joined([point.jacobian(robot, x) for point in self.points])

    def error(self, value: Float[Array, "M"], target: Float[Array, "M"]) -> Float[Array, "M"]:
        """Delta C = C_next - C_ref of equation (7) [m]."""
        return target - value

    def residual(self, value: Float[Array, "M"], target: Float[Array, "M"]) -> Scalar:
        """The error's norm [m], which a plan records."""
        return safe_norm(self.error(value, target))

    def off(self, robot: Robot, x: Joints, target: Float[Array, "M"]) -> Scalar:
        """The residual at x [m]."""
        return self.residual(self.value(robot, x), target)

    @property
    def fine_m(self) -> float:
        """The residual that inverse kinematics stops at [m]: a tenth of the tolerance."""
        return 0.1 * self.tolerance_m

    def reached(self, residual: Numbers) -> Numbers:
        """Whether the residual [m] is within the tolerance; elementwise, numpy or JAX."""
        return residual <= self.tolerance_m

    def counts(self, clearance: Numbers, residual: Numbers, margin_m: Numbers) -> Numbers:
        """Whether a configuration counts: D > 0 and D >= margin_m [m], and the target reached; elementwise.

        Everything that accepts or refuses a configuration asks here, on the host and on the device alike. A margin of 0
        asks for D > 0, as the paper does: touching is not clear.
        """
        return (clearance > 0) & (clearance >= margin_m) & self.reached(residual)


TCP_POSITION = Task()  # the paper's


def _joined(parts: list[Array]) -> Array:
    return parts[0] if len(parts) == 1 else jnp.concatenate(parts)
