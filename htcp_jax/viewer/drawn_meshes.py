"""Meshes that are drawn: a part's own triangles, discs at the points of a cloud, and rounded hulls of bodies."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.model import surface as surfaces

CORNERS = 6  # of a disc
MOST_TRIANGLES = 500_000  # of a larger mesh, discs at sampled points are drawn
THINNEST_M = 1e-4  # minimum radius of a hull


class Mesh(NamedTuple):
    """Triangles, counterclockwise as seen from the side that their normals point to."""

    vertices: Float[np.ndarray, "V 3"]
    normals: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]


def discs(surface: surfaces.Surface, side: int = 1, corners: int = CORNERS) -> Mesh:
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


def flat_mesh(triangles: Float[np.ndarray, "F 3 3"], side: int = 1) -> Mesh:
    """Return a mesh of triangles that are drawn flat.

    Args:
        triangles: The triangles [m].
        side: 1, or -1 for triangles visible from the other side.
    """
    corners = triangles[:, ::side]
    return Mesh(
        corners.reshape(-1, 3), np.repeat(normals_of(corners), 3, axis=0), np.arange(corners.size // 3).reshape(-1, 3)
    )


def normals_of(triangles: Float[np.ndarray, "F 3 3"]) -> Float[np.ndarray, "F 3"]:
    """Return the unit normals of triangles; z for a triangle without area."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 0, normals / np.where(length > 0, length, 1), [0.0, 0, 1])


def cut_triangles(
    triangles: Float[np.ndarray, "F 3 3"], normal: Float[np.ndarray, "3"], offset: float
) -> Float[np.ndarray, "G 3 3"]:
    """Return what remains of triangles where normal @ p <= offset; those that are not cut keep their corners.

    Args:
        triangles: The triangles [m].
        normal: Unit normal of the plane, towards the removed side.
        offset: Distance of the plane from the origin [m].
    """
    over = triangles @ normal - offset
    count = (over > 0).sum(axis=1)
    parts = [triangles[count == 0]]
    for most in (1, 2):  # number of removed corners
        cut = count == most
        own, ends = surfaces.crossed(triangles[cut], over[cut], over[cut] > 0)
        b, c = np.moveaxis(ends, 1, 0)
        if most == 1:
            parts += [np.stack([b, own[:, 1], own[:, 2]], axis=1), np.stack([b, own[:, 2], c], axis=1)]
        else:
            parts.append(np.stack([own[:, 0], b, c], axis=1))
    return np.concatenate(parts)


def rounded_hull(
    points: Float[np.ndarray, "P 3"], radius: float
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]:
    """Return vertices [m] and triangles of the convex hull of points, thickened by a radius [m]."""
    from trimesh import convex, creation  # a slow import that `plan.png` does not need

    ball = max(radius, THINNEST_M) * creation.icosphere(subdivisions=1).vertices
    hull = convex.convex_hull((points[:, None] + ball).reshape(-1, 3))
    return np.array(hull.vertices), np.array(hull.faces)
