"""The convex hull of a point cloud as an intersection of half-spaces."""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from htcp_jax.caching import cached_by_values
from htcp_jax.errors import InputError


class Hull(NamedTuple):
    """A convex hull: the points x with normal @ x <= offset. The normals have length 1 and point outwards."""

    normal: Float[np.ndarray, "F 3"]
    offset: Float[np.ndarray, "F"]  # [m]
    vertices: Float[np.ndarray, "V 3"]  # vertices of the exact hull [m], also for a tolerance above 0


@cached_by_values(2)
def convex_hull(points: Float[np.ndarray, "P 3"], tolerance_m: float, source: str) -> Hull:
    """Return the convex hull of P points [m]: exact for tolerance 0, otherwise with fewer facets.

    With a tolerance the half-spaces still contain every point, and each touches one. They extend beyond the exact hull
    by at most about the tolerance. Use a tolerance for a smooth convex surface: nearly all of its points are vertices
    of the exact hull, and each vertex adds two facets.

    Args:
        points: The points [m].
        tolerance_m: Distance from the hull [m] below which a point adds no vertex.
        source: Name of the points in the error message.

    Raises:
        InputError: For points in one plane.
    """
    try:
        exact = scipy.spatial.ConvexHull(points)
    except scipy.spatial.QhullError:
        raise InputError(
            f"{source}: the points lie in one plane, so the hull has no inside; set interior to 'none'"
        ) from None
    vertices = points[exact.vertices]
    if tolerance_m == 0.0:
        planes = _distinct_planes(exact.equations)
        return Hull(planes[:, :3].copy(), -planes[:, 3], vertices)
    # Qhull's W: a point becomes a vertex only if it lies farther than this outside the facets so far.
    thinned = scipy.spatial.ConvexHull(vertices, qhull_options=f"Qt W{tolerance_m:.17g}")
    normal = _distinct_planes(thinned.equations)[:, :3].copy()
    # Push every facet out to its farthest point, so that no point is outside.
    return Hull(normal, np.max(normal @ vertices.T, axis=1), vertices)


def _distinct_planes(equations: Float[np.ndarray, "E 4"]) -> Float[np.ndarray, "F 4"]:
    """Return the planes without repetitions: Qhull cuts a flat facet into triangles with the same equation."""
    _, first = np.unique(equations.round(9), axis=0, return_index=True)
    return equations[np.sort(first)]
