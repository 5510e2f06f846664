"""Search for a short tour through many groups: as `tour_search`, but an insertion keeps the nodes of other groups.

The best nodes of an order are computed anew only after every few steps, by dynamic programming, which costs more than
these steps.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.sequencing.tour_search import EPOCHS, GroupCosts, best_slots, ranks, replace_worst, temperature_at

CHAINS = 8
REMOVED = 8  # groups that a step removes at most
REFRESH = 20  # steps after which the nodes are chosen anew
STEP_WORK_S, NUMBER_WORK_S = 2.5e-4, 2.4e-8  # work of an insertion, and of a cost that it compares [s]


class _Moves(NamedTuple):
    """Costs between nodes. Axes: n nodes, then home, then a node for padding."""

    group: Int[np.ndarray, "n"]
    node: Int[np.ndarray, "m K"]
    ahead: Float[np.ndarray, "N N"]  # from row to column
    behind: Float[np.ndarray, "N N"]  # its transpose, for reading by rows
    before: Bool[np.ndarray, "m m"]


def search_long(
    costs: GroupCosts, rng: np.random.Generator, effort: float, hint: Int[np.ndarray, "m"] | None = None
) -> tuple[Int[np.ndarray, "m"], float]:
    """Return the shortest order of the groups that the search finds, and its cost [s].

    Args:
        costs: Costs by group [s].
        rng: Random numbers.
        effort: Work [s], a unit that does not depend on the machine's load.
        hint: An order from which half of the chains begin; it has to respect the precedence.
    """
    moves, chains = _moves(costs), np.arange(CHAINS)
    m = len(costs.node)
    home = len(moves.group)
    first = rng.permuted(np.tile(np.arange(m), (CHAINS, 1)), axis=1)
    nodes = _inserted(moves, np.empty((CHAINS, 0), int), first)
    if hint is not None:
        nodes[: CHAINS // 2] = costs.node[hint, 0]
    nodes, lengths = _refreshed(costs, moves, nodes)
    best, shortest = nodes.copy(), lengths.copy()
    most = min(REMOVED, m - 1)
    steps = max(EPOCHS, int(effort / ((1 + most) / 2 * (STEP_WORK_S + CHAINS * costs.node.size * NUMBER_WORK_S))))
    near = ranks(costs)
    for step in range(steps if m > 1 else 0):
        temperature = temperature_at(shortest, m, step / steps)
        number = int(rng.integers(1, most + 1))
        line = moves.group[nodes]
        seeds = rng.integers(m, size=CHAINS)
        seed_groups = line[chains, seeds]
        close = np.where(
            rng.random((CHAINS, 1)) < 0.5, near[seed_groups[:, None], line], np.abs(np.arange(m) - seeds[:, None])
        )
        chosen = np.argpartition((close + 1.0) * rng.uniform(0.5, 1.5, (CHAINS, m)), number, axis=1)[:, :number]
        stays = np.ones((CHAINS, m), bool)
        np.put_along_axis(stays, chosen, False, axis=1)
        groups = np.take_along_axis(line, rng.permuted(chosen, axis=1), axis=1)
        tried = _inserted(moves, nodes[stays].reshape(CHAINS, m - number), groups)
        found = _lengths(moves, tried, home)
        accept = found < lengths - temperature * np.log(rng.uniform(1e-12, 1.0, CHAINS))
        nodes[accept], lengths[accept] = tried[accept], found[accept]
        if (step + 1) % REFRESH == 0 or step + 1 == steps:
            nodes, lengths = _refreshed(costs, moves, nodes)
            better = lengths < shortest
            best[better], shortest[better] = nodes[better], lengths[better]
        if (step + 1) % max(1, steps // EPOCHS) == 0:
            replace_worst((nodes, lengths), (best, shortest))
    at = int(np.argmin(shortest))
    return moves.group[best[at]], float(shortest[at])


def _moves(costs: GroupCosts) -> _Moves:
    home = int(costs.node.max()) + 1
    real = costs.node >= 0
    group = np.empty(home, int)
    group[costs.node[real]] = np.nonzero(real)[0]
    ahead = np.full((home + 2, home + 2), costs.far)
    node = np.where(real, costs.node, home + 1)
    ahead[node[:, None, :, None], node[None, :, None, :]] = costs.move
    ahead[home, node], ahead[node, home] = costs.begin, costs.end
    ahead[home + 1], ahead[:, home + 1] = costs.far, costs.far
    return _Moves(group, node, ahead, np.ascontiguousarray(ahead.T), costs.before)


def _inserted(moves: _Moves, nodes: Int[np.ndarray, "B L"], groups: Int[np.ndarray, "B q"]) -> Int[np.ndarray, "B M"]:
    """Insert groups one after another, each where it costs least and the precedence allows it."""
    home, chains = len(moves.group), np.arange(len(nodes))
    for group in groups.T:
        length = nodes.shape[1]
        line = moves.group[nodes]
        ends = np.full((len(nodes), 1), home)
        last, following = np.concatenate([ends, nodes], axis=1), np.concatenate([nodes, ends], axis=1)
        slots = moves.node[group]
        added = moves.behind[slots[:, :, None], last[:, None]] + moves.ahead[slots[:, :, None], following[:, None]]
        slot = added.argmin(axis=1)
        total = added.min(axis=1) - moves.ahead[last, following]
        place = np.arange(length + 1)
        if length and moves.before.any():
            low = np.max((place[:-1] + 1) * moves.before[line, group[:, None]], axis=1)
            high = np.min(np.where(moves.before[group[:, None], line], place[:-1], length), axis=1)
            total[(place < low[:, None]) | (place > high[:, None])] = np.inf
        at = np.argmin(total, axis=1)[:, None]
        made = np.take_along_axis(following, place - (place > at), axis=1)
        np.put_along_axis(made, at, slots[chains, slot[chains, at[:, 0]]][:, None], axis=1)
        nodes = made
    return nodes


def _lengths(moves: _Moves, nodes: Int[np.ndarray, "B m"], home: int) -> Float[np.ndarray, "B"]:
    inner = moves.ahead[nodes[:, :-1], nodes[:, 1:]].sum(axis=1)
    return inner + moves.ahead[home, nodes[:, 0]] + moves.ahead[nodes[:, -1], home]


def _refreshed(
    costs: GroupCosts, moves: _Moves, nodes: Int[np.ndarray, "B m"]
) -> tuple[Int[np.ndarray, "B m"], Float[np.ndarray, "B"]]:
    """Best nodes of each order, and its cost [s]."""
    line = moves.group[nodes]
    made = moves.node[line, best_slots(costs, line)]
    return made, _lengths(moves, made, len(moves.group))
