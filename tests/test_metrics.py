"""The summary's numbers, on plans whose numbers are known."""

import numpy as np
import pytest

from htcp_jax.metrics import Failure, summarise
from htcp_jax.plans import Plans
from htcp_jax.status import Status


def plans_with(status: list[list[Status]], run_s: float = 1.0) -> Plans:
    """Plans of a 2-joint arm with these statuses: clearances 1, 2, 3, ... mm and residuals half of that."""
    status = np.array(status, np.int8)
    shape = status.shape
    tracked = status <= Status.TRACKED_AFTER_ESCAPE
    clearance = np.where(tracked, 1e-3 * np.arange(1, 1 + status.size).reshape(shape), np.nan)
    return Plans(
        x=np.where(tracked[..., None], np.zeros((*shape, 2)), np.nan),
        tcp=np.where(tracked[..., None], np.zeros((*shape, 3)), np.nan),
        target=np.zeros((*shape, 3)),
        clearance=clearance,
        residual=clearance / 2,
        status=status,
        iterations=np.ones(shape, int),
        joint_step=np.where(tracked, 0.25, np.nan),
        escape=(status == Status.TRACKED_AFTER_ESCAPE).astype(int),
        path_clear=np.where(tracked, 0, -1).astype(np.int8),
        compile_s=3.0,
        run_s=run_s,
    )


DONE, ESCAPED, STUCK, LEFT = (
    Status.TRACKED,
    Status.TRACKED_AFTER_ESCAPE,
    Status.ESCAPE_EXHAUSTED,
    Status.NOT_ATTEMPTED,
)


def test_counts_times_and_distances():
    summary = summarise(plans_with([[DONE, ESCAPED, DONE], [DONE, STUCK, LEFT]]))
    assert (summary.scenarios, summary.complete) == (2, 1)
    assert (summary.tracked, summary.targets, summary.after_escape, summary.blocked_paths) == (4, 6, 1, 4)
    assert summary.success_rate == pytest.approx(4 / 6)
    assert summary.step_ms == pytest.approx(1000 / 5)  # the target that failed was worked on too
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
    assert [status for status in Status if status.tracked] == [DONE, ESCAPED]
