"""Base of the built-in methods that track targets by step QPs and try recovery stages when stuck."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.motion.plans import Plans
from htcp_jax.motion.problem import Problem
from htcp_jax.motion.tip_check import tip_checks
from htcp_jax.planning.tracking.candidates import Waiting
from htcp_jax.planning.tracking.engine import Engine
from htcp_jax.planning.tracking.first_calls import first_calls
from htcp_jax.planning.tracking.stages import Escapes
from htcp_jax.planning.tracking.work import Work
from htcp_jax.settings import Settings
from htcp_jax.solvers.clarabel_ import ClarabelSolver
from htcp_jax.solvers.qpsolvers_ import QPSolversSolver
from htcp_jax.solvers.step_qp import QPSolver, row_count


@dataclass(frozen=True)
class StepQPs(Escapes):
    """Step QPs along the path, equation (9), with these recovery stages. A `registry.Method`."""

    name: str  # in files and on the command line
    title: str
    description: str  # short description

    def first_calls(self, problem: Problem) -> list[tuple]:
        """Return the first kernel calls, see `Kernels.preparing`."""
        return first_calls(problem)

    def plan(self, problem: Problem) -> Plans:
        """Plan all scenarios. Raises InputError for a QP solver that is not installed.

        One engine per thread; all share the work, and write into different rows.
        """
        plans = problem.empty_plans()
        count = len(problem.scenarios.number)
        threads = min(problem.threads, count)
        work, waiting = Work(problem.to_plan.tolist(), threads), Waiting()
        kernels = problem.kernels  # made here, before there are threads
        tips = tip_checks(kernels, problem.tip_guard)

        def run(number: int) -> None:
            robot, settings = problem.robot, problem.settings
            task, (_, rows) = problem.task, kernels[0].sizes
            try:
                solver = make_solver(settings, len(robot.joint_names), row_count(settings, rows, task.bands), task.rows)
                own = number % len(kernels)
                scenarios, tip = problem.scenarios, tips[own]
                engine = Engine(kernels[own], solver, self, settings, scenarios, plans, work, waiting, tip)
                engine.run(problem.progress)
            finally:
                work.end()

        if threads == 1:
            run(0)
            return plans
        with ThreadPoolExecutor(threads) as pool:
            # Not `map`: if one fails it cancels those that have not begun, and the others would wait for them.
            for engine in [pool.submit(run, number) for number in range(threads)]:
                engine.result()
        return plans


def make_solver(settings: Settings, joints: int, rows: int, task_rows: int = 3) -> QPSolver | None:
    """Return the solver that `settings.qp` names; None for the one on the device, which the kernels call themselves.
    Raises InputError for a name that is not installed."""
    if settings.qp == "device":
        return None
    name, _, backend = settings.qp.partition(":")
    makers: dict[str, Callable[[], QPSolver]] = {
        "clarabel": lambda: ClarabelSolver(2 * np.asarray(settings.q_weights), rows, settings.qp_tolerance, task_rows),
        "qpsolvers": lambda: QPSolversSolver(backend),
    }
    if name not in makers:
        raise InputError(f"qp is {settings.qp!r}; valid: clarabel, device, qpsolvers:<name of a solver>")
    return makers[name]()
