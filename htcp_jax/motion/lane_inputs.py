"""Inputs of a lane that every lane function takes."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from htcp_jax.model import Scenario


class LaneInputs(NamedTuple):
    """Inputs of one lane: its scenario's data and its target.

    Each lane carries its own copy, so executables do not depend on the number of scenarios.
    """

    T_world_workpiece: jax.Array
    interior_plane: jax.Array
    margin_m: jax.Array
    tool_extension_m: jax.Array
    number: jax.Array
    target: jax.Array  # the task's goal there [m]
    row: jax.Array  # of the target
    round: jax.Array  # of draws
    seed: jax.Array
    obstacle_numbers: jax.Array | None = None  # of kinds of obstacles, see `Scenario`
    max_joint_step: jax.Array | None = None  # longest travel of each joint to the target, see `longest_joint_steps`


def lane_inputs(
    scenarios: Scenario, scenario: np.ndarray, row: np.ndarray, *, seed: int = 0, round_: int | np.ndarray = 0
) -> LaneInputs:
    """Return the inputs of lanes.

    Args:
        scenarios: Stacked scenarios (S, ...), numpy.
        scenario: Each lane's scenario (n,), by its row.
        row: Each lane's target (n,).
        seed: For functions that draw.
        round_: Round of draws, one for all lanes or one each (n,).
    """
    row, scenario = np.asarray(row, np.int32), np.asarray(scenario)
    return LaneInputs(
        T_world_workpiece=scenarios.T_world_workpiece[scenario],
        interior_plane=scenarios.interior_plane[scenario],
        margin_m=scenarios.margin_m[scenario],
        tool_extension_m=scenarios.tool_extension_m[scenario],
        number=scenarios.number[scenario],
        target=scenarios.goals[scenario, row],
        row=row,
        round=np.full(row.shape, round_, np.int32),
        seed=np.full(row.shape, seed, np.int64),
        obstacle_numbers=None if (given := scenarios.obstacle_numbers) is None else given[scenario],
        max_joint_step=longest_joint_steps(scenarios, scenario, row),
    )


def longest_joint_steps(scenarios: Scenario, scenario: np.ndarray, row: np.ndarray) -> Float[np.ndarray, "n N"] | None:
    """Return the longest travel of each joint from the row before [rad or m]; None: any.

    On a segment with inserted goals that is each part's share of the bound. A search that adds up the travel on a
    segment may use more of it, see `planning.beam.joint_steps`.

    Args:
        scenarios: Stacked scenarios.
        scenario: Each lane's scenario (n,), by its row.
        row: Each lane's target (n,).
    """
    most, place = scenarios.max_joint_step, scenarios.place
    if most is None:
        return None
    share = 1.0 if place is None else np.where(row > 0, place[scenario, row] - place[scenario, row - 1], 1.0)[:, None]
    return most[scenario, row] * share
