"""Convex hulls for validation: convex pieces inside an arm's capsules, and their clearance to walls.

An arm's file may contain a convex piece for a capsule. The capsule and the piece both enclose the same part of the
link's mesh, so the larger of their two clearances is a lower bound on the mesh's. The pieces are read again here,
independently of the planner. The distance of two disjoint polyhedra is the smallest distance of an edge of one from a
face of the other.
"""

from collections.abc import Mapping
from functools import cached_property
from itertools import product
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from htcp_jax.errors import InputError
from htcp_jax.validation.mesh_clearance import axis_distances

# Prefixes of names in an arm's file: <text> with a piece's vertices, <numeric> with its radius [m].
PIECE, RADIUS = "piece of ", "radius of "
SLACK_M = 1e-6  # tolerance for a piece's vertex outside its capsule
FLAT_M = 1e-6  # thickness added to a piece without volume, for Qhull
ROUNDING_M = 1e-9  # tolerance when distant parts of a wall are skipped
AT_ONCE, HEIGHTS_AT_ONCE = 4, 2_000_000  # maximum numbers of wall parts measured, and of heights computed, at once


class Hull:
    """Convex hull of points [m], enlarged by a radius [m]."""

    def __init__(self, points: Float[np.ndarray, "V 3"], radius: float = 0.0):
        self.points, self.radius = points, radius

    @cached_property
    def _hull(self) -> ConvexHull:
        return ConvexHull(self.points)

    @cached_property
    def _edges(self) -> Float[np.ndarray, "e 2 3"]:
        corners = np.concatenate([self._hull.simplices[:, [k, k - 1]] for k in range(3)])
        return self.points[np.unique(np.sort(corners, axis=1), axis=0)]

    def clearance(self, wall: Float[np.ndarray, "m C 3"], below: float = np.inf) -> float:
        """Return the smallest distance of the hull from points or triangles [m].

        The result is negative if a corner of the wall is inside; without a radius it is the negated depth. If only an
        edge passes through a face, it is minus the radius. Parts of the wall that a facet's plane proves to be farther
        away are not measured.

        Args:
            wall: The points (C = 1) or the triangles' corners (C = 3) [m].
            below: Largest distance of interest [m]; a larger distance may be returned as any number above it.
        """
        middle = wall.mean(axis=1)
        apart = self._heights(middle) - np.linalg.norm(wall - middle[:, None], axis=2).max(axis=1) - ROUNDING_M
        within = self._heights(wall[apart <= 0].reshape(-1, 3)).min(initial=np.inf)
        if within <= 0:
            return float(within) - self.radius
        order, found = np.argsort(apart), np.inf
        for first in range(0, len(order), AT_ONCE):
            some = order[first : first + AT_ONCE]
            if apart[some[0]] > min(found, below + self.radius):
                break
            found = min(found, self._distance(wall[some]))
        return found - self.radius

    def _heights(self, points: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "m"]:
        """Return each point's largest signed distance from the facets' planes [m]; negative inside."""
        planes = self._hull.equations
        step = HEIGHTS_AT_ONCE // len(planes)
        parts = [
            (points[k : k + step] @ planes[:, :3].T + planes[:, 3]).max(axis=1) for k in range(0, len(points), step)
        ]
        return np.concatenate(parts or [np.empty(0)])

    def _distance(self, wall: Float[np.ndarray, "m C 3"]) -> float:
        """Return the smallest distance to points or triangles, none of which may lie inside the hull [m]."""
        faces = self.points[self._hull.simplices]
        edges = np.concatenate([np.stack([wall[:, k], wall[:, k - 1]], 1) for k in range(wall.shape[1])])
        found = _smallest(edges, faces)
        return min(found, _smallest(self._edges, wall)) if wall.shape[1] > 1 else found


def _smallest(edges: Float[np.ndarray, "e 2 3"], triangles: Float[np.ndarray, "m 3 3"]) -> float:
    """Return the smallest distance of any edge from any triangle [m]."""
    e, m = (index.ravel() for index in np.indices((len(edges), len(triangles))))
    return float(axis_distances(edges[e, 0], edges[e, 1], triangles[m]).min())


def read_hulls(spec: mujoco.MjSpec, path: Path) -> dict[str, Hull]:
    """Return the convex pieces in an arm's file by capsule name, each in its body's frame.

    Args:
        spec: The parsed file.
        path: The path of the file, for messages.

    Raises:
        InputError: If vertices are not rows of three finite numbers, or if a radius is missing or negative.
    """
    radii = {each.name: each.data[0] for each in spec.numerics if len(each.data)}
    texts = {each.name.removeprefix(PIECE): each.data for each in spec.texts if each.name.startswith(PIECE)}
    return {name: _read_hull(name, text, radii, path) for name, text in texts.items()}


def _read_hull(name: str, text: str, radii: Mapping[str, float], path: Path) -> Hull:
    try:
        points, radius = np.array([row.split() for row in text.split(";")], float), float(radii[RADIUS + name])
    except (ValueError, KeyError):
        points, radius = np.empty(0), np.nan
    if points.shape[1:] != (3,) or not (np.isfinite(points).all() and 0 <= radius < np.inf):
        raise InputError(f"{path}: {PIECE + name!r} needs rows of 3 numbers and a {RADIUS + name!r} of at least 0 m")
    return Hull(points, radius)


def hull_in_capsule(
    hull: Hull, position: np.ndarray, quaternion: np.ndarray, radius: float, half: float
) -> Hull | None:
    """Return a hull in the frame of its capsule; None if a vertex is outside the capsule.

    Args:
        hull: The hull, in the frame of the body.
        position: Position (3,) of the capsule's middle in the body's frame [m].
        quaternion: Orientation (4,) of the capsule in the body's frame, w first; the capsule's axis is z.
        radius: Radius of the capsule [m].
        half: Half length of the capsule's axis [m].
    """
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, quaternion)
    points = (hull.points - position) @ rotation.reshape(3, 3)
    beyond = np.maximum(np.abs(points[:, 2]) - half, 0.0)
    if (np.hypot(np.hypot(points[:, 0], points[:, 1]), beyond) > radius + SLACK_M).any():
        return None
    try:
        ConvexHull(points)
    except (QhullError, ValueError):
        points = (points[:, None] + FLAT_M * np.array(list(product((-1, 1), repeat=3)))).reshape(-1, 3)
    return Hull(points, hull.radius)
