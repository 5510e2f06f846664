"""Playback timeline of the page: by target for a plan, by time [s] for a robot program.

A place is a number on the slider, or between two numbers. Playback runs from `begin` to `end`: for a plan to the last
tracked target, though the slider extends to `last`.
"""

import numpy as np

from htcp_jax.trajectory import PlanProgram
from htcp_jax.viewer.arm_pose import ArmPose
from htcp_jax.viewer.playback import pose_at, poses_along
from htcp_jax.viewer.replay import Replay
from htcp_jax.viewer.timed_play import Curves, arms_of, sample_program

MOST_BETWEEN = 4  # configurations that share the time of a target; more of them, as in a dwell, take longer
TICK_S = 0.05  # between frames of a robot program
SHOWN_PER_SECOND = 60  # number of its configurations to which the camera is fitted


class ByTarget:
    """Timeline of a plan by target, on which no configuration is skipped.

    Configurations of the segment to the next target are at places between the two, those before the first target at
    places below 0.

    Args:
        replay: The plan.
        note: A note that is displayed at every place.
    """

    name, step, curves = "Target", 1, None
    rate_name, rates, usual_rate = "Targets a second", ("5", "10", "20", "40"), "10"

    def __init__(self, replay: Replay, note: str = ""):
        self._note, row = note, poses_along(replay)
        self.end = row[-1].target
        row += [pose_at(replay, target) for target in range(row[-1].target + 1, len(replay.target))]
        targets = np.array([pose.target for pose in row])
        first = np.searchsorted(targets, targets)
        self._count = np.searchsorted(targets, targets, side="right") - first
        self.passed, self._places = row, targets + (np.arange(len(row)) - first) / self._count
        self.begin, self.last = float(self._places[0]), len(replay.target) - 1

    def look(self, place: float) -> tuple[ArmPose, str]:
        """The arm at a place, or the last before it, and a note."""
        return self.passed[self._row(place)], self._note

    def on_slider(self, place: float) -> int:
        """Value of the slider: the target that was reached last."""
        return max(int(np.floor(place)), 0)

    def after(self, place: float, passed_s: float, rate: float) -> float:
        """Place of the next configuration.

        Args:
            place: The current place.
            passed_s: Time since the last frame; not used, so that no configuration is skipped.
            rate: Playback rate; not used.
        """
        del passed_s, rate
        return float(self._places[min(self._row(place) + 1, len(self._places) - 1)])

    def pause_s(self, place: float, rate: float) -> float:
        """Display time of the arm at a place [s]."""
        return 1 / rate / min(self._count[self._row(place)], 1 + MOST_BETWEEN)

    def _row(self, place: float) -> int:
        return max(int(np.searchsorted(self._places, place, side="right")) - 1, 0)


class ByTime:
    """Timeline of a robot program in seconds; frames are dropped if rendering cannot keep up."""

    name, step, begin = "Time [s]", 0.01, 0.0
    rate_name, rates, usual_rate = "Times real time", ("0.25", "1", "4", "16"), "1"

    def __init__(self, made: PlanProgram):
        self._made, self.curves = made, Curves.of(made)
        self.last = self.end = np.ceil(made.program.duration_s / self.step) * self.step
        self.passed = arms_of(made, sample_program(made, np.linspace(0, self.last, SHOWN_PER_SECOND)))

    def look(self, place: float) -> tuple[ArmPose, str]:
        """The arm at a time, and a description of its motion."""
        play = sample_program(self._made, np.array([float(place)]))
        return arms_of(self._made, play)[0], f"**{play.words(0)}**"

    def on_slider(self, place: float) -> float:
        """Value of the slider [s]."""
        return round(place, 2)

    def after(self, place: float, passed_s: float, rate: float) -> float:
        """Place after a time.

        Args:
            place: The current place.
            passed_s: Time since the last frame.
            rate: Playback rate; 1 is real time.
        """
        return min(place + rate * passed_s, self.last)

    def pause_s(self, place: float, rate: float) -> float:
        """Pause until the next frame [s]."""
        del place, rate
        return TICK_S


Timeline = ByTarget | ByTime
