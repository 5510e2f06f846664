"""Triangles that cover the polygons of mesh files: fans, and ear clipping where a fan would leave the polygon.

Each polygon is seen along its mean normal (Newell's). Triangles that all turn as the polygon does cover each point as
often as the polygon's boundary winds around it, as their boundaries add up to it. So a fan without a triangle of the
other sense is exact for a simple polygon, and is used unchanged; ear clipping looks for such triangles elsewhere. If
there are none, the boundary crosses itself, and the polygon is refused. A polygon whose corners do not lie in a plane
is divided as its picture along the mean normal; a Note names it.

G. H. Meisters: Polygons have ears. The American Mathematical Monthly 82, 1975. Libraries for it are further
dependencies, for few lines.
"""

import warnings
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.errors import InputError, Note

TINY = 1e-6  # share of a polygon's size: triangles of a smaller height count as a line
ZERO = 1e-15  # share of a polygon's squared size: smaller areas are 0
UNEVEN = 0.05  # share of a polygon's size: a polygon with a corner farther from its mean plane is named
MOST_TURNS = 64  # corners up to which a fan from each corner is tried before ear clipping
NO_EAR = 3  # rank of a corner that is not clipped, see `_ranks`
MOST_FAILED = 4  # maximum number of failed tests for ears, times the number of corners
MOST_CORNERS = 6_000  # maximum number of corners of a polygon that needs ear clipping, which takes seconds

Vertices = Float[np.ndarray, "V 3"]
Indices = Int[np.ndarray, "C"]


class Triangulation(NamedTuple):
    """Triangles of polygons, ordered by polygon."""

    corners: Int[np.ndarray, "F 3"]  # indices of vertices
    polygon: Int[np.ndarray, "F"]  # index of each triangle's polygon
    rank: Int[np.ndarray, "F"]  # number of each triangle in its polygon, from 0


def triangulate(vertices: Vertices, corners: Indices, counts: Indices, source: str) -> Triangulation:
    """Divide polygons into triangles that cover them only.

    Args:
        vertices: Coordinates of the vertices, in any unit.
        corners: Indices of the corners of all polygons, one polygon after the other.
        counts: Number of corners of each polygon.
        source: The file, for messages.

    Raises:
        InputError: For a polygon with fewer than 3 corners, for an index without vertex, and for a polygon that crosses
            itself.
    """
    check_faces(len(vertices), corners, counts, source)
    first, uneven = np.cumsum(counts) - counts, 0
    found = [Triangulation(np.empty((0, 3), int), np.empty(0, int), np.empty(0, int))]
    for n in np.unique(counts):
        rows = np.flatnonzero(counts == n)
        own = corners[first[rows][:, None] + np.arange(n)]
        places = np.broadcast_to(_fan(n), (len(rows), n - 2, 3)).copy()
        if n > 3:
            seen = vertices[own]
            uneven += _count_uneven(seen)
            _correct(places, seen, rows, source)
        flat = np.take_along_axis(own, places.reshape(len(rows), -1), axis=1).reshape(-1, 3)
        found.append(Triangulation(flat, np.repeat(rows, n - 2), np.tile(np.arange(n - 2), len(rows))))
    if uneven:
        text = f"{uneven} of {len(counts)} polygons are not flat; they are divided into triangles, which may differ"
        warnings.warn(f"{source}: {text} from those of other programs", Note, stacklevel=2)
    joined = Triangulation(*map(np.concatenate, zip(*found, strict=True)))
    order = np.argsort(joined.polygon, kind="stable")
    return Triangulation(*(each[order] for each in joined))


def rolled_quads(found: Triangulation, counts: Indices) -> Int[np.ndarray, "F 3"]:
    """Return the triangles' corners, those of a quad's second triangle from its second corner on.

    Args:
        found: The triangles.
        counts: Number of corners of each polygon.
    """
    second = (counts[found.polygon] == 4) & (found.rank == 1)
    return np.where(second[:, None], np.roll(found.corners, -1, axis=1), found.corners)


def check_faces(vertices: int, corners: Indices, counts: Indices, source: str) -> None:
    """Check that faces have at least 3 corners, which are vertices of the file.

    Args:
        vertices: Number of vertices.
        corners: Indices of the corners of all faces, one face after the other, from 0.
        counts: Number of corners of each face.
        source: The file, for messages.

    Raises:
        InputError: Otherwise; the message counts faces and vertices from 1.
    """
    if (few := np.flatnonzero(counts < 3)).size:
        raise InputError(f"{source}: face {few[0] + 1} has {counts[few[0]]} corners; at least 3 are needed")
    if (beyond := np.flatnonzero((corners < 0) | (corners >= vertices))).size:
        face, vertex = np.searchsorted(np.cumsum(counts), beyond[0], "right") + 1, corners[beyond[0]] + 1
        raise InputError(f"{source}: damaged: face {face} has vertex {vertex}; the file has {vertices} vertices")


def _fan(n: int) -> Int[np.ndarray, "t 3"]:
    return np.stack([np.zeros(n - 2, int), np.arange(1, n - 1), np.arange(2, n)], axis=1)


def _areas(seen: Float[np.ndarray, "m n 3"], turn: int = 0) -> Float[np.ndarray, "m t 3"]:
    """Return twice the area vectors of the triangles of a fan from corner `turn`."""
    edges = np.roll(seen, -turn, axis=1)[:, 1:] - seen[:, turn, None]
    return np.cross(edges[:, :-1], edges[:, 1:])


def _limits(seen: Float[np.ndarray, "m n 3"], turn: int = 0) -> Float[np.ndarray, "m t"]:
    """Return twice the area up to which each triangle of a fan counts as a line."""
    rolled = np.roll(seen, -turn, axis=1)
    sides = rolled[:, 1:] - rolled[:, :1], rolled[:, 2:] - rolled[:, 1:-1]
    spokes, rims = (np.linalg.norm(side, axis=2) for side in sides)
    return TINY * _sizes(seen)[:, None] * np.maximum(np.maximum(spokes[:, :-1], spokes[:, 1:]), rims)


def _sizes(seen: Float[np.ndarray, "m n 3"]) -> Float[np.ndarray, "m"]:
    return np.linalg.norm(np.ptp(seen, axis=1), axis=1)


def _normals(seen: Float[np.ndarray, "m n 3"]) -> Float[np.ndarray, "m 3"]:
    """Return Newell's unit normals; 0 for a polygon without area."""
    normals = _areas(seen).sum(axis=1)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    none = length <= ZERO * _sizes(seen)[:, None] ** 2
    return np.where(none, 0.0, normals / np.where(none, 1.0, length))


def _count_uneven(seen: Float[np.ndarray, "m n 3"]) -> int:
    heights = np.einsum("mni,mi->mn", seen - seen.mean(axis=1, keepdims=True), _normals(seen))
    return int((np.abs(heights).max(axis=1) > UNEVEN * _sizes(seen)).sum())


def _correct(
    places: Int[np.ndarray, "m t 3"], seen: Float[np.ndarray, "m n 3"], rows: Int[np.ndarray, "m"], source: str
) -> None:
    """Replace the fans in `places` that leave their polygon, in place."""
    n, normals, areas, limits = seen.shape[1], _normals(seen), _areas(seen), _limits(seen)
    turning = normals.any(axis=1)  # the others have no area, or cross themselves
    folded = (np.einsum("mti,mi->mt", areas, normals) < -limits).any(axis=1)
    wrong = np.flatnonzero(np.where(turning, folded, (np.linalg.norm(areas, axis=2) > limits).any(axis=1)))
    for turn in range(1, n if n <= MOST_TURNS else 1):
        if not wrong.size:
            return
        own, signed = seen[wrong], np.einsum("mti,mi->mt", _areas(seen[wrong], turn), normals[wrong])
        right = (signed >= -_limits(own, turn)).all(axis=1) & turning[wrong]
        places[wrong[right]] = (_fan(n) + turn) % n
        wrong = wrong[~right]
    for k in wrong:
        if n > MOST_CORNERS:
            raise InputError(f"{source}: face {rows[k] + 1} has {n} corners; divide it into triangles")
        ears = _ears(_flattened(seen[k], normals[k])) if turning[k] else None
        if ears is None:
            raise InputError(f"{source}: face {rows[k] + 1} crosses itself; divide it into triangles")
        places[k] = ears


def _flattened(corners: Float[np.ndarray, "n 3"], normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "n 2"]:
    """Return the corners of a polygon of size 1, seen against its normal."""
    along = np.eye(3)[np.argmin(np.abs(normal))]
    along = np.cross(along, normal) / np.linalg.norm(np.cross(along, normal))
    seen = (corners - corners[0]) @ np.stack([along, np.cross(normal, along)], axis=1)
    return seen / np.linalg.norm(np.ptp(seen, axis=0))


def _ears(points: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, "t 3"] | None:
    """Clip ears from a counter-clockwise polygon; None if there are not enough. A hole may be joined by a bridge.

    A corner that is no ear is tested again only if a neighbour or what blocks it has been clipped. In a simple polygon
    the latter does not happen, see `_block`; a polygon that needs many more tests than that counts as crossing itself.
    """
    n, points = len(points), np.ascontiguousarray(points.T)
    ring, ears, failed = np.arange(n), [], 0
    before, after = np.roll(ring, 1), np.roll(ring, -1)
    blocks, (ranks, lines) = np.full((2, n), -1), _ranks(points, before, ring, after)
    while len(ring) > 2:
        ear = np.argmin(ranks)
        if ranks[ear] >= NO_EAR or failed > MOST_FAILED * n:
            return None
        a, c = before[ear], after[ear]
        if not lines[ear] and (block := _block(points, ring, a, ear, c)) is not None:
            blocks[:, ear], ranks[ear], failed = block, NO_EAR, failed + 1
            continue
        ears.append((a, ear, c))
        ring, after[a], before[c] = ring[ring != ear], c, a
        ranks[ear], blocks[:, ear] = NO_EAR, -1
        again = np.array([a, c, *np.flatnonzero((blocks[0] == ear) | (blocks[1] == ear))])
        ranks[again], lines[again] = _ranks(points, before[again], again, after[again])
        blocks[:, again] = -1
    return np.array(ears)


def _ranks(
    points: Float[np.ndarray, "2 n"], before: Indices, at: Indices, after: Indices
) -> tuple[Int[np.ndarray, "C"], Bool[np.ndarray, "C"]]:
    """Return the order of clipping: corners without area first, then convex ones, then lines; and True for lines."""
    a, b, c = points[:, before], points[:, at], points[:, after]
    turns = _cross(b - a, c - b)
    lines = np.abs(turns) <= TINY * np.linalg.norm(c - a, axis=0)
    return np.select([np.abs(turns) <= ZERO, (turns > 0) & ~lines, lines], [0, 1, 2], NO_EAR), lines


def _block(
    points: Float[np.ndarray, "2 n"], ring: Indices, before: np.integer, ear: np.integer, after: np.integer
) -> tuple[np.integer, np.integer] | None:
    """Return what part of the polygon's boundary is in the triangle of a convex corner: a corner, twice, or an edge.

    Of several corners it is the one farthest from the triangle's open side. In a simple polygon that one turns the
    other way, so it is no ear itself.
    """
    a, b, c, corners = (points[:, at] for at in ([before], [ear], [after], ring))
    depth = _cross(a - c, corners - c)
    inside = np.flatnonzero((_cross(b - a, corners - a) >= 0) & (_cross(c - b, corners - b) >= 0) & (depth >= 0))
    inside = inside[~np.logical_or.reduce([(corners[:, inside] == each).all(axis=0) for each in (a, b, c)])]
    if inside.size:
        deepest = ring[inside[np.argmax(depth[inside])]]
        return deepest, deepest
    left = _cross(c - a, corners - a)
    edges = np.flatnonzero(left * np.roll(left, -1) < 0)
    ends = (edges + 1) % len(ring)
    along, start = corners[:, ends] - corners[:, edges], corners[:, edges]
    crossing = np.flatnonzero(_cross(along, a - start) * _cross(along, c - start) < 0)
    return (ring[edges[crossing[0]]], ring[ends[crossing[0]]]) if crossing.size else None


def _cross(a: Float[np.ndarray, "2 *n"], b: Float[np.ndarray, "2 *n"]) -> Float[np.ndarray, "*n"]:
    return a[0] * b[1] - a[1] * b[0]
