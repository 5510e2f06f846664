"""Time scaling of one section: at the feed, or as fast as limits on velocity, acceleration and jerk allow.

Over the length s a joint has velocity q' s', acceleration q'' s'^2 + q' s'', jerk q''' s'^3 + 3 q'' s' s'' + q' s'''.
At constant speed each limit is a speed limit in closed form,

    s' <= v / |q'|,    s' <= (a / |q''|)^(1/2),    s' <= (j / |q'''|)^(1/3),

and the part of a that q'' s'^2 does not use is available for s''. A speed limit applies as long as its position is in
the moving mean's window. The mean and the mixed terms may still exceed limits. Times at which they do are found on the
timed curve, and speed limits are lowered there, up to ROUNDS times. Finally the complete section is slowed down so that
no limit is exceeded at the checked times.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.trajectory.curve import Derivatives
from htcp_jax.trajectory.limits import MotionLimits
from htcp_jax.trajectory.path import PathCurve
from htcp_jax.trajectory.speed import SpeedProfile, fastest

CURVED = 0.9  # maximum share of a limit that a corner uses at constant speed
ROUNDS = 12
CHECKED_EVERY_S, INSTANTS = 0.004, 20_000  # interval of evenly spaced checks, and their maximum number
RESERVE = 0.995, 0.995, 0.93  # used shares of v, a and j; the rest is for values between checks
NEAR, CLOSER_S, REACH_S = 0.9, 0.0005, 0.004  # closer checks: from this share of a limit, interval, range
ENOUGH = 1.001  # accepted factor by which a limit is exceeded


class _SpeedLimits(NamedTuple):
    """Speed and acceleration limits on a path's grid."""

    speed: Float[np.ndarray, "m"]
    push: Float[np.ndarray, "m"]  # acceleration along the path, in both directions
    limit: Int[np.ndarray, "m"]  # the active limit, as in `TimeScaling`


class TimeScaling(NamedTuple):
    """Time scaling of one section: its path over s, and s over time."""

    path: PathCurve
    speed: SpeedProfile
    limit: Int[np.ndarray, "m"]  # on the path's grid, the active limit: -1 the feed, k + 3 j the velocity,
    # acceleration or jerk of joint j, k = 0, 1, 2
    speed_limit: Float[np.ndarray, "m"]  # on the path's grid, the speed limit before the moving mean

    def at(self, time: Float[np.ndarray, "n"]) -> tuple[Float[np.ndarray, "n"], Derivatives]:
        """Return positions, and joints [rad or m] with their time derivatives, at times from 0 to the duration [s]."""
        place, v, a, j = self.speed.at(time)
        v, a, j = v[:, None], a[:, None], j[:, None]
        x, first, second, third = self.path.at(place)
        return place, Derivatives(
            x, first * v, second * v * v + first * a, third * v**3 + 3 * second * v * a + first * j
        )

    def limit_at(self, place: Float[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
        """Return the active limit at positions, in the format of `limit`."""
        return self.limit[np.clip(np.searchsorted(self.path.place, place), 0, len(self.limit) - 1)]

    def passes(self, u: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
        """Return the times at which via points of the curve are passed, from 0 to the duration [s]."""
        when = instants(self.speed)
        found = np.interp(u, np.maximum.accumulate(self.path.u(self.speed.at(when)[0])), when)
        found[[0, -1]] = 0.0, self.speed.duration_s
        return found


def time_scaling(path: PathCurve, limits: MotionLimits, feed: float | Float[np.ndarray, "m"] = np.inf) -> TimeScaling:
    """Compute the time scaling of a section.

    Args:
        path: The section over s.
        limits: Limits of the joints.
        feed: Desired and maximum speed [m/s]. If the tool does not follow the path, the speed has no unit, and 1 is the
            full speed of the limiting joint. One value, or one per position of the path's grid.
    """
    whole = limits
    limits = MotionLimits(*(share * part for share, part in zip(RESERVE, limits, strict=True)))
    window = float(np.max(limits.acceleration / limits.jerk))
    speed_limits = _speed_limits(path, limits, feed)
    speed_limits = speed_limits._replace(speed=_extended_limits(path, speed_limits.speed, window))
    for _ in range(ROUNDS):
        scaling = TimeScaling(
            path,
            fastest(path.place, speed_limits.speed, speed_limits.push, window),
            speed_limits.limit,
            speed_limits.speed.copy(),
        )
        time = instants(scaling.speed)
        _, found = scaling.at(time)
        shares = limits.shares(*found[1:])
        over = shares.max(axis=1)
        if over.max() <= ENOUGH:
            return _slower(scaling, whole)
        _slow_down(speed_limits, path.place, scaling.speed, time, shares)
    return _slower(scaling._replace(speed=scaling.speed._replace(slower=float(over.max()))), whole)


def _slower(scaling: TimeScaling, limits: MotionLimits) -> TimeScaling:
    """Return the time scaling slowed down by the factor by which limits are exceeded between the checked times."""
    time = instants(scaling.speed)
    near = time[limits.shares(*scaling.at(time)[1][1:]).max(axis=1) > NEAR]
    if not len(near):
        return scaling
    around = np.arange(-REACH_S, REACH_S, CLOSER_S)
    steps = np.unique(np.round((near[:, None] + around) / CLOSER_S))
    _, found = scaling.at(np.clip(CLOSER_S * steps, 0.0, scaling.speed.duration_s))
    over = float(limits.shares(*found[1:]).max())
    return scaling if over <= 1 else scaling._replace(speed=scaling.speed._replace(slower=scaling.speed.slower * over))


def instants(scaling: SpeedProfile) -> Float[np.ndarray, "n"]:
    """Return the times at which limits are checked [s]: evenly spaced, at the grid's positions, at jerk jumps."""
    even = np.linspace(0, scaling.duration_s, 2 + min(int(scaling.duration_s / CHECKED_EVERY_S), INSTANTS))
    passed = np.interp(scaling.place, np.maximum.accumulate(scaling.at(even)[0]), even)
    return np.sort(np.concatenate([even, passed, scaling.jumps()]))


def _speed_limits(path: PathCurve, limits: MotionLimits, feed: float | np.ndarray) -> _SpeedLimits:
    """Return the limits in closed form at every position of the grid."""
    _, first, second, third = (np.maximum(np.abs(part), 1e-300) for part in path.at(path.place))
    with np.errstate(over="ignore"):  # infinite: no limit
        by_joint = np.stack(
            [
                limits.velocity / first,
                np.sqrt(CURVED * limits.acceleration / second),
                np.cbrt(CURVED * limits.jerk / third),
            ]
        )
    flat = by_joint.transpose(1, 2, 0).reshape(len(first), -1)
    limit = flat.argmin(axis=1)
    least = flat[np.arange(len(flat)), limit]
    speed = np.minimum(least, feed)
    with np.errstate(over="ignore"):
        push = ((limits.acceleration - second * speed[:, None] ** 2) / first).min(axis=1)
    return _SpeedLimits(speed, push, np.where(least < feed, limit, -1))


def _extended_limits(path: PathCurve, speed_limit: np.ndarray, window: float) -> np.ndarray:
    """Return the speed limits, with each corner's lowest limit extended to both sides by half the mean's window."""
    held = speed_limit.copy()
    first, last = np.searchsorted(path.place, path.at_corner.T)
    slowest = np.array([speed_limit[max(a - 1, 0) : b + 1].min() for a, b in zip(first, last, strict=True)])
    margin = 0.5 * window * slowest
    first = np.maximum(np.searchsorted(path.place, path.at_corner[:, 0] - margin) - 1, 0)
    last = np.searchsorted(path.place, path.at_corner[:, 1] + margin)
    for k in np.flatnonzero(slowest < np.inf):
        part = held[first[k] : last[k] + 1]
        np.minimum(part, slowest[k], out=part)
    return held


def _slow_down(
    speed_limits: _SpeedLimits, grid: np.ndarray, scaling: SpeedProfile, time: np.ndarray, shares: np.ndarray
) -> None:
    """Lower the speed and acceleration limits around times at which a joint limit is exceeded; record this limit.

    They are lowered at all positions in the moving mean's window around this time.
    """
    over = shares.max(axis=1)
    bad = np.flatnonzero(over > ENOUGH)
    breaks = np.flatnonzero(np.diff(bad) > 1)
    begin, end = bad[np.append(0, breaks + 1)], bad[np.append(breaks, len(bad) - 1)]
    begins = np.searchsorted(grid, scaling.seen(time[begin])[0]) - 1
    ends = np.searchsorted(grid, scaling.seen(time[end])[1]) + 1
    for first, last, a, b in zip(begin, end, np.maximum(begins, 0), ends, strict=True):
        worst = first + over[first : last + 1].argmax()
        by = 1.01 * over[worst]
        speed_limits.speed[a:b] /= by
        speed_limits.push[a:b] /= by**2
        speed_limits.limit[a:b] = shares[worst].argmax()
