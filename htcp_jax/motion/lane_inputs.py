"""Inputs of the lane functions: data of one lane, which is one row of a batch on the device."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from htcp_jax.model import Scenario


class LaneInputs(NamedTuple):
    """Inputs of one lane: its scenario's data and its target.

    Each lane carries its own copy, so executables do not depend on the number of scenarios.
    """

    T_world_workpiece: jax.Array  # this and the next four: see `Scenario`
    interior_plane: jax.Array
    margin_m: jax.Array
    tool_extension_m: jax.Array
    number: jax.Array
    target: jax.Array  # the task's goal at the target [m]
    row: jax.Array  # index of the target
    round: jax.Array  # number of the round of random draws
    seed: jax.Array  # random seed
    obstacle_numbers: jax.Array | None = None  # see `Scenario`
    max_joint_step: jax.Array | None = None  # maximum travel of each joint, see `longest_joint_steps`
    still: jax.Array | None = None  # True for joints that must not move, see `Problem.with_still_joints`; None: none


def lane_inputs(
    scenarios: Scenario, scenario: np.ndarray, row: np.ndarray, *, seed: int = 0, round_: int | np.ndarray = 0
) -> LaneInputs:
    """Return the inputs of lanes.

    Args:
        scenarios: Stacked scenarios (S, ...), numpy.
        scenario: Row of each lane's scenario (n,).
        row: Index of each lane's target (n,).
        seed: Random seed.
        round_: Number of the round of random draws: one for all lanes, or one per lane (n,).
    """
    row, scenario = np.asarray(row, np.int32), np.asarray(scenario)
    return LaneInputs(
        T_world_workpiece=scenarios.T_world_workpiece[scenario],
        interior_plane=scenarios.interior_plane[scenario],
        margin_m=scenarios.margins_to(scenario, row)[0],
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
    """Return the maximum travel of each joint from the previous target [rad or m]; None if it is unlimited.

    Each part of a segment with inserted goals gets its share of the maximum. A search that adds up the travel on a
    segment may allow more, see `planning.beam.tree`.

    Args:
        scenarios: Stacked scenarios.
        scenario: Row of each lane's scenario (n,).
        row: Index of each lane's target (n,).
    """
    most, place = scenarios.max_joint_step, scenarios.place
    if most is None:
        return None
    share = 1.0 if place is None else np.where(row > 0, place[scenario, row] - place[scenario, row - 1], 1.0)[:, None]
    return most[scenario, row] * share
