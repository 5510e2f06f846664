"""Workcells of a plan set: robot, workpiece and settings, and their placement in each scenario."""

from collections.abc import Hashable
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.clearance import Obstacles
from htcp_jax.clearance.obstacles import of_workpiece
from htcp_jax.errors import InputError
from htcp_jax.jobs import PlanConfig, build
from htcp_jax.kinds import numbers_of
from htcp_jax.model import Robot, Scenario, Workpiece
from htcp_jax.model import scenario as scenarios
from htcp_jax.model import surface as surfaces
from htcp_jax.runs import PlanSet, parameters, plan_folder
from htcp_jax.runs import open as plan_sets

MOST_CELLS = 8  # largest number of workcells in memory


class Placement(NamedTuple):
    """Workpiece pose, interior plane and tool extension of one scenario, as `HasWorkpiecePose` requires."""

    T_world_workpiece: Float[np.ndarray, "4 4"]
    interior_plane: Float[np.ndarray, "4"]
    tool_extension_m: float
    obstacle_numbers: Float[np.ndarray, "P"] | None = None


class Workcell:
    """A robot and a workpiece, and the configuration that their scenarios share."""

    def __init__(self, config: PlanConfig, robot: Robot, workpiece: Workpiece):
        self.config, self.robot, self.workpiece = config, robot, workpiece

    @property
    def approach(self) -> int:
        """Number of targets before the tool path."""
        return self.config.on_path

    @cached_property
    def obstacle(self) -> Obstacles:
        """The workpiece and the other obstacles, for clearance queries."""
        return of_workpiece.all_obstacles(self.workpiece, build.obstacles_of(self.config.cell, self.robot))

    @cached_property
    def fixtures(self) -> surfaces.WorldGeometry:
        """The other obstacles, for drawing."""
        return build.drawn_of(self.config.cell, self.robot)

    @cached_property
    def surface(self) -> surfaces.Surface:
        """The workpiece, for drawing."""
        return surfaces.surface_of(self.workpiece.shown)


class RecordedCells:
    """Workcells of saved plans, built from the configurations at first use; the last few are cached.

    `cell(key)` is the workcell of the scenarios with that key. It raises InputError for files that cannot be read.
    """

    def __init__(self, found: PlanSet):
        self._found = found
        self.cell = lru_cache(maxsize=MOST_CELLS)(self._make)

    def key(self, number: int) -> Hashable:
        """Key that is equal for scenarios that share a workcell.

        The paths of a run's scenarios do not matter, as the targets are saved.
        """
        return self._keys[number] if self._found.mixed else None

    def placement(self, number: int) -> Placement:
        """Placement of a scenario in its workcell."""
        cell = self.cell(self.key(number))
        found = self._found
        kinds = (found.jobs[number] if found.mixed else found.config).cell.obstacles
        placement = _placement(cell.robot, cell.workpiece, found.parameters[number])
        return placement._replace(obstacle_numbers=numbers_of(kinds) if kinds else None)

    @cached_property
    def _keys(self) -> dict[int, Hashable]:
        return {number: _shared(self._found.jobs[number]) for number in self._found.parameters}

    def _make(self, key: Hashable) -> Workcell:
        found = self._found
        first = next(number for number in found.parameters if self.key(number) == key)
        config = found.jobs[first] if found.mixed else found.config
        robot = build.robot_of(config.robot, config.cell)
        return Workcell(config, robot, build.workpiece_of(config.workpiece, robot))


class GivenCell:
    """Workcell in memory, with one placement for all scenarios, by the interface of `RecordedCells`."""

    def __init__(self, cell: Workcell, scenario: Scenario):
        T, plane = np.asarray(scenario.T_world_workpiece), np.asarray(scenario.interior_plane)
        self._cell, self._placement = (
            cell,
            Placement(T, plane, float(scenario.tool_extension_m), scenario.obstacle_numbers),
        )

    def key(self, number: int) -> Hashable:
        """Key of every scenario: None."""
        del number
        return None

    def cell(self, key: Hashable) -> Workcell:
        """The only workcell."""
        del key
        return self._cell

    def placement(self, number: int) -> Placement:
        """Placement of every scenario."""
        del number
        return self._placement


Workcells = RecordedCells | GivenCell


def cells_of(found: PlanSet) -> RecordedCells:
    """Return the workcells of saved plans, with the first one built.

    Raises:
        InputError: If it cannot be built, and for a plan whose number of targets or joints differs from its
            configuration's.
    """
    cells = RecordedCells(found)
    cell = cells.cell(cells.key(min(found.parameters)))
    if isinstance(found, plan_sets.FolderPlan):
        shape = cell.approach + len(cell.workpiece.path), len(cell.robot.joint_names)
        if found.plans(found.methods[0]).x.shape[1:] != shape:
            raise InputError(
                f"{found.folder / plan_folder.TRAJECTORY} is not a plan of the configuration next to it; damaged"
            )
    return cells


def _shared(job: PlanConfig) -> tuple:
    """Properties that scenarios in one workcell share."""
    return build.robot_key(job), build.workpiece_key(job), job.approach, job.settings, job.cell


def _placement(robot: Robot, workpiece: Workpiece, given: parameters.Parameters) -> Placement:
    turn = given.rotation_y_rad, given.rotation_z_rad
    T = workpiece.T_world(*turn, tuple(given.shift_m.tolist()), given.rotation_x_rad)
    return Placement(T, scenarios.interior_plane_of(robot, workpiece, T), given.tool_extension_m)
