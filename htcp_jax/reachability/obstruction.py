"""The colliding body at a target that a plan did not reach: its name, the point of contact, and the depth.

From the last tracked configuration, inverse kinematics (5b) moves the tool onto the failed target within the joint
limits, ignoring collisions. The colliding body is the body with the smallest clearance in the resulting configuration.
If this clearance is above 0, no body collides, and the search ended for another reason. This is only one of many
configurations at the target; the plan may have failed in others.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.clearance import Obstacles, Scene
from htcp_jax.clearance.obstacles import all_obstacles
from htcp_jax.device import Executor, lane_function
from htcp_jax.errors import mm_text
from htcp_jax.model import Robot, Scenario, Task, Workpiece, reanchor
from htcp_jax.model import scenario as scenarios
from htcp_jax.motion import Plans, lane_inputs, measured_rows
from htcp_jax.settings import Settings
from htcp_jax.status import AT_HOME, Status

NO_BODY = Status.NOT_ATTEMPTED, Status.OUT_OF_REACH, Status.TIP_BLOCKED, *AT_HOME  # results without a colliding body


class Obstruction(NamedTuple):
    """The arm, moved onto a failed target, and the body with the smallest clearance there."""

    body: str  # name of the capsule with the smallest clearance
    point: Float[np.ndarray, "3"]  # nearest point of the obstacle, world [m]
    depth_m: float  # penetration of the body [m]; negative: its clearance
    residual_m: float  # distance from the TCP to the target
    reached: bool  # True if residual and angle are within the tolerance
    x: Float[np.ndarray, "N"]  # the configuration [rad or m]
    other: str = "the workpiece"  # the obstacle nearest to the body
    from_mesh: str = ""  # text about the distance from the capsule to the link's mesh; empty without meshes
    body_label: str = ""  # name of the body with its link, for messages
    angle_rad: float = 0.0  # deviation from the required orientation; 0 if no orientation is required
    within_bands: bool = True  # False if a cone or band of the task is violated

    @property
    def collides(self) -> bool:
        """True if the tool is on the target and the body penetrates an obstacle."""
        return self.reached and self.depth_m > 0

    def cause(self, otherwise: str) -> str:
        """Return the name of the colliding body, "not reached", or `otherwise` if no body collides."""
        return (self.body_label or self.body) if self.collides else otherwise if self.reached else "not reached"

    @property
    def heading(self) -> str:
        """Label for `description` in a list of facts."""
        return "colliding body" if self.collides else "closest approach" if self.reached else "reach"

    @property
    def description(self) -> str:
        """Message that names the colliding body, or describes how close the arm comes."""
        if not self.reached:
            angle = f" and {np.rad2deg(self.angle_rad):.3g} deg" if self.angle_rad else ""
            outside = "" if self.within_bands else ", outside of the task's cones and bands"
            return (
                "inverse kinematics from the last configuration comes only to within "
                f"{mm_text(self.residual_m)}{angle} of the target{outside}; another configuration may reach it"
            )
        body = self.body_label or self.body
        where = f"at ({', '.join(f'{value:.2f}' for value in self.point)}) m there"
        if self.depth_m > 0:
            return f"{body} is {mm_text(self.depth_m)} inside {self.other} {where}{self.from_mesh}"
        return f"no body collides; {body} comes within {mm_text(-self.depth_m)} of {self.other} {where}"

    def record(self) -> dict[str, Any]:
        """Return the obstruction as a mapping for JSON."""
        found = {"body": self.body, "other": self.other, "point_m": self.point.tolist(), "depth_mm": 1e3 * self.depth_m}
        return {**found, "residual_mm": 1e3 * self.residual_m, "x": self.x.tolist(), "description": self.description}


def obstruction(
    robot: Robot,
    workpiece: Workpiece,
    scenario: Scenario,
    x_last: np.ndarray,
    target: int,
    settings: Settings,
    obstacles: Obstacles = (),
    task: Task | None = None,
) -> Obstruction:
    """Return the obstruction at a target of a scenario: the body with the smallest clearance.

    Args:
        robot: The arm with its tool.
        workpiece: The part.
        scenario: Pose, targets and tool extension.
        x_last: The last tracked configuration, or the start if there is none, (N,) [rad or m].
        target: Index of the target.
        settings: Settings; `tolerance_m` is used.
        obstacles: Obstacles in addition to the workpiece.
        task: The constraints at the target; None: the TCP's position.
    """
    inputs = lane_inputs.lane_inputs(scenarios.stack([scenario]), np.zeros(1, int), np.array([target]))
    known = all_obstacles(workpiece, obstacles)
    (found,) = obstructions(robot, known, inputs, np.asarray(x_last)[None], inputs.target, settings, task)
    return found


def obstructions(
    robot: Robot,
    obstacles: Obstacles,
    where: Any,
    x_last: Float[np.ndarray, "S N"],
    goals: Float[np.ndarray, "S G"],
    settings: Settings,
    task: Task | None = None,
) -> list[Obstruction]:
    """Return the obstruction for each of S scenarios.

    Args:
        robot: The arm with its tool.
        obstacles: All obstacles, including the workpiece.
        where: Stacked scenarios: the fields of `HasWorkpiecePose`, and `tool_extension_m`.
        x_last: The last tracked configurations [rad or m].
        goals: The task's goals; for the default task the targets, world [m].
        settings: Settings; `tolerance_m` is used.
        task: The constraints at the targets; None: the TCP's position.
    """
    task = Task(tolerance_m=settings.tolerance_m) if task is None else task
    if not len(x_last):
        return []
    place, goals = measured_rows.Placement.of(where), np.asarray(goals, float)
    executor = Executor(Scene(robot, (), task), settings)
    brought, residual = executor(BRING, place, np.asarray(x_last, float), goals)
    is_reached = task.reached(residual)
    measured, found = measured_rows.MeasuredRows(robot, obstacles, place, brought), []
    for k, (x, off, reached) in enumerate(zip(brought, residual.tolist(), is_reached.tolist(), strict=True)):
        row = int(measured.distance[k].argmin())
        body, point, depth_m = measured.body(row), measured.found.witness[k, row], -float(measured.distance[k, row])
        other = measured.other(row, k)
        note, label = measured.mesh_note(row, k, other), measured.label(row)
        found.append(Obstruction(body, point, depth_m, off, reached, x, other, note, label))
    if task.is_points or is_reached.all():
        return found
    errors = measured_rows.task_errors(robot, task, place, brought, goals)
    for k in np.flatnonzero(~is_reached).tolist():
        distance, angle, slack = (float(table[k]) for table in errors)
        found[k] = found[k]._replace(residual_m=distance, angle_rad=angle, within_bands=slack >= 0)
    return found


def blocked_target(plans: Plans, scenario: int) -> int | None:
    """Return the first target that is not tracked, if a body of the arm may have blocked it.

    None if all targets are tracked, and for statuses in NO_BODY: for example, no target was attempted, the target is
    out of reach, or the tool's tip is blocked.
    """
    end = plans.outcome(scenario)
    return None if end.status in (None, *NO_BODY) else end.failed


def _bring(settings: Settings, scene: Scene, where: measured_rows.Placement, x_last, goal):
    """Move one scenario's arm onto its goal; return the configuration [rad or m] and the residual [m]."""
    return reanchor(scene.robot, x_last, goal, scene.task.fine_m, task=scene.task)


BRING = lane_function.LaneFunction("bring", _bring, lane_function.STEP, any_cone=True)
