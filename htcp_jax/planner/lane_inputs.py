"""What a lane brings along to every kernel."""

from typing import NamedTuple

import jax
import numpy as np

from htcp_jax.scene.scenario import Scenario


class LaneInputs(NamedTuple):
    """What one lane is about: its scenario's surroundings, and which target. A lane brings all of it
    along, so the compiled programs know nothing of how many scenarios there are."""

    T_world_workpiece: jax.Array
    gate: jax.Array
    margin_m: jax.Array
    tool_extension_m: jax.Array
    number: jax.Array
    target: jax.Array  # [m]
    row: jax.Array  # of the target
    round: jax.Array  # of draws


def lane_inputs(scenarios: Scenario, scenario: np.ndarray, row: np.ndarray, round_: int = 0) -> LaneInputs:
    """What lanes are about that are at target `row` of their `scenario`; scenarios are stacked, numpy."""
    row, scenario = np.asarray(row, np.int32), np.asarray(scenario)
    own = [
        getattr(scenarios, name)[scenario]
        for name in ("T_world_workpiece", "gate", "margin_m", "tool_extension_m", "number")
    ]
    return LaneInputs(*own, scenarios.targets[scenario, row], row, np.full_like(row, round_))
