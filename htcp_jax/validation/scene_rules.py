"""Data to validate, and the scene's rules again in plain numpy, by which targets are recomputed.

scenario.py and the pose rule of workpiece.py are among the code under validation.
"""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.jobs.config import PlanConfig, WorkpieceConfig
from htcp_jax.model.workpiece import Workpiece
from htcp_jax.runs.parameters import Parameters


class Track(NamedTuple):
    """Saved results of one method for one scenario with T targets; NaN where a target is not tracked."""

    method: str
    scenario: int
    config: PlanConfig  # the scenario's own
    start: Float[np.ndarray, "N"]  # start of the plan
    tracked: Bool[np.ndarray, "T"]
    blocked: Bool[np.ndarray, "T"]  # joint path from the previous row, as saved
    proven: Bool[np.ndarray, "T"]  # True if the segment from the previous row is saved as a proven motion
    knots: tuple[Float[np.ndarray, "k N"], ...]  # T times: via points of that segment
    x: Float[np.ndarray, "T N"]
    tcp: Float[np.ndarray, "T 3"]
    target: Float[np.ndarray, "T 3"]
    clearance: Float[np.ndarray, "T"]


class Results(NamedTuple):
    """Everything to validate."""

    folder: Path
    workpiece: Callable[[PlanConfig], Workpiece]  # of a track's configuration
    count: int  # of the tracks
    tracks: Iterable[Track]
    files: dict[str, str]  # SHA-256 of the files that hold the results


def turned_and_moved(part: WorkpieceConfig, pose: Parameters) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and translation (3,) from the workpiece frame to the world [m]: the neutral pose is rotated about
    the pivot, first about world x, then y, then z, and then shifted."""
    angles = pose.rotation_x_rad, pose.rotation_y_rad, pose.rotation_z_rad
    (cx, sx), (cy, sy), (cz, sz) = ((np.cos(angle), np.sin(angle)) for angle in angles)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    rotate, pivot = about_z @ about_y @ about_x, np.array(part.pivot_m)
    return rotate, pivot + rotate @ (np.array(part.neutral_translation_m) - pivot) + pose.shift_m


def targets_of(
    job: PlanConfig, tcp: np.ndarray, inlet: np.ndarray | None, path: np.ndarray
) -> Float[np.ndarray, "T 3"]:
    """Targets, world [m]: the start's TCP, steps to the inlet, steps from there to the path, the path. If the start is
    chosen at the path's first point: that point, then the path."""
    if job.start is None:
        return np.concatenate([path[:1], path])
    to_inlet, to_path = job.workpiece.approach_to_inlet, job.workpiece.approach_to_path
    if inlet is None:
        legs = [(tcp, path[0], to_inlet + to_path)]
    else:
        legs = [(tcp, inlet, to_inlet), (inlet, path[0], to_path)]
    steps = [a + (b - a) * (k / count) for a, b, count in legs for k in range(1, count + 1)]
    return np.array([tcp, *steps, *path])
