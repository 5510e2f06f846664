"""Surface of a point cloud, for validation of the tool's bare tip: a flat disc at every point.

The code is independent of the planner's (tip_guard.py and surface.py). A disc lies in the plane fitted to its point's
neighbours. Its radius is FURTHER times the distance of the eighth neighbour, at most WIDEST times the median radius.
The planner thins clouds of more than 60,000 points, so its discs are larger for such clouds.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

NEIGHBOURS, REACHED = 24, 8  # number of neighbours for a plane, and the neighbour that determines the radius
FURTHER, WIDEST = 1.1, 3.0  # radius / distance of this neighbour; maximum radius / median radius

Points = Float[np.ndarray, "m 3"]


class CloudDiscs:
    """Flat discs at P >= 4 points, each with its own radius [m]; the planes are fitted on demand.

    Args:
        points: The points [m].
        tree: A k-d tree of the points.
    """

    def __init__(self, points: Float[np.ndarray, "P 3"], tree: cKDTree):
        self._points, self._tree, self._normals = points, tree, np.full(points.shape, np.nan)
        distance = tree.query(points, k=[min(REACHED + 1, len(points))], workers=-1)[0][:, 0]
        self.radius = np.minimum(FURTHER * distance, WIDEST * np.median(FURTHER * distance))

    def crossed(self, p: Points, q: Points, rows: Int[np.ndarray, "m"]) -> Bool[np.ndarray, "m"]:
        """Return a mask of the segments, True for each that intersects its disc.

        Args:
            p: Starts of the segments [m].
            q: Ends of the segments [m].
            rows: Index of each segment's disc.
        """
        new = np.unique(rows[np.isnan(self._normals[rows, 0])])
        self._normals[new] = self._fitted(new)
        normal, centre = self._normals[rows], self._points[rows]
        heights = [((end - centre) * normal).sum(axis=1) for end in (p, q)]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = heights[0] / (heights[0] - heights[1])  # infinite or NaN if the segment lies in the plane
            away = np.linalg.norm(p + share[:, None] * (q - p) - centre, axis=1)
        return (share >= 0) & (share <= 1) & (away <= self.radius[rows])

    def _fitted(self, rows: Int[np.ndarray, "k"]) -> Float[np.ndarray, "k 3"]:
        """Return unit normals of the discs' planes, with arbitrary signs."""
        _, near = self._tree.query(self._points[rows], k=min(NEIGHBOURS + 1, len(self._points)))
        spread = self._points[near] - self._points[near].mean(axis=1, keepdims=True)
        return np.linalg.svd(spread, full_matrices=False)[2][:, 2]
