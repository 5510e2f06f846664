"""What was reachable at all: per scenario, how many targets in a row have any clear configuration.

A planner walks a continuous path; this looks at every target by itself. At each target in turn the last clear
configuration is carried over, re-anchored and pushed clear in the null space; where that fails, configurations are
drawn uniformly within the joint limits, brought onto the target, and the clearest of them pushed clear. The first
target at which all draws fail ends the prefix. A clear configuration that is found proves that one exists; one that is
not found proves nothing: the prefix is a lower bound on what is reachable, and says with how many draws. A planner that
gets further found what the draws missed, and is flagged.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance import make_obstacle
from htcp_jax.escape import METHODS, Anchored, Scene, anchor, keep_clear_ascent, own_scene, stuck_key
from htcp_jax.kernels import Kernels, Task, tasks
from htcp_jax.robot import Robot
from htcp_jax.scenario import Scenario
from htcp_jax.settings import Settings
from htcp_jax.workpiece import Workpiece

CEILING_STAGE = 98  # its random keys lie apart from those of the planners
DRAWS, PUSHED, PUSHES = 64, 8, 30  # draws a round, how many of them are pushed clear, null-space steps of a push


class Ceiling(NamedTuple):
    """Result for S scenarios of T targets."""

    prefix: np.ndarray  # (S,) targets in a row, from the first, with a clear configuration
    best: np.ndarray  # (S,) best clearance found at the first target without one [m]; NaN where all have one
    x: np.ndarray  # (S, T, N) the configurations found, NaN beyond the prefix
    draws: int  # at the first target without one


def ceiling(
    robot: Robot,
    workpiece: Workpiece,
    scenarios: Scenario,
    settings: Settings | None = None,
    *,
    draws: int = 2048,
    progress: Callable[[int, int], None] | None = None,
) -> Ceiling:
    """Prefixes of the stacked scenarios. draws: at a target where carrying over fails, in rounds of 64; from the
    settings count alpha_rad, tolerance_m and the seed. progress(target, targets) is called after each target."""
    settings = replace(settings or Settings(), keep_clear_m=1e-9, keep_clear_steps=PUSHES)
    scene = Scene(robot, make_obstacle(workpiece))
    kernels = Kernels(scene, METHODS["baseline"], settings, {"push": push, "draw": draw})
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
        here = kernels("push", _tasks(scenarios, alive, row, 0), x[alive])
        x[alive], good = here.x, _clear(here, settings)
        for round_ in range(-(-draws // DRAWS)):
            lost = alive[~good]
            if not len(lost):
                break
            here = kernels("draw", _tasks(scenarios, lost, row, round_))
            x[lost] = here.x
            best[lost] = np.fmax(best[lost], np.where(here.residual <= settings.tolerance_m, here.clearance, -np.inf))
            good[~good] = _clear(here, settings)
        best[alive[good]] = np.nan
        alive = alive[good]
        found[alive, row] = x[alive]
        prefix[alive] += 1
        if progress is not None:
            progress(row + 1, rows)
    return Ceiling(prefix, best, found, draws)


def push(settings: Settings, scene: Scene, task: Task, x) -> Anchored:
    """x brought onto the task's target and pushed clear of the workpiece in the null space."""
    scene = own_scene(scene, task.tool_extension_m)
    return keep_clear_ascent(scene, settings, task, anchor(scene, settings, task, x, task.target).x, task.target)


def draw(settings: Settings, scene: Scene, task: Task) -> Anchored:
    """The best of a round of random draws: on target, then clear, then clearest."""
    own = own_scene(scene, task.tool_extension_m)
    lower, upper = jnp.maximum(own.robot.lower, -jnp.pi), jnp.minimum(own.robot.upper, jnp.pi)
    key = stuck_key(settings, task.number, task.row, CEILING_STAGE, task.attempt)
    x = lower[None, :] + (upper - lower)[None, :] * jax.random.uniform(key, (DRAWS, lower.shape[0]))
    reached = jax.vmap(lambda x: anchor(own, settings, task, x, task.target))(x)
    rank = jnp.where(reached.residual <= settings.tolerance_m, reached.clearance, -jnp.inf)
    _, first = jax.lax.top_k(rank, PUSHED)
    pushed = jax.lax.map(partial(push, settings, scene, task), reached.x[first])
    rank = jnp.where(pushed.residual <= settings.tolerance_m, pushed.clearance, -jnp.inf)
    return jax.tree.map(lambda leaf: leaf[jnp.argmax(rank)], pushed)


def _clear(here: Anchored, settings: Settings) -> np.ndarray:
    return (here.clearance > 0) & (here.residual <= settings.tolerance_m)


def _tasks(scenarios: Scenario, which: np.ndarray, row: int, round_: int) -> Task:
    return tasks(
        scenarios, which, np.full(len(which), row, np.int32), np.full(len(which), round_, np.int32)
    )
