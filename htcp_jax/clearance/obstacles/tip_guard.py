"""Test whether the tool's bare tip, the segment from the last body to the TCP, passes through a wall.

The tip must come near the wall, so it is not a collision body. Only its end at the TCP may be in a wall; the rest must
not pass through one. The walls are the triangles of a mesh or, for a cloud, one flat disc per point. A disc extends
beyond its point's eighth neighbour, so that discs overlap where points are spread evenly.

A triangle or disc lies in a ball about its middle. The grain is the radius of the largest of these balls. The tip is
cut into pieces no longer than the grain. Anything that a piece crosses then has its middle within 1.5 grains of the
piece's middle. A tree finds these candidates, which are then tested exactly.
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
NEIGHBOURS = 16  # number of consecutive tips that are tested together
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


class TipGuard:
    """Walls that the tip must not pass through, in the workpiece frame.

    The part of the tip within `contact_m` [m] of the TCP may be in a wall.
    """

    def __init__(self, wall: WallTriangles | WallDiscs, contact_m: float):
        self._wall, self._contact = wall, contact_m
        self._tree = scipy.spatial.cKDTree(wall.middle)
        self._reach = 1.5 * wall.grain * (1 + INCLUSIVE)

    def passes(self, p: Ends, q: Ends) -> Bool[np.ndarray, "n"]:
        """Return True where the segments from p to q, shortened at q by the contact length, pass through a wall."""
        kept, move = self._shortened(p, q)
        tip = self._near_tips(p + move / 2, kept.max(initial=0.0) / 2)
        row, middle = _wall_samples(p[tip], move[tip], np.ceil(kept[tip] / self._wall.grain).astype(int))
        near = np.flatnonzero(self._is_near(middle))
        found = scipy.spatial.cKDTree(middle[near]).sparse_distance_matrix(self._tree, self._reach, output_type="ndarray")
        rows, things = tip[row[near[found["i"]]]], found["j"]
        through = np.zeros(len(p), bool)
        through[rows[self._wall.crossed(things, p[rows], (p + move)[rows])]] = True
        return through

    def _near_tips(self, middle: Ends, half_m: float) -> Int[np.ndarray, "_"]:
        """Return the rows of the tips that may touch a piece near a wall; most are excluded in groups of neighbours."""
        rows = np.minimum(np.arange(-(-len(middle) // NEIGHBOURS) * NEIGHBOURS), len(middle) - 1)
        groups = middle[rows].reshape(-1, NEIGHBOURS, 3)
        centre = groups.mean(axis=1)
        radius = half_m + np.linalg.norm(groups - centre[:, None], axis=2).max(axis=1)
        tip = np.flatnonzero(np.repeat(self._is_near(centre, radius), NEIGHBOURS)[: len(middle)])
        return tip[self._is_near(middle[tip], half_m)]

    def _is_near(self, points: Ends, radius_m: Float[np.ndarray, "n"] | float = 0.0) -> Bool[np.ndarray, "n"]:
        """Return True for points that may be within a radius of a piece near a wall [m]."""
        reach = (self._reach + np.asarray(radius_m)) * (1 + INCLUSIVE)
        return self._tree.query(points, distance_upper_bound=reach.max(initial=0.0))[0] <= reach

    def may_pass(
        self, p: Ends, q: Ends, travel: Float[np.ndarray, "n"], is_rigid: bool = True
    ) -> Bool[np.ndarray, "n"]:
        """Return False where no segment whose ends are at most `travel` [m] from p and q passes through a wall.

        Args:
            p: First ends of the segments [m].
            q: Second ends, at the TCP [m].
            travel: Travel of the ends [m].
            is_rigid: True if the segments move rigidly; otherwise the contact length is not subtracted.
        """
        length, move = self._shortened(p, q) if is_rigid else (np.linalg.norm(q - p, axis=1), q - p)
        farthest = (self._reach + length / 2 + travel) * (1 + INCLUSIVE)
        middle = p + move / 2
        beyond = np.maximum(
            np.maximum(self._tree.mins - middle, middle - self._tree.maxes), 0.0
        )  # the box of all walls
        near = ((length > 0) | (not is_rigid)) & (np.linalg.norm(beyond, axis=1) <= farthest)
        most = farthest[near].max(initial=0.0) * (1 + INCLUSIVE)
        near[near] = self._tree.query(middle[near], distance_upper_bound=most)[0] <= farthest[near]
        return near

    def _shortened(self, p: Ends, q: Ends) -> tuple[Float[np.ndarray, "n"], Ends]:
        """Return the lengths of the segments after removal of the contact length at q [m], and the moves from p."""
        length = np.linalg.norm(q - p, axis=1)
        kept = np.maximum(length - self._contact, 0.0)
        return kept, (q - p) * np.divide(kept, length, out=np.zeros_like(kept), where=length > 0)[:, None]


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


def _rows_dot(u: Ends, v: Ends) -> Float[np.ndarray, "n"]:
    return (u * v).sum(axis=1)
