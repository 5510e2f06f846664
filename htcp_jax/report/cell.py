"""The robot and the workpiece of a run, for the report: what is in the way of failed targets, and a picture.

They are read when they are first asked for. Where their files have changed or gone, the report does without and says
so.
"""

import warnings
from functools import cached_property

import numpy as np
from matplotlib.figure import Figure

from htcp_jax.errors import InputError
from htcp_jax.planner.obstruction import Obstruction
from htcp_jax.runs.run_folder import Run
from htcp_jax.viewer.picture import draw_cell
from htcp_jax.viewer.replay import Shelf, open_shelf


class RunScene:
    """The scene of one run."""

    def __init__(self, run: Run):
        self._run = run
        self._in_the_way: dict[str, dict[int, Obstruction]] = {}

    @cached_property
    def _opened(self) -> tuple[Shelf | None, str]:
        try:
            with warnings.catch_warnings():  # of the cloud and its units: the sweep has told them
                warnings.simplefilter("ignore")
                return open_shelf(self._run.folder), ""
        except InputError as error:
            return None, str(error)

    def trouble(self) -> str:
        """Why there is no scene; empty where there is one."""
        return self._opened[1]

    def in_the_way(self, method: str) -> dict[int, Obstruction]:
        """What is in the way in the scenarios that a method lost, by their numbers."""
        shelf, _ = self._opened
        if method not in self._in_the_way:
            self._in_the_way[method] = {} if shelf is None else shelf.obstructions(method)
        return self._in_the_way[method]

    def picture(self, number: int, method: str, title: str) -> Figure | None:
        """The arm in the workpiece of a scenario; None where there is no scene."""
        shelf, _ = self._opened
        if shelf is None:
            return None
        replay = shelf.replay(number, method)
        plans = shelf.plans(method)
        there = plans.status[number] >= 0
        arrays = {k: v[number : number + 1, there] for k, v in plans._asdict().items() if isinstance(v, np.ndarray)}
        return draw_cell(replay.robot, replay.cloud, replay.x[:1], plans._replace(**arrays), title)
