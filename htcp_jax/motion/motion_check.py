"""Verification that plans are motions: they begin at the given start, the arm is proven clear, the tool is on its path.

On the segment to a target of the path, the arm must have the clearance `Scenario.margins_to`, and the TCP must
stay within `Settings.path_tolerance_m` of the line from the previous target, and advance along this line. If the arm
changes its configuration on the segment, the TCP must stay within this distance of the previous target. On segments of
the approach and between seams the TCP may leave the lines. Targets closer than `ONE_POINT_M` are one point.

Before the path and between seams, the arm should have the clearance `Scenario.transfer_margin_m`, see
`RequiredMargins`. A segment that is clear with less is a motion, too: its status is REDUCED_MARGIN.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.clearance.proof import bisection, margin
from htcp_jax.device import tables
from htcp_jax.motion.collision_checker import CollisionChecker
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.motion.plans import Plans
from htcp_jax.motion.problem import Problem
from htcp_jax.motion.raised_bounds import Proving, raise_smallest, raised, together
from htcp_jax.motion.segment_tubes import segment_margins
from htcp_jax.status import MOTION, SegmentStatus

KEPT = 0.5  # share of the clearance that must be proven on a segment
TIGHT = 0.99  # this share for segments whose bound is tightened, see `tighten`
ROWS_AT_ONCE = 16  # rows of a scenario that are verified at a time; rows after the end of a motion need no proof


class StraightPaths(NamedTuple):
    """Straight joint paths that a plan's segments consist of."""

    scenario: Int[np.ndarray, "n"]  # row of the scenario
    target: Int[np.ndarray, "n"]  # target at the end of the segment
    a: Float[np.ndarray, "n N"]  # starts of the paths [rad or m]
    b: Float[np.ndarray, "n N"]  # ends of the paths [rad or m]
    turns: Bool[np.ndarray, "n"]  # True if the arm changes its configuration while the TCP stays at the previous target


class RequiredMargins:
    """Required clearance on the segments of plans, see `clearance.proof.margin`.

    Two motions lead to the path: from the start to the first target, and from there to the path's first point. One
    leads to each later seam. `transfer_margin_m` falls off towards both ends of each.

    Args:
        problem: The problem.
        plans: The plans.
        reduced: True to require only the guaranteed clearance on segments whose status is REDUCED_MARGIN.
    """

    def __init__(self, problem: Problem, plans: Plans, reduced: bool = False):
        self._problem, self._scenarios, self._plans, self._reduced = problem, problem.scenarios, plans, reduced
        self._most = problem.scenarios.transfer_margin_m
        if not (self._most > 0).any():
            return
        every = np.arange(len(plans.status))
        start = problem.checkers[0].states(problem.inputs(every, 0), plans.start)
        last = np.minimum(problem.scenarios.on_path, np.maximum(plans.tracked.sum(axis=1) - 1, 0))
        self._tcp = np.stack([start.tcp, plans.tcp[:, 0], plans.tcp[every, last]], axis=1)
        self._clearance = np.stack([start.clearance, plans.clearance[:, 0], plans.clearance[every, last]], axis=1)

    def of(self, scenario: np.ndarray, target: np.ndarray) -> margin.Margin:
        """Return the required clearance on segments.

        Args:
            scenario: Row of each segment's scenario (n,).
            target: Target at each segment's end (n,).
        """
        off_path = self._problem.off_path(scenario, target)
        found = margin.constant(segment_margins(self._scenarios, scenario, target, off_path))
        before = self.off_path(scenario, target)
        if not before.any():
            return found
        s, t = scenario[before], target[before]
        ends = s[:, None], np.minimum(t, 1)[:, None] + np.arange(2)
        tcp, clearance = self._tcp[ends], self._clearance[ends]
        later = t > self._scenarios.on_path[s]
        if later.any():  # between seams
            rows = s[later, None], t[later, None] + np.arange(-1, 1)
            tcp[later], clearance[later] = self._plans.tcp[rows], self._plans.clearance[rows]
        rule = margin.falling_off(self._most[s], self._scenarios.transfer_falloff_m[s], tcp, clearance)
        if self._reduced:
            least = margin.constant(self._plans.segment_clearance[s, t])
            is_reduced = self._plans.segment_status[s, t] == SegmentStatus.REDUCED_MARGIN
            rule = tables.scatter(rule, is_reduced, tables.gather(least, is_reduced))
        return tables.scatter(found, before, rule)

    def off_path(self, scenario: np.ndarray, target: np.ndarray) -> Bool[np.ndarray, "n"]:
        """Return True for segments off the path on which more than D > 0 is required, if possible."""
        return self._problem.off_path(scenario, target) & (self._most[scenario] > 0)


def check_remaining_paths(problem: Problem, plans: Plans) -> Plans:
    """Return the plans with `path_clear` set at all tracked targets whose joint path was not checked by the method."""
    s, t = np.nonzero(plans.tracked & (plans.path_clear < 0))
    plans = plans.with_own("path_clear")

    def check(checker: CollisionChecker, share: slice) -> None:
        for row, at in tables.portions((s[share], t[share])):
            inputs = lane_inputs(problem.scenarios, row, at)
            plans.path_clear[row, at] = checker.path_clear(inputs, plans.before(row, at), plans.x[row, at])

    if len(s):
        problem.in_threads(check)
    return plans


def verify_motions(problem: Problem, plans: Plans) -> Plans:
    """Return the plans with `segment_status` and `segment_clearance` set, up to the end of each scenario's motion."""
    scenarios, plans = problem.scenarios, plans.with_own("segment_status", "segment_clearance")
    elsewhere = plans.tracked[:, 0] & np.any(plans.start != scenarios.x_home, axis=1) & ~scenarios.begins_anywhere
    plans.segment_status[elsewhere, 0] = SegmentStatus.WRONG_START
    going, margins = np.flatnonzero(plans.tracked[:, 0] & ~elsewhere), RequiredMargins(problem, plans)
    for first in range(0, plans.status.shape[1], ROWS_AT_ONCE):
        block = np.zeros_like(plans.tracked)
        block[going, first : first + ROWS_AT_ONCE] = True
        block &= np.logical_and.accumulate(plans.tracked, axis=1)
        if not block.any():
            break
        segments = segments_of(plans, block)
        _write_verdicts(plans, segments, _proofs_with_margins(problem, segments, margins))
        last = min(first + ROWS_AT_ONCE, plans.status.shape[1]) - 1
        going = going[plans.executable[going, last]]
    ended = np.logical_or.accumulate(~np.isin(plans.segment_status, MOTION), axis=1)[:, :-1]
    plans.segment_status[:, 1:][ended], plans.segment_clearance[:, 1:][ended] = SegmentStatus.NOT_CHECKED, np.nan
    if problem.task.sampled:
        every = np.indices(plans.segment_status.shape)
        along = ~problem.off_path(*every)
        plans.segment_status[along & (plans.segment_status == SegmentStatus.VALID)] = SegmentStatus.SAMPLED
    return plans


def verify_transfers(problem: Problem, plans: Plans) -> Plans:
    """Return the plans with the verdicts of the segments off the path; others are not changed."""
    plans = plans.with_own("segment_status", "segment_clearance")
    first = plans.tracked & problem.off_path(*np.indices(plans.status.shape))
    if first.any():
        segments = segments_of(plans, first)
        _write_verdicts(plans, segments, _proofs_with_margins(problem, segments, RequiredMargins(problem, plans)))
    return plans


def clearance_along(problem: Problem, x: Float[np.ndarray, "k N"]) -> Float[np.ndarray, "k-1"]:
    """Return lower bounds on D along the straight joint paths between consecutive configurations; NaN if not proven.

    The smallest bound is as tight as those of `tighten`, and raised, see `raised_bounds`.

    Args:
        problem: The problem, with one scenario.
        x: The configurations, off the path [rad or m].
    """
    return together([_bounds_along(x)], partial(_clearances, problem))[0]


def _bounds_along(
    x: Float[np.ndarray, "k N"], scenario: int = 0, enough_m: float = np.inf
) -> Proving[Float[np.ndarray, "k-1"]]:
    """Return the bounds of `clearance_along` in a scenario; none is raised above `enough_m` [m].

    Yields:
        Joint paths, and the share of their clearance that must be proven.
    """

    def between(a: Float[np.ndarray, "n N"], b: Float[np.ndarray, "n N"]) -> StraightPaths:
        rows = np.full(len(a), scenario)
        return StraightPaths(rows, np.zeros_like(rows), a, b, np.ones(len(a), bool))

    def more(k: int) -> Proving[float]:
        def parts(begin, end):
            return between(*(x[k] + share[:, None] * (x[k + 1] - x[k]) for share in (begin, end))), TIGHT

        return raised(parts, found[k], enough_m)

    paths = between(x[:-1], x[1:])
    found = yield paths, KEPT
    loose = found < np.nanmin(found, initial=np.inf) / KEPT
    if loose.any():
        found[loose] = np.fmax(found[loose], (yield tables.gather(paths, loose), TIGHT))
    yield from raise_smallest(found, more, enough_m)
    return found


def _clearances(problem: Problem, asked: Sequence[tuple[StraightPaths, float]]) -> list[Float[np.ndarray, "_"]]:
    """Return the proven clearances of joint paths, from `_bounds_along` [m]; NaN where a path is not proven."""
    count = [len(paths.target) for paths, _ in asked]
    paths = tables.concatenate([paths for paths, _ in asked])
    proofs = _proofs(problem, paths, np.repeat([kept for _, kept in asked], count))
    clearance = np.where(proofs.verdict == SegmentStatus.VALID, proofs.clearance, np.nan)
    return np.split(clearance, np.cumsum(count)[:-1])


def tighten(problem: Problem, plans: Plans, here: Bool[np.ndarray, "T"] | None = None) -> Plans:
    """Return the plans with tighter bounds on segments whose bound is below the minimum clearance at the targets.

    Only executable segments are considered: their minimum `segment_clearance` is reported as the scenario's guaranteed
    clearance.

    Args:
        problem: The problem.
        plans: The plans.
        here: True for targets that have the problem's task; None: all.
    """
    clear = np.where(plans.executable, plans.clearance, np.inf).min(axis=1)
    loose = plans.executable & (plans.segment_clearance < TIGHT * clear[:, None])
    loose &= True if here is None else here
    if not loose.any():
        return plans
    segments = segments_of(plans, loose)
    proofs = _proofs(problem, segments, TIGHT)
    found = np.full_like(plans.segment_clearance, np.inf)
    np.minimum.at(found, (segments.scenario, segments.target), proofs.clearance)
    return plans._replace(
        segment_clearance=np.where(loose, np.maximum(plans.segment_clearance, found), plans.segment_clearance)
    )


def raise_air_moves(problem: Problem, plans: Plans) -> Plans:
    """Return the plans with larger bounds on air moves that decide a scenario's guaranteed clearance.

    An air move is a segment before the path, or between seams. It may be long, so that its bound from `tighten` may be
    far below its clearance. It is raised up to the smallest bound on the path, or to the clearance at the targets.

    Args:
        problem: The problem.
        plans: The plans, from `tighten`.
    """
    off_path = problem.off_path(*np.indices(plans.executable.shape))
    known = np.where(plans.executable, plans.segment_clearance, np.nan)
    fixed = np.fmin(np.where(off_path, np.inf, known), TIGHT * np.where(plans.executable, plans.clearance, np.inf))

    def raise_scenario(s: int, enough_m: float) -> Proving[None]:
        def more(t: int) -> Proving[float]:
            x = np.vstack([plans.before(s, t), plans.via_points.on_segment(s, t), plans.x[s, t]])
            return (yield from _bounds_along(x, s, enough_m)).min()

        return raise_smallest(known[s], more, enough_m)

    enough = np.fmin.reduce(fixed, axis=1).tolist()
    together([raise_scenario(s, enough_m) for s, enough_m in enumerate(enough)], partial(_clearances, problem))
    return plans._replace(segment_clearance=np.fmax(plans.segment_clearance, known))


def segments_of(plans: Plans, rows: Bool[np.ndarray, "S T"]) -> StraightPaths:
    """Return the straight joint paths of the segments to some targets, through the via points."""
    s, t = np.nonzero(rows)
    via_points = tables.gather(plans.via_points, rows[plans.via_points.scenario, plans.via_points.target])
    turns = np.arange(len(via_points.x) + len(s)) < len(via_points.x)
    columns = (via_points.scenario, s), (via_points.target, t), (via_points.x, plans.x[s, t])
    scenario, target, b = (np.concatenate(both) for both in columns)
    order = np.lexsort((~turns, target, scenario))  # via points in the order of the motion, then the target
    scenario, target, b, turns = tables.gather((scenario, target, b, turns), order)
    a = plans.before(scenario, target)
    a[1:][turns[:-1]] = b[:-1][turns[:-1]]
    return StraightPaths(scenario, target, a, b, turns)


def prove_segments(
    problem: Problem,
    checker: CollisionChecker,
    segments: StraightPaths,
    kept: float | Float[np.ndarray, "n"] = 0.0,
    margins: RequiredMargins | None = None,
) -> bisection.Proof:
    """Return one proof per straight joint path.

    Args:
        problem: The problem.
        checker: Collision checker of the scene.
        segments: The joint paths.
        kept: Share of the clearance that must be proven, see `CollisionChecker.edges`.
        margins: Required clearance before the path; None: only D > 0.
    """
    inputs = lane_inputs(problem.scenarios, segments.scenario, segments.target)
    tube = problem.tubes(segments.scenario, segments.target, turns=segments.turns)
    if margins is not None:
        tube = tube._replace(margin=margins.of(segments.scenario, segments.target))
    return checker.edges(inputs, segments.a, segments.b, tube, kept=kept)


def _proofs_with_margins(problem: Problem, segments: StraightPaths, margins: RequiredMargins) -> bisection.Proof:
    """Return one proof per straight joint path; those with less than the margin have the verdict REDUCED_MARGIN."""
    proofs = _proofs(problem, segments, margins=margins)
    lacks = (proofs.verdict != SegmentStatus.VALID) & margins.off_path(segments.scenario, segments.target)
    if not lacks.any():
        return proofs
    again = _proofs(problem, tables.gather(segments, lacks))
    verdict = np.where(again.verdict == SegmentStatus.VALID, int(SegmentStatus.REDUCED_MARGIN), again.verdict)
    return tables.scatter(proofs, lacks, again._replace(verdict=verdict))


def _proofs(
    problem: Problem,
    segments: StraightPaths,
    kept: float | Float[np.ndarray, "n"] = KEPT,
    margins: RequiredMargins | None = None,
) -> bisection.Proof:
    """Return one proof per straight joint path, computed by all threads of the problem."""
    each = np.broadcast_to(kept, len(segments.target))

    def prove(checker: CollisionChecker, share: slice) -> bisection.Proof:
        found = []
        for part, own in tables.portions(tables.gather((segments, each), share)):
            problem.progress(0, 0)
            found.append(prove_segments(problem, checker, part, own, margins))
        return tables.concatenate(found)

    return tables.interleaved(problem.in_threads(prove, min(problem.threads, len(segments.target))))


def _write_verdicts(plans: Plans, segments: StraightPaths, proofs: bisection.Proof) -> None:
    """Write into the plans, per segment, the verdict of the first path not proven, and the least clearance of all."""
    s, t = segments.scenario, segments.target
    plans.segment_status[s, t], plans.segment_clearance[s, t] = SegmentStatus.VALID, np.inf
    moves = np.isin(proofs.verdict, MOTION)
    for k in [*np.flatnonzero(moves & (proofs.verdict != SegmentStatus.VALID)), *np.flatnonzero(~moves)[::-1]]:
        plans.segment_status[s[k], t[k]] = proofs.verdict[k]
    np.minimum.at(plans.segment_clearance, (s, t), proofs.clearance)
    plans.segment_clearance[~np.isin(plans.segment_status, MOTION)] = np.nan
