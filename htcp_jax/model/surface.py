"""A cloud of points as a surface to look at: for every point a normal and a small disc that meets its neighbours."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

MOST = 60_000  # points that are shown
NEIGHBOURS, REACHED = 24, 8  # that a normal is fitted to; the one that a disc reaches beyond
CORNERS, SURROUNDINGS = 6, 500


class Surface(NamedTuple):
    """P points of a cloud [m]."""

    points: Float[np.ndarray, "P 3"]
    normals: Float[np.ndarray, "P 3"]  # unit, to the inside
    radius: Float[np.ndarray, "P"]  # of the discs

    def only(self, which: Bool[np.ndarray, "P"] | Int[np.ndarray, "n"]) -> "Surface":
        """Those of the points, or the ones with these numbers."""
        return Surface(*(values[which] for values in self))

    def placed(self, T: Float[np.ndarray, "4 4"]) -> "Surface":
        """The surface moved."""
        rotate, translate = T[:3, :3], T[:3, 3]
        return Surface(self.points @ rotate.T + translate, self.normals @ rotate.T, self.radius)


class Drawn(NamedTuple):
    """What stands in the world, to be looked at."""

    triangles: Float[np.ndarray, "F 3 3"]  # [m]
    clouds: Surface


NOTHING = Drawn(np.empty((0, 3, 3)), Surface(np.empty((0, 3)), np.empty((0, 3)), np.empty(0)))


class Mesh(NamedTuple):
    """Triangles, anticlockwise as seen from where their normals point."""

    vertices: Float[np.ndarray, "V 3"]
    normals: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]


def surface_of(cloud: Float[np.ndarray, "P 3"]) -> Surface:
    """The surface of a cloud: all of its points, or MOST of them drawn at random, the same each time."""
    if len(cloud) > MOST:
        cloud = cloud[np.sort(np.random.default_rng(0).choice(len(cloud), MOST, replace=False))]
    count = min(NEIGHBOURS, len(cloud) - 1)
    distance, near = cKDTree(cloud).query(cloud, k=count + 1)
    reach = 1.1 * distance[:, min(REACHED, count)]
    return Surface(cloud, fitted_normals(cloud, cloud[near], cloud), np.minimum(reach, 3 * np.median(reach)))


def fitted_normals(
    points: Float[np.ndarray, "P 3"], near: Float[np.ndarray, "P K 3"], cloud: Float[np.ndarray, "C 3"]
) -> Float[np.ndarray, "P 3"]:
    """The normals of the cloud's surface at points, unit: across the planes that fit the points near to each, on the
    side on which most of the surroundings lie, the inside."""
    spread = near - near.mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("pki,pkj->pij", spread, spread))
    return _inwards(points, axes[:, :, 0], cloud)


def _inwards(
    points: Float[np.ndarray, "P 3"], normals: Float[np.ndarray, "P 3"], cloud: Float[np.ndarray, "C 3"]
) -> Float[np.ndarray, "P 3"]:
    """The normals turned to the side on which, seen from a point, its wider surroundings in the cloud lie."""
    some = cloud[:: max(1, len(cloud) // SURROUNDINGS)]
    width = max(np.ptp(cloud, axis=0).max() / 4, 1e-9)
    squared = (points**2).sum(axis=1)[:, None] - 2 * points @ some.T + (some**2).sum(axis=1)
    weight = np.exp(-squared / (2 * width**2))
    middle = weight @ some / weight.sum(axis=1, keepdims=True)
    return normals * np.where(((middle - points) * normals).sum(axis=1) < 0, -1.0, 1.0)[:, None]


def discs(surface: Surface, side: int = 1, corners: int = CORNERS) -> Mesh:
    """A hexagon for every point, or with fewer corners, seen from where its normal points, or with `side` -1 from where
    it does not."""
    normals = side * surface.normals
    first = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    first *= (surface.radius / np.linalg.norm(first, axis=1))[:, None]
    second = np.cross(normals, first)
    angle = 2 * np.pi * np.arange(corners) / corners
    around = np.cos(angle)[:, None] * first[:, None] + np.sin(angle)[:, None] * second[:, None]
    fan = np.array([[0, k, k + 1] for k in range(1, corners - 1)])
    return Mesh(
        vertices=(surface.points[:, None] + around).reshape(-1, 3),
        normals=np.repeat(normals, corners, axis=0),
        faces=(corners * np.arange(len(normals))[:, None, None] + fan).reshape(-1, 3),
    )
