"""Joint paths of a motion, each with the segment that it belongs to.

At a rounded corner the controller's path is not known. It stays in the triangle of the points at which the zone begins
and ends and of the corner itself, as a convex combination of both legs does. With a and b those points and c the
corner, the triangle is the union of the segments from c + u (a - c) to c + u (b - c) with 0 <= u <= 1. A band of u of
width w about such a segment is within w / 2 max(|a - c|, |b - c|) of it, joint by joint.

At a flat corner the legs alone cover the triangle with less. Its points are c + s A + t B with A = a - c, B = b - c,
s, t >= 0 and s + t <= 1. For any m > 0, c + (s - m t) A, if s >= m t, or else c + (t - s / m) B, is on a leg. It
differs from the point by r (B + m A) with r = min(t, s / m) <= 1 / (1 + m). With m = |B| / |A| this is 0 if the path
goes straight on.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

BANDS = 8  # number of bands of a corner's triangle
TINY = 1e-300  # divisor in place of 0
PLACES = 64  # places on half a leg at which the distance of the TCP from the corner is measured


class JointCurves(NamedTuple):
    """Polynomial joint paths x(s) = sum_k c_k s^k with 0 <= s <= 1, and how far each joint may be away from them."""

    coefficients: Float[np.ndarray, "m C N"]  # c_0, c_1, ... [rad or m]
    off: Float[np.ndarray, "m N"]  # largest distance of each joint from the path [rad or m]
    segment: Int[np.ndarray, "m"]  # segment that each path belongs to, in ascending order
    span: Float[np.ndarray, "m 2"]  # shares of the segment at which the path begins and ends [1]
    is_certain: Bool[np.ndarray, "m"]  # True: the controller takes this path, within `off`; False: one of several

    @property
    def is_straight(self) -> bool:
        """True if all paths are straight, and no joint may leave them."""
        return self.coefficients.shape[1] <= 2 and not self.off.any()

    def of_segments(self, segments: Int[np.ndarray, "k"]) -> "JointCurves":
        """Return the paths of some segments, in ascending order, renumbered from 0."""
        chosen = np.isin(self.segment, segments)
        found = JointCurves(*(part[chosen] for part in self))
        return found._replace(segment=np.searchsorted(segments, found.segment))

    def between(self, path: int, begin: Float[np.ndarray, "p"], end: Float[np.ndarray, "p"]) -> "JointCurves":
        """Return parts of a path, each a segment of its own.

        Args:
            path: The path's index.
            begin: Shares of the path at which the parts begin [1].
            end: Shares at which they end [1].
        """
        count, degrees = len(begin), range(self.coefficients.shape[1])
        # (begin + size s)^k = sum_j binom(k, j) begin^(k - j) size^j s^j
        change = [[math.comb(k, j) * begin ** max(k - j, 0) * (end - begin) ** j for k in degrees] for j in degrees]
        coefficients = np.einsum("jkp,kn->pjn", np.array(change), self.coefficients[path])
        first, last = self.span[path]
        span = first + (last - first) * np.stack([begin, end], axis=1)
        off, is_certain = np.tile(self.off[path], (count, 1)), np.full(count, self.is_certain[path])
        return JointCurves(coefficients, off, np.arange(count), span, is_certain)

    def within(self, off: float | Float[np.ndarray, "N"]) -> "JointCurves":
        """Return the paths with a larger distance of each joint, as of a servo's lag [rad or m]."""
        return self._replace(off=self.off + off)


def straight(x: Float[np.ndarray, "n N"]) -> JointCurves:
    """Return the straight joint paths between consecutive configurations [rad or m]."""
    return polynomials(np.stack([x[:-1], np.diff(x, axis=0)], axis=1))


def polynomials(coefficients: Float[np.ndarray, "m C N"]) -> JointCurves:
    """Return one polynomial per segment, see `JointCurves`."""
    count, _, joints = coefficients.shape
    span, certain = np.tile([0.0, 1.0], (count, 1)), np.ones(count, bool)
    return JointCurves(coefficients, np.zeros((count, joints)), np.arange(count), span, certain)


def corners(
    x: Float[np.ndarray, "n N"],
    radius_m: Float[np.ndarray, "n"],
    tcp_of: Callable[[Float[np.ndarray, "k N"]], Float[np.ndarray, "k 3"]],
) -> JointCurves:
    """Return straight joint paths between configurations, and all paths inside rounded corners.

    A zone begins at most half a leg before its corner, as controllers limit it. A corner's paths belong to the segment
    that leads to it; a segment's straight part lies between the zones at both of its ends.

    Args:
        x: The configurations [rad or m].
        radius_m: Distance of the TCP from each configuration at which its zone begins [m]; 0, and at both ends: none.
        tcp_of: Function that returns the TCP's positions at configurations, world [m].
    """
    count = len(x) - 1
    rounded = np.zeros(len(x), bool)
    rounded[1:-1] = radius_m[1:-1] > 0
    before, after = np.zeros(count), np.zeros(count)  # shares of each segment in the zones at its end and its begin
    for shares, ends, others in ((before, slice(1, None), slice(None, -1)), (after, slice(None, -1), slice(1, None))):
        here = np.flatnonzero(rounded[ends])
        shares[here] = _shares(x[ends][here], x[others][here], radius_m[ends][here], tcp_of)
    return _with_corners(x, rounded, before, after)


def corners_in_shares(x: Float[np.ndarray, "n N"], shares: Float[np.ndarray, "n 2"]) -> JointCurves:
    """Return straight joint paths between configurations, and all paths inside corners that are rounded in the joints.

    Args:
        x: The configurations [rad or m].
        shares: Shares of the leg before and of the leg after each configuration in which its corner is rounded [1], at
            most 0.5; 0, and at both ends: none.
    """
    rounded = np.zeros(len(x), bool)
    rounded[1:-1] = (shares[1:-1] > 0).any(axis=1)
    kept = np.where(rounded[:, None], shares, 0.0)
    return _with_corners(x, rounded, kept[1:, 0], kept[:-1, 1])


def _with_corners(
    x: Float[np.ndarray, "n N"],
    rounded: Bool[np.ndarray, "n"],
    before: Float[np.ndarray, "m"],
    after: Float[np.ndarray, "m"],
) -> JointCurves:
    """Return the paths of m legs whose corners are rounded in shares at their end (`before`) and at their begin."""
    a, b = x[:-1] + after[:, None] * np.diff(x, axis=0), x[1:] - before[:, None] * np.diff(x, axis=0)
    legs = straight(x)._replace(coefficients=np.stack([a, b - a], axis=1), span=np.stack([after, 1 - before], axis=1))
    inside = [_inside(k - 1, b[k - 1], x[k], a[k], before[k - 1]) for k in np.flatnonzero(rounded)]
    found = JointCurves(*(np.concatenate(parts) for parts in zip(legs, *inside, strict=True)))
    order = np.lexsort((found.span[:, 0], found.segment))
    return JointCurves(*(part[order] for part in found))


def _shares(
    corner: Float[np.ndarray, "k N"],
    other: Float[np.ndarray, "k N"],
    radius_m: Float[np.ndarray, "k"],
    tcp_of: Callable,
) -> Float[np.ndarray, "k"]:
    """Return the share of each leg, from its corner, that is not outside the zone; at most one half.

    A share that is too large adds paths to the proof, and removes none.
    """
    if not len(corner):
        return np.zeros(0)
    share = np.arange(1, PLACES + 1) / (2 * PLACES)
    leg = corner[:, None] + share[None, :, None] * (other - corner)[:, None]
    at = tcp_of(np.concatenate([corner, leg.reshape(-1, corner.shape[1])]))
    apart = np.linalg.norm(at[len(corner) :].reshape(len(corner), PLACES, 3) - at[: len(corner), None], axis=2)
    outside = apart >= radius_m[:, None]
    return share[np.where(outside.any(axis=1), outside.argmax(axis=1), PLACES - 1)]


def _inside(segment: int, a: np.ndarray, corner: np.ndarray, b: np.ndarray, share: float) -> JointCurves:
    """Return paths that cover one corner's triangle: bands, or both legs if they cover it with less."""
    u = (np.arange(BANDS) + 0.5)[:, None] / BANDS
    start, end = corner + u * (a - corner), corner + u * (b - corner)
    off = np.maximum(np.abs(a - corner), np.abs(b - corner)) / (2 * BANDS)
    before, after = np.linalg.norm(a - corner), np.linalg.norm(b - corner)
    around = np.abs(before * (b - corner) + after * (a - corner)) / max(before + after, TINY)
    if around.sum() <= off.sum():
        start, end, off = np.stack([a, corner]), np.stack([corner, b]), around
    return JointCurves(
        np.stack([start, end - start], axis=1),
        np.tile(off, (len(start), 1)),
        np.full(len(start), segment),
        np.tile([1 - share, 1.0], (len(start), 1)),
        np.zeros(len(start), bool),
    )
