"""Capsules that hold a mesh: the smallest one about its points, or several about the pieces that planes cut it into.

A capsule is convex: it holds a triangle when it holds the corners. A plane cuts every triangle that it meets in two, so
that each piece lies on one side, whole in the capsule of that side; none is left out, however many cuts there are. What
a closed mesh encloses is held too: its part on one side of a plane lies in the convex hull of the triangles there.
"""

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize
from scipy.spatial import ConvexHull, QhullError

GRID_M = 1e-5  # ends and radius are multiples of it, the radius rounded up
THINNEST_M = 3e-3  # radius: a thinner body asks for denser points of the workpiece than any task is worth
CUTS = 0.2, 0.35, 0.5, 0.65, 0.8  # shares of a piece's extent at which it is cut on trial
WORTH = 0.15  # a cut must save this share of the volume
SNUG = 1.5  # a capsule with no more than so many times the hull's volume is not cut
MOST = 3  # capsules a body
MORE = 20  # points that join the working set in each round
FINE = 28  # points a side of the grid that volumes are compared on
TINY = 1e-9  # of a mesh's size: less is nothing
LOOKS = np.stack(np.meshgrid(*3 * [[-1.0, 0, 1]]), axis=-1).reshape(-1, 3)  # where first points of a working set lie


class Effort(NamedTuple):
    """How long the smallest capsule is looked for."""

    starts: int  # of the principal axes, the best first
    rounds: int  # of the working set
    steps: int  # of SLSQP
    tolerance: float  # of the volume of points of size 1


THOROUGH, ROUGH = Effort(3, 8, 60, 1e-7), Effort(1, 2, 12, 1e-3)

Triangles = Float[np.ndarray, "F 3 3"]
Points = Float[np.ndarray, "P 3"]
Vector = Float[np.ndarray, "3"]


class Capsule(NamedTuple):
    """All points within `radius` [m] of the segment from p to q [m]."""

    p: Vector
    q: Vector
    radius: float

    @property
    def volume(self) -> float:
        """[m3]"""
        return _volume(float(np.linalg.norm(self.q - self.p)), self.radius)

    def depth(self, points: Points) -> Float[np.ndarray, "P"]:
        """How deep inside the capsule points lie [m]; negative outside."""
        return self.radius - _from_segment(points, self.p, self.q)[0]


class Cut(NamedTuple):
    """The half-space with normal @ x <= offset [m]."""

    normal: tuple[float, float, float]
    offset: float


class Piece(NamedTuple):
    """Part of a mesh, the capsule about it, and the cuts that leave it of the mesh, in their order."""

    triangles: Triangles
    capsule: Capsule
    cuts: tuple[Cut, ...] = ()


def fit_capsule(points: Points, effort: Effort = THOROUGH) -> Capsule:
    """A capsule about all points [m], the smallest by volume or nearly so: least volume over both ends and the radius
    by SLSQP, along the points' principal axes first.

    Few points touch the capsule, so only a working set of them are constraints; others join it where they stick out.
    The radius is measured at last, over all points, and rounded up: it holds them whatever the search did.
    """
    x = _corners(points)
    middle, size = (x.max(axis=0) + x.min(axis=0)) / 2, max(float(np.ptp(x, axis=0).max()), TINY)
    unit = (x - middle) / size
    first = sorted((_along(unit, axis) for axis in _principal(unit)), key=lambda z: _volume(2 * _half(z), z[6]))
    ends = [_least(unit, z, effort)[:6].reshape(2, 3) for z in first[: effort.starts]]
    return min((_around(x, *(middle + size * pair)) for pair in ends), key=lambda capsule: capsule.volume)


def cover(triangles: Triangles, most: int = MOST) -> list[Piece]:
    """At most `most` pieces whose capsules hold every triangle [m]: one, and another as long as the best cut by a plane
    saves WORTH of the volume that the capsules fill together."""
    whole = fit_capsule(triangles.reshape(-1, 3))
    pieces, filled = [Piece(triangles, whole)], partial(_filled, _grid(whole))
    while len(pieces) < most and whole.volume > SNUG * hull_volume(triangles.reshape(-1, 3)):
        tried = [pieces[:k] + halves + pieces[k + 1 :] for k, piece in enumerate(pieces) for halves in _halves(piece)]
        best = min(tried, key=filled, default=pieces)
        if filled(best) > (1 - WORTH) * filled(pieces):
            break
        pieces = best
    return [piece._replace(capsule=fit_capsule(piece.triangles.reshape(-1, 3))) for piece in pieces]


def hull_volume(points: Points) -> float:
    """Volume of the convex hull of points [m3]; 0 where they are flat."""
    try:
        return float(ConvexHull(points).volume)
    except (QhullError, ValueError):
        return 0.0


def clip(triangles: Triangles, cut: Cut) -> Float[np.ndarray, "G 3 3"]:
    """The triangles' part in the half-space, as triangles."""
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
    """Corners from the one that is alone on its side, and where the two edges from there cross the plane."""
    rows, first = np.arange(len(triangles))[:, None], np.argmax(inside == alone, axis=1)
    turned = (first[:, None] + [0, 1, 2]) % 3
    (a, b, c), (u, v, w) = triangles[rows, turned].swapaxes(0, 1), height[rows, turned].T
    return (a, b, c), a + (u / (u - v))[:, None] * (b - a), a + (u / (u - w))[:, None] * (c - a)


def _halves(piece: Piece) -> Iterator[list[Piece]]:
    """A piece in two, cut across the frame's and its principal axes; each half with a rough fit."""
    corners = _corners(piece.triangles.reshape(-1, 3))
    for axis in (*np.eye(3), *_principal(corners)):
        along = corners @ axis
        for share in CUTS:
            offset = float(along.min() + share * np.ptp(along))
            cuts = Cut(tuple(axis.tolist()), offset), Cut(tuple((-axis).tolist()), -offset)
            halves = [clip(piece.triangles, cut) for cut in cuts]
            if all(map(len, halves)):
                fits = [fit_capsule(half.reshape(-1, 3), ROUGH) for half in halves]
                yield [Piece(*each, (*piece.cuts, cut)) for *each, cut in zip(halves, fits, cuts, strict=True)]


def _grid(capsule: Capsule) -> Points:
    low, high = np.minimum(capsule.p, capsule.q) - capsule.radius, np.maximum(capsule.p, capsule.q) + capsule.radius
    sides = [np.linspace(a, b, FINE) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)


def _filled(grid: Points, pieces: list[Piece]) -> int:
    """How many points of a grid lie in any of the capsules."""
    return int(np.any([piece.capsule.depth(grid) >= 0 for piece in pieces], axis=0).sum())


def _corners(points: Points) -> Float[np.ndarray, "V 3"]:
    """The corners of the convex hull; of flat points all of them."""
    try:
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        return np.unique(points, axis=0)


def _principal(points: Points) -> Float[np.ndarray, "3 3"]:
    """Directions of least to greatest spread, in rows."""
    apart = points - points.mean(axis=0)
    return np.linalg.eigh(apart.T @ apart)[1].T


def _volume(length: float, radius: float) -> float:
    return float(np.pi * radius**2 * (length + 4 / 3 * radius))


def _from_segment(x: Points, p: Vector, q: Vector) -> tuple[Float[np.ndarray, "P"], Points, Float[np.ndarray, "P"]]:
    """Distances of points from a segment, directions away from it, and shares of it where they are nearest."""
    ahead = q - p
    length2 = float(ahead @ ahead)
    share = np.clip((x - p) @ ahead / length2, 0, 1) if length2 > 0 else np.zeros(len(x))
    away = x - p - share[:, None] * ahead
    distance = np.linalg.norm(away, axis=1)
    return distance, away / np.maximum(distance, TINY)[:, None], share


def _around(points: Points, p: Vector, q: Vector) -> Capsule:
    """The thinnest capsule on the grid of GRID_M that holds all points, its ends the nearest there to p and q."""
    p, q = (np.round(end / GRID_M) * GRID_M for end in (p, q))
    widest = max(float(_from_segment(points, p, q)[0].max()), THINNEST_M)
    return Capsule(p, q, float(np.ceil(widest / GRID_M + 1e-3) * GRID_M))


# The search; z is both ends of the axis and the radius.


def _along(x: Points, axis: Vector) -> Float[np.ndarray, "7"]:
    """A segment along an axis through the middle, about as long as a capsule about points of size 1 needs."""
    along = x @ axis
    wide = float(np.linalg.norm(x - np.outer(along, axis), axis=1).max())
    reach = max(float(np.ptp(along)) / 2 - wide, 0.0)
    return np.concatenate([-reach * axis, reach * axis, [wide]])


def _least(x: Points, z: Float[np.ndarray, "7"], effort: Effort) -> Float[np.ndarray, "7"]:
    """A small capsule about points of size 1, sought from z."""
    work = np.unique(np.argmax(x @ LOOKS.T, axis=0))
    for _ in range(effort.rounds):
        z = _solve(x[work], z, effort)
        distance = _from_segment(x, z[:3], z[3:6])[0]
        outside = np.flatnonzero(distance > z[6] + 1e-6)
        if not outside.size:
            break
        work = np.union1d(work, outside[np.argsort(distance[outside])[-MORE:]])
    return z


def _half(z: Float[np.ndarray, "7"]) -> float:
    """Half the length of the axis, with so little added that it has a slope at 0."""
    ahead = z[3:6] - z[:3]
    return float(np.sqrt(ahead @ ahead + 1e-12)) / 2


def _solve(x: Points, z: Float[np.ndarray, "7"], effort: Effort) -> Float[np.ndarray, "7"]:
    """The least volume that holds x, from z; z itself where the search fails."""

    def slope(z):
        pull = np.pi * z[6] ** 2 * (z[3:6] - z[:3]) / (2 * _half(z))
        return np.concatenate([-pull, pull, [4 * np.pi * z[6] * (_half(z) + z[6])]])

    def depth(z):
        return z[6] - _from_segment(x, z[:3], z[3:6])[0]

    def depth_slopes(z):
        _, away, share = _from_segment(x, z[:3], z[3:6])
        return np.column_stack([(1 - share)[:, None] * away, share[:, None] * away, np.ones(len(x))])

    held = {"type": "ineq", "fun": depth, "jac": depth_slopes}
    least = partial(minimize, lambda z: _volume(2 * _half(z), z[6]), jac=slope, constraints=held, method="SLSQP")
    found = least(z, options={"maxiter": effort.steps, "ftol": effort.tolerance}).x
    return found if np.isfinite(found).all() else z
