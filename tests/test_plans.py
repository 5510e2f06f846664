"""Outcomes of plans: the same as read off the statuses, row by row."""

import numpy as np
import pytest
from hand_made import plans_with
from hypothesis import given
from hypothesis import strategies as st

from htcp_jax.motion import Plans
from htcp_jax.motion.plans import ARRAYS, NO_TARGET, Outcome, is_tracked, outcomes
from htcp_jax.status import SegmentStatus, Status

A, E, LIMIT, NOT = Status.TRACKED, Status.TRACKED_AFTER_RECOVERY, Status.ITERATION_LIMIT, Status.NOT_ATTEMPTED
FAILURES = [status for status in Status if not status.tracked and status is not NOT]
MOST = 6  # targets of a scenario


@st.composite
def scenarios(draw):
    """Statuses as a planner leaves them: tracked ones, then perhaps a failure and the rest; then no targets."""
    targets = draw(st.integers(0, MOST))
    tracked = draw(st.lists(st.sampled_from([A, E]), max_size=targets))
    rest = targets - len(tracked)
    end = [draw(st.sampled_from(FAILURES)), *[NOT] * (rest - 1)] if rest else []
    return [*tracked, *end, *[NO_TARGET] * (MOST - targets)]


@st.composite
def some_plans(draw):
    """Plans of a few scenarios, with joint paths that are clear, blocked or unknown, and segments of all kinds."""
    plans = plans_with(draw(st.lists(scenarios(), min_size=1, max_size=4)))
    size, shape = plans.status.size, plans.status.shape
    known = draw(st.lists(st.sampled_from([-1, 0, 1]), min_size=size, max_size=size))
    segments = draw(
        st.lists(st.sampled_from([SegmentStatus.VALID] * 6 + [*SegmentStatus]), min_size=size, max_size=size)
    )
    path_clear, segment_status = (np.array(codes, np.int8).reshape(shape) for codes in (known, segments))
    return plans._replace(path_clear=path_clear, segment_status=segment_status)


@given(some_plans())
def test_an_outcome_is_what_one_reads_off_a_row(plans):
    rows = zip(plans.status.tolist(), plans.path_clear.tolist(), plans.segment_status.tolist(), strict=True)
    for s, (row, clear, segments) in enumerate(rows):
        known, end = [code for code in row if code != NO_TARGET], plans.outcome(s)
        tracked = [code in (A, E) for code in known]
        blocked = [good and path == 0 for good, path in zip(tracked, clear, strict=False)]
        assert (end.scenario, end.targets, end.tracked) == (s, len(known), sum(tracked))
        assert end.failed == (None if all(tracked) else tracked.index(False))
        assert end.status == (None if all(tracked) else known[tracked.index(False)])
        assert end.blocked_paths == sum(blocked)
        best = SegmentStatus.SAMPLED if SegmentStatus.SAMPLED in segments else SegmentStatus.VALID
        proven = [
            good and segment_status in (SegmentStatus.VALID, SegmentStatus.SAMPLED, SegmentStatus.REDUCED_MARGIN)
            for good, segment_status in zip(tracked, segments, strict=False)
        ]
        assert end.executable == (proven.index(False) if not all(proven) else len(proven))
        assert end.segment_status == (segments[end.executable] if end.executable < sum(tracked) else best)
        assert end.complete == (bool(known) and all(tracked))
        assert end.can_be_driven == (bool(known) and all(proven) and all(tracked))


@given(some_plans())
def test_the_columns_of_outcomes_are_the_rows_one_by_one(plans):
    ends = plans.outcomes
    assert [ends.of(s) for s in range(len(plans.status))] == [plans.outcome(s) for s in range(len(plans.status))]
    assert ends.complete.tolist() == [ends.of(s).complete for s in range(len(plans.status))]
    assert ends.planned.tolist() == (ends.targets > 0).tolist()
    assert (plans.executable.sum(axis=1) == ends.executable).all()
    assert (plans.blocked.sum(axis=1) == ends.blocked_paths).all()


@given(some_plans())
def test_statuses_alone_say_the_same_but_for_the_joint_paths(plans):
    alone, ends = outcomes(plans.status), plans.outcomes
    for name in ("targets", "tracked", "failed", "status"):
        np.testing.assert_array_equal(getattr(alone, name), getattr(ends, name), err_msg=name)
    assert not alone.blocked_paths.any() and not alone.executable.any()


@given(some_plans(), st.integers(0, 3))
def test_wider_and_narrower_again_changes_nothing_that_exists(plans, more):
    wide = plans.widened(MOST + more)
    assert wide.outcomes.of(0) == plans.outcome(0) and not wide.exists[:, MOST:].any()
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(wide.narrowed(), name), getattr(plans.narrowed(), name), err_msg=name)
    for part in (wide.narrowed(), plans):
        assert part.exists.sum() == plans.exists.sum()


@given(some_plans(), st.permutations(range(4)))
def test_parts_put_together_are_the_whole_in_any_order(plans, order):
    rows = [s for s in order if s < len(plans.status)]
    apart = [plans.rows([s]).narrowed() for s in rows]
    whole = Plans.concatenate(apart).rows(np.argsort(rows))
    np.testing.assert_array_equal(whole.status, plans.narrowed().status)
    for name in set(ARRAYS) - {"start"}:
        there, here = getattr(whole, name)[whole.exists], getattr(plans, name)[plans.exists]
        np.testing.assert_array_equal(there, here, err_msg=name)
    np.testing.assert_array_equal(whole.start, plans.start)
    assert whole.run_s == pytest.approx(len(rows) * plans.run_s)  # each part has the seconds of all


def test_empty_plans_attempt_nothing_and_have_the_targets_that_they_are_given():
    start, target = np.arange(6.0).reshape(2, 3), np.ones((2, 4, 3))
    plans = Plans.empty(start, target, np.array([4, 2]))
    assert plans.exists.tolist() == [[True] * 4, [True, True, False, False]]
    assert (plans.status[plans.exists] == NOT).all() and not plans.tracked.any() and not plans.attempted.any()
    assert np.isnan(plans.x).all() and plans.x.shape == (2, 4, 3) and np.isnan(plans.step_s)
    for own, requested in ((plans.target, target), (plans.start, start)):
        assert (own == requested).all() and not np.shares_memory(own, requested)
    assert plans.outcome(1) == Outcome(1, 2, 0, 0, 0, NOT, 0, SegmentStatus.VALID)


def test_a_joint_path_leaves_the_row_before_and_the_first_one_the_start():
    plans = plans_with([[A, A, LIMIT], [LIMIT, NOT, NOT]])
    plans = plans._replace(start=np.array([[1.0, 2.0], [3.0, 4.0]]), x=np.arange(12.0).reshape(2, 3, 2))
    assert plans.before(0, 0).tolist() == [1.0, 2.0] and plans.before(1, 2).tolist() == plans.x[1, 1].tolist()
    many = plans.before(np.array([1, 0]), np.array([0, 1]))
    np.testing.assert_array_equal(many, [plans.start[1], plans.x[0, 0]])


def test_a_plan_without_any_target_has_no_end():
    plans = Plans.empty(np.zeros((2, 3)), np.zeros((2, 0, 3)))
    assert plans.outcomes.planned.tolist() == [False, False] and plans.outcome(1).failed is None


def test_what_is_tracked_is_what_the_status_says():
    codes = np.array([NO_TARGET, *Status], np.int8)
    assert is_tracked(codes).tolist() == [False, *(status.tracked for status in Status)]
