"""Capsules that enclose a mesh: the smallest one about its points, or several about the mesh's pieces after plane cuts.

A capsule is convex, so it encloses a triangle if it encloses the triangle's corners. A plane clips the triangles that
it intersects: each part lies completely on one side, and in the capsule of that side, after any number of cuts. The
interior of a closed mesh is enclosed, too: its part on one side of a plane lies in the convex hull of the triangles
there.
"""

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import mujoco
import numpy as np
import scipy
from jaxtyping import Bool, Float

from htcp_jax.io.robots.frames import frame

GRID_M = 1e-5  # ends and radius are multiples of it, the radius rounded up
THINNEST_M = 3e-3  # minimum radius: a thinner body would need impractically dense points on the workpiece
CUTS = 0.2, 0.35, 0.5, 0.65, 0.8  # shares of a piece's extent at which cuts are tried
WORTH = 0.15  # share of the volume that a cut must save
SNUG = 1.5  # a capsule with at most this many times the hull's volume is not split
MOST = 3  # maximum number of capsules per body
MORE_PIECES, HOLLOW = 2, 0.05  # for hollows: number of additional pieces; share of the hulls' volume a cut must save
MORE = 20  # points added to the working set in each round
FINE = 28  # points per side of the grid on which volumes are compared
TINY = 1e-9  # of a mesh's size: smaller lengths count as 0
FIRST_DIRECTIONS = np.stack(np.meshgrid(*3 * [[-1.0, 0, 1]]), axis=-1).reshape(-1, 3)  # directions of the first points


class Effort(NamedTuple):
    """Effort of the search for the smallest capsule."""

    starts: int  # number of principal axes to start from, the best first
    rounds: int  # maximum number of extensions of the working set
    steps: int  # maximum number of SLSQP steps
    tolerance: float  # tolerance of the volume, for points scaled to size 1


THOROUGH, ROUGH = Effort(3, 8, 60, 1e-7), Effort(1, 2, 12, 1e-3)

Triangles = Float[np.ndarray, "F 3 3"]
Points = Float[np.ndarray, "P 3"]
Vector = Float[np.ndarray, "3"]


class Capsule(NamedTuple):
    """All points within `radius` [m] of the segment from p to q [m]."""

    p: Vector
    q: Vector
    radius: float

    @classmethod
    def along_z(cls, T: Float[np.ndarray, "4 4"], radius: float, half: float) -> "Capsule":
        """Return the capsule about the z axis of a frame T, half its axis on each side of the origin [m]."""
        reach = half * T[:3, 2]
        return cls(T[:3, 3] + reach, T[:3, 3] - reach, float(radius))

    @classmethod
    def of_geom(cls, model: mujoco.MjModel, geom: int, T: Float[np.ndarray, "4 4"]) -> "Capsule":
        """Return a capsule or a sphere of a model, in the frame in which its body has the pose T."""
        radius, half, _ = model.geom_size[geom]
        T_geom = T @ frame(model.geom_pos[geom], model.geom_quat[geom])
        return cls.along_z(T_geom, radius, half if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0)

    @property
    def volume(self) -> float:
        """Volume [m3]."""
        return _capsule_volume(float(np.linalg.norm(self.q - self.p)), self.radius)

    def depth(self, points: Points) -> Float[np.ndarray, "P"]:
        """Return the depth of points inside the capsule [m]; negative outside."""
        return self.radius - _distance(points, self.p, self.q)


class Cut(NamedTuple):
    """The half-space with normal @ x <= offset [m]."""

    normal: tuple[float, float, float]
    offset: float


class MeshPiece(NamedTuple):
    """A part of a mesh, the capsule about it, and the cuts that produced it, in order."""

    triangles: Triangles
    capsule: Capsule
    cuts: tuple[Cut, ...] = ()


_Marked = tuple[MeshPiece, Bool[np.ndarray, "G"]]  # a piece; True for the points of a grid that are in its capsule


def fit_capsule(points: Points, effort: Effort = THOROUGH) -> Capsule:
    """Return a capsule of nearly minimum volume about all points.

    The search is SLSQP over both ends and the radius, started along the points' principal axes. As few points touch the
    capsule, only a working set of points are constraints; points outside are added to the set. The final radius is
    measured over all points and rounded up, so the capsule encloses all points even if the search fails.

    Args:
        points: The points [m].
        effort: Effort of the search.
    """
    x = hull_corners(points)
    middle, size = (x.max(axis=0) + x.min(axis=0)) / 2, max(float(np.ptp(x, axis=0).max()), TINY)
    unit = (x - middle) / size
    first = sorted(
        (_initial_segment(unit, axis) for axis in principal(unit)), key=lambda z: _capsule_volume(2 * _half(z), z[6])
    )
    ends = [_minimum_capsule(unit, z, effort)[:6].reshape(2, 3) for z in first[: effort.starts]]
    return min((around(x, *(middle + size * pair)) for pair in ends), key=lambda capsule: capsule.volume)


def cover_with_capsules(triangles: Triangles, most: int = MOST, more: int = 0) -> list[MeshPiece]:
    """Split a mesh into at most `most` pieces whose capsules enclose every triangle.

    A piece is added as long as the best plane cut saves a share of WORTH of the volume of the capsules' union. Up to
    `more` pieces are then added to cut hollows, which the pieces' convex hulls would fill.

    Args:
        triangles: The mesh [m].
        most: Maximum number of pieces, without those for hollows.
        more: Maximum number of pieces for hollows.
    """
    whole = fit_capsule(triangles.reshape(-1, 3))
    grid = _grid(whole)

    def marked(piece: MeshPiece) -> _Marked:
        return piece, piece.capsule.depth(grid) >= 0

    pieces = [marked(MeshPiece(triangles, whole))]
    while len(pieces) < most and whole.volume > SNUG * hull_volume(triangles.reshape(-1, 3)):
        tried = [
            pieces[:k] + [marked(half) for half in halves] + pieces[k + 1 :]
            for k, (piece, _) in enumerate(pieces)
            for halves in _splits(piece)
        ]
        best = min(tried, key=_filled, default=pieces)
        if _filled(best) > (1 - WORTH) * _filled(pieces):
            break
        pieces = best
    parts = _without_hollows([piece for piece, _ in pieces], more)
    return [piece._replace(capsule=fit_capsule(piece.triangles.reshape(-1, 3))) for piece in parts]


def _without_hollows(pieces: list[MeshPiece], more: int) -> list[MeshPiece]:
    """Cut pieces into at most `more` additional ones, as long as a cut saves a share of HOLLOW of all hulls' volume."""
    hulls = list(map(_hull_volume, pieces))
    least = HOLLOW * sum(hulls)
    for _ in range(more):
        tried = [(k, halves) for k, piece in enumerate(pieces) for halves in _cuts(piece)]
        saved = [hulls[k] - sum(map(_hull_volume, halves)) for k, halves in tried]
        if max(saved, default=0.0) < least:
            break
        k, halves = tried[int(np.argmax(saved))]
        pieces[k : k + 1], hulls[k : k + 1] = halves, map(_hull_volume, halves)
    return pieces


def _hull_volume(piece: MeshPiece) -> float:
    return hull_volume(piece.triangles.reshape(-1, 3))


def hull_volume(points: Points) -> float:
    """Return the volume of the convex hull of points [m3]; 0 if they are coplanar."""
    try:
        return float(scipy.spatial.ConvexHull(points).volume)
    except (scipy.spatial.QhullError, ValueError):
        return 0.0


def clip(triangles: Triangles, cut: Cut) -> Float[np.ndarray, "G 3 3"]:
    """Clip triangles to a half-space [m]; the result is triangles again."""
    normal, offset = np.array(cut.normal), cut.offset
    height = triangles @ normal - offset
    inside = height <= 0
    count = inside.sum(axis=1)
    one, two = ((triangles[count == k], height[count == k], inside[count == k]) for k in (1, 2))
    (a, _, _), ab, ac = _crossings(*one, alone=True)
    (_, e, f), de, df = _crossings(*two, alone=False)
    parts = [np.stack(corners, axis=1) for corners in ((a, ab, ac), (de, e, f), (de, f, df))]
    return np.concatenate([triangles[count == 3], *parts])


def _crossings(triangles: Triangles, height: Float[np.ndarray, "F 3"], inside: Bool[np.ndarray, "F 3"], alone: bool):
    """Return the corners of triangles that a plane intersects, and the intersections of two edges with the plane.

    The first corner is the one that is alone on its side of the plane; the two edges start at this corner.
    """
    rows, first = np.arange(len(triangles))[:, None], np.argmax(inside == alone, axis=1)
    turned = (first[:, None] + [0, 1, 2]) % 3
    (a, b, c), (u, v, w) = triangles[rows, turned].swapaxes(0, 1), height[rows, turned].T
    return (a, b, c), a + (u / (u - v))[:, None] * (b - a), a + (u / (u - w))[:, None] * (c - a)


def hull_corners(points: Points) -> Float[np.ndarray, "V 3"]:
    """Return the vertices of the convex hull of points [m]; all points if they are coplanar."""
    try:
        return points[scipy.spatial.ConvexHull(points).vertices]
    except (scipy.spatial.QhullError, ValueError):
        return np.unique(points, axis=0)


def _splits(piece: MeshPiece) -> Iterator[list[MeshPiece]]:
    """Yield splits of a piece into two halves, each with a roughly fitted capsule."""
    for halves in _cuts(piece):
        yield [half._replace(capsule=fit_capsule(half.triangles.reshape(-1, 3), ROUGH)) for half in halves]


def _cuts(piece: MeshPiece) -> Iterator[list[MeshPiece]]:
    """Yield the halves of a piece on both sides of planes normal to the frame's axes and its principal axes."""
    corners = hull_corners(piece.triangles.reshape(-1, 3))
    for axis in (*np.eye(3), *principal(corners)):
        for share in CUTS:
            if len(halves := slabs(piece, axis, corners @ axis, (share,))) == 2:
                yield halves


def slabs(piece: MeshPiece, axis: Vector, along: Float[np.ndarray, "n"], shares: tuple[float, ...]) -> list[MeshPiece]:
    """Cut a piece normal to an axis, at shares of its extent; no capsules are fitted to the parts.

    Args:
        piece: The piece.
        axis: The axis, a unit vector.
        along: Positions of the piece's points along the axis [m].
        shares: The shares, increasing.
    """
    parts, rest = [], piece
    for share in shares:
        offset = float(along.min() + share * np.ptp(along))
        below, above = Cut(tuple(axis.tolist()), offset), Cut(tuple((-axis).tolist()), -offset)
        parts.append(rest._replace(triangles=clip(rest.triangles, below), cuts=(*rest.cuts, below)))
        rest = rest._replace(triangles=clip(rest.triangles, above), cuts=(*rest.cuts, above))
    return [each for each in (*parts, rest) if len(each.triangles)]


def _grid(capsule: Capsule) -> Points:
    low, high = np.minimum(capsule.p, capsule.q) - capsule.radius, np.maximum(capsule.p, capsule.q) + capsule.radius
    sides = [np.linspace(a, b, FINE) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)


def _filled(pieces: list[_Marked]) -> int:
    """Return the number of grid points in the union of the capsules."""
    return int(np.any([inside for _, inside in pieces], axis=0).sum())


def principal(points: Points) -> Float[np.ndarray, "3 3"]:
    """Return the principal directions in rows, by increasing variance."""
    apart = points - points.mean(axis=0)
    return np.linalg.eigh(apart.T @ apart)[1].T


def _capsule_volume(length: float, radius: float) -> float:
    return float(np.pi * radius**2 * (length + 4 / 3 * radius))


def _to_segment(x: Points, p: Vector, q: Vector) -> tuple[Points, Float[np.ndarray, "P"]]:
    """Return the vectors from a segment's closest points to points x, and the closest points' shares of its length."""
    ahead = q - p
    length2 = float(ahead @ ahead)
    share = np.clip((x - p) @ ahead / length2, 0, 1) if length2 > 0 else np.zeros(len(x))
    return x - p - share[:, None] * ahead, share


def _distance(x: Points, p: Vector, q: Vector) -> Float[np.ndarray, "P"]:
    """Return the points' distances from a segment."""
    return np.linalg.norm(_to_segment(x, p, q)[0], axis=1)


def around(points: Points, p: Vector, q: Vector) -> Capsule:
    """Return the thinnest capsule about all points whose ends are p and q, rounded to GRID_M."""
    p, q = (np.round(end / GRID_M) * GRID_M for end in (p, q))
    widest = max(float(_distance(points, p, q).max()), THINNEST_M)
    return Capsule(p, q, float(np.ceil(widest / GRID_M + 1e-3) * GRID_M))


# The search. z contains both ends of the axis and the radius.


def _initial_segment(x: Points, axis: Vector) -> Float[np.ndarray, "7"]:
    """Return an initial z: a segment along an axis, centred in points of size 1, and a radius."""
    along = x @ axis
    wide = float(np.linalg.norm(x - np.outer(along, axis), axis=1).max())
    reach = max(float(np.ptp(along)) / 2 - wide, 0.0)
    return np.concatenate([-reach * axis, reach * axis, [wide]])


def _minimum_capsule(x: Points, z: Float[np.ndarray, "7"], effort: Effort) -> Float[np.ndarray, "7"]:
    """Minimise the volume of the capsule about all points, scaled to size 1, starting from z."""
    work = np.unique(np.argmax(x @ FIRST_DIRECTIONS.T, axis=0))
    for _ in range(effort.rounds):
        z = _minimise_volume(x[work], z, effort)
        distance = _distance(x, z[:3], z[3:6])
        outside = np.flatnonzero(distance > z[6] + 1e-6)
        if not outside.size:
            break
        work = np.union1d(work, outside[np.argsort(distance[outside])[-MORE:]])
    return z


def _half(z: Float[np.ndarray, "7"]) -> float:
    """Return half the length of the axis, regularised to be differentiable at 0."""
    ahead = z[3:6] - z[:3]
    return float(np.sqrt(ahead @ ahead + 1e-12)) / 2


def _minimise_volume(x: Points, z: Float[np.ndarray, "7"], effort: Effort) -> Float[np.ndarray, "7"]:
    """Minimise the volume of the capsule about the working set x, starting from z; return z if the search fails."""

    def slope(z):
        pull = np.pi * z[6] ** 2 * (z[3:6] - z[:3]) / (2 * _half(z))
        return np.concatenate([-pull, pull, [4 * np.pi * z[6] * (_half(z) + z[6])]])

    def depth(z):
        return z[6] - _distance(x, z[:3], z[3:6])

    def depth_slopes(z):
        away, share = _to_segment(x, z[:3], z[3:6])
        away /= np.maximum(np.linalg.norm(away, axis=1), TINY)[:, None]
        return np.column_stack([(1 - share)[:, None] * away, share[:, None] * away, np.ones(len(x))])

    held = {"type": "ineq", "fun": depth, "jac": depth_slopes}
    least = partial(
        scipy.optimize.minimize,
        lambda z: _capsule_volume(2 * _half(z), z[6]),
        jac=slope,
        constraints=held,
        method="SLSQP",
    )
    found = least(z, options={"maxiter": effort.steps, "ftol": effort.tolerance}).x
    return found if np.isfinite(found).all() else z
