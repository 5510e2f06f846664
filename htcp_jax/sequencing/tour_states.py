"""Exact search between a lower bound and a known tour: dynamic programming over sets of visited groups.

A state is a set of visited groups and the last node. The cost of a tour is at least the lower bound plus the reduced
costs of its moves, so a state is dropped if the reduced costs up to it, and the least from there home, exceed the gap
(bounded dynamic programming; Christofides, Mingozzi and Toth, 1981). If too many states remain, those with the largest
sums are dropped, too, and the gap that is searched completely gets smaller. Either way this part of the gap is closed.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

MOST_GROUPS = 62  # a set of groups is an integer of 64 bits


def closed_gap(
    group: Int[np.ndarray, "n"],
    cost: Float[np.ndarray, "N N"],
    reduced: Float[np.ndarray, "N N"],
    before: Bool[np.ndarray, "m m"],
    gap: float,
    most: int,
) -> tuple[list[int], float]:
    """Return the shortest tour that is found, [] if none is, and the part of the gap that is closed [s].

    No tour other than the one that is found, and shorter than it, costs less than the lower bound plus this part.

    Args:
        group: Group of each node, from 0 to m - 1.
        cost: Cost of each move; number n is home, inf is not possible [s].
        reduced: Reduced cost of each move, not negative; a tour costs at least the lower bound plus their sum [s].
        before: Transitive precedence.
        gap: Cost of the known tour less the lower bound [s].
        most: Number of states per layer at most; layer k has sets of k groups.
    """
    home, count = len(group), len(before)
    if count > MOST_GROUPS:
        return [], 0.0
    ahead = [reduced[:home, home]]
    for _ in range(count - 1):
        ahead.append((reduced[:home, :home] + ahead[-1]).min(axis=1))
    tails, heads = np.nonzero(np.isfinite(cost[:home, :home]) & (reduced[:home, :home] < gap))
    first = np.searchsorted(tails, np.arange(home + 1))
    bit = np.left_shift(1, group)
    needs = np.array([sum(1 << int(each) for each in np.flatnonzero(before[:, k])) for k in group])
    node = np.flatnonzero((needs == 0) & (reduced[home, :home] + ahead[-1] < gap))
    visited, true, sums = bit[node], cost[home, node], reduced[home, node]
    layers: list[tuple[np.ndarray, np.ndarray]] = [(node, np.zeros(len(node), int))]
    for left in range(count - 2, -1, -1):
        number = first[node + 1] - first[node]
        source = np.repeat(np.arange(len(node)), number)
        arc = np.arange(len(source)) - np.repeat(np.cumsum(number) - number, number) + np.repeat(first[node], number)
        head = heads[arc]
        bound = sums[source] + reduced[node[source], head] + ahead[left][head]
        have = visited[source]
        stays = np.flatnonzero((bound < gap) & (have & bit[head] == 0) & (have & needs[head] == needs[head]))
        source, head, bound = source[stays], head[stays], bound[stays]
        reached, length = visited[source] | bit[head], true[source] + cost[node[source], head]
        order = np.lexsort((length, head, reached))
        is_new = np.ones(len(order), bool)
        is_new[1:] = (np.diff(reached[order]) != 0) | (np.diff(head[order]) != 0)
        order = order[is_new]
        if len(order) > most:
            gap = float(np.partition(bound[order], most)[most])
            order = order[bound[order] < gap]
        sums = sums[source[order]] + reduced[node[source[order]], head[order]]
        node, visited, true = head[order], reached[order], length[order]
        layers.append((node, source[order]))
    total = true + cost[node, home]
    if not np.isfinite(total).any():
        return [], gap
    at = int(np.argmin(total))
    tour = []
    for nodes, parents in reversed(layers):
        tour.append(int(nodes[at]))
        at = int(parents[at])
    return tour[::-1], gap
