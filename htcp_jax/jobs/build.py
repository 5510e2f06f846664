"""Builders of the robot, workpiece, obstacles, task and scenario that a job describes.

All raise InputError for invalid input.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from htcp_jax.clearance import Obstacles
from htcp_jax.clearance.obstacles import (
    PlacedCloud,
    SelfCollision,
    given_obstacles,
    make_fixtures,
    make_self_collision,
    placed_cloud,
)
from htcp_jax.errors import InputError, Note
from htcp_jax.io import parts
from htcp_jax.io.robots import indexed_joints, load_robot, part_moves
from htcp_jax.jobs import cell_shapes
from htcp_jax.jobs.resolve import resolve
from htcp_jax.jobs.seam_keys import with_goals_of_seams, with_margins_of_seams
from htcp_jax.jobs.seam_paths import is_file, points_of_seams
from htcp_jax.model import (
    Fixture,
    InletDirection,
    Robot,
    RowError,
    Scenario,
    Task,
    Workpiece,
    check_constant_angles,
    denser_spacing,
    follower_position,
    make_scenario,
    surface,
    task_of,
    tcp_at,
    thinnest_nearby,
    with_plates,
)
from htcp_jax.model import robot as robots
from htcp_jax.spec import (
    SEVERAL,
    CellConfig,
    CloudConfig,
    PlanConfig,
    RobotConfig,
    WorkpieceConfig,
    model_source,
    numbers_of,
    template_of,
)

NO_CELL = CellConfig()
LEVEL = 1e-6  # 1 - cosine of the angle at which a plane counts as level


@contextmanager
def _rows_by_key() -> Iterator[None]:
    """Name a task's rows by their keys in the job, such as task.2, in errors."""
    try:
        yield
    except RowError as error:
        raise InputError(error.message("task.")) from None


def scene(job: PlanConfig) -> tuple[Robot, Workpiece, Scenario]:
    """Build the robot, the workpiece and the scenario of a job."""
    return resolved_scene(job)[1:]


def resolved_scene(job: PlanConfig, source: str = "the configuration") -> tuple[PlanConfig, Robot, Workpiece, Scenario]:
    """Resolve a job, and build its robot, workpiece and scenario; its path has all seams, in the order of the list.

    Args:
        job: The job.
        source: Name of the job, for messages.
    """
    job, robot = with_robot(job, source)
    workpiece = workpiece_of(job.workpiece, robot)
    beyond_reach = "record" if len(job.workpiece.seams) > 1 else "raise"  # seams may be out of reach
    return job, robot, workpiece, scenario_of(job, robot, workpiece, beyond_reach=beyond_reach)


def with_robot(job: PlanConfig, source: str) -> tuple[PlanConfig, Robot]:
    """Load the robot of a job, and return the resolved job and the robot.

    Args:
        job: The job.
        source: Name of the job, for messages.

    Raises:
        InputError: See `robot_of` and `resolve`.
    """
    robot = _bare_robot(job.robot, job.tree)
    return resolve(job, robot, source), _in_cell(robot, job.robot, job.cell)


@_rows_by_key()
def task_of_job(job: PlanConfig, robot: Robot, seam: int = 0) -> Task:
    """Build the task of a job on one of its seams: the constraints on the tool at each point of the path.

    Args:
        job: The job.
        robot: The robot.
        seam: Number of the seam; 0 for a job without seams.
    """
    return task_of(job.tasks[seam], robot, job.settings.tolerance_m, job.settings.tolerance_rad)


def robot_of(arm: RobotConfig, cell: CellConfig = NO_CELL, tree: model_source.ComposedModel | None = None) -> Robot:
    """Load the robot. The extension of its tool is not included, as it belongs to the scenario.

    Args:
        arm: Section `robot` of the job.
        cell: Section `cell` of the job; fixtures on links become bodies of the robot.
        tree: The models of arm, positioner, rail and tool as one tree; None: only the arm's file.

    Raises:
        InputError: See `load_robot` and `with_carried`; also if the part does not move and the tool seems not to be in
            metres, see `check_tool`.
    """
    return _in_cell(_bare_robot(arm, tree), arm, cell)


def _bare_robot(arm: RobotConfig, tree: model_source.ComposedModel | None) -> Robot:
    """Load the robot without the cell's fixtures, of which it may carry some."""
    source = tree or arm.file
    robot = load_robot(
        source,
        tcp_site=arm.tcp or model_source.default_tcp(source),
        limits=arm.limits,
        **({} if tree else {"base_m": arm.base_m, "base_rpy_rad": arm.base_rpy_rad}),
        tool=arm.tool,
        locked=dict(arm.locked),
    )
    if robot.omitted:
        warnings.warn(
            f"{model_source.label_of(source)}: not checked: {', '.join(robot.omitted)}: omitted from the model",
            Note,
            stacklevel=3,
        )
    robot = replace(robot, indexed=_indexed(arm, source, robot))
    if arm.bodies == "capsules":
        return replace(robot, pieces=None)
    if arm.bodies == "meshes" and robot.pieces is None:
        raise InputError(
            f"robot.bodies: {arm.model} has no convex pieces of meshes; "
            "set robot.bodies to capsules, or use a model file written by htcp robot"
        )
    return robot


def _indexed(arm: RobotConfig, source: model_source.ModelSource, robot: Robot) -> frozenset[str]:
    """Return the names of the robot's joints that stand still within each seam.

    Raises:
        InputError: If `robot.indexed` names a joint that the robot does not have, or if no other joint remains.
    """
    joints, locked = robot.joint_names, dict(arm.locked)
    for name in arm.indexed:
        if name not in joints:
            why = "is locked, see robot.locked" if name in locked else "is not a joint that the planner moves"
            raise InputError(f"robot.indexed: {name!r} {why}; valid: {', '.join(joints)}")
    indexed = frozenset(indexed_joints(arm.indexed, source)) & frozenset(joints)
    if len(indexed) == len(joints):
        raise InputError(f"all joints of {robot.name} are indexed ({', '.join(joints)}); no joint moves along a seam")
    return indexed


def _in_cell(robot: Robot, arm: RobotConfig, cell: CellConfig) -> Robot:
    """Return the robot with the fixtures of the cell that its links carry, after a check of its tool."""
    if not robot.part_moves:  # if the part moves, the TCP may be anywhere in the world
        parts.check_tool(robot, arm.tool_extension_m)
    return cell_shapes.with_carried(robot, cell)


def workpiece_of(part: WorkpieceConfig, robot: Robot) -> Workpiece:
    """Load the workpiece. Its pose is not included, as it belongs to the scenario.

    The points on a mesh are as dense as the thinnest body that can come near it requires. A UserWarning reports a cloud
    with gaps through which this body fits, and a mesh whose covering radius is not below this body's radius.
    """
    if robot.part_moves and part.is_along_world_x:
        raise InputError(
            "workpiece.inlet_direction is world-x, but the part moves; set it to x,y,z in the frame of the part's link"
        )
    direction = InletDirection.WORLD_X if part.is_along_world_x else part.inlet_direction
    stated = {"inlet": part.inlet_m, "inlet_direction": direction}
    track: dict[str, Any] = {"path": path_file(part)}
    if part.seams:
        points, begins = points_of_seams(part)
        track = {"path": points, "name": part.path_label, "seam_begins": begins}
    else:
        columns = {} if part.path_columns is None else part.path_columns.given
        track |= {"path_columns": columns, "path_unit": part.path_unit, "path_angles": part.path_angles}
    workpiece = parts.load_workpiece(
        source_of(part),
        interior=part.interior,
        interior_depth_m=part.interior_depth_m,
        tip_contact_m=part.tip_contact_m,
        pivot=part.pivot_m,
        neutral_translation=part.neutral_translation_m,
        robot=robot,
        origin=part.origin_m,
        **track,
        **{name: value for name, value in stated.items() if value is not None},
    )
    workpiece = with_plates_of(part, workpiece)
    _warn_of_a_far_inlet(part, workpiece)
    body, cover_m = thinnest_nearby(robot), workpiece.covering_radius_m
    if body is None or not len(workpiece.cloud):
        return workpiece
    if not len(workpiece.triangles) and workpiece.largest_gap_m > 2 * body.radius_m:
        warnings.warn(
            f"{part.cloud}: the points have gaps of up to {1e3 * workpiece.largest_gap_m:.3g} mm; "
            f"{body.label}, {2e3 * body.radius_m:.3g} mm thick, fits through; collisions may be missed; use a denser "
            "cloud or a mesh",
            UserWarning,
            stacklevel=2,
        )
    if cover_m >= body.radius_m:
        spacing = denser_spacing(workpiece, cover_m - body.radius_m / 2)
        warnings.warn(
            f"{part.cloud}: every clearance is reduced by {1e3 * cover_m:.3g} mm, the covering radius of the mesh's "
            f"points; {body.label} has a radius of only {1e3 * body.radius_m:.3g} mm"
            + (f"; try {surface.KEY}: {spacing:g}" if spacing else ""),
            UserWarning,
            stacklevel=2,
        )
    return workpiece


def _warn_of_a_far_inlet(part: WorkpieceConfig, workpiece: Workpiece) -> None:
    """Warn of a stated inlet that is farther from the part than the part is large, as a length in mm would be."""
    if part.inlet_m is None or not len(workpiece.cloud):
        return
    low, high = workpiece.cloud.min(axis=0), workpiece.cloud.max(axis=0)
    away_m = float(np.linalg.norm(np.maximum(0.0, np.maximum(low - workpiece.inlet, workpiece.inlet - high))))
    if away_m > (size_m := float(np.linalg.norm(high - low))):
        warnings.warn(
            f"workpiece.inlet_m is {away_m:.3g} m away from the part, which is {size_m:.3g} m large; it is in metres, "
            "in the part's frame",
            UserWarning,
            stacklevel=3,
        )


def with_plates_of(part: WorkpieceConfig, workpiece: Workpiece) -> Workpiece:
    """Return the workpiece with the plates of a fillet from its mesh, if the section says so."""
    if part.plates is None:
        return workpiece
    return with_plates(workpiece, part.plates.within_m, np.array(part.plates.plate_1_faces))


def source_of(part: WorkpieceConfig) -> parts.WorkpieceSource:
    """Return the source of the workpiece's walls: the generated duct, the content of a file, or no walls."""
    if part.unit is not None and (part.is_duct or not part.has_cloud):
        raise InputError(
            f"workpiece.unit is {part.unit!r}, but workpiece.cloud is {part.cloud}, not a file; omit the key"
        )
    if part.is_duct:
        is_own = part.seams or path_file(part) is not None
        return parts.GeneratedDuct() if is_own else parts.GeneratedDuct(seam=part.path)
    return parts.read_source(part.cloud, part.mesh_spacing_m, part.unit) if part.has_cloud else parts.NoCloud()


def path_file(part: WorkpieceConfig) -> str | None:
    """Return the name of the path's file; None if the path is a seam of the generated duct, or several seams."""
    return part.path if is_file(part, part.path) else None


@_rows_by_key()
def scenario_of(
    job: PlanConfig,
    robot: Robot,
    workpiece: Workpiece,
    number: int = 0,
    beyond_reach: Literal["raise", "record"] = "raise",
) -> Scenario:
    """Build the scenario of a job: start, workpiece pose, targets, margin and tool extension.

    Args:
        job: The job.
        robot: The robot from `robot_of`.
        workpiece: The workpiece from `workpiece_of`.
        number: Number of the scenario, from which its random keys are derived.
        beyond_reach: "raise" raises an error if a target is beyond reach, or violates an angle that no joint changes;
            "record" does not, see `make_scenario`.
    """
    part = job.workpiece
    task = None if len(part.seams) > 1 else task_of_job(job, robot)
    follows = follower_at(job, robot, np.array(job.start)) if job.task and job.start is not None else None
    scenario = make_scenario(
        robot,
        workpiece,
        job.start,
        home=job.home_rad,
        rotation=(part.rotation_y_rad, part.rotation_z_rad),
        rotation_x_rad=part.rotation_x_rad,
        shift=part.shift_m,
        approach=job.approach,
        margin_m=job.margin_m,
        segment_margin_m=job.segment_margin_m,
        transfer_margin_m=job.transfer_margin_m,
        transfer_falloff_m=job.transfer_falloff_m,
        tool_extension_m=job.robot.tool_extension_m,
        number=number,
        beyond_reach=beyond_reach,
        follows=follows,
    )
    if job.cell.obstacles:
        scenario = replace(scenario, obstacle_numbers=numbers_of(job.cell.obstacles))
    with_goals = with_goals_of_seams(scenario, job, robot, workpiece, task)
    scenario = with_margins_of_seams(with_goals, job, workpiece)
    if beyond_reach == "raise" and task is not None:
        check_constant_angles(scenario, job.task, task, robot, workpiece)
    return scenario


def follower_at(job: PlanConfig, robot: Robot, x: Float[np.ndarray, "N"]) -> Float[np.ndarray, "3"]:
    """Return the world position, in a configuration x, of the point that follows the path [m]: the TCP without a task.

    Args:
        job: The job.
        robot: The robot from `robot_of`.
        x: The configuration [rad or m].
    """
    if not job.task:
        return tcp_at(robot, job.robot.tool_extension_m, x)
    return follower_position(job.task, robots.lengthen_tool(robot, job.robot.tool_extension_m), x)


def shapes_of(cell: CellConfig, robot: Robot) -> tuple[Fixture, ...]:
    """Return the shapes of the cell that do not move, in the world."""
    given = (shape for kind in cell.obstacles for shape in cell_shapes.shapes_in_world(kind))
    return *cell_shapes.standing_cell(cell, robot).shapes, *given


def drawn_of(cell: CellConfig, robot: Robot) -> surface.WorldGeometry:
    """Load the triangles and clouds of the cell's fixed objects, for drawing; moving objects are bodies of the arm.

    The floor is the highest plane that faces upwards.
    """
    given = [cell_shapes.shapes_in_world(kind) for kind in cell.obstacles]
    for kind, shapes in zip(cell.obstacles, given, strict=True):
        if not shapes:
            warnings.warn(f"the obstacle {kind.name!r} is not drawn: it has no shapes", Note, stacklevel=2)
    standing = cell_shapes.standing_cell(cell, robot)
    shapes = *standing.shapes, *(shape for own in given for shape in own)
    triangles = [surface.NOTHING.triangles, *(each.surface for each in shapes)]
    surfaces = [surface.NOTHING.clouds]
    for each, T in standing.clouds:
        points, mesh = parts.load_geometry(each.cloud, each.unit)
        if len(mesh):
            triangles.append(mesh @ T[:3, :3].T + T[:3, 3])
        else:
            surfaces.append(surface.surface_of(points).placed(T))
    clouds = surface.Surface(*map(np.concatenate, zip(*surfaces, strict=True)))
    planes = [each.T_world for each in shapes if each.kind == "plane"]
    floors = [float(T[2, 3]) for T in planes if T[2, 2] > 1 - LEVEL]
    return surface.WorldGeometry(np.concatenate(triangles), clouds, max(floors, default=None))


def obstacles_of(cell: CellConfig, robot: Robot) -> Obstacles:
    """Build the obstacles of the cell, without the workpiece.

    Raises:
        InputError: See `standing_cell`; also if the part moves and an obstacle that is fixed in the world cannot be
            tested.
    """
    if robot.part_moves and cell.obstacles:
        raise InputError(
            f"cell.obstacles: {cell.obstacles[0].name!r} is fixed in the world; if the part moves, remove it"
        )
    if robot.part_moves and robot.attached and not cell.self_collision:
        name = robot.capsule_names[robot.attached[0]]
        raise InputError(f"cell.self_collision must be true, because {name!r} moves relative to the part")
    standing = cell_shapes.standing_cell(cell, robot)
    for shape in standing.shapes:
        if shape.kind == "mesh":
            corners = shape.triangles.reshape(-1, 3)
            parts.check_cell_extent(robot, corners, shape.name, f"the scale of its mesh in {cell.model}")
        elif shape.kind != "plane":
            ends = np.outer([-1.0, 1.0], np.max(shape.size) * np.ones(3))
            parts.check_cell_extent(robot, ends, shape.name, f"its size in {cell.model}, in metres")
    clouds = tuple(_cell_cloud(each, T, standing, robot) for each, T in standing.clouds)
    own = make_self_collision(robot) if cell.self_collision else None
    given = given_obstacles(cell.obstacles)
    return (
        *make_fixtures(robot, standing.shapes, standing.excluded),
        *clouds,
        *given,
        *(() if own is None else (own,)),
    )


def checked_facts(robot: Robot, obstacles: Obstacles, *, is_tree: bool = False) -> dict[str, str]:
    """Return what is checked as text by label: bodies, pairs for self-collision, fixtures; and what is not checked.

    Args:
        robot: The robot.
        obstacles: Obstacles in addition to the workpiece.
        is_tree: True if the job composes the robot of several models.
    """
    own = [each.described(robot) for each in obstacles if isinstance(each, SelfCollision)]
    names = [robot.capsule_names[k] for k in robot.attached]
    names += [name for each in obstacles for name in each.names if name]
    facts = {"self-collision": own[0]} if own else {}
    unchecked = [f"{', '.join(robot.omitted)}: omitted from the model"] if robot.omitted else []
    if robot.ignored_geoms and not is_tree:
        ignored = ", ".join(robot.ignored_geoms)
        unchecked.append(f"{ignored}: no capsule or sphere; convert the arm with htcp robot")
    unchecked += [f"{each.sunk}: fixed bodies are not tested" for each in obstacles if each.sunk]
    if unchecked:
        facts = {"not checked": "; ".join(unchecked)} | facts
    if robot.pieces is not None:
        facts = {"bodies": f"{len(robot.capsule_names)} capsules, and convex pieces where in doubt"} | facts
    return facts | ({"fixtures": ", ".join(names)} if names else {})


def _cell_cloud(
    cloud: CloudConfig, T: Float[np.ndarray, "4 4"], standing: cell_shapes.StandingCell, robot: Robot
) -> PlacedCloud:
    """Return a cloud or mesh of the cell, at its pose T in the world [m]."""
    found, name = parts.load_geometry(cloud.cloud, cloud.unit), cell_shapes.name_of(cloud)
    parts.check_cell_extent(robot, found.points, name, "cell.clouds has the key unit")
    excluded = standing.excluded.get(name, ())
    return placed_cloud(robot, *found, T, source=cloud.cloud, name=name, excluded=excluded)


_POSE = {"rotation_x_rad": 0.0, "rotation_y_rad": 0.0, "rotation_z_rad": 0.0, "shift_m": (0.0, 0.0, 0.0)}
_APPROACH = {"approach_to_inlet": 0, "approach_to_path": 0}


def robot_key(job: PlanConfig) -> tuple[RobotConfig, CellConfig, model_source.ComposedModel | None]:
    """Return the arguments of `robot_of` for a job, as a cache key. Scenarios with equal keys share the robot."""
    cell, arm, tree = job.cell, job.robot.model_copy(update={"tool_extension_m": 0.0}), job.tree
    if (tree or not job.robot.is_gp50) and part_moves(tree or job.robot.file):
        return arm, cell.model_copy(update={"self_collision": False, "obstacles": ()}), tree
    carried = cell.is_carried and CellConfig(model=cell.model, clouds=cell.clouds, fixtures=cell.fixtures)
    return arm, carried or NO_CELL, tree


def workpiece_key(job: PlanConfig) -> WorkpieceConfig:
    """Return the section `workpiece` without pose and approach, as a cache key. Equal keys share the workpiece."""
    return job.workpiece.model_copy(update=_POSE | _APPROACH)


def obstacles_key(cell: CellConfig) -> tuple:
    """Return the values of `cell` that determine the obstacles, as a cache key.

    The key does not contain the numeric fields of obstacles from other packages, as they belong to the scenario.
    """
    return cell.model_copy(update={"obstacles": ()}), tuple(map(template_of, cell.obstacles))


def walls_key(part: WorkpieceConfig) -> WorkpieceConfig:
    """Return the section `workpiece` without path and pose, as a cache key. Equal keys share the walls."""
    origin = (0.0, 0.0, 0.0)
    path = {"path": SEVERAL, "seams": (), "path_columns": None, "path_unit": None, "path_angles": None}
    return part.model_copy(update={**path, "pivot_m": origin, "neutral_translation_m": origin})
