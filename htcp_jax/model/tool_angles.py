"""Row of a tool's angles along a path: work angle, travel angle and spin, see `spec.tool_angles`.

With t the path's tangent, n its normal, b = n x t, h the tool's direction from tip to handle, x the axis after the
tool's axis in the tool's frame, and y = h x x:

    tan(work) = h b / h n      tan(travel) = -h t / h n      tan(spin) = t y / t x

An angle is at least w if the vector (a, c) of its tangent a / c satisfies a cos w - c sin w >= 0. This is linear in the
features h, x and y, and the sine of the tool's angle to a plane: a rotation of the tool by an angle changes it by at
most this angle. A range of at most 180 degrees is the intersection of two such half-spaces; one angle is the plane
between them, with the side on which c > 0.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from htcp_jax.model.robot import ArmFrame
from htcp_jax.model.rotations import axis_error, frame_turns, turned_frames
from htcp_jax.model.row_bounds import HalfSpaces, half_way
from htcp_jax.model.task_rows import AIM_SHARE, Feature, Row, eased_offsets, mixed
from htcp_jax.numerics import product, safe_norm
from htcp_jax.spec import AIM_RAD
from htcp_jax.types import Array, Float, Scalar, Vector3

Limits = Literal["free", "value", "range"]
WORK, TRAVEL, SPIN = range(3)


@dataclass(frozen=True)
class ToolAngles(Row):
    """A tool's work angle, travel angle and spin along a path: each has one value, a range, or is free.

    A goal is the path's frame, row by row, with the columns t, b and n; then the lower and the upper bound of the three
    angles [rad]; then one offset for each error and slack, which is 0 on the path, see `task_rows.eased_offsets`.
    """

    frame: ArmFrame  # its columns are h, x and y
    limits: tuple[Limits, Limits, Limits]

    angular: ClassVar[bool] = True
    turns: ClassVar[bool] = True

    @property
    def features(self) -> tuple[Feature, ...]:
        """The tool's axis h; with a limited spin also x and y."""
        axes = self.frame.columns if self.limits[SPIN] != "free" else self.frame.columns[:1]
        return tuple(Feature(self.frame.link, axis, is_direction=True) for axis in axes)

    @property
    def equalities(self) -> int:
        """Number of equations: one for each angle with one value."""
        return self.limits.count("value")

    @property
    def inequalities(self) -> int:
        """Number of inequalities: two for each range, and one for each plane whose side no other angle determines."""
        return 2 * self.limits.count("range") + len(self._sides)

    @property
    def numbers(self) -> int:
        """Number of coordinates of a goal."""
        return 15 + self.equalities + self.inequalities

    @property
    def _sides(self) -> list[int]:
        """Angles with one value whose plane has a side on which the tool must be."""
        leaning = self.limits[:SPIN]
        sides = [leaning.index("value")] if sorted(leaning) == ["free", "value"] else []
        return [*sides, SPIN] if self.limits[SPIN] == "value" else sides

    def error(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "m"]:
        """Return the errors of the angles with one value [rad], to first order in small angles."""
        bounds = goal[9:15].reshape(3, 2)[:, 0]
        found = [axis_error(value[:3], self._direction(goal, bounds))] if self._is_direction else [jnp.zeros(0)]
        for k in self._angles("value"):
            if k == SPIN or not self._is_direction:
                found.append(_above(*self._parts(k, value, goal), bounds[k])[None])
        return jnp.concatenate(found) - goal[15 : 15 + self.equalities]

    def slack(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the slacks of the ranges and of the sides [rad], to first order in small angles."""
        return self._inside(value, goal) + goal[15 + self.equalities :]

    def aim(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the angle inside each inequality at which a step aims [rad]."""
        half = [self._half_width(goal, k) for k in self._angles("range") for _ in range(2)]
        return jnp.minimum(AIM_RAD, AIM_SHARE * _stacked([*half, *self._sides_free()]))

    def between(self, goals: Float[Array, "2 g"], tolerance_m: float, tolerance_rad: float) -> HalfSpaces:
        """Return the region: as required at one of both targets, or half way between them.

        Half way, each range is at least as wide as half of the frame's rotation from target to target.
        """
        middle, turn = half_way(*goals[:, :9].reshape(2, 3, 3))
        mean = jnp.concatenate([middle.ravel(), 0.5 * (goals[0, 9:] + goals[1, 9:])])
        turn = turn + jnp.max(jnp.abs(goals[1, 9:15] - goals[0, 9:15]))
        every = (goals[0], goals[1], mean)
        # All expressions are linear in the value, without a constant.
        vectors = jnp.stack([jax.jacfwd(lambda value, goal=goal: self._allowed(value, goal))(
            jnp.zeros(self.size)
        ) for goal in every])  # fmt: skip
        wider = jnp.stack([jnp.maximum(0.0, 0.5 * turn - half) for half in self._half_widths(mean)])
        beyond = tolerance_rad + jnp.stack([jnp.zeros(len(wider)), jnp.zeros(len(wider)), wider])
        return HalfSpaces(vectors, jnp.sin(jnp.minimum(beyond, 0.5 * np.pi)))

    def drawn(self, rng: np.random.Generator) -> Float[np.ndarray, "g"]:
        """Return a random frame, with angles of 0 and ranges of 0.2 rad."""
        frame = scipy.spatial.transform.Rotation.random(rng=rng).as_matrix().ravel()
        bounds = [(-0.1, 0.1) if limit == "range" else (0.0, 0.0) for limit in self.limits]
        return np.concatenate([frame, *bounds, np.zeros(self.numbers - 15)])

    def eased(self, start, first, share, places):
        """Return the first goal with offsets that decrease to 0; with the first offsets the start satisfies the row."""
        return eased_offsets(self, start, first, share)

    def interpolated(self, goals, share, places=None):
        """Interpolate the path's frames by rotation, and the angles' bounds linearly."""
        found, frames = mixed(goals, share), goals[..., :9].reshape(-1, 2, 3, 3)
        found[:, :9] = turned_frames(frames[:, 0], frames[:, 1], share).reshape(-1, 9)
        return found

    def turn(self, goals, least=False):
        """Return the angle between two goals' frames [rad].

        With `least`, it is the angle between the directions in the middle of the ranges, minus their half widths; 0 if
        the work angle or the travel angle is free.
        """
        frames = goals[..., :9].reshape(-1, 2, 3, 3)
        if not least:
            return np.linalg.norm(frame_turns(frames[:, 0], frames[:, 1]), axis=1)
        if "free" in self.limits[:SPIN]:
            return np.zeros(len(goals))
        bounds = goals[..., 9:13].reshape(-1, 2, 2, 2)  # scenario, target, angle, bound
        work, travel = np.tan(bounds.mean(axis=3)).transpose(2, 0, 1)
        d = np.stack([-travel, work, np.ones_like(work)], axis=-1)
        d = (frames @ (d / np.linalg.norm(d, axis=-1, keepdims=True))[..., None])[..., 0]
        apart = np.arctan2(np.linalg.norm(np.cross(d[:, 0], d[:, 1]), axis=1), (d[:, 0] * d[:, 1]).sum(axis=1))
        return np.maximum(apart - np.linalg.norm(np.diff(bounds, axis=3)[..., 0] / 2, axis=2).sum(axis=1), 0.0)

    @property
    def _is_direction(self) -> bool:
        """True if work angle and travel angle have one value each, so that h has one direction."""
        return self.limits[:SPIN] == ("value", "value")

    def _angles(self, limit: Limits) -> Iterator[int]:
        return (k for k in range(3) if self.limits[k] == limit)

    def _parts(self, k: int, value: Float[Array, "v"], goal: Float[Array, "g"]) -> tuple[Scalar, Scalar]:
        """Return numerator and denominator of an angle's tangent."""
        t, b, n = goal[:9].reshape(3, 3).T
        h = value[:3]
        if k == WORK:
            return product(b, h), product(n, h)
        if k == TRAVEL:
            return -product(t, h), product(n, h)
        return product(t, value[6:9]), product(t, value[3:6])

    def _inside(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the slacks without offsets."""
        bounds, found = goal[9:15].reshape(3, 2), []
        for k in self._angles("range"):
            parts = self._parts(k, value, goal)
            found += [_above(*parts, bounds[k, 0]), -_above(*parts, bounds[k, 1])]
        for k in self._sides:
            across, along = self._parts(k, value, goal)
            found.append(across * jnp.sin(bounds[k, 0]) + along * jnp.cos(bounds[k, 0]))
        return _stacked(found)

    def _allowed(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "c"]:
        """Return expressions that are at least 0 if the row is satisfied; an equation has two."""
        bounds, found = goal[9:15].reshape(3, 2)[:, 0], []
        for k in self._angles("value"):
            above = _above(*self._parts(k, value, goal), bounds[k])
            found += [above, -above]
        if self._is_direction:
            found.append(product(self._direction(goal, bounds), value[:3]))
        return jnp.concatenate([_stacked(found), self._inside(value, goal)])

    def _half_widths(self, goal: Float[Array, "g"]) -> list[Scalar]:
        """Return the half width of the region of each expression of `_allowed` [rad]; pi for a side."""
        equations = [jnp.zeros(())] * (2 * self.equalities)
        ranges = [self._half_width(goal, k) for k in self._angles("range") for _ in range(2)]
        return [*equations, *[jnp.array(np.pi)] * self._is_direction, *ranges, *self._sides_free()]

    def _sides_free(self) -> list[Scalar]:
        return [jnp.array(np.pi)] * len(self._sides)

    def _half_width(self, goal: Float[Array, "g"], k: int) -> Scalar:
        return 0.5 * (goal[10 + 2 * k] - goal[9 + 2 * k])

    def _direction(self, goal: Float[Array, "g"], angles: Float[Array, "3"]) -> Vector3:
        """Return the direction h with given work and travel angles [rad]."""
        local = jnp.stack([-jnp.tan(angles[TRAVEL]), jnp.tan(angles[WORK]), jnp.ones(())])
        return product(goal[:9].reshape(3, 3), local / safe_norm(local))


def _stacked(values: list[Scalar]) -> Float[Array, "n"]:
    return jnp.stack(values) if values else jnp.zeros(0)


def _above(across: Scalar, along: Scalar, bound: Scalar) -> Scalar:
    """Return the distance of the angle atan2(across, along) above a bound, as the sine of the tool's angle to it."""
    return across * jnp.cos(bound) - along * jnp.sin(bound)
