"""Transfers and approaches: from the start to other configurations at the first target, or at the path's first point.

The start may be in a component of the configuration space from which no motion along the path reaches its end; and the
straight lines to the path may lead through a wall. Before the path the tool is free, so the arm may move to another
configuration there by any joint path that is proven clear.
"""

import numpy as np
from jaxtyping import Float

from htcp_jax.device import tables
from htcp_jax.motion.collision_checker import CollisionChecker
from htcp_jax.motion.joint_search import Limits, join
from htcp_jax.motion.problem import Problem
from htcp_jax.motion.selection import dispersed
from htcp_jax.motion.step_functions import State

DRAWS = 512  # configurations sampled at the first target
STREAM = 1_000_000  # first stream of random numbers; smaller ones belong to `joint_search`
MOST_ROOTS = 16  # maximum number of configurations to join


def other_configurations(problem: Problem, checker: CollisionChecker, s: int, round_: int, target: int = 0) -> State:
    """Return valid configurations of one scenario at a target, far apart, and new ones in every round.

    They are sampled uniformly within the joint limits, and not yet joined to the start. Of equivalent joint turns,
    those nearest to home are returned.

    Args:
        problem: The problem.
        checker: Collision checker of the scene.
        s: Row of the scenario.
        round_: Number of the round.
        target: The target.
    """
    settings, drawn = problem.settings, drawn_configurations(problem, checker, s, round_)
    here = projected(problem, checker, s, target, drawn)
    found = tables.gather(here, checker.valid(problem.inputs(s, target, len(drawn)), here))
    one = np.zeros(len(found.x), int)
    return tables.gather(found, dispersed(found.x, one, settings.beam_width, settings.beam_separation_rad))


def projected(problem: Problem, checker: CollisionChecker, s: int, target: int, x: Float[np.ndarray, "n N"]) -> State:
    """Return configurations of one scenario brought onto a target, as far as inverse kinematics gets, and measured.

    Args:
        problem: The problem.
        checker: Collision checker of the scene.
        s: Row of the scenario.
        target: The target.
        x: The configurations [rad or m].
    """
    inputs = problem.inputs(s, target, len(x))
    x = _unwound(checker.project(inputs, x), checker.executor.limits, _about(problem, s))
    return checker.states(inputs, x)._replace(x=x, linear=None)


def drawn_configurations(
    problem: Problem, checker: CollisionChecker, s: int, round_: int
) -> Float[np.ndarray, "DRAWS N"]:
    """Return random configurations of one scenario within the joint limits [rad or m], new ones in every round.

    Args:
        problem: The problem.
        checker: Collision checker of the scene.
        s: Row of the scenario.
        round_: Number of the round.
    """
    rng = np.random.default_rng([problem.settings.seed, int(problem.scenarios.number[s]), STREAM + round_])
    return _sampled_configurations(problem.robot.slides, checker.executor.limits, _about(problem, s), rng)


def _about(problem: Problem, s: int) -> Float[np.ndarray, "N"]:
    """Return the configuration about which unlimited joints are sampled."""
    return problem.scenarios.x_start[s] if problem.begins_anywhere[s] else problem.scenarios.x_home[s]


def _sampled_configurations(
    slides: tuple[bool, ...], limits: Limits, about: Float[np.ndarray, "N"], rng: np.random.Generator
) -> Float[np.ndarray, "DRAWS N"]:
    """Sample configurations within the limits; unlimited joints within half a turn of `about`."""
    lower, upper = limits
    ends = np.where(np.isfinite(lower), lower, about - np.pi), np.where(np.isfinite(upper), upper, about + np.pi)
    drawn = rng.uniform(*ends, (DRAWS, len(lower)))
    turned = drawn - 2 * np.pi * np.where(slides, 0.0, np.rint((drawn - about) / (2 * np.pi)))
    return np.where((turned >= lower) & (turned <= upper), turned, drawn)


def _unwound(x: Float[np.ndarray, "n N"], limits: Limits, about: Float[np.ndarray, "N"]) -> Float[np.ndarray, "n N"]:
    """Return the same configurations with unlimited joints within half a turn of those of `about`."""
    endless = np.isinf(limits[0]) & np.isinf(limits[1])
    return np.where(endless, x - 2 * np.pi * np.rint((x - about) / (2 * np.pi)), x) if endless.any() else x


def joined(
    problem: Problem, checker: CollisionChecker, s: int, start: np.ndarray, to: Float[np.ndarray, "n N"]
) -> list[Float[np.ndarray, "_ N"] | None]:
    """Return the via points from one configuration to the one of `to` that is joined in the fewest rounds of queries.

    Args:
        problem: The problem.
        checker: Collision checker of the scene.
        s: Row of the scenario.
        start: The configuration (N,) [rad or m].
        to: The other ends [rad or m]; only the first MOST_ROOTS are tried.

    Returns:
        Via points for that one, None for the others, and for all if none can be joined.
    """
    to = to[:MOST_ROOTS]
    scenario, pair = np.full(len(to), s), np.arange(len(to))
    starts = np.broadcast_to(start, to.shape)
    return join(checker, problem.scenarios, scenario, pair, starts, to, problem.settings, soonest=True)
