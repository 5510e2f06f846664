"""Allowed regions of a task row's features between two targets, and the slack that an interval of a motion leaves.

On a segment a row's goal lies between that of the previous target, 0, and that of this one, 1:

    a place       f_k = u_k p - o_k, its deviation in a direction by either: min f_k <= w and max f_k >= -w
    an axis       the angle to d_0, to d_1, or to the direction half way, is at most the limit
    a frame       so is the angle of the rotation to R_0, to R_1, or to the rotation half way
    a view        so is the angle to the direction of the place
    any other     error and slack by goal 0, by goal 1, or by the numbers half way

w is the band plus the tolerance of lengths; the limit is the half angle, half way at least half the turn from 0 to 1,
plus the tolerance of angles.

Where |g''| <= B within h of the middle m, g is within B h^2 / 2 of g(m) + (s - m) g'(m), the ends of which bound every
convex function of it. Angles are compared as chords, which are lengths of vectors: |a - d| = 2 sin(angle / 2), and of
rotation matrices sqrt(2) times that. Where the hinges turn by S in all per unit of s, |a''| <= S^2; of the direction
q / |q| to a place, |q| >= r, it is at most |q''| / r + 2 / sqrt(3) |q'|^2 / r^2.

Of any other row error and slack change by at most `rate` times the displacement of its features, see `TaskRowKind`. A
row without a rate is sampled: at intervals no longer than SAMPLED, in their middles, and nothing between them.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from htcp_jax.model.rotations import angle, axis_angle_matrix, rotation_vector
from htcp_jax.numerics import product, safe_norm
from htcp_jax.types import Array, Bool, Float, Scalar, Vector3

ROUNDING_M = 1e-9  # of a place
ROUNDING = 1e-12  # of a chord
SAMPLED = 0.01  # longest interval of a sampled row, in any joint [rad or m]


class RowSlack(NamedTuple):
    """Slack of a row, or of each of P, on an interval of a joint path."""

    left: Float[Array, "*P"]  # allowed deviation of its features' vectors from the path; negative: it may be violated
    broken: Bool[Array, "*P"]  # True: it is violated at the middle
    apart: Float[Array, "*P"]  # lower bound on the distance of the place that an axis points at [m]; inf: none


class FeatureMotion:
    """Motion of a row's features on an interval of a joint path, about its middle; per unit of the path."""

    half: Scalar  # half the interval
    turning: Scalar  # sum of the hinges' turns [rad]
    fastest: Scalar  # largest joint change [rad or m]

    def moving(self, k: int) -> tuple[Vector3, Vector3]:
        """Return feature k's position [m] or direction, and its velocity."""
        raise NotImplementedError

    def bend(self, k: int) -> Scalar:
        """Return a bound on the acceleration of feature k, a point, on the interval [m]."""
        raise NotImplementedError

    def velocity(self, function: Callable) -> tuple[Array, Array]:
        """Return function(feature 0, feature 1, ...) of the features' vectors, and its derivative."""
        raise NotImplementedError


class Slabs(NamedTuple):
    """Allowed region of a point: c directions, offsets and allowed deviations.

    For either target: the offsets along the directions, and the allowed deviation [m].
    """

    across: Float[Array, "2 c 3"]
    offset: Float[Array, "2 c"]
    within: Float[Array, "2"]

    def left(self, motion: FeatureMotion) -> RowSlack:
        """Return the slack of the point [m]."""
        half = motion.half
        point, speed = motion.moving(0)
        bend = motion.bend(0)
        slack = half * jnp.abs(self._along(speed)) + 0.5 * half * half * bend
        off, within = self._along(point) - self.offset, self.within[:, None]
        above, below = within - (off + slack + ROUNDING_M), (off - slack - ROUNDING_M) + within
        left = jnp.minimum(jnp.max(above, axis=0), jnp.max(below, axis=0))
        broken = jnp.all(off > within, axis=0) | jnp.all(off < -within, axis=0)
        return RowSlack(jnp.min(left), jnp.any(broken), jnp.inf)

    def _along(self, vector: Vector3) -> Float[Array, "2 c"]:
        return jnp.sum(self.across * vector[None, None], axis=2)


class Chords(NamedTuple):
    """Allowed vectors of the arm: within a distance of one of k; axes of length 1, concatenated."""

    vectors: Float[Array, "k v"]
    radius: Float[Array, "k"]

    def left(self, motion: FeatureMotion) -> RowSlack:
        """Return the slack of the axes, as a chord."""
        half, count = motion.half, self.vectors.shape[1] // 3
        now, ahead = (jnp.concatenate(each) for each in zip(*map(motion.moving, range(count)), strict=True))
        bend = np.sqrt(count) * motion.turning**2
        off = now[None] - self.vectors
        most = _farthest(off, half * ahead) + 0.5 * half * half * bend + ROUNDING
        return RowSlack(jnp.max(self.radius - most), jnp.all(safe_norm(off) > self.radius), jnp.inf)


class ViewTarget(NamedTuple):
    """The place that an axis points at [m], and the allowed deviation of the axis as a chord."""

    place: Vector3
    radius: Scalar

    def left(self, motion: FeatureMotion) -> RowSlack:
        """Return the slack of the axis, as a chord."""

        def off(axis: Vector3, eye: Vector3) -> Vector3:
            ahead = self.place - eye
            return axis - ahead / jnp.maximum(safe_norm(ahead), 1e-12)

        half, (here, rate) = motion.half, motion.velocity(off)
        point, speed = motion.moving(1)
        bend = motion.bend(1)
        fastest = safe_norm(speed) + half * bend
        nearest = safe_norm(self.place - point) - half * fastest
        apart = jnp.maximum(nearest, 1e-12)
        bend = motion.turning**2 + bend / apart + 2 / np.sqrt(3) * (fastest / apart) ** 2
        most = _farthest(here[None], half * rate)[0] + 0.5 * half * half * bend + ROUNDING
        left = jnp.where(nearest > 0, self.radius - most, -1.0)
        left = jnp.where(jnp.isfinite(self.radius), left, jnp.inf)
        return RowSlack(left, safe_norm(here) > self.radius, nearest)


class RateBound(NamedTuple):
    """Features of which error and slack change by at most `rate` per displacement; None: sampled."""

    slack: Callable[[Float[Array, "v"]], Scalar]  # the larger of the slacks by the goals at both targets and half way
    is_direction: tuple[bool, ...]  # of each feature
    rate: float | None

    def left(self, motion: FeatureMotion) -> RowSlack:
        """Return the slack of the features' vectors together."""
        half, moving = motion.half, [motion.moving(k) for k in range(len(self.is_direction))]
        slack = self.slack(jnp.concatenate([now for now, _ in moving]))
        if self.rate is None:
            return RowSlack(jnp.where(half * motion.fastest <= SAMPLED, slack, -1.0), slack < 0, jnp.inf)
        bends = [motion.turning**2 if turns else motion.bend(k) for k, turns in enumerate(self.is_direction)]
        moves = [half * safe_norm(v) + 0.5 * half * half * bend for (_, v), bend in zip(moving, bends, strict=True)]
        return RowSlack(slack / self.rate - safe_norm(jnp.stack(moves)) - ROUNDING_M, slack < 0, jnp.inf)


Region = Slabs | Chords | ViewTarget | RateBound


def allowed_axes(a: Vector3, b: Vector3, limit: Float[Array, "2"], tolerance_rad: float) -> Chords:
    """Return the allowed axes between two directions with half angles [rad]."""
    both = a + b
    middle = jnp.where(safe_norm(both) > 1e-6, both / jnp.maximum(safe_norm(both), 1e-6), a)
    return Chords(jnp.stack([a, b, middle]), chord(_half_angles(limit, angle(a, b)) + tolerance_rad))


def allowed_frames(
    a: Float[Array, "3 3"], b: Float[Array, "3 3"], limit: Float[Array, "2"], tolerance_rad: float
) -> Chords:
    """Return the allowed frames between two rotations with angles [rad]."""
    vector = rotation_vector(product(b, a.T))
    size = safe_norm(vector)
    axis = jnp.where(size > 0, vector, jnp.array([1.0, 0.0, 0.0])) / jnp.where(size > 0, size, 1.0)
    middle = product(axis_angle_matrix(axis[None], 0.5 * size[None])[0], a)
    radius = np.sqrt(2) * chord(_half_angles(limit, size) + tolerance_rad)
    return Chords(jnp.stack([a.T, b.T, middle.T]).reshape(3, 9), radius)


def chord(half_angle: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Return the chord of a half angle [rad] in a circle of radius 1; infinite from half a turn on."""
    return jnp.where(half_angle < np.pi, 2 * jnp.sin(0.5 * half_angle), jnp.inf)


def _half_angles(limit: Float[Array, "2"], turn: Scalar) -> Float[Array, "3"]:
    """Return the half angles about both ends of a turn, and half way."""
    return jnp.append(limit, jnp.maximum(limit.mean(), 0.5 * turn))


def _farthest(off: Float[Array, "k v"], move: Float[Array, "v"]) -> Float[Array, "k"]:
    return jnp.maximum(safe_norm(off + move[None]), safe_norm(off - move[None]))
