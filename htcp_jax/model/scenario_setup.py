"""Set-up of scenarios: the start, the pose of the part and the targets, and their description."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import jax
import numpy as np
import scipy

from htcp_jax.errors import InputError
from htcp_jax.model.kinematics import max_reach, tcp_position
from htcp_jax.model.robot import Robot, lengthen_tool
from htcp_jax.model.scenario import NOT_REFUSED, Scenario, without_pose
from htcp_jax.model.workpiece import Workpiece
from htcp_jax.status import Status
from htcp_jax.types import Anywhere, Bool, Float, Int


class OutOfReach(InputError):
    """Error for a target beyond the arm's maximum reach."""


def path_targets(
    tcp: Float[np.ndarray, "*S 3"],
    inlet: Float[np.ndarray, "*S 3"] | None,
    path: Float[np.ndarray, "*S W 3"],
    approach: tuple[int, int] = (5, 5),
) -> Float[np.ndarray, "*S T 3"]:
    """Return the targets of scenarios [m]: the start TCP, the steps of the approach, and the complete path.

    The path's first point occurs twice: it is also the last step of the approach. All points are in the same frame.

    Args:
        tcp: The start TCP.
        inlet: The inlet's centre, via point of the approach; None: the approach is straight from the start to the path.
        path: Points of the path.
        approach: Number of equal steps to the inlet's centre, and number of equal steps from there to the path.
    """
    stops = [tcp, path[..., 0, :]] if inlet is None else [tcp, inlet, path[..., 0, :]]
    stops = [np.asarray(stop)[..., None, :] for stop in stops]
    steps = [sum(approach)] if inlet is None else approach
    legs = [
        a + (b - a) * np.linspace(0, 1, n + 1)[1:, None] for a, b, n in zip(stops[:-1], stops[1:], steps, strict=True)
    ]
    return np.concatenate([stops[0], *legs, path], axis=-2)


def make_scenario(
    robot: Robot,
    workpiece: Workpiece,
    start: Sequence[float] | Anywhere | None,
    *,
    home: Sequence[float] | Anywhere | None = None,
    rotation: tuple[float, float] = (0.4, 0.1),
    rotation_x_rad: float = 0.0,
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0),
    approach: tuple[int, int] = (5, 5),
    margin_m: float = 5e-4,
    segment_margin_m: float = 0.0,
    transfer_margin_m: float = 0.0,
    transfer_falloff_m: float = 0.05,
    tool_extension_m: float = 0.0,
    number: int = 0,
    beyond_reach: Literal["raise", "record"] = "raise",
    follows: Float[np.ndarray, "3"] | None = None,
) -> Scenario:
    """Build a scenario: a start, a workpiece pose and the targets.

    Args:
        robot: The robot.
        workpiece: The workpiece.
        start: N joint positions [rad or m]; None: the planner chooses them, at the path's first point, which is then
            the first target, without an approach.
        home: Joint positions at which the motion begins [rad or m]; None: the start.
        rotation: Rotation of the workpiece about world y, then z [rad], after `rotation_x_rad`.
        rotation_x_rad: Rotation of the workpiece about world x.
        shift: Translation of the workpiece in the world [m].
        approach: Steps of the approach, see `path_targets`.
        margin_m: Required clearance at the targets.
        segment_margin_m: Required clearance on the segments of the path; 0: only D > 0.
        transfer_margin_m: Required clearance before the path, if there is such a motion; 0: only D > 0.
        transfer_falloff_m: Distance from the ends of a motion within which `transfer_margin_m` falls off.
        tool_extension_m: Extension of the tool, see `robot.lengthen_tool`.
        number: Number of the scenario, for the random keys.
        beyond_reach: What to do if a target is beyond the arm's maximum reach: "raise" raises OutOfReach; "record" sets
            the scenario's status, and the scenario is not planned.
        follows: World position [m], at the start, of the point that follows the path; None: the TCP's position.

    Raises:
        InputError: For a start or home of the wrong length or outside the joint limits.
        OutOfReach: An InputError, for a target beyond the arm's maximum reach if `beyond_reach` is "raise".
    """
    x_start, x_home = start_and_home(robot, start, home)
    T_world_workpiece = workpiece.T_world(*rotation, shift=shift, wx=rotation_x_rad)
    scenarios = make_scenarios(
        robot,
        workpiece,
        x_start[None],
        x_home[None],
        auto_start=start is None,
        follows=(tcp_at(robot, tool_extension_m, x_start) if follows is None else np.asarray(follows))[None],
        T_world_workpiece=T_world_workpiece[None],
        interior_plane=interior_plane_of(robot, workpiece, T_world_workpiece)[None],
        approach=approach,
        margin_m=np.array([margin_m], float),
        segment_margin_m=np.array([segment_margin_m], float),
        transfer_margin_m=np.array([transfer_margin_m], float),
        transfer_falloff_m=np.array([transfer_falloff_m], float),
        tool_extension_m=tool_extension_m,
        number=np.array([number]),
    )
    scenario = jax.tree.map(lambda leaf: np.asarray(leaf[0]), scenarios)
    if beyond_reach == "raise" and scenario.refused != NOT_REFUSED:
        error = _beyond_reach(with_tool(robot, float(tool_extension_m)), scenario.targets)
        raise OutOfReach(f"{without_pose(T_world_workpiece)}{error}")
    return scenario


def make_scenarios(
    robot: Robot,
    workpiece: Workpiece,
    x_start: Float[np.ndarray, "S N"],
    x_home: Float[np.ndarray, "S N"],
    *,
    auto_start: bool,
    follows: Float[np.ndarray, "S 3"],
    T_world_workpiece: Float[np.ndarray, "S 4 4"],
    interior_plane: Float[np.ndarray, "S 4"],
    approach: tuple[int, int],
    margin_m: Float[np.ndarray, "S"],
    segment_margin_m: Float[np.ndarray, "S"],
    transfer_margin_m: Float[np.ndarray, "S"],
    transfer_falloff_m: Float[np.ndarray, "S"],
    tool_extension_m: float,
    number: Int[np.ndarray, "S"],
) -> Scenario:
    """Build stacked scenarios that share the robot with its tool, the workpiece and the approach.

    The status of a scenario with a target beyond the arm's maximum reach is set, and it is not planned.

    Args:
        robot: The robot.
        workpiece: The workpiece.
        x_start: Starts, see `start_and_home` [rad or m].
        x_home: First configurations of the motions [rad or m].
        auto_start: True if the planner chooses the starts, see `make_scenario`.
        follows: World positions [m], at the starts, of the point that follows the path.
        T_world_workpiece: Poses of the workpiece [m].
        interior_plane: Planes that belong to the poses, see `interior_plane_of` [m].
        approach: Steps of the approach, see `path_targets`.
        margin_m: Required clearances at the targets.
        segment_margin_m: Required clearances on the segments of the path; 0: only D > 0.
        transfer_margin_m: Required clearances before the path, see `make_scenario`.
        transfer_falloff_m: Distances within which they fall off.
        tool_extension_m: Extension of the tool, see `robot.lengthen_tool`.
        number: Numbers of the scenarios, for the random keys.
    """
    rotate, translate = T_world_workpiece[:, :3, :3], T_world_workpiece[:, :3, 3]
    path = workpiece.path @ np.swapaxes(rotate, 1, 2) + translate[:, None]
    inlet = None if workpiece.inlet is None else rotate @ workpiece.inlet + translate
    first, steps = (path[:, 0], (0, 0)) if auto_start else (follows, approach)
    targets = path_targets(first, inlet, path, steps)
    is_far = beyond_reach(robot, targets, tool_extension_m)
    scenarios, count = targets.shape[:2]
    return Scenario(
        x_start=x_start,
        x_home=x_home,
        auto_start=np.full(scenarios, auto_start),
        T_world_workpiece=T_world_workpiece,
        interior_plane=interior_plane,
        targets=targets,
        count=np.full(scenarios, count, np.int32),
        on_path=np.full(scenarios, count - len(workpiece.path), np.int32),
        margin_m=margin_m,
        segment_margin_m=segment_margin_m,
        transfer_margin_m=transfer_margin_m,
        transfer_falloff_m=transfer_falloff_m,
        tool_extension_m=np.full(scenarios, tool_extension_m, float),
        number=number.astype(np.int32),
        refused=np.where(is_far.any(axis=1), Status.OUT_OF_REACH, NOT_REFUSED).astype(np.int32),
    )


def beyond_reach(
    robot: Robot, targets: Float[np.ndarray, "*S T 3"], tool_extension_m: float
) -> Bool[np.ndarray, "*S T"]:
    """Return True for targets [m] beyond the maximum reach of an arm with its tool lengthened by `tool_extension_m`."""
    return _distances(robot, targets) > max_reach(with_tool(robot, float(tool_extension_m)))


def interior_plane_of(
    robot: Robot, workpiece: Workpiece, T_world_workpiece: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "4"]:
    """Return the plane beyond which capsule ends must lie inside the workpiece: its unit normal n and offset [m].

    A point x in the world lies beyond the plane if n @ x > offset. If the part has no hull, if it moves, or if the
    robot's base is beyond the plane (next to the workpiece), the offset is infinite, which switches the rule off. For
    the paper's rule, along the world's x, the base is not considered.
    """
    plane = workpiece.interior_plane(T_world_workpiece)
    if robot.part_moves or not len(workpiece.hull_offset):
        plane[3] = np.inf
        return plane
    fixed = np.asarray(robot.capsule_link) < 0
    ends = (np.asarray(end)[fixed] for end in (robot.capsule_p, robot.capsule_q))
    base = np.concatenate([np.asarray(robot.T_parent_joint)[:1, :3, 3], *ends])
    if workpiece.inlet_direction is not None and (base @ plane[:3] > plane[3]).any():
        plane[3] = np.inf
    return plane


def interior_rule(workpiece: Workpiece, scenario: Scenario) -> str:
    """Describe the rule that bodies deep in the workpiece must lie in its hull, or the reason why it is off."""
    is_outside = np.isinf(scenario.interior_plane[3]) and len(workpiece.hull_offset)
    return "off: the robot stands beyond the inlet, or the part moves" if is_outside else workpiece.interior_rule


def place_of(workpiece: Workpiece, T_world_workpiece: Float[np.ndarray, "4 4"], link: str | None = None) -> str:
    """Describe a workpiece's place in the world: its frame, and the extent of its walls, or of its path without walls.

    Args:
        workpiece: The workpiece.
        T_world_workpiece: Its pose [m].
        link: Name of the link that carries it; None for the world.
    """
    T = np.asarray(T_world_workpiece)
    at = ", ".join(f"{value:.4g}" for value in np.round(T[:3, 3], 6) + 0.0)
    place = f"origin at ({at}) m" if T[:3, 3].any() else f"at {'the world' if link is None else link}'s origin"
    points = workpiece.shown @ T[:3, :3].T + T[:3, 3]
    sides = zip("xyz", points.min(axis=0) + 0.0, points.max(axis=0) + 0.0, strict=True)
    extent = ", ".join(f"{axis} {low:.3f} to {high:.3f}" for axis, low, high in sides)
    origin = ", ".join(f"{value:.12g}" for value in np.asarray(workpiece.origin))
    of_files = f"; its origin is ({origin}) m of its files" if np.any(workpiece.origin) else ""
    frame = "" if link is None else f", in the frame of {link}"
    return f"{place}, {_turn(T[:3, :3])}; extent {extent} m{frame}{of_files}"


def _turn(R: Float[np.ndarray, "3 3"]) -> str:
    """Return text about a rotation: its angle and axis."""
    if (R == np.eye(3)).all():
        return "not turned"
    turn = scipy.spatial.transform.Rotation.from_matrix(R).as_rotvec()
    angle = np.linalg.norm(turn)
    axis = np.round(turn / max(angle, 1e-12), 3) + 0.0
    k = int(np.abs(axis).argmax())
    if np.abs(axis[k]) == 1:
        return f"turned by {np.rad2deg(angle) * axis[k]:.3g} deg about {'xyz'[k]}"
    return f"turned by {np.rad2deg(angle):.3g} deg about ({', '.join(f'{each:g}' for each in axis)})"


def with_own_tool(robot: Robot, scenario: Scenario) -> tuple[Robot, Scenario]:
    """Return an equivalent robot and scenario: the robot with the scenario's tool extension, the scenario with 0."""
    own = replace(scenario, tool_extension_m=np.zeros_like(scenario.tool_extension_m))
    return with_tool(robot, float(scenario.tool_extension_m)), own


def with_tool(robot: Robot, extension_m: float) -> Robot:
    """Return the robot with its tool lengthened by `extension_m`, see `lengthen_tool`; the same object for 0."""
    return _LONGER(robot, extension_m) if extension_m else robot


def tcp_at(robot: Robot, tool_extension_m: float, x: Float[np.ndarray, "N"]) -> Float[np.ndarray, "3"]:
    """Return the world position of the TCP at a configuration [m], with the tool lengthened by `tool_extension_m`."""
    return np.asarray(_TCP(with_tool(robot, float(tool_extension_m)), x))


_TCP, _LONGER = jax.jit(tcp_position), jax.jit(lengthen_tool)


def start_and_home(
    robot: Robot, start: Sequence[float] | Anywhere | None, home: Sequence[float] | Anywhere | None
) -> tuple[Float[np.ndarray, "N"], Float[np.ndarray, "N"]]:
    """Return x_start and x_home of a `Scenario` [rad or m], see `make_scenario`.

    Raises:
        InputError: For a start or home of the wrong length or outside the joint limits.
    """
    if start is None and home is None:
        anywhere = np.clip(np.zeros(len(robot.joint_names)), robot.lower, robot.upper)
        return anywhere, np.full_like(anywhere, np.nan)
    x_home = _start_configuration(robot, start if home is None else home, "start" if home is None else "home")
    return x_home if start is None else _start_configuration(robot, start, "start"), x_home


def _start_configuration(robot: Robot, positions: Sequence[float] | Anywhere, what: str) -> Float[np.ndarray, "N"]:
    """Return joint positions as an array, checked against the robot's limits; `what` is their name in messages.

    Raises:
        InputError: For a wrong number of positions, and for one outside its limits.
    """
    x, lower, upper = np.asarray(positions, float), np.asarray(robot.lower), np.asarray(robot.upper)
    if x.shape != lower.shape:
        raise InputError(f"{what} has {x.size} joint positions, the robot {robot.name} has {robot.counted_joints}")
    for name, value, low, high in zip(robot.joint_names, x, lower, upper, strict=True):
        if not low <= value <= high:
            raise InputError(f"{what}: {name} at {value:.6g} is outside its limits {low:.6g} to {high:.6g}")
    return x


def _distances(robot: Robot, targets: Float[np.ndarray, "*S T 3"]) -> Float[np.ndarray, "*S T"]:
    """Return the distances of targets from the robot's base [m]."""
    return np.linalg.norm(targets - np.asarray(robot.T_parent_joint)[0, :3, 3], axis=-1)


def _beyond_reach(robot: Robot, targets: Float[np.ndarray, "T 3"]) -> str:
    """Return text that names the first target beyond reach."""
    far, longest = _distances(robot, targets), max_reach(robot)
    first, *more = np.flatnonzero(far > longest)
    others = f"; {len(more)} more target{' is' if len(more) == 1 else 's are'} out of reach" if more else ""
    return (
        f"target {first} is {far[first]:.3f} m from the robot's base, but {robot.name} reaches at most {longest:.3f} m"
        f"{others}"
    )
