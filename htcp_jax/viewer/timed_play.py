"""Playback and plots of a robot program: kind of motion, speeds of the TCP and the joints."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Int8

from htcp_jax.status import Kind
from htcp_jax.trajectory import PlanProgram, Program, tcp_at
from htcp_jax.viewer.arm_pose import ArmPose, arm_poses
from htcp_jax.viewer.movie import RATE

INSTANTS = 600
BOUNDS = 0.1, 100.0  # of a joint's limit [%]: on the path joints are slower by two orders of magnitude
HEADROOM = 1.5  # factor on the required feed rate; elsewhere the TCP may be faster, and its curve leaves the plot


class PlaybackStates(NamedTuple):
    """States at n instants of a robot program."""

    time_s: Float[np.ndarray, "n"]
    x: Float[np.ndarray, "n N"]  # [rad or m]
    kind: Int8[np.ndarray, "n"]  # `status.Kind`
    target: Int[np.ndarray, "n"]  # the last one reached, -1 before the first
    tcp_m_s: Float[np.ndarray, "n"]  # speed of the TCP
    share: Float[np.ndarray, "n N"]  # speed of each joint by its limit [1]

    def words(self, k: int) -> str:
        """Description of the motion at the k-th instant."""
        return f"{self.time_s[k]:.2f} s: {Kind(int(self.kind[k])).words}, TCP {1e3 * self.tcp_m_s[k]:.1f} mm/s"


class Curves(NamedTuple):
    """Curves of a robot program at n equidistant instants, from its begin to its end."""

    time_s: Float[np.ndarray, "n"]
    tcp_mm_s: dict[Kind, Float[np.ndarray, "n"]]  # by kind of motion; NaN during other kinds
    feed_mm_s: float  # required
    share_percent: dict[str, Float[np.ndarray, "n"]]  # by joint: its speed by its limit

    @classmethod
    def of(cls, made: PlanProgram, instants: int = INSTANTS) -> "Curves":
        """Compute the curves of a robot program."""
        play = sample_program(made, np.linspace(0, made.program.duration_s, instants))
        tcp = {
            kind: np.where(play.kind == kind, 1e3 * play.tcp_m_s, np.nan) for kind in Kind if (play.kind == kind).any()
        }
        share = dict(zip(made.robot.joint_names, 100 * play.share.T, strict=True))
        return cls(play.time_s, tcp, 1e3 * made.program.feed_m_s, share)

    @property
    def top_mm_s(self) -> float:
        """Upper limit of the plot of the TCP's speed."""
        return HEADROOM * self.feed_mm_s


def sample_program(made: PlanProgram, time_s: Float[np.ndarray, "n"]) -> PlaybackStates:
    """Sample a robot program at times that increase from 0; after its end the arm is at rest."""
    timed = made.program.at(time_s)
    _, jacobian = tcp_at(made.robot, timed.x)
    tcp = np.linalg.norm(np.einsum("nij,nj->ni", jacobian, timed.velocity), axis=1)
    share = np.abs(timed.velocity) / made.limits.velocity
    return PlaybackStates(time_s, timed.x, timed.kind, _come_to(made.program, time_s), tcp, share)


def arms_of(made: PlanProgram, play: PlaybackStates) -> list[ArmPose]:
    """The arm at each instant."""
    return arm_poses(made.robot, play.x, play.target, play.kind == Kind.DWELL)


def frame_times(duration_s: float, speed: float = 1.0) -> Float[np.ndarray, "n"]:
    """Times of a movie's frames, in the time of the robot program [s].

    The movie has RATE frames a second and takes the program's duration over `speed`, to within a frame.

    Args:
        duration_s: The program's duration.
        speed: Playback rate; 1 is real time [1].
    """
    return np.arange(int(duration_s * RATE / speed) + 1) * speed / RATE


def _come_to(program: Program, time_s: Float[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
    """Last target reached at each time.

    Of the program's configurations that lead to a target, the last one is at it; during the retract each is at its
    target or past it.
    """
    passed = program.at_configurations()
    back = passed.kind == Kind.RETRACT
    leads = passed.target + (passed.kind == Kind.DWELL)
    there = np.append((np.diff(leads) != 0) | back[1:], True) | back
    return (leads - ~there)[np.searchsorted(passed.time_s, time_s, side="right") - 1]
