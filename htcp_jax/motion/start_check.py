"""Checks that a scenario can begin: neither home nor start may be in collision.

A start is checked by itself, before anything is compiled for the planner, so that an error names the body and the
obstacle.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from htcp_jax.clearance import Obstacles
from htcp_jax.clearance.obstacles import RefusedPair, SelfCollision, all_obstacles, refused_pair
from htcp_jax.errors import InputError
from htcp_jax.model import Robot, Scenario, Workpiece
from htcp_jax.model import scenario as scenario_functions
from htcp_jax.motion.measured_rows import MeasuredRows
from htcp_jax.status import Status

INTERIOR_RULE = (  # after the name of the keep-out zone
    ", which begins at the depth workpiece.interior_depth_m in the part; move one of them, or set "
    "workpiece.interior: none if the part is open there"
)


class StartContact(NamedTuple):
    """The body nearest to an obstacle at a configuration."""

    clearance_m: float  # the clearance D
    body: str  # label of the body
    other: str  # the obstacle nearest to it, with a note if a mesh is not that near
    is_fixed: bool  # True if the body is fixed in the world


def start_contact(
    robot: Robot,
    workpiece: Workpiece,
    scenario: Scenario,
    x: Float[np.ndarray, "N"] | None = None,
    obstacles: Obstacles = (),
    fixed_first: bool = False,
) -> StartContact:
    """Return the clearance at the scenario's start, with the body and the obstacle nearest to it.

    Args:
        robot: The arm with its tool.
        workpiece: The part.
        scenario: Start, pose of the workpiece, and tool extension.
        x: Configuration to measure instead of the start [rad or m].
        obstacles: In addition to the workpiece.
        fixed_first: True: if any fixed body overlaps an obstacle, return the fixed body with the deepest overlap.
    """
    x = np.asarray(scenario.x_start if x is None else x)
    measured = MeasuredRows(robot, all_obstacles(workpiece, obstacles), scenario_functions.stack([scenario]), x[None])
    distance, fixed = measured.distance[0], measured.stands
    if fixed_first and (fixed & (distance <= 0)).any():
        distance = np.where(fixed, distance, np.inf)
    row = int(distance.argmin())
    other = measured.other(row, 0)
    rule = INTERIOR_RULE if measured.found.by_interior_rule[0, row] else ""
    other = f"{other}{rule}{measured.mesh_note(row, 0, other)}"
    return StartContact(float(distance[row]), measured.label(row), other, bool(fixed[row]))


def check_start(robot: Robot, workpiece: Workpiece, scenario: Scenario, obstacles: Obstacles = ()) -> None:
    """Check that neither the home nor the start is in collision, and that no fixed body is.

    Args:
        robot: The arm with its tool.
        workpiece: The part.
        scenario: Home, start, pose of the workpiece, and tool extension.
        obstacles: In addition to the workpiece.

    Raises:
        InputError: If the home or the start is in collision; the message names the body, the obstacle and the depth.
    """
    for what, x in begins_at(scenario).items():
        D, body, other, fixed = start_contact(robot, workpiece, scenario, x, obstacles, fixed_first=True)
        if D <= 0:
            where = "no configuration is clear" if fixed else f"{what} is in collision"
            remedy = "; neither of the two moves: move one of them" if fixed else ""
            place = scenario_functions.without_pose(scenario.T_world_workpiece) if "workpiece" in other else ""
            raise InputError(f"{place}{where}: {body} is {-1e3 * D:.3f} mm inside {other}{remedy}")


def begins_at(scenario: Scenario) -> dict[str, Float[np.ndarray, "N"]]:
    """Return the configurations [rad or m] that must be clear before planning (home, start), by name."""
    if scenario.begins_anywhere:
        return {}
    start = {"start": scenario.x_start}
    if scenario.auto_start or (scenario.x_home != scenario.x_start).any():
        return {"home": scenario.x_home} | ({} if scenario.auto_start else start)
    return start


def with_refused(robot: Robot, obstacles: Obstacles, scenarios: Scenario, raises: bool) -> Scenario:
    """Return the scenarios with those refused that begin with an overlap of excluded capsules, see `refused_pair`.

    Raises:
        InputError: If there is such a scenario and `raises` is True.
    """
    refused = scenarios.refused.copy()
    for own in (each for each in obstacles if isinstance(each, SelfCollision)):
        known: dict[bytes, RefusedPair | None] = {}
        for s in np.flatnonzero(refused == scenario_functions.NOT_REFUSED):
            for what, x in begins_at(jax.tree.map(lambda leaf, s=s: leaf[s], scenarios)).items():
                if x.tobytes() not in known:
                    known[x.tobytes()] = refused_pair(own, robot, x)
                if (pair := known[x.tobytes()]) is None:
                    continue
                if raises:
                    raise InputError(f"{what} is in collision: {pair.reason}")
                home = what == "home"
                refused[s] = Status.HOME_IN_COLLISION if home else Status.START_IN_COLLISION
    return replace(scenarios, refused=refused)
