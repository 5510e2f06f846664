"""Calls of lane functions that engines make, to be compiled in parallel, see `Executor.preparing`."""

import numpy as np

from htcp_jax.motion import Problem, collision_checker, lane_inputs, step_functions
from htcp_jax.planning.tracking.lanes import Lanes, new_lanes
from htcp_jax.planning.tracking.stages import ASCEND, DRAW, ENTER, PUSH, NullSpace, Recoveries


def first_calls(problem: Problem) -> list[tuple]:
    """Return one call of each lane function, in the order of use, except that the longest compilation starts early."""
    inputs, lanes = _one_lane(problem)
    x, state = lanes.x_ref, (inputs, lanes.x_ref, lanes.x_previous, lanes.linear)
    advance = step_functions.advance_of(problem.settings), inputs, x, x
    proof = [collision_checker.prove_call(problem.task, inputs, x, x)] if problem.check_paths else []
    if problem.settings.qp == "device":
        return [advance, (step_functions.TRACK_CHUNK, *state, lanes.iteration), *proof]
    return [advance, *proof, (step_functions.PREPARE, *state)]


def further_calls(problem: Problem, recoveries: Recoveries) -> list[tuple]:
    """Return one call of each lane function of the recoveries."""
    inputs, lanes = _one_lane(problem)
    x, freedom, calls = lanes.x_ref, problem.checkers[0].executor.freedom, []
    for k, stage in enumerate(recoveries.stages):
        if isinstance(stage, NullSpace) and freedom:
            steps = lanes.null_space_steps
            calls += [(stage.lane_function(k), inputs, x, x, steps, steps), (ENTER, inputs, x)]
        elif freedom or not stage.in_null_space:
            calls += [(stage.lane_function(k), inputs, x)]
    if recoveries.keep_clear and freedom:
        calls += [(ASCEND, inputs, x)]
    backwards = recoveries.replan_backwards and problem.settings.restart_rounds > 0
    return calls + ([(DRAW, inputs), (PUSH, inputs, x)] if backwards else [])


def _one_lane(problem: Problem) -> tuple[lane_inputs.LaneInputs, Lanes]:
    """Return a lane at the start of the first scenario to plan, and its inputs."""
    sizes, one = problem.checkers[0].executor.sizes, problem.to_plan[:1]
    x = problem.scenarios.x_start[one]
    return problem.inputs(int(one[0]), 0), new_lanes(sizes, one, np.zeros(1, int), x, x)
