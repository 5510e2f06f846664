"""Search for a short tour through groups of nodes: cheapest insertion, then ruin and recreate with annealing.

A tour is stored as an order of the groups; the best node of each group follows from it by dynamic programming over
the groups in order. A step removes a few groups that are close to each other and inserts each again where it costs
least, as in "slack induction by string removals" (Christiaens and Vanden Berghe, 2020). Several tours, the chains, are
changed side by side by NumPy. Results repeat for a seed: the number of steps depends on the effort and on the size of
the problem.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

CHAINS = 16
STEP_WORK_S = 1.5e-5  # work of one place of the tour in one insertion, see `steps_of` [s]
NUMBER_WORK_S = 4e-9  # work of one sum of costs [s]
HOT, COLD = 0.1, 0.002  # temperatures at begin and end, as shares of a tour's mean cost per group
EPOCHS = 10  # times that the worst chains are replaced by the best


class GroupCosts(NamedTuple):
    """Costs of a problem by groups, whose K nodes are padded with nodes that cost `far`.

    Axes: m groups, K nodes of a group. Costs are in the unit of the input, [s].
    """

    node: Int[np.ndarray, "m K"]  # number of the node; -1: padding
    begin: Float[np.ndarray, "m K"]
    end: Float[np.ndarray, "m K"]
    move: Float[np.ndarray, "m m K K"]
    before: Bool[np.ndarray, "m m"]  # [a, b]: a is before b, directly or through others
    far: float  # cost of a move that is not possible: more than any tour of possible moves


def group_costs(
    group: Int[np.ndarray, "n"],
    begin: Float[np.ndarray, "n"],
    end: Float[np.ndarray, "n"],
    move: Float[np.ndarray, "n n"],
    before: Bool[np.ndarray, "m m"],
) -> GroupCosts:
    """Return costs by group, of groups that are numbered from 0 to m - 1.

    Args:
        group: Group of each node.
        begin: Cost from home to each node and of the node itself [s].
        end: Cost from each node back home [s].
        move: Cost from each node to each node, and of the latter itself [s].
        before: Transitive precedence.

    Returns:
        The costs; moves that are not possible (inf) cost `far`.
    """
    members = [np.flatnonzero(group == k) for k in range(len(before))]
    node = np.full((len(before), max(map(len, members))), -1)
    for row, each in zip(node, members, strict=True):
        row[: len(each)] = each
    finite = [values[np.isfinite(values)] for values in (begin, end, move)]
    far = 2.0 * (len(before) + 1) * max((float(values.max()) for values in finite if values.size), default=0.0) + 1.0
    padded = [np.where(node < 0, far, np.minimum(values[node], far)) for values in (begin, end)]
    moves = np.minimum(move[node[:, None, :, None], node[None, :, None, :]], far)
    missing = (node < 0)[:, None, :, None] | (node < 0)[None, :, None, :]
    return GroupCosts(node, *padded, np.where(missing, far, moves), before, far)


def steps_of(effort: float, costs: GroupCosts, removed: float) -> int:
    """Return the number of steps whose work is an effort [s], at least one for each epoch."""
    m, k = costs.node.shape
    insertion = 2 * m * STEP_WORK_S + 4 * CHAINS * m * k * k * NUMBER_WORK_S
    return max(EPOCHS, int(effort / (removed * insertion)))


def search(
    costs: GroupCosts, rng: np.random.Generator, effort: float, hint: Int[np.ndarray, "m"] | None = None
) -> tuple[Int[np.ndarray, "m"], float]:
    """Return the shortest order of the groups that the search finds, and its cost [s].

    Args:
        costs: Costs by group [s].
        rng: Random numbers.
        effort: Work [s], a unit that does not depend on the machine's load.
        hint: An order from which half of the chains begin; it has to respect the precedence.
    """
    m = len(costs.node)
    orders = _inserted(costs, np.empty((CHAINS, 0), int), rng.permuted(np.tile(np.arange(m), (CHAINS, 1)), axis=1))
    if hint is not None:
        orders[: CHAINS // 2] = hint
    lengths = lengths_of(costs, orders)
    best, shortest = orders.copy(), lengths.copy()
    removed = max(1, min(10, m // 3))
    steps = steps_of(effort, costs, (1 + removed) // 2)
    near = ranks(costs)
    chains = np.arange(CHAINS)
    for step in range(steps if m > 2 else 0):
        temperature = temperature_at(shortest, m, step / steps)
        number = int(rng.integers(1, removed + 1))
        seeds = rng.integers(m, size=CHAINS)
        place = np.argsort(orders, axis=1)
        apart = np.abs(place - place[chains, seeds][:, None])  # in the order
        close = np.where(rng.random((CHAINS, 1)) < 0.5, near[seeds], apart)
        chosen = np.argsort((close + 1.0) * rng.uniform(0.5, 1.5, (CHAINS, m)), axis=1)[:, :number]
        stays = np.ones((CHAINS, m), bool)
        np.put_along_axis(stays, chosen, False, axis=1)
        rest = orders[np.take_along_axis(stays, orders, axis=1)].reshape(CHAINS, m - number)
        tried = _inserted(costs, rest, rng.permuted(chosen, axis=1))
        found = lengths_of(costs, tried)
        accept = found < lengths - temperature * np.log(rng.uniform(1e-12, 1.0, CHAINS))
        orders[accept], lengths[accept] = tried[accept], found[accept]
        better = lengths < shortest
        best[better], shortest[better] = orders[better], lengths[better]
        if (step + 1) % max(1, steps // EPOCHS) == 0:
            replace_worst((orders, lengths), (best, shortest))
    first = int(np.argmin(shortest))
    return best[first], float(shortest[first])


def temperature_at(shortest: Float[np.ndarray, "B"], groups: int, share: float) -> float:
    """Return the temperature of the annealing [s].

    Args:
        shortest: Cost of the best tour of each chain [s].
        groups: Number of groups.
        share: Share of the steps that are done [1].
    """
    return float(np.median(shortest)) / (groups + 1) * HOT * (COLD / HOT) ** share


def replace_worst(
    now: tuple[Int[np.ndarray, "B m"], Float[np.ndarray, "B"]],
    best: tuple[Int[np.ndarray, "B m"], Float[np.ndarray, "B"]],
) -> None:
    """Replace the worst quarter of the chains by the best tours of the best quarter.

    Args:
        now: Tours of the chains, and their costs [s]; they are modified.
        best: The best tour of each chain so far, and its cost [s]; they are modified.
    """
    tours, costs = best
    rank = np.argsort(costs, kind="stable")
    worst, first = rank[-len(rank) // 4 :], rank[: len(rank) // 4]
    for each_tours, each_costs in (now, best):
        each_tours[worst], each_costs[worst] = tours[first], costs[first]


def lengths_of(costs: GroupCosts, orders: Int[np.ndarray, "B m"]) -> Float[np.ndarray, "B"]:
    """Return the cost of each order with the best node of each group [s]."""
    return (_prefixes(costs, orders)[-1] + costs.end[orders[:, -1]]).min(axis=1)


def nodes_of(costs: GroupCosts, order: Int[np.ndarray, "m"]) -> list[int]:
    """Return the best node of each group in an order, in order of travel."""
    return [int(node) for node in costs.node[order, best_slots(costs, order[None])[0]]]


def best_slots(costs: GroupCosts, orders: Int[np.ndarray, "B m"]) -> Int[np.ndarray, "B m"]:
    """Return the column in `costs.node` of the best node of each group in each order."""
    ahead = _suffixes(costs, orders)
    slots = np.empty(orders.shape, int)
    slots[:, 0] = np.argmin(costs.begin[orders[:, 0]] + ahead[0], axis=1)
    for place in range(1, orders.shape[1]):
        step = costs.move[orders[:, place - 1], orders[:, place], slots[:, place - 1]]
        slots[:, place] = np.argmin(step + ahead[place], axis=1)
    return slots


def without_far(costs: GroupCosts, order: Int[np.ndarray, "m"]) -> Int[np.ndarray, "k"]:
    """Return an order without the groups that make it use impossible moves; empty if no group can be visited."""
    while len(order) and float(lengths_of(costs, order[None])[0]) >= costs.far:
        if len(order) == 1:
            return order[:0]
        shorter = np.array([np.delete(order, place) for place in range(len(order))])
        order = shorter[int(np.argmin(lengths_of(costs, shorter)))]
    return order


def _inserted(
    costs: GroupCosts, orders: Int[np.ndarray, "B L"], groups: Int[np.ndarray, "B q"]
) -> Int[np.ndarray, "B M"]:
    """Insert groups one after another, each where it costs least and the precedence allows it."""
    for group in groups.T:
        orders = _with_group(costs, orders, group)
    return orders


def _with_group(
    costs: GroupCosts, orders: Int[np.ndarray, "B L"], group: Int[np.ndarray, "B"]
) -> Int[np.ndarray, "B M"]:
    chains, length = orders.shape
    if length == 0:
        return group[:, None]
    arrive = np.empty((length + 1, chains, costs.node.shape[1]))
    leave = np.empty_like(arrive)
    arrive[0], leave[-1] = costs.begin[group], costs.end[group]
    line = orders.T  # places first: each step of the recursion reads one slice
    arrive[1:] = (_prefixes(costs, orders)[..., None] + costs.move[line, group]).min(axis=2)
    leave[:-1] = (costs.move[group, line] + _suffixes(costs, orders)[:, :, None, :]).min(axis=3)
    total = (arrive + leave).min(axis=2)
    place = np.arange(length + 1)[:, None]
    first = np.max((place[:-1] + 1) * costs.before[line, group], axis=0)
    last = np.min(np.where(costs.before[group, line], place[:-1], length), axis=0)
    total[(place < first) | (place > last)] = np.inf
    at = np.argmin(total, axis=0)[:, None]
    made = np.empty((chains, length + 1), orders.dtype)
    column = place.T
    made[:] = np.take_along_axis(orders, np.clip(column - (column > at), 0, length - 1), axis=1)
    np.put_along_axis(made, at, group[:, None], axis=1)
    return made


def _prefixes(costs: GroupCosts, orders: Int[np.ndarray, "B L"]) -> Float[np.ndarray, "L B K"]:
    """Cost from home to each node of the group at each place."""
    step = costs.move[orders.T[:-1], orders.T[1:]]
    made = np.empty((orders.shape[1], len(orders), costs.node.shape[1]))
    made[0] = costs.begin[orders[:, 0]]
    for place in range(1, len(made)):
        np.min(made[place - 1][:, :, None] + step[place - 1], axis=1, out=made[place])
    return made


def _suffixes(costs: GroupCosts, orders: Int[np.ndarray, "B L"]) -> Float[np.ndarray, "L B K"]:
    """Cost from each node of the group at each place, without the node itself, back home."""
    step = costs.move[orders.T[:-1], orders.T[1:]]
    made = np.empty((orders.shape[1], len(orders), costs.node.shape[1]))
    made[-1] = costs.end[orders[:, -1]]
    for place in range(len(made) - 2, -1, -1):
        np.min(step[place] + made[place + 1][:, None, :], axis=2, out=made[place])
    return made


def ranks(costs: GroupCosts) -> Int[np.ndarray, "m m"]:
    """Return the rank of each group by its cheapest move from or to a group: 0 is the group itself."""
    least = costs.move.min(axis=(2, 3))
    least = np.minimum(least, least.T)
    np.fill_diagonal(least, -1.0)
    return np.argsort(np.argsort(least, axis=1, kind="stable"), axis=1, kind="stable")
