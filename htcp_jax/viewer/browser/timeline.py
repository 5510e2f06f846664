"""Playback timeline of the page: by target for a plan, by time [s] for a robot program.

A place is a position on the timeline, possibly between two steps of the slider. Playback runs from `begin` to `end`.
For a plan, `end` is the last tracked target, and the slider extends to its last target, `last`.
"""

import numpy as np

from htcp_jax.trajectory import PlanProgram
from htcp_jax.viewer.arm_pose import ArmPose
from htcp_jax.viewer.playback import pose_at, poses_along
from htcp_jax.viewer.replay import Replay
from htcp_jax.viewer.timed_play import Curves, arms_of, sample_program

# Number of configurations that share a target's time; a segment with more, such as a dwell, takes longer.
MOST_BETWEEN = 4
TICK_S = 0.05  # time between frames of a robot program
SHOWN_PER_SECOND = 60  # number of the program's configurations that the camera has in view


class ByTarget:
    """Timeline of a plan by target; playback skips no configuration.

    Configurations between two targets have places between the targets' indices. Configurations before the first target
    have negative places.

    Args:
        replay: The plan.
        note: A text that is displayed at every place.
    """

    name, step, stride, curves = "Target", 1, 1, None
    rate_name, rates, usual_rate = "Targets per second", ("5", "10", "20", "40"), "10"

    def __init__(self, replay: Replay, note: str = ""):
        self._note, row = note, poses_along(replay)
        if replay.file is not None:
            self.name, self.rate_name = "Configuration", "Per second"
        self.end = row[-1].target
        row += [pose_at(replay, target) for target in range(row[-1].target + 1, len(replay.target))]
        targets = np.array([pose.target for pose in row])
        first = np.searchsorted(targets, targets)
        self._count = np.searchsorted(targets, targets, side="right") - first
        self.passed, self._places = row, targets + (np.arange(len(row)) - first) / self._count
        self.begin, self.last = float(self._places[0]), len(replay.target) - 1

    def look(self, place: float) -> tuple[ArmPose, str]:
        """Return the arm at the last configuration up to a place, and the note."""
        return self.passed[self._row(place)], self._note

    def on_slider(self, place: float) -> int:
        """Return the slider's value at a place: the last reached target."""
        return max(int(np.floor(place)), 0)

    def after(self, place: float, passed_s: float, rate: float) -> float:
        """Return the place of the next configuration.

        Args:
            place: The current place.
            passed_s: Time since the last frame; not used, as no configuration is skipped.
            rate: Playback rate; not used.
        """
        return float(self._places[min(self._row(place) + 1, len(self._places) - 1)])

    def pause_s(self, place: float, rate: float) -> float:
        """Return the time for which the arm is displayed at a place [s]."""
        return 1 / rate / min(self._count[self._row(place)], 1 + MOST_BETWEEN)

    def _row(self, place: float) -> int:
        return max(int(np.searchsorted(self._places, place, side="right")) - 1, 0)


class ByTime:
    """Timeline of a robot program in seconds; frames are dropped if rendering cannot keep up."""

    name, step, stride, begin = "Time [s]", 0.01, 0.1, 0.0
    rate_name, rates, usual_rate = "Speed / real time", ("0.25", "1", "4", "16"), "1"

    def __init__(self, made: PlanProgram):
        self._made, self.curves = made, Curves.of(made)
        self.last = self.end = np.ceil(made.program.duration_s / self.step) * self.step
        self.passed = arms_of(made, sample_program(made, np.linspace(0, self.last, SHOWN_PER_SECOND)))

    def look(self, place: float) -> tuple[ArmPose, str]:
        """Return the arm at a time, and a description of its motion."""
        play = sample_program(self._made, np.array([float(place)]))
        return arms_of(self._made, play)[0], f"**{play.words(0)}**"

    def on_slider(self, place: float) -> float:
        """Return the slider's value at a place [s]."""
        return round(place, 2)

    def after(self, place: float, passed_s: float, rate: float) -> float:
        """Return the place after the time `passed_s`.

        Args:
            place: The current place.
            passed_s: Time since the last frame.
            rate: Playback rate; 1 is real time.
        """
        return min(place + rate * passed_s, self.last)

    def pause_s(self, place: float, rate: float) -> float:
        """Return the pause until the next frame [s]."""
        return TICK_S


Timeline = ByTarget | ByTime
