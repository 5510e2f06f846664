"""Robot and workpiece of a run, for the report: colliding bodies at failed targets, and pictures.

The robot's and the workpiece's files are read at first use. If one has changed or is missing, the report has no
colliding bodies and no pictures, and gives the reason.
"""

import warnings
from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int

from htcp_jax import viewer
from htcp_jax.errors import InputError
from htcp_jax.motion import Plans
from htcp_jax.reachability import Obstruction, Reach
from htcp_jax.runs import Run
from htcp_jax.runs import open as plan_sets
from htcp_jax.viewer import Replays, recorded_replays

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class OpenedScene:
    """Robot, workpiece and obstacles of one run, opened at first use.

    Args:
        run: The run.
        plans: Plans by method, for every method with at least one finished shard.
    """

    def __init__(self, run: Run, plans: Mapping[str, Plans]):
        self._run, self._plans = run, plans
        self._colliding_bodies: dict[str, dict[int, Obstruction]] = {}

    @cached_property
    def _opened(self) -> tuple[Replays | None, str]:
        try:
            with warnings.catch_warnings():  # the sweep has already shown the warnings on the cloud and its units
                warnings.simplefilter("ignore")
                return recorded_replays(plan_sets.plans_of_run(self._run), self._plans.__getitem__), ""
        except InputError as error:
            return None, str(error)

    @property
    def problem(self) -> str:
        """Reason why the scene cannot be read; empty if it can."""
        return self._opened[1]

    def colliding_bodies(self, method: str) -> dict[int, Obstruction]:
        """Return the colliding body by scenario, for the scenarios in which a method failed."""
        replays, _ = self._opened
        if method not in self._colliding_bodies:
            self._colliding_bodies[method] = {} if replays is None else replays.obstructions(method)
        return self._colliding_bodies[method]

    def picture(self, number: int, method: str, title: str) -> "Figure | None":
        """Draw a scenario's arm in its workpiece; return None if the scene cannot be read.

        Args:
            number: The number of the scenario.
            method: The method.
            title: The title of the figure.
        """
        replays, _ = self._opened
        if replays is None:
            return None
        replay = replays.replay(number, method)
        plans = self._plans[method].rows([number]).narrowed()
        part = replay.triangles, replay.part_axes
        return viewer.draw_cell(replay.robot, replay.cloud, replay.x[:1], plans, title, replay.fixtures, *part)

    def reach_picture(self, numbers: Int[np.ndarray, "S"], reach: Int[np.ndarray, "S T"], name: str) -> "Figure | None":
        """Draw the workpiece with its targets coloured by reach; return None if the scene cannot be read.

        Args:
            numbers: The numbers of the scenarios.
            reach: Values of `Reach`, a row per scenario.
            name: Name of the group of scenarios, for the title.
        """
        replays, _ = self._opened
        if replays is None:
            return None
        panels = []
        for number, own in zip(numbers[: viewer.reach_picture.PANELS].tolist(), reach, strict=False):
            method = next((each for each, plans in self._plans.items() if plans.exists[number].any()), None)
            if method is None:
                continue
            replay = replays.replay(number, method)
            path = own[: len(replay.target)] != Reach.NOT_JUDGED
            base = np.asarray(replay.robot.T_parent_joint)[0, :3, 3]
            reached = own[: len(path)][path]
            panels.append(viewer.ReachPanel(f"scenario {number}", replay.cloud, replay.target[path], reached, base))
        first = f"; the first {len(panels)} of {len(numbers)} scenarios" if len(panels) < len(numbers) else ""
        return viewer.draw_reach(panels, f"{name}: targets by their reach{first}")
