"""Figures of a robot program: duration, feed drops, and the largest used share of each limit."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.io.robots import RATES
from htcp_jax.status import Kind
from htcp_jax.trajectory.curve import Blend
from htcp_jax.trajectory.limits import MotionLimits
from htcp_jax.trajectory.program import FeedDrop, Program
from htcp_jax.trajectory.time_scaling import TimeScaling, instants

ROUNDING = 1e-9  # tolerance / speed limit


class Share(NamedTuple):
    """Largest used share of one kind of limit."""

    limit: str  # kind of limit: velocity, acceleration or jerk
    share: float  # largest value / limit [1]
    joint: str  # joint with the largest share
    time_s: float  # time of the largest share [s]


class ProgramFigures(NamedTuple):
    """Figures of a robot program."""

    duration_s: float  # [s]
    seconds: dict[str, float]  # duration of each kind of segment, by the name of its `status.Kind` [s]
    feed_m_s: float  # required feed; the largest one if seams have their own [m/s]
    path_m: float  # length of the TCP's motion on the path [m]
    held_share: float  # share of this length on which the feed is held within 1 % [1]
    reached_m_s: float  # minimum feed between the path's run-up and run-down; 0 if the arm stops there [m/s]
    reason: str | None  # cause of this minimum, as in `FeedDrop`; None if the feed is held
    reached_target: int | None  # target to which the motion leads at this minimum; None if the feed is held
    drops: list[FeedDrop]
    shares: list[Share]  # largest shares during the complete motion
    path_shares: list[Share]  # largest shares on the path; off the path the arm always reaches a limit

    @property
    def path_s(self) -> float:
        """Duration on the path, including dwells [s]."""
        return sum(self.seconds.get(kind.words, 0.0) for kind in (Kind.PROCESS, Kind.DWELL))


def program_figures(made: Program, limits: MotionLimits) -> ProgramFigures:
    """Return the figures of a robot program.

    If the tool does not follow a path, the figures of the feed are NaN, and `path_shares` is empty.
    """
    feeding = [each for each in zip(made.blends, made.scalings, strict=True) if each[0].on_process]
    path, drops = float(sum(scaling.path.place[-1] for _, scaling in feeding)), made.drops()
    off = sum(drop.end_m - drop.begin_m for drop in drops)
    held = 1 - off / path if path else np.nan
    looked_at = _sampled_shares(made, limits)
    on_path = [part for part, blend in zip(looked_at, made.blends, strict=True) if blend.on_process]
    return ProgramFigures(
        duration_s=made.duration_s,
        seconds=_seconds_by_kind(made),
        feed_m_s=made.feed_m_s,
        path_m=path,
        held_share=held,
        **_reached(made, feeding, drops),
        drops=drops,
        shares=_largest_shares(looked_at, made.joint_names),
        path_shares=_largest_shares(on_path, made.joint_names),
    )


def _seconds_by_kind(made: Program) -> dict[str, float]:
    found: dict[str, float] = {}
    time, row = made.passes()
    kinds = made.motion.kind[row]
    for kind, seconds in zip(kinds[1:].tolist(), np.diff(time).tolist(), strict=True):
        found[Kind(kind).words] = found.get(Kind(kind).words, 0.0) + seconds
    return found


def _reached(
    made: Program, feeding: list[tuple[Blend, TimeScaling]], drops: list[FeedDrop]
) -> dict[str, float | str | int | None]:
    """Return the fields on the minimum feed and its cause; the feed is 0 if the path has several sections."""
    if not feeding:
        return {"reached_m_s": np.nan, "reason": None, "reached_target": None}
    if feeding[1:]:
        inner = [drop for drop in drops if drop.reason == "stop" and drop.begin_m > drops[0].begin_m]
        return {"reached_m_s": 0.0, "reason": "stop", "reached_target": inner[0].target if inner else None}
    place, speed = _between_ends(feeding[0][1])
    least = int(speed.argmin())
    around = [drop for drop in drops if drop.begin_m <= place[least] <= drop.end_m]
    reason = min(around, key=lambda drop: drop.feed_m_s).reason if around else None
    target = None if reason is None else int(made.targets_at(*feeding[0], place[[least]])[0])
    return {"reached_m_s": float(speed[least]), "reason": reason, "reached_target": target}


def _between_ends(scaling: TimeScaling) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Return positions and speeds between a section's run-up and run-down.

    The run-up ends at the first position at which the time scaling, before its moving mean, reaches a speed limit; the
    run-down begins at the last one. If no limit is reached, only the fastest position is returned.
    """
    own, when = scaling.speed, instants(scaling.speed)
    place, speed = own.at(when)[:2]
    capped = np.flatnonzero(own.speed[1:-1] >= (1 - ROUNDING) * scaling.speed_limit[1:-1]) + 1
    if len(capped):
        first, last = own.slower * (own.time[capped[0]] + own.window_s), own.slower * own.time[capped[-1]]
        between = (when >= first) & (when <= last)
        if between.any():
            return place[between], speed[between]
    fastest = [int(speed.argmax())]
    return place[fastest], speed[fastest]


def _sampled_shares(made: Program, limits: MotionLimits) -> list[tuple[np.ndarray, list[np.ndarray]]]:
    """Return each section's sample times, and the joints' used shares of velocity, acceleration and jerk limits."""
    found = []
    for scaling, end in zip(made.scalings, made.ends_s.tolist(), strict=True):
        when = instants(scaling.speed)
        rates = scaling.at(when)[1][1:]
        shares = [np.abs(rate) / limit for rate, limit in zip(rates, limits, strict=True)]
        found.append((end - scaling.speed.duration_s + when, shares))
    return found


def _largest_shares(looked_at: list[tuple[np.ndarray, list[np.ndarray]]], names: tuple[str, ...]) -> list[Share]:
    if not looked_at:
        return []
    times, parts = zip(*looked_at, strict=True)
    time, found = np.concatenate(times), []
    for kind, share in zip(RATES, map(np.concatenate, zip(*parts, strict=True)), strict=True):
        row, joint = np.unravel_index(share.argmax(), share.shape)
        found.append(Share(kind, float(share[row, joint]), names[joint], float(time[row])))
    return found
