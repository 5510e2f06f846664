"""Lower bound on the cost of a tour through groups of nodes: a linear program with generated columns and cuts.

The relaxation is a circulation in the complete graph of nodes that leaves each group once. Cuts are those of the
sequential ordering problem (Balas, Fischetti and Pulleyblank, 1995), on groups: one tour leads from the begin to each
group without its successors, from each group to the end without its predecessors, and from a group to its successor.
They are found by minimum cuts. Any dual solution gives a bound, because reduced costs of all moves are computed, so
rounding of the solver does not matter.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

VIOLATED = 0.02  # least violation of a cut that is added
CUTS_PER_ROUND = 80
COLUMNS_PER_ROUND = 3000
SETTLED = 100  # columns that a round may add, and still count for the end
STALLED, RISE = 6, 0.002  # the bound stops if it rose by less than this share of the gap in so many rounds
MOST_SINKS = 80  # groups to each of which a minimum cut is computed; of more, one in each part of the flow
STRONG = 0.5  # flow that connects two groups to a part
SCALE = 1_000_000  # capacities of a minimum cut are integers


class TourBound(NamedTuple):
    """A lower bound, and what each move adds to it.

    Axes: n nodes and the home, whose number is n.
    """

    cost: float  # no tour costs less [s]
    reduced: Float[np.ndarray, "N N"]  # a tour with this move costs at least `cost` plus this [s]; inf: not possible


def tour_bound(
    group: Int[np.ndarray, "n"],
    cost: Float[np.ndarray, "N N"],
    before: Bool[np.ndarray, "m m"],
    tour: list[int],
    rounds: int,
) -> TourBound:
    """Return a lower bound on the cost of tours that visit each group once.

    Args:
        group: Group of each node, from 0 to m - 1.
        cost: Cost of each move; number n is home, inf is not possible [s]. Not negative.
        before: Transitive precedence.
        tour: Nodes of a tour, in order of travel: the first columns of the program.
        rounds: Linear programs to solve at most.

    Returns:
        The bound, with reduced costs [s].
    """
    m = len(before)
    group = np.append(group, m)
    length = float(cost[[len(group) - 1, *tour], [*tour, len(group) - 1]].sum())
    best = TourBound(0.0, cost)
    columns = _first_columns(cost, tour)
    cuts = np.zeros((0, m + 1, m + 1), bool)
    history: list[float] = []  # bounds of rounds in which few columns were missing
    for _ in range(rounds):
        solution = _solve(group, cost, columns, cuts)
        if solution is None:
            return best
        flow, prices, weights = solution
        reduced = _reduced(group, cost, prices, weights, cuts)
        least = np.full(m + 1, np.inf)
        np.minimum.at(least, group, reduced.min(axis=1))
        constant = float(prices[len(group) :].sum() + weights.sum())
        found = constant + float(least.sum())  # a tour leaves each group once
        if found > best.cost:
            best = TourBound(found, np.maximum(reduced - least[group][:, None], 0.0))
        if best.cost >= length * (1 - 1e-9):
            break
        priced = reduced < -1e-7
        priced[columns] = False
        if priced.any():
            where = np.flatnonzero(priced)
            chosen = where[np.argsort(reduced.ravel()[where], kind="stable")[:COLUMNS_PER_ROUND]]
            more = np.unravel_index(chosen, cost.shape)
            columns = tuple(np.concatenate(pair) for pair in zip(columns, more, strict=True))
        between = np.zeros((m + 1, m + 1))
        np.add.at(between, (group[columns[0][: len(flow)]], group[columns[1][: len(flow)]]), flow)
        added = _cuts(between, before) if found > 0.98 * best.cost or not priced.any() else cuts[:0]
        if priced.sum() < SETTLED:
            history.append(best.cost)
        stalled = len(history) > STALLED and best.cost - history[-STALLED] < RISE * (length - best.cost)
        if stalled or not (priced.any() or len(added)):
            break
        cuts = np.concatenate([cuts[weights > 0] if len(cuts) > 600 else cuts, added])
    return best


def _reduced(group, cost, prices, weights, cuts) -> Float[np.ndarray, "N N"]:
    n = len(group)
    node, leaving = prices[:n], prices[n:]
    dual = np.tensordot(weights, cuts, axes=1) if len(cuts) else np.zeros((len(leaving), len(leaving)))
    return cost - node[:, None] + node[None, :] - (leaving[:, None] + dual)[group[:, None], group[None, :]]


def _first_columns(cost: Float[np.ndarray, "N N"], tour: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Tails and heads of the cheapest moves of each node, and of the tour's."""
    n = len(cost) - 1
    keep = np.zeros(cost.shape, bool)
    near = min(6, n)
    np.put_along_axis(keep, np.argpartition(cost, near, axis=1)[:, :near], True, axis=1)
    np.put_along_axis(keep, np.argpartition(cost, near, axis=0)[:near], True, axis=0)
    keep[n], keep[:, n] = True, True
    keep &= np.isfinite(cost)
    keep[[n, *tour], [*tour, n]] = True
    return np.nonzero(keep)


def _solve(group, cost, columns, cuts):
    """Flow of each column, prices of nodes and groups, and of cuts; None if the solver gives no solution."""
    from scipy.optimize import linprog
    from scipy.sparse import coo_array, csr_array

    n, m = len(group), int(group[-1]) + 1
    tails, heads = columns
    number = np.arange(len(tails))
    ones = np.ones(len(tails))
    rows = np.concatenate([tails, heads, n + group[tails]])
    equal = coo_array((np.concatenate([ones, -ones, ones]), (rows, np.tile(number, 3))), shape=(n + m, len(tails)))
    right = np.append(np.zeros(n), np.ones(m))
    crossing = csr_array(-cuts[:, group[tails], group[heads]].astype(float)) if len(cuts) else None
    found = linprog(
        cost[tails, heads], crossing, -np.ones(len(cuts)) if len(cuts) else None, equal.tocsr(), right, method="highs"
    )
    if found.status != 0:
        return None
    weights = np.maximum(-found.ineqlin.marginals, 0.0) if len(cuts) else np.zeros(0)
    return found.x, found.eqlin.marginals, weights


def _cuts(between: Float[np.ndarray, "M M"], before: Bool[np.ndarray, "m m"]) -> Bool[np.ndarray, "c M M"]:
    """Violated cuts of a flow between groups, the most violated first; the last group is home."""
    m = len(before)
    flow = np.zeros((m + 2, m + 2))  # home is split: m is the begin, m + 1 the end
    flow[: m + 1, :m] = between[:, :m]
    flow[:m, m + 1] = between[:m, m]
    capacity = np.rint(flow * SCALE).astype(np.int32)
    into = range(m) if m <= MOST_SINKS else _one_of_each_part(between[:m, :m])
    cases = [(m, j, np.append(before[j], [False, True])) for j in into]
    cases += [(j, m + 1, np.append(before[:, j], [True, False])) for j in range(m) if before[:, j].any()]
    for i, j in np.argwhere(before):
        cases.append((i, j, np.append(before[:, i] | before[j], [True, True])))
    found: dict[bytes, tuple[float, np.ndarray]] = {}
    for source, sink, removed in cases:
        value, side = _minimum_cut(capacity, source, sink, removed)
        if value < 1 - VIOLATED:
            crossing = np.outer(side, ~side & ~removed)
            made = np.zeros((m + 1, m + 1), bool)
            made[:, :m] = crossing[: m + 1, :m]
            made[:m, m] = crossing[:m, m + 1]
            found.setdefault(made.tobytes(), (value, made))
    ordered = sorted(found.values(), key=lambda pair: pair[0])[:CUTS_PER_ROUND]
    return np.array([made for _, made in ordered]).reshape(-1, m + 1, m + 1)


def _one_of_each_part(between: Float[np.ndarray, "m m"]) -> list[int]:
    """Return the first group of each part that moves with a flow of at least STRONG connect."""
    from scipy.sparse.csgraph import connected_components

    return np.unique(connected_components(between >= STRONG, directed=False)[1], return_index=True)[1].tolist()


def _minimum_cut(capacity, source: int, sink: int, removed) -> tuple[float, np.ndarray]:
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import breadth_first_order, maximum_flow

    stays = np.flatnonzero(~removed)
    part = csr_array(capacity[np.ix_(stays, stays)])
    begin, end = (int(np.searchsorted(stays, each)) for each in (source, sink))
    result = maximum_flow(part, begin, end)
    side = np.zeros(len(capacity), bool)
    rest = csr_array(part - result.flow)
    rest.data[rest.data < 0] = 0
    rest.eliminate_zeros()
    side[stays[breadth_first_order(rest, begin, return_predecessors=False)]] = True
    return result.flow_value / SCALE, side
