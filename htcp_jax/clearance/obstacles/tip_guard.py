"""Test whether the tool's bare tip, the segment from the last body to the TCP, passes through a wall.

The tip must come near the wall, so it is not a collision body. Only its end at the TCP may be in a wall; the rest must
not pass through one. The walls are the triangles of a mesh or, for a cloud, one flat disc per point. A disc extends
beyond its point's eighth neighbour, so that discs overlap where points are spread evenly.

A triangle or disc lies in a ball about its middle. The grain is the radius of the largest of these balls. The tip is
cut into pieces no longer than the grain. Anything that a piece crosses then has its middle within 1.5 grains of the
piece's middle. A tree finds these candidates, which are then tested exactly. Tips of a path are first excluded
together: by the tree if they are far from all walls, else by axes that separate their convex hull from the candidates.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from htcp_jax.caching import cached_for_last
from htcp_jax.model import Workpiece
from htcp_jax.model import surface as surfaces
from htcp_jax.numerics import ragged_rows

GRAINS = 100_000  # approximate number of pieces that a mesh is cut into for the search
INCLUSIVE = 1e-9  # tolerance relative to a triangle's size, so that no line passes between neighbouring triangles
ANY = -1  # in place of a wall's row: any wall
Ends = Float[np.ndarray, "n 3"]


class NearWalls(NamedTuple):
    """Pairs of a tip, or a group of tips, and a wall that it may pass through."""

    tip: Int[np.ndarray, "m"]  # row of the tip or group
    wall: Int[np.ndarray, "m"]  # row of the triangle or disc; ANY

    @classmethod
    def unknown(cls, count: int) -> "NearWalls":
        """Return pairs of `count` tips or groups that may pass through any wall."""
        return cls(np.arange(count), np.full(count, ANY))

    def each(self, counts: Int[np.ndarray, "n"]) -> "NearWalls":
        """Return the pairs after replacing each row by the given number of rows, which follow each other."""
        pair, nth = ragged_rows(counts[self.tip])
        return NearWalls((np.cumsum(counts) - counts)[self.tip[pair]] + nth, self.wall[pair])

    def only(self, which: Bool[np.ndarray, "n"]) -> "NearWalls":
        """Return the pairs of some rows, which are numbered from 0."""
        mine = which[self.tip]
        return NearWalls((np.cumsum(which) - 1)[self.tip[mine]], self.wall[mine])


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

    def least_distance(self, rows: Int[np.ndarray, "n"], tips: Float[np.ndarray, "n k 2 3"]) -> Float[np.ndarray, "n"]:
        """Return lower bounds on the distances of tips' convex hulls from triangles [m]: gaps along separating axes.

        The axes are the triangle's normal, and those perpendicular to the mean tip and to a side of the triangle.
        """
        corners, ends = self._corners[rows], np.concatenate([tips[:, :, 0], tips[:, :, 1]], axis=1)
        sides, move = np.roll(corners, -1, axis=1) - corners, (tips[:, :, 1] - tips[:, :, 0]).mean(axis=1)
        normal = np.cross(sides[:, 0], sides[:, 1])
        axes = np.concatenate([normal[:, None], np.cross(sides, move[:, None])], axis=1).swapaxes(1, 2)
        wall, tip = corners @ axes, ends @ axes
        gap = np.maximum(wall.min(axis=1) - tip.max(axis=1), tip.min(axis=1) - wall.max(axis=1))
        return np.maximum(gap / np.maximum(np.linalg.norm(axes, axis=1), 1e-300), 0.0).max(axis=1)


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

    def least_distance(self, rows: Int[np.ndarray, "n"], tips: Float[np.ndarray, "n k 2 3"]) -> Float[np.ndarray, "n"]:
        """Return lower bounds on the distances of tips' convex hulls from discs [m]: from their planes, or balls."""
        disc, ends = self._surface.only(rows), np.concatenate([tips[:, :, 0], tips[:, :, 1]], axis=1)
        mean, spread = tips.mean(axis=1), np.linalg.norm(tips - tips.mean(axis=1)[:, None], axis=3).max(axis=(1, 2))
        move = mean[:, 1] - mean[:, 0]
        share = _rows_dot(disc.points - mean[:, 0], move) / np.maximum(_rows_dot(move, move), 1e-300)
        away = np.linalg.norm(mean[:, 0] + np.clip(share, 0, 1)[:, None] * move - disc.points, axis=1)
        height = ((ends - disc.points[:, None]) @ disc.normals[:, :, None])[:, :, 0]
        over = np.maximum(np.maximum(height.min(axis=1), -height.max(axis=1)), 0.0)
        return np.maximum(over, away - spread - disc.radius)


class TipGuard:
    """Walls that the tip must not pass through, in the workpiece frame.

    The part of the tip within `contact_m` [m] of the TCP may be in a wall.
    """

    def __init__(self, wall: WallTriangles | WallDiscs, contact_m: float):
        self._wall, self._contact = wall, contact_m
        self._tree = scipy.spatial.cKDTree(wall.middle)
        self._reach = 1.5 * wall.grain * (1 + INCLUSIVE)

    def passes(self, p: Ends, q: Ends, near: NearWalls | None = None) -> Bool[np.ndarray, "n"]:
        """Return True where the segments from p to q, shortened at q by the contact length, pass through a wall.

        Args:
            p: First ends of the segments [m].
            q: Second ends, at the TCP [m].
            near: Walls that each segment may pass through; None: any.
        """
        end = p + self._shortened(p, q)[1]
        tip, wall = NearWalls.unknown(len(p)) if near is None else near
        rest = tip[wall == ANY]
        rest = rest[self._is_near(p[rest], end[rest])]
        row, walls, _ = self._walls_near(p[rest], end[rest])
        tip, wall = np.append(tip[wall != ANY], rest[row]), np.append(wall[wall != ANY], walls)
        through = np.zeros(len(p), bool)
        through[tip[self._wall.crossed(wall, p[tip], end[tip])]] = True
        return through

    def near_walls(
        self,
        tips: Float[np.ndarray, "n k 2 3"],
        away_m: Float[np.ndarray, "n"],
        is_rigid: bool,
        near: NearWalls | None = None,
    ) -> NearWalls:
        """Return the walls that tips of groups may pass through: those near the convex hulls of some of the tips.

        Args:
            tips: Both ends of some tips of each group, the second ones at the TCP [m].
            away_m: Distance from the convex hull of these tips within which all tips of the group are [m].
            is_rigid: True if the tips move rigidly; otherwise the contact length is not subtracted.
            near: Walls that tips of the groups may pass through as far as known; None: any.
        """
        p, q = tips[:, :, 0], tips[:, :, 1]
        length, move = self._shortened(p, q) if is_rigid else (np.linalg.norm(q - p, axis=2), q - p)
        tips, exists = np.stack([p, p + move], axis=2), (length > 0).any(axis=1) | (not is_rigid)
        mean = tips.mean(axis=1)
        away_m = (1 + INCLUSIVE) * away_m + INCLUSIVE
        around = np.linalg.norm(tips - mean[:, None], axis=3).max(axis=(1, 2), initial=0.0) + away_m
        group, wall = NearWalls.unknown(len(tips)) if near is None else near
        rest = group[(wall == ANY) & exists[group]]
        rest = rest[self._is_near(mean[rest, 0], mean[rest, 1], around[rest])]
        is_large = around[rest] > self._wall.grain  # too many walls are near
        large, rest = rest[is_large], rest[~is_large]
        row, walls, apart = self._walls_near(mean[rest, 0], mean[rest, 1], around[rest].max(initial=0.0))
        meets = apart <= self._reach + around[rest[row]]
        group = np.append(group[wall != ANY], rest[row[meets]])
        wall = np.append(wall[wall != ANY], walls[meets])
        touches = self._wall.least_distance(wall, tips[group]) <= away_m[group]
        return NearWalls(np.append(group[touches], large), np.append(wall[touches], np.full(len(large), ANY)))

    def _walls_near(
        self, p: Ends, q: Ends, away_m: float = 0.0
    ) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"], Float[np.ndarray, "m"]]:
        """Return pairs of a segment from p to q and a triangle or disc that may be near it, and how near they are [m].

        Args:
            p: First ends of the segments [m].
            q: Second ends [m].
            away_m: Distance beyond which a triangle or disc is not near [m].
        """
        row, middle = _wall_samples(p, q - p, np.ceil(np.linalg.norm(q - p, axis=1) / self._wall.grain).astype(int))
        within = self._reach + away_m
        pairs = scipy.spatial.cKDTree(middle).sparse_distance_matrix(self._tree, within, output_type="ndarray")
        return row[pairs["i"]], pairs["j"], pairs["v"]

    def _is_near(self, p: Ends, q: Ends, away_m: float | Float[np.ndarray, "n"] = 0.0) -> Bool[np.ndarray, "n"]:
        """Return False for segments from p to q that are farther than `away_m` from all walls [m]."""
        reach = (self._reach + np.linalg.norm(q - p, axis=1) / 2 + away_m) * (1 + INCLUSIVE)
        middle = (p + q) / 2
        beyond = np.maximum(np.maximum(self._tree.mins - middle, middle - self._tree.maxes), 0.0)
        near = np.linalg.norm(beyond, axis=1) <= reach  # of the box of all walls
        near[near] = self._tree.query(middle[near], distance_upper_bound=reach.max(initial=0.0))[0] <= reach[near]
        return near

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


def _rows_dot(u: Ends, v: Ends) -> Float[np.ndarray, "n"]:
    return (u * v).sum(axis=1)
