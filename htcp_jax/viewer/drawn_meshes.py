"""Meshes that are drawn: discs at the points of a cloud, and rounded hulls of bodies."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.model import surface as surfaces

CORNERS = 6  # of a disc
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


def rounded_hull(
    points: Float[np.ndarray, "P 3"], radius: float
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]:
    """Return vertices [m] and triangles of the convex hull of points, thickened by a radius [m]."""
    from trimesh import convex, creation  # a slow import that `plan.png` does not need

    ball = max(radius, THINNEST_M) * creation.icosphere(subdivisions=1).vertices
    hull = convex.convex_hull((points[:, None] + ball).reshape(-1, 3))
    return np.array(hull.vertices), np.array(hull.faces)
