"""Joint paths from home to the start that are proven clear, for many scenarios at once.

    problem, from_home = leave_home(problem)           # before planning: chooses starts, and refuses scenarios
    plans = begin_at_home(problem, plans, from_home)   # after planning: the plans begin at home

Every method plans from the start, so these paths can be added to the plans of every method. If no start is given, it is
chosen among configurations sampled at the first target, the clearest first. Four configurations at a time are joined to
home; the start is the one joined in the fewest rounds of queries. Without a home, it is the clearest configuration.
All scenarios share the calls of lane functions: their trials are one table.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.device import tables
from htcp_jax.model import Scenario
from htcp_jax.model import scenario as scenario_functions
from htcp_jax.motion.collision_checker import CollisionChecker
from htcp_jax.motion.joint_search import join
from htcp_jax.motion.plans import Plans
from htcp_jax.motion.problem import Problem
from htcp_jax.motion.sparse_columns import ViaPoints
from htcp_jax.motion.transfers import DRAWS, other_configurations
from htcp_jax.status import Status

ROUNDS, FIRST_ROUND = 4, 100  # number of rounds of sampled starts; number of the first one, unused by transfers
TOGETHER, MOST_TRIED = 4, 16  # sampled starts that are joined at a time, and per round
PAIR = 500_000  # number of the first pair that begins at home; transfers use smaller numbers

ViaPointsFromHome = dict[int, Float[np.ndarray, "_ N"]]  # scenario -> via points from home to the start [rad or m]
Rows = Int[np.ndarray, "n"]


class Trials(NamedTuple):
    """Table of n configurations that may become starts, sorted by scenario and then by preference."""

    scenario: Rows
    pair: Int[np.ndarray, "n"]  # numbers of the pairs of home and x, which seed random numbers
    x: Float[np.ndarray, "n N"]  # [rad or m]


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
    rows = problem.to_plan[apart[problem.to_plan]]
    if not len(rows):
        return problem, {}
    parts = problem.in_threads(lambda checker, share: HomeConnector(problem, checker).run(rows[share]))
    x_start, refused, from_home = scenarios.x_start.copy(), scenarios.refused.copy(), ViaPointsFromHome()
    for s, start in (each for part in parts for each in part.items()):
        x_start[s], refused[s] = start.x, start.refused
        if start.via_points is not None:
            from_home[s] = start.via_points
    problem.progress(0, int((refused != scenarios.refused).sum()))
    return problem.with_scenarios(replace(scenarios, x_start=x_start, refused=refused)), from_home


def most_draws(scenarios: Scenario) -> int:
    """Return the maximum number of configurations that are drawn to find the starts of stacked scenarios."""
    is_chosen = scenarios.auto_start & (scenarios.refused == scenario_functions.NOT_REFUSED)
    return ROUNDS * DRAWS * int(is_chosen.sum())


class HomeConnector:
    """Search that joins home to the start for many scenarios together."""

    def __init__(self, problem: Problem, checker: CollisionChecker):
        self._problem, self._checker, self._scenarios = problem, checker, problem.scenarios
        self._starts: dict[int, Start] = {}

    def run(self, rows: Rows) -> dict[int, Start]:
        """Return the starts of some scenarios, whose rows ascend."""
        scenarios, anywhere = self._scenarios, self._problem.begins_anywhere[rows]
        self._choose_without_home(rows[anywhere])
        leave = self._clear(rows[~anywhere], scenarios.x_home, Status.HOME_IN_COLLISION)
        is_chosen = scenarios.auto_start[leave]
        arrive = self._clear(leave[~is_chosen], scenarios.x_start, Status.START_IN_COLLISION)
        self._join(Trials(arrive, np.full(len(arrive), PAIR), scenarios.x_start[arrive]))
        chosen = self._without_start(leave[is_chosen], Status.NO_START)
        for round_ in range(ROUNDS):
            self._join(self._sampled(self._not_joined(chosen), round_))
        return self._starts

    def _without_start(self, rows: Rows, status: Status) -> Rows:
        """Store a status as the reason why scenarios cannot begin, until a start is found; return the scenarios."""
        self._starts |= {s: Start(self._scenarios.x_start[s], status) for s in rows.tolist()}
        return rows

    def _not_joined(self, rows: Rows) -> Rows:
        return np.array([s for s in rows.tolist() if self._starts[s].via_points is None], int)

    def _choose_without_home(self, rows: Rows) -> None:
        """Choose the starts of scenarios without a home: the clearest one of the first round with a valid start."""
        self._without_start(rows, Status.NO_START)
        for round_ in range(ROUNDS):
            trials = self._sampled(rows, round_)
            clearest = tables.gather(trials, np.flatnonzero(np.diff(trials.scenario, prepend=-1)))
            self._starts |= {s: Start(x) for s, x in zip(clearest.scenario.tolist(), clearest.x, strict=True)}
            self._problem.progress(0, 0, len(clearest.x))
            rows = np.setdiff1d(rows, clearest.scenario)

    def _clear(self, rows: Rows, x: Float[np.ndarray, "S N"], status: Status) -> Rows:
        """Return the scenarios whose configuration in x is clear; store a status as that of the others."""
        if not len(rows):
            return rows
        clear = self._checker.states(self._problem.inputs(rows, 0), x[rows]).clearance > 0
        self._without_start(rows[~clear], status)
        return rows[clear]

    def _sampled(self, rows: Rows, round_: int) -> Trials:
        """Return a round of trials: valid configurations at the first targets, the clearest of each scenario first."""
        if not len(rows):
            return Trials(rows, rows, self._scenarios.x_start[rows])
        self._problem.progress(0, 0, 0)
        at, lane = other_configurations(self._problem, self._checker, rows, FIRST_ROUND + round_)
        self._problem.progress(0, 0, 0, len(rows) * DRAWS)
        order, place = np.lexsort((-at.clearance, lane)), np.arange(len(lane)) - np.searchsorted(lane, lane)
        pair = PAIR + round_ * MOST_TRIED + place
        return tables.gather(Trials(rows[lane], pair, at.x[order]), place < MOST_TRIED)

    def _join(self, trials: Trials) -> None:
        """Join home to trials, and store the one joined in the fewest rounds of queries as its scenario's start."""
        scenarios, settings = self._scenarios, self._problem.settings
        rows = self._without_start(np.unique(trials.scenario), Status.HOME_NOT_JOINED)
        group, report = (trials.pair - PAIR) % MOST_TRIED // TOGETHER, partial(self._problem.progress, 0, 0)
        for number in range(MOST_TRIED // TOGETHER):
            now = (group == number) & np.isin(trials.scenario, self._not_joined(rows))
            s, pair, x = tables.gather(trials, now)
            home = scenarios.x_home[s]
            joined = join(self._checker, scenarios, s, pair, home, x, settings, soonest=True, report=report)
            found = zip(s.tolist(), x, joined, strict=True)
            self._starts |= {s: Start(x, via_points=each) for s, x, each in found if each is not None}


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
