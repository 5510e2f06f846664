"""`Problem`: the input of a planning method."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import jax
import numpy as np
from jaxtyping import Bool, Int

from htcp_jax.clearance.obstacles.obstacle import Obstacles
from htcp_jax.clearance.obstacles.scene import Scene
from htcp_jax.clearance.obstacles.tip_guard import TipGuard, make_tip_guard
from htcp_jax.device.programs import Kernels
from htcp_jax.model.robot import Robot
from htcp_jax.model.scenario import NOT_REFUSED, Scenario
from htcp_jax.model.task import Task
from htcp_jax.model.workpiece import Workpiece
from htcp_jax.motion.plans import Plans
from htcp_jax.settings import Settings


def ignore(tracked: int, finished: int) -> None:
    """Progress callback that does nothing."""


@dataclass(frozen=True, eq=False)
class Problem:
    """S scenarios of up to T targets for one arm at one workpiece, and the devices and threads to plan them with.

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

    @cached_property
    def kernels(self) -> list[Kernels]:
        """Executors of kernels in this scene, one for each device."""
        scene = Scene(self.robot, self.obstacles, self.task)
        spare = max(1, self.threads // max(1, len(self.to_plan)))  # threads without a scenario of their own
        return [Kernels(scene, self.settings, device, threads=spare) for device in self.devices]

    @cached_property
    def begins_anywhere(self) -> Bool[np.ndarray, "S"]:
        """`Scenario.begins_anywhere` of all scenarios, computed once for lookups scenario by scenario."""
        return self.scenarios.begins_anywhere

    @cached_property
    def tip_guard(self) -> TipGuard | None:
        """The walls that the tool's bare tip must not pass through; None if it may touch anywhere."""
        return make_tip_guard(self.workpiece)

    @property
    def to_plan(self) -> Int[np.ndarray, "_"]:
        """Indices of the scenarios to plan: those that were not refused beforehand."""
        return np.flatnonzero(self.scenarios.refused == NOT_REFUSED)

    def empty_plans(self) -> Plans:
        """Return plans in which nothing is attempted yet, to be filled in; refused scenarios already have their
        status."""
        plans = Plans.empty(self.scenarios.x_start, self.scenarios.targets, self.scenarios.count)
        refused = self.scenarios.refused != NOT_REFUSED
        plans.status[refused, 0] = self.scenarios.refused[refused]
        return plans
