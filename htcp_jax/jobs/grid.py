"""Sweep files: a grid of scenarios around one configuration.

    config: ../configs/paper.yaml                      # shared by all scenarios; default: the default job
    grid:                                              # axes multiply; the last one moves fastest
      - start_rad.3: {offsets: [-0.1, 0, 0.1]}         # added to the configuration's value
      - workpiece.rotation_y_rad: [0.4, 0.5]           # parameters of one axis vary jointly (zipped)
        workpiece.rotation_z_rad: [0.1, 0.2]           # so this grid has 3 x 2 scenarios

A parameter is any key of the configuration except `method`, `program` and `ray`: see `grid_axes`. Joints are given by
number, from 1, or by name. Axes are applied in order, so an axis may set `start_rad` and the next ones change single
joints. Instead of `grid`, `groups` maps names to grids, whose scenarios are concatenated. A scenario's number, which
determines its random keys, is its index in the full grid.
"""

import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.clearance import Obstacles
from htcp_jax.errors import InputError
from htcp_jax.io import strict_model
from htcp_jax.jobs.build import (
    obstacles_key,
    obstacles_of,
    robot_key,
    robot_of,
    scenario_of,
    task_of_job,
    walls_key,
    workpiece_key,
    workpiece_of,
)
from htcp_jax.jobs.config import DEPENDENT, PlanConfig, WorkpieceConfig
from htcp_jax.jobs.config_file import put_key
from htcp_jax.jobs.defaults import fill_in, is_other, keys_of
from htcp_jax.jobs.examples import read_mapping
from htcp_jax.jobs.grid_axes import FILE_KEYS, KEYS, MOST, Group, ScenarioPoint, read_grid
from htcp_jax.jobs.grid_points import points_of
from htcp_jax.jobs.load_config import load_config, read_config
from htcp_jax.model import Robot, Scenario, Task, Workpiece
from htcp_jax.model import scenario as scenario_functions
from htcp_jax.settings import Settings


class SweepFile(strict_model.FileSection):
    """Content of a sweep file; `grid_axes` checks the axes."""

    config: str | None = None
    grid: tuple[dict, ...] | None = None
    groups: dict[str, tuple[dict, ...]] | None = None


class PlannerInputs(NamedTuple):
    """Data shared by the scenarios in one call of the planner."""

    robot: Robot
    workpiece: Workpiece
    settings: Settings
    task: Task
    obstacles: Obstacles = ()  # in addition to the workpiece


class Batch(NamedTuple):
    """Scenarios ready to be planned."""

    cells: tuple[PlannerInputs, ...]
    cell: Int[np.ndarray, "S"]  # index of each scenario's cell
    scenarios: Scenario  # stacked
    points: tuple[ScenarioPoint, ...]

    @property
    def robot(self) -> Robot:
        """Robot of the first scenario; all have the same joints."""
        return self.cells[0].robot

    @property
    def workpiece(self) -> Workpiece:
        """Workpiece of the first scenario."""
        return self.cells[0].workpiece


@dataclass(frozen=True)
class Sweep:
    """A sweep file, read and checked, with the robot of its configuration.

    Attributes:
        name: Stem of the file's name.
        config: Configuration shared by all scenarios.
        robot: Its robot.
        groups: The grids.
        stated: See `grid_points.points_of`.
        alone: True if every scenario uses the random keys of a job planned alone (number 0) in place of its own
            number's.
    """

    name: str
    config: PlanConfig
    robot: Robot
    groups: tuple[Group, ...]
    stated: frozenset[str]
    alone: bool = False

    def __len__(self) -> int:
        return sum(group.size for group in self.groups)

    def points(self, limit: int | None = None) -> tuple[ScenarioPoint, ...]:
        """Return the first `limit` scenarios, in order.

        Raises:
            InputError: For a value out of its range.
        """
        if limit is not None and not 1 <= limit <= MOST:
            raise InputError(f"limit is {limit}; valid: 1 to {MOST:,}")
        return tuple(itertools.islice(points_of(self.name, self.config, self.groups, self.stated), limit))

    def batch(self, limit: int | None = None) -> Batch:
        """Build the first `limit` scenarios with their cells.

        Raises:
            InputError: Naming the scenario, for a start outside the joint limits and targets beyond reach, and for
                robots with different joints.
        """
        points = self.points(limit)
        arms = {robot_key(self.config): self.robot}
        parts: dict[tuple[tuple, WorkpieceConfig], Workpiece] = {}
        obstacles: dict[tuple[tuple, tuple], Obstacles] = {}
        follows: dict[tuple, Float[np.ndarray, "3"]] = {}  # position at a start, see `make_scenario`
        cells: dict[tuple, tuple[int, PlannerInputs]] = {}
        scenarios, whose = [], []
        for point in points:
            arm, part, settings = robot_key(point.config), workpiece_key(point.config), point.config.settings
            if arm not in arms:
                arms[arm] = _like(self.robot, robot_of(*arm), f"{self.name}: scenario {point.number}")
            if (arm, part) not in parts:
                parts[arm, part] = workpiece_of(part, arms[arm])
            task, surroundings = _task(point, arms[arm]), obstacles_key(point.config.cell)
            if (arm, surroundings) not in obstacles:
                obstacles[arm, surroundings] = obstacles_of(point.config.cell, arms[arm])
            own = len(cells), PlannerInputs(arms[arm], parts[arm, part], settings, task, obstacles[arm, surroundings])
            whose.append(cells.setdefault((arm, walls_key(part), settings, task, surroundings), own)[0])
            begins = arm, point.config.robot.tool_extension_m, point.config.start, point.config.task
            number = 0 if self.alone else point.number
            scenarios.append(_scenario(point, arms[arm], parts[arm, part], follows.get(begins), number))
            follows[begins] = scenarios[-1].targets[0]
            _check_alike(point, task, next(iter(cells.values()))[1].task)
            _check_obstacles(point, scenarios[-1], scenarios[0])
        return Batch(
            tuple(cell for _, cell in cells.values()), np.array(whose, int), scenario_functions.stack(scenarios), points
        )


def load_sweep(
    spec: str | Path | Mapping[str, Any],
    config: str | Path | Mapping[str, Any] | None = None,
    overrides: Sequence[str] | Mapping[str, Any] = (),
) -> Sweep:
    """Load a sweep.

    Args:
        spec: Path of its file, or the name of an example, or a mapping, {"grid": [...]}, whose files are relative to
            the working folder.
        config: Configuration in place of the sweep's own.
        overrides: Changes to the configuration before the axes are applied, see `load_config`.

    Raises:
        InputError: For an invalid file, for an unknown parameter and for an empty grid.
    """
    path, raw = read_mapping(spec, "sweep")
    file: SweepFile = strict_model.validate_model(raw, SweepFile, str(path))
    if config is None and file.config is not None:
        config = path.parent / file.config
    if (file.grid is None) == (file.groups is None):
        raise InputError(f"{path}: a sweep has either a grid or groups, a list of axes or several under their names")
    grids = {None: file.grid} if file.groups is None else file.groups
    if not grids:
        raise InputError(f"{path}: groups is empty")
    raw, source = read_config(config, overrides)
    stated = keys_of(raw)
    first = _first_values(raw, grids, path.parent)
    for key, value in first.items():
        put_key(raw, key, value)
    fill_in(raw, keys_of(raw), source)
    base: PlanConfig = strict_model.validate_model(raw, PlanConfig, source)
    robot = robot_of(base.robot, base.cell)
    groups = []
    for name, axes in grids.items():
        where = f"{path}: grid" if name is None else f"{path}: groups.{name}"
        groups.append(read_grid(where, path.parent, name, axes, robot.joint_names))
        for key in first.keys() - groups[-1].keys:
            raise InputError(f"{where}: {key} varies in another group; it must vary in every one")
    if (size := sum(group.size for group in groups)) > MOST:
        raise InputError(f"{path}: the grid has {size:,} scenarios; at most {MOST:,} make a sweep")
    return Sweep(path.stem, base, robot, tuple(groups), frozenset(stated.intersection((*DEPENDENT, "start_rad"))))


def load_sweep_or_job(
    spec: str | Path | Mapping[str, Any],
    config: str | Path | Mapping[str, Any] | None = None,
    overrides: Sequence[str] | Mapping[str, Any] = (),
) -> Sweep:
    """Load a sweep, or a job as a sweep of one scenario.

    Args:
        spec: As of `load_sweep`, or a job's; a job has neither `grid` nor `groups`.
        config: Configuration in place of the sweep's own.
        overrides: Changes to the configuration.

    Raises:
        InputError: As `load_sweep` and `load_config`, and for a job with another configuration.
    """
    path, raw = read_mapping(spec, "sweep")
    if not isinstance(raw, dict) or {"grid", "groups"} & raw.keys():
        return load_sweep(spec, config, overrides)
    if config is not None:
        raise InputError(f"{path} is a job; only a sweep takes another configuration")
    job = load_config(spec, overrides)
    name = "job" if isinstance(spec, Mapping) else path.stem
    return Sweep(name, job, robot_of(job.robot, job.cell), (Group(None, ()),), frozenset(), alone=True)


def _first_values(raw: dict, grids: Mapping[str | None, Sequence[dict]], folder: Path) -> dict[str, Any]:
    """Return the values that the configuration takes from the axes, so that it has a robot and a start.

    If they vary the robot, the first value of each of its keys and of the start; else the first start, if another robot
    has no start.
    """
    first: dict[str, Any] = {}
    for axis in itertools.chain.from_iterable(grids.values()):
        for key, value in axis.items():
            items = value.get("values") if isinstance(value, dict) else value
            if isinstance(items, list | tuple) and items:
                first.setdefault(str(key), items[0])
    if "robot.model" not in first:
        lacks_start = is_other(raw, "robot.model") and "start_rad" not in raw
        return {key: value for key, value in first.items() if key == "start_rad" and lacks_start}
    model = first.pop("robot.model")
    if isinstance(model, str | os.PathLike):
        first["robot.model"] = model if model in FILE_KEYS["robot.model"] else str(folder / model)
    return {
        key: value for key, value in first.items() if key == "start_rad" or (key.startswith("robot.") and key in KEYS)
    }


def _like(first: Robot, robot: Robot, where: str) -> Robot:
    """Return the robot.

    Raises:
        InputError: If its joint types differ from the first one's.
    """
    if robot.slides != first.slides:
        kinds = [f"{one.name} has {len(one.slides)} joints, {sum(one.slides)} of them slides" for one in (robot, first)]
        raise InputError(f"{where}: {'; '.join(kinds)}; the robots of one sweep must have as many joints of each kind")
    return robot


def _task(point: ScenarioPoint, robot: Robot) -> Task:
    try:
        return task_of_job(point.config, robot)
    except InputError as error:
        raise InputError(f"scenario {point.number}: {error}") from None


def _check_alike(point: ScenarioPoint, task: Task, first: Task) -> None:
    """Check that a goal has as many numbers as the first scenario's: all are stacked in one array.

    Raises:
        InputError: If it has not.
    """
    if task.numbers != first.numbers:
        raise InputError(
            f"scenario {point.number}: its task has other rows than the first one's; "
            "a cone of 0 degrees is no cone, and the TCP with an offset is another point than without"
        )


def _check_obstacles(point: ScenarioPoint, scenario: Scenario, first: Scenario) -> None:
    """Raise InputError if the obstacles have another count of numbers than the first scenario's."""
    if np.shape(scenario.obstacle_numbers) != np.shape(first.obstacle_numbers):
        raise InputError(f"scenario {point.number}: its cell.obstacles have other numbers than the first one's")


def _scenario(
    point: ScenarioPoint, robot: Robot, workpiece: Workpiece, follows: Float[np.ndarray, "3"] | None, number: int
) -> Scenario:
    try:
        return scenario_of(point.config, robot, workpiece, number, "record", follows)
    except InputError as error:
        raise InputError(f"scenario {point.number}: {error}") from None
