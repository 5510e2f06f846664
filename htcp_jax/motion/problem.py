"""`Problem`: the input of a planning method."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import jax
import numpy as np
from jaxtyping import Bool, Int

from htcp_jax.clearance import Obstacles, Scene
from htcp_jax.clearance.obstacles import tip_guard
from htcp_jax.device import Executor
from htcp_jax.device import devices as compute_devices
from htcp_jax.model import Robot, Scenario, Task, Workpiece
from htcp_jax.model import scenario as scenario_functions
from htcp_jax.motion.collision_checker import CollisionChecker
from htcp_jax.motion.lane_inputs import LaneInputs, lane_inputs
from htcp_jax.motion.plans import Plans
from htcp_jax.settings import Settings
from htcp_jax.types import Anywhere

FoundInThread = TypeVar("FoundInThread")


def ignore(tracked: int, finished: int) -> None:
    """Progress callback that does nothing."""


@dataclass(frozen=True, eq=False)
class Problem:
    """S scenarios of up to T targets for one arm at one workpiece, and the devices and threads to plan them with.

    A problem is final: starts are chosen and scenarios refused before a method gets it, and its arrays are read-only.
    progress(targets newly tracked, scenarios newly finished) may be called at any time, on any thread; an exception in
    it ends the work. After a method's `plan`, joint paths that it did not check are checked if `check_paths` is set.
    """

    robot: Robot  # without the scenarios' own tool extensions, see `model.robot.lengthen_tool`
    workpiece: Workpiece
    scenarios: Scenario  # stacked: a leading axis of S on every leaf, numpy
    settings: Settings
    task: Task  # to be fulfilled at every target
    obstacles: Obstacles  # the workpiece's, and all others
    devices: Sequence[jax.Device]  # of one kind
    threads: int  # 1 or more
    check_paths: bool = True
    progress: Callable[[int, int], None] = ignore

    def __post_init__(self):
        object.__setattr__(self, "scenarios", jax.tree.map(_read_only, self.scenarios))

    @cached_property
    def checkers(self) -> tuple[CollisionChecker, ...]:
        """Collision checkers of this scene, one for each device."""
        scene, guard = Scene(self.robot, self.obstacles, self.task), tip_guard.make_tip_guard(self.workpiece)
        extra = max(1, self.threads // max(1, len(self.to_plan)))  # threads without a scenario of their own
        each = (Executor(scene, self.settings, device, threads=extra) for device in self.devices)
        return tuple(CollisionChecker(executor, self.settings, guard) for executor in each)

    @cached_property
    def begins_anywhere(self) -> Bool[np.ndarray, "S"]:
        """`Scenario.begins_anywhere` of all scenarios, computed once for lookups scenario by scenario."""
        return _read_only(self.scenarios.begins_anywhere)

    @property
    def to_plan(self) -> Int[np.ndarray, "_"]:
        """Indices of the scenarios to plan: those that were not refused beforehand."""
        return np.flatnonzero(self.scenarios.refused == scenario_functions.NOT_REFUSED)

    def empty_plans(self) -> Plans:
        """Return plans in which nothing is attempted yet, to be filled in; refused scenarios have their status."""
        plans = Plans.empty(*map(np.asarray, (self.scenarios.x_start, self.scenarios.targets, self.scenarios.count)))
        refused = self.scenarios.refused != scenario_functions.NOT_REFUSED
        plans.status[refused, 0] = self.scenarios.refused[refused]
        return plans

    def inputs(self, scenario: int, target: int, count: int = 1) -> LaneInputs:
        """Return what a checker needs of one target, in `count` equal rows."""
        return lane_inputs(self.scenarios, np.full(count, scenario), np.full(count, target))

    def in_threads(
        self, work: Callable[[CollisionChecker, slice], FoundInThread], threads: int | None = None
    ) -> list[FoundInThread]:
        """Return the results of work(checker, share), one per thread, each with the checker of its device.

        Args:
            work: The function; `share` are the thread's rows of any table, every so many.
            threads: Number of threads; by default all of the problem's.
        """
        checkers, threads = self.checkers, threads or self.threads  # checkers are made before there are threads

        def run(number: int) -> FoundInThread:
            checker = checkers[number % len(checkers)]
            with compute_devices.on(checker.executor.device):
                return work(checker, slice(number, None, threads))

        if threads == 1:
            return [run(0)]
        with ThreadPoolExecutor(threads) as pool:
            # Not `map`: if one fails it cancels those that have not begun, for which others may wait.
            return [each.result() for each in [pool.submit(run, number) for number in range(threads)]]

    def with_scenarios(self, scenarios: Scenario, progress: Callable[[int, int], None] | None = None) -> "Problem":
        """Return the problem with other scenarios, and the same checkers; `progress` replaces the callback."""
        other = replace(self, scenarios=scenarios, progress=progress or self.progress)
        vars(other)["checkers"] = self.checkers
        return other

    def as_planned(self, plans: Plans) -> "Problem":
        """Return the problem with the targets that a method's plans have.

        Plans may replace targets of an approach by the path's first point: from the first such target on, all targets
        of the approach have its goals.
        """
        before = np.arange(plans.target.shape[1]) < self.scenarios.on_path[:, None]
        left = np.logical_or.accumulate((plans.target != self.scenarios.targets).any(axis=2), axis=1) & before
        return self.with_scenarios(scenario_functions.with_free_approach(self.scenarios, left)) if left.any() else self


def _read_only(array: Anywhere) -> np.ndarray:
    """Return a view of an array that cannot be written into."""
    view = np.asarray(array).view()
    view.flags.writeable = False
    return view
