"""Data to validate, and an independent implementation of the rules for poses, targets and normals, in numpy.

The planner's implementation (scenario.py, path_frames.py, workpiece.py) is part of the code that is validated.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from htcp_jax.runs import Parameters
from htcp_jax.spec import PlanConfig
from htcp_jax.spec import config as configs

NEAREST, SURROUNDINGS = 60, 500  # numbers of points for fitting a normal, and for choosing its sign
ONE_PLACE_M = 1e-5  # points of a path within this distance of the last place are the same place
SHORTEST_M = 1e-9  # a vector that is shorter than this has no direction


class Track(NamedTuple):
    """Saved results of one method for one scenario with T targets; NaN where a target is not tracked."""

    method: str
    scenario: int
    config: PlanConfig  # job of the scenario
    start: Float[np.ndarray, "N"]  # configuration at which the plan starts
    tracked: Bool[np.ndarray, "T"]
    blocked: Bool[np.ndarray, "T"]  # True if the joint path from the previous target is saved as blocked
    proven: Bool[np.ndarray, "T"]  # True if the segment from the previous target is saved as a proven motion
    claimed: Bool[np.ndarray, "T"]  # True also for segments with via points that are saved as not checked
    via_points: tuple[Float[np.ndarray, "k N"], ...]  # via points of each segment [rad or m]
    via_shares: tuple[Float[np.ndarray, "k"], ...]  # positions of the via points as shares of the segment's length [1]
    x: Float[np.ndarray, "T N"]
    tcp: Float[np.ndarray, "T 3"]
    target: Float[np.ndarray, "T 3"]
    clearance: Float[np.ndarray, "T"]
    segment_clearance: Float[np.ndarray, "T"]  # saved lower bound along the segment from the previous target [m]


@dataclass(frozen=True, eq=False)
class WorkpieceData:
    """A workpiece in its own frame [m]; normals and tangents are computed if the path's file lacks them."""

    cloud: Float[np.ndarray, "P 3"]  # for a mesh, the planner's points, which are used for normals only
    path: Float[np.ndarray, "T 3"]
    inlet: Float[np.ndarray, "3"] | None
    triangles: Float[np.ndarray, "M 3 3"]  # none for a cloud
    cover_m: float  # covering radius of the planner's points on a mesh; 0 for a cloud
    given_normals: Float[np.ndarray, "T 3"] | None
    given_tangents: Float[np.ndarray, "T 3"] | None
    rotations: Float[np.ndarray, "T 3 3"] | None
    plates: Float[np.ndarray, "T 2 3"] | None = None  # unit normals of both plates of a fillet
    seam_begins: tuple[int, ...] = ()  # first points of the second and of each later seam

    @cached_property
    def normals(self) -> Float[np.ndarray, "T 3"]:
        """Unit normals of the path."""
        return path_normals(self.cloud, self.path) if self.given_normals is None else self.given_normals

    @cached_property
    def tangents(self) -> Float[np.ndarray, "T 3"]:
        """Unit tangents of the path, along each seam; NaN at a seam of one point."""
        if self.given_tangents is not None:
            return self.given_tangents
        seams = np.split(self.path, self.seam_begins)
        return np.concatenate([tangents_of(seam) if len(seam) > 1 else np.full((1, 3), np.nan) for seam in seams])


class Results(NamedTuple):
    """The results to validate, as tracks."""

    folder: Path
    workpiece: Callable[[PlanConfig], WorkpieceData]  # function that loads a job's workpiece
    count: int  # number of tracks
    tracks: Iterable[Track]
    files: dict[str, str]  # SHA-256 of the result files
    missing: Mapping[str, str] = MappingProxyType({})  # reasons for seams that the plan lacks, by name


def part_pose(part: configs.WorkpieceConfig, pose: Parameters) -> tuple[np.ndarray, np.ndarray]:
    """Return the rotation (3, 3) and the translation (3,) [m] from the workpiece frame to the world.

    The neutral pose is rotated about the pivot (about world x, then y, then z) and then shifted.
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
    """Return the targets of a job, world [m].

    The targets are the TCP at the start, points from there to the inlet, points from the inlet to the path, and the
    path. If the planner chooses the start at the path's first point, the targets are this point and the path.

    Args:
        job: The job.
        tcp: The TCP at the start (3,), world [m].
        inlet: The inlet (3,), world [m]; None if there is none.
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
    """Return the unit normals of planes fitted to the cloud near each point of a path.

    A normal points to the side with more of the cloud; points are weighted by a function that decreases over a quarter
    of the cloud's extent.
    """
    near = cloud[cKDTree(cloud).query(path, k=min(NEAREST, len(cloud)))[1]]
    normals = np.linalg.svd(near - near.mean(axis=1, keepdims=True), full_matrices=False)[2][:, 2]
    some = cloud[:: max(1, len(cloud) // SURROUNDINGS)]
    width = max(float(np.ptp(cloud, axis=0).max()) / 4, SHORTEST_M)
    weight = np.exp(-((cdist(path, some) / width) ** 2) / 2)
    inwards = weight @ some / weight.sum(axis=1, keepdims=True) - path
    return np.where((inwards * normals).sum(axis=1) < 0, -1.0, 1.0)[:, None] * normals


def tangents_of(path: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3"]:
    """Return unit tangents of a path, from the previous place to the next; at a reversal, only to the next.

    All points within ONE_PLACE_M of a place, up to the first point outside, have its tangent.
    """
    places, place_of = [path[0]], []
    for point in path:
        if np.linalg.norm(point - places[-1]) > ONE_PLACE_M:
            places.append(point)
        place_of.append(len(places) - 1)
    padded = np.pad(np.array(places), ((1, 1), (0, 0)), "edge")
    along, ahead = padded[2:] - padded[:-2], padded[2:] - padded[1:-1]
    along = np.where(np.linalg.norm(along, axis=1)[:, None] > SHORTEST_M, along, ahead)
    return (along / np.linalg.norm(along, axis=1)[:, None])[place_of]
