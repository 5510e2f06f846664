"""Surfaces: the points of a cloud, each with a normal and a small disc, and the triangles of a mesh, cut into pieces.

The discs of neighbouring points overlap. A triangle is cut at the middle of its longest edge.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from htcp_jax.errors import InputError

MOST = 60_000  # maximum number of points drawn
NEIGHBOURS, REACHED = 24, 8  # neighbours to which a normal is fitted; a disc extends beyond the REACHED-th neighbour
SURROUNDINGS = 500  # maximum number of points of the cloud to which a normal is directed
MOST_POINTS = 3_000_000  # maximum number of points on a mesh
KEY = "workpiece.mesh_spacing_m"

Triangles = Float[np.ndarray, "F 3 3"]
Corners = Float[np.ndarray, "3 3 F"]  # triangles by corner and coordinate, as numpy is fastest along the last axis


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
    floor_m: float | None = None  # height of the floor [m]; None: unknown

    def placed(self, T: Float[np.ndarray, "4 4"]) -> "WorldGeometry":
        """Return the geometry transformed by T [m]; without a floor, unless T is the identity."""
        floor_m = self.floor_m if (T == np.eye(4)).all() else None
        return WorldGeometry(self.triangles @ T[:3, :3].T + T[:3, 3], self.clouds.placed(T), floor_m)


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


def pieces(triangles: Triangles, edge_m: float, source: str) -> Float[np.ndarray, "G 3 3"]:
    """Cut the triangles until no edge is longer than `edge_m`.

    Raises:
        InputError: For more than 2 MOST_POINTS pieces.
    """
    left = np.ascontiguousarray(np.moveaxis(triangles, 0, 2))
    done, count = [], 0
    while left.shape[2]:
        left = longest_edge_first(left)
        coarse = square_norm(left[1] - left[0]) > edge_m**2
        done.append(left[:, :, ~coarse])
        count += done[-1].shape[2]
        left, _ = halved_triangles(left[:, :, coarse])
        check_count((count + left.shape[2]) / 2, f"a spacing of {edge_m:.3g} m", source)
    return np.ascontiguousarray(np.moveaxis(np.concatenate(done, axis=2), 2, 0))


def crossed(
    triangles: Triangles, height: Float[np.ndarray, "F 3"], above: Bool[np.ndarray, "F 3"]
) -> tuple[Triangles, Float[np.ndarray, "F 2 3"]]:
    """Return triangles that a plane cuts, and the two points at which their edges cross it.

    Args:
        triangles: The triangles [m]. Each is returned from the corner on that is alone on its side of the plane.
        height: Distances of their corners from the plane [m].
        above: True for corners on one side of the plane.
    """
    alone = np.where(above.sum(axis=1) == 1, above.argmax(axis=1), (~above).argmax(axis=1))
    turn = (alone[:, None] + np.arange(3)) % 3
    turned, height = np.take_along_axis(triangles, turn[..., None], 1), np.take_along_axis(height, turn, 1)
    share = height[:, :1] / (height[:, :1] - height[:, 1:])
    return turned, turned[:, :1] + share[..., None] * (turned[:, 1:] - turned[:, :1])


def nearest_share(off: Float[np.ndarray, "*#r d"], along: Float[np.ndarray, "*#r d"]) -> Float[np.ndarray, "*s"]:
    """Return the places on segments that are nearest to points, as shares of the segments.

    Args:
        off: Vectors from the segments' beginnings to the points [m].
        along: Vectors from the segments' beginnings to their ends [m].
    """
    return np.clip((off * along).sum(axis=-1) / np.maximum((along * along).sum(axis=-1), 1e-300), 0.0, 1.0)


def area(triangles: Triangles) -> Float[np.ndarray, "F"]:
    """Return the area of each triangle [m2]."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def halved_triangles(corners: Corners) -> tuple[Float[np.ndarray, "3 3 2*F"], Float[np.ndarray, "3 F"]]:
    """Cut each triangle in two at the middle of its first edge, the longest; return the halves and the middles.

    Two triangles that share such an edge get the same middle, bit for bit.
    """
    b, c, a = corners
    middle = (b + c) / 2
    return np.concatenate([np.stack([a, b, middle]), np.stack([c, a, middle])], axis=2), middle


def longest_edge_first(corners: Corners) -> Corners:
    """Reorder each triangle's corners cyclically so that its longest edge comes first."""
    a, b, c = corners
    ab, bc, ca = square_norm(b - a), square_norm(c - b), square_norm(a - c)
    from_b, from_c = (bc > ab) & (bc >= ca), (ca > ab) & (ca > bc)
    turned = corners.copy()
    turned[:, :, from_b] = corners[[1, 2, 0]][:, :, from_b]
    turned[:, :, from_c] = corners[[2, 0, 1]][:, :, from_c]
    return turned


def components_dot(u: Float[np.ndarray, "3 F"], v: Float[np.ndarray, "3 F"]) -> Float[np.ndarray, "F"]:
    """Return the scalar product of each pair of vectors [m2]."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def square_norm(u: Float[np.ndarray, "3 F"]) -> Float[np.ndarray, "F"]:
    """Return the squared length of each vector [m2]."""
    return components_dot(u, u)


def check_count(points: float, spacing: str, source: str, enough: str = "") -> None:
    """Raise an InputError for more than MOST_POINTS points; `enough` says which spacing is accepted, if known."""
    if points > MOST_POINTS:
        raise InputError(f"{source}: more than {MOST_POINTS:,} points at {spacing}; increase {KEY}{enough}")
