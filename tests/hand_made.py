"""Hand-made plans, for tests of the steps after planning."""

import numpy as np

from htcp_jax.motion import Plans, ViaPoints
from htcp_jax.motion.plans import is_tracked
from htcp_jax.status import SegmentStatus, Status


def plans_with(status: list[list[Status]], joints: int = 2, run_s: float = 1.0) -> Plans:
    """Plans of an arm at rest with these statuses: clearances 1, 2, 3, ... mm and residuals half of that."""
    status = np.array(status, np.int8)
    shape = status.shape
    tracked = is_tracked(status)
    clearance = np.where(tracked, 1e-3 * np.arange(1, 1 + status.size).reshape(shape), np.nan)
    return Plans(
        start=np.zeros((shape[0], joints)),
        x=np.where(tracked[..., None], np.zeros((*shape, joints)), np.nan),
        tcp=np.where(tracked[..., None], np.zeros((*shape, 3)), np.nan),
        target=np.zeros((*shape, 3)),
        clearance=clearance,
        residual=clearance / 2,
        orientation_error=np.full(shape, np.nan),
        status=status,
        iterations=np.ones(shape, int),
        joint_step=np.where(tracked, 0.25, np.nan),
        recovery=(status == Status.TRACKED_AFTER_RECOVERY).astype(int),
        path_clear=np.where(tracked, 0, -1).astype(np.int8),
        segment_status=np.where(tracked, SegmentStatus.IN_COLLISION, SegmentStatus.NOT_CHECKED).astype(np.int8),
        segment_clearance=np.full(shape, np.nan),
        via_points=ViaPoints.none(joints),
        compile_s=3.0,
        run_s=run_s,
    )
