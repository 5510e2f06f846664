"""Via points of segments: they stay with their scenario and target, in their order."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from htcp_jax.motion import Knots, Plans
from htcp_jax.motion.motion_check import segments_of

SCENARIOS, TARGETS, JOINTS = 4, 5, 2


@st.composite
def some_ways(draw, scenarios=SCENARIOS):
    """Strategy for via points: (scenario, target) -> distinct configurations, in any order."""
    keys = st.tuples(st.integers(0, scenarios - 1), st.integers(0, TARGETS - 1))
    counts = draw(st.dictionaries(keys, st.integers(1, 3), max_size=6))
    first = draw(st.integers(0, 1000))
    ways = {}
    for key, count in counts.items():
        ways[key] = np.arange(first, first + count * JOINTS, dtype=float).reshape(count, JOINTS)
        first += count * JOINTS
    return ways


def knots_of(ways):
    return Knots.of([(*key, x) for key, x in ways.items()], JOINTS)


def ways_in(knots, scenarios=SCENARIOS):
    """Via points by (scenario, target): the inverse of `knots_of`."""
    found = {(s, t): knots.on_the_way(s, t) for s in range(scenarios) for t in range(TARGETS)}
    return {key: x for key, x in found.items() if len(x)}


def same(found, expected):
    assert found.keys() == expected.keys()
    for key, x in expected.items():
        np.testing.assert_array_equal(found[key], x)


def in_order(knots):
    """True if via points are sorted by scenario and target."""
    keys = list(zip(knots.scenario.tolist(), knots.target.tolist(), strict=True))
    return keys == sorted(keys)


def plans_along(knots, scenarios=SCENARIOS, targets=TARGETS):
    """Plans with only via points and starts, which are distinct for each scenario."""
    starts = np.arange(scenarios * JOINTS, dtype=float).reshape(scenarios, JOINTS)
    return Plans.empty(starts, np.zeros((scenarios, targets, 3)))._replace(knots=knots)


@given(some_ways())
def test_every_way_has_the_postures_that_it_was_given(ways):
    knots = knots_of(ways)
    same(ways_in(knots), ways)
    assert in_order(knots) and len(knots.x) == len(knots.scenario) == len(knots.target) == sum(map(len, ways.values()))


def test_without_ways_there_are_none():
    for knots in (Knots.none(3), Knots.of([], 3), Knots.of([(1, 2, np.zeros((0, 3)))], 3)):
        assert knots.x.shape == (0, 3) and knots.scenario.shape == knots.target.shape == (0,)
        assert knots.on_the_way(1, 2).shape == (0, 3)
        assert knots.rows(np.array([1, 0])).x.shape == (0, 3)


@given(some_ways(), st.permutations(range(SCENARIOS)), st.integers(1, SCENARIOS))
def test_rows_are_numbered_as_they_are_asked_for(ways, order, count):
    which = order[:count]
    picked = knots_of(ways).rows(np.array(which))
    same(ways_in(picked), {(which.index(s), t): x for (s, t), x in ways.items() if s in which})
    assert in_order(picked)


@given(some_ways(2), some_ways(1), some_ways(3))
def test_parts_put_one_after_the_other_keep_their_ways(first_part, second_part, third_part):
    parts, sizes, joined = (first_part, second_part, third_part), (2, 1, 3), {}
    for first, part in zip((0, 2, 3), parts, strict=True):
        joined |= {(s + first, t): x for (s, t), x in part.items()}
    whole = Knots.concatenate([knots_of(part) for part in parts], sizes)
    same(ways_in(whole, 6), joined)
    assert in_order(whole)
    for first, size, part in zip((0, 2, 3), sizes, parts, strict=True):
        same(ways_in(whole.rows(np.arange(first, first + size)), size), part)


@given(some_ways(), st.permutations(range(SCENARIOS)))
def test_plans_taken_apart_and_put_together_again_keep_their_knots(ways, order):
    plans = plans_along(knots_of(ways))
    apart = [plans.rows([s]) for s in order]
    for s, part in zip(order, apart, strict=True):
        same(ways_in(part.knots, 1), {(0, t): x for (own, t), x in ways.items() if own == s})
    whole = Plans.concatenate(apart).rows(np.argsort(order))
    np.testing.assert_array_equal(whole.start, plans.start)
    same(ways_in(whole.knots), ways)


@given(some_ways(), st.lists(st.booleans(), min_size=SCENARIOS, max_size=SCENARIOS))
def test_rows_of_plans_are_asked_for_by_numbers_by_a_slice_or_by_a_mask(ways, mask):
    plans, rows = plans_along(knots_of(ways)), np.flatnonzero(mask)
    expected = {(rows.tolist().index(s), t): x for (s, t), x in ways.items() if s in rows}
    for which in (np.array(mask), rows):
        same(ways_in(plans.rows(which).knots), expected)
    same(ways_in(plans.rows(slice(None, None, -1)).knots), {(SCENARIOS - 1 - s, t): x for (s, t), x in ways.items()})


@given(some_ways(2), some_ways(1))
def test_plans_of_different_lengths_keep_their_knots_when_they_are_put_together(long, short):
    short = {(s, t): x for (s, t), x in short.items() if t < 2}
    whole = Plans.concatenate([plans_along(knots_of(short), 1, 2), plans_along(knots_of(long), 2)])
    same(ways_in(whole.knots, 3), short | {(s + 1, t): x for (s, t), x in long.items()})
    assert len(whole.without_postures().knots.x) == 0


@given(some_ways(), st.lists(st.booleans(), min_size=SCENARIOS * TARGETS, max_size=SCENARIOS * TARGETS))
def test_ways_are_taken_apart_from_posture_to_posture(ways, wanted):
    """Compare the joint paths to requested rows, in order; those to via points count as reconfigurations."""
    plans, rows = plans_along(knots_of(ways)), np.reshape(wanted, (SCENARIOS, TARGETS))
    plans.x[:] = -1.0 - np.arange(plans.x.size).reshape(plans.x.shape)
    expected = []
    for s, t in np.argwhere(rows).tolist():
        way = [plans.before(s, t), *ways.get((s, t), []), plans.x[s, t]]
        expected += [(s, t, *a, *b, k < len(way) - 2) for k, (a, b) in enumerate(pairwise(way))]
    found = segments_of(plans, rows)
    columns = [found.scenario[:, None], found.target[:, None], found.a, found.b, found.turns[:, None]]
    np.testing.assert_array_equal(np.hstack(columns), np.array(expected).reshape(-1, 3 + 2 * JOINTS))
