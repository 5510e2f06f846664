"""What was reachable at all: per scenario, how many targets in a row have any clear configuration.

A planner walks a continuous path; this looks at every target by itself. At each target in turn the last clear
configuration is carried over, re-anchored and pushed clear in the null space; where that fails, configurations are
drawn uniformly within the joint limits, brought onto the target, and the clearest of them pushed clear. The first
target at which all draws fail ends the prefix. A clear configuration that is found proves that one exists; one that is
not found proves nothing: the prefix is a lower bound on what is reachable, and says with how many draws. A planner that
gets further found what the draws missed, and is flagged.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from htcp_jax.clearance.of_workpiece import make_obstacle
from htcp_jax.clearance.scene import Scene
from htcp_jax.clearance.tip_guard import make_tip_guard
from htcp_jax.planner.lane_inputs import lane_inputs
from htcp_jax.planner.null_space import DRAWS, Anchored
from htcp_jax.planner.programs import Kernels
from htcp_jax.planner.stages import DRAW, PUSH
from htcp_jax.planner.tip_check import tip_checks
from htcp_jax.scene.robot import Robot
from htcp_jax.scene.scenario import Scenario
from htcp_jax.scene.task import Task
from htcp_jax.scene.workpiece import Workpiece
from htcp_jax.settings import Settings


class Reachability(NamedTuple):
    """Result for S scenarios of T targets."""

    prefix: np.ndarray  # (S,) targets in a row, from the first, with a clear configuration
    best: np.ndarray  # (S,) best clearance found at the first target without one [m]; NaN where all have one
    x: np.ndarray  # (S, T, N) the configurations found, NaN beyond the prefix
    draws: int  # at the first target without one


def reachable_prefixes(
    robot: Robot,
    workpiece: Workpiece,
    scenarios: Scenario,
    settings: Settings | None = None,
    *,
    task: Task | None = None,
    draws: int = 2048,
    progress: Callable[[int, int], None] | None = None,
) -> Reachability:
    """Prefixes of the stacked scenarios. draws: at a target where carrying over fails, in rounds of `DRAWS`; from the
    settings count alpha_rad, tolerance_m and the seed. task: what the arm holds; None: the TCP's position.
    progress(target, targets) is called after each target."""
    settings = settings or Settings()
    task = Task(tolerance_m=settings.tolerance_m) if task is None else task
    scene = Scene(robot, make_obstacle(workpiece), task)
    kernels = Kernels(scene, settings)
    [tip] = tip_checks([kernels], make_tip_guard(workpiece))

    def good_at(row: int, rows: np.ndarray, here: Anchored) -> np.ndarray:
        good = kernels.task.counts(here.clearance, here.residual, scenarios.margin_m[rows])
        if tip is not None and good.any():
            good[good] = ~tip.at(lane_inputs(scenarios, rows[good], np.full(good.sum(), row)), here.x[good])
        return good

    scenarios = jax.tree.map(np.asarray, scenarios)
    count, rows = scenarios.targets.shape[:2]
    prefix, best = np.zeros(count, int), np.full(count, np.nan)
    found = np.full((count, rows, scenarios.x_start.shape[1]), np.nan)
    x = scenarios.x_start.copy()
    alive = np.arange(count)
    for row in range(rows):
        alive = alive[scenarios.count[alive] > row]
        if not len(alive):
            break
        here = kernels(PUSH, lane_inputs(scenarios, alive, np.full(len(alive), row)), x[alive])
        x[alive], good = here.x, good_at(row, alive, here)
        for round_ in range(-(-draws // DRAWS)):
            lost = alive[~good]
            if not len(lost):
                break
            here = kernels(
                DRAW, lane_inputs(scenarios, lost, np.full(len(lost), row), seed=settings.seed, round_=round_)
            )
            here = jax.tree.map(lambda leaf: leaf[:, 0], here)
            x[lost] = here.x
            best[lost] = np.fmax(best[lost], np.where(kernels.task.reached(here.residual), here.clearance, -np.inf))
            good[~good] = good_at(row, lost, here)
        best[alive[good]] = np.nan
        alive = alive[good]
        found[alive, row] = x[alive]
        prefix[alive] += 1
        if progress is not None:
            progress(row + 1, rows)
    return Reachability(prefix, best, found, draws)
