"""Builders of the robot, workpiece, obstacles, task and scenario that a job describes; all raise InputError."""

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from htcp_jax.clearance import Obstacles
from htcp_jax.clearance.obstacles import given_obstacle, of_cell, self_collision
from htcp_jax.errors import InputError, Note
from htcp_jax.io import parts
from htcp_jax.io.robots import load_robot, part_moves
from htcp_jax.jobs import cell_shapes
from htcp_jax.jobs.config import CellConfig, PlanConfig, RobotConfig, WorkpieceConfig
from htcp_jax.jobs.given_kinds import shapes_in_world
from htcp_jax.kinds import numbers_of, template_of
from htcp_jax.model import Robot, Scenario, Task, Workpiece, goals, mesh_points, surface
from htcp_jax.model import robot as robots
from htcp_jax.model import scenario as scenarios
from htcp_jax.model import workpiece as workpieces

NO_CELL = CellConfig()


def scene(job: PlanConfig) -> tuple[Robot, Workpiece, Scenario]:
    """Build the robot, the workpiece and the scenario of a job."""
    robot = robot_of(job.robot, job.cell)
    workpiece = workpiece_of(job.workpiece, robot)
    return robot, workpiece, scenario_of(job, robot, workpiece)


def task_of_job(job: PlanConfig, robot: Robot) -> Task:
    """Build the task: the constraints on the path."""
    return goals.task_of(job.task, robot, job.settings.tolerance_m, job.settings.tolerance_rad)


def robot_of(arm: RobotConfig, cell: CellConfig = NO_CELL) -> Robot:
    """Load the robot, without the tool's extension, which belongs to the scenario.

    Args:
        arm: The arm.
        cell: Its fixtures on links become bodies of the robot.

    Raises:
        InputError: As `load_robot` and `with_carried` do, and for a tool that is longer than an arm in the world.
    """
    robot = load_robot(
        arm.file,
        tcp_site="tcp" if arm.tcp is None else arm.tcp,
        limits=arm.limits,
        base_m=arm.base_m,
        base_rpy_rad=arm.base_rpy_rad,
        tool=arm.tool,
        locked=dict(arm.locked),
    )
    if arm.bodies == "capsules":
        robot = replace(robot, pieces=None)
    elif arm.bodies == "meshes" and robot.pieces is None:
        raise InputError(
            f"robot.bodies: {arm.model} has no convex pieces of meshes; valid: capsules, or a file made by htcp robot"
        )
    if not robot.part_moves:  # else the TCP may be anywhere in the world
        parts.check_tool(robot, arm.tool_extension_m)
    return cell_shapes.with_carried(robot, cell)


def workpiece_of(part: WorkpieceConfig, robot: Robot) -> Workpiece:
    """Load the workpiece, without its pose, which belongs to the scenario.

    Points on a mesh are as dense as the thinnest body near it requires. A UserWarning reports a cloud between whose
    points that body fits, and a mesh whose covering radius is not smaller than that body's radius.
    """
    if robot.part_moves and part.is_along_world_x:
        raise InputError("workpiece.inlet_direction is world-x, but the part moves; give x,y,z in its link's frame")
    direction = workpieces.InletDirection.WORLD_X if part.is_along_world_x else part.inlet_direction
    stated = {"inlet": part.inlet_m, "inlet_direction": direction}
    workpiece = parts.load_workpiece(
        source_of(part),
        path_file(part),
        interior=part.interior,
        interior_depth_m=part.interior_depth_m,
        tip_contact_m=part.tip_contact_m,
        pivot=part.pivot_m,
        neutral_translation=part.neutral_translation_m,
        robot=robot,
        path_columns={} if part.path_columns is None else part.path_columns.given,
        path_unit=part.path_unit,
        origin=part.origin_m,
        **{name: value for name, value in stated.items() if value is not None},
    )
    body, cover_m = mesh_points.thinnest_nearby(robot), workpiece.covering_radius_m
    if body is None or not len(workpiece.cloud):
        return workpiece
    if not len(workpiece.triangles) and workpiece.largest_gap_m > 2 * body.radius_m:
        warnings.warn(
            f"{part.cloud}: a gap of {1e3 * workpiece.largest_gap_m:.3g} mm between its points; "
            f"{body.label}, {2e3 * body.radius_m:.3g} mm thick, fits through",
            UserWarning,
            stacklevel=2,
        )
    if cover_m >= body.radius_m:
        warnings.warn(
            f"{part.cloud}: every clearance is reduced by {1e3 * cover_m:.3g} mm, the covering radius of the mesh's "
            f"points; {body.label} has a radius of only {1e3 * body.radius_m:.3g} mm, and a smaller "
            f"{mesh_points.KEY} would reduce it less",
            UserWarning,
            stacklevel=2,
        )
    return workpiece


def source_of(part: WorkpieceConfig) -> parts.WorkpieceSource:
    """Return the source of the workpiece's walls; a file is read."""
    if part.is_duct:
        return parts.GeneratedDuct(seam=part.path) if path_file(part) is None else parts.GeneratedDuct()
    return parts.read_source(part.cloud, part.mesh_spacing_m) if part.has_cloud else parts.NoCloud()


def path_file(part: WorkpieceConfig) -> str | None:
    """Return the path's file; None if a seam of the generated duct is named."""
    is_seam = part.path in parts.SEAMS or (part.is_duct and not Path(part.path).suffix)
    return None if is_seam else part.path


def scenario_of(
    job: PlanConfig,
    robot: Robot,
    workpiece: Workpiece,
    number: int = 0,
    beyond_reach: Literal["raise", "record"] = "raise",
    follows: Float[np.ndarray, "3"] | None = None,
) -> Scenario:
    """Build the scenario: start, pose, targets, margin and tool of a job.

    Args:
        job: The job.
        robot: From `robot_of`.
        workpiece: From `workpiece_of`.
        number: Number of the scenario, for the random keys.
        beyond_reach: See `make_scenario`; likewise for angles that no joint changes.
        follows: Position at the start of the point that follows the path, world [m], if known.
    """
    part, task = job.workpiece, task_of_job(job, robot)
    scenario = scenarios.make_scenario(
        robot,
        workpiece,
        job.start,
        home=job.home_rad,
        rotation=(part.rotation_y_rad, part.rotation_z_rad),
        rotation_x_rad=part.rotation_x_rad,
        shift=part.shift_m,
        approach=job.approach,
        margin_m=job.margin_m,
        tool_extension_m=job.robot.tool_extension_m,
        number=number,
        beyond_reach=beyond_reach,
        follows=_follower_at_start(job, robot) if follows is None else follows,
    )
    if job.cell.obstacles:
        scenario = replace(scenario, obstacle_numbers=numbers_of(job.cell.obstacles))
    scenario = goals.with_goals(scenario, job.task, task, robot, workpiece)
    if beyond_reach == "raise":
        goals.check_constant_angles(scenario, job.task, task, robot, workpiece)
    return scenario


def _follower_at_start(job: PlanConfig, robot: Robot) -> Float[np.ndarray, "3"] | None:
    """Return the position at a given start of the point that follows the path, world [m]; None if unknown."""
    if not job.task or job.start is None:
        return None
    return goals.follower_position(
        job.task, robots.lengthen_tool(robot, job.robot.tool_extension_m), np.array(job.start)
    )


def drawn_of(cell: CellConfig, robot: Robot) -> surface.WorldGeometry:
    """Load the triangles and clouds of the cell that stand still, for drawing; the others are bodies of the robot."""
    given = [shapes_in_world(kind) for kind in cell.obstacles]
    for kind, shapes in zip(cell.obstacles, given, strict=True):
        if not shapes:
            warnings.warn(f"the obstacle {kind.name!r} is not drawn: it has no shapes", Note, stacklevel=2)
    standing = cell_shapes.standing_cell(cell, robot)
    shapes = *standing.shapes, *(shape for own in given for shape in own)
    triangles = [surface.NOTHING.triangles, *(each.surface for each in shapes)]
    surfaces = [surface.NOTHING.clouds]
    for each, T in standing.clouds:
        points, mesh = parts.load_geometry(each.cloud)
        if len(mesh):
            triangles.append(mesh @ T[:3, :3].T + T[:3, 3])
        else:
            surfaces.append(surface.surface_of(points).placed(T))
    return surface.WorldGeometry(
        np.concatenate(triangles), surface.Surface(*map(np.concatenate, zip(*surfaces, strict=True)))
    )


def obstacles_of(cell: CellConfig, robot: Robot) -> Obstacles:
    """Build the collision objects in addition to the workpiece.

    Raises:
        InputError: As `standing_cell` does, and if the part moves for bodies of the world that cannot be tested.
    """
    if robot.part_moves and cell.obstacles:
        raise InputError(f"cell.obstacles: {cell.obstacles[0].name!r} stands in the world, and the part moves")
    if robot.part_moves and robot.attached and not cell.self_collision:
        name = robot.capsule_names[robot.attached[0]]
        raise InputError(f"cell.self_collision is false, but {name!r} moves relative to the part; it must be true")
    standing = cell_shapes.standing_cell(cell, robot)
    clouds = tuple(
        of_cell.placed_cloud(
            robot,
            *parts.load_geometry(each.cloud),
            T,
            source=each.cloud,
            name=(name := cell_shapes.name_of(each)),
            excluded=standing.excluded.get(name, ()),
        )
        for each, T in standing.clouds
    )
    own = self_collision.self_collision(robot) if cell.self_collision else None
    given = given_obstacle.given_obstacles(cell.obstacles)
    return (
        *of_cell.make_fixtures(robot, standing.shapes, standing.excluded),
        *clouds,
        *given,
        *(() if own is None else (own,)),
    )


_POSE = {"rotation_x_rad": 0.0, "rotation_y_rad": 0.0, "rotation_z_rad": 0.0, "shift_m": (0.0, 0.0, 0.0)}
_APPROACH = {"approach_to_inlet": 0, "approach_to_path": 0}


def robot_key(job: PlanConfig) -> tuple[RobotConfig, CellConfig]:
    """Return the keys that determine the robot, `robot_of`'s arguments; equal for scenarios that share it."""
    cell, arm = job.cell, job.robot.model_copy(update={"tool_extension_m": 0.0})
    if not job.robot.is_gp50 and part_moves(job.robot.file):
        return arm, cell.model_copy(update={"self_collision": False, "obstacles": ()})
    carried = cell.is_carried and CellConfig(model=cell.model, clouds=cell.clouds, fixtures=cell.fixtures)
    return arm, carried or NO_CELL


def workpiece_key(job: PlanConfig) -> WorkpieceConfig:
    """Return the keys that determine the workpiece."""
    return job.workpiece.model_copy(update=_POSE | _APPROACH)


def obstacles_key(cell: CellConfig) -> tuple:
    """Return the values that determine the planner's obstacles in addition to the workpiece.

    The numbers of obstacles of other packages are excluded: they belong to the scenario.
    """
    return cell.model_copy(update={"obstacles": ()}), tuple(map(template_of, cell.obstacles))


def walls_key(part: WorkpieceConfig) -> WorkpieceConfig:
    """Return the keys that determine the workpiece for the planner: without path and pose, which the scenario has."""
    origin = (0.0, 0.0, 0.0)
    path = {"path": "", "path_columns": None, "path_unit": None}
    return part.model_copy(update={**path, "pivot_m": origin, "neutral_translation_m": origin})
