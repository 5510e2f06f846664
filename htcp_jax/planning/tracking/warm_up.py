"""Calls of lane functions that engines make, to be compiled in parallel, see `Executor.preparing`."""

import numpy as np

from htcp_jax.motion import Problem, collision_checker, step_functions
from htcp_jax.planning.method import WarmUp
from htcp_jax.planning.tracking.lanes import new_lanes
from htcp_jax.planning.tracking.stages import ASCEND, DRAW, ENTER, PUSH, NullSpace, Recoveries


def warm_up_calls(problem: Problem, recoveries: Recoveries) -> WarmUp:
    """Return one call of each lane function, at the start of the first scenario to plan.

    The first calls are in the order of use, except that the longest compilation starts early. Those of the recoveries
    are for hard targets.
    """
    executor, one = problem.checkers[0].executor, problem.to_plan[:1]
    x = problem.scenarios.x_start[one]
    inputs, lanes = problem.inputs(one, 0), new_lanes(executor.sizes, one, np.zeros(1, int), x, x)
    x, state = lanes.x_ref, (inputs, lanes.x_ref, lanes.x_previous, lanes.linear)
    advance = step_functions.advance_of(problem.settings), inputs, x, x
    proof = [collision_checker.prove_call(problem.task, inputs, x, x)] if problem.check_paths else []
    if problem.settings.qp == "device":
        first = [advance, (step_functions.TRACK_CHUNK, *state, lanes.iteration), *proof]
    else:
        first = [advance, *proof, (step_functions.PREPARE, *state)]
    hard: list[tuple] = []
    for k, stage in enumerate(recoveries.stages):
        if isinstance(stage, NullSpace) and executor.freedom:
            steps = lanes.null_space_steps
            hard += [(stage.lane_function(k), inputs, x, x, steps, steps), (ENTER, inputs, x)]
        elif executor.freedom or not stage.in_null_space:
            hard += [(stage.lane_function(k), inputs, x)]
    if recoveries.keep_clear and executor.freedom:
        hard += [(ASCEND, inputs, x)]
    if recoveries.replan_backwards and problem.settings.restart_rounds > 0:
        hard += [(DRAW, inputs), (PUSH, inputs, x)]
    return WarmUp(first, hard)
