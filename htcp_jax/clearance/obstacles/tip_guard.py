"""Test whether the tool's bare tip, the segment from the last body to the TCP, passes through a wall.

The tip must come near the wall, so it is not a collision body. Only its end at the TCP may be in a wall; the rest must
not pass through one. The walls are the triangles of a mesh or, for a cloud, one flat disc per point. A disc extends
beyond its point's eighth neighbour, so that discs overlap where points are spread evenly.

A triangle or disc lies in a ball about its middle. The grain is the radius of the largest of these balls. The tip is
cut into pieces no longer than the grain. Anything that a piece crosses then has its middle within 1.5 grains of the
piece's middle. A tree finds these candidates, which are then tested exactly. Consecutive tips of a path are first
excluded together, by the planes of the candidates of their mean.
"""

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from htcp_jax.caching import cached_for_last
from htcp_jax.model import Workpiece
from htcp_jax.model import surface as surfaces
from htcp_jax.numerics import ragged_rows

GRAINS = 100_000  # approximate number of pieces that a mesh is cut into for the search
INCLUSIVE = 1e-9  # tolerance relative to a triangle's size, so that no line passes between neighbouring triangles
NEIGHBOURS = 11  # number of consecutive tips that are tested together
Ends = Float[np.ndarray, "n 3"]


class WallTriangles:
    """Walls of a mesh: its triangles, cut into pieces of about the same size; `middle` of each, and `grain` [m]."""

    def __init__(self, triangles: Float[np.ndarray, "F 3 3"]):
        edges = triangles - np.roll(triangles, 1, axis=1)
        area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum() / 2
        self._corners = surfaces.pieces(triangles, 2 * np.sqrt(area / GRAINS), "the mesh")
        self.middle = self._corners.mean(axis=1)
        self.grain = float(np.linalg.norm(self._corners - self.middle[:, None], axis=2).max())

    def crossed(self, rows: Int[np.ndarray, "n"], p: Ends, q: Ends) -> Bool[np.ndarray, "n"]:
        """Return True where the segment from p to q passes through the triangle in the given row.

        Algorithm of Moeller and Trumbore: the segment crosses the plane at a point whose barycentric coordinates u, v,
        1 - u - v are not negative. A segment within the plane does not pass through the triangle.
        """
        a, b, c = np.moveaxis(self._corners[rows], 1, 0)
        move, ab, ac = q - p, b - a, c - a
        across = np.cross(move, ac)
        det = _rows_dot(ab, across)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = _rows_dot(p - a, across) / det
            other = np.cross(p - a, ab)
            v, t = _rows_dot(move, other) / det, _rows_dot(ac, other) / det
            return (np.minimum(np.minimum(u, v), 1 - u - v) >= -INCLUSIVE) & (t >= 0) & (t <= 1)

    def plane_distance(self, rows: Int[np.ndarray, "n"], p: Ends, q: Ends) -> Float[np.ndarray, "n"]:
        """Return the distance of segments from the planes of triangles [m]; 0 if they cross it, or without a plane."""
        a, b, c = np.moveaxis(self._corners[rows], 1, 0)
        normal = np.cross(b - a, c - a)
        return _one_sided(a, normal, p, q) / np.maximum(np.linalg.norm(normal, axis=1), 1e-300)


class WallDiscs:
    """Walls of a cloud: one flat disc per point; `middle` of each, and `grain` [m]."""

    def __init__(self, surface: surfaces.Surface):
        self._surface, self.middle, self.grain = surface, surface.points, float(surface.radius.max())

    def crossed(self, rows: Int[np.ndarray, "n"], p: Ends, q: Ends) -> Bool[np.ndarray, "n"]:
        """Return True where the segment from p to q passes through the disc in the given row.

        The ends must lie on different sides of the disc's plane, and the segment must cross the plane within the disc.
        """
        disc = self._surface.only(rows)
        before, after = _rows_dot(p - disc.points, disc.normals), _rows_dot(q - disc.points, disc.normals)
        with np.errstate(divide="ignore", invalid="ignore"):
            point = p + (before / (before - after))[:, None] * (q - p)
            return (before * after <= 0) & (np.linalg.norm(point - disc.points, axis=1) <= disc.radius)

    def plane_distance(self, rows: Int[np.ndarray, "n"], p: Ends, q: Ends) -> Float[np.ndarray, "n"]:
        """Return the distance of segments from the planes of discs [m]; 0 if they cross it."""
        disc = self._surface.only(rows)
        return _one_sided(disc.points, disc.normals, p, q)


class TipGuard:
    """Walls that the tip must not pass through, in the workpiece frame.

    The part of the tip within `contact_m` [m] of the TCP may be in a wall.
    """

    def __init__(self, wall: WallTriangles | WallDiscs, contact_m: float):
        self._wall, self._contact = wall, contact_m
        self._tree = scipy.spatial.cKDTree(wall.middle)
        self._reach = 1.5 * wall.grain * (1 + INCLUSIVE)

    def passes(self, p: Ends, q: Ends) -> Bool[np.ndarray, "n"]:
        """Return True where the segments from p to q, shortened at q by the contact length, pass through a wall.

        Most tips are excluded together with their neighbours, so consecutive tips should be close to each other.
        """
        rows = np.minimum(np.arange(-(-len(p) // NEIGHBOURS) * NEIGHBOURS), len(p) - 1)
        groups = np.stack([p, q], axis=1)[rows].reshape(-1, NEIGHBOURS, 2, 3)
        tip = np.flatnonzero(np.repeat(self.may_pass(groups), NEIGHBOURS)[: len(p)])
        end = p[tip] + self._shortened(p[tip], q[tip])[1]
        row, things, _ = self._walls_near(p[tip], end)
        through = np.zeros(len(p), bool)
        through[tip[row[self._wall.crossed(things, p[tip[row]], end[row])]]] = True
        return through

    def may_pass(
        self, tips: Float[np.ndarray, "n k 2 3"], away_m: float | Float[np.ndarray, "n"] = 0.0, is_rigid: bool = True
    ) -> Bool[np.ndarray, "n"]:
        """Return False for groups of tips between which no tip passes through a wall.

        Every point of a tip is near a point of the group's mean tip. If a wall is farther than that from the mean tip,
        or its plane, on one side of it, no tip of the group passes through this wall.

        Args:
            tips: Both ends of the k tips of each group, the second ones at the TCP [m].
            away_m: Distance from the tips' convex hull within which the ends of other tips of a group are [m].
            is_rigid: True if the tips move rigidly; otherwise the contact length is not subtracted.
        """
        p, q = tips[:, :, 0], tips[:, :, 1]
        length, move = self._shortened(p, q) if is_rigid else (np.linalg.norm(q - p, axis=2), q - p)
        ends = np.stack([p, p + move], axis=2)
        mean = ends.mean(axis=1)
        away = (1 + INCLUSIVE) * (np.linalg.norm(ends - mean[:, None], axis=3).max(axis=(1, 2), initial=0.0) + away_m)
        middle, radius = mean.mean(axis=1), np.linalg.norm(mean[:, 1] - mean[:, 0], axis=1) / 2 + away
        # Most are farther than that from the box of all walls.
        beyond = np.maximum(np.maximum(self._tree.mins - middle, middle - self._tree.maxes), 0.0)
        near = (length > 0).any(axis=1) | (not is_rigid)
        near &= np.linalg.norm(beyond, axis=1) <= (self._reach + radius) * (1 + INCLUSIVE)
        near[near] = self._is_near(middle[near], radius[near])
        small = np.flatnonzero(near & (away <= self._wall.grain))
        row, things, apart = self._walls_near(mean[small, 0], mean[small, 1], away[small].max(initial=0.0))
        row = small[row]
        row, things = (each[apart <= self._reach + away[row]] for each in (row, things))
        near[small] = False
        near[row[self._wall.plane_distance(things, mean[row, 0], mean[row, 1]) <= away[row] + INCLUSIVE]] = True
        return near

    def _walls_near(
        self, p: Ends, q: Ends, away_m: float = 0.0
    ) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"], Float[np.ndarray, "m"]]:
        """Return pairs of a segment from p to q and a triangle or disc that may be near it, and how near they are [m].

        Args:
            p: First ends of the segments [m].
            q: Second ends [m].
            away_m: Distance beyond which a triangle or disc is not near [m].
        """
        move, half = q - p, np.linalg.norm(q - p, axis=1) / 2
        near = np.flatnonzero(self._is_near(p + move / 2, half + away_m))
        row, middle = _wall_samples(p[near], move[near], np.ceil(2 * half[near] / self._wall.grain).astype(int))
        within = self._reach + away_m
        pairs = scipy.spatial.cKDTree(middle).sparse_distance_matrix(self._tree, within, output_type="ndarray")
        return near[row[pairs["i"]]], pairs["j"], pairs["v"]

    def _is_near(self, points: Ends, radius_m: Float[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
        """Return True for points that may be within a radius of a piece near a wall [m]."""
        reach = (self._reach + radius_m) * (1 + INCLUSIVE)
        return self._tree.query(points, distance_upper_bound=reach.max(initial=0.0))[0] <= reach

    def _shortened(
        self, p: Float[np.ndarray, "*n 3"], q: Float[np.ndarray, "*n 3"]
    ) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n 3"]]:
        """Return the lengths of the segments after removal of the contact length at q [m], and the moves from p."""
        length = np.linalg.norm(q - p, axis=-1)
        kept = np.maximum(length - self._contact, 0.0)
        return kept, (q - p) * np.divide(kept, length, out=np.zeros_like(kept), where=length > 0)[..., None]


@cached_for_last(2)
def make_tip_guard(workpiece: Workpiece) -> TipGuard | None:
    """Return the tip guard of a workpiece, cached for the next plan; None if the tip may touch anywhere."""
    if workpiece.tip_contact_m is None:
        return None
    triangles, cloud = workpiece.triangles, workpiece.cloud
    wall = WallTriangles(triangles) if len(triangles) else WallDiscs(surfaces.surface_of(cloud))
    return TipGuard(wall, workpiece.tip_contact_m)


def _wall_samples(
    p: Ends, move: Ends, counts: Int[np.ndarray, "n"]
) -> tuple[Int[np.ndarray, "m"], Float[np.ndarray, "m 3"]]:
    """Return the segment and the middle of each piece, after cutting each segment p, p + move into `counts` pieces."""
    row, nth = ragged_rows(counts)
    fraction = (nth + 0.5) / counts[row]
    return row, p[row] + fraction[:, None] * move[row]


def _one_sided(point: Ends, normal: Ends, p: Ends, q: Ends) -> Float[np.ndarray, "n"]:
    """Return the smaller height of the ends p and q over planes, in units of the normal; 0 between two sides."""
    before, after = _rows_dot(p - point, normal), _rows_dot(q - point, normal)
    return np.where(before * after > 0, np.minimum(np.abs(before), np.abs(after)), 0.0)


def _rows_dot(u: Ends, v: Ends) -> Float[np.ndarray, "n"]:
    return (u * v).sum(axis=1)
