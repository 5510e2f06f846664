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
    """Input of a method: S scenarios with up to T targets, arm, workpiece and obstacles, devices and threads.

    A problem is final: before a method gets it, starts are chosen and scenarios are refused. Its arrays are read-only.
    `progress` has two arguments: the numbers of newly tracked targets and of newly finished scenarios. It may be called
    at any time, on any thread; an exception in it ends planning. If `check_paths` is True, joint paths that the method
    did not check are checked after its `plan`.
    """

    robot: Robot  # without the scenarios' own tool extensions, see `model.robot.lengthen_tool`
    workpiece: Workpiece
    scenarios: Scenario  # stacked: a leading axis of S on every leaf, numpy
    settings: Settings
    task: Task  # constraints at every target
    obstacles: Obstacles  # all obstacles, including the workpiece's
    devices: Sequence[jax.Device]  # all CPUs or all GPUs
    threads: int  # 1 or more
    check_paths: bool = True
    progress: Callable[[int, int], None] = ignore

    def __post_init__(self):
        object.__setattr__(self, "scenarios", jax.tree.map(_read_only, self.scenarios))

    @cached_property
    def checkers(self) -> tuple[CollisionChecker, ...]:
        """Collision checkers of this scene, one for each device."""
        scene, guard = Scene(self.robot, self.obstacles, self.task), tip_guard.make_tip_guard(self.workpiece)
        extra = max(1, self.threads // max(1, len(self.to_plan)))  # threads per scenario
        each = (Executor(scene, self.settings, device, threads=extra) for device in self.devices)
        return tuple(CollisionChecker(executor, self.settings, guard) for executor in each)

    @cached_property
    def begins_anywhere(self) -> Bool[np.ndarray, "S"]:
        """`Scenario.begins_anywhere` of all scenarios, computed once."""
        return _read_only(self.scenarios.begins_anywhere)

    @property
    def to_plan(self) -> Int[np.ndarray, "_"]:
        """Indices of the scenarios to plan: those that are not refused."""
        return np.flatnonzero(self.scenarios.refused == scenario_functions.NOT_REFUSED)

    def empty_plans(self) -> Plans:
        """Return plans without any attempted target, to be filled in; refused scenarios already have their status."""
        plans = Plans.empty(*map(np.asarray, (self.scenarios.x_start, self.scenarios.targets, self.scenarios.count)))
        refused = self.scenarios.refused != scenario_functions.NOT_REFUSED
        plans.status[refused, 0] = self.scenarios.refused[refused]
        return plans

    def inputs(self, scenario: int, target: int, count: int = 1) -> LaneInputs:
        """Return the inputs of a `CollisionChecker` for one target of a scenario, in `count` equal rows."""
        return lane_inputs(self.scenarios, np.full(count, scenario), np.full(count, target))

    def in_threads(
        self, work: Callable[[CollisionChecker, slice], FoundInThread], threads: int | None = None
    ) -> list[FoundInThread]:
        """Call work(checker, share) in every thread, and return the results.

        Args:
            work: Function of the checker of the thread's device, and of a slice that selects the thread's share of the
                rows of any table.
            threads: Number of threads; None: `self.threads`.
        """
        checkers, threads = self.checkers, threads or self.threads  # checkers are made before there are threads

        def run(number: int) -> FoundInThread:
            checker = checkers[number % len(checkers)]
            with compute_devices.on(checker.executor.device):
                return work(checker, slice(number, None, threads))

        if threads == 1:
            return [run(0)]
        with ThreadPoolExecutor(threads) as pool:
            # Not `map`: if a call fails, `map` cancels calls that have not begun, for which other calls may wait.
            return [each.result() for each in [pool.submit(run, number) for number in range(threads)]]

    def with_scenarios(self, scenarios: Scenario, progress: Callable[[int, int], None] | None = None) -> "Problem":
        """Return the problem with other scenarios, and the same checkers; `progress` replaces the callback."""
        other = replace(self, scenarios=scenarios, progress=progress or self.progress)
        vars(other)["checkers"] = self.checkers
        return other

    def as_planned(self, plans: Plans) -> "Problem":
        """Return the problem with the targets of a method's plans.

        Plans may replace targets of the approach by the path's first point. From the first such target on, all targets
        of the approach get the goals of the path's first point.
        """
        before = np.arange(plans.target.shape[1]) < self.scenarios.on_path[:, None]
        left = np.logical_or.accumulate((plans.target != self.scenarios.targets).any(axis=2), axis=1) & before
        return self.with_scenarios(scenario_functions.with_free_approach(self.scenarios, left)) if left.any() else self


def _read_only(array: Anywhere) -> np.ndarray:
    """Return a read-only view of an array."""
    view = np.asarray(array).view()
    view.flags.writeable = False
    return view
