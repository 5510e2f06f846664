"""Goals inserted on long segments of a path, which cut them into short parts; their configurations become via points.

Between two configurations the arm interpolates in joint space, so the TCP deviates from the straight line. On a segment
of length L, at a distance r from the rotating joint, the deviation is L^2 / (8 r). A segment is cut into equal parts if
this exceeds SHARE of the allowed distance even at the arm's full reach. If the task rotates the tool by an angle t, the
deviation is r t^2 / 8. The angle of a part is limited to that with a deviation of SHARE of the allowed distance, at
WRIST of the full reach. A rotation that the task's cones absorb does not count, but rotations of more than TURN_RAD
are always cut. Without `settings.path_check` no goals are inserted.

An inserted goal lies on the line between the segment's targets, with interpolated directions and frames. Methods,
proofs and smoothing treat it as a target. After planning, the plans have one row per target of the file again, and the
configurations at inserted goals are via points. If planning fails at an inserted goal, the segment's target fails, and
the via points lead to the last goal that was reached. If the joints cannot follow one of the parts, the number of parts
is doubled.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from htcp_jax.device import tables
from htcp_jax.model import Robot, Scenario, Task, kinematics
from htcp_jax.model import scenario as scenario_functions
from htcp_jax.motion import Plans, Problem, ViaPoints
from htcp_jax.motion import plans as plan_arrays
from htcp_jax.settings import Settings
from htcp_jax.status import MOTION, SegmentStatus, Status

SHARE = 0.125  # share of the allowed distance from the line up to which no goals are inserted
TURN_RAD = 0.8  # rotation of the task's orientation up to which no goals are inserted if the task's cones absorb it
WRIST = 0.1  # distance of the TCP from the joints that rotate the tool, as a share of the full reach
FINER = 4  # number of parts of a segment that just exceeds SHARE of the allowed distance or TURN_RAD
MOST_PARTS = 10_000  # maximum number of parts of a segment
HALVINGS = 2  # maximum number of times that a segment's parts are halved because joints cannot follow them

PlanRows = Callable[[Problem, Int[np.ndarray, "_"]], Plans]  # (problem, original rows of its scenarios) -> plans


@dataclass(frozen=True, eq=False)
class PathParts:
    """Parts of the segments of S scenarios: T targets in the file, and R rows including inserted goals."""

    row: Int[np.ndarray, "S T"]  # row of each target
    target: Int[np.ndarray, "S R"]  # target at the end of each row's segment
    begin: Float[np.ndarray, "S R"]  # share of the segment at which the part to each row begins
    end: Float[np.ndarray, "S R"]  # share of the segment at which the part ends; 1 for a target's row

    @classmethod
    def of(cls, pieces: Int[np.ndarray, "S T"], count: Int[np.ndarray, "S"]) -> "PathParts":
        """Return the parts of segments.

        Args:
            pieces: Number of parts of the segment to each target.
            count: Number of targets of each scenario.
        """
        pieces = np.where(np.arange(pieces.shape[1]) < count[:, None], pieces, 0)
        last = np.cumsum(pieces, axis=1)
        row = np.minimum(np.arange(last.max(initial=0)), last[:, -1:] - 1)  # padded with the last row
        target = (row[:, :, None] >= last[:, None]).sum(axis=2)
        of_segment = np.take_along_axis(pieces, target, axis=1)
        nth = row - (np.take_along_axis(last, target, axis=1) - of_segment)
        return cls(np.maximum(last - 1, 0), target, nth / of_segment, (nth + 1) / of_segment)


def pieces_of(robot: Robot, task: Task, scenarios: Scenario, settings: Settings) -> Int[np.ndarray, "S T"]:
    """Return the number of equal parts into which the segment to each target is cut.

    The number is 1 on the approach, and everywhere without `settings.path_check`.

    Args:
        robot: The arm.
        task: The constraints at every target.
        scenarios: Stacked scenarios.
        settings: `tube_m`, the allowed distance from the line, and `path_check`.
    """
    t = np.arange(scenarios.targets.shape[1])
    found = np.ones(scenarios.targets.shape[:2], int)
    s, t = np.nonzero((t > scenarios.on_path[:, None]) & (t < scenarios.count[:, None]))
    if not len(s) or settings.path_check != "all":
        return found
    tube_m = settings.tube_m if task.holds_tcp else task.tolerance_m
    reach_m = kinematics.max_reach(robot)
    longest = np.sqrt(8 * SHARE * tube_m * reach_m)
    widest = np.sqrt(8 * SHARE * tube_m / (WRIST * reach_m)) if np.isfinite(reach_m) else np.inf
    goals = _ends(scenarios.goals, s, t)
    length = np.linalg.norm(np.diff(scenarios.targets, axis=1), axis=2)[s, t - 1] / longest
    most = np.maximum(length, task.turn(goals) / TURN_RAD)
    turn = task.turn(goals, least=True) if task.holds_tcp else 0.0
    found[s, t] = np.clip(np.ceil(np.maximum(np.where(most > 1, FINER * most, 1), turn / widest)), 1, MOST_PARTS)
    return found


def planned(plan: PlanRows, problem: Problem) -> Plans:
    """Return the plans of a problem, planned with goals inserted on its long segments.

    Args:
        plan: Function that plans some scenarios with all proofs. Its arguments are their problem with inserted goals,
            and their rows in `problem`.
        problem: The problem without inserted goals.
    """
    pieces = pieces_of(problem.robot, problem.task, problem.scenarios, problem.settings)
    rows = np.arange(len(pieces))
    if (pieces == 1).all():
        return plan(problem, rows)
    report = _Progress(problem)
    plans = _planned(plan, problem, rows, pieces, report)
    for _ in range(HALVINGS):
        lost = _not_followed(plans)
        rows = np.flatnonzero((lost >= 0) & (pieces[np.arange(len(lost)), lost] > 1))
        if not len(rows):
            break
        pieces = pieces.copy()
        pieces[rows, lost[rows]] *= 2
        again = _planned(plan, problem, rows, pieces, lambda *counts: problem.progress(0, 0))
        ends, others = plans.outcomes, again.outcomes
        better = others.executable + others.tracked > (ends.executable + ends.tracked)[rows]
        stays = np.setdiff1d(np.arange(len(lost)), rows[better])
        joined = Plans.concatenate([plans.rows(stays), again.rows(np.flatnonzero(better))])
        plans = joined.rows(np.argsort(np.append(stays, rows[better])))
    problem.progress(int(plans.tracked.sum()) - report.shown, 0)
    return plans


class LostPlace(NamedTuple):
    """Place on a segment with inserted goals at which planning failed."""

    share: float  # share of the segment
    x_last: Float[np.ndarray, "N"]  # the last configuration that was reached [rad or m]
    scenario: Scenario  # the scenario with this place as the target, and the goal before it as the one before


def lost_place(
    robot: Robot, task: Task, scenario: Scenario, settings: Settings, plans: Plans, target: int
) -> LostPlace | None:
    """Return the place on a segment at which a plan failed; None for a segment without inserted goals.

    Args:
        robot: The arm.
        task: The constraints at every target.
        scenario: The plan's scenario.
        settings: Settings of the planner.
        plans: Plans with the scenario in row 0.
        target: The target at the segment's end.
    """
    stacked = scenario_functions.stack([scenario])
    pieces = int(pieces_of(robot, task, stacked, settings)[0, target])
    if pieces == 1:
        return None
    known = plans.via_points
    reached = np.unique(np.append(0.0, known.shares_on(0, target)))
    if len(reached) > 1:
        pieces = max(pieces, round(1.0 / float(np.diff(reached).min())))
    nth = min(round(float(reached[-1]) * pieces) + 1, pieces)
    x_last = np.concatenate([plans.before(0, target)[None], known.on_segment(0, target)])[-1]
    counts = np.ones(stacked.targets.shape[:2], int)
    counts[0, target] = pieces
    denser = inserted(task, stacked, PathParts.of(counts, stacked.count))
    targets, goals = scenario.targets.copy(), None if scenario.task_goals is None else scenario.task_goals.copy()
    targets[target - 1 : target + 1] = denser.targets[0, target + nth - 2 : target + nth]
    if goals is not None:
        goals[target - 1 : target + 1] = denser.goals[0, target + nth - 2 : target + nth]
    return LostPlace(nth / pieces, x_last, replace(scenario, targets=targets, task_goals=goals))


def inserted(task: Task, scenarios: Scenario, parts: PathParts) -> Scenario:
    """Return stacked scenarios with the goals of all parts.

    Args:
        task: The constraints at every target.
        scenarios: The scenarios.
        parts: Parts of the scenarios' segments.
    """
    s = np.arange(len(parts.target))[:, None]
    targets, goals = scenarios.targets[s, parts.target], scenarios.goals[s, parts.target]
    own = np.nonzero(parts.end < 1.0)
    share, ends = parts.end[own], (own[0], parts.target[own])
    places = _ends(scenarios.targets, *ends)
    targets[own] = places[:, 0] + share[:, None] * (places[:, 1] - places[:, 0])
    goals[own] = task.interpolated(_ends(scenarios.goals, *ends), share, places if places.shape[2] == 3 else None)
    count = parts.row[s[:, 0], scenarios.count - 1] + 1
    task_goals = None if scenarios.task_goals is None else goals
    most, margins = (
        None if table is None else table[s, parts.target]
        for table in (scenarios.max_joint_step, scenarios.seam_margins_m)
    )
    place, count = parts.target - 1 + parts.end, count.astype(scenarios.count.dtype)
    return replace(
        scenarios,
        targets=targets,
        task_goals=task_goals,
        count=count,
        max_joint_step=most,
        place=place,
        seam_margins_m=margins,
    )


def folded(plans: Plans, count: Int[np.ndarray, "S"], parts: PathParts) -> Plans:
    """Return plans with one row per target of the file.

    Args:
        plans: Plans of `inserted` scenarios.
        count: Number of targets of each scenario, without inserted goals.
        parts: Parts of their segments.
    """
    exists = np.arange(parts.row.shape[1]) < count[:, None]
    found = plans.with_targets(parts.row, exists)
    before = np.diff(parts.row, axis=1, prepend=-1)
    for one, t in zip(*np.nonzero(exists & (before > 1)), strict=True):
        last = parts.row[one, t] + 1
        _fold(plans, found, int(one), int(t), slice(last - before[one, t], last))
    return found._replace(via_points=_via_points(plans, parts), dead_ends=plans.dead_ends.moved(parts.target))


def _planned(plan: PlanRows, problem: Problem, rows: np.ndarray, pieces: np.ndarray, progress: Callable) -> Plans:
    """Return the plans of some scenarios, one row per target of the file."""
    scenarios = jax.tree.map(lambda leaf: leaf[rows], problem.scenarios)
    parts = PathParts.of(pieces[rows], scenarios.count)
    denser = problem.with_scenarios(inserted(problem.task, scenarios, parts), progress)
    if isinstance(progress, _Progress):
        progress.goals = int(denser.scenarios.count.sum())
    return folded(plan(denser, rows), scenarios.count, parts)


class _Progress:
    """Progress of a problem with inserted goals, in targets of the file."""

    def __init__(self, problem: Problem):
        self._report, self._lock = problem.progress, threading.Lock()
        self._targets, self._tracked = int(problem.scenarios.count.sum()), 0
        self.goals, self.shown = self._targets, 0

    def __call__(self, tracked: int, finished: int) -> None:
        with self._lock:
            self._tracked += tracked
            before, self.shown = self.shown, self._tracked * self._targets // self.goals
            more = self.shown - before
        self._report(more, finished)


def _not_followed(plans: Plans) -> Int[np.ndarray, "S"]:
    """Return the first target of each scenario to which the joints could not follow the line.

    It is -1 if there is no such target, or if an earlier target failed for another reason.
    """
    off = np.isin(plans.segment_status, (SegmentStatus.OFF_PATH, SegmentStatus.REVERSES))
    lost = ~plans.tracked | off
    first = lost.argmax(axis=1)
    s = np.arange(len(first))
    follows = (plans.status[s, first] == Status.PATH_BLOCKED) | (plans.tracked[s, first] & off[s, first])
    return np.where(lost.any(axis=1) & follows, first, -1)


def _fold(plans: Plans, found: Plans, s: int, t: int, own: slice) -> None:
    """Write the results of a segment's parts into the row of its target."""
    status, proofs, clear = (column[s, own] for column in (plans.status, plans.segment_status, plans.path_clear))
    missed, unproven = np.flatnonzero(~plan_arrays.is_tracked(status)), np.flatnonzero(~np.isin(proofs, MOTION))
    found.iterations[s, t] = plans.iterations[s, own].sum()
    if len(missed):
        for name in set(plan_arrays.EMPTY) - {"target", "iterations"}:
            getattr(found, name)[s, t] = plan_arrays.EMPTY[name]
        found.status[s, t] = status[missed[0]]
        return
    found.status[s, t], found.recovery[s, t] = status.max(), plans.recovery[s, own].max()
    found.path_clear[s, t] = 0 if (clear == 0).any() else clear.min()
    found.joint_step[s, t] = np.linalg.norm(found.x[s, t] - found.before(s, t))
    found.segment_status[s, t] = proofs[unproven[0]] if len(unproven) else proofs.max()
    found.segment_clearance[s, t] = np.nan if len(unproven) else plans.segment_clearance[s, own].min()


def _via_points(plans: Plans, parts: PathParts) -> ViaPoints:
    """Return the via points of plans, including the configurations at tracked inserted goals."""
    known = plans.via_points
    s, row = np.nonzero(plans.tracked & (parts.end < 1.0))
    scenario, rows = np.append(known.scenario, s), np.append(known.target, row)
    x = np.concatenate([known.x, plans.x[s, row]])
    share = np.append(parts.begin[known.scenario, known.target], parts.end[s, row])
    order = np.lexsort((np.repeat([0, 1], [len(known.x), len(s)]), rows, scenario))  # a part's dwell, then its goal
    scenario, rows, x, share = tables.gather((scenario, rows, x, share), order)
    return ViaPoints(scenario.astype(np.int32), parts.target[scenario, rows].astype(np.int32), x, share)


def _ends(table: Float[np.ndarray, "S T G"], s: np.ndarray, t: np.ndarray) -> Float[np.ndarray, "n 2 G"]:
    """Return the rows of a table at the targets t - 1 and t of scenarios s, the ends of segments."""
    return np.stack([table[s, np.maximum(t - 1, 0)], table[s, t]], axis=1)
