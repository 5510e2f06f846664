"""Fixtures that move with a link, for validation: exact convex bodies, placed by MuJoCo's kinematics.

The planner encloses them in capsules, whose clearance is a lower bound. Here the box, or the convex hull of the mesh,
is measured: by mj_geomDistance against solids and the arm's capsules (`mujoco_cell`), and by `convex_hull` against the
points or triangles of a wall.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.validation.convex_hull import Hull
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
        return Hull(self.corners).clearance(wall)
