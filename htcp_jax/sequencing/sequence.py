"""Order of a part's seams, and the proven motion through all of them.

The order is a generalised travelling-salesman problem: each seam is done once, by one of its plans, in one direction.
The time of an air move that is not proven yet is estimated: that of the straight joint path, a lower bound, times the
usual ratio of a proven air move's time to it. The shortest order is found, its air moves are proven and get their true
times, and the order is found again, until all air moves in it are proven. Last, a lower bound for all orders of these
plans is found with the lower bounds of the air moves that are not proven.
"""

import threading
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.motion import Plans, Problem, Retract, ViaPoints, motion, motion_check
from htcp_jax.planning import Progress
from htcp_jax.sequencing.air_moves import AirMove, AirMoves
from htcp_jax.sequencing.order import Order, shortest_order
from htcp_jax.sequencing.seam_plans import SeamPlan, in_order

ROUNDS = 12  # maximum number of orders that are found and proven
ORDER_EFFORT, BOUND_EFFORT = 2.0, 10.0  # work for each order, and for the bound: about the seconds on one core [s]


class SeamSequence(NamedTuple):
    """Seams in their order of work, with proven air moves."""

    visits: list[SeamPlan]
    moves: list[AirMove]  # the air move to each visit but the first and, with a home, from home to the first one
    retract: AirMove | None  # from the last visit to home; None without a home
    cost_s: float  # time of the whole motion at the joints' full speed
    bound_s: float  # lower bound on this time for all orders of the same plans


def moves_between(
    problem: Problem, plans: Sequence[SeamPlan], home: Float[np.ndarray, "N"] | None, speed: Float[np.ndarray, "N"]
) -> AirMoves:
    """Return the air moves between the ends of plans and home, none of which is proven yet.

    Args:
        problem: The problem; its first scenario has the margins of transfers.
        plans: Proven motions along the seams.
        home: First and last configuration of the motion [rad or m]; None: it begins and ends at the seams.
        speed: Full speeds of the joints [rad/s or m/s].
    """
    return AirMoves(problem, _ends(plans)[0] if plans else np.empty((0, len(speed))), home, speed)


def find_sequence(
    seams: Int[np.ndarray, "P"],
    plans: Sequence[SeamPlan],
    before: Sequence[tuple[int, int]],
    moves: AirMoves,
    seed: int,
    progress: Callable[[Progress], None] | None = None,
    effort: float = ORDER_EFFORT,
) -> SeamSequence:
    """Return the shortest order of seams that is found, with proven air moves.

    A seam to which no air move leads is skipped.

    Args:
        seams: Number of the seam of each plan.
        plans: Proven motions along the seams.
        before: Pairs of seams, the first of which must be done before the second.
        moves: The air moves between the ends of the plans; those that are needed are proven.
        seed: Seed of the search for an order.
        progress: See `batch.plan`; here it counts the air moves of the current order.
        effort: Work for each order, about the seconds on one core [s].
    """
    if not len(plans):
        return SeamSequence([], [], None, 0.0, 0.0)
    nodes, report = _nodes(seams, plans, moves), _Report(progress)
    least = _least_times(moves)
    cost, is_known, ratio = _times(moves, least)
    best, hint = (np.inf, list[int]()), None
    for number in range(1, ROUNDS + 1):
        estimated = np.where(is_known, cost, ratio * cost)
        order = _order(nodes, estimated, moves.home, before, seed, effort, hint, "tour")
        pairs, hint = _pairs(nodes, order.nodes, moves.home), order.nodes
        new = [pair for pair in pairs if not moves.is_known(*pair)]
        if new:
            report.begin(number, len(new))
            moves.find(new, report.add)
            cost, is_known, ratio = _times(moves, least)
        time_s = float(nodes.own_s[order.nodes].sum() + sum(cost[pair] for pair in pairs))
        best = min(best, (time_s, order.nodes), key=lambda each: each[0])
        if not new:
            break
    time_s, chosen = best
    bound_s = _order(nodes, cost, moves.home, before, seed, BOUND_EFFORT, chosen, "bound").bound
    legs = [moves.between(*pair) for pair in _pairs(nodes, chosen, moves.home)]
    retract = legs.pop() if legs and moves.home is not None else None
    return SeamSequence([plans[k] for k in chosen], legs, retract, time_s, min(bound_s, time_s))


def whole_plans(
    problems: Sequence[tuple[Problem, Bool[np.ndarray, "T"]]], sequence: SeamSequence, missing: Sequence[Plans]
) -> Plans:
    """Return the plan of all seams: one motion from home through the seams, and back home in `Plans.retract`.

    Args:
        problems: One problem for each task, with the targets that have it. The only scenario of each has the targets
            of all seams: in the order of work, then the missing.
        sequence: The seams that are done, with their air moves.
        missing: Plans of the seams that are not done.
    """
    problem, visits, has_home = problems[0][0], sequence.visits, sequence.retract is not None
    plans = in_order([visit.plans for visit in visits], missing)
    first = np.array([0, *plans.seam_begins][: len(visits)], int)  # target 0 is the first seam's first point, repeated
    start = problem.scenarios.x_home if has_home else plans.start
    to = first.tolist() if has_home else first[1:].tolist()
    added = [(0, target, move.via_points) for target, move in zip(to, sequence.moves, strict=True)]
    known = plans.via_points
    added += [(0, int(t), known.x[k][None], known.share[k][None]) for k, t in enumerate(known.target)]
    plans = plans.with_own("joint_step")._replace(start=start, via_points=ViaPoints.of(added, plans.x.shape[2]))
    plans.joint_step[0, first] = np.linalg.norm(plans.x[0, first] - plans.before(np.zeros_like(first), first), axis=1)
    plans = motion_check.verify_transfers(problem, plans)
    for own_problem, here in problems:
        plans = motion_check.tighten(own_problem, plans, here)
    plans = motion_check.raise_air_moves(problem, plans)
    if not has_home or not visits:
        return plans
    back = np.concatenate([sequence.retract.via_points, problem.scenarios.x_home])
    clearance = motion_check.clearance_along(problem, np.concatenate([visits[-1].end[None], back]))
    return plans._replace(retract=Retract(back, clearance))


class _Report:
    """Progress of the orders and their air moves."""

    def __init__(self, progress: Callable[[Progress], None] | None):
        self._progress, self._now, self._lock = progress, Progress(0, 0, 0, 0), threading.Lock()

    def begin(self, number: int, moves: int) -> None:
        """Begin the air moves of an order."""
        self._now = Progress(0, 1, 0, moves, phase=f" of order {number}", unit="air moves")
        self.add(0)

    def add(self, joined: int) -> None:
        """Count air moves that are found; may be called on any thread."""
        with self._lock:
            self._now = self._now._replace(targets_tracked=self._now.targets_tracked + joined)
            if self._progress is not None:
                self._progress(self._now)


class _Nodes(NamedTuple):
    """Plans as nodes of the order."""

    seam: Int[np.ndarray, "P"]
    own_s: Float[np.ndarray, "P"]  # times along the seams
    begin: Int[np.ndarray, "P"]  # row of each plan's first configuration in `AirMoves.configurations`
    end: Int[np.ndarray, "P"]  # row of its last one


def _nodes(seams: np.ndarray, plans: Sequence[SeamPlan], moves: AirMoves) -> _Nodes:
    begin, end = _ends(plans)[1]
    own = [motion.motions(plan.plans, 0).x for plan in plans]
    own_s = [float((np.abs(np.diff(x, axis=0)) / moves.speed).max(axis=1, initial=0).sum()) for x in own]
    return _Nodes(np.asarray(seams), np.array(own_s), begin, end)


def _ends(plans: Sequence[SeamPlan]) -> tuple[Float[np.ndarray, "n N"], Int[np.ndarray, "2 P"]]:
    """Return all ends of plans without repetitions [rad or m], and the rows of each plan's first and last one."""
    ends = np.concatenate([[plan.start for plan in plans], [plan.end for plan in plans]])
    configurations, row = np.unique(ends, axis=0, return_inverse=True)
    return configurations, row.reshape(2, -1)


def _least_times(moves: AirMoves) -> Float[np.ndarray, "n n"]:
    """Return the least times between all configurations [s]."""
    rows = np.arange(len(moves.configurations))
    return np.stack([moves.least_time_s(row, rows) for row in rows])


def _times(moves: AirMoves, least: Float[np.ndarray, "n n"]) -> tuple[np.ndarray, np.ndarray, float]:
    """Return what is known about the times between all configurations.

    Returns:
        The times of air moves that are known, and lower bounds on all others (n, n) [s]; True for those known (n, n);
        and the usual ratio of a known time to its lower bound.
    """
    cost, is_known = least.copy(), np.zeros(least.shape, bool)
    for a, b in moves.known:
        move = moves.between(a, b)
        cost[[a, b], [b, a]] = np.inf if move is None else move.time_s
        is_known[[a, b], [b, a]] = True
    finite = is_known & np.isfinite(cost) & (least > 0)
    return cost, is_known, float(np.median(cost[finite] / least[finite])) if finite.any() else 1.0


def _order(
    nodes: _Nodes,
    cost: Float[np.ndarray, "n n"],
    home: int | None,
    before: Sequence[tuple[int, int]],
    seed: int,
    effort: float,
    hint: list[int] | None,
    only: Literal["tour", "bound"],
) -> Order:
    """Return the shortest order for some times of air moves between configurations [s]."""
    free = np.zeros(len(nodes.seam))
    begin, end = (free, free) if home is None else (cost[home, nodes.begin], cost[nodes.end, home])
    between = cost[nodes.end[:, None], nodes.begin[None]]
    costs = nodes.own_s, between, begin, end
    return shortest_order(nodes.seam, *costs, before, seed=seed, effort=effort, hint=hint, only=only)


def _pairs(nodes: _Nodes, order: Sequence[int], home: int | None) -> list[tuple[int, int]]:
    """Return the configurations at both ends of each air move in an order, by row."""
    ends, begins = nodes.end[list(order)].tolist(), nodes.begin[list(order)].tolist()
    if home is not None:
        ends, begins = [home, *ends], [*begins, home]
        return list(zip(ends, begins, strict=True)) if order else []
    return list(zip(ends, begins[1:], strict=False))
