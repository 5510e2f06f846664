"""Scenarios of a sweep as arrays, with all inputs of the planner.

Scenarios share sections of their configurations as objects. What follows from sections is therefore built once for each
combination of them, and the arrays of all scenarios that share robot, workpiece and task are built together.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from htcp_jax.clearance import Obstacles
from htcp_jax.errors import InputError
from htcp_jax.jobs.build import (
    follower_at,
    obstacles_key,
    obstacles_of,
    robot_key,
    robot_of,
    task_of_job,
    walls_key,
    workpiece_key,
    workpiece_of,
)
from htcp_jax.jobs.grid_axes import ScenarioPoint
from htcp_jax.jobs.resolve import check_start
from htcp_jax.jobs.seam_keys import with_goals_of_seams
from htcp_jax.model import Robot, Scenario, Task, Workpiece, interior_plane_of, make_scenarios, start_and_home
from htcp_jax.model import scenario as scenario_functions
from htcp_jax.settings import Settings
from htcp_jax.spec import PlanConfig, numbers_of

# Sections of a configuration; the other keys are those of the start and the margins
SECTIONS = "robot", "positioner", "rail", "tool", "workpiece", "cell", "task", "settings"


class PlannerInputs(NamedTuple):
    """Inputs that all scenarios in one call of the planner share."""

    robot: Robot
    workpiece: Workpiece
    settings: Settings
    task: Task
    obstacles: Obstacles = ()  # those in addition to the workpiece


class Batch(NamedTuple):
    """Scenarios of a sweep, with all inputs of the planner."""

    cells: tuple[PlannerInputs, ...]  # the distinct inputs; scenarios with equal inputs share one entry
    cell: Int[np.ndarray, "S"]  # index of each scenario's inputs in `cells`
    scenarios: Scenario  # all scenarios, with a leading axis S in each array
    points: tuple[ScenarioPoint, ...]  # number and configuration of each scenario
    workpieces: tuple[Workpiece, ...]  # workpiece of each scenario; those in `cells` may have another path

    @property
    def robot(self) -> Robot:
        """Robot of the first scenario; the robots of all scenarios have the same joints."""
        return self.cells[0].robot

    @property
    def workpiece(self) -> Workpiece:
        """Workpiece of the first scenario."""
        return self.cells[0].workpiece


class _Shared(NamedTuple):
    """Values that scenarios with the same sections of the configuration share."""

    cell: int  # index in `Batch.cells`
    inputs: PlannerInputs  # those in `Batch.cells` may have another path
    T_world_workpiece: Float[np.ndarray, "4 4"]
    interior_plane: Float[np.ndarray, "4"]
    tool_extension_m: float
    obstacle_numbers: Float[np.ndarray, "P"] | None


class _Begin(NamedTuple):
    """The beginning of a scenario's motion [rad or m], and the point that follows the path at the start [m]."""

    x_start: Float[np.ndarray, "N"]
    x_home: Float[np.ndarray, "N"]
    follows: Float[np.ndarray, "3"]


def batch_of(
    name: str,
    config: PlanConfig,
    robot: Robot,
    points: Sequence[ScenarioPoint],
    alone: bool = False,
    remedy: str = "",
) -> Batch:
    """Build the scenarios of a sweep with their planner inputs.

    Args:
        name: Name of the sweep, for messages.
        config: Configuration shared by the scenarios.
        robot: Its robot.
        points: The scenarios.
        alone: True if all scenarios use the random keys of number 0.
        remedy: Text to append to the message on a start outside the joint limits.

    Raises:
        InputError: If a start is outside the joint limits, or if the robots have different joints. The message names
            the scenario.
    """
    builder = _Builder(name, config, robot, remedy)
    shared = [builder.shared(point) for point in points]
    begins = [builder.begin(point, own.inputs.robot) for point, own in zip(points, shared, strict=True)]
    groups: dict[tuple, list[int]] = {}
    for k, (point, own) in enumerate(zip(points, shared, strict=True)):
        alike = own.cell, id(own.inputs.workpiece), own.tool_extension_m, point.config.start is None
        groups.setdefault((*alike, point.config.approach), []).append(k)
    parts = [
        _scenarios([points[k] for k in rows], [shared[k] for k in rows], [begins[k] for k in rows], alone)
        for rows in groups.values()
    ]
    order = np.argsort(np.concatenate([np.array(rows) for rows in groups.values()]))
    scenarios = jax.tree.map(lambda leaf: leaf[order], scenario_functions.concatenate(parts))
    cell, parts = np.array([own.cell for own in shared], int), tuple(own.inputs.workpiece for own in shared)
    return Batch(tuple(builder.cells.values()), cell, scenarios, tuple(points), parts)


def _scenarios(
    points: Sequence[ScenarioPoint], shared: Sequence[_Shared], begins: Sequence[_Begin], alone: bool
) -> Scenario:
    """Return stacked scenarios with the same robot, workpiece, task and approach."""
    first, job = shared[0], points[0].config
    scenarios = make_scenarios(
        first.inputs.robot,
        first.inputs.workpiece,
        np.stack([begin.x_start for begin in begins]),
        np.stack([begin.x_home for begin in begins]),
        auto_start=job.start is None,
        follows=np.stack([begin.follows for begin in begins]),
        T_world_workpiece=np.stack([own.T_world_workpiece for own in shared]),
        interior_plane=np.stack([own.interior_plane for own in shared]),
        approach=job.approach,
        **{
            name: np.array([getattr(point.config, name) for point in points], float)
            for name in ("margin_m", "segment_margin_m", "transfer_margin_m", "transfer_falloff_m")
        },
        tool_extension_m=first.tool_extension_m,
        number=np.array([0 if alone else point.number for point in points]),
    )
    if first.obstacle_numbers is not None:
        scenarios = replace(scenarios, obstacle_numbers=np.stack([own.obstacle_numbers for own in shared]))
    rows: list[Scenario] = []
    for k, point in enumerate(points):
        with _naming(point):
            one = jax.tree.map(lambda leaf, k=k: np.asarray(leaf[k]), scenarios)
            rows.append(with_goals_of_seams(one, point.config, *first.inputs[:2], first.inputs.task))
        if rows[0].task_goals is None:  # the goals of all scenarios are their targets
            return scenarios
    return scenario_functions.stack(rows)


class _Builder:
    """Builder of values that scenarios share: for each combination of sections, and each beginning, once.

    Attributes:
        cells: The distinct planner inputs, by number.
    """

    def __init__(self, name: str, config: PlanConfig, robot: Robot, remedy: str):
        self.cells: dict[int, PlannerInputs] = {}
        self._name, self._robot, self._remedy, own = name, robot, remedy, robot_key(config)
        self._robots = cache(lambda *key: robot if key == own else robot_of(*key))
        self._workpieces = cache(lambda part, *key: workpiece_of(part, self._robots(*key)))
        self._obstacles: dict[tuple[tuple, tuple], Obstacles] = {}
        self._numbers: dict[tuple, int] = {}  # numbers of cells, by what determines them
        self._shared: dict[tuple[int, ...], _Shared] = {}
        self._begins: dict[tuple, _Begin] = {}

    def shared(self, point: ScenarioPoint) -> _Shared:
        """Return the values that a scenario shares with others."""
        sections = tuple(id(getattr(point.config, key)) for key in SECTIONS)
        if sections not in self._shared:
            self._shared[sections] = self._build(point)
        return self._shared[sections]

    def begin(self, point: ScenarioPoint, robot: Robot) -> _Begin:
        """Return the beginning of a scenario's motion with its robot."""
        job = point.config
        about = id(robot), job.robot.tool_extension_m, job.start_rad, job.home_rad, id(job.task)
        if about not in self._begins:
            check_start(job, robot, f"{self._name}: scenario {point.number}")
            with _naming(point, self._remedy):
                x_start, x_home = start_and_home(robot, job.start, job.home_rad)
                self._begins[about] = _Begin(x_start, x_home, follower_at(job, robot, x_start))
        return self._begins[about]

    def _build(self, point: ScenarioPoint) -> _Shared:
        job = point.config
        arm, part, surroundings = robot_key(job), workpiece_key(job), obstacles_key(job.cell)
        robot = _like(self._robot, self._robots(*arm), f"{self._name}: scenario {point.number}")
        workpiece = self._workpieces(part, *arm)
        with _naming(point):
            task = task_of_job(job, robot)
        if (arm, surroundings) not in self._obstacles:
            self._obstacles[arm, surroundings] = obstacles_of(job.cell, robot)
        inputs = PlannerInputs(robot, workpiece, job.settings, task, self._obstacles[arm, surroundings])
        about = arm, walls_key(part), job.settings, task, surroundings
        number = self._numbers.setdefault(about, len(self.cells))
        self.cells.setdefault(number, inputs)
        pose, obstacles = job.workpiece, job.cell.obstacles
        T = workpiece.T_world(pose.rotation_y_rad, pose.rotation_z_rad, pose.shift_m, pose.rotation_x_rad)
        own = _Shared(
            number,
            inputs,
            T,
            interior_plane_of(robot, workpiece, T),
            job.robot.tool_extension_m,
            numbers_of(obstacles) if obstacles else None,
        )
        with _naming(point):
            _check_alike(own, next(iter(self._shared.values()), own))
        return own


def _like(first: Robot, robot: Robot, where: str) -> Robot:
    """Return `robot` unchanged, after a check that it has the same joints as the first robot.

    Args:
        first: The first robot.
        robot: The robot to check.
        where: Name of its scenario, for messages.

    Raises:
        InputError: If the number or the types of the joints differ, or their followers and side branches.
    """
    own, firsts = ((each.slides, each.parents, each.tcp_link, each.sliding) for each in (robot, first))
    if own != firsts:
        raise InputError(
            f"{where}: {_joints_of(robot)}; {_joints_of(first)}; all robots of a sweep must have the same numbers of "
            "hinge and slide joints, the same followers and the same side branches"
        )
    return robot


def _joints_of(robot: Robot) -> str:
    """Return the numbers of an arm's joints as text, with its followers and side branches, and what carries them."""
    names, side = robot.all_joint_names, range(robot.tcp_link + 1, len(robot.slides))
    more = [f"{names[j]} on {(*names, 'the base')[robot.parents[j]]}" for j in sorted({*robot.followers, *side})]
    joints = f"{robot.name} has {robot.dof} joints, {sum(robot.sliding)} of them slides"
    return joints + ((more and f", with {', '.join(more)}") or "")


@contextmanager
def _naming(point: ScenarioPoint, remedy: str = "") -> Iterator[None]:
    """Put the scenario's number in front of the message of an `InputError`, and a remedy after it."""
    try:
        yield
    except InputError as error:
        raise InputError(f"scenario {point.number}: {error}{remedy}") from None


def _check_alike(own: _Shared, first: _Shared) -> None:
    """Check that obstacles have as many numbers as the first scenario's.

    Raises:
        InputError: If they differ.
    """
    if np.shape(own.obstacle_numbers) != np.shape(first.obstacle_numbers):
        raise InputError("its cell.obstacles need as many numbers as the first scenario's")
