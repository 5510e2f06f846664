"""Targets that repeat the place before them: the planner plans each place once.

Consecutive targets of the path within ONE_POINT_M and ONE_TURN_RAD are one place. The arm passes it in one
configuration, without a stop. Methods, proofs and smoothing see the distinct places only. After planning, the plans
have one row per target of the file again: the repeated targets have the configuration of their place. A change of the
configuration there is a dwell at the last target of the place.
"""

from collections.abc import Callable
from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Bool, Int

from htcp_jax.model import ONE_POINT_M, Scenario, Task
from htcp_jax.motion import Plans, Problem
from htcp_jax.motion import lane_inputs as lane_tables
from htcp_jax.motion import plans as plan_arrays
from htcp_jax.planning.tracking.record import with_separate_errors
from htcp_jax.status import MOTION, SegmentStatus, Status

ONE_TURN_RAD = 1e-4  # largest angle between the orientations of targets at one place


def are_distinct(scenarios: Scenario, task: Task) -> Bool[np.ndarray, "S T"]:
    """Return False for targets of the path that repeat the place before them.

    Args:
        scenarios: Stacked scenarios.
        task: The constraints at every target.
    """
    t = np.arange(scenarios.targets.shape[1])
    on_path = (t > np.reshape(scenarios.on_path, (-1, 1))) & (t < np.reshape(scenarios.count, (-1, 1)))
    found = np.ones(on_path.shape, bool)
    close = np.linalg.norm(np.diff(scenarios.targets, axis=1), axis=2) <= ONE_POINT_M
    s, t = np.nonzero(on_path[:, 1:] & close)
    found[s, t + 1] = ~_at_one_place(scenarios, task, s, t, t + 1)
    if found.all():
        return found
    place = np.array(scenarios.on_path)  # the first target of the last place
    for t in range(1, on_path.shape[1]):
        s = np.flatnonzero(on_path[:, t] & (place != t - 1))
        found[s, t] = ~_at_one_place(scenarios, task, s, place[s], np.full(len(s), t))
        place = np.where(on_path[:, t] & found[:, t], t, place)
    return found


def _at_one_place(
    scenarios: Scenario, task: Task, s: Int[np.ndarray, "n"], a: Int[np.ndarray, "n"], b: Int[np.ndarray, "n"]
) -> Bool[np.ndarray, "n"]:
    """Return True where the targets a and b of scenarios s are at one place."""
    targets, goals = np.asarray(scenarios.targets), np.asarray(scenarios.goals)
    near = np.linalg.norm(targets[s, a] - targets[s, b], axis=1) <= ONE_POINT_M
    k = np.flatnonzero(near)
    for part, first in zip(task.parts, task.starts, strict=True):
        pair = np.stack([goals[s[k], a[k]], goals[s[k], b[k]]], axis=1)[..., first : first + part.numbers]
        difference = np.abs(pair[:, 0] - pair[:, 1]).max(axis=1, initial=0.0)
        near[k] &= difference <= (ONE_TURN_RAD if part.turns else ONE_POINT_M)
        near[k] &= part.turn(pair) <= ONE_TURN_RAD
    return near


def planned(plan: Callable[[Problem], Plans], problem: Problem) -> Plans:
    """Return the plans of a problem in which some targets may be repeated.

    If the configuration of a place does not satisfy the task at a repeated target, all targets of that scenario are
    planned.

    Args:
        plan: Function that plans a problem with all proofs.
        problem: The problem.
    """
    distinct, shown = are_distinct(problem.scenarios, problem.task), 0
    if distinct.all():
        return plan(problem)

    def progress(tracked: int, *others: int | None) -> None:
        nonlocal shown
        shown += tracked
        problem.progress(tracked, *others)

    plans, fits = _with_own_errors(problem, _planned(plan, problem, distinct, progress), distinct)
    if len(rows := np.flatnonzero(~fits)):
        scenarios = jax.tree.map(lambda leaf: leaf[rows], problem.scenarios)
        again = plan(problem.with_scenarios(scenarios, lambda *counts: problem.progress(0, 0)))
        others = np.flatnonzero(fits)
        plans = Plans.concatenate([plans.rows(others), again]).rows(np.argsort(np.append(others, rows)))
    problem.progress(int(plans.tracked.sum()) - shown, 0)
    return plans


def _planned(
    plan: Callable[[Problem], Plans], problem: Problem, distinct: np.ndarray, progress: Callable[[int, int], None]
) -> Plans:
    scenarios = problem.scenarios
    exists = np.arange(distinct.shape[1]) < scenarios.count[:, None]
    distinct = distinct & exists
    count = distinct.sum(axis=1)
    first = np.argsort(~distinct, axis=1, kind="stable")[:, : count.max()]  # padded with any target
    s = np.arange(len(first))[:, None]
    first = np.where(np.arange(first.shape[1]) < count[:, None], first, first[s, count[:, None] - 1])
    tables = {name: getattr(scenarios, name) for name in ("targets", "task_goals", "max_joint_step")}
    fewer = {name: None if table is None else table[s, first] for name, table in tables.items()}
    places = replace(scenarios, **fewer, count=count.astype(scenarios.count.dtype))
    return _expanded(plan(problem.with_scenarios(places, progress)), problem, distinct, exists, first)


def _expanded(
    plans: Plans, problem: Problem, distinct: np.ndarray, exists: np.ndarray, first: Int[np.ndarray, "S R"]
) -> Plans:
    """Return plans with one row per target of the file.

    Args:
        plans: Plans of the distinct places.
        problem: The problem with all targets.
        distinct: See `are_distinct`; False for padding.
        exists: True for existing targets.
        first: The first target of each place.
    """
    found = plans.with_targets(np.maximum(np.cumsum(distinct, axis=1) - 1, 0), exists)
    repeated = exists & ~distinct
    found.target[repeated] = problem.scenarios.targets[repeated]
    passed = repeated & found.tracked
    found.status[repeated & ~passed] = Status.NOT_ATTEMPTED
    found.status[passed] = Status.TRACKED
    found.iterations[repeated] = found.recovery[repeated] = 0
    found.joint_step[passed] = 0.0
    proof = found.segment_status[passed]
    checked, stays = proof != SegmentStatus.NOT_CHECKED, np.where(np.isin(proof, MOTION), proof, SegmentStatus.VALID)
    found.segment_status[passed] = np.where(checked, stays, SegmentStatus.NOT_CHECKED)
    found.segment_clearance[passed] = np.where(checked, found.clearance[passed], np.nan)
    found.path_clear[passed] = np.where(found.path_clear[passed] == plan_arrays.PATH_UNKNOWN, -1, 1)
    known = plans.via_points
    via_points = known._replace(target=first[known.scenario, known.target].astype(known.target.dtype))
    return found._replace(via_points=via_points, dead_ends=plans.dead_ends.moved(first))


def _with_own_errors(problem: Problem, plans: Plans, distinct: np.ndarray) -> tuple[Plans, Bool[np.ndarray, "S"]]:
    """Return the plans with the errors at repeated targets whose goals differ from those of their place.

    The second result is False for scenarios whose configurations do not satisfy the task there.
    """
    goals, fits = np.asarray(problem.scenarios.goals), np.ones(len(distinct), bool)
    moved = ~distinct & plans.tracked
    moved[:, 1:] &= (goals[:, 1:] != goals[:, :-1]).any(axis=2)
    s, t = np.nonzero(moved)
    if not len(s):
        return plans, fits
    checker, inputs = problem.checkers[0], lane_tables.lane_inputs(problem.scenarios, s, t)
    at = checker.states(inputs, plans.x[s, t])
    fits[s[~checker.valid(inputs, at)]] = False
    plans = plans.with_own("residual", "orientation_error")
    plans.residual[s, t] = at.residual
    if problem.task.holds_angles:
        separate = with_separate_errors(problem, plans)
        plans.residual[s, t], plans.orientation_error[s, t] = separate.residual[s, t], separate.orientation_error[s, t]
    return plans, fits
