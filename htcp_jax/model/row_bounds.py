"""Allowed regions of a task row's features on a segment between two targets, and the slack on an interval of a motion.

On a segment a row's goal lies between goal 0 of the previous target and goal 1 of the segment's own target. The allowed
region of each kind of row:

    a point       with f_k = u_k p - o_k, the deviation by goal k = 0, 1 in a direction: min f_k <= w and max f_k >= -w
    an axis       the angle to d_0, to d_1, or to the direction half way between them, is at most the limit
    a frame       the angle of the rotation to R_0, to R_1, or to the rotation half way, is at most the limit
    tool angles   the axes are in the half-spaces of goal 0, of goal 1, or of the goal half way
    a view        the angle to the direction of the place is at most the limit
    other kinds   error and slack are within the tolerance by goal 0, by goal 1, or by their mean

w is the band plus the tolerance of lengths. The limit is the half angle plus the tolerance of angles. Half way, the
half angle is taken to be at least half of the angle from goal 0 to goal 1.

Bounds: if |g''| <= B within h of the middle m, then g(s) is within B h^2 / 2 of g(m) + (s - m) g'(m). A convex function
of this line attains its maximum at an end. Angles are compared as chords, which are lengths of vectors: |a - d| =
2 sin(angle / 2) for axes, and sqrt(2) times that for rotation matrices. If the hinges turn by S in total per unit of s,
an axis satisfies |a''| <= S^2. For the direction q / |q| to a place, |q| >= r, the second derivative is at most
|q''| / r + 2 / sqrt(3) |q'|^2 / r^2.

Error and slack of other kinds change by at most `rate` times the displacement of their features, see `TaskRowKind`. A
row without a rate is sampled: it is evaluated only in the middles of intervals no longer than SAMPLED.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from htcp_jax.model.rotations import angle, axis_angle_matrix, rotation_vector
from htcp_jax.numerics import product, safe_norm
from htcp_jax.types import Array, Bool, Float, Scalar, Vector3

ROUNDING_M = 1e-9  # rounding error of a position
ROUNDING = 1e-12  # rounding error of a chord
SAMPLED = 0.01  # longest interval of a sampled row, in any joint [rad or m]


class RowSlack(NamedTuple):
    """Slack of a row, or of each of P rows, on an interval of a joint path."""

    left: Float[Array, "*P"]  # further deviation that the features' vectors may have; negative: may be violated
    broken: Bool[Array, "*P"]  # True: the row is violated at the interval's middle
    apart: Float[Array, "*P"]  # lower bound on an axis's distance from the place it points at [m]; inf: not a view


class FeatureMotion:
    """Motion of a row's features about the middle of an interval of a joint path; rates are per unit of the path."""

    half: Scalar  # half the interval's length
    turning: Scalar  # sum of the hinges' rotation rates [rad]
    fastest: Scalar  # largest rate of a joint [rad or m]

    def moving(self, k: int) -> tuple[Vector3, Vector3]:
        """Return feature k at the middle, a position [m] or a direction, and its velocity."""
        raise NotImplementedError

    def bend(self, k: int) -> Scalar:
        """Return an upper bound on the acceleration of feature k, a point, on the interval [m]."""
        raise NotImplementedError

    def velocity(self, function: Callable) -> tuple[Array, Array]:
        """Return function(feature 0, feature 1, ...) at the middle, and its derivative along the path."""
        raise NotImplementedError


class Slabs(NamedTuple):
    """Allowed region of a point, by the goals of both targets: slabs normal to c directions."""

    across: Float[Array, "2 c 3"]  # directions
    offset: Float[Array, "2 c"]  # required positions along the directions [m]
    within: Float[Array, "2"]  # allowed deviations [m]

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
    """Allowed region of an axis or a frame: vectors within a distance of one of k vectors.

    A vector is the axis, or the concatenation of the frame's three axes, of length 1 each.
    """

    vectors: Float[Array, "k v"]
    radius: Float[Array, "k"]  # allowed distances, as chords

    def left(self, motion: FeatureMotion) -> RowSlack:
        """Return the slack of the axes, as a chord."""
        half, count = motion.half, self.vectors.shape[1] // 3
        now, ahead = (jnp.concatenate(each) for each in zip(*map(motion.moving, range(count)), strict=True))
        bend = np.sqrt(count) * motion.turning**2
        off = now[None] - self.vectors
        most = _farthest(off, half * ahead) + 0.5 * half * half * bend + ROUNDING
        return RowSlack(jnp.max(self.radius - most), jnp.all(safe_norm(off) > self.radius), jnp.inf)


class HalfSpaces(NamedTuple):
    """Allowed region of one or more axes of a frame: c half-spaces of their vectors, by one of k goals.

    Each vector of a half-space has the length 1 if it is applied to one axis; applied to several axes, it is a unit
    vector fixed to the frame, times a unit vector.
    """

    vectors: Float[Array, "k c v"]
    beyond: Float[Array, "k c"]  # distances by which the axes may be outside

    def left(self, motion: FeatureMotion) -> RowSlack:
        """Return the slack of the axes, as a chord."""
        half, count = motion.half, self.vectors.shape[2] // 3
        now, ahead = (jnp.concatenate(each) for each in zip(*map(motion.moving, range(count)), strict=True))
        inside, speed = (jnp.sum(self.vectors * vector[None, None], axis=2) for vector in (now, ahead))
        inside = inside + self.beyond
        least = inside - half * jnp.abs(speed) - 0.5 * half * half * motion.turning**2 - ROUNDING
        return RowSlack(jnp.max(jnp.min(least, axis=1)), jnp.all(jnp.any(inside < 0, axis=1)), jnp.inf)


class ViewTarget(NamedTuple):
    """Allowed region of an axis that points at a place."""

    place: Vector3  # [m]
    radius: Scalar  # allowed deviation of the axis, as a chord

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
    """Allowed region of features by their slack, which changes by at most `rate` times their displacement."""

    slack: Callable[[Float[Array, "v"]], Scalar]  # the largest slack by goal 0, by goal 1 and by their mean
    is_direction: tuple[bool, ...]  # per feature; False for a point
    rate: float | None  # see `TaskRowKind`; None: unknown, the row is sampled

    def left(self, motion: FeatureMotion) -> RowSlack:
        """Return the slack as a norm: the displacement that all features together may have."""
        half, moving = motion.half, [motion.moving(k) for k in range(len(self.is_direction))]
        slack = self.slack(jnp.concatenate([now for now, _ in moving]))
        if self.rate is None:
            return RowSlack(jnp.where(half * motion.fastest <= SAMPLED, slack, -1.0), slack < 0, jnp.inf)
        bends = [motion.turning**2 if turns else motion.bend(k) for k, turns in enumerate(self.is_direction)]
        moves = [half * safe_norm(v) + 0.5 * half * half * bend for (_, v), bend in zip(moving, bends, strict=True)]
        return RowSlack(slack / self.rate - safe_norm(jnp.stack(moves)) - ROUNDING_M, slack < 0, jnp.inf)


Region = Slabs | Chords | HalfSpaces | ViewTarget | RateBound


def allowed_axes(a: Vector3, b: Vector3, limit: Float[Array, "2"], tolerance_rad: float) -> Chords:
    """Return the allowed region of an axis between two required directions; `limit` is each goal's half angle [rad]."""
    both = a + b
    middle = jnp.where(safe_norm(both) > 1e-6, both / jnp.maximum(safe_norm(both), 1e-6), a)
    return Chords(jnp.stack([a, b, middle]), chord(_half_angles(limit, angle(a, b)) + tolerance_rad))


def allowed_frames(
    a: Float[Array, "3 3"], b: Float[Array, "3 3"], limit: Float[Array, "2"], tolerance_rad: float
) -> Chords:
    """Return the allowed region of a frame between two required rotations; `limit` is each goal's half angle [rad]."""
    middle, size = half_way(a, b)
    radius = np.sqrt(2) * chord(_half_angles(limit, size) + tolerance_rad)
    return Chords(jnp.stack([a.T, b.T, middle.T]).reshape(3, 9), radius)


def half_way(a: Float[Array, "3 3"], b: Float[Array, "3 3"]) -> tuple[Float[Array, "3 3"], Scalar]:
    """Return the rotation half way between two rotations, and the angle between these [rad]."""
    vector = rotation_vector(product(b, a.T))
    size = safe_norm(vector)
    axis = jnp.where(size > 0, vector, jnp.array([1.0, 0.0, 0.0])) / jnp.where(size > 0, size, 1.0)
    return product(axis_angle_matrix(axis[None], 0.5 * size[None])[0], a), size


def chord(half_angle: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Return the chord 2 sin(angle / 2) of an angle [rad] in the unit circle; infinite for pi and more."""
    return jnp.where(half_angle < np.pi, 2 * jnp.sin(0.5 * half_angle), jnp.inf)


def _half_angles(limit: Float[Array, "2"], turn: Scalar) -> Float[Array, "3"]:
    """Return the half angles at goal 0, at goal 1 and half way; `turn` is the angle between the goals [rad]."""
    return jnp.append(limit, jnp.maximum(limit.mean(), 0.5 * turn))


def _farthest(off: Float[Array, "k v"], move: Float[Array, "v"]) -> Float[Array, "k"]:
    return jnp.maximum(safe_norm(off + move[None]), safe_norm(off - move[None]))
