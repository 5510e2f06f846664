"""Convex pieces of link meshes, one within each capsule that was fitted to a part of a mesh.

A mesh is cut by planes, and a capsule is fitted to each part. The convex hull of the part lies within the capsule and
bounds the same triangles more closely.
"""

from itertools import product as combinations
from typing import NamedTuple

import numpy as np
import scipy

from htcp_jax.numerics import table_size, with_repeated
from htcp_jax.types import Anywhere, Float, Int

FLAT = 1e-7  # points this close to a plane or a line, relative to their extent, lie on it
LEAST = 6  # least number of vertices of a stack
SHARES = 1, 2, 3, 3  # rows of vertices, normals, edges and sides of a stack, relative to each other
SHARP = 0.9  # no plane is added at an edge or a corner if the cosine of the angle between its normals is larger


class ConvexPiece(NamedTuple):
    """A convex polyhedron in its own frame, thickened by a radius.

    A polygon, a segment or a point is stored as a prism of thickness 0. In a stack of pieces, arrays are padded by
    repeating their last rows.
    """

    vertices: Float[Anywhere, "*n V 3"]  # [m]
    normals: Float[Anywhere, "*n F 3"]  # outward unit normals of the faces
    edges: Int[Anywhere, "*n E 2"]  # indices of both ends, in the direction of the cross product of the sides' normals
    sides: Int[Anywhere, "*n E 2"]  # indices of the faces that meet at the edge
    radius: Float[Anywhere, "*n"]  # [m]


class BodyPieces(NamedTuple):
    """Convex pieces of an arm's K bodies, each in the frame of its capsule's link."""

    piece: ConvexPiece  # stacked; an arbitrary one for a body without a piece
    planes: Float[Anywhere, "K D 4"]  # half-spaces that enclose the piece: unit normal, offset [m]
    excess_m: Float[Anywhere, "K"]  # largest distance of the capsule's surface from the piece; 0: there is no piece


def make_piece(points: Float[np.ndarray, "P 3"], radius: float = 0.0) -> ConvexPiece:
    """Return the convex hull of P >= 1 points [m], thickened by a radius [m].

    The points may lie in a plane or on a line.
    """
    middle = points.mean(axis=0)
    _, size, axes = np.linalg.svd(np.concatenate([points - middle, np.zeros((3, 3))]), full_matrices=False)
    missing = axes[int(np.sum(size > FLAT * size[0])) :] * (size[0] or 1.0)
    thickened = np.array(list(combinations((-1, 1), repeat=len(missing)))) @ missing
    hull = scipy.spatial.ConvexHull((points[:, None] + thickened[None]).reshape(-1, 3))
    normals, face = np.unique(hull.equations[:, :3].round(12), axis=0, return_inverse=True)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    used, vertex = np.unique(np.arange(len(points)).repeat(len(thickened))[hull.simplices], return_inverse=True)
    corners, vertices = vertex.reshape(-1, 3), points[used]
    ends = corners[:, [[1, 2], [0, 2], [0, 1]]]  # ends of the edge to each neighbour; neighbour i is opposite corner i
    sides = np.stack(np.broadcast_arrays(face[:, None], face[hull.neighbors]), axis=2)
    is_edge = (np.arange(len(face))[:, None] < hull.neighbors) & (sides[..., 0] != sides[..., 1])
    is_edge &= ends[..., 0] != ends[..., 1]
    ends, sides = ends[is_edge], sides[is_edge]
    along = np.cross(normals[sides[:, 0]], normals[sides[:, 1]])
    forwards = np.sum(along * (vertices[ends[:, 1]] - vertices[ends[:, 0]]), axis=1) > 0
    edges = np.column_stack([np.where(forwards[:, None], ends, ends[:, ::-1]), sides])
    if not len(edges):
        edges = np.zeros((1, 4), int)
    edges = edges[np.sort(np.unique(edges, axis=0, return_index=True)[1])]
    return ConvexPiece(vertices, normals, edges[:, :2], edges[:, 2:], np.asarray(radius, float))


def stack_pieces(pieces: list[ConvexPiece]) -> ConvexPiece:
    """Stack pieces, each padded to the size of the largest one."""
    columns = list(zip(*(piece[:4] for piece in pieces), strict=True))
    shared = list(zip(columns, SHARES, strict=True))
    size = table_size(max(max(map(len, column)) / share for column, share in shared), LEAST)
    padded = [[with_repeated(rows, size * share) for rows in column] for column, share in shared]
    return ConvexPiece(*map(np.stack, padded), np.stack([piece.radius for piece in pieces]))


def body_pieces(pieces: list[ConvexPiece], excess_m: Float[np.ndarray, "K"]) -> BodyPieces:
    """Stack the pieces of K bodies and compute the planes that enclose each piece."""
    planes = [_enclosing_planes(piece) for piece in pieces]
    most = table_size(max(map(len, planes)), 4 * LEAST)
    return BodyPieces(stack_pieces(pieces), np.stack([with_repeated(each, most) for each in planes]), excess_m)


def _enclosing_planes(piece: ConvexPiece) -> Float[np.ndarray, "D 4"]:
    """Return half-spaces that enclose a piece: at its faces, its sharp edges and its sharp corners."""
    sides = piece.normals[piece.sides]
    edges = sides[np.sum(sides[:, 0] * sides[:, 1], axis=1) < SHARP].sum(axis=1)
    is_side = np.zeros((len(piece.vertices), len(piece.normals)), bool)
    is_side[piece.edges[:, :, None], piece.sides[:, None, :]] = True
    corners = []
    for sides_of_vertex in is_side:
        own = piece.normals[sides_of_vertex]
        middle = own.sum(axis=0)
        size = np.linalg.norm(middle)
        if size > FLAT and (own @ middle).min() < SHARP * size:
            corners.append(middle)
    over = np.concatenate([edges, np.reshape(corners, (-1, 3))])
    length = np.linalg.norm(over, axis=1, keepdims=True)
    normals = np.concatenate([piece.normals, over[length[:, 0] > FLAT] / length[length[:, 0] > FLAT]])
    return np.column_stack([normals, (normals @ piece.vertices.T).max(axis=1) + piece.radius])
