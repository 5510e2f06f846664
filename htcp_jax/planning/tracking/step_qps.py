"""Base class of the built-in methods that track targets by step QPs and try recovery stages when stuck."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from htcp_jax import solvers
from htcp_jax.errors import InputError
from htcp_jax.motion import CollisionChecker, Plans, Problem, prove_call, step_functions
from htcp_jax.planning.method import Method, WarmUp
from htcp_jax.planning.tracking.engine import Engine
from htcp_jax.planning.tracking.lanes import Work, new_lanes
from htcp_jax.planning.tracking.stages import ASCEND, DRAW, ENTER, PUSH, NullSpace, Recoveries
from htcp_jax.settings import Settings
from htcp_jax.solvers import step_qp


@dataclass(frozen=True)
class StepQPs(Recoveries, Method):
    """Method that tracks the path by step QPs, equation (9), with recovery stages."""

    name: str  # name in files and on the command line
    title: str  # column heading in tables
    description: str  # short description

    def warm_up(self, problem: Problem) -> WarmUp:
        """Return one call of each lane function; those of the recoveries are for hard targets."""
        return warm_up_calls(problem, self)

    def plan(self, problem: Problem) -> Plans:
        """Plan all scenarios with one engine per thread; engines write into different rows of the plans.

        Raises:
            InputError: If the QP solver is not installed.
        """
        plans, count = problem.empty_plans(), len(problem.scenarios.number)
        threads = min(problem.threads, count)
        work = Work(problem.to_plan.tolist(), threads)

        def run(checker: CollisionChecker, _: slice) -> None:
            settings, task, (_, rows) = problem.settings, problem.task, checker.executor.sizes
            try:
                rows = step_qp.row_count(settings, rows, task.bands)
                solver = make_solver(settings, rows, task.rows)
                Engine(problem, checker, solver, self, plans, work).run()
            finally:
                work.end()

        problem.in_threads(run, threads)
        return plans


def make_solver(settings: Settings, rows: int, task_rows: int = 3) -> step_qp.QPSolver | None:
    """Return the solver named by `settings.qp`; None for the solver on the device, which lane functions call.

    Args:
        settings: `qp`, `qp_tolerance` and `q_weights`.
        rows: Number of inequality rows per step QP.
        task_rows: Number of the task's equality rows.

    Raises:
        InputError: If no solver of that name is installed.
    """
    if settings.qp == "device":
        return None
    name, _, backend = settings.qp.partition(":")
    makers: dict[str, Callable[[], step_qp.QPSolver]] = {
        "clarabel": lambda: solvers.ClarabelSolver(
            2 * step_qp.scaled_weights(settings.q_weights), rows, settings.qp_tolerance, task_rows
        ),
        "qpsolvers": lambda: solvers.QPSolversSolver(backend),
    }
    if name not in makers:
        raise InputError(f"qp is {settings.qp!r}; valid: clarabel, device, qpsolvers:<name of a solver>")
    return makers[name]()


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
    proof = [prove_call(problem.task, inputs, x, x)] if problem.check_paths else []
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
