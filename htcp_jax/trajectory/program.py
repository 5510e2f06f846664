"""Time-parameterised motion: `time_motion(robot, motion, left, limits, feed_m_s)`.

```python
left = motion_slack(plans, 0, motion, settings.tube_m)
made = time_motion(robot, motion, left, joint_limits(robot), feed_m_s=0.02)
made.timed(0.001)   # arrays, 1 ms apart
made.drops()         # feed drops along the weld, with the limiting joint
```
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.errors import InputError
from htcp_jax.io.robots import RATES
from htcp_jax.model import Robot
from htcp_jax.motion import Motion
from htcp_jax.trajectory.blends import MotionSlack, blends
from htcp_jax.trajectory.curve import Blend, Curve
from htcp_jax.trajectory.limits import MotionLimits
from htcp_jax.trajectory.near_part import ShareOfSpeed
from htcp_jax.trajectory.path import path_of_blend
from htcp_jax.trajectory.time_scaling import TimeScaling, instants, time_scaling
from htcp_jax.trajectory.timed_motion import TimedMotion

LONGEST_S = 86_400.0  # maximum duration of a motion, one day: a longer one has a wrong limit or feed
MOST_SAMPLES = 1_000_000  # maximum number of samples, limited by memory
HELD, AT_REST = 0.99, 1e-6  # speeds / feed below which a feed drop begins, and below which the arm counts as at rest


class NothingToTimeError(InputError):
    """The motion has no configurations, or the arm does not move."""


class FeedDrop(NamedTuple):
    """Feed drop: a part of the path on which the TCP is slower than the feed."""

    begin_m: float  # position along the path, from its first point
    end_m: float
    feed_m_s: float  # minimum feed; 0 at a stop
    reason: str  # "stop", or the kind of limit and the joint
    first_target: int  # target to which the motion leads at the begin of the drop
    target: int  # target to which the motion leads at the minimum
    last_target: int  # target to which the motion leads at the end of the drop


class Program(NamedTuple):
    """Time-parameterised motion: its sections in order, each with its time scaling."""

    motion: Motion
    blends: list[Blend]
    scalings: list[TimeScaling]
    joint_names: tuple[str, ...]
    feed_m_s: float  # required feed; the largest one if it is not the same on the complete path
    feeds_m_s: tuple[float, ...]  # required feed on each section; off the path it has no effect

    @property
    def ends_s(self) -> Float[np.ndarray, "m"]:
        """End time of each section [s]."""
        return np.cumsum([scaling.speed.duration_s for scaling in self.scalings])

    @property
    def duration_s(self) -> float:
        """Duration from the first configuration to the last [s]."""
        return float(self.ends_s[-1])

    def timed(self, step_s: float = 0.001) -> TimedMotion:
        """Return samples of the motion every `step_s`, up to the first sample at or after its end.

        Raises:
            InputError: For more than MOST_SAMPLES samples.
        """
        count = int(np.ceil(self.duration_s / step_s - 1e-9))
        if count > MOST_SAMPLES:
            raise InputError(
                f"the motion takes {self.duration_s:.6g} s, which are {count:,} configurations at a step of "
                f"{1e3 * step_s:g} ms; at most {MOST_SAMPLES:,} are possible: choose a larger --step-ms, or "
                "program.control_step_s"
            )
        return self.at(step_s * np.arange(count + 1))

    def long_step_s(self, step_s: float) -> float:
        """Return a time step with at most MOST_SAMPLES samples [s]: `step_s`, or a longer one for a long motion."""
        return max(step_s, self.duration_s / MOST_SAMPLES)

    def at_configurations(self) -> TimedMotion:
        """Return the motion's own configurations, with the times at which the program passes them.

        At a blended corner the program passes near the configuration. The straight joint paths between the
        configurations are proven.
        """
        time, row = self.passes()
        x = np.concatenate([self.blends[0].curve.x[:1], *(each.curve.x[1:] for each in self.blends)])
        shares = [_blended(each.curve) for each in self.blends]
        blended = np.concatenate([shares[0][:1], *(each[1:] for each in shares)])
        own = {"kind": self.motion.kind[row], "target": self.motion.target[row], "span": self._span(row)}
        return self.at(time)._replace(x=x, blended=blended, **own)

    def passes(self) -> tuple[Float[np.ndarray, "n"], Int[np.ndarray, "n"]]:
        """Return the times at which the program passes the motion's configurations [s], and their rows in it."""
        starts = np.append(0.0, self.ends_s[:-1])
        parts = zip(starts.tolist(), self.blends, self.scalings, strict=True)
        times = [start + scaling.passes(blend.curve.u) for start, blend, scaling in parts]
        row = np.concatenate([self.blends[0].row[:1], *(each.row for each in self.blends)])
        return np.concatenate([times[0][:1], *(each[1:] for each in times)]), row

    def at(self, time: Float[np.ndarray, "n"]) -> TimedMotion:
        """Return samples of the motion at times that increase from 0 [s]; from `duration_s` on the arm is at rest."""
        parts = []
        for blend, scaling, own in self._by_section(time):
            place, found = scaling.at(own)
            row = blend.row[blend.curve.leg(scaling.path.u(place))]
            parts.append((found.x, found.first, found.second, row))
        x, velocity, acceleration, row = map(np.concatenate, zip(*parts, strict=True))
        kind, target = self.motion.kind[row], self.motion.target[row]
        return TimedMotion(time, x, velocity, acceleration, kind, target, self.joint_names, self._span(row))

    def straight_at(self, time: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n N"]:
        """Return the configurations on the motion's straight joint paths at times that increase from 0 [s].

        They differ from those of `at` only where the program blends a corner, and have the same curve parameter.
        """
        parts = []
        for blend, scaling, own in self._by_section(time):
            u, curve = scaling.path.u(scaling.speed.at(own)[0]), blend.curve
            leg = curve.leg(u)
            parts.append(curve.x[leg] + (u - curve.u[leg])[:, None] * curve.slopes[leg])
        return np.concatenate(parts)

    def _by_section(self, time: Float[np.ndarray, "n"]) -> Iterator[tuple[Blend, TimeScaling, np.ndarray]]:
        """Yield each section with its time scaling, and the times in it, counted from its begin [s]."""
        ends = self.ends_s
        bounds = [0, *np.searchsorted(time, ends[:-1]).tolist(), len(time)]
        for k, (blend, scaling) in enumerate(zip(self.blends, self.scalings, strict=True)):
            yield blend, scaling, time[bounds[k] : bounds[k + 1]] - (ends[k] - scaling.speed.duration_s)

    def _span(self, row: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n 2"] | None:
        return None if self.motion.span is None else self.motion.span[row]

    def targets_at(self, blend: Blend, scaling: TimeScaling, place: Float[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
        """Return the targets to which a section leads at positions along it [m]."""
        return self.motion.target[blend.row[blend.curve.leg(scaling.path.u(place))]]

    def drops(self) -> list[FeedDrop]:
        """Return the feed drops along the path, in order."""
        found, before = [], 0.0
        for blend, scaling, feed in zip(self.blends, self.scalings, self.feeds_m_s, strict=True):
            if blend.on_process:
                found += _feed_drops(blend, scaling, before, feed, self)
                before += float(scaling.path.place[-1])
        return found


def time_motion(
    robot: Robot,
    motion: Motion,
    left: MotionSlack,
    limits: MotionLimits,
    feed_m_s: float | Float[np.ndarray, "T"],
    near_part: ShareOfSpeed | None = None,
) -> Program:
    """Return the fastest program of a motion within the feed rate and the limits.

    Args:
        robot: The robot with the job's tool.
        motion: The motion.
        left: Slack of the motion's proof at each leg.
        limits: Limits of the joints.
        feed_m_s: Feed rate of the TCP on the path; one for each target, or one for all.
        near_part: Lower speed near the part, see `near_part_speeds`; None: full speed.

    Raises:
        InputError: If the feed rate is not above 0, or if the motion would take longer than LONGEST_S.
        NothingToTimeError: If the motion has no configurations, or if the arm does not move.
    """
    for feed in np.unique(feed_m_s).tolist():
        if not 0 < feed < np.inf:
            raise InputError(f"feed is {feed} m/s; it must be above 0")
    if not len(motion.x):
        raise NothingToTimeError("the motion has no configurations: no target is executable")
    if not np.any(motion.x != motion.x[0]):
        raise NothingToTimeError("the arm does not move in this motion, so there is nothing to time")
    slowest = _slowest_limit(robot, motion, limits)
    parts = blends(robot, motion, left, limits, feed_m_s)
    paths, free = [path_of_blend(robot, part) for part in parts], near_part or (lambda path: np.inf)
    required = [_feed_of(part, motion, feed_m_s) for part in parts]
    seconds = sum(
        float(path.place[-1]) / feed for path, part, feed in zip(paths, parts, required, strict=True) if part.on_process
    )
    on_path = [feed for part, feed in zip(parts, required, strict=True) if part.on_process] or required
    if not seconds <= LONGEST_S:
        raise InputError(f"{_too_long(seconds)}: the feed is {1e3 * min(on_path):g} mm/s; choose a higher feed")
    feeds = [feed if part.on_process else free(path) for part, path, feed in zip(parts, paths, required, strict=True)]
    scalings = [time_scaling(path, limits, feed) for path, feed in zip(paths, feeds, strict=True)]
    made = Program(motion, parts, scalings, robot.joint_names, max(on_path), tuple(required))
    if not made.duration_s <= LONGEST_S:
        raise InputError(f"{_too_long(made.duration_s)}: {slowest}")
    return made


def _feed_of(part: Blend, motion: Motion, feed_m_s: float | Float[np.ndarray, "T"]) -> float:
    """Return the required feed on a section [m/s]."""
    return float(np.asarray(feed_m_s)[motion.target[part.row[0]]]) if np.ndim(feed_m_s) else float(feed_m_s)


def _blended(curve: Curve) -> Float[np.ndarray, "k"]:
    """Return the share of the longer leg next to each corner in which it is blended [1]; 0 at both ends."""
    legs = np.diff(curve.u)
    return np.append(0.0, np.append(curve.blend_length[1:-1] / np.maximum(legs[:-1], legs[1:]), 0.0))


def _slowest_limit(robot: Robot, motion: Motion, limits: MotionLimits) -> str:
    """Return the limit that lengthens a motion most, as text.

    The shortest time for a joint's total travel d within one of its limits is d / v, 2 (d / a)^(1/2) or
    (32 d / j)^(1/3), and the moving mean of the time scaling adds a / j.

    Raises:
        InputError: If this limit alone makes the motion longer than LONGEST_S.
    """
    d = np.abs(np.diff(motion.x, axis=0)).sum(axis=0)
    v, a, j = limits
    least = np.stack([d / v, 2 * np.sqrt(d / a), np.maximum(np.cbrt(32 * d / j), a / j)])
    kind, joint = np.unravel_index(least.argmax(), least.shape)
    unit = f"{'m' if robot.sliding[joint] else 'rad'}/s{('', '2', '3')[kind]}"
    text = f"the {RATES[kind]} limit of {robot.joint_names[joint]} is {limits[kind][joint]:g} {unit}"
    text += f"; raise it, for example by program.{RATES[kind]}"
    if not least[kind, joint] <= LONGEST_S:
        raise InputError(f"{_too_long(least[kind, joint])}: {text}")
    return text


def _too_long(seconds: float) -> str:
    return f"the motion takes {seconds:.3g} s, more than {LONGEST_S:,.0f} s"


def _feed_drops(blend: Blend, scaling: TimeScaling, before: float, feed: float, made: Program) -> list[FeedDrop]:
    """Return the feed drops of one section with a required feed that begins `before` metres along the path."""
    place, speed, _, _ = scaling.speed.at(instants(scaling.speed))
    names = made.joint_names
    target = made.targets_at(blend, scaling, place)
    slow, found = np.flatnonzero(speed < HELD * feed), []
    limit = scaling.limit_at(place)
    for part in _split_at(slow, np.diff(slow) > 1):
        ramps = [run for run in _split_at(part, np.diff(limit[part] >= 0)) if _is_ramp(limit[run], speed[run] / feed)]
        stands = np.isin(part, np.concatenate([part[:0], *ramps]))
        for piece in _split_at(part, np.diff(stands)):
            known = piece[limit[piece] >= 0]
            reason = _named(int(limit[known[speed[known].argmin()]]), names) if len(known) else "stop"
            ends, least = before + place[piece[[0, -1]]], speed[piece].min()
            at = target[[piece[0], piece[speed[piece].argmin()], piece[-1]]].tolist()
            found.append(FeedDrop(float(ends[0]), float(ends[1]), float(least), reason, *at))
    return found


def _is_ramp(limit: np.ndarray, share: np.ndarray) -> bool:
    """Return True if the only cause of a drop is a stop at its begin or end."""
    return bool(limit[0] < 0 and share.min() <= AT_REST)


def _split_at(which: np.ndarray, breaks: np.ndarray) -> list[np.ndarray]:
    """Return the indices in `which`, split after every break."""
    return [run for run in np.split(which, np.flatnonzero(breaks) + 1) if len(run)]


def _named(limit: int, names: tuple[str, ...]) -> str:
    return f"{RATES[limit % len(RATES)]} of {names[limit // len(RATES)]}"
