"""Transfers: from the start to other postures at the first target, which lead further.

A start may be in a part of the space of postures from which no motion along the path gets through, or not to the end.
Before the path the tool is free, so the arm may change its posture there by any joint path that is proven clear.
"""

import numpy as np

from htcp_jax.planner.front import Node, dispersed
from htcp_jax.planner.joint_search import join
from htcp_jax.planner.kernels import ADVANCE, SETTLE
from htcp_jax.planner.lane_inputs import lane_inputs
from htcp_jax.planner.problem import Problem
from htcp_jax.planner.programs import Kernels
from htcp_jax.planner.tip_check import TipCheck, out_of_walls

DRAWS = 512  # of postures at the first target
STREAM = 1_000_000  # of random numbers; those before it are of `joint_search`
MOST_ROOTS = 16  # that are tried to be joined


def other_postures(problem: Problem, kernels: Kernels, tip: TipCheck | None, s: int, round_: int) -> list[Node]:
    """Postures of scenario s at its first target that count, drawn uniformly within the joint limits and far apart,
    others in every round; how the arm gets there is not asked."""
    scenarios, settings = problem.scenarios, problem.settings
    rng = np.random.default_rng([settings.seed, int(scenarios.number[s]), STREAM + round_])
    lower, upper = kernels.limits
    inputs = lane_inputs(scenarios, np.full(DRAWS, s), np.zeros(DRAWS, int))
    x = kernels(SETTLE, inputs, rng.uniform(lower, upper, (DRAWS, len(lower))))
    here = kernels(ADVANCE, inputs, x, np.zeros_like(x))
    good = problem.task.counts(here.clearance, here.residual, scenarios.margin_m[s])
    good = out_of_walls(tip, inputs, x, good)
    nodes = [Node(x[k], here.clearance[k], here.residual[k], here.tcp[k], 0) for k in np.flatnonzero(good)]
    return dispersed(nodes, settings.front, settings.front_apart_rad)


def joined(
    problem: Problem, kernels: Kernels, tip: TipCheck | None, s: int, leaves: list[Node]
) -> tuple[Node, np.ndarray] | None:
    """The first of the leaves whose root can be reached from the start of scenario s, and the knots on the way there;
    None where none can."""
    roots = list(dict.fromkeys(leaf.root for leaf in leaves))[:MOST_ROOTS]
    start, scenario = problem.scenarios.x_start[s], np.full(len(roots), s)
    to, pair = np.stack([root.x for root in roots]), np.arange(len(roots))
    ways = join(kernels, tip, problem.scenarios, scenario, pair, np.broadcast_to(start, to.shape), to, problem.settings)
    known = dict(zip(roots, ways, strict=True))
    return next(((leaf, way) for leaf in leaves if (way := known.get(leaf.root)) is not None), None)
