"""Test for walls that the tool's bare tip, the segment between the last body and the TCP, passes through.

The tip has to come near the wall, so it is not a collision body. But a wall that it crosses, except with its very end,
lies between the tool and its target. The walls are the triangles of a mesh, or for a cloud one flat disc per point, as
in pictures: each extends beyond its point's eighth neighbour, so that discs overlap where points are spread evenly.

A triangle or disc lies in a ball about its middle; the radius of the largest of these balls is the grain. The tip is
cut into samples of a grain at most: anything that a sample crosses has its middle within one and a half grains of the
sample's. The candidates from a tree of the middles are tested exactly.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from htcp_jax.caching import cached_for_last
from htcp_jax.model import Workpiece, mesh_points
from htcp_jax.model import surface as surfaces

GRAINS = 100_000  # approximate number of pieces that a mesh is cut into for the search
INCLUSIVE = 1e-9  # tolerance relative to a triangle's size: a line through an edge meets one of its triangles
Ends = Float[np.ndarray, "n 3"]


class WallTriangles:
    """The triangles of a mesh, in pieces of about the same size; their middles, and the grain [m]."""

    def __init__(self, triangles: Float[np.ndarray, "F 3 3"]):
        edges = triangles - np.roll(triangles, 1, axis=1)
        area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum() / 2
        self._corners = mesh_points.pieces(triangles, 2 * np.sqrt(area / GRAINS), "the mesh")
        self.middle = self._corners.mean(axis=1)
        self.grain = float(np.linalg.norm(self._corners - self.middle[:, None], axis=2).max())

    def crossed(self, rows: Int[np.ndarray, "n"], p: Ends, q: Ends) -> Bool[np.ndarray, "n"]:
        """Return True where the straight line from p to q passes through the piece in that row.

        By Moeller and Trumbore: the line meets the plane between its ends, at a point with barycentric coordinates u,
        v, 1 - u - v that are not negative. A line within the plane passes through nothing.
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
    """The flat discs of a cloud's points; their middles, and the grain [m]."""

    def __init__(self, surface: surfaces.Surface):
        self._surface, self.middle, self.grain = surface, surface.points, float(surface.radius.max())

    def crossed(self, rows: Int[np.ndarray, "n"], p: Ends, q: Ends) -> Bool[np.ndarray, "n"]:
        """Return True where the straight line from p to q passes through the disc in that row.

        Its ends lie on both sides of the plane, and its point in the plane within the disc.
        """
        disc = self._surface.only(rows)
        before, after = _rows_dot(p - disc.points, disc.normals), _rows_dot(q - disc.points, disc.normals)
        with np.errstate(divide="ignore", invalid="ignore"):
            point = p + (before / (before - after))[:, None] * (q - p)
            return (before * after <= 0) & (np.linalg.norm(point - disc.points, axis=1) <= disc.radius)


class TipGuard:
    """Walls that the tip must not pass through, in the workpiece frame; its end of length `contact_m` [m] may touch."""

    def __init__(self, wall: WallTriangles | WallDiscs, contact_m: float):
        self._wall, self._contact = wall, contact_m
        self._tree = scipy.spatial.cKDTree(wall.middle)
        self._reach = 1.5 * wall.grain * (1 + INCLUSIVE)

    def passes(self, p: Ends, q: Ends) -> Bool[np.ndarray, "n"]:
        """Return True where the segments from p to q, shortened at q by the contact length, pass through a wall."""
        length = np.linalg.norm(q - p, axis=1)
        kept = np.maximum(length - self._contact, 0.0)
        move = (q - p) * np.divide(kept, length, out=np.zeros_like(kept), where=length > 0)[:, None]
        row, middle = _wall_samples(p, move, np.ceil(kept / self._wall.grain).astype(int))
        near = np.isfinite(self._tree.query(middle, distance_upper_bound=self._reach)[0])
        row = row[near]
        found = self._tree.query_ball_point(middle[near], self._reach, return_sorted=False)
        rows = np.repeat(row, [len(each) for each in found])
        things = np.concatenate([np.empty(0, int), *(np.array(each, int) for each in found)])
        through = np.zeros(len(p), bool)
        through[rows[self._wall.crossed(things, p[rows], (p + move)[rows])]] = True
        return through


@cached_for_last(2)
def make_tip_guard(workpiece: Workpiece) -> TipGuard | None:
    """Return the guard of a workpiece, cached for the next plan; None if its tip may touch anywhere."""
    if workpiece.tip_contact_m is None:
        return None
    wall = (
        WallTriangles(workpiece.triangles)
        if len(workpiece.triangles)
        else WallDiscs(surfaces.surface_of(workpiece.cloud))
    )
    return TipGuard(wall, workpiece.tip_contact_m)


class _Samples(NamedTuple):
    row: Int[np.ndarray, "m"]
    middle: Float[np.ndarray, "m 3"]


def _wall_samples(p: Ends, move: Ends, counts: Int[np.ndarray, "n"]) -> _Samples:
    """Cut the segments that begin at p into `counts` equal samples each; return their segment numbers and middles."""
    row = np.repeat(np.arange(len(p)), counts)
    before = np.cumsum(counts) - counts
    fraction = (np.arange(len(row)) - before[row] + 0.5) / counts[row]
    return _Samples(row, p[row] + fraction[:, None] * move[row])


def _rows_dot(u: Ends, v: Ends) -> Float[np.ndarray, "n"]:
    return (u * v).sum(axis=1)
