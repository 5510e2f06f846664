"""Fixtures that move with a link, for validation: exact convex bodies, placed by MuJoCo's kinematics.

The planner encloses these fixtures in capsules, whose clearance is a lower bound. Validation measures the exact box, or
the convex hull of the mesh. Distances to solids and to the arm's capsules are computed by mj_geomDistance
(`mujoco_cell`), distances to a wall's points or triangles by `convex_hull`.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.validation.convex_hull import Hull
from htcp_jax.validation.mujoco_arm import MujocoArm


class CarriedBody(NamedTuple):
    """Convex body of a fixture that moves with a link."""

    geom: int  # index in the cell's model
    parent: str
    link: int  # link of the parent frame; 0: fixed to the world
    excluded: frozenset[int]  # links from which no distance is checked
    R: Float[np.ndarray, "3 3"]  # rotation R and translation t of the geom in the parent's frame
    t: Float[np.ndarray, "3"]
    corners: Float[np.ndarray, "V 3"]  # corners of the body in the geom's frame [m]
    arm: MujocoArm

    def poses(self, x: Float[np.ndarray, "n N"]) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"]]:
        """Return the geom's positions [m] and axes in the world at configurations x [rad or m]."""
        origin, rotation = self.arm.frames(x, self.parent, tip=False)
        return origin + rotation @ self.t, rotation @ self.R

    @property
    def ball(self) -> tuple[Float[np.ndarray, "3"], float]:
        """Centre, in the geom's frame, and radius of a ball that encloses the body [m]."""
        centre = (self.corners.min(axis=0) + self.corners.max(axis=0)) / 2
        return centre, float(np.linalg.norm(self.corners - centre, axis=1).max())

    def clearance(self, wall: Float[np.ndarray, "m C 3"]) -> float:
        """Return the smallest distance of the body from points or triangles [m].

        The result is negative, the negated depth, if a corner of the wall is inside. It is 0 if only an edge passes
        through a face.

        Args:
            wall: The points (C = 1) or the triangles' corners (C = 3) in the geom's frame [m].
        """
        return Hull(self.corners).clearance(wall)
