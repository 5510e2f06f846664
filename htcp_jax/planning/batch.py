"""Planning of a batch of scenarios with one method: the public function `plan`."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, wait
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int

from htcp_jax.caching import cache_folder
from htcp_jax.device import devices as compute_devices
from htcp_jax.device import processes as worker_processes
from htcp_jax.device import tables
from htcp_jax.errors import InputError
from htcp_jax.model import Scenario
from htcp_jax.model import scenario as scenario_functions
from htcp_jax.motion import Plans, Problem, begin_at_home, leave_home, most_draws, motion_check, smoothing, start_cause
from htcp_jax.planning import inserted_goals, methods, repeated_targets
from htcp_jax.planning.method import Method
from htcp_jax.planning.tracking.record import with_separate_errors
from htcp_jax.status import Status

REPORT_S = 0.2  # interval at which progress is reported while executables are compiled


class Progress(NamedTuple):
    """Progress of planning: the numbers of finished scenarios and tracked targets so far, and of all of them."""

    scenarios_done: int
    scenarios: int
    targets_tracked: int
    targets: int
    starts: int | None = None  # number of starts chosen, and joined to home, so far; None before the first attempt
    draws: tuple[int, int] = (0, 0)  # configurations drawn to find starts, so far and at most
    phase: str = ""  # text about the part of the work, such as "; seams from home: 1 of 4 plans ended"
    unit: str = "targets"  # what is counted as targets: these, or "air moves" between seams


def plan(problem: Problem, method: str | Method = "beam", progress: Callable[[Progress], None] | None = None) -> Plans:
    """Plan every scenario of a problem with one method.

    Results depend neither on the number of threads nor on that of processes.

    Args:
        problem: The problem, see `Problem.of`.
        method: Name of the method, see `registry`, or the method itself.
        progress: Function that is called with the `Progress` when it changes.

    Returns:
        The plans, one row per scenario.

    Raises:
        InputError: For an unknown method, and, with `problem.check_starts`, a start in collision.
        Lost: If a process is ended from outside.
    """
    chosen = method if isinstance(method, Method) else methods.find(method)
    if problem.robot.indexed and not chosen.plans_indexed:
        axes = ", ".join(sorted(problem.robot.indexed))
        raise InputError(f"indexed axes ({axes}) need the method beam; {chosen.name} moves every joint along a seam")
    problem = problem.with_scenarios(problem.scenarios, _counter(problem.scenarios, progress))
    with compute_devices.on(problem.devices[0]):
        if problem.processes > 1 and methods.is_shared(chosen) and (shared := _shared_part(problem)):
            return _spread(problem, chosen, shared, progress)
        began, began_cpu, waited_s = time.perf_counter(), time.process_time(), _waited_s(problem)
        plans = repeated_targets.planned(partial(_planned_places, chosen), problem)
        compile_s = plans.compile_s + _waited_s(problem) - waited_s
        spent = problem.prepared_s + time.perf_counter() - began
        cpu_s = time.process_time() - began_cpu - plans.cpu_s
        return plans._replace(compile_s=compile_s, run_s=spent - compile_s, cpu_s=cpu_s)


def _planned_places(method: Method, problem: Problem) -> Plans:
    """Return the plans of a problem without repeated targets; their times are those of `Execution.warm_up`."""
    calls = _warm_up_calls(problem) or (method.warm_up(problem).first if len(problem.to_plan) else ())
    with _compiling(problem, calls) as compilations:
        if problem.check_starts:
            start_cause.check_starts(problem, compilations)
        problem, from_home = leave_home(problem)
        if problem.check_starts:
            start_cause.refuse_standing_overlaps(problem)
        compile_s, cpu_s = _wait_until_compiled(problem, compilations) if problem.execution.warm_up else (0.0, 0.0)
        plans = inserted_goals.planned(partial(_planned_rows, method, from_home), problem)
        return plans._replace(compile_s=plans.compile_s + compile_s, cpu_s=cpu_s)


def _planned_rows(
    method: Method, from_home: Mapping[int, np.ndarray], problem: Problem, rows: Int[np.ndarray, "_"]
) -> Plans:
    """Return the plans of some scenarios from home, verified and smoothed.

    Args:
        method: The method.
        from_home: The via points from home, by row of all scenarios.
        problem: The problem of the scenarios.
        rows: Their rows.
    """
    from_home = {k: from_home[s] for k, s in enumerate(rows.tolist()) if s in from_home}
    smooths = problem.check_paths and (method.smooth if problem.settings.smooth is None else problem.settings.smooth)
    unfinished = problem.with_scenarios(problem.scenarios, lambda tracked, *_: problem.progress(tracked, 0))
    plans = _checked_plans(method.plan(unfinished if smooths else problem), problem, method.name)
    problem = problem.as_planned(plans)
    if problem.check_paths:
        plans = motion_check.check_remaining_paths(problem, plans)
    plans = begin_at_home(problem, plans, from_home)
    if problem.check_paths:
        plans = motion_check.verify_motions(problem, plans)
    if smooths:
        smoothed = motion_check.verify_motions(problem, smoothing.smooth(problem, plans))
        plans = motion_check.raise_air_moves(problem, motion_check.tighten(problem, smoothed))
    return with_separate_errors(problem, plans)


@contextmanager
def _compiling(problem: Problem, calls: Sequence[tuple]) -> Iterator[list[Future]]:
    """Compile the executables of calls while the context is open; its value is the compilations."""
    with ExitStack() as stack:
        begun = [stack.enter_context(each.executor.preparing(calls)) for each in (problem.checkers if calls else ())]
        yield [compilation for own in begun for compilation in own]


def _warm_up_calls(problem: Problem) -> list[tuple]:
    """Return one call of each lane function of the methods in `Execution.warm_up`; those for hard targets first."""
    found = [methods.find(name).warm_up(problem) for name in problem.execution.warm_up if len(problem.to_plan)]
    calls = {call[0]: call for each in found for call in each.hard}
    return list((calls | {call[0]: call for each in found for call in each.first}).values())


def _wait_until_compiled(problem: Problem, compilations: Sequence[Future]) -> tuple[float, float]:
    """Wait for compilations, unless no scenario has a start; return the wall and processor time it takes [s]."""
    began, began_cpu = time.perf_counter(), time.process_time()
    if not len(problem.to_plan):
        for each in compilations:
            each.cancel()
    while wait(compilations, REPORT_S).not_done:
        problem.progress(0, 0)
    return time.perf_counter() - began, time.process_time() - began_cpu


def _waited_s(problem: Problem) -> float:
    """Return the time that the problem's executors have waited for executables [s]."""
    return max(each.executor.compile_s for each in problem.checkers)


def _shared_part(problem: Problem) -> bytes | None:
    """Return what all scenarios share, pickled for other processes; None if those cannot load it."""
    execution = replace(problem.execution, device=None, processes=1)
    if problem.devices[0].platform == "cpu":  # its executables are warmed up here, on all cores
        execution = replace(execution, threads=execution.threads or 1, warm_up=())
    how = {"execution": execution, "check_paths": problem.check_paths, "check_starts": problem.check_starts}
    given = problem.robot, problem.workpiece, problem.settings, problem.task, problem.other_obstacles
    return worker_processes.portable(given, how)


def _spread(problem: Problem, method: Method, shared: bytes, progress: Callable | None) -> Plans:
    """Return plans from other processes; `compile_s` is the time to start these plus their mean compilation time."""
    scenarios, on_cpu, warm_up_s = problem.scenarios, problem.devices[0].platform == "cpu", 0.0
    if on_cpu and cache_folder.folder():  # the other processes load what this one stores
        with _compiling(problem, _warm_up_calls(problem)) as compilations:
            warm_up_s, _ = _wait_until_compiled(problem, compilations)
    began, began_cpu, count, workers = time.perf_counter(), time.process_time(), len(scenarios.number), problem.workers
    # a GPU is faster with one large part
    rows = worker_processes.shares(count, len(workers), worker_processes.MOST_TOGETHER if on_cpu else count)
    parts = [tables.gather(scenarios, own) for own in rows]

    def report(reported: np.ndarray) -> None:
        done, tracked, starts = reported.sum(axis=0).tolist()
        progress(Progress(done, count, tracked, int(scenarios.count.sum()), starts or None))

    call, ready = partial(_plan_part, method.name), partial(methods.find, method.name)
    found, start_s = worker_processes.spread(workers, call, shared, parts, progress and report, ready)
    plans = Plans.concatenate(found).rows(np.argsort(np.concatenate(rows)))
    compile_s = start_s + plans.compile_s / min(len(workers), len(parts))
    run_s, cpu_s = time.perf_counter() - began - compile_s, plans.cpu_s + time.process_time() - began_cpu
    return plans._replace(compile_s=compile_s + warm_up_s, run_s=run_s, cpu_s=cpu_s)


def _plan_part(method: str, notify: Callable, given: tuple, how: dict[str, Any], scenarios: Scenario) -> Plans:
    """Plan some scenarios in another process."""
    notify(int((scenarios.refused != scenario_functions.NOT_REFUSED).sum()), 0, 0)

    def progress(now: Progress) -> None:
        notify(now.scenarios_done, now.targets_tracked, now.starts or 0)

    robot, workpiece, *others = given
    return plan(Problem(robot, workpiece, scenarios, *others, **how), method, progress)


def _counter(scenarios: Scenario, progress: Callable[[Progress], None] | None) -> Callable[..., None]:
    """Return a function that adds counts of newly tracked targets and finished scenarios, and reports the totals.

    Its third argument, optional, counts newly chosen starts, and its fourth one configurations drawn to find starts. It
    may be called on any thread.
    """
    if progress is None:
        return lambda tracked, finished, begun=None, drawn=0: None
    lock = threading.Lock()
    now = Progress(
        int((scenarios.refused != scenario_functions.NOT_REFUSED).sum()),
        len(scenarios.number),
        0,
        int(scenarios.count.sum()),
        draws=(0, most_draws(scenarios)),
    )

    def add(tracked: int, finished: int, begun: int | None = None, drawn: int = 0) -> None:
        nonlocal now
        with lock:
            now = now._replace(
                scenarios_done=now.scenarios_done + finished,
                targets_tracked=now.targets_tracked + tracked,
                starts=now.starts if begun is None else (now.starts or 0) + begun,
                draws=(now.draws[0] + drawn, now.draws[1]),
            )
            progress(now)

    return add


def _checked_plans(plans: Any, problem: Problem, method: str) -> Plans:
    """Return the plans unchanged.

    Raises:
        InputError: If their shapes are not those of the problem's scenarios and targets, or a required column is empty.
    """
    expected = problem.scenarios.targets.shape[:2]
    shapes = {each.shape[:2] for each in (plans.status, plans.x, plans.target)} if isinstance(plans, Plans) else set()
    if shapes != {expected}:
        raise InputError(f"method {method!r} must return Plans of {expected[0]} scenarios with {expected[1]} targets")
    for column in ("x", "tcp", "clearance", "residual"):
        if np.isnan(getattr(plans, column)[plans.tracked]).any():
            raise InputError(f"method {method!r} returned NaN in {column} of a tracked target")
    if (plans.status[problem.to_plan, 0] == Status.NOT_ATTEMPTED).any():
        raise InputError(f"method {method!r} did not set the status of target 0; it must be TRACKED or a failure")
    return plans


__all__ = ["Progress", "plan"]
