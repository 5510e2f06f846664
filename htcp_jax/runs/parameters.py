"""Parameters in which the scenarios of a run may differ, and their columns in the scenario table.

The columns are:

    start_<joint>_rad ..., rotation_x_rad, rotation_y_rad, rotation_z_rad, shift_x_m ..., tool_extension_m

The names of the columns are defined only here. The start in a table is the first configuration of the plan, see
`Plans.start`.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.spec import PlanConfig

ROTATIONS = "rotation_x_rad", "rotation_y_rad", "rotation_z_rad"
SHIFTS = "shift_x_m", "shift_y_m", "shift_z_m"
TOOL = "tool_extension_m"


class Parameters(NamedTuple):
    """Start of the motion, pose of the workpiece and extension of the tool in one scenario."""

    start: Float[np.ndarray, "N"]  # first configuration [rad or m]; empty if the planner chooses it
    rotation_x_rad: float  # rotations of the workpiece about its pivot: about world x, then y, then z
    rotation_y_rad: float
    rotation_z_rad: float
    shift_m: Float[np.ndarray, "3"]  # translation of the workpiece in the world
    tool_extension_m: float


def of_job(job: PlanConfig) -> Parameters:
    """Return the parameters of a job's scenario."""
    part = job.workpiece
    start, shift = np.array(job.begins_rad, float), np.array(part.shift_m, float)
    return Parameters(start, *(getattr(part, name) for name in ROTATIONS), shift, job.robot.tool_extension_m)


def of_row(row: Mapping[str, Any], joints: Sequence[str]) -> Parameters:
    """Return the parameters in a row of a scenario table.

    Args:
        row: Values by name of their columns.
        joints: Names of the columns of x, see `tables.joint_columns`.
    """
    start, shift = ([row[name] for name in names] for names in (start_columns(joints), SHIFTS))
    return Parameters(np.array(start, float), *(row[name] for name in ROTATIONS), np.array(shift, float), row[TOOL])


def columns(
    parameters: Sequence[Parameters], start: Float[np.ndarray, "S N"], joints: Sequence[str]
) -> dict[str, np.ndarray]:
    """Return the columns of the scenario table that contain the parameters of S scenarios.

    Args:
        parameters: Parameters of each scenario.
        start: First configuration of each plan [rad or m].
        joints: Names of the columns of x, see `tables.joint_columns`.
    """
    found = {name: start[:, k] for k, name in enumerate(start_columns(joints))}
    found |= {name: [getattr(one, name) for one in parameters] for name in ROTATIONS}
    found |= {name: [one.shift_m[k] for one in parameters] for k, name in enumerate(SHIFTS)}
    found |= {TOOL: [one.tool_extension_m for one in parameters]}
    return {name: np.array(values, float) for name, values in found.items()}


def start_columns(joints: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the columns that contain the start, one per joint."""
    return tuple(f"start_{name}" for name in joints)
