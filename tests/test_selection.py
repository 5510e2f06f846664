"""Beam of the beam search: the best, mutually distant configurations per target, and exact path costs."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from htcp_jax.motion.configurations import BLOCK, dispersed, first_apart
from htcp_jax.motion.step_functions import State
from htcp_jax.planning.beam.tree import LEAST, BeamTree, Nodes, best_first

numbers = st.floats(-1, 1)
configurations = st.lists(st.tuples(numbers, numbers), min_size=1, max_size=20)
EACH = 3  # searches


def array(places) -> np.ndarray:
    return np.array(list(places), float).reshape(-1, 2)


def at(x) -> State:
    x = array(x)
    return State(x, clearance=x[:, 0], residual=x[:, 1], tcp=np.zeros((len(x), 3)))


@st.composite
def of_searches(draw, least=0):
    """Strategy for configurations and the search of each, sorted by search."""
    parts = [draw(st.lists(st.tuples(numbers, numbers), min_size=least, max_size=12)) for _ in range(EACH)]
    return array(x for part in parts for x in part), np.repeat(np.arange(EACH), [len(part) for part in parts])


def away(x, others):
    return np.linalg.norm(others - x, axis=1).min(initial=np.inf)


@given(st.lists(st.tuples(st.integers(0, 2), st.sampled_from([0.0, 0.5, 2.0]), st.integers(0, EACH - 1)), min_size=1))
def test_the_best_has_the_fewest_dwells_and_then_the_least_cost(ranks):
    dwells, cost, search = (np.array(column) for column in zip(*ranks, strict=True))
    zero = np.zeros_like(dwells)
    order = best_first(Nodes(at([(0, 0)] * len(zero)), zero, zero, zero > 0, zero, dwells, cost), search)
    assert sorted(order) == list(range(len(ranks)))
    ranked = [(search[k], dwells[k], cost[k], k) for k in order]
    assert ranked == sorted(ranked)  # ties are broken by the order of discovery


@given(of_searches(), st.floats(0.01, 1.0), of_searches())
def test_of_close_configurations_the_first_is_kept_and_all_that_are_kept_are_apart(given_, apart, known):
    """Compare with a plain loop, with a beam wide enough for all."""
    x, search = given_
    kept = dispersed(x, search, len(x), apart, known)
    expected = []
    for number in range(EACH):
        near = list(known[0][known[1] == number])
        for k in np.flatnonzero(search == number):
            if away(x[k], array(near)) >= apart:
                near.append(x[k])
                expected.append(k)
    assert kept.tolist() == expected


@given(of_searches(least=1), st.floats(0.01, 0.5), st.integers(1, 6))
def test_where_there_are_too_many_those_far_from_each_other_are_kept(given_, apart, most):
    """Check farthest-point selection, which always keeps the best.

    No excluded configuration is further from the kept ones than these are from each other.
    """
    x, search = given_
    every, kept = dispersed(x, search, len(x), apart), dispersed(x, search, most, apart)
    assert [k for k in every if k in kept] == kept.tolist()
    for number in range(EACH):
        own, all_ = kept[search[kept] == number], every[search[every] == number]
        assert len(own) == min(most, len(all_)) and own[0] == np.flatnonzero(search == number)[0]
        closest = min((away(x[k], x[own[own != k]]) for k in own), default=np.inf)
        assert all(k in own or away(x[k], x[own]) <= closest for k in all_)


def test_nothing_is_kept_of_what_is_known_already():
    x, one = array([(0, 0), (1, 0)]), np.zeros(2, int)
    none = x[:0], one[:0]
    assert dispersed(x, one, 5, 0.1, (x, one)).size == 0 == dispersed(*none, 5, 0.1).size
    assert dispersed(x, one, 5, 0.1, (x[:1], one[:1])).tolist() == [1]
    assert dispersed(x, one, 5, 0.1, (x, one + 1)).tolist() == [0, 1]  # known to another search only
    assert dispersed(x, one, 1, 0.1, (array([(0.5, 0)]), one[:1])).tolist() == [0]


legs = st.lists(st.tuples(st.booleans(), configurations), min_size=1, max_size=6)


@given(st.tuples(numbers, numbers), legs)
def test_a_path_costs_the_squares_of_its_steps_and_has_the_dwells_of_its_parts(start, legs):
    """Compare costs with plain sums: a self-motion counts all its configurations, a process segment only its end."""
    tree, passed, dwells = BeamTree(2), [start], 0
    here = tree.plant(at([start]), -1)
    for by_self_motion, leg in legs:
        leg = leg if by_self_motion else leg[-1:]
        for k, x in enumerate(leg):
            here = tree.grow(here, at([x]), 0, by_self_motion=by_self_motion, dwells=int(by_self_motion and k == 0))
        passed += leg
        dwells += by_self_motion
        steps, now = np.diff(np.array(passed), axis=0), tree.nodes(here)
        np.testing.assert_allclose(now.cost, (steps**2).sum(), rtol=1e-12, atol=1e-300)
        assert now.dwells == dwells
    path = tree.path(int(here[0]))
    np.testing.assert_array_equal(tree.x[path], passed)
    assert all(tree.nodes(path).parent[k] == before for k, (before, _) in enumerate(pairwise(path), start=1))


@pytest.mark.parametrize("seed", range(3))
def test_a_pruned_tree_has_every_path_required_and_no_other_configuration(seed):
    rng = np.random.default_rng(seed)
    tree = BeamTree(2)
    rows = tree.plant(at(rng.standard_normal((5, 2))), -1)
    while not tree.is_overgrown:
        parent = rng.choice(rows, 400)
        rows = tree.grow(parent, at(rng.standard_normal((400, 2))), tree.target[parent] + 1, step_qps=2)
    assert len(tree) > 2 * LEAST
    kept = rng.choice(rows, 20)
    before = [tree.nodes(tree.path(int(row))) for row in kept]
    alive = {int(row) for leaf in kept for row in tree.path(int(leaf))}
    moved = tree.prune(kept)
    assert len(tree) == len(alive) and not tree.is_overgrown
    for nodes, row in zip(before, moved[kept], strict=True):
        now = tree.nodes(tree.path(int(row)))
        for one, other in zip(nodes.at, now.at, strict=True):
            np.testing.assert_array_equal(one, other)
        for name in ("target", "by_self_motion", "step_qps", "dwells", "cost"):
            np.testing.assert_array_equal(getattr(nodes, name), getattr(now, name))
    grown = tree.grow(moved[kept], at(np.zeros((20, 2))), 0)
    assert grown.tolist() == list(range(len(alive), len(alive) + 20))


@pytest.mark.parametrize("norm", [2, np.inf])
def test_the_first_rows_apart_are_those_of_a_plain_loop_in_each_group(norm):
    """Groups have more rows than are compared at a time, fewer, and none."""
    rng = np.random.default_rng(0)
    length, most, apart = [3 * BLOCK, 0, 5, BLOCK + 1], 12, 0.3
    group = np.repeat(np.arange(len(length)), length)
    x = rng.uniform(-0.8, 0.8, (len(group), 2)) * np.where(group == 0, 0.3, 1.0)[:, None]
    expected = []
    for number in range(len(length)):
        near = []
        for k in np.flatnonzero(group == number):
            if len(near) < most and all(np.linalg.norm(x[k] - x[other], norm) >= apart for other in near):
                near.append(int(k))
        expected += near
    assert first_apart(x, group, most, apart, norm).tolist() == expected
