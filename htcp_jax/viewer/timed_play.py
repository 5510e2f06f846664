"""Samples of a robot program for playback and plots: kind of motion, speeds of the TCP and the joints."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Int8

from htcp_jax.errors import InputError
from htcp_jax.status import Kind
from htcp_jax.trajectory import PlanProgram, Program, tcp_at
from htcp_jax.viewer.arm_pose import ArmPose, arm_poses
from htcp_jax.viewer.movie import RATE

MOST_FRAMES = 50_000  # maximum number of frames of a movie

INSTANTS = 600
BOUNDS = 0.1, 100.0  # axis range of joint speed / limit [%]; logarithmic, as joints are slow along the path
HEADROOM = 1.5  # top of the TCP speed axis / required feed rate; fast air moves exceed it


class PlaybackStates(NamedTuple):
    """States of a robot program at n times."""

    time_s: Float[np.ndarray, "n"]
    x: Float[np.ndarray, "n N"]  # [rad or m]
    kind: Int8[np.ndarray, "n"]  # `status.Kind`
    target: Int[np.ndarray, "n"]  # last reached target; -1 before the first target
    tcp_m_s: Float[np.ndarray, "n"]  # speed of the TCP
    share: Float[np.ndarray, "n N"]  # speed / limit of each joint [1]

    def words(self, k: int) -> str:
        """Return a description of the motion at the k-th time."""
        return f"{self.time_s[k]:.2f} s: {Kind(int(self.kind[k])).words}, TCP {1e3 * self.tcp_m_s[k]:.1f} mm/s"


class Curves(NamedTuple):
    """Curves of a robot program at n equidistant times, from its beginning to its end."""

    time_s: Float[np.ndarray, "n"]
    tcp_mm_s: dict[Kind, Float[np.ndarray, "n"]]  # by kind of motion; NaN during other kinds
    feed_mm_s: float  # required feed rate
    share_percent: dict[str, Float[np.ndarray, "n"]]  # joint speed / limit [%], by joint

    @classmethod
    def of(cls, made: PlanProgram, instants: int = INSTANTS) -> "Curves":
        """Compute the curves of a robot program at `instants` times."""
        play = sample_program(made, np.linspace(0, made.program.duration_s, instants))
        tcp = {
            kind: np.where(play.kind == kind, 1e3 * play.tcp_m_s, np.nan) for kind in Kind if (play.kind == kind).any()
        }
        share = dict(zip(made.robot.joint_names, 100 * play.share.T, strict=True))
        return cls(play.time_s, tcp, 1e3 * made.program.feed_m_s, share)

    @property
    def top_mm_s(self) -> float:
        """Upper end of the TCP speed axis [mm/s]."""
        return HEADROOM * self.feed_mm_s


def sample_program(made: PlanProgram, time_s: Float[np.ndarray, "n"]) -> PlaybackStates:
    """Sample a robot program at times that increase from 0; after its end the arm is at rest."""
    timed = made.program.at(time_s)
    _, jacobian = tcp_at(made.robot, timed.x)
    tcp = np.linalg.norm(np.einsum("nij,nj->ni", jacobian, timed.velocity), axis=1)
    share = np.abs(timed.velocity) / made.limits.velocity
    return PlaybackStates(time_s, timed.x, timed.kind, _come_to(made.program, time_s), tcp, share)


def arms_of(made: PlanProgram, play: PlaybackStates) -> list[ArmPose]:
    """Return the arm's pose at each time of `play`."""
    return arm_poses(made.robot, play.x, play.target, play.kind == Kind.DWELL)


def frame_times(duration_s: float, speed: float = 1.0) -> Float[np.ndarray, "n"]:
    """Return the times of a movie's frames, in the time of the robot program [s].

    The movie has RATE frames per second and takes the program's duration / `speed`, to within a frame.

    Args:
        duration_s: The robot program's duration.
        speed: Playback rate [1]; 1 is real time.

    Raises:
        InputError: For more than MOST_FRAMES frames.
    """
    if (count := int(duration_s * RATE / speed) + 1) > MOST_FRAMES:
        raise InputError(
            f"the motion takes {duration_s:.6g} s; a movie of it at {speed:g} times real time has {count:,} frames, at "
            f"most {MOST_FRAMES:,} are possible: choose a --speed of {duration_s * RATE / MOST_FRAMES:.3g} or more"
        )
    return np.arange(count) * speed / RATE


def reached_s(program: Program) -> tuple[Float[np.ndarray, "n"], Int[np.ndarray, "n"]]:
    """Return the times at which the program has reached targets [s], in order, and the targets; without the retract."""
    passed = program.at_configurations()
    leads, back = passed.target + (passed.kind == Kind.DWELL), passed.kind == Kind.RETRACT
    there = np.append((np.diff(leads) != 0) | back[1:], True) & ~back
    return passed.time_s[there], leads[there]


def _come_to(program: Program, time_s: Float[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
    """Return the last target reached at each time; -1 before the first target.

    Of a program's configurations that lead to a target, the last one is at the target. During the retract, every
    configuration is at its target or beyond it.
    """
    passed = program.at_configurations()
    back = passed.kind == Kind.RETRACT
    leads = passed.target + (passed.kind == Kind.DWELL)
    there = np.append((np.diff(leads) != 0) | back[1:], True) | back
    return (leads - ~there)[np.searchsorted(passed.time_s, time_s, side="right") - 1]
