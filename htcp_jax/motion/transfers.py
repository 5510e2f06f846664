"""Transfers and approaches: motions from the start to another configuration.

A transfer leads to another configuration at the first target, an approach to a configuration at the path's first point.
They are needed if no motion from the start's configuration reaches the path's end, or if the straight lines to the path
lead through a wall. On the approach the task is not required, so the arm may move to another configuration by any joint
path that is proven clear.
"""

import numpy as np
from jaxtyping import Float

from htcp_jax.device import tables
from htcp_jax.motion.collision_checker import CollisionChecker
from htcp_jax.motion.configurations import dispersed
from htcp_jax.motion.joint_search import Limits, join
from htcp_jax.motion.problem import Problem
from htcp_jax.motion.step_functions import State

DRAWS = 512  # configurations sampled at the first target
STREAM = 1_000_000  # first stream of random numbers; smaller ones belong to `joint_search`
MOST_ROOTS = 16  # maximum number of configurations to join


def other_configurations(problem: Problem, checker: CollisionChecker, s: int, round_: int, target: int = 0) -> State:
    """Return valid configurations of one scenario at a target, far apart from each other; new ones in every round.

    They are sampled uniformly within the joint limits, and not yet joined to the start. Among configurations that
    differ by multiples of 2 pi in a hinge, the one nearest to home is returned.

    Args:
        problem: The problem.
        checker: Collision checker of the scene.
        s: Row of the scenario.
        round_: Number of the round.
        target: Index of the target.
    """
    settings, drawn = problem.settings, drawn_configurations(problem, checker, s, round_)
    here = projected(problem, checker, s, target, drawn)
    found = tables.gather(here, checker.valid(problem.inputs(s, target, len(drawn)), here))
    one = np.zeros(len(found.x), int)
    return tables.gather(found, dispersed(found.x, one, settings.beam_width, settings.beam_separation_rad))


def projected(problem: Problem, checker: CollisionChecker, s: int, target: int, x: Float[np.ndarray, "n N"]) -> State:
    """Return the states of configurations after inverse kinematics onto a target of one scenario.

    If inverse kinematics does not converge, the residual is above the tolerance.

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
    """Return random configurations within the limits; unlimited joints are sampled within pi [rad or m] of `about`."""
    lower, upper = limits
    ends = np.where(np.isfinite(lower), lower, about - np.pi), np.where(np.isfinite(upper), upper, about + np.pi)
    drawn = rng.uniform(*ends, (DRAWS, len(lower)))
    turned = drawn - 2 * np.pi * np.where(slides, 0.0, np.rint((drawn - about) / (2 * np.pi)))
    return np.where((turned >= lower) & (turned <= upper), turned, drawn)


def _unwound(x: Float[np.ndarray, "n N"], limits: Limits, about: Float[np.ndarray, "N"]) -> Float[np.ndarray, "n N"]:
    """Return the configurations with multiples of 2 pi added to unlimited hinges: within pi of `about`."""
    endless = np.isinf(limits[0]) & np.isinf(limits[1])
    return np.where(endless, x - 2 * np.pi * np.rint((x - about) / (2 * np.pi)), x) if endless.any() else x


def joined(
    problem: Problem, checker: CollisionChecker, s: int, start: np.ndarray, to: Float[np.ndarray, "n N"]
) -> list[Float[np.ndarray, "_ N"] | None]:
    """Return the via points from `start` to the configuration in `to` that is joined in the fewest rounds of queries.

    Args:
        problem: The problem.
        checker: Collision checker of the scene.
        s: Row of the scenario.
        start: The configuration to begin at (N,) [rad or m].
        to: Configurations to join to it [rad or m]; only the first MOST_ROOTS are tried.

    Returns:
        A list with one entry per configuration in `to`: via points for the joined one, None for all others.
    """
    to = to[:MOST_ROOTS]
    scenario, pair = np.full(len(to), s), np.arange(len(to))
    starts = np.broadcast_to(start, to.shape)
    return join(checker, problem.scenarios, scenario, pair, starts, to, problem.settings, soonest=True)
