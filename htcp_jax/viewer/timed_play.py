"""A program as it is played: at each instant what the arm does, and how fast the tool and the joints are."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Int8

from htcp_jax.program.nudge import tcp_at
from htcp_jax.program.of_plan import OfPlan
from htcp_jax.program.program import Program
from htcp_jax.status import Kind
from htcp_jax.viewer.movie import RATE
from htcp_jax.viewer.playback import Posture, postures


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
