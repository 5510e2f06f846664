"""What a program comes to: how long it takes, where the feed is held, and how much of each limit is used."""

from typing import NamedTuple

import numpy as np

from htcp_jax.program.limits import KINDS, Limits
from htcp_jax.program.program import Dip, Program
from htcp_jax.program.time_law import instants
from htcp_jax.status import Kind


class Share(NamedTuple):
    """Of one kind of limit, the largest share that is used of it."""

    limit: str  # velocity, acceleration or jerk
    share: float  # of it, 1 at the limit [1]
    joint: str
    time_s: float  # [s]


class Figures(NamedTuple):
    """Of a program."""

    duration_s: float  # [s]
    seconds: dict[str, float]  # of it, by the name of a `status.Kind` [s]
    feed_m_s: float  # asked for [m/s]
    path_m: float  # how far the TCP goes along the path [m]
    held_share: float  # of that, where the feed is held within 1 % [1]
    dips: list[Dip]
    shares: list[Share]


def figures(made: Program, limits: Limits) -> Figures:
    """All of them."""
    feeding = [law for stretch, law in zip(made.stretches, made.laws, strict=True) if stretch.feeds]
    path, dips = float(sum(law.path.place[-1] for law in feeding)), made.dips()
    off = sum(dip.end_m - dip.begin_m for dip in dips)
    held = 1 - off / path if path else np.nan
    return Figures(made.duration_s, _seconds(made), made.feed_m_s, path, held, dips, _shares(made, limits))


def _seconds(made: Program) -> dict[str, float]:
    found: dict[str, float] = {}
    timed = made.at_postures()
    for kind, seconds in zip(timed.kind[1:].tolist(), np.diff(timed.time_s).tolist(), strict=True):
        found[Kind(kind).words] = found.get(Kind(kind).words, 0.0) + seconds
    return found


def _shares(made: Program, limits: Limits) -> list[Share]:
    times, parts = [], []
    for law, end in zip(made.laws, made.ends_s.tolist(), strict=True):
        when = instants(law.speed)
        times.append(end - law.speed.duration_s + when)
        rates = law.at(when)[1][1:]
        parts.append([np.abs(rate) / limit for rate, limit in zip(rates, limits, strict=True)])
    time = np.concatenate(times)
    found = []
    for kind, share in zip(KINDS, map(np.concatenate, zip(*parts, strict=True)), strict=True):
        row, joint = np.unravel_index(share.argmax(), share.shape)
        found.append(Share(kind, float(share[row, joint]), made.joint_names[joint], float(time[row])))
    return found
