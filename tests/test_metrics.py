"""The metrics of a summary are those calculated by hand on plans with known values."""

import numpy as np
import pytest
from hand_made import plans_with

from htcp_jax.runs.summary import Failure, summarise
from htcp_jax.status import Status

DONE, RECOVERED, STUCK, LEFT = (Status(k) for k in (0, 1, 4, 7))


def test_counts_times_and_distances():
    summary = summarise(plans_with([[DONE, RECOVERED, DONE], [DONE, STUCK, LEFT]]))
    assert (summary.scenarios, summary.complete) == (2, 1)
    assert (summary.tracked, summary.targets, summary.after_recovery, summary.blocked_paths) == (4, 6, 1, 4)
    assert summary.success_rate == pytest.approx(4 / 6)
    assert summary.step_ms == pytest.approx(1000 / 5)  # the failed target took a step, too
    assert (summary.compile_s, summary.run_s) == (3, 1)
    assert summary.clearance_min_mm == pytest.approx(1)
    assert summary.clearance_mean_mm == pytest.approx((1 + 2 + 3 + 4) / 4)
    assert summary.tcp_distance_mean_mm == pytest.approx((1 + 2 + 3 + 4) / 8)
    assert summary.tcp_distance_max_mm == pytest.approx(2)
    assert summary.joint_motion_rad == pytest.approx(1)
    assert summary.failures == (Failure(1, 1, STUCK),)


def test_nothing_tracked_gives_nan_and_no_warning():
    summary = summarise(plans_with([[STUCK, LEFT]]))
    assert summary.tracked == 0 and summary.failures == (Failure(0, 0, STUCK),)
    assert np.isnan([summary.clearance_min_mm, summary.tcp_distance_mean_mm]).all()


def test_every_status_has_a_sentence():
    assert all(status.message and "\n" not in status.message for status in Status)
    assert [status for status in Status if status.tracked] == [DONE, RECOVERED]
