"""Data to validate, and the scene's rules again in plain numpy, by which targets are recomputed.

scenario.py, path_frames.py and the pose rule of workpiece.py are among the code under validation.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from htcp_jax.jobs import PlanConfig
from htcp_jax.jobs import config as configs
from htcp_jax.runs import parameters

NEAREST, SURROUNDINGS = 60, 500  # points of the wall to which a normal is fitted, and for its side
DISTINCT_M = 1e-9  # points of a path closer than this coincide


class Track(NamedTuple):
    """Saved results of one method for one scenario with T targets; NaN where a target is not tracked."""

    method: str
    scenario: int
    config: PlanConfig  # the scenario's own
    start: Float[np.ndarray, "N"]  # start of the plan
    tracked: Bool[np.ndarray, "T"]
    blocked: Bool[np.ndarray, "T"]  # joint path from the previous row, as saved
    proven: Bool[np.ndarray, "T"]  # True if the segment from the previous row is saved as a proven motion
    via_points: tuple[Float[np.ndarray, "k N"], ...]  # T times: via points of that segment
    via_shares: tuple[Float[np.ndarray, "k"], ...]  # and their shares of the way from the target before
    x: Float[np.ndarray, "T N"]
    tcp: Float[np.ndarray, "T 3"]
    target: Float[np.ndarray, "T 3"]
    clearance: Float[np.ndarray, "T"]


@dataclass(frozen=True, eq=False)
class WorkpieceData:
    """A workpiece as loaded, in its own frame [m]; directions that the path's file lacks are computed here."""

    cloud: Float[np.ndarray, "P 3"]  # on a mesh: the planner's points, which only normals are fitted to
    path: Float[np.ndarray, "T 3"]
    inlet: Float[np.ndarray, "3"] | None
    is_mesh: bool
    cover_m: float  # covering radius of the planner's points on a mesh; 0 for a cloud
    given_normals: Float[np.ndarray, "T 3"] | None
    given_tangents: Float[np.ndarray, "T 3"] | None
    rotations: Float[np.ndarray, "T 3 3"] | None

    @cached_property
    def normals(self) -> Float[np.ndarray, "T 3"]:
        """Unit normals of the path."""
        return path_normals(self.cloud, self.path) if self.given_normals is None else self.given_normals

    @cached_property
    def tangents(self) -> Float[np.ndarray, "T 3"]:
        """Unit tangents of the path."""
        return tangents_of(self.path) if self.given_tangents is None else self.given_tangents


class Results(NamedTuple):
    """Everything to validate."""

    folder: Path
    workpiece: Callable[[PlanConfig], WorkpieceData]  # of a track's configuration
    count: int  # of the tracks
    tracks: Iterable[Track]
    files: dict[str, str]  # SHA-256 of the files that hold the results


def part_pose(part: configs.WorkpieceConfig, pose: parameters.Parameters) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and translation (3,) from the workpiece frame to the world [m].

    The neutral pose is rotated about the pivot, first about world x, then y, then z, and then shifted.
    """
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
    """Targets of a job, world [m].

    They are the start's TCP, steps to the inlet, steps from there to the path, and the path. If the start is chosen at
    the path's first point, they are that point, then the path.

    Args:
        job: The job.
        tcp: The TCP at the start (3,), world [m].
        inlet: The inlet (3,), world [m]; None without one.
        path: The path (T, 3), world [m].
    """
    if job.start is None:
        return np.concatenate([path[:1], path])
    to_inlet, to_path = job.workpiece.approach_to_inlet, job.workpiece.approach_to_path
    if inlet is None:
        legs = [(tcp, path[0], to_inlet + to_path)]
    else:
        legs = [(tcp, inlet, to_inlet), (inlet, path[0], to_path)]
    steps = [a + (b - a) * (k / count) for a, b, count in legs for k in range(1, count + 1)]
    return np.array([tcp, *steps, *path])


def path_normals(cloud: Float[np.ndarray, "P 3"], path: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3"]:
    """Unit normals of the planes fitted to the points near a path.

    They point to the side on which most of the cloud lies, by weights that decrease over a quarter of its extent.
    """
    near = cloud[cKDTree(cloud).query(path, k=min(NEAREST, len(cloud)))[1]]
    normals = np.linalg.svd(near - near.mean(axis=1, keepdims=True), full_matrices=False)[2][:, 2]
    some = cloud[:: max(1, len(cloud) // SURROUNDINGS)]
    width = max(float(np.ptp(cloud, axis=0).max()) / 4, DISTINCT_M)
    weight = np.exp(-((cdist(path, some) / width) ** 2) / 2)
    inwards = weight @ some / weight.sum(axis=1, keepdims=True) - path
    return np.where((inwards * normals).sum(axis=1) < 0, -1.0, 1.0)[:, None] * normals


def tangents_of(path: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3"]:
    """Unit tangents of a path: from the distinct point before to the one after, or ahead where the path reverses."""
    new = np.append(True, np.linalg.norm(np.diff(path, axis=0), axis=1) > DISTINCT_M)
    padded = np.pad(path[new], ((1, 1), (0, 0)), "edge")
    along, ahead = padded[2:] - padded[:-2], padded[2:] - padded[1:-1]
    along = np.where(np.linalg.norm(along, axis=1)[:, None] > DISTINCT_M, along, ahead)
    return (along / np.linalg.norm(along, axis=1)[:, None])[np.cumsum(new) - 1]
