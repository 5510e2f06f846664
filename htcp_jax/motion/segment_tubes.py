"""Regions in which the TCP must stay on segments, and the clearance that is required there."""

import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.clearance.proof import margin, motion_proof
from htcp_jax.model import ONE_POINT_M, TCP_POSITION, Scenario, Task


def tubes(
    scenarios: Scenario,
    task: Task,
    radius_m: float,
    scenario: np.ndarray,
    target: np.ndarray,
    turns: np.ndarray,
    off_path: np.ndarray,
) -> motion_proof.Tube:
    """Return the tubes in which the TCP must stay on some segments, see `Problem.tubes`.

    Args:
        scenarios: Stacked scenarios.
        task: The task.
        radius_m: Largest distance from the line [m].
        scenario: Row of each segment's scenario (n,).
        target: Target at each segment's end (n,).
        turns: True if the arm changes its configuration on the segment while the TCP stays (n,).
        off_path: True for segments before the path and between seams (n,).
    """
    rows, before, last = (None, None), np.maximum(target - 1, 0), scenarios.goals.shape[1] - 1
    if task.parts != TCP_POSITION.parts:  # the paper's task is enforced by the tube alone
        ends = before, np.where(turns, before, target)
        rows = np.stack([scenarios.goals[scenario, row] for row in ends], axis=1), ~off_path
    required = margin.constant(segment_margins(scenarios, scenario, target, off_path))
    free = off_path | (not task.holds_tcp)
    if free.all():
        anywhere = np.zeros((len(target), 3))
        return motion_proof.Tube(anywhere, anywhere, np.full(len(target), np.inf), *rows, required)
    # The last target ends the path.
    a, b = (task.tcp_place(scenarios.goals[scenario, row]) for row in (before, np.minimum(target, last)))
    a = np.where((np.linalg.norm(b - a, axis=1) < ONE_POINT_M)[:, None], b, a)
    return motion_proof.Tube(a, np.where(turns[:, None], a, b), np.where(free, np.inf, radius_m), *rows, required)


def segment_margins(
    scenarios: Scenario, scenario: np.ndarray, target: np.ndarray, off_path: Bool[np.ndarray, "n"] | bool = False
) -> Float[np.ndarray, "n"]:
    """Return the required clearance on segments [m]; -inf where only D > 0 is required, as before the path.

    Args:
        scenarios: Stacked scenarios.
        scenario: Row of each segment's scenario (n,).
        target: Target at each segment's end (n,).
        off_path: True for segments before the path and between seams; False: for segments of one seam.
    """
    least = scenarios.margins_to(scenario, target)[1]
    return np.where((target > scenarios.on_path[scenario]) & (least > 0) & ~np.asarray(off_path), least, -np.inf)
