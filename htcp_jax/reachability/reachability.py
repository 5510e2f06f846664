"""Reachable prefix per scenario: the number of consecutive targets that have a collision-free configuration.

A planner needs a continuous motion. Here, a target only needs some collision-free configuration. A few distinct
configurations at the previous target are carried over, re-anchored and pushed clear in the null space. If this fails,
the target is searched at a given resolution of tool orientations (`configuration_search`). The prefix ends at the first
target at which no configuration was found.

The prefix is a lower bound on the number of reachable targets; "not found" does not imply unreachable. An upper bound
comes from proofs (`motion.tool_cells`): if every configuration at a target collides with the tool or the arm, or
violates a row of the task, every plan ends before this target. Targets between the two bounds are undecided.
"""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.clearance import Obstacles, Scene
from htcp_jax.clearance.obstacles import all_obstacles, make_tip_guard
from htcp_jax.device import Executor, devices, tables
from htcp_jax.model import Robot, Scenario, Task, Workpiece, scenario
from htcp_jax.motion import CollisionChecker, lane_inputs, tool_cells
from htcp_jax.reachability.configuration_search import ConfigurationSearch
from htcp_jax.reachability.each_target import EachTarget, TargetJudge
from htcp_jax.settings import Settings

RESOLUTION_RAD = 0.11
PROOF_CELLS = 4096
FIRST_AHEAD = 4  # number of targets from the last found one to the first proof; doubled for each further proof
COARSE_FIRST = (4, 1)  # resolutions of successive searches, as multiples of the requested resolution


class Reachability(NamedTuple):
    """Reachability of S scenarios with T targets each."""

    prefix: np.ndarray  # (S,) number of consecutive targets, from the first on, with a clear configuration
    most: np.ndarray  # (S,) number of targets before the first one proven to have no clear configuration
    best: np.ndarray  # (S,) largest clearance found at the target after the prefix [m]; NaN if there is no such target
    x: np.ndarray  # (S, T, N) the configurations found [rad or m]; NaN after the prefix
    # (S,) resolution of the search at the target after the prefix. 0: there is no such target, the tool alone collides,
    # or it cannot satisfy the rows about its orientation. pi: the task does not constrain the TCP's position
    resolution_rad: np.ndarray
    each: EachTarget | None = None  # results for every target by itself; None if not requested


class SearchStopped(KeyboardInterrupt):
    """Interruption of a search, raised in place of KeyboardInterrupt; `found` is the result so far."""

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
    """Return the reachability of stacked scenarios, computed by one thread per core.

    Args:
        robot: The arm, without the scenarios' tool extensions.
        workpiece: The part.
        scenarios: The stacked scenarios.
        settings: Settings; `alpha_rad`, `tolerance_m` and the seed are used. None: the defaults.
        task: The constraints at every target; None: the TCP's position. There are no proofs if the TCP's position is
            not constrained.
        obstacles: Obstacles in addition to the workpiece; proofs ignore them.
        resolution_rad: Resolution of the tool's orientations at a target where carrying over fails.
        proof_cells: Maximum number of cells per proof, see `motion.tool_cells.excluded`; 0: no proofs.
        each: True to also classify every target on the path by itself.
        progress: Function that is called with (target, targets) after each target; with `each`, it is also called with
            the numbers of decided targets and of all targets.

    Raises:
        SearchStopped: If Ctrl-C is pressed.
    """
    settings = settings or Settings()
    scenarios = jax.tree.map(np.asarray, scenarios)
    task = Task(tolerance_m=settings.tolerance_m) if task is None else task
    scene = Scene(robot, all_obstacles(workpiece, obstacles), task)
    checker = CollisionChecker(Executor(scene, settings), settings, make_tip_guard(workpiece))
    search = ConfigurationSearch(checker, robot, scenarios.tool_extension_m)
    cells = proof_cells if task.holds_tcp else 0
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
        own = _prefixes(search, own, settings.seed, resolution_rad, found, report)
        parts[number] = found._replace(most=_upper_bounds(checker.executor, robot, own, found, cells))

    pool = ThreadPoolExecutor(threads)
    try:
        list(pool.map(work, range(threads)))
        if each:
            found = tables.interleaved(parts)
            mapped = lambda function, chunks: list(pool.map(function, chunks))  # noqa: E731
            report = progress or (lambda done, count: None)
            judge = TargetJudge(search, scenarios, found.x, settings.seed, mapped, report)
            judged = judge.judge(resolution_rad, cells)
            return found._replace(most=np.minimum(found.most, judged.first_excluded), each=judged)
    except KeyboardInterrupt:
        raise SearchStopped(tables.interleaved(parts)) from None
    finally:
        stop.set()
        pool.shutdown(wait=False, cancel_futures=True)
    return tables.interleaved(parts)


def initial_reachability(scenarios: Scenario) -> Reachability:
    """Return the result for S stacked scenarios before any search, in new arrays."""
    count, rows = scenarios.targets.shape[:2]
    return Reachability(
        np.zeros(count, int), np.array(scenarios.count), np.full(count, np.nan),
        np.full((count, rows, scenarios.x_start.shape[1]), np.nan), np.zeros(count),
    )  # fmt: skip


def _prefixes(
    search: ConfigurationSearch,
    scenarios: Scenario,
    seed: int,
    resolution_rad: float,
    found: Reachability,
    progress: Callable,
) -> Scenario:
    """Search the prefixes, and write the results into `found`, except `most`.

    Returns:
        The scenarios with the targets that were searched, see `_off_lines`.
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
            clear, best, coarsest = _clear_configurations(search, inputs, [beam[s] for s in looked], resolution_rad)
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
    search: ConfigurationSearch, inputs: lane_inputs.LaneInputs, beam: list, resolution_rad: float
) -> tuple[list[np.ndarray], Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Return the clear configurations at n targets, carried over from each `beam` or else searched for.

    Also return the largest clearance [m] and the resolution [rad] at targets without a clear configuration; NaN and 0
    at other targets.
    """
    clear = search.carried(inputs, beam)
    best, coarsest = np.full(len(beam), np.nan), np.zeros(len(beam))
    for coarser in COARSE_FIRST if search.checker.task.holds_tcp else (1,):
        which = np.flatnonzero([not len(own) for own in clear])
        if not len(which):
            break
        lost_inputs = tables.gather(inputs, which)
        here = search.search(lost_inputs, coarser * resolution_rad)
        for k, own in zip(which, search.searched(lost_inputs, here.at), strict=True):
            clear[k] = own
        lost = np.array([not len(clear[k]) for k in which])
        best[which], coarsest[which] = np.where(lost, here.at.clearance[:, 0], np.nan), lost * here.resolution_rad
    return clear, best, coarsest


def _off_lines(scenarios: Scenario, rows: Int[np.ndarray, "n"], target: int) -> Bool[np.ndarray, "S T"]:
    """Return True for targets at which an approach may leave its straight lines, as it may in a plan.

    If a target of the approach was not reached, these are this target and the following ones up to the path's first
    point.

    Args:
        scenarios: Stacked scenarios.
        rows: Rows of the scenarios that have not reached the target.
        target: Index of the target.
    """
    goals, on_path = scenarios.goals, scenarios.on_path[rows]
    leave = (0 < target) & (target < on_path) & (goals[rows, target] != goals[rows, on_path]).any(axis=1)
    which = np.zeros(goals.shape[:2], bool)
    which[rows[leave], target:] = True
    return which & (np.arange(goals.shape[1]) < scenarios.on_path[:, None])


def _upper_bounds(executor: Executor, robot: Robot, scenarios: Scenario, found: Reachability, cells: int) -> np.ndarray:
    """Return the number of targets (S,) before one that is proven unreachable: the smaller result of two searches.

    Both bisect between a target that is not excluded and one that is. The first search begins at 4, 8, 16, ... targets
    after the last one found; it is for paths that leave the part again, as their end cannot be excluded. The second
    search bisects the whole path, as later targets are usually easier to exclude. The bound is not tight if an earlier
    target could be excluded.
    """
    ahead = _excluded_first(executor, robot, scenarios, found, cells, FIRST_AHEAD)
    return np.minimum(ahead, _excluded_first(executor, robot, scenarios, found, cells, 0))


def _excluded_first(
    executor: Executor, robot: Robot, scenarios: Scenario, found: Reachability, cells: int, ahead: int
) -> np.ndarray:
    """Return the earliest target of each scenario (S,) that was found to be excluded; the number of targets if none.

    Args:
        executor: Runs compiled functions.
        robot: The arm.
        scenarios: Stacked scenarios.
        found: Result of the search, with the prefixes.
        cells: Maximum number of cells in a proof; 0: no proofs.
        ahead: Number of targets from the last found one to the first proof; 0: bisection of the whole path.
    """
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
