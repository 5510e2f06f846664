"""Convex hulls for validation: pieces of the vendor's meshes in an arm's capsules, and their clearance to walls.

An arm's file may have a convex piece for a capsule. The mesh lies within both: the larger distance of the two is a
bound on its clearance. The pieces are read here a second time. The distance of two polyhedra that do not intersect is
that of an edge of one and a face of the other.
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

PIECE, RADIUS = (
    "piece of ",
    "radius of ",
)  # names of an arm's <text> with a capsule's vertices, and of its <numeric> [m]
SLACK_M = 1e-6  # by which a vertex may be outside of its capsule
FLAT_M = 1e-6  # by which a piece without volume is thickened, for Qhull
ROUNDING_M = 1e-9  # of the heights that exclude parts of a wall
AT_ONCE, HEIGHTS_AT_ONCE = 4, 2_000_000  # parts of a wall that are measured at once; heights in memory


class Hull:
    """The convex hull of points [m], thickened by a radius [m]."""

    def __init__(self, points: Float[np.ndarray, "V 3"], radius: float = 0.0):
        self.points, self.radius = points, radius

    @cached_property
    def _hull(self) -> ConvexHull:
        return ConvexHull(self.points)

    @cached_property
    def _edges(self) -> Float[np.ndarray, "e 2 3"]:
        corners = np.concatenate([self._hull.simplices[:, [k, k - 1]] for k in range(3)])
        return self.points[np.unique(np.sort(corners, axis=1), axis=0)]

    def clearance(self, wall: Float[np.ndarray, "m C 3"]) -> float:
        """Smallest distance to points (C = 1) or triangles (C = 3) [m].

        Negative if a corner is inside, for a radius of 0 the depth; minus the radius if only an edge passes through a
        face. Parts of the wall are not measured if a plane of the hull separates them by more than the distance.
        """
        middle = wall.mean(axis=1)
        apart = self._heights(middle) - np.linalg.norm(wall - middle[:, None], axis=2).max(axis=1) - ROUNDING_M
        within = self._heights(wall[apart <= 0].reshape(-1, 3)).min(initial=np.inf)
        if within <= 0:
            return float(within) - self.radius
        order, found = np.argsort(apart), np.inf
        for first in range(0, len(order), AT_ONCE):
            some = order[first : first + AT_ONCE]
            if apart[some[0]] > found:
                break
            found = min(found, self._distance(wall[some]))
        return found - self.radius

    def _heights(self, points: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "m"]:
        """Largest signed distance of each point to the planes of the facets [m]; negative inside."""
        planes = self._hull.equations
        step = HEIGHTS_AT_ONCE // len(planes)
        parts = [
            (points[k : k + step] @ planes[:, :3].T + planes[:, 3]).max(axis=1) for k in range(0, len(points), step)
        ]
        return np.concatenate(parts or [np.empty(0)])

    def _distance(self, wall: Float[np.ndarray, "m C 3"]) -> float:
        """Smallest distance to points or triangles that do not lie inside [m]."""
        faces = self.points[self._hull.simplices]
        edges = np.concatenate([np.stack([wall[:, k], wall[:, k - 1]], 1) for k in range(wall.shape[1])])
        found = _smallest(edges, faces)
        return min(found, _smallest(self._edges, wall)) if wall.shape[1] > 1 else found


def _smallest(edges: Float[np.ndarray, "e 2 3"], triangles: Float[np.ndarray, "m 3 3"]) -> float:
    """Smallest distance of any edge to any triangle [m]."""
    e, m = (index.ravel() for index in np.indices((len(edges), len(triangles))))
    return float(axis_distances(edges[e, 0], edges[e, 1], triangles[m]).min())


def read_hulls(spec: mujoco.MjSpec, path: Path) -> dict[str, Hull]:
    """Read the pieces in an arm's file, in the frames of the bodies, by the names of their capsules.

    Args:
        spec: The file.
        path: The file, for messages.

    Raises:
        InputError: For vertices that are not rows of three finite numbers, or a radius that is missing or negative.
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
    """Return a hull in the frame of its capsule; None if the capsule does not hold its points.

    Args:
        hull: The hull, in the frame of the body.
        position: Position (3,) of the capsule's middle there [m].
        quaternion: Orientation (4,) of the capsule there; its axis is z.
        radius: Radius of the capsule [m].
        half: Half length of its axis [m].
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
