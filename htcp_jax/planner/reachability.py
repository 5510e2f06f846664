"""What was reachable at all: per scenario, how many targets in a row have any clear configuration.

A planner walks a continuous path; this looks at every target by itself. A few postures of the last target, far apart,
are carried over, re-anchored and pushed clear in the null space; where none of them gets through, the target is
searched at a stated resolution of the null space (`posture_search`). The first target at which nothing is found ends
the prefix.

A clear configuration that is found proves that one exists: the prefix is a lower bound on what is reachable. One that
is not found proves nothing by itself; but where every orientation of the tool collides for sure, none exists, and the
prefix is all there is. Between the two lies what is not known.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from htcp_jax.clearance.of_workpiece import make_obstacle
from htcp_jax.clearance.scene import Scene
from htcp_jax.clearance.tip_guard import make_tip_guard
from htcp_jax.planner.lane_inputs import LaneInputs, lane_inputs
from htcp_jax.planner.lanes import gather
from htcp_jax.planner.null_space import Anchored
from htcp_jax.planner.posture_search import APART_RAD, PUSHED, search
from htcp_jax.planner.programs import Kernels
from htcp_jax.planner.stages import PUSH
from htcp_jax.planner.tip_check import TipCheck, tip_checks
from htcp_jax.scene.robot import Robot
from htcp_jax.scene.scenario import Scenario
from htcp_jax.scene.task import Task
from htcp_jax.scene.workpiece import Workpiece
from htcp_jax.settings import Settings

CARRIED = 6  # postures carried from a target to the next
RESOLUTION_RAD = 0.11
COARSE_FIRST = (4, 1)  # resolutions that a target is searched at, in turn, as multiples of the one asked for


class Reachability(NamedTuple):
    """Result for S scenarios of T targets."""

    prefix: np.ndarray  # (S,) targets in a row, from the first, with a clear configuration
    excluded: np.ndarray  # (S,) whether the first target without one is proven to have none
    best: np.ndarray  # (S,) best clearance found at the first target without one [m]; NaN where all have one
    x: np.ndarray  # (S, T, N) the configurations found, NaN beyond the prefix
    resolution_rad: float  # of every search: the coarsest

    def most(self, count: np.ndarray) -> np.ndarray:
        """(S,) targets in a row that are not proven unreachable; count: those of each scenario."""
        return np.where(self.excluded, self.prefix, count)


def reachable_prefixes(
    robot: Robot,
    workpiece: Workpiece,
    scenarios: Scenario,
    settings: Settings | None = None,
    *,
    resolution_rad: float = RESOLUTION_RAD,
    progress: Callable[[int, int], None] | None = None,
) -> Reachability:
    """Prefixes of the stacked scenarios. resolution_rad: of the tool's orientations, at a target where carrying over
    fails; from the settings count alpha_rad, tolerance_m and the seed. progress(target, targets) is
    called after each target."""
    settings = settings or Settings()
    scenarios = jax.tree.map(np.asarray, scenarios)
    scene = Scene(robot, make_obstacle(workpiece), Task(tolerance_m=settings.tolerance_m))
    kernels = Kernels(scene, settings)
    [tip] = tip_checks([kernels], make_tip_guard(workpiece))
    count, rows = scenarios.targets.shape[:2]
    found = Reachability(
        np.zeros(count, int), np.zeros(count, bool), np.full(count, np.nan),
        np.full((count, rows, scenarios.x_start.shape[1]), np.nan), resolution_rad,
    )  # fmt: skip
    front = [x[None] for x in scenarios.x_start]
    alive = np.arange(count)
    for row in range(rows):
        alive = alive[scenarios.count[alive] > row]
        if not len(alive):
            break
        inputs = lane_inputs(scenarios, alive, np.full(len(alive), row), seed=settings.seed)
        clear = _carried(kernels, tip, inputs, [front[s] for s in alive])
        for coarser in COARSE_FIRST:
            which = np.flatnonzero([not len(own) for own in clear])
            if not len(which):
                break
            here = search(kernels, robot, gather(inputs, which), coarser * resolution_rad)
            for k, own in zip(which, _searched(kernels, tip, gather(inputs, which), here), strict=True):
                clear[k] = own
            nothing = np.array([not len(clear[k]) for k in which])
            found.best[alive[which[nothing]]] = here.clearance[nothing, 0]
            found.excluded[alive[which[nothing]]] = here.excluded[nothing]
            if coarser == 1:
                found = found._replace(resolution_rad=max(found.resolution_rad, _coarsest(here)))
        for s, own in zip(alive, clear, strict=True):
            if len(own):
                front[s], found.x[s, row], found.best[s] = own, own[0], np.nan
                found.prefix[s] += 1
        alive = alive[[len(own) > 0 for own in clear]]
        if progress is not None:
            progress(row + 1, rows)
    return found


def _carried(kernels: Kernels, tip: TipCheck | None, inputs: LaneInputs, front: list[np.ndarray]) -> list[np.ndarray]:
    """Of each target's front the postures that are clear at the next, far apart, clearest first."""
    lane = np.repeat(np.arange(len(front)), [len(own) for own in front])
    here = kernels(PUSH, gather(inputs, lane), np.concatenate(front))
    return _clear(kernels, tip, gather(inputs, lane), lane, len(front), here)


def _searched(kernels: Kernels, tip: TipCheck | None, inputs: LaneInputs, here) -> list[np.ndarray]:
    """The same of what a search found."""
    lane = np.repeat(np.arange(len(here.x)), PUSHED)
    residual = np.where(here.clearance > -np.inf, 0.0, np.inf).ravel()  # others are not among them
    at = Anchored(here.x.reshape(len(lane), -1), here.clearance.ravel(), residual)
    return _clear(kernels, tip, gather(inputs, lane), lane, len(here.x), at)


def _clear(
    kernels: Kernels, tip: TipCheck | None, inputs: LaneInputs, lane: np.ndarray, lanes: int, here: Anchored
) -> list[np.ndarray]:
    good = kernels.task.counts(here.clearance, here.residual, inputs.margin_m)
    if tip is not None and good.any():
        good[good] = ~tip.at(gather(inputs, good), here.x[good])
    return [_dispersed(here.x[own], here.clearance[own]) for own in (good & (lane == k) for k in range(lanes))]


def _dispersed(x: np.ndarray, clearance: np.ndarray) -> np.ndarray:
    """CARRIED of the postures at most: the clearest, then always the one farthest from those chosen."""
    if not len(x):
        return x
    kept = [int(np.argmax(clearance))]
    away = np.linalg.norm(x - x[kept[0]], axis=1)
    while len(kept) < CARRIED and away.max() >= APART_RAD:
        kept.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(x - x[kept[-1]], axis=1))
    return x[kept]


def _coarsest(here) -> float:
    searched = here.resolution_rad[~here.excluded]
    return float(searched.max()) if len(searched) else 0.0
