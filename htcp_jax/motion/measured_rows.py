"""Distances of all rows of clearance, nearest points, and the names of bodies and obstacles, for messages and pictures.

The executables are independent of the task and of the arm's structure, see `Scene.for_programs`, so that a message
about an arm compiles nothing if another arm of the same sizes has been measured.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.clearance import Obstacle, Obstacles, Scene, by_pieces, contacts, contacts_of_each, surface_points
from htcp_jax.clearance.obstacles import grouped
from htcp_jax.device import Executor, devices, lane_function, tables
from htcp_jax.errors import mm_text
from htcp_jax.model import Robot, Task
from htcp_jax.model import robot as robots
from htcp_jax.settings import Settings

ALL = -1  # in place of the number of an obstacle's part


class Placement(NamedTuple):
    """The part of a scenario, or of n scenarios, that distances depend on; implements `HasWorkpiecePose`."""

    T_world_workpiece: Float[np.ndarray, "*n 4 4"]  # this and the others: see `Scenario`
    interior_plane: Float[np.ndarray, "*n 4"]
    tool_extension_m: Float[np.ndarray, "*n"] | float
    obstacle_numbers: Float[np.ndarray, "*n P"] | None = None
    margin_m: Float[np.ndarray, "*n"] | float = 0.0  # decides which capsules' convex pieces are measured

    @classmethod
    def of(cls, where: Any) -> "Placement":
        """Return the placement of stacked scenarios, or of inputs of lanes."""
        return cls(*(getattr(where, name) for name in cls._fields))


class RowDistances(NamedTuple):
    """Results of `measure_rows`: nearest points and distances of R rows at one configuration, or at n."""

    distance: Float[np.ndarray, "*n R"]  # [m]
    witness: Float[np.ndarray, "*n R 3"]  # nearest point of the obstacle, world [m]
    surfaces: Float[np.ndarray, "*n R 2 3"]  # nearest points on the surfaces of the body and of the obstacle, world [m]
    by_piece: Bool[np.ndarray, "*n R"]  # True: the distance is that of a convex piece
    by_interior_rule: Bool[np.ndarray, "*n R"]


class NearestPair(NamedTuple):
    """Pair of nearest points on the arm and on the obstacles, at one configuration or at n."""

    body: Int[np.ndarray, "*n"]  # number of the nearest body
    arm: Float[np.ndarray, "*n 3"]  # point on its surface, or the end of its axis that crossed the hull, world [m]
    other: Float[np.ndarray, "*n 3"]  # point of the obstacle, or of the hull that the end has crossed, world [m]


class MeasuredRows:
    """Distances of R rows at n configurations.

    Args:
        robot: The arm with its tool.
        obstacles: All obstacles, including the workpiece.
        where: Stacked scenarios or inputs of lanes, one per configuration, see `Placement.of`.
        x: The configurations, at least one [rad or m].
        device: The device; None: the default one.
    """

    def __init__(
        self,
        robot: Robot,
        obstacles: Obstacles,
        where: Any,
        x: Float[np.ndarray, "n N"],
        device: jax.Device | None = None,
    ):
        scene = Scene(robot, obstacles)
        self._robot, self._groups, self._rows = robot, grouped(obstacles), scene.rows
        self._starts = np.cumsum([0, *(len(group[0].rows(robot).body) for group in self._groups[:-1])])
        self._executor = Executor(scene, Settings(), device, threads=devices.cores())
        self._where, self.x = Placement.of(where), np.asarray(x, float)
        every, self._of_each = self._measure(np.arange(len(x)), ALL)
        self.found = RowDistances(*(table[:, self._executor.rows] for table in every))
        self.links = self._rows.links(robot)  # number of the link of each row's body; negative: the base

    @property
    def distance(self) -> Float[np.ndarray, "n R"]:
        """Distance of each row at each configuration [m]."""
        return self.found.distance

    @property
    def stands(self) -> Bool[np.ndarray, "R"]:
        """True for rows of bodies that are fixed in the world."""
        return self.links < 0

    def body(self, row: int) -> str:
        """Return the name of a row's body."""
        return self._robot.capsule_names[self._rows.body[row]]

    def label(self, row: int) -> str:
        """Return the name of a row's body for messages, see `capsule_label`."""
        return robots.capsule_label(self._robot, self.body(row))

    def other(self, row: int, k: int) -> str:
        """Return the name of the obstacle nearest to a row's body at configuration k.

        Of several equally near obstacles, the workpiece is named last.
        """
        number, nearest, row = self._nearest(row, k)
        obstacle = self._groups[number][nearest]
        part, *more = obstacle.parts(self._robot, row)
        if more:
            parts = np.array([part, *more])
            part = parts[self._measure(np.full(len(parts), k), parts)[1][number][nearest][:, row].argmin()]
        return obstacle.part_name(self._robot, int(part))

    def of_mesh(self, row: int, k: int) -> bool:
        """Return True if the obstacle nearest to a row's body at configuration k is a mesh, see `Obstacle.of_mesh`."""
        return self._obstacle(row, k).of_mesh

    def _obstacle(self, row: int, k: int) -> Obstacle:
        """Return the obstacle nearest to a row's body at configuration k."""
        number, nearest, _ = self._nearest(row, k)
        return self._groups[number][nearest]

    def _nearest(self, row: int, k: int) -> tuple[int, int, int]:
        """Return the obstacle nearest to a row's body at configuration k: its group, its place and its own row."""
        number = int(np.searchsorted(self._starts, row, side="right")) - 1
        group, row = self._groups[number], row - int(self._starts[number])
        order = sorted(range(len(group)), key=lambda each: group[each].of_workpiece)
        return number, min(order, key=lambda each: self._of_each[number][each][k, row]), row

    def mesh_note(self, row: int, k: int, other: str) -> str:
        """Return the end of a collision message about a row's body at configuration k.

        It has `gaps_note`, and how far the body's mesh is from its capsule, see `robots.mesh_note`.
        """
        robot, extension_m = self._robot, float(self._where.tool_extension_m[k])
        robot = robots.lengthen_tool(robot, extension_m) if extension_m else robot
        surfaces, by_piece = self.found.surfaces[k, row], bool(self.found.by_piece[k, row])
        return self.gaps_note(row, k) + robots.mesh_note(robot, self.body(row), other, self.x[k], surfaces, by_piece)

    def gaps_note(self, row: int, k: int) -> str:
        """Return the part of a message about what the points on an obstacle's mesh take from a row's distance."""
        cover_m, distance_m = self._obstacle(row, k).covering_radius_m, float(self.distance[k, row])
        if not cover_m:
            return ""
        gaps = f"{mm_text(cover_m)} for the gaps between the points on its mesh"
        if distance_m > 0:
            return f"; {gaps} are subtracted"
        return f"; this includes {gaps}" + (", which itself may be clear" if -distance_m < cover_m else "")

    def _measure(self, k: Int[np.ndarray, "m"], parts: Int[np.ndarray, "m"] | int) -> tuple[RowDistances, list]:
        """Return the results of `measure_rows` at configurations k, with padding between the rows."""
        lanes = tables.gather((self._where, self.x), k)
        return self._executor(MEASURE, *lanes, np.full(len(k), parts))


def nearest_pairs(robot: Robot, obstacles: Obstacles, where: Any, x: Float[np.ndarray, "n N"]) -> NearestPair:
    """Return the nearest points at n >= 1 configurations [rad or m].

    Args:
        robot: The arm with its tool.
        obstacles: All obstacles, including the workpiece.
        where: The scenario, see `Placement.of`.
        x: The configurations.
    """
    lanes = jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[None], len(x), axis=0), Placement.of(where))
    return Executor(Scene(robot, obstacles), Settings(), threads=devices.cores())(NEAREST_PAIR, lanes, x)


def task_errors(
    robot: Robot, task: Task, where: Any, x: Float[np.ndarray, "n N"], goals: Float[np.ndarray, "n G"]
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Return the distances [m] and the angles [rad] from goals, see `Task.errors`, and the slack of bands and cones.

    Args:
        robot: The arm with its tool.
        task: The task.
        where: See `Placement.of`.
        x: The configurations [rad or m].
        goals: The task's goals.
    """
    return Executor(Scene(robot, (), task), Settings())(ERRORS, Placement.of(where), x, goals)


def measure_rows(settings: Settings, scene: Scene, where: Placement, x, part) -> tuple[RowDistances, list]:
    """Return the distances of all rows at x, and those of each obstacle by group.

    Args:
        settings: Settings; none is used.
        scene: The scene.
        where: The placement.
        x: The configuration [rad or m].
        part: Number of the part of each obstacle that is measured alone, see `Obstacle.only`; ALL.
    """
    robot, obstacles = scene.robot, tuple(each.only(scene.robot, part) for each in scene.obstacles)
    touch, of_each = contacts_of_each(robot, obstacles, where, x)
    surface = surface_points(robot, scene.rows, touch)
    surfaces = jnp.stack([surface, surface - touch.distance[:, None] * touch.normal], axis=1)
    by_piece = by_pieces(robot, scene.rows, touch)
    found = RowDistances(touch.distance, touch.witness, surfaces, by_piece, touch.by_interior_rule)
    return found, [[each.distance for each in group] for group in of_each]


def _nearest_pair(settings: Settings, scene: Scene, where: Placement, x) -> NearestPair:
    touch = contacts(scene.robot, scene.obstacles, where, x)
    row = jnp.argmin(touch.distance)
    surface = surface_points(scene.robot, scene.rows, touch)[row]
    arm = jnp.where(touch.by_interior_rule[row], touch.point[row], surface)
    return NearestPair(jnp.asarray(scene.rows.body)[row], arm, arm - touch.distance[row] * touch.normal[row])


def _errors(settings: Settings, scene: Scene, where: Placement, x, goal):
    robot, task = scene.robot, scene.task
    return *task.errors(robot, x, goal), task.slack(task.value(robot, x), goal)


MEASURE = lane_function.LaneFunction(
    "measure_rows", measure_rows, lane_function.STEP, any_cone=True, compiles_quickly=True
)
NEAREST_PAIR = lane_function.LaneFunction("nearest_pair", _nearest_pair, lane_function.STEP, any_cone=True)
ERRORS = lane_function.LaneFunction("task_errors", _errors, lane_function.STEP, any_cone=True)
