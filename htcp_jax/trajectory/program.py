"""Time-parameterised motion: `program(robot, motion, left, limits, feed_m_s)`.

Example:
    left = spare(plans, 0, motion, settings.tube_m)
    made = program(robot, motion, left, joint_limits(robot), feed_m_s=0.02)
    made.timed(0.001)   # arrays, 1 ms apart
    made.dips()         # feed drops along the weld, with the limiting joint
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.errors import InputError
from htcp_jax.model import Robot
from htcp_jax.motion import Motion
from htcp_jax.trajectory.curve import Stretch
from htcp_jax.trajectory.limits import KINDS, Limits
from htcp_jax.trajectory.path import path_of
from htcp_jax.trajectory.stretches import Spare, stretches
from htcp_jax.trajectory.time_law import Law, instants, law_of
from htcp_jax.trajectory.timed import Timed

HELD, STANDS = 0.99, 1e-6  # shares of the feed below which a feed drop, and a stop, begins


class Dip(NamedTuple):
    """A feed drop: a part of the weld on which the TCP is slower than the feed."""

    begin_m: float  # along the weld, from its first point
    end_m: float
    feed_m_s: float  # minimum; 0 at a stop
    reason: str  # "stop", or a limit and its joint


class Program(NamedTuple):
    """Sections of a motion in order, each with its time scaling."""

    motion: Motion
    stretches: list[Stretch]
    laws: list[Law]
    joint_names: tuple[str, ...]
    feed_m_s: float

    @property
    def ends_s(self) -> Float[np.ndarray, "m"]:
        """End time of each section [s]."""
        return np.cumsum([law.speed.duration_s for law in self.laws])

    @property
    def duration_s(self) -> float:
        """Duration from the first configuration to the last [s]."""
        return float(self.ends_s[-1])

    def timed(self, step_s: float = 0.001) -> Timed:
        """Sample the motion every `step_s`, up to the first sample at or after its end."""
        count = int(np.ceil(self.duration_s / step_s - 1e-9))
        return self.at(step_s * np.arange(count + 1))

    def at_postures(self) -> Timed:
        """Return the motion's own configurations, at the times at which their corners are passed.

        The straight joint paths between them are proven.
        """
        time, row = self.passes()
        x = np.concatenate([self.stretches[0].curve.x[:1], *(each.curve.x[1:] for each in self.stretches)])
        return self.at(time)._replace(x=x, kind=self.motion.kind[row], target=self.motion.target[row])

    def passes(self) -> tuple[Float[np.ndarray, "n"], Int[np.ndarray, "n"]]:
        """Return the times at which the motion's own configurations are passed [s], and their rows in it."""
        starts = np.append(0.0, self.ends_s[:-1])
        parts = zip(starts.tolist(), self.stretches, self.laws, strict=True)
        times = [start + law.passes(stretch.curve.u) for start, stretch, law in parts]
        row = np.concatenate([self.stretches[0].row[:1], *(each.row for each in self.stretches)])
        return np.concatenate([times[0][:1], *(each[1:] for each in times)]), row

    def at(self, time: Float[np.ndarray, "n"]) -> Timed:
        """Sample the motion at times that increase from 0 [s]; from `duration_s` on the arm is at rest."""
        ends = self.ends_s
        bounds = [0, *np.searchsorted(time, ends[:-1]).tolist(), len(time)]
        parts = []
        for k, (stretch, law) in enumerate(zip(self.stretches, self.laws, strict=True)):
            own = time[bounds[k] : bounds[k + 1]] - (ends[k] - law.speed.duration_s)
            place, found = law.at(own)
            row = stretch.row[stretch.curve.leg(law.path.u(place))]
            parts.append((found.x, found.first, found.second, row))
        x, velocity, acceleration, row = map(np.concatenate, zip(*parts, strict=True))
        kind, target = self.motion.kind[row], self.motion.target[row]
        return Timed(time, x, velocity, acceleration, kind, target, self.joint_names)

    def dips(self) -> list[Dip]:
        """Return the feed drops along the weld, in order."""
        found, before = [], 0.0
        for stretch, law in zip(self.stretches, self.laws, strict=True):
            if stretch.feeds:
                found += _dips(law, before, self.feed_m_s, self.joint_names)
                before += float(law.path.place[-1])
        return found


def program(robot: Robot, motion: Motion, left: Spare, limits: Limits, feed_m_s: float) -> Program:
    """Time-parameterise a motion.

    Args:
        robot: With the job's tool.
        motion: The motion.
        left: Slack of its proof next to each leg.
        limits: Limits of the joints.
        feed_m_s: Feed of the TCP on the path.

    Raises:
        InputError: For a feed that is not above 0, and for a motion without configurations or in which the arm does not
            move.
    """
    if not 0 < feed_m_s < np.inf:
        raise InputError(f"feed is {feed_m_s} m/s, a speed above 0 is needed")
    if not len(motion.x):
        raise InputError("the motion has no postures: no target is executable")
    if not np.any(motion.x != motion.x[0]):
        raise InputError("the arm stands still in this motion, there is nothing to time")
    parts = stretches(robot, motion, left, limits, feed_m_s)
    laws = [law_of(path_of(robot, part), limits, feed_m_s if part.feeds else np.inf) for part in parts]
    return Program(motion, parts, laws, robot.joint_names, feed_m_s)


def _dips(law: Law, before: float, feed: float, names: tuple[str, ...]) -> list[Dip]:
    """Return the feed drops of one section that begins `before` metres along the weld."""
    place, speed, _, _ = law.speed.at(instants(law.speed))
    slow, found = np.flatnonzero(speed < HELD * feed), []
    limit = law.limit_at(place)
    for part in _runs(slow, np.diff(slow) > 1):
        ramps = [run for run in _runs(part, np.diff(limit[part] >= 0)) if _is_ramp(limit[run], speed[run] / feed)]
        stands = np.isin(part, np.concatenate([part[:0], *ramps]))
        for piece in _runs(part, np.diff(stands)):
            known = piece[limit[piece] >= 0]
            reason = _named(int(limit[known[speed[known].argmin()]]), names) if len(known) else "stop"
            ends, least = before + place[piece[[0, -1]]], speed[piece].min()
            found.append(Dip(float(ends[0]), float(ends[1]), float(least), reason))
    return found


def _is_ramp(limit: np.ndarray, share: np.ndarray) -> bool:
    """Return True if a run that starts or ends at a stop has no other cause."""
    return bool(limit[0] < 0 and share.min() <= STANDS)


def _runs(which: np.ndarray, breaks: np.ndarray) -> list[np.ndarray]:
    """Split after every break."""
    return [run for run in np.split(which, np.flatnonzero(breaks) + 1) if len(run)]


def _named(limit: int, names: tuple[str, ...]) -> str:
    return f"{KINDS[limit % len(KINDS)]} of {names[limit // len(KINDS)]}"
