"""Workcells of saved plans: robot, workpiece and settings, and the workpiece's placement in each scenario."""

from collections.abc import Hashable
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float

from htcp_jax.clearance import Obstacles
from htcp_jax.clearance.obstacles import all_obstacles
from htcp_jax.errors import InputError
from htcp_jax.jobs import build
from htcp_jax.model import Robot, Scenario, Task, Workpiece, interior_plane_of
from htcp_jax.model import surface as surfaces
from htcp_jax.motion import measured_rows
from htcp_jax.runs import Parameters, PlanSet, plan_folder
from htcp_jax.runs import open as plan_sets
from htcp_jax.spec import PlanConfig, numbers_of
from htcp_jax.viewer.drawn_meshes import MOST_TRIANGLES

MOST_CELLS = 8  # maximum number of workcells in memory
DOT_M = 5e-4  # radius of a dot


class Workcell:
    """Robot, workpiece and configuration that several scenarios share."""

    def __init__(self, config: PlanConfig, robot: Robot, workpiece: Workpiece):
        self.config, self.robot, self.workpiece = config, robot, workpiece

    @property
    def approach(self) -> int:
        """Number of approach targets, which precede the tool path."""
        return self.config.on_path

    @cached_property
    def obstacle(self) -> Obstacles:
        """Workpiece and other obstacles, for clearance queries."""
        return all_obstacles(self.workpiece, build.obstacles_of(self.config.cell, self.robot))

    @cached_property
    def fixtures(self) -> surfaces.WorldGeometry:
        """Obstacles other than the workpiece, for drawing."""
        return build.drawn_of(self.config.cell, self.robot)

    @property
    def triangles(self) -> Float[np.ndarray, "M 3 3"]:
        """Mesh of the workpiece, in its own frame [m], for drawing; none for a cloud or a very fine mesh."""
        return shown_triangles(self.workpiece)

    @cached_property
    def surface(self) -> surfaces.Surface:
        """Workpiece surface, for drawing; without a cloud, dots on the path."""
        found = surfaces.surface_of(self.workpiece.shown)
        return found if len(self.workpiece.cloud) else found._replace(radius=np.full(len(found.points), DOT_M))


def shown_triangles(workpiece: Workpiece) -> Float[np.ndarray, "M 3 3"]:
    """Return the triangles of a workpiece's mesh that are drawn [m]: all, or none of more than MOST_TRIANGLES."""
    found = workpiece.triangles
    return found if len(found) <= MOST_TRIANGLES else found[:0]


class RecordedCells:
    """Workcells of saved plans, built at first use; the last MOST_CELLS are cached.

    `cell(key)` returns the workcell of the scenarios with that key. It raises InputError if a file cannot be read.
    """

    def __init__(self, found: PlanSet):
        self._found = found
        self.cell = lru_cache(maxsize=MOST_CELLS)(self._make)

    def key(self, number: int) -> Hashable:
        """Return the key of a scenario's workcell; scenarios that share a workcell have equal keys.

        The key does not depend on the scenario's path, because targets are saved with the plans.
        """
        return self._keys[number] if self._found.mixed else None

    def placement(self, number: int) -> measured_rows.Placement:
        """Return the workpiece's placement in a scenario."""
        cell = self.cell(self.key(number))
        found = self._found
        kinds = (found.jobs[number] if found.mixed else found.config).cell.obstacles
        placement = _placement(cell.robot, cell.workpiece, found.parameters[number])
        return placement._replace(obstacle_numbers=numbers_of(kinds) if kinds else None)

    def task(self, number: int, seam: int) -> Task | None:
        """Return the task of a scenario on one of its seams; None: the default one."""
        return _task_of(self._found.jobs[number], self.cell(self.key(number)).robot, seam)

    def goals(self, number: int) -> Float[np.ndarray, "T G"]:
        """Goals of a scenario's task, which are computed again from its job, as they are not saved."""
        cell, job = self.cell(self.key(number)), self._found.jobs[number]
        return np.asarray(build.scenario_of(job, cell.robot, cell.workpiece, number, "record").goals)

    @cached_property
    def _keys(self) -> dict[int, Hashable]:
        return {number: _shared(self._found.jobs[number]) for number in self._found.parameters}

    def _make(self, key: Hashable) -> Workcell:
        found = self._found
        first = next(number for number in found.parameters if self.key(number) == key)
        config = found.jobs[first] if found.mixed else found.config
        robot = build.robot_of(config.robot, config.cell, config.tree)
        return Workcell(config, robot, build.workpiece_of(config.workpiece, robot))


class GivenCell:
    """Workcell in memory, with one placement for all scenarios; has the interface of `RecordedCells`."""

    def __init__(self, cell: Workcell, scenario: Scenario):
        self._scenario = scenario
        T, plane = np.asarray(scenario.T_world_workpiece), np.asarray(scenario.interior_plane)
        self._cell = cell
        self._placement = measured_rows.Placement(T, plane, float(scenario.tool_extension_m), scenario.obstacle_numbers)

    def key(self, number: int) -> Hashable:
        """Return None, the key of the only workcell."""
        return None

    def cell(self, key: Hashable) -> Workcell:
        """Return the only workcell."""
        return self._cell

    def placement(self, number: int) -> measured_rows.Placement:
        """Return the placement, which is the same in every scenario."""
        return self._placement

    def task(self, number: int, seam: int) -> Task | None:
        """Return the task of every scenario on one of its seams; None: the default one."""
        return _task_of(self._cell.config, self._cell.robot, seam)

    def goals(self, number: int) -> Float[np.ndarray, "T G"]:
        """Goals of the task in every scenario."""
        return np.asarray(self._scenario.goals)


Workcells = RecordedCells | GivenCell


def _task_of(job: PlanConfig, robot: Robot, seam: int) -> Task | None:
    return build.task_of_job(job, robot, seam) if job.tasks[seam] else None


def cells_of(found: PlanSet) -> RecordedCells:
    """Return the workcells of saved plans; the first one is built at once to check it.

    Raises:
        InputError: If the workcell cannot be built, or if the number of targets or joints differs between the plan's
            files.
    """
    cells = RecordedCells(found)
    cell = cells.cell(cells.key(min(found.parameters)))
    if isinstance(found, plan_sets.FolderPlan):
        shape = cell.approach + len(cell.workpiece.path), len(cell.robot.joint_names)
        saved = found.plans(found.methods[0]).x.shape[1:]
        if saved != shape:
            raise InputError(
                f"{found.folder / plan_folder.TRAJECTORY} contains {saved[0]} targets and {saved[1]} joints, but "
                f"{plan_folder.SUMMARY} describes {shape[0]} and {shape[1]}: the folder is damaged"
            )
    return cells


def _shared(job: PlanConfig) -> tuple:
    """Return the values of a job that are equal in all scenarios of a workcell."""
    return build.robot_key(job), build.workpiece_key(job), job.approach, job.settings, job.cell


def _placement(robot: Robot, workpiece: Workpiece, given: Parameters) -> measured_rows.Placement:
    turn = given.rotation_y_rad, given.rotation_z_rad
    T = workpiece.T_world(*turn, tuple(given.shift_m.tolist()), given.rotation_x_rad)
    return measured_rows.Placement(T, interior_plane_of(robot, workpiece, T), given.tool_extension_m)
