"""The front of a roadmap: what is kept at a target is far apart and the best there is, and a way costs what it is."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from htcp_jax.planner.front import Node, best_first, dispersed

PLACE = np.zeros(3)
numbers = st.floats(-1, 1)
postures = st.lists(st.tuples(numbers, numbers), min_size=1, max_size=20)
DWELLS = 3


def node(x, cost=0.0, dwells=0, parent=None, walked=None):
    """At posture x, of this cost; or, with a parent, of what the way from there costs."""
    walked = None if walked is None else np.array(walked, float)
    return Node(np.array(x, float), 1e-3, 0.0, PLACE, 0, parent, walked, dwells=dwells, cost=cost)


@st.composite
def some_nodes(draw):
    """Of different costs and dwells, some of them alike, in any order."""
    found = [node(x, draw(st.sampled_from([0.0, 0.5, 2.0])), draw(st.integers(0, DWELLS))) for x in draw(postures)]
    return draw(st.permutations(found))


def away(one, others):
    return min((float(np.linalg.norm(one.x - other.x)) for other in others), default=np.inf)


def is_better(one, other, among):
    return (one.dwells, one.cost, among.index(one)) < (other.dwells, other.cost, among.index(other))


@given(some_nodes())
def test_the_best_has_the_fewest_dwells_and_then_the_least_cost(nodes):
    ranked = best_first(iter(nodes))
    assert len(ranked) == len(nodes) and {id(one) for one in ranked} == {id(one) for one in nodes}
    for one, other in pairwise(ranked):
        assert is_better(one, other, nodes)  # of equals the one found first


@given(some_nodes(), st.floats(0.01, 1.0), some_nodes())
def test_of_close_postures_the_best_is_kept_and_all_that_are_kept_are_apart(nodes, apart, known):
    """With room for all: whoever is not kept is close to a better one that is, or to one that is known."""
    kept = dispersed(nodes, len(nodes), apart, known)
    for one in kept:
        assert one in nodes and away(one, [other for other in kept if other is not one] + known) >= apart
    for one in nodes:
        better = [other for other in kept if other is one or is_better(other, one, nodes)]
        assert one in kept or away(one, better + known) < apart


@given(some_nodes(), st.floats(0.01, 0.5), st.integers(1, 6))
def test_where_there_are_too_many_those_far_from_each_other_are_kept(nodes, apart, most):
    """Farthest-point selection: none that is left out is further from those kept than these are from each other. The
    best is among them."""
    every, kept = dispersed(nodes, len(nodes), apart), dispersed(nodes, most, apart)
    assert len(kept) == min(most, len(every)) and kept[0] is best_first(nodes)[0]
    assert [one for one in every if one in kept] == kept
    closest = min((away(one, [other for other in kept if other is not one]) for one in kept), default=np.inf)
    for one in every:
        assert one in kept or away(one, kept) <= closest


def test_nothing_is_kept_of_what_is_known_already():
    nodes = [node((0.0, 0.0)), node((1.0, 0.0))]
    assert dispersed(nodes, 5, 0.1, known=nodes) == [] == dispersed([], 5, 0.1)
    assert dispersed(nodes, 5, 0.1, known=nodes[:1]) == nodes[1:]
    assert dispersed(nodes, 1, 0.1, known=[node((0.5, 0.0))]) == nodes[:1]


legs = st.lists(st.tuples(st.booleans(), postures), min_size=1, max_size=6)


@given(st.tuples(numbers, numbers), legs)
def test_a_way_costs_the_squares_of_its_steps_and_has_the_dwells_of_its_parts(start, legs):
    """Of a leg that is walked every posture is a step, of one that is fed its end alone."""
    here, passed, dwells = node(start), [start], 0
    for is_walked, leg in legs:
        here = node(leg[-1], dwells=int(is_walked), parent=here, walked=leg if is_walked else None)
        passed += leg if is_walked else leg[-1:]
        dwells += is_walked
        steps = np.diff(np.array(passed), axis=0)
        np.testing.assert_allclose(here.cost, (steps**2).sum(), rtol=1e-12, atol=1e-300)
        assert here.dwells == dwells
    chain = list(here.ancestors())
    assert len(chain) == len(legs) + 1 and chain[0] is here and chain[-1].parent is None
    assert all(child.parent is parent for child, parent in pairwise(chain))
