"""Reason why a target has no clear configuration: the fewest bodies of the arm with which `tool_cells` proves it."""

import numpy as np
from jaxtyping import Bool, Int

from htcp_jax.clearance.proof import exclusion
from htcp_jax.device import Executor, tables
from htcp_jax.model import Robot, kinematics
from htcp_jax.motion.lane_inputs import LaneInputs
from htcp_jax.motion.tool_cells import excluded
from htcp_jax.status import Exclusion

SMALLEST_FIRST = {
    exclusion.Bodies.NONE: Exclusion.OUT_OF_REACH,
    exclusion.Bodies.TOOL: Exclusion.TOOL,
    exclusion.Bodies.WRIST: Exclusion.WRIST,
}


def exclusions(executor: Executor, robot: Robot, inputs: LaneInputs, cells: int) -> Int[np.ndarray, "n"]:
    """Return, for each of n targets, why it has no clear configuration: an `Exclusion`, NONE without a proof.

    Args:
        executor: Compiled functions of the scene, whose task fixes the TCP's position.
        robot: The arm, without the scenarios' tool extensions.
        inputs: The lanes' inputs, one row per target.
        cells: Maximum number of cells of a proof, see `tool_cells.excluded`.
    """
    found = np.where(_beyond(executor, robot, inputs), Exclusion.OUT_OF_REACH, Exclusion.NONE).astype(int)
    of, proofs = Exclusion.NONE, {exclusion.Bodies.ARM: Exclusion.ARM} | SMALLEST_FIRST
    for bodies, reason in proofs.items():
        left = np.flatnonzero(found == of)
        if len(left):
            found[left[excluded(executor, robot, tables.gather(inputs, left), cells, bodies)]] = reason
        of = Exclusion.ARM
    return found


def _beyond(executor: Executor, robot: Robot, inputs: LaneInputs) -> Bool[np.ndarray, "n"]:
    """Return True for targets farther away from the base than the length of the arm."""
    task = executor.task
    away = np.linalg.norm(task.tcp_place(inputs.target) - np.asarray(robot.T_parent_joint)[0, :3, 3], axis=1)
    return away > kinematics.max_reach(robot) + inputs.tool_extension_m + task.tolerance_m
