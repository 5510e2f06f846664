"""A program as it is played, and what is plotted of it: what the arm does, how fast the tool and the joints are."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Int8

from htcp_jax.status import Kind
from htcp_jax.trajectory.nudge import tcp_at
from htcp_jax.trajectory.of_plan import OfPlan
from htcp_jax.trajectory.program import Program
from htcp_jax.viewer.movie import RATE
from htcp_jax.viewer.posture import Posture, postures

INSTANTS = 600
BOUNDS = 0.1, 100.0  # of a joint's limit [%]: on the path joints are slow by two powers of ten
ROOM = 1.5  # over the feed that was asked for; off the path the TCP is faster, and its curve leaves the plot


class Played(NamedTuple):
    """n instants of a program."""

    time_s: Float[np.ndarray, "n"]
    x: Float[np.ndarray, "n N"]  # [rad or m]
    kind: Int8[np.ndarray, "n"]  # `status.Kind`
    target: Int[np.ndarray, "n"]  # the last one that the arm has come to, -1 before the first
    tcp_m_s: Float[np.ndarray, "n"]  # how fast the TCP is
    share: Float[np.ndarray, "n N"]  # how fast each joint is, of its limit [1]

    def words(self, k: int) -> str:
        """What is done at the k-th instant, and how fast."""
        return f"{self.time_s[k]:.2f} s: {Kind(int(self.kind[k])).words}, TCP {1e3 * self.tcp_m_s[k]:.1f} mm/s"


class Curves(NamedTuple):
    """n instants, evenly apart, from the first posture to the last."""

    time_s: Float[np.ndarray, "n"]
    tcp_mm_s: dict[Kind, Float[np.ndarray, "n"]]  # by what the arm does; NaN where it does something else
    feed_mm_s: float  # asked for
    share_percent: dict[str, Float[np.ndarray, "n"]]  # by the joint: its speed, of its limit

    @classmethod
    def of(cls, made: OfPlan, instants: int = INSTANTS) -> "Curves":
        """Those of a program."""
        play = played(made, np.linspace(0, made.program.duration_s, instants))
        tcp = {
            kind: np.where(play.kind == kind, 1e3 * play.tcp_m_s, np.nan) for kind in Kind if (play.kind == kind).any()
        }
        share = dict(zip(made.robot.joint_names, 100 * play.share.T, strict=True))
        return cls(play.time_s, tcp, 1e3 * made.program.feed_m_s, share)

    @property
    def top_mm_s(self) -> float:
        """How far up the TCP's speed is shown."""
        return ROOM * self.feed_mm_s


def played(made: OfPlan, time_s: Float[np.ndarray, "n"]) -> Played:
    """A program at times that rise from 0; from its end on the arm stands."""
    timed = made.program.at(time_s)
    _, jacobian = tcp_at(made.robot, timed.x)
    tcp = np.linalg.norm(np.einsum("nij,nj->ni", jacobian, timed.velocity), axis=1)
    share = np.abs(timed.velocity) / made.limits.velocity
    return Played(time_s, timed.x, timed.kind, _come_to(made.program, time_s), tcp, share)


def arms_of(made: OfPlan, play: Played) -> list[Posture]:
    """The arm at each instant."""
    return postures(made.robot, play.x, play.target, play.kind == Kind.DWELL)


def frame_times(duration_s: float, speed: float = 1.0) -> Float[np.ndarray, "n"]:
    """When the frames of a movie are taken [s], RATE a second, of a program that is shown at `speed` times real time.
    The movie takes the program's duration over `speed`, to within a frame."""
    return np.arange(int(duration_s * RATE / speed) + 1) * speed / RATE


def _come_to(program: Program, time_s: Float[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
    """By the postures that are passed: on the way there the last one of those that lead to a target is at it; on the
    way back each is at or behind its own."""
    passed = program.at_postures()
    back = passed.kind == Kind.RETRACT
    leads = passed.target + (passed.kind == Kind.DWELL)
    there = np.append((np.diff(leads) != 0) | back[1:], True) | back
    return (leads - ~there)[np.searchsorted(passed.time_s, time_s, side="right") - 1]
