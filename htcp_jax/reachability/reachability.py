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
from htcp_jax.reachability import memo as memos
from htcp_jax.reachability.configuration_search import CARRIED, ConfigurationSearch
from htcp_jax.reachability.each_target import SEARCHED, TOGETHER, EachTarget, TargetJudge
from htcp_jax.reachability.memo import Memo, compute_all
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
    progress: Callable[..., None] | None = None,
    memo: Memo = compute_all,
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
            the numbers of finished targets and of all targets of a step, and the step's name.
        memo: Results of an earlier call with the same arguments that was interrupted.
    """
    settings = settings or Settings()
    scenarios = jax.tree.map(np.asarray, scenarios)
    task = Task(tolerance_m=settings.tolerance_m) if task is None else task
    scene = Scene(robot, all_obstacles(workpiece, obstacles), task)
    checker = CollisionChecker(Executor(scene, settings), settings, make_tip_guard(workpiece))
    search = ConfigurationSearch(checker, robot, scenarios.tool_extension_m)
    cells = proof_cells if task.holds_tcp else 0
    threads = devices.default_threads([checker.executor.device], settings.qp)
    report = progress or (lambda *step: None)
    stop = threading.Event()

    def until_stopped(*step) -> memos.Results:
        if stop.is_set():
            raise KeyboardInterrupt
        return memo(*step)

    def work(number: int) -> Reachability:
        rows = np.arange(number, len(scenarios.count), threads)
        own, own_memo = tables.gather(scenarios, rows), memos.of_rows(until_stopped, rows)
        found = initial_reachability(own)
        own_report = report if number == 0 else lambda row, rows: None
        own = _prefixes(search, own, settings.seed, resolution_rad, found, own_report, own_memo)
        return found._replace(most=_upper_bounds(checker.executor, robot, own, found, cells, own_memo))

    pool = ThreadPoolExecutor(threads)
    try:
        found = tables.interleaved(list(pool.map(work, range(threads))))
        if not each:
            return found
        mapped = lambda function, chunks: list(pool.map(function, chunks))  # noqa: E731
        judge = TargetJudge(search, scenarios, found.x, settings.seed, mapped, report, until_stopped)
        judged = judge.judge(resolution_rad, cells)
        return found._replace(most=np.minimum(found.most, judged.first_excluded), each=judged)
    finally:
        stop.set()
        pool.shutdown(wait=False, cancel_futures=True)


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
    memo: Memo,
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
        looked, step = alive, "prefix"
        while len(looked):
            pairs = np.column_stack([looked, np.full(len(looked), row)])
            inputs, own = lane_inputs.lane_inputs(scenarios, *pairs.T, seed=seed), [beam[s] for s in looked]
            own_memo = memos.of_step(memo, step)
            clear, best, coarsest = _clear_configurations(search, inputs, pairs, own, resolution_rad, own_memo)
            for k, s in enumerate(looked):
                found.best[s], found.resolution_rad[s] = best[k], coarsest[k]
                if len(clear[k]):
                    beam[s], found.x[s, row] = clear[k], clear[k][0]
                    found.prefix[s] += 1
            looked, step = looked[[not len(own) for own in clear]], "free approach"
            leave = _off_lines(scenarios, looked, row)
            scenarios = scenario.with_free_approach(scenarios, leave) if leave.any() else scenarios
            looked = looked[leave[looked, row]]
        alive = alive[found.prefix[alive] > row]
        progress(row + 1, rows)
    return scenarios


def _clear_configurations(
    search: ConfigurationSearch,
    inputs: lane_inputs.LaneInputs,
    pairs: memos.Pairs,
    beam: list,
    resolution_rad: float,
    memo: Memo,
) -> tuple[list[np.ndarray], Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Return the clear configurations at n targets, carried over from each `beam` or else searched for.

    Also return the largest clearance [m] and the resolution [rad] at targets without a clear configuration; NaN and 0
    at other targets.
    """
    joints = beam[0].shape[1]

    def carried(which: np.ndarray) -> memos.Results:
        return memos.padded(search.carried(tables.gather(inputs, which), [beam[k] for k in which]), CARRIED, joints)

    clear = memos.unpadded(memo("carried", pairs, CARRIED * joints, carried), joints)
    best, coarsest = np.full(len(beam), np.nan), np.zeros(len(beam))
    for coarser in COARSE_FIRST if search.checker.task.holds_tcp else (1,):
        which = np.flatnonzero([not len(own) for own in clear])
        if not len(which):
            break

        def searched(some: np.ndarray, which=which, coarser=coarser) -> memos.Results:
            own = tables.gather(inputs, which[some])
            here = search.search(own, coarser * resolution_rad)
            rows = memos.padded(search.searched(own, here.at), CARRIED, joints)
            return np.column_stack([here.at.clearance[:, 0], here.resolution_rad, rows])

        step = f"searched {coarser}"
        here = memos.in_chunks(memo, SEARCHED)(step, pairs[which], 2 + CARRIED * joints, searched)
        for k, own in zip(which, memos.unpadded(here[:, 2:], joints), strict=True):
            clear[k] = own
        lost = np.array([not len(clear[k]) for k in which])
        best[which], coarsest[which] = np.where(lost, here[:, 0], np.nan), lost * here[:, 1]
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


def _upper_bounds(
    executor: Executor, robot: Robot, scenarios: Scenario, found: Reachability, cells: int, memo: Memo = compute_all
) -> np.ndarray:
    """Return the number of targets (S,) before one that is proven unreachable: the smaller result of two searches.

    Both bisect between a target that is not excluded and one that is. The first search begins at 4, 8, 16, ... targets
    after the last one found; it is for paths that leave the part again, as their end cannot be excluded. The second
    search bisects the whole path, as later targets are usually easier to exclude. The bound is not tight if an earlier
    target could be excluded.
    """

    def are_excluded(rows: np.ndarray, target: np.ndarray) -> np.ndarray:
        def prove(which: np.ndarray) -> memos.Results:
            inputs = lane_inputs.lane_inputs(scenarios, rows[which], target[which])
            return tool_cells.excluded(executor, robot, inputs, cells)[:, None]

        return memos.in_chunks(memo, TOGETHER)("bound", np.column_stack([rows, target]), 1, prove)[:, 0] == 1

    prove = are_excluded if cells else None
    ahead = _excluded_first(prove, scenarios.count, found, FIRST_AHEAD)
    return np.minimum(ahead, _excluded_first(prove, scenarios.count, found, 0))


def _excluded_first(
    are_excluded: Callable[[np.ndarray, np.ndarray], np.ndarray] | None,
    count: Int[np.ndarray, "S"],
    found: Reachability,
    ahead: int,
) -> np.ndarray:
    """Return the earliest target of each scenario (S,) that was found to be excluded; the number of targets if none.

    Args:
        are_excluded: Function (rows of scenarios, targets) that returns the mask of excluded targets; None: no proofs.
        count: Numbers of targets.
        found: Result of the search, with the prefixes.
        ahead: Number of targets from the last found one to the first proof; 0: bisection of the whole path.
    """
    short, no_cell = found.prefix < count, found.resolution_rad == 0
    low, high = found.prefix - 1, np.where(short & no_cell, found.prefix, count)
    is_bounded = (short & no_cell) | (ahead == 0)
    while are_excluded and (open_ := np.flatnonzero(short & (high - low > 1))).size:
        further = np.minimum(found.prefix - 1 + ahead, high - 1)
        target = np.where(is_bounded, (low + high) // 2, further)[open_]
        none = are_excluded(open_, target)
        high[open_[none]], low[open_[~none]] = target[none], target[~none]
        is_bounded[open_[none]] = True
        ahead *= 2
    return high
