"""Via points of segments: they stay with their scenario and target, in their order."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from htcp_jax.motion import Plans, ViaPoints, plans
from htcp_jax.motion.motion_check import segments_of

SCENARIOS, TARGETS, JOINTS = 4, 5, 2


@st.composite
def some_segments(draw, scenarios=SCENARIOS):
    """Strategy for via points: (scenario, target) -> distinct configurations, in any order."""
    keys = st.tuples(st.integers(0, scenarios - 1), st.integers(0, TARGETS - 1))
    counts = draw(st.dictionaries(keys, st.integers(1, 3), max_size=6))
    first = draw(st.integers(0, 1000))
    segments = {}
    for key, count in counts.items():
        segments[key] = np.arange(first, first + count * JOINTS, dtype=float).reshape(count, JOINTS)
        first += count * JOINTS
    return segments


def via_points_of(segments):
    return ViaPoints.of([(*key, x) for key, x in segments.items()], JOINTS)


def segments_in(via_points, scenarios=SCENARIOS):
    """Via points by (scenario, target): the inverse of `via_points_of`."""
    found = {(s, t): via_points.on_segment(s, t) for s in range(scenarios) for t in range(TARGETS)}
    return {key: x for key, x in found.items() if len(x)}


def same(found, expected):
    assert found.keys() == expected.keys()
    for key, x in expected.items():
        np.testing.assert_array_equal(found[key], x)


def in_order(via_points):
    """True if via points are sorted by scenario and target."""
    keys = list(zip(via_points.scenario.tolist(), via_points.target.tolist(), strict=True))
    return keys == sorted(keys)


def plans_along(via_points, scenarios=SCENARIOS, targets=TARGETS):
    """Plans with only via points and starts, which are distinct for each scenario."""
    starts = np.arange(scenarios * JOINTS, dtype=float).reshape(scenarios, JOINTS)
    return Plans.empty(starts, np.zeros((scenarios, targets, 3)))._replace(via_points=via_points)


@given(some_segments())
def test_every_segment_has_the_configurations_that_it_was_given(segments):
    via_points = via_points_of(segments)
    same(segments_in(via_points), segments)
    assert in_order(via_points) and len(via_points.x) == len(via_points.scenario) == len(via_points.target) == sum(
        map(len, segments.values())
    )


def test_without_segments_there_are_none():
    for via_points in (ViaPoints.none(3), ViaPoints.of([], 3), ViaPoints.of([(1, 2, np.zeros((0, 3)))], 3)):
        assert via_points.x.shape == (0, 3) and via_points.scenario.shape == via_points.target.shape == (0,)
        assert via_points.on_segment(1, 2).shape == (0, 3)
        assert via_points.rows(np.array([1, 0])).x.shape == (0, 3)


@given(some_segments(), st.permutations(range(SCENARIOS)), st.integers(1, SCENARIOS))
def test_rows_are_numbered_as_they_are_asked_for(segments, order, count):
    which = order[:count]
    picked = via_points_of(segments).rows(np.array(which))
    same(segments_in(picked), {(which.index(s), t): x for (s, t), x in segments.items() if s in which})
    assert in_order(picked)


@given(some_segments(2), some_segments(1), some_segments(3))
def test_parts_put_one_after_the_other_keep_their_segments(first_part, second_part, third_part):
    parts, sizes, joined = (first_part, second_part, third_part), (2, 1, 3), {}
    for first, part in zip((0, 2, 3), parts, strict=True):
        joined |= {(s + first, t): x for (s, t), x in part.items()}
    whole = plans.consecutive([via_points_of(part) for part in parts], sizes)
    same(segments_in(whole, 6), joined)
    assert in_order(whole)
    for first, size, part in zip((0, 2, 3), sizes, parts, strict=True):
        same(segments_in(whole.rows(np.arange(first, first + size)), size), part)


@given(some_segments(), st.permutations(range(SCENARIOS)))
def test_plans_taken_apart_and_put_together_again_keep_their_via_points(segments, order):
    plans = plans_along(via_points_of(segments))
    apart = [plans.rows([s]) for s in order]
    for s, part in zip(order, apart, strict=True):
        same(segments_in(part.via_points, 1), {(0, t): x for (own, t), x in segments.items() if own == s})
    whole = Plans.concatenate(apart).rows(np.argsort(order))
    np.testing.assert_array_equal(whole.start, plans.start)
    same(segments_in(whole.via_points), segments)


@given(some_segments(), st.lists(st.booleans(), min_size=SCENARIOS, max_size=SCENARIOS))
def test_rows_of_plans_are_asked_for_by_numbers_by_a_slice_or_by_a_mask(segments, mask):
    plans, rows = plans_along(via_points_of(segments)), np.flatnonzero(mask)
    expected = {(rows.tolist().index(s), t): x for (s, t), x in segments.items() if s in rows}
    for which in (np.array(mask), rows):
        same(segments_in(plans.rows(which).via_points), expected)
    same(
        segments_in(plans.rows(slice(None, None, -1)).via_points),
        {(SCENARIOS - 1 - s, t): x for (s, t), x in segments.items()},
    )


@given(some_segments(2), some_segments(1))
def test_plans_of_different_lengths_keep_their_via_points_when_they_are_put_together(long, short):
    short = {(s, t): x for (s, t), x in short.items() if t < 2}
    whole = Plans.concatenate([plans_along(via_points_of(short), 1, 2), plans_along(via_points_of(long), 2)])
    same(segments_in(whole.via_points, 3), short | {(s + 1, t): x for (s, t), x in long.items()})
    assert len(whole.without_configurations().via_points.x) == 0


@given(some_segments(), st.lists(st.booleans(), min_size=SCENARIOS * TARGETS, max_size=SCENARIOS * TARGETS))
def test_segments_are_taken_apart_from_configuration_to_configuration(segments, wanted):
    """Compare the joint paths to requested rows, in order; those to via points count as reconfigurations."""
    plans, rows = plans_along(via_points_of(segments)), np.reshape(wanted, (SCENARIOS, TARGETS))
    plans.x[:] = -1.0 - np.arange(plans.x.size).reshape(plans.x.shape)
    expected = []
    for s, t in np.argwhere(rows).tolist():
        segment_status = [plans.before(s, t), *segments.get((s, t), []), plans.x[s, t]]
        expected += [(s, t, *a, *b, k < len(segment_status) - 2) for k, (a, b) in enumerate(pairwise(segment_status))]
    found = segments_of(plans, rows)
    columns = [found.scenario[:, None], found.target[:, None], found.a, found.b, found.turns[:, None]]
    np.testing.assert_array_equal(np.hstack(columns), np.array(expected).reshape(-1, 3 + 2 * JOINTS))
