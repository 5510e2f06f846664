"""Proof that the rows of a task hold between two targets, on an interval of a straight joint path.

Each row states its allowed region between the targets, see `model.row_bounds`; here are the bounds on the motion of its
features, to second order. A row's slack is the displacement of the point [m], or of the vectors as a chord, that it
still permits: a motion that stays that close to the joint path satisfies the row, see `trajectory.row_slack`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance.proof.motion_bound import point_bend_bound
from htcp_jax.model import Robot, Task, row_bounds, task_rows
from htcp_jax.model import task as tasks
from htcp_jax.types import Array, Bool, Float, Joints, Scalar, Vector3

IN_TUBE = task_rows.TaskPoint()  # the TCP at a place, which its tube constrains


def between(task: Task, goals: Float[Array, "2 G"]) -> tuple[row_bounds.Region | None, ...]:
    """Return the constraint of every part of a task between two targets; None for the TCP at a place.

    Args:
        task: The task.
        goals: The goals of the two targets.
    """
    return tuple(
        None
        if part == IN_TUBE
        else part.between(goals[:, start : start + part.numbers], task.tolerance_m, task.tolerance_rad)
        for start, part in zip(task.starts, task.parts, strict=True)
    )


def checked(parts: tuple[task_rows.Row, ...]) -> tuple[task_rows.Row, ...]:
    """Return the parts of a task that `row_slack` covers."""
    return tuple(part for part in parts if part != IN_TUBE)


def rows_left(
    robot: Robot,
    parts: tuple[task_rows.Row, ...],
    requested: tuple[row_bounds.Region | None, ...],
    x: Joints,
    rates: Joints,
    half: Scalar,
) -> row_bounds.RowSlack:
    """Return the slack of each of the `checked` parts on a straight joint path.

    Args:
        robot: The robot.
        parts: All parts of the task.
        requested: Their constraints, see `between`.
        x: The middle of the path x + s `rates` [rad or m].
        rates: Its derivative in s [rad or m].
        half: Largest |s|.
    """
    given = [(part, own) for part, own in zip(parts, requested, strict=True) if own is not None]
    found = [own.left(_FeatureSweep(robot, part.features, x, rates, half)) for part, own in given]
    return row_bounds.RowSlack(*(jnp.stack(each) for each in zip(*found, strict=True)))


def rows_hold(
    robot: Robot,
    parts: tuple[task_rows.Row, ...],
    requested: tuple[row_bounds.Region | None, ...],
    x: Joints,
    rates: Joints,
    half: Scalar,
) -> tuple[Bool[Array, "P"], Bool[Array, "P"]]:
    """Return True for parts proven to hold on the joint path of `row_slack`, and True for parts violated at x."""
    found = rows_left(robot, parts, requested, x, rates, half)
    return found.left >= 0, found.broken


@dataclass(frozen=True)
class _FeatureSweep(row_bounds.FeatureMotion):
    """Features on the joint path x + s rates with |s| <= half."""

    robot: Robot
    features: tuple[task_rows.Feature, ...]
    x: Joints
    rates: Joints
    half: Scalar

    @property
    def turning(self) -> Scalar:
        """Sum of the hinges' turns."""
        return jnp.sum(jnp.where(np.array(self.robot.slides), 0.0, jnp.abs(self.rates)))

    @property
    def fastest(self) -> Scalar:
        """Largest joint change."""
        return jnp.max(jnp.abs(self.rates))

    def moving(self, k: int) -> tuple[Vector3, Vector3]:
        """Return a feature's position or direction, and its velocity."""
        return jax.jvp(partial(tasks.feature_at, self.robot, feature=self.features[k]), (self.x,), (self.rates,))

    def bend(self, k: int) -> Scalar:
        """Return a bound on the acceleration of a point."""
        feature, (point, _) = self.features[k], self.moving(k)
        link = len(self.robot.slides) - 1 if feature.link is None else feature.link
        moves = self.half * jnp.abs(self.rates)
        return point_bend_bound(self.robot, self.x, self.rates, moves, point[None], jnp.array([link]))[0]

    def velocity(self, function: Callable) -> tuple[Array, Array]:
        """Return a function of the features' vectors, and its derivative."""

        def of(x: Joints) -> Array:
            return function(*(tasks.feature_at(self.robot, x, feature) for feature in self.features))

        return jax.jvp(of, (self.x,), (self.rates,))
