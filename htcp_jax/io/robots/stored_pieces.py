"""Convex pieces of the meshes in an arm's capsules, as the arm's file stores them.

A capsule is fitted to a part of a mesh. Its piece is the convex hull of some of the part's points, thickened by a
radius so that it contains all points. The hull lies within the capsule; the thickened hull may extend beyond the
capsule by the radius.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import scipy
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io.robots.capsule_fit import FIRST_DIRECTIONS, TINY, Capsule, Points, hull_corners
from htcp_jax.model import BodyPieces, body_pieces, make_piece

# Names of an arm's <text> with a capsule's vertices, and of its <numeric>s [m].
PIECE, RADIUS, EXCESS, FITTED = "piece of ", "radius of ", "excess of ", "capsule of "
MOST_VERTICES = 96
ENOUGH_M = 1e-4  # vertices are added until all points are within this distance of the hull
DIGITS = 6  # decimals of a vertex and a radius [m]
SLACK_M = 1e-6  # distance by which a vertex may be outside of its capsule, due to rounding
MOST_READ = 1000  # maximum number of vertices of a piece in a file


Vertices = Float[np.ndarray, "V 3"]


class StoredPiece(NamedTuple):
    """A convex hull in the frame of its capsule's body, thickened by a radius."""

    vertices: Vertices  # [m]
    radius: float  # [m]
    capsule: Capsule | None = None  # the fitted capsule, in the same frame; None: any capsule that contains the hull

    def missed_m(self, points: Points) -> float:
        """Return the largest distance of the points from the piece [m]; 0 if all are inside."""
        outside = points[_heights(points, self.vertices) > 0]
        return max(0.0, max((_distance(point, self.vertices) for point in outside), default=0.0) - self.radius)

    def excess_m(self, capsule: Capsule) -> float:
        """Return the largest distance of a capsule's surface from the piece [m], exactly.

        In a direction n, the capsule's support function is max(n @ p, n @ q) + r, and the hull's is max(n @ v). The
        largest difference is r plus the larger of the signed distances of p and q from the hull.
        """
        ends = np.stack([capsule.p, capsule.q])
        signed = [
            height if height <= 0 else _distance(end, self.vertices)
            for height, end in zip(_heights(ends, self.vertices), ends, strict=True)
        ]
        return max(0.0, capsule.radius - self.radius + float(max(signed)))


def reduced_piece(points: Points) -> StoredPiece:
    """Return the convex hull of points [m] with at most MOST_VERTICES, and the radius that encloses all points.

    The hull begins with the extreme points in FIRST_DIRECTIONS; the point farthest outside is then added repeatedly.
    """
    x = hull_corners(points)
    rounded = np.unique(x.round(DIGITS), axis=0)
    chosen = np.unique(np.argmax(rounded @ FIRST_DIRECTIONS.T, axis=0)).tolist()
    while len(chosen) < min(MOST_VERTICES, len(rounded)):
        height = _heights(rounded, rounded[chosen])
        if height.max() < ENOUGH_M / 2:
            break
        chosen.append(int(height.argmax()))
    piece = StoredPiece(rounded[chosen], 0.0)
    return piece._replace(radius=float(np.ceil(piece.missed_m(x) * 10**DIGITS + 1e-3) / 10**DIGITS))


def vertices_text(piece: StoredPiece) -> str:
    """Format a piece's vertices as text, as in an arm's file."""
    return "; ".join(" ".join(f"{number + 0.0:.9g}" for number in vertex) for vertex in piece.vertices)


def read_pieces(spec: mujoco.MjSpec, path: Path) -> dict[str, StoredPiece]:
    """Return the pieces in an arm's file by the names of their capsules.

    Args:
        spec: The file as an MjSpec.
        path: The file, for messages.

    Raises:
        InputError: For vertices that are not rows of three finite numbers, or a radius that is missing or negative.
    """
    radii = {numeric.name: float(numeric.data[0]) for numeric in spec.numerics if len(numeric.data)}
    texts = {text.name.removeprefix(PIECE): text.data for text in spec.texts if text.name.startswith(PIECE)}
    fitted = {each.name: np.array(each.data) for each in spec.numerics if each.name.startswith(FITTED)}
    pieces = {name: _read_piece(name, data, radii.get(RADIUS + name), path) for name, data in texts.items()}
    return {name: piece._replace(capsule=_read_capsule(fitted.get(FITTED + name))) for name, piece in pieces.items()}


def _read_capsule(numbers: Float[np.ndarray, "n"] | None) -> Capsule | None:
    return None if numbers is None or len(numbers) != 7 else Capsule(numbers[:3], numbers[3:6], float(numbers[6]))


def _read_piece(name: str, data: str, radius: float | None, path: Path) -> StoredPiece:
    try:
        rows = [[float(number) for number in row.split()] for row in data.split(";")]
    except ValueError:
        rows = []
    if not 1 <= len(rows) <= MOST_READ or any(len(row) != 3 for row in rows) or not np.isfinite(rows).all():
        raise InputError(f"{path}: text {PIECE + name!r} must be 1 to {MOST_READ} rows of 3 numbers, separated by ;")
    if radius is None or not 0 <= radius < np.inf:
        raise InputError(f"{path}: {PIECE + name!r} needs a numeric {RADIUS + name!r} of at least 0 m")
    return StoredPiece(np.array(rows), radius)


def pieces_of(
    stored: Mapping[str, StoredPiece], capsules: Mapping[str, tuple[Capsule, Float[np.ndarray, "4 4"]]]
) -> BodyPieces | None:
    """Return the pieces of an arm's capsules in the frames of their links; None if no capsule has a piece.

    The piece of a capsule that was changed by hand is ignored, as the capsule may represent more than its mesh.

    Args:
        stored: The pieces in the arm's file, by the names of their capsules.
        capsules: By name, the arm's capsules, and the poses of the capsules' bodies, both in the frames of their links
            [m].
    """
    pieces, excess = [], []
    for name, (capsule, T_link_body) in capsules.items():
        own = stored.get(name)
        if own is not None:
            own = _moved(own, T_link_body)
        if own is None or not _holds(capsule, own):
            pieces.append(make_piece(capsule.p[None]))
            excess.append(0.0)
        else:
            pieces.append(make_piece(own.vertices, own.radius))
            excess.append(own.excess_m(capsule))
    return body_pieces(pieces, np.array(excess)) if any(excess) else None


def _moved(piece: StoredPiece, T: Float[np.ndarray, "4 4"]) -> StoredPiece:
    """Return a piece transformed by T [m]."""
    R, t, fitted = T[:3, :3].T, T[:3, 3], piece.capsule
    fitted = fitted and Capsule(fitted.p @ R + t, fitted.q @ R + t, fitted.radius)
    return StoredPiece(piece.vertices @ R + t, piece.radius, fitted)


def _holds(capsule: Capsule, piece: StoredPiece) -> bool:
    """Return True if a capsule contains a piece's hull, and is the capsule that was fitted, if that is known."""
    if capsule.depth(piece.vertices).min() < -SLACK_M:
        return False
    if (fitted := piece.capsule) is None:
        return True
    ends = [np.stack(pair) for pair in ((fitted.p, fitted.q), (fitted.q, fitted.p))]
    off = min(np.abs(pair - np.stack([capsule.p, capsule.q])).max() for pair in ends)
    return bool(off <= SLACK_M and abs(capsule.radius - fitted.radius) <= SLACK_M)


def _heights(points: Points, vertices: Vertices) -> Float[np.ndarray, "P"]:
    """Return each point's largest signed distance from the planes of a hull [m]; minus its depth for a point inside."""
    try:
        faces = scipy.spatial.ConvexHull(vertices).equations
        return np.max(points @ faces[:, :3].T + faces[:, 3], axis=1)
    except (scipy.spatial.QhullError, ValueError):  # flat
        normals = make_piece(vertices).normals
        return np.max(points @ normals.T - np.max(vertices @ normals.T, axis=0), axis=1)


def _distance(point: Float[np.ndarray, "3"], vertices: Points) -> float:
    """Return the distance of a point from a convex hull [m].

    Non-negative least squares of |sum(share * away)|^2 + (sum(share) - 1)^2 gives the shares of the vertices in the
    nearest point, up to a factor.
    """
    away = vertices - point
    size = max(float(np.abs(away).max()), TINY)
    share, _ = scipy.optimize.nnls(np.vstack([away.T / size, np.ones(len(away))]), np.array([0.0, 0.0, 0.0, 1.0]))
    return float(np.linalg.norm(share @ away)) / max(float(share.sum()), TINY)
