"""Shapes fixed in the work cell."""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from htcp_jax.model.surface import area

PRIMITIVES = {"plane": 0, "box": 3, "sphere": 1, "capsule": 2, "cylinder": 2}  # shape -> number of its sizes
KINDS = (*PRIMITIVES, "mesh")
CONVEX = 1e-6  # tolerance of the convexity test, relative to the hull's size
MOST_FACES = 400  # maximum number of faces of a mesh treated as a convex solid; meshes with more faces are sampled


class Fixture(NamedTuple):
    """A shape in the world."""

    name: str
    kind: str  # one of KINDS
    T_world: Float[np.ndarray, "4 4"]  # MuJoCo's frame of the shape [m]; the world's for a mesh
    size: Float[np.ndarray, "3"]  # MuJoCo's sizes of the shape [m]
    triangles: Float[np.ndarray, "F 3 3"]  # triangles of a mesh, world [m]; empty for other shapes

    @property
    def surface(self) -> Float[np.ndarray, "F 3 3"]:
        """Triangles for pictures, world [m]; none for a plane."""
        import trimesh  # here, because it loads slowly and only pictures need it

        make, size = trimesh.creation, self.size
        if self.kind in ("mesh", "plane"):
            return self.triangles
        if self.kind == "box":
            drawn = make.box(extents=2 * size)
        elif self.kind == "sphere":
            drawn = make.icosphere(subdivisions=2, radius=size[0])
        elif self.kind == "cylinder":
            drawn = make.cylinder(radius=size[0], height=2 * size[1])
        else:
            drawn = make.capsule(radius=size[0], height=2 * size[1])
        own = np.asarray(drawn.triangles) - drawn.bounds.mean(axis=0)
        return own @ self.T_world[:3, :3].T + self.T_world[:3, 3]

    @property
    def convex(self) -> bool:
        """True if the mesh is a solid, see `is_solid`."""
        return is_solid(self.triangles)


def is_solid(triangles: Float[np.ndarray, "F 3 3"]) -> bool:
    """Return True if a mesh is closed and convex, and has at most MOST_FACES faces.

    A mesh is closed and convex if its triangles lie on its convex hull and have the hull's area. Any other mesh is a
    surface: its interior is not known.

    Args:
        triangles: Corners of the mesh's triangles [m].
    """
    if len(triangles) > MOST_FACES:
        return False
    try:
        hull = scipy.spatial.ConvexHull(triangles.reshape(-1, 3))
    except scipy.spatial.QhullError:
        return False
    normal, offset = hull.equations[:, :3], -hull.equations[:, 3]
    depth = (offset - triangles.mean(axis=1) @ normal.T).min(axis=1)
    alike = abs(area(triangles).sum() - hull.area) <= CONVEX * hull.area
    return bool(alike and depth.max() <= CONVEX * np.sqrt(hull.area))
