"""Surface of a point cloud for drawing: a normal and a small disc for every point; neighbouring discs overlap."""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

MOST = 60_000  # maximum number of points drawn
NEIGHBOURS, REACHED = 24, 8  # neighbours to which a normal is fitted; a disc extends beyond the REACHED-th neighbour
CORNERS, SURROUNDINGS = 6, 500
THINNEST_M = 1e-4  # minimum radius of a hull


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


class Mesh(NamedTuple):
    """Triangles, counterclockwise as seen from the side that their normals point to."""

    vertices: Float[np.ndarray, "V 3"]
    normals: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]


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


def discs(surface: Surface, side: int = 1, corners: int = CORNERS) -> Mesh:
    """Return a mesh with one disc per point; a disc is a polygon, visible from the side of its normal.

    Args:
        surface: The points, their normals and radii.
        side: 1, or -1 for polygons visible from the other side.
        corners: Number of corners of each polygon.
    """
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


def rounded_hull(
    points: Float[np.ndarray, "P 3"], radius: float
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]:
    """Return vertices [m] and triangles of the convex hull of points, thickened by a radius [m]."""
    from trimesh import convex, creation  # a slow import that `plan.png` does not need

    ball = max(radius, THINNEST_M) * creation.icosphere(subdivisions=1).vertices
    hull = convex.convex_hull((points[:, None] + ball).reshape(-1, 3))
    return np.array(hull.vertices), np.array(hull.faces)
