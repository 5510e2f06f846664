"""Surface of a point cloud for drawing: a normal and a small disc for every point; neighbouring discs overlap."""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

MOST = 60_000  # maximum number of points drawn
NEIGHBOURS, REACHED = 24, 8  # neighbours to which a normal is fitted; a disc extends beyond the REACHED-th neighbour
SURROUNDINGS = 500  # maximum number of points of the cloud to which a normal is directed


class Surface(NamedTuple):
    """P points of a cloud [m], each with a normal and a disc."""

    points: Float[np.ndarray, "P 3"]
    normals: Float[np.ndarray, "P 3"]  # unit, towards the inside
    radius: Float[np.ndarray, "P"]  # radii of the discs [m]

    def only(self, which: Bool[np.ndarray, "P"] | Int[np.ndarray, "n"]) -> "Surface":
        """Return the points selected by a mask or by indices."""
        return Surface(*(values[which] for values in self))

    def placed(self, T: Float[np.ndarray, "4 4"]) -> "Surface":
        """Return the surface transformed by T [m]."""
        rotate, translate = T[:3, :3], T[:3, 3]
        return Surface(self.points @ rotate.T + translate, self.normals @ rotate.T, self.radius)


class WorldGeometry(NamedTuple):
    """Geometry in the world, for drawing."""

    triangles: Float[np.ndarray, "F 3 3"]  # [m]
    clouds: Surface

    def placed(self, T: Float[np.ndarray, "4 4"]) -> "WorldGeometry":
        """Return the geometry transformed by T [m]."""
        return WorldGeometry(self.triangles @ T[:3, :3].T + T[:3, 3], self.clouds.placed(T))


NOTHING = WorldGeometry(np.empty((0, 3, 3)), Surface(np.empty((0, 3)), np.empty((0, 3)), np.empty(0)))


def surface_of(cloud: Float[np.ndarray, "P 3"], most: int = MOST) -> Surface:
    """Return the surface of a cloud [m]: all of its points, or at most `most` points from a fixed random choice."""
    if len(cloud) > most:
        cloud = cloud[np.sort(np.random.default_rng(0).choice(len(cloud), most, replace=False))]
    count = min(NEIGHBOURS, len(cloud) - 1)
    distance, near = scipy.spatial.cKDTree(cloud).query(cloud, k=count + 1)
    reach = 1.1 * distance[:, min(REACHED, count)]
    return Surface(cloud, cloud_normals(cloud, cloud[near], cloud), np.minimum(reach, 3 * np.median(reach)))


def cloud_normals(
    points: Float[np.ndarray, "P 3"], near: Float[np.ndarray, "P K 3"], cloud: Float[np.ndarray, "C 3"]
) -> Float[np.ndarray, "P 3"]:
    """Return the unit normals of the cloud's surface at points, towards the inside.

    A normal is perpendicular to the plane that fits the point's neighbours. It points to the side on which most of the
    cloud nearby lies.

    Args:
        points: Points at which to fit [m].
        near: Neighbours of each point [m].
        cloud: The complete cloud [m].
    """
    spread = near - near.mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("pki,pkj->pij", spread, spread))
    return _inwards(points, axes[:, :, 0], cloud)


def _inwards(
    points: Float[np.ndarray, "P 3"], normals: Float[np.ndarray, "P 3"], cloud: Float[np.ndarray, "C 3"]
) -> Float[np.ndarray, "P 3"]:
    """Reverse each normal that points away from the mean of the cloud around its point, weighted by distance."""
    some = cloud[:: max(1, len(cloud) // SURROUNDINGS)]
    width = max(np.ptp(cloud, axis=0).max() / 4, 1e-9)
    squared = (points**2).sum(axis=1)[:, None] - 2 * points @ some.T + (some**2).sum(axis=1)
    weight = np.exp(-squared / (2 * width**2))
    middle = weight @ some / weight.sum(axis=1, keepdims=True)
    return normals * np.where(((middle - points) * normals).sum(axis=1) < 0, -1.0, 1.0)[:, None]
