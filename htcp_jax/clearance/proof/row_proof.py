"""Proof that the rows of a task are satisfied between two targets, on an interval of a straight joint path.

Each row defines its allowed region between the targets, see `model.row_bounds`. This module bounds the motion of the
row's features, to second order. The slack of a row is the displacement that the row still allows: of its point [m], or
of the ends of its unit vectors. A motion whose deviation from the joint path is below the slack satisfies the row, see
`trajectory.row_slack`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance.proof.motion_bound import JointSweep, point_bend_bound
from htcp_jax.model import (
    Feature,
    FeatureMotion,
    Region,
    Robot,
    Row,
    RowSlack,
    Task,
    TaskPoint,
    feature_at,
    kinematics,
    moved_by,
)
from htcp_jax.types import Array, Float, Joints, Scalar, Vector3

IN_TUBE = TaskPoint()  # the row that constrains the TCP's position, which the tube bounds


def between(task: Task, goals: Float[Array, "2 G"]) -> tuple[Region | None, ...]:
    """Return the allowed region of every part of a task between two targets.

    The region is None for the part that constrains the TCP's position, which the tube bounds.

    Args:
        task: The task.
        goals: The task's goals at the two targets.
    """
    return tuple(
        None
        if part == IN_TUBE
        else part.between(goals[:, start : start + part.numbers], task.tolerance_m, task.tolerance_rad)
        for start, part in zip(task.starts, task.parts, strict=True)
    )


def checked(parts: tuple[Row, ...]) -> tuple[Row, ...]:
    """Return the parts of a task that `row_slacks` covers: all but the TCP's position."""
    return tuple(part for part in parts if part != IN_TUBE)


def row_slacks(
    robot: Robot,
    parts: tuple[Row, ...],
    requested: tuple[Region | None, ...],
    x: Joints,
    rates: Joints,
    half: Scalar,
) -> RowSlack:
    """Return the slack of each part in `checked(parts)` on a straight joint path.

    Args:
        robot: The robot.
        parts: All parts of the task.
        requested: The parts' allowed regions, see `between`.
        x: The middle of the path x + s `rates` [rad or m].
        rates: The path's derivative in s [rad or m].
        half: Largest |s|.
    """
    given = [(part, own) for part, own in zip(parts, requested, strict=True) if own is not None]
    found = [own.left(_FeatureSweep(robot, part.features, x, rates, half)) for part, own in given]
    return RowSlack(*(jnp.stack(each) for each in zip(*found, strict=True)))


@dataclass(frozen=True)
class _FeatureSweep(FeatureMotion):
    """Features on the joint path x + s rates with |s| <= half."""

    robot: Robot
    features: tuple[Feature, ...]
    x: Joints
    rates: Joints
    half: Scalar

    @property
    def turning(self) -> Scalar:
        """Sum of the hinges' |rates| [rad], without hinges on side branches that move no feature."""
        still, rates = jnp.asarray(self.robot.slides), kinematics.joint_rates(self.robot, self.rates)
        if self.robot.coupling is not None:
            frames = [f.link for f in self.features] + [f.seen_from.link for f in self.features if f.seen_from]
            links = [self.robot.tcp_link if link is None else link for link in frames]
            still |= ~moved_by(self.robot.parents)[links].any(axis=0)
        return jnp.sum(jnp.where(still, 0.0, jnp.abs(rates)))

    @property
    def fastest(self) -> Scalar:
        """Largest |rate| of a joint [rad or m]."""
        return jnp.max(jnp.abs(kinematics.joint_rates(self.robot, self.rates)))

    def moving(self, k: int) -> tuple[Vector3, Vector3]:
        """Return the position or direction of feature number k at x, and its derivative in s."""
        return jax.jvp(partial(feature_at, self.robot, feature=self.features[k]), (self.x,), (self.rates,))

    def bend(self, k: int) -> Scalar:
        """Return a bound on the second derivative in s of feature number k, a point [m]."""
        feature, (point, _) = self.features[k], self.moving(k)
        link = self.robot.tcp_link if feature.link is None else feature.link
        return point_bend_bound(self.robot, self.x, JointSweep(self.rates, self.half), point[None], np.array([link]))[0]

    def velocity(self, function: Callable) -> tuple[Array, Array]:
        """Return the value of a function of the features' vectors at x, and its derivative in s."""

        def of(x: Joints) -> Array:
            return function(*(feature_at(self.robot, x, feature) for feature in self.features))

        return jax.jvp(of, (self.x,), (self.rates,))
