"""Reachable prefix per scenario: the number of consecutive targets that have any clear configuration.

A planner follows a continuous path; this checks every target independently. A few configurations of the last target,
far apart, are carried over, re-anchored and pushed clear in the null space; if none succeeds, the target is searched at
a stated resolution of the null space (`configuration_search`). The first target at which nothing is found ends the
prefix.

A clear configuration that is found proves that one exists: the prefix is a lower bound on the reachable targets. "Not
found" does not imply unreachable. But if at some target every configuration certainly has the tool, or the arm behind
it, in collision, or violates a row of the task (`motion.tool_cells`), no configuration is clear there, and any path
ends before it: an upper bound. Targets between the two bounds are undecided.
"""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.clearance import Obstacles, Scene
from htcp_jax.clearance.obstacles import of_workpiece, tip_guard
from htcp_jax.device import Executor, devices, tables
from htcp_jax.model import Robot, Scenario, Task, Workpiece, scenario
from htcp_jax.motion import CollisionChecker, lane_inputs, tool_cells
from htcp_jax.reachability.configuration_search import (
    KnownConfigurations,
    carried,
    known_configurations,
    search,
    searched,
)
from htcp_jax.reachability.each_target import EachTarget, judge_each
from htcp_jax.settings import Settings

RESOLUTION_RAD = 0.11
PROOF_CELLS = 2048
FIRST_AHEAD = 4  # targets from the last one found to the first one tried by a proof; then twice as many, and so on
COARSE_FIRST = (4, 1)  # successive search resolutions, as multiples of the requested one


class Reachability(NamedTuple):
    """Result for S scenarios of T targets."""

    prefix: np.ndarray  # (S,) consecutive targets, from the first, with a clear configuration; see `_off_lines`
    most: np.ndarray  # (S,) targets before one that is proven to have none
    best: np.ndarray  # (S,) best clearance found at the first target without one [m]; NaN where all have one
    x: np.ndarray  # (S, T, N) the configurations found, NaN beyond the prefix
    # (S,) of the search there; 0 if all are found, or the tool alone collides, or it cannot satisfy the rows about its
    # orientation; pi if the task does not constrain the TCP's position, and only spread configurations are tried
    resolution_rad: np.ndarray
    each: EachTarget | None = None  # every target on the path by itself; None if that was not required


class SearchStopped(KeyboardInterrupt):
    """Interruption of a search, in place of KeyboardInterrupt; `found` is its result so far, with looser bounds."""

    def __init__(self, found: Reachability):
        super().__init__()
        self.found = found


def reachable_prefixes(
    robot: Robot,
    workpiece: Workpiece,
    scenarios: Scenario,
    settings: Settings | None = None,
    *,
    task: Task | None = None,
    obstacles: Obstacles = (),
    resolution_rad: float = RESOLUTION_RAD,
    proof_cells: int = PROOF_CELLS,
    each: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Reachability:
    """Return the reachable prefixes of stacked scenarios, which one thread per core share.

    Args:
        robot: The arm, its tool not extended.
        workpiece: The part.
        scenarios: Stacked.
        settings: `alpha_rad`, `tolerance_m` and the seed are used; None: the defaults.
        task: The constraints at every target; None: the TCP's position. Without the TCP's position among them there are
            no proofs.
        obstacles: In addition to the workpiece; proofs ignore them.
        resolution_rad: Resolution of the tool's orientations at a target where carrying over fails.
        proof_cells: See `motion.tool_cells.excluded`; 0: no proofs.
        each: True judges every target on the path by itself, too.
        progress: Called with (target, targets) after each target; then, with `each`, with the number of targets that
            are settled, and of all.

    Raises:
        SearchStopped: On Ctrl-C.
    """
    settings = settings or Settings()
    scenarios = jax.tree.map(np.asarray, scenarios)
    task = Task(tolerance_m=settings.tolerance_m) if task is None else task
    scene = Scene(robot, of_workpiece.all_obstacles(workpiece, obstacles), task)
    checker = CollisionChecker(Executor(scene, settings), settings, tip_guard.make_tip_guard(workpiece))
    known = known_configurations(robot, scenarios.tool_extension_m)
    threads = devices.default_threads([checker.executor.device], settings.qp)
    parts = [initial_reachability(tables.gather(scenarios, slice(number, None, threads))) for number in range(threads)]
    stop = threading.Event()

    def work(number: int) -> None:
        own = tables.gather(scenarios, slice(number, None, threads))

        def report(row: int, rows: int) -> None:
            if stop.is_set():
                raise KeyboardInterrupt
            if progress is not None and number == 0:
                progress(row, rows)

        found = parts[number]
        own = _prefixes(checker, known, own, settings.seed, resolution_rad, found, report)
        cells = proof_cells if task.holds_tcp else 0
        parts[number] = found._replace(most=_upper_bounds(checker.executor, robot, own, found, cells))

    pool = ThreadPoolExecutor(threads)
    try:
        list(pool.map(work, range(threads)))
        if each:
            found = tables.interleaved(parts)
            judged = judge_each(
                checker,
                known,
                robot,
                scenarios,
                found.x,
                seed=settings.seed,
                resolution_rad=resolution_rad,
                proof_cells=proof_cells if task.holds_tcp else 0,
                mapped=lambda function, chunks: list(pool.map(function, chunks)),
                progress=progress or (lambda done, count: None),
            )
            return found._replace(most=np.minimum(found.most, judged.first_excluded), each=judged)
    except KeyboardInterrupt:
        raise SearchStopped(tables.interleaved(parts)) from None
    finally:
        stop.set()
        pool.shutdown(wait=False, cancel_futures=True)
    return tables.interleaved(parts)


def initial_reachability(scenarios: Scenario) -> Reachability:
    """Return the initial result for S stacked scenarios, with its own arrays."""
    count, rows = scenarios.targets.shape[:2]
    return Reachability(
        np.zeros(count, int), np.array(scenarios.count), np.full(count, np.nan),
        np.full((count, rows, scenarios.x_start.shape[1]), np.nan), np.zeros(count),
    )  # fmt: skip


def _prefixes(
    checker: CollisionChecker,
    known: KnownConfigurations,
    scenarios: Scenario,
    seed: int,
    resolution_rad: float,
    found: Reachability,
    progress: Callable,
) -> Scenario:
    """Search, and write the result into `found`, except `most`.

    Returns:
        The scenarios as they were searched, see `_off_lines`.
    """
    count, rows = scenarios.targets.shape[:2]
    beam = [x[None] for x in scenarios.x_start]
    alive = np.arange(count)
    for row in range(rows):
        alive = alive[scenarios.count[alive] > row]
        if not len(alive):
            break
        looked = alive
        while len(looked):
            inputs = lane_inputs.lane_inputs(scenarios, looked, np.full(len(looked), row), seed=seed)
            clear, best, coarsest = _clear_configurations(
                checker, known, inputs, [beam[s] for s in looked], resolution_rad
            )
            for k, s in enumerate(looked):
                found.best[s], found.resolution_rad[s] = best[k], coarsest[k]
                if len(clear[k]):
                    beam[s], found.x[s, row] = clear[k], clear[k][0]
                    found.prefix[s] += 1
            looked = looked[[not len(own) for own in clear]]
            leave = _off_lines(scenarios, looked, row)
            scenarios = scenario.with_free_approach(scenarios, leave) if leave.any() else scenarios
            looked = looked[leave[looked, row]]
        alive = alive[found.prefix[alive] > row]
        progress(row + 1, rows)
    return scenarios


def _clear_configurations(
    checker: CollisionChecker,
    known: KnownConfigurations,
    inputs: lane_inputs.LaneInputs,
    beam: list,
    resolution_rad: float,
) -> tuple[list[np.ndarray], Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Return the clear configurations at n targets, carried over from each `beam` or else searched for.

    Also, at targets without any, the best clearance [m] and the resolution [rad], elsewhere NaN and 0.
    """
    clear = carried(checker, inputs, beam)
    best, coarsest = np.full(len(beam), np.nan), np.zeros(len(beam))
    for coarser in COARSE_FIRST if checker.task.holds_tcp else (1,):
        which = np.flatnonzero([not len(own) for own in clear])
        if not len(which):
            break
        here = search(checker, known, tables.gather(inputs, which), coarser * resolution_rad)
        for k, own in zip(which, searched(checker, tables.gather(inputs, which), here.at), strict=True):
            clear[k] = own
        lost = np.array([not len(clear[k]) for k in which])
        best[which], coarsest[which] = np.where(lost, here.at.clearance[:, 0], np.nan), lost * here.resolution_rad
    return clear, best, coarsest


def _off_lines(scenarios: Scenario, rows: Int[np.ndarray, "n"], target: int) -> Bool[np.ndarray, "S T"]:
    """Return the targets at which approaches leave their lines, as a planner's may.

    For scenarios that have not reached a target before the path these are that target and the following ones up to the
    path's first point.
    """
    goals, on_path = scenarios.goals, scenarios.on_path[rows]
    leave = (0 < target) & (target < on_path) & (goals[rows, target] != goals[rows, on_path]).any(axis=1)
    which = np.zeros(goals.shape[:2], bool)
    which[rows[leave], target:] = True
    return which & (np.arange(goals.shape[1]) < scenarios.on_path[:, None])


def _upper_bounds(executor: Executor, robot: Robot, scenarios: Scenario, found: Reachability, cells: int) -> np.ndarray:
    """Return the number of targets (S,) before one that is proven out of reach: the smaller result of two searches.

    Both bisect between a target that is not excluded and one that is. The first begins at targets 4, 8, 16, ... behind
    the last one found: on a path that comes back into the open its end is not excluded. The second begins at the path's
    end: a later target is usually excluded more easily. If another one is excluded earlier, the bound is larger than it
    could be.
    """
    ahead = _excluded_first(executor, robot, scenarios, found, cells, FIRST_AHEAD)
    return np.minimum(ahead, _excluded_first(executor, robot, scenarios, found, cells, 0))


def _excluded_first(
    executor: Executor, robot: Robot, scenarios: Scenario, found: Reachability, cells: int, ahead: int
) -> np.ndarray:
    """Return the first target (S,) found to be excluded, trying those `ahead` first; 0: bisection of the whole path."""
    short, no_cell = found.prefix < scenarios.count, found.resolution_rad == 0
    low, high = found.prefix - 1, np.where(short & no_cell, found.prefix, scenarios.count)
    is_bounded = (short & no_cell) | (ahead == 0)
    while cells and (open_ := np.flatnonzero(short & (high - low > 1))).size:
        further = np.minimum(found.prefix - 1 + ahead, high - 1)
        target = np.where(is_bounded, (low + high) // 2, further)[open_]
        none = tool_cells.excluded(executor, robot, lane_inputs.lane_inputs(scenarios, open_, target), cells)
        high[open_[none]], low[open_[~none]] = target[none], target[~none]
        is_bounded[open_[none]] = True
        ahead *= 2
    return high
