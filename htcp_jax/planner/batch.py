"""The public call: plan a batch of scenarios with one method."""

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance.obstacles import clearances
from htcp_jax.clearance.of_workpiece import make_obstacle
from htcp_jax.clearance.scene import Scene, own_scene
from htcp_jax.errors import InputError
from htcp_jax.planner.devices import choose, default_threads
from htcp_jax.planner.engine import EMPTY, Engine
from htcp_jax.planner.lane_inputs import lane_inputs
from htcp_jax.planner.methods import METHODS
from htcp_jax.planner.plans import Plans
from htcp_jax.planner.programs import Kernels
from htcp_jax.planner.tip_check import TipCheck, tip_checks
from htcp_jax.scene.robot import Robot
from htcp_jax.scene.scenario import NOT_REFUSED, Scenario, stack
from htcp_jax.scene.task import Task
from htcp_jax.scene.workpiece import Workpiece
from htcp_jax.settings import Settings, settings_of
from htcp_jax.solvers.by_name import make_solver
from htcp_jax.solvers.step_qp import row_count


class Progress(NamedTuple):
    """How far a plan has come: all counts are totals."""

    scenarios_done: int
    scenarios: int
    targets_tracked: int
    targets: int


def plan(
    robot: Robot,
    workpiece: Workpiece,
    scenarios: Scenario | Sequence[Scenario],
    method: str = "nspace-sqp",
    settings: Settings | Mapping[str, Any] | None = None,
    *,
    progress: Callable[[Progress], None] | None = None,
    device: str | None = None,
    threads: int | None = None,
    check_paths: bool = True,
) -> Plans:
    """Plan every scenario with one method (see `METHODS`).

    scenarios: from `make_scenario`, one or many, or stacked already. settings: a mapping, {"alpha_rad": 0.05}, changes
    the defaults. device: see `devices.choose`. threads: engines that share the scenarios, by default one a core;
    results do not depend on it. check_paths: afterwards measure, for every accepted step that the method did not check
    itself, whether its straight joint path is clear (`Plans.path_clear`).
    Raises InputError for an unknown method, device or setting, for weights of the wrong length, and for no scenarios.
    """
    settings = settings_of(settings)
    if method not in METHODS:
        raise InputError(f"unknown method {method!r}; valid: {', '.join(METHODS)}")
    joints = len(robot.joint_names)
    if len(settings.q_weights) != joints:
        raise InputError(f"q_weights has {len(settings.q_weights)} values, the robot {robot.name} has {joints} joints")
    if not isinstance(scenarios, Scenario):
        scenarios = stack(scenarios)
    elif scenarios.x_start.ndim == 1:
        scenarios = stack([scenarios])
    scenarios = jax.tree.map(np.asarray, scenarios)
    began = time.perf_counter()
    devices = choose(device)
    scene = Scene(robot, make_obstacle(workpiece), Task(tolerance_m=settings.tolerance_m))
    kernels = [Kernels(scene, METHODS[method], settings, device) for device in devices]
    tips = tip_checks(kernels, workpiece)
    plans = _empty_plans(scenarios.targets, joints)
    threads = threads or default_threads(devices, settings.qp)
    _run_engines(kernels, tips, robot, method, settings, scenarios, plans, threads, progress)
    if check_paths:
        _check_remaining_paths(kernels, tips, scenarios, plans, threads)
    spent = time.perf_counter() - began
    compile_s = sum(each.compile_s for each in kernels)
    return plans._replace(compile_s=compile_s, run_s=spent - compile_s)


def start_clearance(robot: Robot, workpiece: Workpiece, scenario: Scenario) -> tuple[float, str]:
    """D at the scenario's start [m] and the name of the body it belongs to."""
    scenario = jax.tree.map(jnp.asarray, scenario)
    scene = own_scene(Scene(robot, make_obstacle(workpiece)), scenario.tool_extension_m)
    D = np.asarray(jax.jit(clearances)(scene.robot, scene.obstacles, scenario, scenario.x_start))
    return float(D.min()), robot.capsule_names[int(D.argmin())]


def check_start(robot: Robot, workpiece: Workpiece, scenario: Scenario) -> None:
    """Raise InputError when the start is in collision, naming the body and the depth."""
    D, body = start_clearance(robot, workpiece, scenario)
    if D <= 0:
        raise InputError(f"start is in collision: {body} is {-1e3 * D:.3f} mm inside the workpiece")


def _run_engines(kernels: list[Kernels], tips, robot, method, settings, scenarios, plans, threads, progress) -> None:
    """One engine a thread; all take scenarios from one iterator, their share at first, and write into different rows of
    the plans."""
    count = len(scenarios.number)
    targets = int(scenarios.count.sum())
    threads = min(threads, count)
    share = -(-count // threads)
    # Neighbours in a grid are alike: dealt out in turn, every engine gets its part of the hard ones.
    refused = scenarios.refused != NOT_REFUSED
    plans.status[refused, 0] = scenarios.refused[refused]
    order = iter([k for first in range(threads) for k in range(first, count, threads) if not refused[k]])
    lock = threading.Lock()
    totals = [0, int(refused.sum())]

    def hand_out():
        while True:
            with lock:
                scenario = next(order, None)
            if scenario is None:
                return
            yield scenario

    def tell(tracked: int, finished: int) -> None:
        with lock:
            totals[0] += tracked
            totals[1] += finished
            if progress is not None:
                progress(Progress(totals[1], count, totals[0], targets))

    def work(number: int) -> None:
        task_rows, rows = kernels[0].sizes
        solver = make_solver(settings, len(robot.joint_names), row_count(settings, rows), task_rows)
        own = number % len(kernels)
        engine = Engine(kernels[own], solver, method, settings, scenarios, plans, share, tips[own])
        engine.run(hand_out(), tell)

    if threads == 1:
        work(0)
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, range(threads)))


def _check_remaining_paths(
    kernels: list[Kernels], tips: list[TipCheck | None], scenarios: Scenario, plans: Plans, threads: int
) -> None:
    """Fill in path_clear where a tracked target's path was not checked while planning."""
    tracked = ~np.isnan(plans.clearance)
    s, t = np.nonzero(tracked & (plans.path_clear < 0))
    if not len(s):
        return
    before = np.where((t == 0)[:, None], scenarios.x_start[s], plans.x[s, np.maximum(t - 1, 0)])
    inputs = lane_inputs(scenarios, s, t)

    def check(number: int) -> None:
        part = np.arange(len(s))[number::threads]
        pick = jax.tree.map(lambda table: table[part], (inputs, before, plans.x[s, t]))
        if len(part):
            own = number % len(kernels)
            clear = kernels[own]("check_path", *pick)
            plans.path_clear[s[part], t[part]] = clear if tips[own] is None else clear & ~tips[own].along(*pick)

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(check, range(threads)))


def _empty_plans(targets: np.ndarray, joints: int) -> Plans:
    shape = targets.shape[:2]

    def full(name, *more, dtype=float):
        return np.full((*shape, *more), EMPTY[name], dtype)

    return Plans(
        x=full("x", joints),
        tcp=full("tcp", 3),
        target=targets,
        clearance=full("clearance"),
        residual=full("residual"),
        status=full("status", dtype=np.int8),
        iterations=full("iterations", dtype=np.int32),
        joint_step=full("joint_step"),
        escape=full("escape", dtype=np.int8),
        path_clear=full("path_clear", dtype=np.int8),
        compile_s=0.0,
        run_s=0.0,
    )


__all__ = ["METHODS", "Progress", "check_start", "plan", "start_clearance"]
