"""Calls of lane functions that engines will certainly make, to be compiled in parallel, see `Executor.preparing`."""

import numpy as np

from htcp_jax.motion import Problem, collision_checker, lane_inputs, step_functions
from htcp_jax.planning.tracking.lanes import new_lanes


def first_calls(problem: Problem) -> list[tuple]:
    """Return one call of each lane function, in the order of use, except that the longest compilation starts early."""
    executor, one, zero = problem.checkers[0].executor, problem.to_plan[:1], np.zeros(1, int)
    x, inputs = problem.scenarios.x_start[one], lane_inputs.lane_inputs(problem.scenarios, one, zero)
    lanes = new_lanes(executor.sizes, one, zero, x, x)
    state = inputs, lanes.x_ref, lanes.x_previous, lanes.linear
    advance = step_functions.advance_of(problem.settings), inputs, x, x
    proof = [collision_checker.prove_call(problem.task, inputs, x, x)] if problem.check_paths else []
    if problem.settings.qp == "device":
        return [advance, (step_functions.TRACK_CHUNK, *state, lanes.iteration), *proof]
    return [advance, *proof, (step_functions.PREPARE, *state)]
