"""The order of seams: the shortest one of small jobs, a bound that is true, and groups that cannot be visited."""

import itertools
import sys

import numpy as np
import pytest

from htcp_jax.errors import InputError
from htcp_jax.sequencing import shortest_order
from htcp_jax.sequencing.tour_states import closed_gap

pytest.importorskip("ortools", reason="the extra `order` is not installed")


def job(seed: int, groups: int, missing: float = 0.0, pairs: float = 0.2):
    """Return random arguments of `shortest_order`: groups of 1 to 3 nodes, and the share of moves that is missing."""
    rng = np.random.default_rng(seed)
    group = np.repeat(np.arange(groups), rng.integers(1, 4, groups))
    move = rng.uniform(0.0, 1.0, (len(group), len(group)))
    move[rng.random(move.shape) < missing] = np.inf
    own, begin, end = rng.uniform(0.0, 1.0, (3, len(group)))
    before = [pair for pair in itertools.combinations(range(groups), 2) if rng.random() < pairs]
    return group, own, move, begin, end, before


def closure(before, groups: int) -> np.ndarray:
    """Return (groups, groups): the first is before the second, directly or through others."""
    made = np.zeros((groups, groups), bool)
    made[tuple(np.array(before, int).reshape(-1, 2).T)] = True
    for _ in range(groups):
        made |= (made.astype(int) @ made.astype(int)) > 0
    return made


def shortest_by_trial(group, own, move, begin, end, before) -> tuple[int, float]:
    """Return how many groups can be visited, and the least cost of visiting as many [s], by all permutations."""
    names = range(int(group.max()) + 1)
    nodes = [np.flatnonzero(group == k) for k in names]
    before = np.argwhere(closure(before, len(names))).tolist()  # also through groups that are skipped
    for count in reversed(names):
        costs = []
        for line in itertools.permutations(names, count + 1):
            if any(a in line and b in line and line.index(a) > line.index(b) for a, b in before):
                continue
            cost = begin[nodes[line[0]]] + own[nodes[line[0]]]
            for a, b in itertools.pairwise(line):
                cost = (cost[:, None] + move[np.ix_(nodes[a], nodes[b])]).min(axis=0) + own[nodes[b]]
            costs.append((cost + end[nodes[line[-1]]]).min())
        if np.isfinite(min(costs, default=np.inf)):
            return count + 1, min(costs)
    return 0, 0.0


def cost_of(found, group, own, move, begin, end, before) -> float:
    """Return the cost of an order [s], and fail if a group is visited twice or too early."""
    line = [int(group[node]) for node in found.nodes]
    assert len(set(line)) == len(line)
    assert all(line.index(a) < line.index(b) for a, b in before if a in line and b in line)
    moves = move[found.nodes[:-1], found.nodes[1:]].sum() + begin[found.nodes[0]] + end[found.nodes[-1]]
    return float(moves + own[found.nodes].sum())


@pytest.mark.parametrize("seed", range(12))
def test_an_order_is_the_shortest_of_all_permutations_with_precedence(seed):
    case = job(seed, groups=2 + seed % 5)
    found = shortest_order(*case, seed=seed, effort=0.1)
    count, least = shortest_by_trial(*case)
    assert len(found.nodes) == count
    np.testing.assert_allclose([found.cost, cost_of(found, *case)], least, rtol=1e-9)
    assert least * (1 - 1e-6) <= found.bound <= found.cost


@pytest.mark.parametrize("seed", range(12))
def test_as_few_groups_as_possible_are_skipped_where_moves_are_missing(seed):
    case = job(seed, groups=2 + seed % 4, missing=0.75, pairs=0.25)
    found = shortest_order(*case, seed=seed, effort=0.1)
    count, least = shortest_by_trial(*case)
    assert len(found.nodes) == count
    np.testing.assert_allclose([found.cost, cost_of(found, *case)], least, rtol=1e-9)
    assert least * (1 - 1e-6) <= found.bound <= found.cost


def test_a_group_without_possible_moves_is_skipped():
    group, own, move, begin, end, _ = job(1, groups=5)
    move[group == 2], begin[group == 2] = np.inf, np.inf
    move[:, group == 2] = np.inf
    found = shortest_order(group, own, move, begin, end, [(0, 2), (2, 4)], seed=0, effort=0.1)
    assert sorted(group[found.nodes]) == [0, 1, 3, 4]
    nothing = shortest_order(group, own, move, np.full_like(begin, np.inf), end, [], seed=0, effort=0.1)
    assert nothing == ([], 0.0, 0.0)


def test_an_order_repeats_for_the_same_seed():
    case = job(7, groups=14)
    assert len({str(shortest_order(*case, seed=3, effort=0.3)) for _ in range(2)}) == 1


@pytest.mark.parametrize("seed", range(3))
def test_no_other_seed_finds_an_order_below_the_bound(seed):
    case = job(seed, groups=16, pairs=0.05)
    some, other = (shortest_order(*case, seed=each, effort=0.3) for each in (0, 1))
    assert max(some.bound, other.bound) <= min(some.cost, other.cost)
    assert some.bound >= 0.8 * some.cost


def test_an_order_is_never_longer_than_its_hint():
    case = job(5, groups=10)
    first = shortest_order(*case, seed=0, effort=0.3)
    assert shortest_order(*case, seed=1, effort=0.01, hint=first.nodes).cost <= first.cost


def test_a_cycle_of_precedence_is_named():
    with pytest.raises(InputError, match=r"^the groups 0, 1 are before each other: an order without cycles is needed$"):
        shortest_order(*job(0, groups=3)[:5], [(0, 1), (1, 0)], seed=0, effort=0.1)


def test_costs_that_are_not_numbers_are_refused():
    group, own, *rest = job(0, groups=3)
    own[0] = np.nan
    with pytest.raises(InputError, match=r"^costs of an order are negative or NaN: at least 0 s, or inf, is needed$"):
        shortest_order(group, own, *rest, seed=0, effort=0.1)


def test_a_missing_solver_is_named_with_a_command_that_installs_it_without_an_index_of_this_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "ortools.sat.python", None)
    with pytest.raises(
        InputError, match=r"^an order of seams needs OR-Tools: \S+ -m pip install '?ortools[<>=,.\d]*'?$"
    ):
        shortest_order(*job(0, groups=3), seed=0, effort=0.1)


@pytest.mark.parametrize("seed", range(3))
def test_the_search_for_long_tours_finds_the_shortest_order_of_few_groups(seed, monkeypatch):
    monkeypatch.setattr("htcp_jax.sequencing.order.FEW", 0)
    case = job(seed, groups=6)
    found = shortest_order(*case, seed=seed, effort=0.1)
    _, least = shortest_by_trial(*case)
    np.testing.assert_allclose([found.cost, cost_of(found, *case)], least, rtol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_the_bound_of_a_long_tour_is_below_the_shortest_order_and_keeps_the_tour(seed, monkeypatch):
    monkeypatch.setattr("htcp_jax.sequencing.order.FEW", 0)
    monkeypatch.setattr("htcp_jax.sequencing.tour_bound.MOST_SINKS", 0)
    case = job(seed, groups=6)
    tour = shortest_order(*case, seed=seed, effort=0.01, only="tour")
    found = shortest_order(*case, seed=seed, effort=1.0, hint=tour.nodes, only="bound")
    _, least = shortest_by_trial(*case)
    assert (tour.bound, found.nodes) == (0.0, tour.nodes)
    assert 0.5 * least < found.bound <= least * (1 + 1e-9)


@pytest.mark.parametrize("most", [0, 1, 3, 1000])
@pytest.mark.parametrize("seed", range(4))
def test_a_gap_that_is_closed_in_part_contains_no_shorter_tour(seed, most):
    group, own, move, begin, end, before = job(seed, groups=6)
    home = len(group)
    cost = np.full((home + 1, home + 1), np.inf)
    cost[:home, :home], cost[home, :home], cost[:home, home] = move + own, begin + own, end
    cost[:home, :home][group[:, None] == group] = np.inf
    _, least = shortest_by_trial(group, own, move, begin, end, before)
    tour, closed = closed_gap(group, cost, cost, closure(before, 6), least + 0.1, most)
    assert closed <= least + 0.1 and (not tour or least <= cost[[home, *tour], [*tour, home]].sum() + 1e-9)
    found = cost[[home, *tour], [*tour, home]].sum() if tour else np.inf
    assert min(found, closed) <= least + 1e-9
    if most == 1000:
        np.testing.assert_allclose(found, least)


def test_an_order_of_fourteen_seams_is_proven_to_be_the_shortest():
    found = shortest_order(*job(2, groups=14, pairs=0.0), seed=0, effort=2.0)
    assert found.bound >= found.cost * (1 - 1e-9)
