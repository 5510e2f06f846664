"""Fixtures that move with a link, for validation: exact convex bodies, placed by MuJoCo's kinematics.

The planner encloses them in capsules, whose clearance is a lower bound. Here the box, or the convex hull of the mesh,
is measured: by mj_geomDistance against solids and the arm's capsules (`mujoco_cell`), and in this module against the
points or triangles of a wall. The distance of two polyhedra that do not intersect is that of an edge of one and a face
of the other.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from htcp_jax.validation.mesh_clearance import axis_distances
from htcp_jax.validation.mujoco_arm import MujocoArm


class CarriedBody(NamedTuple):
    """A convex body that a moving link carries."""

    geom: int  # in the cell's model
    parent: str
    link: int  # of the parent; 0: fixed to the world
    excluded: frozenset[int]  # links that it is not tested against
    R: Float[np.ndarray, "3 3"]  # pose of the geom in the parent's frame
    t: Float[np.ndarray, "3"]
    corners: Float[np.ndarray, "V 3"]  # in the geom's frame [m]
    arm: MujocoArm

    def poses(self, x: Float[np.ndarray, "n N"]) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"]]:
        """Position [m] and axes of the geom at configurations x, world."""
        origin, rotation = self.arm.frames(x, self.parent, tip=False)
        return origin + rotation @ self.t, rotation @ self.R

    @property
    def ball(self) -> tuple[Float[np.ndarray, "3"], float]:
        """Centre in the geom's frame, and radius, of a ball about the body [m]."""
        centre = (self.corners.min(axis=0) + self.corners.max(axis=0)) / 2
        return centre, float(np.linalg.norm(self.corners - centre, axis=1).max())

    def clearance(self, wall: Float[np.ndarray, "m C 3"]) -> float:
        """Smallest distance to points (C = 1) or triangles (C = 3) in the geom's frame [m].

        Negative, the depth, if a corner is inside; 0 if only an edge passes through a face.
        """
        hull = ConvexHull(self.corners)
        within = (wall.reshape(-1, 3) @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1).min()
        if within <= 0:
            return float(within)
        faces = self.corners[hull.simplices]
        edges = np.concatenate([np.stack([wall[:, k], wall[:, k - 1]], 1) for k in range(wall.shape[1])])
        found = _smallest(edges, faces)
        if wall.shape[1] > 1:
            own = np.unique(np.sort(np.concatenate([hull.simplices[:, [k, k - 1]] for k in range(3)]), axis=1), axis=0)
            found = min(found, _smallest(self.corners[own], wall))
        return found


def _smallest(edges: Float[np.ndarray, "e 2 3"], triangles: Float[np.ndarray, "m 3 3"]) -> float:
    """Smallest distance of any edge to any triangle [m]."""
    e, m = (index.ravel() for index in np.indices((len(edges), len(triangles))))
    return float(axis_distances(edges[e, 0], edges[e, 1], triangles[m]).min())
