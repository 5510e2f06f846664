"""Planning of a batch of scenarios with one method: the public function `plan`."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, wait
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from htcp_jax.caching import cache_folder
from htcp_jax.clearance import Obstacle, Obstacles, Scene, by_pieces, contacts, nearest_to, surface_points
from htcp_jax.clearance.obstacles import given_obstacle, of_workpiece, self_collision
from htcp_jax.device import devices as compute_devices
from htcp_jax.device import processes as worker_processes
from htcp_jax.device import tables
from htcp_jax.errors import InputError
from htcp_jax.model import Robot, Scenario, Task, Workpiece
from htcp_jax.model import robot as robots
from htcp_jax.model import scenario as scenario_functions
from htcp_jax.motion import Plans, Problem, lane_inputs, start_cause
from htcp_jax.planning import registry
from htcp_jax.planning.method import Method
from htcp_jax.planning.registry import find
from htcp_jax.settings import Settings, settings_of
from htcp_jax.spec import obstacle_kind
from htcp_jax.status import Status

INTERIOR_RULE = (  # after the name of the part, where not its points but the rule decides
    ", by the interior rule: deeper than workpiece.interior_depth_m behind the inlet a body must be in the part's "
    "hull; move it, or set workpiece.interior: none"
)

REPORT_S = 0.2  # interval at which progress is reported while executables are compiled


class Progress(NamedTuple):
    """Progress of planning: the numbers of finished scenarios and tracked targets so far, and of all of them."""

    scenarios_done: int
    scenarios: int
    targets_tracked: int
    targets: int


def plan(
    robot: Robot,
    workpiece: Workpiece,
    scenarios: Scenario | Sequence[Scenario],
    method: str | Method = "beam",
    settings: Settings | Mapping[str, Any] | None = None,
    *,
    progress: Callable[[Progress], None] | None = None,
    device: str | None = None,
    threads: int | None = None,
    check_paths: bool = True,
    task: Task | None = None,
    obstacles: Sequence[Obstacle | obstacle_kind.ObstacleKind] = (),
    check_starts: bool = False,
    processes: int | None = None,
    targets_in_all: int | None = None,
    compiled_first: Sequence[str] = (),
) -> Plans:
    """Plan every scenario with one method.

    Results depend neither on `threads` nor on `processes`.

    Args:
        robot: The arm with its tool.
        workpiece: The part that the scenarios place.
        scenarios: One or several scenarios from `make_scenario`, or stacked scenarios.
        method: Name of the method, see `registry`, or the method itself.
        settings: Settings, or a mapping such as {"alpha_rad": 0.05} that changes the defaults.
        progress: Function that is called with the `Progress` when it changes.
        device: `cpu`, `gpu` or `gpu:2`; None: all GPUs if there are any, else the CPU.
        targets_in_all: Number of targets of all calls that belong together, such as the shards of a sweep; None: of
            this call. It determines whether several processes are used.
        threads: Number of engines per process; None: one, or one per core if there is only one process.
        check_paths: Afterwards check the straight joint path (`Plans.path_clear`) of every accepted step that the
            method did not check itself, verify the motion of every segment, and smooth the motions if `settings.smooth`
            or the method requires it.
        task: The constraints at every target; None: the TCP's position within `tolerance_m`.
        obstacles: Obstacles in addition to the workpiece, see `obstacle.Obstacle`.
        check_starts: True to raise an error for a start in collision, which otherwise gets a status.
        processes: Number of processes that share the scenarios on a CPU; None: see
            `processes.profitable_count`. Work that other processes cannot import, for example a method or an obstacle
            defined in a notebook, is planned in this one.
        compiled_first: Names of methods that will plan such scenarios. Their executables are compiled before this plan,
            in parallel, see `Method.further_calls`.

    Returns:
        The plans, one row per scenario.

    Raises:
        InputError: For an unknown method, device or setting, weights of the wrong length, no scenarios, a task with
            more rows than joints or that does not match the columns of the targets, fewer than one process, and, with
            `check_starts`, a start in collision.
        Lost: If a process is ended from outside.
    """
    chosen, settings = method if isinstance(method, Method) else find(method), settings_of(settings)
    method = chosen.name
    joints = len(robot.joint_names)
    for name in ("q_weights", "path_weights", "max_joint_step_rad"):
        weights = getattr(settings, name)
        if isinstance(weights, tuple) and len(weights) != joints:
            raise InputError(f"{name} has {len(weights)} values, but the robot {robot.name} has {joints} joints")
    if settings.qp.startswith("qpsolvers:"):  # refuse one that is not installed, even if the method does not use it
        from htcp_jax.solvers import QPSolversSolver

        QPSolversSolver(settings.qp.partition(":")[2])
    if not isinstance(scenarios, Scenario):
        scenarios = scenario_functions.stack(scenarios)
    elif scenarios.x_start.ndim == 1:
        scenarios = scenario_functions.stack([scenarios])
    obstacles, scenarios = given_obstacle.with_given(obstacles, jax.tree.map(np.asarray, scenarios))
    scenarios = _with_refused(robot, obstacles, scenarios, check_starts)
    task = Task(tolerance_m=settings.tolerance_m) if task is None else task
    _check_task(task, robot, scenarios)
    devices = compute_devices.choose(device)
    cores = compute_devices.default_threads(devices, settings.qp)
    if processes is None:
        targets = targets_in_all or int(scenarios.count.sum())
        processes = 1 if threads else worker_processes.profitable_count(cores, len(scenarios.number), targets)
    if processes < 1:
        raise InputError(f"processes is {processes}; it must be 1 or more")
    began = time.perf_counter()

    def problem_of() -> Problem:
        limited = scenario_functions.with_max_joint_step(scenarios, settings.max_joint_step_rad)
        return Problem(
            robot,
            workpiece,
            limited,
            settings,
            task,
            of_workpiece.all_obstacles(workpiece, obstacles),
            devices,
            threads or cores,
            check_paths,
            _counter(limited, progress),
        )

    if processes > 1 and devices[0].platform == "cpu" and registry.METHODS.is_shared(chosen):
        how = {"method": method, "settings": settings, "threads": threads or 1, "task": task}
        how |= {"check_paths": check_paths, "check_starts": check_starts}
        shared = worker_processes.portable(robot, workpiece, tuple(obstacles))
        if shared and worker_processes.portable(how):
            compile_s = 0.0
            if compiled_first and cache_folder.folder():  # the other processes load what this one stores
                with compute_devices.on(devices[0]):
                    compile_s = _compile(problem_of(), compiled_first)
            plans = _spread(processes, how, shared, scenarios, progress)
            return plans._replace(compile_s=plans.compile_s + compile_s)
    with compute_devices.on(devices[0]):
        problem = problem_of()
        plans = _planned_here(problem, chosen, method, obstacles, check_starts, compiled_first)
    spent = time.perf_counter() - began
    compile_s = plans.compile_s + max(each.executor.compile_s for each in problem.checkers)
    return plans._replace(compile_s=compile_s, run_s=spent - compile_s)


def _compile(problem: Problem, methods: Sequence[str]) -> float:
    """Compile the executables of methods on all cores, and return the time that this takes [s]."""
    if not (methods and len(problem.to_plan)):
        return 0.0
    began, chosen = time.perf_counter(), [find(name) for name in methods]
    further = {call[0]: call for method in chosen for call in method.further_calls(problem)}
    calls = further | {call[0]: call for method in chosen for call in method.first_calls(problem)}
    with _preparing(problem, list(calls.values())) as compilations:
        while wait(compilations, REPORT_S).not_done:
            problem.progress(0, 0)
    return time.perf_counter() - began


def _planned_here(
    problem: Problem,
    chosen: Method,
    method: str,
    obstacles: Obstacles,
    check_starts: bool,
    compiled_first: Sequence[str],
) -> Plans:
    """Return the result of `plan`, planned on the problem's devices in this process.

    Of the times, it has only that of `compiled_first`.
    """
    # Imported here, as methods are: no lane functions are loaded before a method is looked up.
    from htcp_jax.planning import repeated_targets

    def plan_places(problem: Problem) -> Plans:
        return _planned_places(problem, chosen, method, obstacles, check_starts, compiled_first)

    distinct = repeated_targets.are_distinct(problem.scenarios, problem.task)
    return plan_places(problem) if distinct.all() else repeated_targets.planned(plan_places, problem, distinct)


def _planned_places(
    problem: Problem,
    chosen: Method,
    method: str,
    obstacles: Obstacles,
    check_starts: bool,
    compiled_first: Sequence[str],
) -> Plans:
    """Return the result of `_planned_here` for a problem without repeated targets."""
    from htcp_jax.motion import home as home_motion
    from htcp_jax.planning import inserted_goals

    with _preparing(problem, chosen.first_calls(problem) if len(problem.to_plan) else ()) as compilations:
        if check_starts:
            _check_starts(problem, obstacles, compilations)
        problem, from_home = home_motion.leave_home(problem)
        if check_starts:
            _refuse_standing_overlaps(problem)
        compile_s = _compile(problem, compiled_first)  # now it is known whether any scenario has a start
        pieces = inserted_goals.pieces_of(problem.robot, problem.task, problem.scenarios, problem.settings)

        def plan_rows(denser: Problem, rows: np.ndarray) -> Plans:
            own = {k: from_home[s] for k, s in enumerate(rows.tolist()) if s in from_home}
            return _with_proofs(denser, chosen, method, own)

        if (pieces == 1).all():
            plans = _with_proofs(problem, chosen, method, from_home)
        else:
            plans = inserted_goals.planned(plan_rows, problem, pieces)
        return plans._replace(compile_s=plans.compile_s + compile_s)


def _with_proofs(problem: Problem, chosen: Method, method: str, from_home: Mapping[int, np.ndarray]) -> Plans:
    """Return the plans from home, verified and smoothed."""
    from htcp_jax.motion import home as home_motion
    from htcp_jax.motion import motion_check
    from htcp_jax.planning.tracking.record import with_separate_errors

    settings, check_paths = problem.settings, problem.check_paths
    plans = _of_these(chosen.plan(problem), problem, method)
    problem = problem.as_planned(plans)
    if check_paths:
        plans = motion_check.check_remaining_paths(problem, plans)
    plans = home_motion.begin_at_home(problem, plans, from_home)
    if check_paths:
        plans = motion_check.verify_motions(problem, plans)
        if chosen.smooth if settings.smooth is None else settings.smooth:
            from htcp_jax.motion import smoothing

            plans = motion_check.tighten(
                problem, motion_check.verify_motions(problem, smoothing.smooth(problem, plans))
            )
    return with_separate_errors(problem, plans)


def _spread(processes: int, how: dict, shared: bytes, scenarios: Scenario, progress: Callable | None) -> Plans:
    """Return plans from other processes; `compile_s` is the time to start these plus their mean compilation time."""
    began = time.perf_counter()
    rows = worker_processes.shares(len(scenarios.number), processes)
    parts = [tables.gather(scenarios, own) for own in rows]

    def report(reported: np.ndarray) -> None:
        done, tracked = reported.sum(axis=0).tolist()
        progress(Progress(done, len(scenarios.number), tracked, int(scenarios.count.sum())))

    call, ready = partial(_plan_part, how), partial(find, how["method"])
    found, start_s = worker_processes.spread(processes, call, shared, parts, progress and report, ready)
    plans = Plans.concatenate(found).rows(np.argsort(np.concatenate(rows)))
    compile_s = start_s + plans.compile_s / min(processes, len(parts))
    return plans._replace(compile_s=compile_s, run_s=time.perf_counter() - began - compile_s)


def _plan_part(
    how: dict, notify: Callable, robot: Robot, workpiece: Workpiece, obstacles: Obstacles, scenarios: Scenario
) -> Plans:
    """Plan some scenarios in another process."""
    notify(int((scenarios.refused != scenario_functions.NOT_REFUSED).sum()), 0)

    def progress(now: Progress) -> None:
        notify(now.scenarios_done, now.targets_tracked)

    return plan(robot, workpiece, scenarios, obstacles=obstacles, progress=progress, processes=1, **how)


def start_clearance(
    robot: Robot,
    workpiece: Workpiece,
    scenario: Scenario,
    x: Float[np.ndarray, "N"] | None = None,
    obstacles: Obstacles = (),
) -> tuple[float, str, str]:
    """Return the clearance D [m] at the scenario's start, the name of the body, and the obstacle nearest to it.

    Args:
        robot: The arm with its tool.
        workpiece: The part.
        scenario: Start, pose of the workpiece, and tool extension.
        x: Configuration to measure instead of the start [rad or m].
        obstacles: In addition to the workpiece.
    """
    return _start_contact(robot, workpiece, scenario, x, obstacles)[:3]


def _start_contact(
    robot: Robot,
    workpiece: Workpiece,
    scenario: Scenario,
    x: Float[np.ndarray, "N"] | None,
    obstacles: Obstacles,
    fixed_first: bool = False,
) -> tuple[float, str, str, bool]:
    """Return the result of `start_clearance`, and True if the body is fixed in the world.

    With `fixed_first`, if any fixed body overlaps an obstacle, the result is for the fixed body with the deepest
    overlap.
    """
    scenario = jax.tree.map(jnp.asarray, scenario)
    x = scenario.x_start if x is None else jnp.asarray(x)
    scene = Scene(
        robots.lengthen_tool(robot, scenario.tool_extension_m), of_workpiece.all_obstacles(workpiece, obstacles)
    )
    touch = jax.jit(contacts)(scene.robot, scene.obstacles, scenario, x)
    distance, fixed = np.asarray(touch.distance), np.array(robot.capsule_link)[np.array(scene.rows.body)] < 0
    if fixed_first and (fixed & (distance <= 0)).any():
        distance = np.where(fixed, distance, np.inf)
    row = int(distance.argmin())
    body = scene.rows.body[row]
    surface = np.asarray(surface_points(scene.robot, scene.rows, touch)[row])
    points = np.stack([surface, surface - np.asarray(distance[row] * touch.normal[row])])
    by_piece = bool(by_pieces(scene.robot, scene.rows, touch)[row])
    other = nearest_to(scene.robot, scene.obstacles, scenario, x, row)
    note = robots.mesh_note(scene.robot, robot.capsule_names[body], other, np.asarray(x), points, by_piece)
    other += INTERIOR_RULE if bool(touch.by_interior_rule[row]) else ""
    label = robots.capsule_label(robot, robot.capsule_names[body])
    return float(touch.distance[row]), label, other + note, bool(fixed[row])


def check_start(robot: Robot, workpiece: Workpiece, scenario: Scenario, obstacles: Obstacles = ()) -> None:
    """Check that neither the home nor the start is in collision.

    Args:
        robot: The arm with its tool.
        workpiece: The part.
        scenario: Home, start, pose of the workpiece, and tool extension.
        obstacles: In addition to the workpiece.

    Raises:
        InputError: If the home or the start is in collision; the message names the body, the obstacle and the depth.
    """
    for what, x in _begins_at(scenario).items():
        D, body, other, fixed = _start_contact(robot, workpiece, scenario, x, obstacles, fixed_first=True)
        if D <= 0:
            always = ", in every configuration, because neither moves" if fixed else ""
            place = scenario_functions.without_pose(scenario.T_world_workpiece) if "workpiece" in other else ""
            raise InputError(f"{place}{what} is in collision: {body} is {-1e3 * D:.3f} mm inside {other}{always}")


def _begins_at(scenario: Scenario) -> dict[str, Float[np.ndarray, "N"]]:
    """Return the configurations that must be clear before planning (home, start), by name."""
    if scenario.begins_anywhere:
        return {}
    start = {"start": scenario.x_start}
    if scenario.auto_start or (scenario.x_home != scenario.x_start).any():
        return {"home": scenario.x_home} | ({} if scenario.auto_start else start)
    return start


@contextmanager
def _preparing(problem: Problem, calls: Sequence[tuple]) -> Iterator[list[Future]]:
    """Compile the executables of calls while the context is open; its value is the compilations."""
    with ExitStack() as stack:
        begun = [stack.enter_context(each.executor.preparing(calls)) for each in (problem.checkers if calls else ())]
        yield [compilation for own in begun for compilation in own]


def _check_starts(problem: Problem, obstacles: Obstacles, compilations: Sequence[Future]) -> None:
    """Call `check_start` for every scenario whose start collides, after cancelling the compilations.

    These scenarios are found by an executable that planning needs anyway.
    """
    for s in problem.to_plan.tolist():
        one = jax.tree.map(lambda leaf, s=s: leaf[s], problem.scenarios)
        inputs = lane_inputs.lane_inputs(problem.scenarios, np.array([s]), np.zeros(1, int))
        for x in _begins_at(one).values():
            if problem.checkers[0].states(inputs, x[None]).clearance[0] <= 0:
                for each in compilations:
                    each.cancel()
                check_start(problem.robot, problem.workpiece, one, obstacles)


def _refuse_standing_overlaps(problem: Problem) -> None:
    """Check that no scenario without a start has an overlap in every configuration.

    Raises:
        InputError: If a scenario has such an overlap; the message names the bodies and the depth.
    """
    for s in np.flatnonzero(problem.scenarios.refused == Status.NO_START).tolist():
        if (found := start_cause.standing_overlap(problem, s)) is not None:
            place = found.place(problem.scenarios.T_world_workpiece[s])
            raise InputError(f"{place}no start exists: {found.description}")


def _with_refused(robot: Robot, obstacles: Obstacles, scenarios: Scenario, raises: bool) -> Scenario:
    """Return the scenarios with those refused that begin with an overlap of excluded capsules, see `refused_pair`.

    Raises:
        InputError: If there is such a scenario and `raises` is True.
    """
    refused = scenarios.refused.copy()
    for own in (each for each in obstacles if isinstance(each, self_collision.SelfCollision)):
        known: dict[bytes, self_collision.RefusedPair | None] = {}
        for s in np.flatnonzero(refused == scenario_functions.NOT_REFUSED):
            for what, x in _begins_at(jax.tree.map(lambda leaf, s=s: leaf[s], scenarios)).items():
                if x.tobytes() not in known:
                    known[x.tobytes()] = self_collision.refused_pair(own, robot, x)
                if (pair := known[x.tobytes()]) is None:
                    continue
                if raises:
                    raise InputError(f"{what} is in collision: {pair.reason}")
                home = what == "home"
                refused[s] = Status.HOME_IN_COLLISION if home else Status.START_IN_COLLISION
    return replace(scenarios, refused=refused)


def _check_task(task: Task, robot: Robot, scenarios: Scenario) -> None:
    task.freedom(robot)
    if scenarios.task_goals is None and (given := scenarios.targets.shape[-1]) != task.rows:
        raise InputError(f"the task has {task.rows} equations, but the targets have {given} numbers")
    if scenarios.task_goals is not None and (given := scenarios.task_goals.shape[-1]) != task.numbers:
        raise InputError(f"the task needs {task.numbers} numbers at each target, but the goals have {given}")


def _counter(scenarios: Scenario, progress: Callable[[Progress], None] | None) -> Callable[[int, int], None]:
    """Return a function that adds counts of newly tracked targets and finished scenarios, and reports the totals.

    It may be called on any thread.
    """
    if progress is None:
        return lambda tracked, finished: None
    lock = threading.Lock()
    now = Progress(
        int((scenarios.refused != scenario_functions.NOT_REFUSED).sum()),
        len(scenarios.number),
        0,
        int(scenarios.count.sum()),
    )

    def add(tracked: int, finished: int) -> None:
        nonlocal now
        with lock:
            now = now._replace(
                scenarios_done=now.scenarios_done + finished, targets_tracked=now.targets_tracked + tracked
            )
            progress(now)

    return add


def _of_these(plans: Any, problem: Problem, method: str) -> Plans:
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


__all__ = ["Progress", "check_start", "plan", "start_clearance"]
