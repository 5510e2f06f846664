"""A program as it is played: at each instant what the arm does, and how fast the tool and the joints are."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Int8

from htcp_jax.program.nudge import tcp_at
from htcp_jax.program.of_plan import OfPlan
from htcp_jax.program.timed import Timed
from htcp_jax.status import Kind
from htcp_jax.viewer.playback import Posture, postures

LEADS = Kind.TRANSFER, Kind.APPROACH, Kind.FEED  # on these legs the target that they lead to is still to come


class Played(NamedTuple):
    """n instants of a program."""

    time_s: Float[np.ndarray, "n"]
    x: Float[np.ndarray, "n N"]  # [rad or m]
    kind: Int8[np.ndarray, "n"]  # `status.Kind`
    target: Int[np.ndarray, "n"]  # the last one that the arm has come to, -1 before the first
    tcp_m_s: Float[np.ndarray, "n"]  # how fast the TCP is
    share: Float[np.ndarray, "n N"]  # how fast each joint is, of its limit [1]


def played(made: OfPlan, time_s: Float[np.ndarray, "n"]) -> Played:
    """A program at times that rise from 0; from its end on the arm stands."""
    timed = made.program.at(time_s)
    _, jacobian = tcp_at(made.robot, timed.x)
    tcp = np.linalg.norm(np.einsum("nij,nj->ni", jacobian, timed.velocity), axis=1)
    share = np.abs(timed.velocity) / made.limits.velocity
    return Played(time_s, timed.x, timed.kind, _come_to(timed, made.program.duration_s), tcp, share)


def arms_of(made: OfPlan, play: Played) -> list[Posture]:
    """The arm at each instant."""
    return postures(made.robot, play.x, play.target, play.kind == Kind.DWELL)


def frame_times(duration_s: float, rate: float, speed: float = 1.0) -> Float[np.ndarray, "n"]:
    """When the frames of a movie are taken [s], `rate` a second, of a program that is shown `speed` times as fast as it
    is run: so many that the movie takes its time over `speed`, to within a frame."""
    return np.arange(int(duration_s * rate / speed) + 1) * speed / rate


def _come_to(timed: Timed, duration_s: float) -> Int[np.ndarray, "n"]:
    coming = np.isin(timed.kind, LEADS) & (timed.time_s < duration_s)
    return timed.target - coming
