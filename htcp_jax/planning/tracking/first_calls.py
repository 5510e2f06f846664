"""Calls of lane functions that engines will certainly make, to be compiled in parallel, see `Kernels.preparing`."""

import numpy as np

from htcp_jax.motion.collision_checker import prove_call
from htcp_jax.motion.kernels import PREPARE, TRACK_BURST, advance_of
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.motion.problem import Problem
from htcp_jax.planning.tracking.lanes import new_lanes


def first_calls(problem: Problem) -> list[tuple]:
    """Return one call of each lane function, in the order of need; quick compilations do not delay the longest."""
    kernels, one, zero = problem.checkers[0].kernels, problem.to_plan[:1], np.zeros(1, int)
    x, inputs = problem.scenarios.x_start[one], lane_inputs(problem.scenarios, one, zero)
    lanes = new_lanes(kernels.sizes, one, zero, x, x)
    state = inputs, lanes.x_ref, lanes.x_previous, lanes.linear
    advance = advance_of(problem.settings), inputs, x, x
    proof = [prove_call(problem.task, inputs, x, x)] if problem.check_paths else []
    if problem.settings.qp == "device":
        return [advance, (TRACK_BURST, *state, lanes.iteration), *proof]
    return [advance, *proof, (PREPARE, *state)]
