"""`Problem`: the input of a planning method."""

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import jax
import numpy as np
from jaxtyping import Bool, Int

from htcp_jax.clearance import Obstacle, Obstacles, Scene
from htcp_jax.clearance.obstacles import all_obstacles, make_tip_guard, with_given
from htcp_jax.clearance.proof import motion_proof
from htcp_jax.device import Executor
from htcp_jax.device import devices as compute_devices
from htcp_jax.device import processes as worker_processes
from htcp_jax.errors import InputError
from htcp_jax.model import Robot, Scenario, Task, Workpiece
from htcp_jax.model import scenario as scenario_functions
from htcp_jax.motion import segment_tubes, start_check
from htcp_jax.motion.collision_checker import CollisionChecker
from htcp_jax.motion.lane_inputs import LaneInputs, lane_inputs
from htcp_jax.motion.plans import Plans
from htcp_jax.settings import Settings, settings_of
from htcp_jax.spec import ObstacleKind
from htcp_jax.types import Anywhere


@dataclass(frozen=True)
class Execution:
    """Devices, threads and processes that plan a problem. Results depend on none of them but the kind of device.

    Attributes:
        device: `cpu`, `gpu` or `gpu:2`; None: all GPUs if there are any, else the CPU.
        threads: Number of engines per process; None: one, or one per core if there is only one process.
        processes: Number of processes that share the scenarios on a CPU; None: see `processes.profitable_count`. With
            several NVIDIA GPUs, large problems get one process per GPU unless `processes` is 1. Work that other
            processes cannot import, for example a method or an obstacle defined in a notebook, is planned in this one.
            On a GPU, further processes on all cores solve the QPs of smoothing in large problems.
        targets_in_all: Number of targets of all problems that belong together, such as the shards of a sweep; None: of
            this problem. It determines whether several processes are used.
        warm_up: Names of methods that will plan such scenarios. Their executables are compiled before the plan, in
            parallel, see `Method.warm_up`.

    Raises:
        InputError: For fewer than one process.
    """

    device: str | None = None
    threads: int | None = None
    processes: int | None = None
    targets_in_all: int | None = None
    warm_up: tuple[str, ...] = ()

    def __post_init__(self):
        if self.processes is not None and self.processes < 1:
            raise InputError(f"processes is {self.processes}; it must be 1 or more")


DEFAULT = Execution()


FoundInThread = TypeVar("FoundInThread")
Rows = int | np.integer | Int[np.ndarray, "n"]


def ignore(tracked: int, finished: int, begun: int | None = None, drawn: int = 0) -> None:
    """Progress callback that does nothing."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Input of a method: S scenarios with up to T targets, arm, workpiece and obstacles, and how to execute it.

    `Problem.of` makes a problem. It is final: before a method gets it, starts are chosen and scenarios are refused. Its
    arrays are read-only. `progress` takes the numbers of newly tracked targets and of newly finished scenarios, and
    optionally of starts newly chosen and of configurations drawn to find them. It may be called at any time, on any
    thread; an exception in it ends planning.
    """

    robot: Robot  # without the scenarios' own tool extensions, see `model.robot.lengthen_tool`
    workpiece: Workpiece
    scenarios: Scenario  # stacked: a leading axis of S on every leaf, numpy
    settings: Settings
    task: Task  # constraints at every target
    other_obstacles: Obstacles = ()  # in addition to the workpiece's
    execution: Execution = DEFAULT
    check_paths: bool = True  # True: after `plan`, joint paths that the method did not check are checked
    check_starts: bool = False  # True: a start in collision is an error
    progress: Callable[..., None] = ignore
    prepared_s: float = 0.0  # time that `of` took, a part of `Plans.run_s`
    checkers: tuple[CollisionChecker, ...] = ()  # one for each device, made with the problem
    covers_meshes: bool = True  # False: no covering radius is subtracted from distances to points on meshes

    def __post_init__(self):
        object.__setattr__(self, "settings", self.settings.on(self.devices[0].platform))
        object.__setattr__(self, "scenarios", jax.tree.map(_read_only, self.scenarios))
        if not self.checkers:
            object.__setattr__(self, "checkers", self._new_checkers())

    @classmethod
    def of(
        cls,
        robot: Robot,
        workpiece: Workpiece,
        scenarios: Scenario | Sequence[Scenario],
        settings: Settings | Mapping[str, Any] | None = None,
        task: Task | None = None,
        obstacles: Sequence[Obstacle | ObstacleKind] = (),
        execution: Execution = DEFAULT,
        *,
        check_paths: bool = True,
        check_starts: bool = False,
    ) -> "Problem":
        """Check the input of a plan, and return it as a problem.

        Args:
            robot: The arm with its tool.
            workpiece: The part that the scenarios place.
            scenarios: One or several scenarios from `make_scenario`, or stacked scenarios.
            settings: Settings, or a mapping such as {"alpha_rad": 0.05} that changes the defaults.
            task: The constraints at every target; None: the TCP's position within `tolerance_m`.
            obstacles: Obstacles in addition to the workpiece, see `obstacle.Obstacle`.
            execution: Devices, threads and processes.
            check_paths: Afterwards check the straight joint path (`Plans.path_clear`) of every accepted step that the
                method did not check itself, verify the motion of every segment, and smooth the motions if
                `settings.smooth` or the method requires it.
            check_starts: True to raise an error for a start in collision, which otherwise gets a status.

        Raises:
            InputError: For an unknown device or setting, weights of the wrong length, no scenarios, a task with more
                rows than joints or that does not match the columns of the targets, and, with `check_starts`, a start
                with an overlap of excluded capsules.
        """
        settings = settings_of(settings)
        _check_settings(settings, robot)
        if not isinstance(scenarios, Scenario):
            scenarios = scenario_functions.stack(scenarios)
        elif scenarios.x_start.ndim == 1:
            scenarios = scenario_functions.stack([scenarios])
        if robot.indexed:  # the motion to the path may begin anywhere in the range of an indexed axis
            settings = replace(settings, transfers=True)
        others, scenarios = with_given(obstacles, jax.tree.map(np.asarray, scenarios))
        scenarios = start_check.with_refused(robot, others, scenarios, check_starts)
        task = Task(tolerance_m=settings.tolerance_m) if task is None else task
        _check_task(task, robot, scenarios)
        compute_devices.choose(execution.device)  # an unknown one is an error before the time below begins
        began = time.perf_counter()
        limited = scenario_functions.with_max_joint_step(scenarios, settings.max_joint_step_rad)
        problem = cls(robot, workpiece, limited, settings, task, others, execution, check_paths, check_starts)
        return replace(problem, prepared_s=time.perf_counter() - began)

    @cached_property
    def obstacles(self) -> Obstacles:
        """All obstacles, including the workpiece's."""
        found = all_obstacles(self.workpiece, self.other_obstacles)
        return found if self.covers_meshes else tuple(each.without_covering_radius for each in found)

    @cached_property
    def without_covering_radius(self) -> "Problem":
        """The problem with distances from the points on meshes, from which no covering radius is subtracted."""
        if not any(each.covering_radius_m for each in self.obstacles):
            return self
        return replace(self, covers_meshes=False, checkers=())

    @cached_property
    def devices(self) -> list[jax.Device]:
        """All CPUs or all GPUs of the execution."""
        return compute_devices.choose(self.execution.device)

    @cached_property
    def threads(self) -> int:
        """Number of engines of this process, 1 or more."""
        return self.execution.threads or compute_devices.default_threads(self.devices, self.settings.qp)

    @property
    def processes(self) -> int:
        """Number of processes to share the scenarios: on a CPU any number, on several NVIDIA GPUs one each, else 1."""
        targets, first = self.execution.targets_in_all or int(self.scenarios.count.sum()), self.devices[0]
        given = self.execution.processes or (1 if self.execution.threads else None)
        if first.platform == "cpu":
            return given or worker_processes.profitable_count(self.threads, len(self.scenarios.number), targets)
        pays = targets >= worker_processes.START_PAYS_ON_GPU if given is None else given > 1
        return len(self.devices) if pays and "cuda" in first.client.platform_version.lower() else 1

    @property
    def workers(self) -> list[dict[str, str]]:
        """Environment variables of each worker process that shares the scenarios."""
        if self.devices[0].platform == "cpu":
            return [worker_processes.ON_CPU] * self.processes
        return [worker_processes.on_gpu(device) for device in self.devices]

    def _new_checkers(self) -> tuple[CollisionChecker, ...]:
        with compute_devices.on(self.devices[0]):
            scene, guard = Scene(self.robot, self.obstacles, self.task), make_tip_guard(self.workpiece)
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

    def off_path(self, scenario: Rows, target: Rows) -> Bool[np.ndarray, "n"]:
        """Return True for segments on which the task is not required: before the path, and between seams.

        Args:
            scenario: Row of each segment's scenario.
            target: Target at each segment's end.
        """
        row = np.asarray(target - self.scenarios.on_path[scenario])  # row of the path
        begins = self.workpiece.seam_begins
        return (row <= 0) | np.isin(row, begins) if begins else row <= 0

    @cached_property
    def indexed(self) -> Bool[np.ndarray, "N"]:
        """True for joints that stand still within each seam, see `Robot.indexed`."""
        return np.array([name in self.robot.indexed for name in self.robot.joint_names])

    def with_still_joints(self, inputs: LaneInputs, scenario: Rows, target: Rows) -> LaneInputs:
        """Return inputs of lane functions that name the joints which must not move; unchanged if there are none.

        Args:
            inputs: The inputs.
            scenario: Row of each segment's scenario.
            target: Target at each segment's end; for a motion at a target, the next one.
        """
        if not self.robot.indexed:
            return inputs
        moves = self.off_path(scenario, target) & ~self.begins_anywhere[scenario]
        return inputs._replace(still=self.indexed & ~moves[:, None])

    def empty_plans(self) -> Plans:
        """Return plans without any attempted target, to be filled in; refused scenarios already have their status."""
        plans = Plans.empty(*map(np.asarray, (self.scenarios.x_start, self.scenarios.targets, self.scenarios.count)))
        refused = self.scenarios.refused != scenario_functions.NOT_REFUSED
        plans.status[refused, 0] = self.scenarios.refused[refused]
        return plans

    def inputs(self, scenario: Rows, target: Rows, count: int = 1) -> LaneInputs:
        """Return the inputs of lane functions and of a `CollisionChecker`, in `count` equal rows for each target.

        Args:
            scenario: Row of a scenario, or n rows.
            target: Index of the target, or n of them.
            count: Number of equal rows; those of one target follow each other.
        """
        rows = np.broadcast_arrays(scenario, target)
        return lane_inputs(self.scenarios, *(np.repeat(each, count) for each in rows))

    def tubes(
        self, scenario: Rows, target: Rows, count: int = 1, *, turns: np.ndarray | bool = False
    ) -> motion_proof.Tube:
        """Return the regions in which the TCP must stay on segments, with the task's goals and the required clearance.

        A tube is unbounded before the path and between seams, and if the task does not constrain the TCP's position.

        Args:
            scenario: Row of a scenario, or n rows.
            target: Index of the target at the segment's end, or n of them.
            count: Number of equal rows; those of one segment follow each other.
            turns: True, or a mask (n,), for parts of a segment on which the arm changes its configuration while the TCP
                stays.
        """
        s, t, turn = (np.repeat(each, count) for each in np.broadcast_arrays(scenario, target, turns))
        return segment_tubes.tubes(self.scenarios, self.task, self.settings.tube_m, s, t, turn, self.off_path(s, t))

    def in_threads(
        self, work: Callable[[CollisionChecker, slice], FoundInThread], threads: int | None = None
    ) -> list[FoundInThread]:
        """Call work(checker, share) in every thread, and return the results.

        Args:
            work: Function of the collision checker of the thread's device and of a slice. The slice selects the rows
                of a table that this thread computes, for example the scenarios `to_plan[share]`; it writes no others.
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

    def with_scenarios(self, scenarios: Scenario, progress: Callable[..., None] | None = None) -> "Problem":
        """Return the problem with other scenarios, and the same checkers; `progress` replaces the callback."""
        return replace(self, scenarios=scenarios, progress=progress or self.progress)

    def as_planned(self, plans: Plans) -> "Problem":
        """Return the problem with the targets of a method's plans.

        Plans may replace targets of the approach by the path's first point. From the first such target on, all targets
        of the approach get the goals of the path's first point.
        """
        before = np.arange(plans.target.shape[1]) < self.scenarios.on_path[:, None]
        left = np.logical_or.accumulate((plans.target != self.scenarios.targets).any(axis=2), axis=1) & before
        return self.with_scenarios(scenario_functions.with_free_approach(self.scenarios, left)) if left.any() else self


def _check_settings(settings: Settings, robot: Robot) -> None:
    """Check the length of weights, and that the solver is installed, even if the method does not use it."""
    joints = len(robot.joint_names)
    for name in ("q_weights", "path_weights", "max_joint_step_rad"):
        weights = getattr(settings, name)
        if isinstance(weights, tuple) and len(weights) != joints:
            raise InputError(f"{name} has {len(weights)} values, but the robot {robot.name} has {robot.counted_joints}")
    if settings.qp.startswith("qpsolvers:"):
        from htcp_jax.solvers import QPSolversSolver

        QPSolversSolver(settings.qp.partition(":")[2])


def _check_task(task: Task, robot: Robot, scenarios: Scenario) -> None:
    if task.freedom(robot) < len(robot.indexed):
        moving = [name for name in robot.joint_names if name not in robot.indexed]
        raise InputError(
            f"the task has {task.rows} equations, more than the joints that move along a seam, {', '.join(moving)}; "
            f"indexed: {', '.join(sorted(robot.indexed))}"
        )
    if scenarios.task_goals is None and (given := scenarios.targets.shape[-1]) != task.rows:
        raise InputError(f"the task has {task.rows} equations, but the targets have {given} numbers")
    if scenarios.task_goals is not None and (given := scenarios.task_goals.shape[-1]) != task.numbers:
        raise InputError(f"the task needs {task.numbers} numbers at each target, but the goals have {given}")


def _read_only(array: Anywhere) -> np.ndarray:
    """Return a read-only view of an array."""
    view = np.asarray(array).view()
    view.flags.writeable = False
    return view
