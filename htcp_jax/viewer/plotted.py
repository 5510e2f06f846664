"""What is plotted of a program against time, in a movie as in the browser."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.program.of_plan import OfPlan
from htcp_jax.status import Kind
from htcp_jax.viewer.timed_play import played

INSTANTS = 600
BOUNDS = 0.1, 100.0  # of a joint's limit [%]: on the path joints are slow by two powers of ten
ROOM = 1.5  # over the feed that was asked for; off the path the TCP is faster, and its curve leaves the plot


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
