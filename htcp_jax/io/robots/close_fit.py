"""Capsules close to a mesh: as in `capsule_fit`, with more kinds of cuts, until they are within a tolerance of it.

Several capsules side by side approximate a drum or a box better than one capsule, but no single cut into two may
improve the fit. Cuts into two to five parts are therefore tried at once. FCL computes the distances of the capsules
from the mesh, at points on the capsules' surfaces.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import fcl
import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.io.robots import capsule_fit
from htcp_jax.io.robots.capsule_fit import (
    CUTS,
    THINNEST_M,
    Capsule,
    MeshPiece,
    Points,
    Triangles,
    Vector,
    fit_capsule,
)

TOLERANCES_M = 1e-3, 0.1  # minimum and maximum of a valid tolerance
MOST = 5  # maximum number of capsules of a body without a tolerance
MOST_CLOSE = 20  # maximum number of capsules of a body with a tolerance
BEST = 8  # number of cuts, the best by rough fits, that are compared by thorough fits
WITHIN = 0.95  # share of the capsules' surface that must be within the tolerance
WORTH, WORTH_CLOSE = 0.02, 0.005  # share of the union's volume that one more capsule must save
WORST = 3  # number of capsules for which cuts are tried, those with the largest area beyond the tolerance
SLABS = ((1 / 3, 2 / 3), (0.2, 0.8), (0.15, 0.5), (0.5, 0.85)), ((0.25, 0.5, 0.75),), ((0.2, 0.4, 0.6, 0.8),)
GRIDS = [each for each in itertools.product(range(1, 5), repeat=3) if sorted(each)[1] > 1]  # numbers of cells per axis
ALIGNED = 0.99  # cosine of the angle between two axes above which they are treated as one
SAMPLES = 300  # points on a capsule's surface
FINE = 20  # points per side of the grid on which volumes are compared
GOOD = capsule_fit.Effort(2, 6, 40, 1e-5)
DIRECTIONS = np.concatenate([capsule_fit.FIRST_DIRECTIONS, np.random.default_rng(0).normal(size=(60, 3))])
WIDER = np.array([1, 1.05, 1.12, 1.25, 1.5])
GOLDEN = np.pi * (3 - 5**0.5)  # [rad]
PROBE_M = 1e-9  # radius of the sphere that represents a point


@dataclass(frozen=True, eq=False)
class _Part:
    """A piece of a mesh, with the points of a grid that are in its capsule; it is equal to itself only."""

    piece: MeshPiece
    inside: Bool[np.ndarray, "G"]
    is_thorough: bool = False  # True if the capsule is the smallest one that was found


def cover_closely(triangles: Triangles, most: int = MOST, tolerance_m: float | None = None) -> list[MeshPiece]:
    """Split a mesh into at most `most` pieces whose capsules enclose every triangle.

    Args:
        triangles: The mesh [m].
        most: Maximum number of pieces.
        tolerance_m: Pieces are added until WITHIN of the surface of the capsules' union is within this distance of the
            mesh; None: as long as one more saves WORTH of the volume of this union.
    """
    whole = MeshPiece(triangles, fit_capsule(triangles.reshape(-1, 3)))
    grid = volume_grid([whole.capsule], FINE)[0]
    surface = None if tolerance_m is None else _Surface(triangles)

    def part(piece: MeshPiece, is_thorough: bool = False) -> _Part:
        return _Part(piece, piece.capsule.depth(grid) >= 0, is_thorough)

    @cache
    def fitted(rough: _Part) -> _Part:
        return rough if rough.is_thorough else part(_fitted(rough.piece), is_thorough=True)

    @cache
    def splits(known: _Part) -> list[list[_Part]]:
        return [[part(half) for half in halves] for halves in _splits(known.piece, most - len(parts))]

    parts = [part(whole, is_thorough=True)]

    def cost(parts: list[_Part]) -> float:
        filled = np.any([each.inside for each in parts], axis=0).sum()
        return float(np.log(max(filled, 1))) + (WORTH if surface is None else WORTH_CLOSE) * len(parts)

    def beyond(parts: list[_Part]) -> float:
        return float(surface.areas([each.piece.capsule for each in parts], tolerance_m)[1].sum())

    while len(parts) < most:
        some = range(len(parts))
        if surface is not None:
            bare, far = surface.areas([each.piece.capsule for each in parts], tolerance_m)
            if far.sum() <= (1 - WITHIN) * bare.sum():
                break
            some = np.argsort(-far)[:WORST]
        tried = [parts[:k] + halves + parts[k + 1 :] for k in some for halves in splits(parts[k])]
        tried = sorted((each for each in tried if len(each) <= most), key=cost)[:BEST]
        best = min((list(map(fitted, found)) for found in tried), key=beyond if surface else cost, default=parts)
        if best is parts or (surface is None and cost(best) >= cost(parts)):
            break
        parts = best
    return [each.piece for each in parts]


def union_volume(capsules: list[Capsule]) -> float:
    """Return the volume of the union of capsules [m3], by a grid."""
    grid, cell = volume_grid(capsules, 2 * FINE)
    return cell * int(np.any([capsule.depth(grid) >= 0 for capsule in capsules], axis=0).sum())


def volume_grid(capsules: list[Capsule], count: int) -> tuple[Points, float]:
    """Return the middles of the cells of a grid over capsules [m], `count` on each side, and a cell's volume [m3]."""
    low = np.min([np.minimum(each.p, each.q) - each.radius for each in capsules], axis=0)
    high = np.max([np.maximum(each.p, each.q) + each.radius for each in capsules], axis=0)
    sides = [a + (b - a) * (np.arange(count) + 0.5) / count for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3), float(np.prod((high - low) / count))


def excesses_m(triangles: Triangles, capsules: list[Capsule]) -> list[float]:
    """Return the largest distance from a mesh of each capsule's surface outside of the other capsules [m]."""
    surface = _Surface(triangles)
    away = [surface.distances_m(each)[bare] for each, bare in zip(capsules, _bare(capsules), strict=True)]
    return [float(each.max(initial=0.0)) for each in away]


def _bare(capsules: list[Capsule]) -> Iterator[Bool[np.ndarray, "n"]]:
    """Yield a mask for each capsule: True for those of its `surface_points` that are in no other capsule."""
    for k, capsule in enumerate(capsules):
        points = surface_points(capsule)
        depth = [each.depth(points) for each in capsules[:k] + capsules[k + 1 :]]
        yield np.max(depth, axis=0, initial=-np.inf) <= 0 if depth else np.ones(len(points), bool)


class _Surface:
    """Distances of capsules' surfaces from a mesh."""

    def __init__(self, triangles: Triangles):
        self._mesh = mesh_object(triangles)
        self._known: dict[tuple, Float[np.ndarray, "n"]] = {}

    def areas(
        self, capsules: list[Capsule], tolerance_m: float
    ) -> tuple[Float[np.ndarray, "C"], Float[np.ndarray, "C"]]:
        """Return each capsule's area outside of the other capsules, and the part of it beyond the tolerance [m2]."""
        areas = np.array([2 * np.pi * r * (np.linalg.norm(q - p) + 2 * r) / SAMPLES for p, q, r in capsules])
        bare = np.stack(list(_bare(capsules)))
        far = bare & (np.stack([self.distances_m(each) for each in capsules]) > tolerance_m)
        return areas * bare.sum(axis=1), areas * far.sum(axis=1)

    def distances_m(self, capsule: Capsule) -> Float[np.ndarray, "n"]:
        """Return the distances of a capsule's `surface_points` from the mesh [m]."""
        key = (*capsule.p, *capsule.q, capsule.radius)
        if key not in self._known:
            self._known[key] = np.array([point_distance_m(self._mesh, point) for point in surface_points(capsule)])
        return self._known[key]


def mesh_object(triangles: Triangles) -> fcl.CollisionObject:
    """Return a mesh as an object of FCL, at the origin."""
    corners, faces = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    mesh = fcl.BVHModel()
    mesh.beginModel(len(triangles), len(corners))
    mesh.addSubModel(corners, faces.reshape(-1, 3))
    mesh.endModel()
    return fcl.CollisionObject(mesh)


def point_distance_m(shape: fcl.CollisionObject, point: Vector) -> float:
    """Return the distance of a point from an object of FCL [m]."""
    probe = fcl.CollisionObject(fcl.Sphere(PROBE_M), fcl.Transform(np.eye(3), point))
    return fcl.distance(shape, probe) + PROBE_M


def surface_points(capsule: Capsule) -> Float[np.ndarray, "n 3"]:
    """Return SAMPLES points on a capsule's surface [m], each for an equal area, in equal steps along the axis."""
    along = capsule.q - capsule.p
    length = float(np.linalg.norm(along))
    axis = along / length if length > 0 else np.array([0.0, 0.0, 1.0])
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    r = capsule.radius
    height = -r + (np.arange(SAMPLES) + 0.5) / SAMPLES * (length + 2 * r)
    wide = np.sqrt(np.maximum(r**2 - (height - np.clip(height, 0, length)) ** 2, 0.0))
    turn = GOLDEN * np.arange(SAMPLES)
    around = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(axis, side)
    return capsule.p + height[:, None] * axis + wide[:, None] * around


def _fitted(piece: MeshPiece) -> MeshPiece:
    return piece._replace(capsule=fit_capsule(piece.triangles.reshape(-1, 3), GOOD))


def _splits(piece: MeshPiece, more: int) -> Iterator[list[MeshPiece]]:
    """Yield splits of a piece into up to `more` + 1 parts, each with a roughly fitted capsule.

    The parts are slabs normal to an axis, two slabs of which one is cut again, or the cells of a grid.
    """
    corners = np.unique(piece.triangles.reshape(-1, 3), axis=0)
    principal = [axis for axis in capsule_fit.principal(corners) if np.abs(axis).max() < ALIGNED]
    axes = [*np.eye(3), *principal]
    for one in axes:
        for share in CUTS:
            yield from _rough(_slabs(piece, one, (share,)))
        for count, kinds in enumerate(SLABS, 2):
            for shares in kinds if more >= count else ():
                yield from _rough(_slabs(piece, one, shares))
        for other in (each for each in axes if abs(each @ one) < 1 - ALIGNED):
            halves = _slabs(piece, one, (0.5,))
            if len(halves) == 2 and more >= 2:
                for k in (0, 1):
                    yield from _rough([halves[1 - k], *_slabs(halves[k], other, (0.5,))])
    for frame in (np.eye(3), *([np.stack(principal)] if len(principal) == 3 else [])):
        for counts in (each for each in GRIDS if math.prod(each) <= more + 1):
            cells = [piece]
            for axis, count in zip(frame, counts, strict=True):
                cells = [cell for each in cells for cell in _slabs(each, axis, tuple(np.arange(1, count) / count))]
            yield from _rough(cells)


def _slabs(piece: MeshPiece, axis: Vector, shares: tuple[float, ...]) -> list[MeshPiece]:
    return capsule_fit.slabs(piece, axis, piece.triangles.reshape(-1, 3) @ axis, shares)


def _rough_capsule(points: Points) -> Capsule:
    """Return a small capsule about all points, for comparisons."""
    return capsule_fit.around(points, *next(_axes_about(points)))


def _axes_about(points: Points) -> Iterator[tuple[Vector, Vector]]:
    """Yield the ends of capsules about points, along the principal axes of their extremes, the smallest capsule first.

    The axis passes through the centre of a circle that encloses the points' projection along the axis. The radius is
    one of WIDER times the circle's, and the ends are as close together as the points allow.
    """
    x = points[np.unique(np.argmax(points @ DIRECTIONS.T, axis=0))]
    axes = capsule_fit.principal(x)
    height = x @ axes.T  # (points, axes)
    flat = x[:, None] - height[..., None] * axes
    middle = (flat.max(axis=0) + flat.min(axis=0)) / 2
    for step in range(2, 12):  # M. Badoiu, K. Clarkson: Smaller core-sets for balls. SODA 2003
        farthest = np.argmax(np.sum((flat - middle) ** 2, axis=2), axis=0)
        middle = middle + (flat[farthest, np.arange(len(axes))] - middle) / step
    off = np.sum((flat - middle) ** 2, axis=2)
    radius = np.maximum(np.sqrt(off.max(axis=0)), THINNEST_M) * WIDER[:, None]  # (radii, axes)
    reach = np.sqrt(np.maximum(radius[:, None] ** 2 - off, 0.0))
    low, high = (height + reach).min(axis=1), (height - reach).max(axis=1)
    ball = low > high
    low, high = np.where(ball, (low + high) / 2, low), np.where(ball, (low + high) / 2, high)
    for number in np.argsort(radius**2 * (high - low + 4 / 3 * radius), axis=None):
        k, a = np.unravel_index(number, radius.shape)
        yield middle[a] + low[k, a] * axes[a], middle[a] + high[k, a] * axes[a]


def _rough(parts: list[MeshPiece]) -> Iterator[list[MeshPiece]]:
    if len(parts) > 1:
        yield [each._replace(capsule=_rough_capsule(each.triangles.reshape(-1, 3))) for each in parts]
