"""Joint paths from home to the start that are proven clear, for many scenarios at once.

    ways = leave_home(problem)            # before planning: chooses starts, and refuses scenarios
    begin_at_home(problem, plans, ways)   # afterwards: the plans begin at home

Any method plans from the start, so all of them can begin at home. A start that is not given is chosen among the
clearest configurations sampled at the path's first point: of four at a time, the one joined to home in the fewest
rounds of queries; without a home, the clearest.
"""

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.device.programs import Kernels
from htcp_jax.model.scenario import NOT_REFUSED
from htcp_jax.motion.joint_search import join
from htcp_jax.motion.kernels import ADVANCE
from htcp_jax.motion.knots import Knots
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.motion.plans import Plans
from htcp_jax.motion.problem import Problem
from htcp_jax.motion.tip_check import TipCheck, tip_checks
from htcp_jax.motion.transfers import other_postures
from htcp_jax.status import Status

ROUNDS, FIRST_ROUND = 4, 100  # rounds of sampled starts; numbered beyond those of transfers
TOGETHER, MOST_TRIED = 4, 16  # starts of a round to join at a time, and in total
PAIR = 500_000  # first number of pairs that begin at home; smaller ones belong to transfers

Ways = dict[int, Float[np.ndarray, "_ N"]]  # by scenario: the via points from home to the start


class Trial(NamedTuple):
    """A candidate for the start of a scenario."""

    scenario: int
    pair: int
    x: Float[np.ndarray, "N"]


def leave_home(problem: Problem) -> Ways:
    """Return the via points from home to the start, for every scenario with a start other than home. Chosen starts are
    written into the problem's scenarios; scenarios without such a path are refused there."""
    scenarios = problem.scenarios
    apart = scenarios.auto_start | (scenarios.x_home != scenarios.x_start).any(axis=1)
    rows = problem.to_plan[apart[problem.to_plan]].tolist()
    if not rows:
        return {}
    kernels = problem.kernels  # made here, before there are threads
    tips = tip_checks(kernels, problem.tip_guard)

    def work(number: int) -> Ways:
        own = number % len(kernels)
        return Leaving(problem, kernels[own], tips[own]).run(rows[number :: problem.threads])

    with ThreadPoolExecutor(problem.threads) as pool:
        ways = {s: way for part in pool.map(work, range(problem.threads)) for s, way in part.items()}
    problem.progress(0, len(rows) - len(ways))
    return ways


class Leaving:
    """Join home to the start for many scenarios together."""

    def __init__(self, problem: Problem, kernels: Kernels, tip: TipCheck | None):
        self._problem, self._kernels, self._tip = problem, kernels, tip

    def run(self, rows: list[int]) -> Ways:
        """Return the via points from home of the scenarios that are joined; the others are refused with their
        status."""
        scenarios, ways = self._problem.scenarios, Ways()
        anywhere = self._problem.begins_anywhere
        self._begin([s for s in rows if anywhere[s]])
        rows = [s for s in rows if not anywhere[s]]
        rows = self._clear(rows, scenarios.x_home, Status.HOME_IN_COLLISION)
        chosen = [s for s in rows if scenarios.auto_start[s]]
        given = self._clear([s for s in rows if s not in chosen], scenarios.x_start, Status.START_IN_COLLISION)
        ways |= self._joined({s: [Trial(s, PAIR, scenarios.x_start[s])] for s in given})
        scenarios.refused[given] = Status.HOME_NOT_JOINED
        scenarios.refused[chosen] = Status.NO_START
        for round_ in range(ROUNDS):
            trials = {s: self._drawn(s, round_) for s in chosen if s not in ways}
            scenarios.refused[[s for s, found in trials.items() if found]] = Status.HOME_NOT_JOINED
            ways |= self._joined(trials)
        scenarios.refused[list(ways)] = NOT_REFUSED
        return ways

    def _begin(self, rows: list[int]) -> None:
        """Choose the start of scenarios without a home: the clearest configuration of the first round that finds a
        valid one."""
        scenarios = self._problem.scenarios
        for s in rows:
            found = (self._drawn(s, round_) for round_ in range(ROUNDS))
            if (trials := next(filter(None, found), None)) is None:
                scenarios.refused[s] = Status.NO_START
            else:
                scenarios.x_start[s] = trials[0].x

    def _clear(self, rows: list[int], x: Float[np.ndarray, "S N"], otherwise: Status) -> list[int]:
        """Return the scenarios that are clear at their x; the others are refused."""
        if not rows:
            return []
        inputs = lane_inputs(self._problem.scenarios, np.array(rows), np.zeros(len(rows), int))
        clear = self._kernels(ADVANCE, inputs, x[rows], np.zeros_like(x[rows])).clearance > 0
        self._problem.scenarios.refused[np.array(rows)[~clear]] = otherwise
        return np.array(rows)[clear].tolist()

    def _drawn(self, s: int, round_: int) -> list[Trial]:
        """Return configurations at the first target, the clearest first."""
        found = other_postures(self._problem, self._kernels, self._tip, s, FIRST_ROUND + round_)
        clearest = found.x[np.argsort(-found.clearance, kind="stable")[:MOST_TRIED]]
        return [Trial(s, PAIR + round_ * MOST_TRIED + k, x) for k, x in enumerate(clearest)]

    def _joined(self, trials: dict[int, list[Trial]]) -> Ways:
        """Return each scenario's path to the candidate joined in the fewest rounds of queries, which becomes its
        start."""
        ways, scenarios = Ways(), self._problem.scenarios
        for first in range(0, MOST_TRIED, TOGETHER):
            now = [one for s, own in trials.items() if s not in ways for one in own[first : first + TOGETHER]]
            if not now:
                break
            s, pair = np.array([one.scenario for one in now]), np.array([one.pair for one in now])
            to, settings = np.stack([one.x for one in now]), self._problem.settings
            found = join(self._kernels, self._tip, scenarios, s, pair, scenarios.x_home[s], to, settings, soonest=True)
            for one, way in zip(now, found, strict=True):
                if way is not None and one.scenario not in ways:
                    ways[one.scenario], scenarios.x_start[one.scenario] = way, one.x
        return ways


def begin_at_home(problem: Problem, plans: Plans, ways: Ways) -> Plans:
    """Return the plans with the paths from home prepended: starts become via points on the segment to the first
    target."""
    scenarios = problem.scenarios
    mine = (plans.start == scenarios.x_start).all(axis=1) & ~scenarios.begins_anywhere
    plans.start[mine] = scenarios.x_home[mine]
    if not ways:
        return plans
    begun = [s for s in ways if mine[s] and plans.tracked[s, 0]]
    knots = [(s, 0, way) for s in begun for way in (ways[s], scenarios.x_start[s][None])]
    knots += [(s, t, x[None]) for s, t, x in zip(*map(np.ndarray.tolist, plans.knots[:2]), plans.knots.x, strict=True)]
    plans = plans._replace(knots=Knots.of(knots, plans.x.shape[2]))
    plans.joint_step[begun, 0] = np.linalg.norm(plans.x[begun, 0] - plans.start[begun], axis=1)
    return plans
