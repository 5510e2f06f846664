"""Joint paths from home to the start that are proven clear, for many scenarios at once.

    problem, from_home = leave_home(problem)           # before planning: chooses starts, and refuses scenarios
    plans = begin_at_home(problem, plans, from_home)   # after planning: the plans begin at home

Every method plans from the start, so these paths can be added to the plans of every method. If no start is given, it is
chosen among configurations sampled at the first target, the clearest first. Four configurations at a time are joined to
home; the start is the one joined in the fewest rounds of queries. Without a home, it is the clearest configuration.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.model import Scenario
from htcp_jax.model import scenario as scenario_functions
from htcp_jax.motion.collision_checker import CollisionChecker
from htcp_jax.motion.joint_search import join
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.motion.plans import Plans
from htcp_jax.motion.problem import Problem
from htcp_jax.motion.sparse_columns import ViaPoints
from htcp_jax.motion.transfers import other_configurations
from htcp_jax.status import Status

ROUNDS, FIRST_ROUND = 4, 100  # number of rounds of sampled starts; number of the first one, unused by transfers
TOGETHER, MOST_TRIED = 4, 16  # sampled starts that are joined at a time, and per round
PAIR = 500_000  # number of the first pair that begins at home; transfers use smaller numbers

ViaPointsFromHome = dict[int, Float[np.ndarray, "_ N"]]  # scenario -> via points from home to the start [rad or m]


class Trial(NamedTuple):
    """A configuration that may become the start of a scenario."""

    scenario: int
    pair: int  # number of the pair of home and x, which seeds random numbers
    x: Float[np.ndarray, "N"]  # [rad or m]


class Start(NamedTuple):
    """The start of a scenario."""

    x: Float[np.ndarray, "N"]  # [rad or m]
    refused: int = scenario_functions.NOT_REFUSED  # or the Status of a scenario that cannot begin
    via_points: Float[np.ndarray, "_ N"] | None = None  # the via points from home; None if there is no home


def leave_home(problem: Problem) -> tuple[Problem, ViaPointsFromHome]:
    """Return the problem with all starts chosen, and the via points from home to the start.

    Scenarios that cannot begin are marked as refused. All other scenarios whose start is not home get via points, which
    may be an empty array.
    """
    scenarios = problem.scenarios
    apart = scenarios.auto_start | (scenarios.x_home != scenarios.x_start).any(axis=1)
    rows = problem.to_plan[apart[problem.to_plan]].tolist()
    if not rows:
        return problem, {}
    parts = problem.in_threads(lambda checker, share: HomeConnector(problem, checker).run(rows[share]))
    x_start, refused, from_home = scenarios.x_start.copy(), scenarios.refused.copy(), ViaPointsFromHome()
    for s, start in (each for part in parts for each in part.items()):
        x_start[s], refused[s] = start.x, start.refused
        if start.via_points is not None:
            from_home[s] = start.via_points
    problem.progress(0, int((refused != scenarios.refused).sum()))
    return problem.with_scenarios(replace(scenarios, x_start=x_start, refused=refused)), from_home


class HomeConnector:
    """Search that joins home to the start for many scenarios together."""

    def __init__(self, problem: Problem, checker: CollisionChecker):
        self._problem, self._checker = problem, checker

    def run(self, rows: list[int]) -> dict[int, Start]:
        """Return the starts of some scenarios."""
        x_home, x_start, anywhere = self._scenarios.x_home, self._scenarios.x_start, self._problem.begins_anywhere
        starts = {s: self._without_home(s) for s in rows if anywhere[s]}
        rows = [s for s in rows if not anywhere[s]]
        leave = self._clear(rows, x_home)
        chosen = [s for s in leave if self._scenarios.auto_start[s]]
        given = [s for s in leave if s not in chosen]
        arrive = self._clear(given, x_start)
        starts |= {s: Start(x_start[s], Status.HOME_IN_COLLISION) for s in rows}
        starts |= {s: Start(x_start[s], Status.START_IN_COLLISION) for s in given}
        starts |= {s: Start(x_start[s], Status.NO_START) for s in chosen}
        starts |= self._joined({s: [Trial(s, PAIR, x_start[s])] for s in arrive})
        for round_ in range(ROUNDS):
            trials = {s: self._drawn(s, round_) for s in chosen if starts[s].via_points is None}
            starts |= self._joined({s: found for s, found in trials.items() if found})
        return starts

    @property
    def _scenarios(self) -> Scenario:
        return self._problem.scenarios

    def _without_home(self, s: int) -> Start:
        """Return the start of a scenario without a home: the clearest one of the first round with a valid start."""
        for round_ in range(ROUNDS):
            if found := self._drawn(s, round_):
                return Start(found[0].x)
        return Start(self._scenarios.x_start[s], Status.NO_START)

    def _clear(self, rows: list[int], x: Float[np.ndarray, "S N"]) -> list[int]:
        """Return the scenarios whose configuration in x is clear."""
        if not rows:
            return []
        inputs = lane_inputs(self._scenarios, np.array(rows), np.zeros(len(rows), int))
        return np.array(rows)[self._checker.states(inputs, x[rows]).clearance > 0].tolist()

    def _drawn(self, s: int, round_: int) -> list[Trial]:
        """Return one round of trials: valid configurations at the first target, the clearest first."""
        found, _ = other_configurations(self._problem, self._checker, np.array([s]), FIRST_ROUND + round_)
        clearest = found.x[np.argsort(-found.clearance, kind="stable")[:MOST_TRIED]]
        return [Trial(s, PAIR + round_ * MOST_TRIED + k, x) for k, x in enumerate(clearest)]

    def _joined(self, trials: dict[int, list[Trial]]) -> dict[int, Start]:
        """Return each scenario's start: the trial joined in the fewest rounds of queries, with its via points."""
        scenarios, settings = self._scenarios, self._problem.settings
        starts = {s: Start(scenarios.x_start[s], Status.HOME_NOT_JOINED) for s in trials}
        for first in range(0, MOST_TRIED, TOGETHER):
            open_ = [own[first : first + TOGETHER] for s, own in trials.items() if starts[s].via_points is None]
            now = [trial for own in open_ for trial in own]
            if not now:
                break
            s, pair, to = (np.array(column) for column in zip(*now, strict=True))
            found = join(self._checker, scenarios, s, pair, scenarios.x_home[s], to, settings, soonest=True)
            joined = [
                (trial, via_points) for trial, via_points in zip(now, found, strict=True) if via_points is not None
            ]
            starts |= {trial.scenario: Start(trial.x, via_points=via_points) for trial, via_points in joined}
        return starts


def begin_at_home(problem: Problem, plans: Plans, from_home: ViaPointsFromHome) -> Plans:
    """Return the plans with the paths from home prepended.

    Each start becomes a via point on the segment from home to the first target.

    Args:
        problem: The problem from `leave_home`.
        plans: The problem's plans, which begin at the starts.
        from_home: The via points from `leave_home`.
    """
    scenarios, plans = problem.scenarios, plans.with_own("start", "joint_step")
    mine = (plans.start == scenarios.x_start).all(axis=1) & ~scenarios.begins_anywhere
    plans.start[mine] = scenarios.x_home[mine]
    if not from_home:
        return plans
    begun = [s for s in from_home if mine[s] and plans.tracked[s, 0]]
    plans.joint_step[begun, 0] = np.linalg.norm(plans.x[begun, 0] - plans.start[begun], axis=1)
    via_points = [(s, 0, via_points) for s in begun for via_points in (from_home[s], scenarios.x_start[s][None])]
    via_points += [
        (s, t, x[None])
        for s, t, x in zip(*map(np.ndarray.tolist, plans.via_points[:2]), plans.via_points.x, strict=True)
    ]
    return plans._replace(via_points=ViaPoints.of(via_points, plans.x.shape[2]))
