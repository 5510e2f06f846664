"""Verification that plans are motions: from the given start, with the arm proven clear and the tool on its path.

On the segment to a target on the path the TCP stays within `Settings.path_tolerance_m` of the line from the previous
target, and advances along it; if the arm changes its configuration on the segment, the TCP stays that close to the
previous target. Segments before the path may leave their lines. Targets closer than `ONE_POINT_M` count as one.
"""

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.clearance.proof.bisection import Proof
from htcp_jax.clearance.proof.motion_proof import Tube
from htcp_jax.device.programs import Kernels
from htcp_jax.device.tables import concatenate, gather, portions
from htcp_jax.model.scenario import Scenario
from htcp_jax.model.task import TCP_POSITION, Task
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.motion.motion import ONE_POINT_M
from htcp_jax.motion.plans import Plans
from htcp_jax.motion.problem import Problem
from htcp_jax.motion.proofs import proofs_of
from htcp_jax.motion.tip_check import TipCheck, tip_checks
from htcp_jax.status import Way

KEPT = 0.5  # share of the clearance that the recorded bound of a segment keeps
TIGHT = 0.99  # the share for a smoothed motion, where its clearance is least
ROWS_AT_ONCE = 16  # per scenario: rows beyond the end of a motion need no proof


class Segments(NamedTuple):
    """Straight joint paths that the segments between rows consist of."""

    scenario: Int[np.ndarray, "n"]
    target: Int[np.ndarray, "n"]  # end of the segment
    a: Float[np.ndarray, "n N"]
    b: Float[np.ndarray, "n N"]
    turns: Bool[np.ndarray, "n"]  # True if the arm changes its configuration at the target before


def tubes(
    scenarios: Scenario, task: Task, radius_m: float, scenario: np.ndarray, target: np.ndarray, turns: np.ndarray
) -> Tube:
    """Return the tubes that the TCP has to stay in on the segments to targets, and the task's goals on the path;
    unbounded before the path, and if the task does not hold the TCP's position. turns: see `Segments`."""
    free = (target <= scenarios.on_path[scenario]) | (not task.holds_tcp)
    rows = _rows(scenarios, task, scenario, target, turns)
    if free.all():
        return Tube(np.zeros((len(target), 3)), np.zeros((len(target), 3)), np.full(len(target), np.inf), *rows)
    a, b = (task.tcp_place(scenarios.aims[scenario, row]) for row in (np.maximum(target - 1, 0), target))
    a = np.where((np.linalg.norm(b - a, axis=1) < ONE_POINT_M)[:, None], b, a)
    return Tube(a, np.where(turns[:, None], a, b), np.where(free, np.inf, radius_m), *rows)


def _rows(
    scenarios: Scenario, task: Task, scenario: np.ndarray, target: np.ndarray, turns: np.ndarray
) -> tuple[Float[np.ndarray, "n 2 G"], Bool[np.ndarray, "n"]] | tuple[()]:
    """Return the task's goals at the previous target and at this one, and True if they hold on the segment, i.e. on the
    path. Empty for the paper's task, which the tube alone enforces."""
    if task.parts == TCP_POSITION.parts:
        return ()
    before = np.maximum(target - 1, 0)
    goals = np.stack([scenarios.aims[scenario, row] for row in (before, np.where(turns, before, target))], axis=1)
    return goals, target > scenarios.on_path[scenario]


def judge_motions(problem: Problem, plans: Plans) -> None:
    """Fill in `way` and `way_clearance` of every scenario, up to the end of its motion."""
    scenarios = problem.scenarios
    elsewhere = plans.tracked[:, 0] & np.any(plans.start != scenarios.x_home, axis=1) & ~scenarios.begins_anywhere
    plans.way[elsewhere, 0] = Way.ELSEWHERE
    going = np.flatnonzero(plans.tracked[:, 0] & ~elsewhere)
    for first in range(0, plans.status.shape[1], ROWS_AT_ONCE):
        block = np.zeros_like(plans.tracked)
        block[going, first : first + ROWS_AT_ONCE] = True
        block &= np.logical_and.accumulate(plans.tracked, axis=1)
        if not block.any():
            break
        segments = segments_of(plans, block)
        _record(plans, segments, _proofs(problem, segments))
        last = min(first + ROWS_AT_ONCE, plans.status.shape[1]) - 1
        going = going[plans.executable[going, last]]
    ended = np.logical_or.accumulate(plans.way != Way.PROVEN, axis=1)[:, :-1]
    plans.way[:, 1:][ended], plans.way_clearance[:, 1:][ended] = Way.UNKNOWN, np.nan


def tighten(problem: Problem, plans: Plans) -> None:
    """Prove again, with a tighter bound, the executable segments whose bound is below the clearance at every target:
    the minimum `way_clearance` of a scenario is reported as its guaranteed clearance."""
    clear = np.where(plans.executable, plans.clearance, np.inf).min(axis=1)
    loose = plans.executable & (plans.way_clearance < TIGHT * clear[:, None])
    if not loose.any():
        return
    segments = segments_of(plans, loose)
    proofs = _proofs(problem, segments, TIGHT)
    found = np.full_like(plans.way_clearance, np.inf)
    np.minimum.at(found, (segments.scenario, segments.target), proofs.clearance)
    plans.way_clearance[loose] = np.maximum(plans.way_clearance, found)[loose]


def segments_of(plans: Plans, rows: Bool[np.ndarray, "S T"]) -> Segments:
    """Return the straight joint paths that lead to some rows: from via point to via point, and from the last one to the
    row."""
    s, t = np.nonzero(rows)
    knots = gather(plans.knots, rows[plans.knots.scenario, plans.knots.target])
    turns = np.arange(len(knots.x) + len(s)) < len(knots.x)
    columns = (knots.scenario, s), (knots.target, t), (knots.x, plans.x[s, t])
    scenario, target, b = (np.concatenate(both) for both in columns)
    order = np.lexsort((~turns, target, scenario))  # via points as they are passed, then the row
    scenario, target, b, turns = gather((scenario, target, b, turns), order)
    a = plans.before(scenario, target)
    a[1:][turns[:-1]] = b[:-1][turns[:-1]]
    return Segments(scenario, target, a, b, turns)


def prove_segments(
    problem: Problem, kernels: Kernels, tip: TipCheck | None, segments: Segments, kept: float = 0.0
) -> Proof:
    """Return one proof per segment; if the tool's bare tip passes through a wall, its verdict is a collision. kept: see
    `prove`."""
    inputs = lane_inputs(problem.scenarios, segments.scenario, segments.target)
    radius = problem.settings.tube_m
    tube = tubes(problem.scenarios, problem.task, radius, segments.scenario, segments.target, segments.turns)
    proof = proofs_of(kernels, inputs, segments.a, segments.b, tube, kept)
    if tip is not None:
        through = (proof.verdict == Way.PROVEN) & tip.along(inputs, segments.a, segments.b)
        proof = proof._replace(verdict=np.where(through, int(Way.COLLIDES), proof.verdict))
    return proof


def _proofs(problem: Problem, segments: Segments, kept: float = KEPT) -> Proof:
    """Return one proof per segment, computed by all threads."""
    kernels = problem.kernels  # made here, before there are threads
    tips = tip_checks(kernels, problem.tip_guard)
    count, threads = len(segments.target), min(problem.threads, len(segments.target))

    def look(number: int) -> Proof:
        own, mine = number % len(kernels), gather(segments, slice(number, None, threads))
        proven = [prove_segments(problem, kernels[own], tips[own], part, kept) for part in portions(mine)]
        return concatenate(proven)

    with ThreadPoolExecutor(threads) as pool:
        proofs = concatenate(list(pool.map(look, range(threads))))
    order = np.argsort(np.concatenate([np.arange(number, count, threads) for number in range(threads)]))
    return gather(proofs, order)


def _record(plans: Plans, segments: Segments, proofs: Proof) -> None:
    """Record for each row the verdict of its first joint path that is not proven, and the least clearance of all."""
    s, t = segments.scenario, segments.target
    plans.way[s, t], plans.way_clearance[s, t] = Way.PROVEN, np.inf
    for k in np.flatnonzero(proofs.verdict != Way.PROVEN)[::-1]:
        plans.way[s[k], t[k]] = proofs.verdict[k]
    np.minimum.at(plans.way_clearance, (s, t), proofs.clearance)
    plans.way_clearance[plans.way != Way.PROVEN] = np.nan
