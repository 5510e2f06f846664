"""The shortest order of seams, each done in one of several ways: a travelling-salesman problem with groups.

Nodes are ways to do a seam, groups are seams, and one node of each group is visited. Some groups must come before
others. OR-Tools' CP-SAT solves it as a circuit with optional nodes. Its search is limited by deterministic time and
has a fixed seed and number of workers, so that a result repeats.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.errors import InputError

PER_S = 1e5  # costs are rounded down to multiples of 1 / PER_S
WORKERS = 8  # searches that CP-SAT interleaves on one thread
LEAST_TIME, TIME_PER_EFFORT = 1.0, 4.0  # deterministic time of a search, about seconds
NEIGHBOURS = 12  # arcs from a node that are kept in a problem with more than MOST_ARCS
MOST_ARCS = 30_000
HOME = 0  # number of home among the nodes of the circuit; others are counted from 1


class Order(NamedTuple):
    """An order of nodes."""

    nodes: list[int]  # chosen nodes in order; groups without one are skipped
    cost: float  # of the tour [s]
    bound: float  # lower bound on the cost of every tour that skips no more groups [s]


class Costs(NamedTuple):
    """Costs of n nodes [s]; inf for moves that are not possible."""

    own: Float[np.ndarray, "n"]
    move: Float[np.ndarray, "n n"]  # from the end of a node to the begin of another one
    begin: Float[np.ndarray, "n"]  # from home
    end: Float[np.ndarray, "n"]  # to home

    def of(self, nodes: Sequence[int]) -> float:
        """Return the cost of a tour."""
        if not len(nodes):
            return 0.0
        rows = np.array(nodes)
        moves = self.move[rows[:-1], rows[1:]].sum()
        return float(self.begin[rows[0]] + self.own[rows].sum() + moves + self.end[rows[-1]])


def shortest_order(
    group: Int[np.ndarray, "n"],
    costs: Costs,
    before: Sequence[tuple[int, int]],
    *,
    seed: int,
    effort: float,
    hint: Sequence[int] | None = None,
) -> Order:
    """Return the shortest order that is found, with a bound.

    As few groups as possible are skipped.

    Args:
        group: Group of each node.
        costs: Costs of nodes and moves.
        before: Pairs of groups, the first of which must come before the second.
        seed: Seed of the search.
        effort: Factor of the search's deterministic time.
        hint: Nodes of an order to begin with; None: the nearest neighbours.

    Raises:
        InputError: If OR-Tools is not installed.
    """
    groups, group = np.unique(group, return_inverse=True)
    number = {int(g): k for k, g in enumerate(groups)}
    earlier = _closure([(number[a], number[b]) for a, b in before if a in number and b in number], len(groups))
    begun = [tour for tour in (hint, _nearest(group, costs, earlier)) if tour is not None]
    best = min(begun, key=lambda tour: (-len(tour), costs.of(tour)))
    model = _Model(group, costs, earlier, best)
    nodes, bound = model.solve(seed, LEAST_TIME + TIME_PER_EFFORT * effort)
    if len(nodes) < len(best) or (len(nodes) == len(best) and costs.of(best) < costs.of(nodes)):
        nodes = list(best)
    cost = costs.of(nodes)
    return Order(nodes, cost, min(cost, bound))


class _Model:
    """Circuit of CP-SAT: home, optional nodes, groups and positions."""

    def __init__(self, group: np.ndarray, costs: Costs, earlier: np.ndarray, hint: Sequence[int]):
        try:
            from ortools.sat.python import cp_model
        except ImportError:
            raise InputError("a job with several seams needs OR-Tools: pip install 'htcp_jax[order]'") from None
        self._cp, self._model, self._count = cp_model, cp_model.CpModel(), len(group)
        self._group, self._groups = group, int(group.max(initial=-1)) + 1
        a, b, cost = _arcs(group, costs, earlier, hint)
        self._pruned = len(a) < _all_arcs(group, costs, earlier)
        self._literal = [self._model.new_bool_var("") for _ in a]
        self._a, self._b = a.tolist(), b.tolist()
        loops = [self._model.new_bool_var("") for _ in range(self._count + 1)]
        arcs = [*zip(self._a, self._b, self._literal, strict=True), *((k, k, lit) for k, lit in enumerate(loops))]
        self._model.add_circuit(arcs)
        skipped = [self._model.new_bool_var("") for _ in range(self._groups)]
        for g, skip in enumerate(skipped):
            visited = [~loops[1 + int(k)] for k in np.flatnonzero(group == g)]
            self._model.add_exactly_one([*visited, skip])
        if earlier.any():
            self._add_positions(earlier, skipped)
        whole = np.floor(PER_S * cost).astype(np.int64)
        self._penalty = int(1 + whole.max(initial=0) * (self._groups + 2))
        self._model.minimize(
            sum(int(c) * lit for c, lit in zip(whole, self._literal, strict=True)) + self._penalty * sum(skipped)
        )
        self._hint(hint, loops, skipped)

    def _add_positions(self, earlier: np.ndarray, skipped: list[Any]) -> None:
        """Add positions of the groups, and the precedence between them."""
        position = [self._model.new_int_var(0, self._groups, "") for _ in range(self._groups)]
        between: dict[tuple[int, int], list[Any]] = {}
        for a, b, literal in zip(self._a, self._b, self._literal, strict=True):
            if a != HOME and b != HOME:
                between.setdefault((int(self._group[a - 1]), int(self._group[b - 1])), []).append(literal)
        for (g, h), literals in between.items():
            used = self._model.new_bool_var("")
            self._model.add(sum(literals) == used)
            self._model.add(position[h] >= position[g] + 1).only_enforce_if(used)
        for g, h in np.argwhere(earlier).tolist():
            self._model.add(position[g] < position[h]).only_enforce_if(~skipped[g], ~skipped[h])

    def _hint(self, nodes: Sequence[int], loops: list[Any], skipped: list[Any]) -> None:
        """Give the search a tour to begin with."""
        tour = [HOME, *(int(k) + 1 for k in nodes), HOME]
        used = set(zip(tour, tour[1:], strict=False)) if len(nodes) else set()
        for a, b, literal in zip(self._a, self._b, self._literal, strict=True):
            self._model.add_hint(literal, int((a, b) in used))
        for k, loop in enumerate(loops):
            self._model.add_hint(loop, int(k not in tour if len(nodes) else True))
        done = {int(self._group[k]) for k in nodes}
        for g, skip in enumerate(skipped):
            self._model.add_hint(skip, int(g not in done))

    def solve(self, seed: int, time: float) -> tuple[list[int], float]:
        """Return the nodes of the best tour that is found, and a lower bound on its cost [s]."""
        solver = self._cp.CpSolver()
        own = solver.parameters
        own.random_seed, own.num_workers, own.interleave_search = seed % 2**31, WORKERS, True
        own.max_deterministic_time = time
        status = solver.solve(self._model)
        if status not in (self._cp.OPTIMAL, self._cp.FEASIBLE):
            return [], 0.0
        following = {
            a: b for a, b, lit in zip(self._a, self._b, self._literal, strict=True) if solver.boolean_value(lit)
        }
        nodes, at = [], following.get(HOME, HOME)
        while at != HOME:
            nodes.append(at - 1)
            at = following[at]
        lost = self._groups - len(nodes)
        bound = (solver.best_objective_bound - self._penalty * lost) / PER_S
        return nodes, 0.0 if self._pruned else max(0.0, bound)


def _arcs(
    group: np.ndarray, costs: Costs, earlier: np.ndarray, hint: Sequence[int]
) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"], Float[np.ndarray, "m"]]:
    """Return the arcs of the circuit: first node, second node and cost, with half of the nodes' own costs."""
    move = _possible(group, costs, earlier)
    if np.isfinite(move).sum() > MOST_ARCS:
        kept = np.zeros(move.shape, bool)
        for table in (move, move.T):  # the cheapest arcs from each node, and to each
            near = np.argsort(table, axis=1, kind="stable")[:, :NEIGHBOURS]
            rows = np.arange(len(table))[:, None]
            (kept if table is move else kept.T)[rows, near] = True
        kept[list(hint)[:-1], list(hint)[1:]] = True
        move = np.where(kept, move, np.inf)
    a, b = np.nonzero(np.isfinite(move))
    first, last = np.flatnonzero(np.isfinite(costs.begin)), np.flatnonzero(np.isfinite(costs.end))
    cost = [costs.begin[first] + costs.own[first], move[a, b] + costs.own[b], costs.end[last]]
    return (
        np.concatenate([np.full(len(first), HOME), a + 1, last + 1]),
        np.concatenate([first + 1, b + 1, np.full(len(last), HOME)]),
        np.concatenate(cost),
    )


def _possible(group: np.ndarray, costs: Costs, earlier: np.ndarray) -> Float[np.ndarray, "n n"]:
    """Return the costs of moves [s]; inf within a group, and to a group that must come before."""
    excluded = (group[:, None] == group) | earlier.T[group[:, None], group]
    return np.where(excluded, np.inf, costs.move)


def _all_arcs(group: np.ndarray, costs: Costs, earlier: np.ndarray) -> int:
    """Return the number of arcs without pruning."""
    finite = np.isfinite(costs.begin).sum() + np.isfinite(costs.end).sum()
    return int(np.isfinite(_possible(group, costs, earlier)).sum() + finite)


def _nearest(group: np.ndarray, costs: Costs, earlier: np.ndarray) -> list[int]:
    """Return a tour that goes to the nearest node that is allowed, as far as one can be reached."""
    move, nodes, left = _possible(group, costs, earlier), list[int](), np.ones(earlier.shape[0], bool)
    while True:
        allowed = left & ~(earlier & left[:, None]).any(axis=0)
        here = costs.begin if not nodes else move[nodes[-1]]
        cost = np.where(allowed[group] & np.isfinite(costs.end), here + costs.own, np.inf)
        if not len(cost) or not np.isfinite(cost.min()):
            return nodes
        nodes.append(int(cost.argmin()))
        left[group[nodes[-1]]] = False


def _closure(before: Sequence[tuple[int, int]], count: int) -> np.ndarray:
    """Return a table (count, count) that is True if the first group must come before the second."""
    earlier = np.zeros((count, count), bool)
    for a, b in before:
        earlier[a, b] = True
    for k in range(count):
        earlier |= earlier[:, k, None] & earlier[k]
    return earlier
