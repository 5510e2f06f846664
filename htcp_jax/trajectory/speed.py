"""Fastest speed along a curve from stop to stop within limits of speed and acceleration, and its duration.

On a grid of positions s with speeds z, z^2 is linear between two positions: the acceleration is constant there. A
moving mean of s(t) over a time window T makes the motion smooth: with P the integral of s over time,

    s_T(t) = (P(t + T/2) - P(t - T/2)) / T,    s_T' = (s(t + T/2) - s(t - T/2)) / T,    and so on,

The acceleration is then continuous, and the jerk is at most the difference of two accelerations divided by T. A speed
that is constant for longer than T is preserved.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

AT_ONCE_S = 1e-9


class SpeedProfile(NamedTuple):
    """Speeds of a time scaling on a grid of m positions, with the moving mean's window T."""

    time: Float[np.ndarray, "m"]  # [s]
    place: Float[np.ndarray, "m"]
    speed: Float[np.ndarray, "m"]
    integral: Float[np.ndarray, "m"]  # integral P of the position over time
    window_s: float
    slower: float = 1.0  # factor by which all times are lengthened

    @property
    def duration_s(self) -> float:
        """Duration from stop to stop [s]."""
        return self.slower * float(self.time[-1] + self.window_s)

    def at(self, time: Float[np.ndarray, "n"]) -> tuple[Float[np.ndarray, "n"], ...]:
        """Return position, speed, acceleration and jerk at times from 0 to `duration_s`."""
        late, early = self._raw(time / self.slower), self._raw(time / self.slower - self.window_s)
        scale = self.window_s * self.slower ** np.arange(4)
        place, *more = ((b - a) / by for a, b, by in zip(early, late, scale, strict=True))
        return np.clip(place, 0.0, self.place[-1]), *more

    def seen(self, time: Float[np.ndarray, "n"]) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Return the first and the last position in the moving mean's window around each time."""
        time = time / self.slower
        return self._raw(time - self.window_s)[1], self._raw(time)[1]

    def jumps(self) -> Float[np.ndarray, "n"]:
        """Return times shortly before and after each jump of the jerk; the jerk is constant between two jumps."""
        push = np.pad(np.diff(self.speed) / np.diff(self.time), 1)
        bends = self.time[np.abs(np.diff(push)) > 1e-9 * np.abs(push).max()]
        bends = self.slower * np.append(bends, bends + self.window_s)
        return np.clip(np.append(bends - AT_ONCE_S, bends + AT_ONCE_S), 0.0, self.duration_s)

    def _raw(self, time: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return P, s, s', s'' before the moving mean, at rest before the begin and after the end."""
        k = np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, len(self.time) - 2)
        push = np.diff(self.speed) / np.diff(self.time)
        t, last = time - self.time[k], self.time[-1]
        s, z, a = self.place[k], self.speed[k], push[k]
        raw = [self.integral[k] + t * (s + t * (z / 2 + t * a / 6)), s + t * (z + t * a / 2), z + t * a, a]
        before, after = time < 0, np.flatnonzero(time >= last)
        for part, at_end in zip(raw, (0.0, self.place[-1], 0.0, 0.0), strict=True):
            part[before], part[after] = 0.0, at_end
        raw[0][after] = self.integral[-1] + (time[after] - last) * self.place[-1]
        return tuple(raw)


def fastest(
    place: Float[np.ndarray, "m"], speed_limit: Float[np.ndarray, "m"], push: Float[np.ndarray, "m"], window_s: float
) -> SpeedProfile:
    """Return the fastest time scaling within limits of speed and acceleration, at rest at both ends.

    z^2 grows by at most 2 push ds in both directions. With C the integral of 2 push over s, the forward pass is z^2 = C
    + min(limit^2 - C), with the minimum over all earlier positions. The backward pass is the same in reverse.

    Args:
        place: Grid of positions [m or s].
        speed_limit: Maximum speeds at these positions [m/s or 1].
        push: Maximum accelerations at these positions, in both directions [m/s2 or 1/s].
        window_s: Time window of the moving mean.
    """
    square = speed_limit * speed_limit
    square[[0, -1]] = 0.0
    rise = np.minimum(push[:-1], push[1:]) * np.diff(place) * 2
    sums = np.append(0.0, np.cumsum(rise))
    square = np.minimum.accumulate(square - sums) + sums
    square = np.minimum.accumulate((square + sums)[::-1])[::-1] - sums
    speed = np.minimum(np.sqrt(np.maximum(square, 0.0)), speed_limit)
    speed[[0, -1]] = 0.0
    step = 2 * np.diff(place) / (speed[:-1] + speed[1:])
    time = np.append(0.0, np.cumsum(step))
    push = np.diff(speed) / step
    whole = step * (place[:-1] + step * (speed[:-1] / 2 + step * push / 6))
    return SpeedProfile(time, place, speed, np.append(0.0, np.cumsum(whole)), window_s)
