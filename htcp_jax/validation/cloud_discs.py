"""Walls of a point cloud that the tool's bare tip must not pass through, for validation: a flat disc at every point.

The code is independent of tip_guard.py and surface.py. A disc lies in the plane fitted to its point's neighbours, and
extends beyond the eighth of them. The planner thins a cloud of more than 60,000 points, so its discs are larger there.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

NEIGHBOURS, REACHED = 24, 8  # that a plane is fitted to, and the one that a disc extends beyond
FURTHER, WIDEST = 1.1, 3.0  # radius by the distance of that neighbour; largest radius by the median

Points = Float[np.ndarray, "m 3"]


class CloudDiscs:
    """Flat discs at P >= 4 points, with a radius each [m]; planes are fitted when they are needed.

    Args:
        points: The points [m].
        tree: A tree of these points.
    """

    def __init__(self, points: Float[np.ndarray, "P 3"], tree: cKDTree):
        self._points, self._tree, self._normals = points, tree, np.full(points.shape, np.nan)
        distance = tree.query(points, k=[min(REACHED + 1, len(points))], workers=-1)[0][:, 0]
        self.radius = np.minimum(FURTHER * distance, WIDEST * np.median(FURTHER * distance))

    def crossed(self, p: Points, q: Points, rows: Int[np.ndarray, "m"]) -> Bool[np.ndarray, "m"]:
        """True if a segment meets its disc.

        Args:
            p: Starts of the segments [m].
            q: Ends of the segments [m].
            rows: The disc of each segment.
        """
        new = np.unique(rows[np.isnan(self._normals[rows, 0])])
        self._normals[new] = self._fitted(new)
        normal, centre = self._normals[rows], self._points[rows]
        heights = [((end - centre) * normal).sum(axis=1) for end in (p, q)]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = heights[0] / (heights[0] - heights[1])  # not finite if the segment lies in the plane
            away = np.linalg.norm(p + share[:, None] * (q - p) - centre, axis=1)
        return (share >= 0) & (share <= 1) & (away <= self.radius[rows])

    def _fitted(self, rows: Int[np.ndarray, "k"]) -> Float[np.ndarray, "k 3"]:
        """Unit normals of the planes, to either side."""
        _, near = self._tree.query(self._points[rows], k=min(NEIGHBOURS + 1, len(self._points)))
        spread = self._points[near] - self._points[near].mean(axis=1, keepdims=True)
        return np.linalg.svd(spread, full_matrices=False)[2][:, 2]
