"""Order of the seams of a job: a generalised travelling-salesman problem with precedence.

A node is one way to do a seam: its configurations at begin and end, and its direction. The nodes of a seam are a group.
A tour begins at home, visits one node of each group and ends at home. Three parts work together: `tour_search` finds a
short tour, `tour_bound` a lower bound with reduced costs, and `tour_states` closes the gap between them, or a part of
it, by dynamic programming. CP-SAT of OR-Tools, a circuit with optional nodes, continues with the moves that a shorter
tour can contain. If no tour visits all groups, CP-SAT alone decides which groups are skipped. The other parts are not
left to CP-SAT, because alone it proves no useful bound for 14 groups of 8 nodes in a minute.
"""

from collections.abc import Iterable
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.errors import InputError, install_command
from htcp_jax.sequencing.long_tour import search_long
from htcp_jax.sequencing.tour_bound import tour_bound
from htcp_jax.sequencing.tour_search import group_costs, nodes_of, search, without_far
from htcp_jax.sequencing.tour_states import MOST_GROUPS, closed_gap

TOTAL = 2**40  # cost of the tour that is known, as an integer: costs of moves are rounded to 1e-12 of it
ROUNDS, FEW_NODES = 12, 320  # linear programs of the bound for each unit of effort, with at most so many nodes
MOVES = 20_000  # in CP-SAT's model at most: with more it closed none of the gaps that were measured
MOVES_SKIPPING = 150_000  # the same, if it decides which groups are skipped
FEW = 80  # groups: beyond these, the search keeps the nodes of groups that it does not move
AGAIN = 0.4  # share of the effort of a search that begins with a known long tour
SHARES = 0.4, 0.2, 0.4  # of the effort: for the search, for CP-SAT, and for states between tour and bound
STATE_WORK_S = 4e-6  # work of a state [s]


class Order(NamedTuple):
    """Order in which the seams are done, and how.

    Groups of which no node is in `nodes` are skipped.
    """

    nodes: list[int]  # one node of each visited group, in order of travel
    cost: float  # of the tour [s]
    bound: float  # no tour that visits as many groups costs less [s]


def shortest_order(
    group: Int[np.ndarray, "n"],
    own_cost: Float[np.ndarray, "n"],
    move_cost: Float[np.ndarray, "n n"],
    begin_cost: Float[np.ndarray, "n"],
    end_cost: Float[np.ndarray, "n"],
    before: Iterable[tuple[int, int]],
    *,
    seed: int,
    effort: float,
    hint: list[int] | None = None,
    only: Literal["tour", "bound"] | None = None,
) -> Order:
    """Return a short tour that visits one node of each group, with a lower bound on the cost of all tours.

    If no tour that visits all groups is found, some are skipped, as few as possible. Precedence holds between visited
    groups, also through one that is skipped. The result repeats for equal arguments: the work is limited, not the time.

    Args:
        group: Group of each node, (n,); a group is any integer.
        own_cost: Cost of each node itself, (n,) [s].
        move_cost: Cost from the end of a node (row) to the begin of another (column), (n, n); inf: not possible [s].
        begin_cost: Cost from home to the begin of each node, (n,); zeros if the tour is open [s].
        end_cost: Cost from the end of each node back home, (n,); zeros if the tour is open [s].
        before: Pairs of groups: the first is visited before the second. Without a cycle.
        seed: Seed of the search.
        effort: Work, about the seconds that it takes on one idle core of 3 GHz [s].
        hint: Nodes of a tour that is known, in order of travel.
        only: "bound" keeps the tour of `hint`; "tour", for more than FEW groups, omits the bound, which is then 0.

    Returns:
        The tour. The bound is 0 if nothing better was proven; if it is more, no tour visits more groups.

    Raises:
        InputError: OR-Tools is not installed, costs are negative or NaN, or `before` has a cycle.
    """
    cp_model = _cp_model()
    costs = tuple(np.asarray(each, float) for each in (own_cost, move_cost, begin_cost, end_cost))
    if any(not np.all(each >= 0) for each in costs):
        raise InputError("costs of an order are negative or NaN: at least 0 s, or inf, is needed")
    own, move, begin, end = costs
    names, group = np.unique(np.asarray(group, int), return_inverse=True)
    index = {int(name): number for number, name in enumerate(names)}
    pairs = [(index[a], index[b]) for a, b in before if a in index and b in index]
    after = _closure(pairs, len(names))
    if after.diagonal().any():
        listed = ", ".join(map(str, names[after.diagonal()]))
        raise InputError(f"the groups {listed} are before each other: an order without cycles is needed")
    home = len(group)
    cost = np.full((home + 1, home + 1), np.inf)
    cost[:home, :home] = move + own
    cost[home, :home], cost[:home, home] = begin + own, end
    cost[:home, :home][group[:, None] == group] = np.inf
    cost[:home, :home][after.T[group[:, None], group]] = np.inf
    kept = _possible(cost)
    if not len(kept):
        return Order([], 0.0, 0.0)
    rows = np.append(kept, home)
    known = {int(node): place for place, node in enumerate(kept)}
    groups, inner = np.unique(group[kept], return_inverse=True)
    problem = _Problem(inner, cost[np.ix_(rows, rows)], after[np.ix_(groups, groups)])
    start = [known[node] for node in hint or [] if node in known]
    tour, bound = _solve(cp_model, problem, start, seed, effort, only)
    return Order([int(kept[node]) for node in tour], problem.cost_of(tour), bound)


class _Problem(NamedTuple):
    """Problem of the nodes that a tour can contain; home is node n.

    A cost is that of a move and of the node to which it leads.
    """

    group: Int[np.ndarray, "n"]
    cost: Float[np.ndarray, "N N"]
    before: Bool[np.ndarray, "m m"]

    def cost_of(self, tour: list[int]) -> float:
        """Return the cost of a tour [s]."""
        home = len(self.group)
        return float(self.cost[[home, *tour], [*tour, home]].sum()) if tour else 0.0


def check_solver() -> None:
    """Raise InputError if OR-Tools is not installed."""
    _cp_model()


def _cp_model():
    try:
        from ortools.sat.python import cp_model
    except ImportError:
        raise InputError(f"an order of seams needs OR-Tools: {install_command('order')}") from None
    return cp_model


def _closure(pairs: list[tuple[int, int]], count: int) -> Bool[np.ndarray, "m m"]:
    made = np.zeros((count, count), bool)
    for a, b in pairs:
        made[a, b] = True
    for middle in range(count):
        made |= made[:, middle, None] & made[middle]
    return made


def _possible(cost: Float[np.ndarray, "N N"]) -> Int[np.ndarray, "k"]:
    """Nodes that a possible path from home can reach, and from which one can return home."""
    finite = np.isfinite(cost)
    found = np.ones(len(cost), bool)
    for links in (finite, finite.T):
        reached = np.arange(len(cost)) == len(cost) - 1
        while (more := reached | links[reached].any(axis=0)).sum() > reached.sum():
            reached = more
        found &= reached
    return np.flatnonzero(found[:-1])


def _solve(
    cp_model,
    problem: _Problem,
    start: list[int],
    seed: int,
    effort: float,
    only: Literal["tour", "bound"] | None = None,
) -> tuple[list[int], float]:
    """Best tour, and a lower bound on tours that visit as many groups [s]."""
    group, cost, before = problem
    count, home = len(before), len(group)
    costs = group_costs(group, cost[home, :home], cost[:home, home], cost[:home, :home], before)
    hint = group[start] if sorted(group[start]) == list(range(count)) and _respects(group[start], before) else None
    only = only if count > FEW or only == "bound" else None
    if only == "tour" and hint is not None:
        effort *= AGAIN
    if only == "bound" and hint is not None:
        tour = start
    else:
        share, find = SHARES[0] if count <= MOST_GROUPS else 1.0, search if count <= FEW else search_long
        order, length = find(costs, np.random.default_rng(seed), share * effort, hint)
        if length >= costs.far:
            return _skipping(cp_model, problem, without_far(costs, order), seed, effort / 2)
        tour = nodes_of(costs, order)
    length = problem.cost_of(tour)
    if only == "tour":
        return tour, 0.0
    cost = np.where(_excluded(group, before), np.inf, cost)
    lower = tour_bound(group, cost, before, tour, max(10, int(ROUNDS * effort * min(1.0, FEW_NODES / home))))
    if lower.cost >= length * (1 - 1e-9):
        return tour, min(lower.cost, length)
    most = int(SHARES[2] * effort / (count * STATE_WORK_S))
    other, closed = closed_gap(group, cost, lower.reduced, before, length - lower.cost, most)
    if other and problem.cost_of(other) < length:
        tour, length = other, problem.cost_of(other)
    bound = min(lower.cost + closed, length)
    if bound >= length * (1 - 1e-9):
        return tour, bound
    moves = np.isfinite(cost) & (lower.cost + lower.reduced <= length * (1 + 1e-9))
    moves[[home, *tour], [*tour, home]] = True
    if moves.sum() > MOVES:
        return tour, bound
    found, proven = _by_cp_sat(cp_model, problem, moves, tour, bound, False, seed, SHARES[1] * effort)
    return found, min(max(bound, proven), problem.cost_of(found))


def _skipping(
    cp_model, problem: _Problem, order: Int[np.ndarray, "k"], seed: int, effort: float
) -> tuple[list[int], float]:
    """Best tour of the groups in an order that is possible, or of more or other groups by CP-SAT, and its bound [s]."""
    group, cost, before = problem
    tour: list[int] = []
    if len(order):
        kept = np.flatnonzero(np.isin(group, order))
        groups, inner = np.unique(group[kept], return_inverse=True)
        rows = np.append(kept, len(group))
        fewer = _Problem(inner, cost[np.ix_(rows, rows)], before[np.ix_(groups, groups)])
        first = [int(np.flatnonzero(inner == np.flatnonzero(groups == each)[0])[0]) for each in order]
        tour = [int(kept[node]) for node in _solve(cp_model, fewer, first, seed, effort)[0]]
    moves = np.isfinite(cost)
    if moves.sum() > MOVES_SKIPPING:
        return tour, 0.0
    return _by_cp_sat(cp_model, problem, moves, tour, 0.0, True, seed, effort)


def _respects(order: Int[np.ndarray, "k"], before: Bool[np.ndarray, "m m"]) -> bool:
    return not np.any(np.tril(before[np.ix_(order, order)]))


def _excluded(group: Int[np.ndarray, "n"], before: Bool[np.ndarray, "m m"]) -> Bool[np.ndarray, "N N"]:
    """Moves that contradict the precedence if all groups are visited: past a group that has to be between."""
    count = len(before)
    made = np.zeros((count + 1, count + 1), bool)
    made[:count, :count] = before.T | (before.astype(int) @ before.astype(int) > 0)
    made[count, :count], made[:count, count] = before.any(axis=0), before.any(axis=1)
    of_node = np.append(group, count)
    return made[of_node[:, None], of_node]


def _by_cp_sat(
    cp_model,
    problem: _Problem,
    moves: Bool[np.ndarray, "N N"],
    tour: list[int],
    lower: float,
    may_skip: bool,
    seed: int,
    effort: float,
) -> tuple[list[int], float]:
    """Best tour of the moves, and its bound [s], by CP-SAT.

    Costs become integers: rounded down, so that the bound stays true. A tour of k moves is at most k units cheaper.
    """
    group, cost, before = problem
    home, count = len(group), len(before)
    tails, heads = np.nonzero(moves)
    top = float(cost[tails, heads].max())
    scale = TOTAL / max(top * (count + 1), 1e-300)
    units = np.floor(cost[tails, heads] * scale).astype(np.int64)
    model = cp_model.CpModel()
    literals = [model.new_bool_var("") for _ in tails]
    visited = [model.new_bool_var("") for _ in range(home)]
    arcs = [(int(a), int(b), literal) for a, b, literal in zip(tails, heads, literals, strict=True)]
    arcs += [(node, node, ~visited[node]) for node in range(home)]
    if may_skip:
        is_idle = model.new_bool_var("")  # nothing is visited: the circuit is home alone
        arcs.append((home, home, is_idle))
        model.add_hint(is_idle, not tour)
    model.add_circuit(arcs)
    skipped = []
    for k in range(count):
        members = [visited[node] for node in np.flatnonzero(group == k)]
        if may_skip:
            skipped.append(model.new_bool_var(""))
            members.append(skipped[-1])
            model.add_hint(skipped[-1], not np.isin(group[tour], k).any())
        model.add_exactly_one(members)
    if before.any():
        _add_precedence(model, problem, tails, heads, literals, tour)
    penalty = TOTAL + 1  # more than any tour
    total = cp_model.LinearExpr.weighted_sum(literals, units.tolist())
    if not may_skip:
        model.add(total >= int(np.floor(lower * scale)) - count - 1)
    model.minimize(total + penalty * sum(skipped))
    chosen = {(a, b) for a, b in zip([home, *tour], [*tour, home], strict=True)} if tour else set()
    for a, b, literal in zip(tails.tolist(), heads.tolist(), literals, strict=True):
        model.add_hint(literal, (a, b) in chosen)
    for node in range(home):
        model.add_hint(visited[node], node in tour)
    solver = cp_model.CpSolver()
    solver.parameters.num_workers = 1  # with more, processor time grows faster than the part of the gap that is closed
    solver.parameters.linearization_level = 2
    solver.parameters.random_seed = seed % 2**31
    solver.parameters.max_deterministic_time = effort
    status = solver.solve(model)
    if status not in (cp_model.OPTIMAL, cp_model.FEASIBLE):
        return tour, lower
    after = {
        a: b for a, b, literal in zip(tails.tolist(), heads.tolist(), literals, strict=True) if solver.value(literal)
    }
    found, node = [], after.get(home, home)
    while node != home:
        found.append(node)
        node = after[node]
    missing = count - len(found)
    bound = max(0.0, (solver.best_objective_bound - penalty * missing) / scale)
    if len(found) < len(tour) or (len(found) == len(tour) and problem.cost_of(found) > problem.cost_of(tour)):
        found = tour
    return found, bound


def _add_precedence(model, problem: _Problem, tails, heads, literals, tour: list[int]) -> None:
    """Constrain the places of groups in the tour: one move leads to the next place."""
    group, _, before = problem
    count = len(before)
    ranks = {int(group[node]): place for place, node in enumerate(tour)}
    places = [model.new_int_var(0, count - 1, "") for _ in range(count)]
    for k, place in enumerate(places):
        model.add_hint(place, ranks.get(k, 0))
    between: dict[tuple[int, int], list] = {}
    inner = (tails < len(group)) & (heads < len(group))
    for at in np.flatnonzero(inner):
        between.setdefault((int(group[tails[at]]), int(group[heads[at]])), []).append(literals[at])
    for (a, b), each in between.items():
        for literal in each if len(each) == 1 else [_any_of(model, each)]:
            model.add(places[b] >= places[a] + 1).only_enforce_if(literal)
    direct = before & ~(before.astype(int) @ before.astype(int) > 0)
    for a, b in np.argwhere(direct).tolist():
        model.add(places[a] + 1 <= places[b])


def _any_of(model, literals):
    made = model.new_bool_var("")
    model.add(sum(literals) == made)
    return made
