"""Transfers and approaches: motions from the start to another configuration.

A transfer leads to another configuration at the first target, an approach to a configuration at the path's first point.
They are needed if no motion from the start's configuration reaches the path's end, or if the straight lines to the path
lead through a wall. On the approach the task is not required, so the arm may move to another configuration by any joint
path that is proven clear.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.device import tables
from htcp_jax.model import kinematics
from htcp_jax.motion.collision_checker import CollisionChecker
from htcp_jax.motion.configurations import dispersed
from htcp_jax.motion.joint_search import Limits, join
from htcp_jax.motion.problem import Problem
from htcp_jax.motion.step_functions import State
from htcp_jax.numerics import ragged_rows

DRAWS = 512  # configurations sampled at a target of one scenario
TOGETHER = tables.PORTION // DRAWS  # number of scenarios sampled together, which limits the memory
STREAM = 1_000_000  # first stream of random numbers; smaller ones belong to `joint_search`
MOST_ROOTS = 16  # maximum number of configurations to join


def other_configurations(
    problem: Problem,
    checker: CollisionChecker,
    scenario: Int[np.ndarray, "n"],
    round_: int | Int[np.ndarray, "n"],
    target: int | Int[np.ndarray, "n"] = 0,
) -> tuple[State, Int[np.ndarray, "m"]]:
    """Return valid configurations at targets of many scenarios, far apart from each other; new ones in every round.

    They are sampled uniformly within the joint limits, and not yet joined to the start. Among configurations that
    differ by multiples of 2 pi in a hinge, the one nearest to home is returned.

    Args:
        problem: The problem.
        checker: Collision checker of the scene.
        scenario: Row of each scenario.
        round_: Number of the round, or one for each scenario.
        target: Index of the target, or one for each scenario.

    Returns:
        The states of all configurations, and the index of each one's scenario in `scenario`, in ascending order.
    """
    settings, count = problem.settings, len(scenario)
    round_, target = np.broadcast_to(round_, count), np.broadcast_to(target, count)
    parts = []
    for first in range(0, count, TOGETHER):
        own = np.arange(first, min(first + TOGETHER, count))
        drawn, lane = drawn_configurations(problem, checker, scenario[own], round_[own]), np.repeat(own, DRAWS)
        x = _on_targets(problem, checker, scenario[lane], target[lane], np.concatenate(drawn))
        hopeful = checker.may_be_valid(problem.inputs(scenario[lane], target[lane]), x)
        hopeful = hopeful | (np.arange(len(x)) == 0)  # a call needs at least one lane
        lane, x = tables.gather((lane, x), hopeful)
        inputs = problem.inputs(scenario[lane], target[lane])
        here = checker.states(inputs, x)._replace(x=x, linear=None)
        here, lane = tables.gather((here, lane), checker.valid(inputs, here))
        apart = dispersed(here.x, lane, settings.beam_width, settings.beam_separation_rad)
        parts.append(tables.gather((here, lane), apart))
    return tables.concatenate(parts)


def projected(
    problem: Problem,
    checker: CollisionChecker,
    scenario: Int[np.ndarray, "n"],
    target: int | Int[np.ndarray, "n"],
    x: Float[np.ndarray, "n N"],
    still: bool = False,
) -> State:
    """Return the states of configurations after inverse kinematics onto targets of their scenarios.

    If inverse kinematics does not converge, the residual is above the tolerance.

    Args:
        problem: The problem.
        checker: Collision checker of the scene.
        scenario: Row of each configuration's scenario.
        target: Index of the target, or one for each configuration.
        x: The configurations [rad or m].
        still: True if indexed axes do not move.
    """
    x = _on_targets(problem, checker, scenario, target, x, still)
    return checker.states(problem.inputs(scenario, target), x)._replace(x=x, linear=None)


def _on_targets(
    problem: Problem, checker: CollisionChecker, scenario, target, x, still: bool = False
) -> Float[np.ndarray, "n N"]:
    """Return configurations after inverse kinematics, see `projected` [rad or m]."""
    periodic, about = np.asarray(kinematics.is_periodic(problem.robot)), _about(problem, scenario)
    inputs = problem.inputs(scenario, target)
    if still:
        inputs = problem.with_still_joints(inputs, scenario, problem.scenarios.on_path[scenario] + 1)
    return _unwound(checker.project(inputs, x), periodic, checker.executor.limits, about)


def drawn_configurations(
    problem: Problem, checker: CollisionChecker, scenario: Int[np.ndarray, "n"], round_: int | Int[np.ndarray, "n"]
) -> Float[np.ndarray, "n DRAWS N"]:
    """Return random configurations of many scenarios within the joint limits [rad or m], new ones in every round.

    Unlimited joints are sampled within pi of home.

    Args:
        problem: The problem.
        checker: Collision checker of the scene.
        scenario: Row of each scenario; the same one several times for several rounds.
        round_: Number of the round, or one for each scenario.
    """
    seed, about, limits = problem.settings.seed, _about(problem, scenario)[:, None], checker.executor.limits
    lower = np.where(np.isfinite(limits[0]), limits[0], about - np.pi)
    upper = np.where(np.isfinite(limits[1]), limits[1], about + np.pi)
    drawn = np.empty((len(scenario), DRAWS, about.shape[2]))
    numbers = problem.scenarios.number[scenario], np.broadcast_to(round_, len(scenario))
    for own, number, of in zip(drawn, *numbers, strict=True):
        np.random.default_rng([seed, int(number), STREAM + int(of)]).random(out=own)
    drawn = lower + (upper - lower) * drawn
    periodic = np.asarray(kinematics.is_periodic(problem.robot))
    turned = drawn - 2 * np.pi * np.where(periodic, np.rint((drawn - about) / (2 * np.pi)), 0.0)
    return np.where((turned >= limits[0]) & (turned <= limits[1]), turned, drawn)


def _about(problem: Problem, scenario: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n N"]:
    """Return the configurations about which unlimited joints are sampled."""
    anywhere = problem.begins_anywhere[scenario, None]
    return np.where(anywhere, problem.scenarios.x_start[scenario], problem.scenarios.x_home[scenario])


def _unwound(
    x: Float[np.ndarray, "n N"],
    periodic: Bool[np.ndarray, "N"],
    limits: Limits,
    about: Float[np.ndarray, "n N"],
) -> Float[np.ndarray, "n N"]:
    """Return the configurations with multiples of 2 pi added to unlimited hinges: within pi of `about`."""
    endless = periodic & np.isinf(limits[0]) & np.isinf(limits[1])
    return np.where(endless, x - 2 * np.pi * np.rint((x - about) / (2 * np.pi)), x) if endless.any() else x


def joined(
    problem: Problem,
    checker: CollisionChecker,
    scenario: Int[np.ndarray, "n"],
    start: Float[np.ndarray, "n N"],
    to: Sequence[Float[np.ndarray, "_ N"]],
) -> list[list[Float[np.ndarray, "_ N"] | None]]:
    """Join configurations to the starts of scenarios: for each start, the one joined in the fewest rounds of queries.

    Args:
        problem: The problem.
        checker: Collision checker of the scene.
        scenario: Rows of n scenarios, all different.
        start: The configurations to begin at [rad or m].
        to: Configurations to join to each of them [rad or m]; only the first MOST_ROOTS are tried.

    Returns:
        A list per scenario with one entry per configuration tried: via points for the joined one, None for all others.
    """
    to = [each[:MOST_ROOTS] for each in to]
    row, pair = ragged_rows(np.array([len(each) for each in to], int))
    ends = np.concatenate(to) if to else start
    found = join(checker, problem.scenarios, scenario[row], pair, start[row], ends, problem.settings, soonest=True)
    last = np.cumsum([len(each) for each in to]).tolist()
    return [found[end - len(each) : end] for end, each in zip(last, to, strict=True)]
