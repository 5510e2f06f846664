"""Conversion of a job's task list to the planner's task for a robot, and to the goals of its rows at every target.

On the approach the goals are interpolated evenly from the start's values to those of the path's first point, as is the
tool's position. The start therefore always satisfies its goal.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.model.arm_features import point_of
from htcp_jax.model.built_in_rows import AxisTowards, FrameOrientation, PointAlong
from htcp_jax.model.robot import Robot
from htcp_jax.model.rotations import frame_turns
from htcp_jax.model.rows_of_spec import PlacedPath, angles_of, drawn_goal, goals_of, row_of
from htcp_jax.model.scenario import Scenario
from htcp_jax.model.scenario_setup import with_tool
from htcp_jax.model.task import Task
from htcp_jax.model.task_rows import Row, TaskPoint
from htcp_jax.model.workpiece import Workpiece
from htcp_jax.spec import TCP_ON_PATH, BuiltInRow, TaskRowKind, ToolAxisRow, path_row

MOST_ALONG = 0.8  # largest component of a plate's normal along the seam; in the corner of a square it is 0.71
DRAWS, FLAT = 8, 1e-6  # random configurations from which a task's rank is computed; tolerance of singular values


class RowError(InputError):
    """Rows of a task that are invalid. The arguments are the reason, and for each row its number and description."""

    def __str__(self) -> str:
        return self.message("row ")

    def message(self, prefix: str) -> str:
        """Return the message with a prefix before each row's number, such as `task.`."""
        reason, *rows = self.args
        return " and ".join(prefix + row for row in rows) + reason


def task_of(rows: Sequence[TaskRowKind], robot: Robot, tolerance_m: float = 1e-3, tolerance_rad: float = 2e-3) -> Task:
    """Return the task of the given rows for a robot; without rows, the paper's task.

    Args:
        rows: Rows of the task list.
        robot: The robot, whose sites and bodies the rows may name.
        tolerance_m: Tolerance of the norm of the error [m].
        tolerance_rad: Tolerance of angles [rad].

    Raises:
        InputError: For a name that the robot lacks, for more equations than joints, and for a row that repeats or
            contradicts earlier rows.
    """
    parts: list[Row] = []
    for k, row in enumerate(rows or (TCP_ON_PATH,), 1):
        try:
            parts.append(row_of(row, robot))
        except InputError as error:
            raise RowError(f": {error}", f"{k}") from None
        if parts[-1].equalities and _is_angle_to_world(row, robot):
            _check_turns(k, row, robot, parts[-1])
    task = Task(tuple(parts), tolerance_m, tolerance_rad)
    task.freedom(robot)
    for k in (k for k in range(2, len(parts) + 1) if parts[k - 1].equalities):
        if _jacobian_rank(robot, rows[:k], Task(tuple(parts[:k]))) < sum(part.equalities for part in parts[:k]):
            raise RowError(" repeats or contradicts an earlier row; remove one of them", f"{k} ({rows[k - 1]})")
    return task


def follower_position(rows: Sequence[TaskRowKind], robot: Robot, x: Float[np.ndarray, "N"]) -> Float[np.ndarray, "3"]:
    """Return the position [m] of the point that follows the path: the TCP, unless a row names another point.

    Args:
        rows: Rows of the task list.
        robot: The robot.
        x: The configuration [rad or m].

    Returns:
        The position in the world.

    Raises:
        InputError: For a name that the robot lacks.
    """
    row = path_row(rows) or TCP_ON_PATH
    point = point_of(robot, row.point, row.offset_m)
    part = PointAlong(point.link, point.vector, 3)
    return np.asarray(_VALUE(robot, jnp.asarray(x), Task((part,))))


def with_goals(
    scenario: Scenario, rows: Sequence[TaskRowKind], task: Task, robot: Robot, workpiece: Workpiece
) -> Scenario:
    """Return the scenario with the rows' goals at all of its targets.

    Args:
        scenario: A scenario; its last targets are the points of the path.
        rows: Rows of the task list; empty for the paper's task.
        task: The rows' task, see `task_of`.
        robot: The robot without the scenario's tool extension.
        workpiece: The scenario's workpiece.

    Raises:
        InputError: For a path without the frames that the rows require, and for two rows that contradict each other.
    """
    rows = rows or (TCP_ON_PATH,)
    if task.parts == (TaskPoint(),) and path_row(rows):
        return scenario
    robot, targets = with_tool(robot, float(scenario.tool_extension_m)), scenario.targets
    rotate, translate = scenario.T_world_workpiece[:3, :3], scenario.T_world_workpiece[:3, 3]
    before = len(targets) - len(workpiece.path)
    placed = PlacedPath(rotate, translate, targets[before:], workpiece)
    _check_frames(rows, workpiece)
    start = np.array(_VALUE(robot, jnp.asarray(scenario.x_start), task))
    share = np.linspace(0.0, 1.0, before) if before > 1 else np.full(before, float(scenario.auto_start))
    columns, v = [], 0
    for row, part in zip(rows, task.parts, strict=True):
        size = part.size
        wanted = goals_of(row, part, placed)
        places = targets[:before] if row is path_row(rows) else None
        eased = part.eased(start[v : v + size], wanted[0], share, places)
        columns.append(np.concatenate([eased, wanted]))
        v += size
    _check_pairs(rows, task, columns, before)
    return replace(scenario, task_goals=np.concatenate(columns, axis=1))


def tool_angles_at(
    scenario: Scenario, row: ToolAxisRow, robot: Robot, workpiece: Workpiece, x: Float[np.ndarray, "T N"]
) -> Float[np.ndarray, "T 3"]:
    """Return the work angle, the travel angle and the spin of the tool at a plan's targets [degrees].

    NaN before the path, and where a configuration is NaN. A work angle from a plate is measured as in the row.

    Args:
        scenario: The scenario; its last targets are the points of the path.
        row: Row of the task with the tool's axis.
        robot: The robot without the scenario's tool extension.
        workpiece: The scenario's workpiece.
        x: Configurations at the scenario's targets [rad or m].
    """
    count = len(workpiece.path)
    part = replace(row_of(row, robot), limits=("range", "range", "range"))
    rotate, translate = scenario.T_world_workpiece[:3, :3], scenario.T_world_workpiece[:3, 3]
    placed = PlacedPath(rotate, translate, scenario.targets[-count:], workpiece)
    values = _VALUES(with_tool(robot, float(scenario.tool_extension_m)), jnp.asarray(x[-count:]), Task((part,)))
    found = np.full((len(x), 3), np.nan)
    found[-count:] = np.rad2deg(angles_of(row, np.asarray(values), placed))
    return found


def check_constant_angles(
    scenario: Scenario, rows: Sequence[TaskRowKind], task: Task, robot: Robot, workpiece: Workpiece
) -> None:
    """Check that angles to world directions which no joint can change are allowed at every point of the path.

    Args:
        scenario: A scenario with the rows' goals.
        rows: Rows of the task list.
        task: The rows' task, see `task_of`.
        robot: The robot.
        workpiece: The scenario's workpiece.

    Raises:
        InputError: For an angle that violates its cone or limit at a point of the path.
    """
    for k, (row, part, start) in enumerate(zip(rows or (TCP_ON_PATH,), task.parts, task.starts, strict=True), 1):
        if part.inequalities and _is_angle_to_world(row, robot):
            on_path = scenario.goals[-len(workpiece.path) :, start : start + part.numbers]
            _check_constant(k, row, robot, part, np.asarray(on_path))


def _jacobian_rank(robot: Robot, rows: Sequence[TaskRowKind], task: Task) -> int:
    """Return the rank of the equations' Jacobian: its maximum over random configurations and goals."""
    rng = np.random.default_rng(0)
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    found = 0
    for x in rng.uniform(lower, upper, (DRAWS, len(lower))):
        goal = np.concatenate([drawn_goal(row, part, rng) for row, part in zip(rows, task.parts, strict=True)])
        size = np.linalg.svd(_JACOBIAN(robot, jnp.asarray(x), jnp.asarray(goal), task), compute_uv=False)
        found = max(found, int((size > FLAT * size.max(initial=0.0)).sum()))
    return found


_VALUE = jax.jit(lambda robot, x, task: task.value(robot, x), static_argnums=2)
_VALUES = jax.jit(jax.vmap(lambda robot, x, task: task.value(robot, x), (None, 0, None)), static_argnums=2)
_SLOPES = jax.jit(lambda robot, x, task: task.jacobian(robot, x), static_argnums=2)
_JACOBIAN = jax.jit(lambda robot, x, goal, task: task.linear_at(robot, x, goal).jacobian, static_argnums=3)


# Checks


def _check_frames(rows: Sequence[TaskRowKind], workpiece: Workpiece) -> None:
    for k, row in enumerate(rows, 1):
        if "rotations" in row.uses and _is_lacking(workpiece.frames.rotations):
            remedy = "add columns qw,qx,qy,qz to its file, or set workpiece.path_angles for columns of angles"
            raise RowError(f": the path has no orientations; {remedy}", f"{k} ({row})")
        if "plates" in row.uses and _is_lacking(workpiece.frames.plates):
            remedy = "add columns n1x ... n2z, the plates' normals, to its file, or set workpiece.plates for a mesh"
            raise RowError(f": the path has no plates; {remedy}", f"{k} ({row})")
        if "plates" in row.uses:
            along = np.abs(np.einsum("tpx,tx->tp", workpiece.frames.plates, workpiece.tangents))
            if len(far := np.argwhere(along > MOST_ALONG)):
                point, plate = far[0] + 1
                reason = (
                    f": the normal of plate {plate} is {np.rad2deg(np.arccos(along[*far[0]])):.3g} degrees from the "
                )
                raise RowError(f"{reason}seam at point {point}; it must be across the seam", f"{k} ({row})")
        for name in sorted(row.uses & {"normals", "tangents"}):
            if len(lacking := np.flatnonzero(np.isnan(getattr(workpiece, name)).any(axis=1))):
                raise RowError(f": point {lacking[0] + 1} of the path has no {name[:-1]}", f"{k} ({row})")
        if row.uses >= {"normals", "tangents"}:
            square = np.linalg.norm(np.cross(workpiece.tangents, workpiece.normals), axis=1)
            if len(flat := np.flatnonzero(square < 1e-6)):
                reason = f": tangent and normal are parallel at point {flat[0] + 1} of the path"
                raise RowError(reason, f"{k} ({row})")


def _is_lacking(directions: Float[np.ndarray, "T *d"] | None) -> bool:
    """Return True for directions that the path's file lacks, or that of one of the seams."""
    return directions is None or bool(np.isnan(directions).any())


def _is_angle_to_world(row: TaskRowKind, robot: Robot) -> bool:
    """Return True for an angle to a direction of the world that may be the same in all configurations."""
    if not (isinstance(row, BuiltInRow) and row.angular and row.is_in_world):
        return False
    return robot.part_moves or row.is_of_path


def _slopes(robot: Robot, part: Row) -> Float[np.ndarray, "D V N"]:
    """Return the Jacobians of a row's features at D random configurations."""
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    x = np.random.default_rng(0).uniform(lower, upper, (DRAWS, len(lower)))
    return np.array([_SLOPES(robot, jnp.asarray(each), Task((part,))) for each in x])


def _check_turns(k: int, row: TaskRowKind, robot: Robot, part: Row) -> None:
    """Check that the joints can satisfy the equations of a row about a world direction.

    Raises:
        InputError: If the joints can rotate it about fewer axes than the row has equations.
    """
    sizes = np.linalg.svd(_slopes(robot, part), compute_uv=False)
    turns = int((sizes > FLAT).sum(axis=1).max())
    if turns < part.equalities:
        raise RowError(
            f": it has {part.equalities} equations, but the joints rotate it in only {turns} directions; set cone_deg "
            "or within_deg to allow an angle",
            f"{k} ({row})",
        )


def _check_constant(k: int, row: TaskRowKind, robot: Robot, part: Row, goals: Float[np.ndarray, "T g"]) -> None:
    """Check a row whose angle no joint changes; all other rows are skipped.

    Raises:
        InputError: If the angle violates its limit at a point of the path.
    """
    if np.abs(_slopes(robot, part)).max() > FLAT:
        return
    x = jnp.asarray(np.clip(0.0, robot.lower, robot.upper))
    value, goals = _VALUE(robot, x, Task((part,))), jnp.asarray(goals)
    slack = np.asarray(jax.vmap(lambda goal: (part.slack(value, goal) - part.aim(value, goal))[0])(goals))
    if len(far := np.flatnonzero(slack < 0)):
        most = float(goals[far[0], -1])
        angle = np.rad2deg(most - float(part.slack(value, goals[far[0]])[0]))
        raise RowError(
            f": no joint changes this angle; it is {angle:.4g} degrees at point {far[0] + 1} of the path, and at most "
            f"{np.rad2deg(most):.4g} are allowed; increase this limit or change the direction",
            f"{k} ({row})",
        )


def _check_pairs(rows: Sequence[TaskRowKind], task: Task, goals: Sequence[np.ndarray], before: int) -> None:
    """Check that every two rows about the same link or point can be satisfied together.

    Raises:
        InputError: For two rows that contradict each other.
    """
    on_path = [goal[before:] for goal in goals]
    for i, k in combinations(range(len(rows)), 2):
        a, b, own, found = task.parts[i], task.parts[k], (on_path[i], on_path[k]), None
        if isinstance(a, AxisTowards | FrameOrientation) and isinstance(b, AxisTowards | FrameOrientation):
            found = _unmet_turns((a, b), own, task.tolerance_rad)
        elif isinstance(a, TaskPoint | PointAlong) and isinstance(b, TaskPoint | PointAlong):
            found = _unmet_bands((a, b), own, task.tolerance_m)
        if found:
            reason = f" contradict each other at point {found[0] + 1} of the path: {found[1]}"
            raise RowError(reason, f"{i + 1} ({rows[i]})", f"{k + 1} ({rows[k]})")


def _unmet_turns(
    of: Sequence[AxisTowards | FrameOrientation], goals: Sequence[np.ndarray], tolerance_rad: float
) -> tuple[int, str] | None:
    """Return the first point of the path at which two angular rows contradict each other, and the reason.

    For two axes, the angle between the required directions may differ from the angle between the axes by at most the
    sum of the rows' limits. An orientation row requires a direction of every axis. For two orientation rows, the angle
    between the required orientations may be at most the sum of the limits.

    Returns:
        The point's index and the reason. None if there is no contradiction, and for rows of different links.
    """
    if any(part.is_view for part in of) or (of[0].link, of[0].seen_from) != (of[1].link, of[1].seen_from):
        return None
    at = 9 if isinstance(of[0], FrameOrientation) else 3, 9 if isinstance(of[1], FrameOrientation) else 3
    most = sum(goal[:, n] if part.cone else tolerance_rad for part, goal, n in zip(of, goals, at, strict=True))
    turned = [
        goal[:, :9].reshape(-1, 3, 3) @ part.columns if isinstance(part, FrameOrientation) else goal[:, :3]
        for part, goal in zip(of, goals, strict=True)
    ]  # the link's rotations that frames require, and the axes' directions
    if at == (9, 9):
        what, has, wants = "frames", 0.0, np.linalg.norm(frame_turns(*turned), axis=1)
    else:
        axes = [part.axis for part in of if isinstance(part, AxisTowards)]
        seen = [each if each.ndim == 2 else each @ axes[0] for each in turned]
        what, has = "axes", np.arccos(np.clip(np.dot(axes[0], axes[-1]), -1.0, 1.0))
        wants = np.arccos(np.clip((seen[0] * seen[1]).sum(axis=1), -1.0, 1.0))
    if not len(far := np.flatnonzero(np.abs(wants - has) > most)):
        return None
    has, wants = np.rad2deg(has), np.rad2deg(wants[far[0]])
    return int(far[0]), f"the {what} are {has:.4g} degrees apart, their required directions {wants:.4g}"


def _unmet_bands(
    of: Sequence[TaskPoint | PointAlong], goals: Sequence[np.ndarray], tolerance_m: float
) -> tuple[int, str] | None:
    """Return the first point of the path at which the bands of two rows do not intersect, and the reason.

    The bands are compared along the directions that both rows constrain: those directions of one row that lie in the
    span of the other row's directions.

    Returns:
        The point's index and the reason. None if there is no contradiction, and for rows about different points.
    """
    if (of[0].link, of[0].offset_m) != (of[1].link, of[1].offset_m):
        return None
    bands = [_bands(part, goal, tolerance_m) for part, goal in zip(of, goals, strict=True)]
    for (across, offset, within), (u, o, w) in (bands, bands[::-1]):
        share = np.einsum("tci,tdi->tdc", across, u)  # component of each direction u along the directions `across`
        spans = np.abs((share**2).sum(axis=2) - 1) < FLAT
        off = np.abs(np.einsum("tdc,tc->td", share, offset) - o)
        most = np.abs(share).sum(axis=2) * within[:, None] + w[:, None]
        if len(far := np.argwhere(spans & (off > most + FLAT))):
            first = tuple(far[0])
            return int(first[0]), f"required positions are {off[first]:.4g} m apart, {most[first]:.4g} m are allowed"
    return None


def _bands(
    part: TaskPoint | PointAlong, goals: Float[np.ndarray, "T g"], tolerance_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a row's c constrained directions (T, c, 3), their offsets (T, c) [m] and the half widths (T,) [m]."""
    if isinstance(part, TaskPoint):
        across = np.eye(3)[list(part.axes)]
        return np.broadcast_to(across, (len(goals), *across.shape)), goals, np.full(len(goals), tolerance_m)
    each = goals[:, : 4 * part.count].reshape(-1, part.count, 4)
    return each[..., :3], each[..., 3], tolerance_m + (goals[:, -1] if part.band else np.zeros(len(goals)))
