"""The method that the built-in ones are kinds of: targets are tracked by step QPs, and what is stuck escapes."""

import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.planner.engine import Engine
from htcp_jax.planner.first_calls import first_calls
from htcp_jax.planner.plans import Plans
from htcp_jax.planner.problem import Problem
from htcp_jax.planner.stages import Escapes
from htcp_jax.planner.tip_check import tip_checks
from htcp_jax.settings import Settings
from htcp_jax.solvers.clarabel_ import ClarabelSolver
from htcp_jax.solvers.qpsolvers_ import QPSolversSolver
from htcp_jax.solvers.step_qp import QPSolver, row_count


@dataclass(frozen=True)
class StepQPs(Escapes):
    """Step QPs along the path, equation (8), with these escapes. A `registry.Method`."""

    name: str  # in files and on the command line
    title: str
    description: str  # what it does, in words

    def first_calls(self, problem: Problem) -> list[tuple]:
        """See `Kernels.prepare`."""
        return first_calls(problem)

    def plan(self, problem: Problem) -> Plans:
        """Plan all scenarios. Raises InputError for a QP solver that is not there.

        One engine a thread; all take scenarios from one iterator, their share at first, and write into different rows.
        """
        plans = problem.empty_plans()
        count = len(problem.scenarios.number)
        threads = min(problem.threads, count)
        share = -(-count // threads)
        # Neighbours in a grid are alike: dealt out in turn, every engine gets its part of the hard ones.
        refused = set(range(count)).difference(problem.to_plan.tolist())
        order = [k for first in range(threads) for k in range(first, count, threads) if k not in refused]
        handed_out = _Shared(order)
        kernels = problem.kernels  # made here, before there are threads
        tips = tip_checks(kernels, problem.tip_guard)

        def work(number: int) -> None:
            robot, settings = problem.robot, problem.settings
            task, (_, rows) = problem.task, kernels[0].sizes
            solver = make_solver(settings, len(robot.joint_names), row_count(settings, rows, task.bands), task.rows)
            own = number % len(kernels)
            engine = Engine(kernels[own], solver, self, settings, problem.scenarios, plans, share, tips[own])
            engine.run(handed_out, problem.progress)

        if threads == 1:
            work(0)
            return plans
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(work, range(threads)))
        return plans


class _Shared(Iterator[int]):
    """An iterator for many threads."""

    def __init__(self, values: Iterable[int]):
        self._values, self._lock = iter(values), threading.Lock()

    def __next__(self) -> int:
        with self._lock:
            return next(self._values)


def make_solver(settings: Settings, joints: int, rows: int, task_rows: int = 3) -> QPSolver | None:
    """The solver that `settings.qp` names; None for the one on the device, which the kernels call themselves. Raises
    InputError for a name that is not installed."""
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
