"""Convex pieces of link meshes, one within each capsule that was fitted to a part of a mesh.

The mesh is cut by planes; a capsule encloses the triangles of one part, and the part's convex hull lies within it: a
closer bound of the same triangles.
"""

from itertools import product as combinations
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from htcp_jax.types import Anywhere, Float, Int

FLAT = 1e-7  # points this close to a plane or a line, relative to their extent, lie on it


class ConvexPiece(NamedTuple):
    """A convex polyhedron in its own frame, thickened by a radius; stacked ones repeat last rows.

    A polygon, a segment and a point are prisms without thickness in the directions that they lack.
    """

    vertices: Float[Anywhere, "*n V 3"]
    normals: Float[Anywhere, "*n F 3"]  # of the faces, unit, outwards
    edges: Int[Anywhere, "*n E 2"]  # vertices, in the direction of the cross product of the sides' normals
    sides: Int[Anywhere, "*n E 2"]  # faces
    radius: Float[Anywhere, "*n"]


class BodyPieces(NamedTuple):
    """Convex pieces of an arm's K bodies, each in the frame of its capsule's link."""

    piece: ConvexPiece  # stacked; of a body without a piece any
    excess_m: Float[Anywhere, "K"]  # largest distance of the capsule's surface from the piece; 0: without a piece


def make_piece(points: Float[np.ndarray, "P 3"], radius: float = 0.0) -> ConvexPiece:
    """Return the convex hull of at least one point [m], thickened by a radius [m].

    The points may lie in a plane or on a line.
    """
    middle = points.mean(axis=0)
    _, size, axes = np.linalg.svd(np.concatenate([points - middle, np.zeros((3, 3))]))
    missing = axes[int(np.sum(size > FLAT * size[0])) :] * (size[0] or 1.0)
    thickened = np.array(list(combinations((-1, 1), repeat=len(missing)))) @ missing
    hull = ConvexHull((points[:, None] + thickened[None]).reshape(-1, 3))
    normals, face = np.unique(hull.equations[:, :3].round(12), axis=0, return_inverse=True)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    used, vertex = np.unique(np.arange(len(points)).repeat(len(thickened))[hull.simplices], return_inverse=True)
    corners, vertices = vertex.reshape(-1, 3), points[used]
    edges = {}
    for facet, neighbours in enumerate(hull.neighbors):
        for opposite, other in enumerate(neighbours):  # the neighbour is opposite of the corner
            (a, b), sides = np.delete(corners[facet], opposite), (face[facet], face[other])
            if facet < other and sides[0] != sides[1] and a != b:
                forwards = np.cross(*normals[list(sides)]) @ (vertices[b] - vertices[a]) > 0
                edges[(a, b) if forwards else (b, a), sides] = None
    pairs = np.array(list(edges) or [((0, 0), (0, 0))])
    return ConvexPiece(vertices, normals, pairs[:, 0], pairs[:, 1], np.asarray(radius, float))


def stack_pieces(pieces: list[ConvexPiece]) -> ConvexPiece:
    """Return the pieces stacked, each padded to the largest."""
    columns = list(zip(*(piece[:4] for piece in pieces), strict=True))
    padded = [[_padded(rows, max(map(len, column))) for rows in column] for column in columns]
    return ConvexPiece(*map(np.stack, padded), np.stack([piece.radius for piece in pieces]))


def _padded(rows: np.ndarray, count: int) -> np.ndarray:
    return rows[np.minimum(np.arange(count), len(rows) - 1)]
