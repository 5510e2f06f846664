"""Seams of the generated duct that a job may name: its weld, and the beads in the table below.

A bead is a straight line on the wall in the coordinates of `duct.surface`: a side seam has a constant angle, a girth
seam a constant depth, and on a helix both change linearly. Its points are equally spaced by arc length, from the inlet
inwards; on a girth seam they run clockwise as seen from the inlet. Depths and angles are round numbers; the deep girth
seam begins where it is hardest to follow.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.model import duct


class Bead(NamedTuple):
    """Depths and angles at the first and the last point of a bead.

    As seen from the inlet with z up, angles run clockwise from the left side: 90 degrees is the crown (the line along
    the top), 180 the right side, 270 the invert (the line along the bottom).
    """

    x_m: tuple[float, float]
    angle_deg: tuple[float, float]
    points: int

    @property
    def closed(self) -> bool:
        """True if the bead is a closed loop; its last point is then one step before its first."""
        return self.x_m[0] == self.x_m[1] and abs(self.angle_deg[1] - self.angle_deg[0]) == 360.0


BEADS = {
    "left": Bead((0.2, 0.9), (0.0, 0.0), 90),
    "right": Bead((0.2, 0.9), (180.0, 180.0), 90),
    "crown": Bead((0.2, 0.9), (90.0, 90.0), 90),
    "invert": Bead((0.2, 0.9), (270.0, 270.0), 90),
    "girth-shallow": Bead((0.3, 0.3), (0.0, 360.0), 100),
    "girth-deep": Bead((0.8, 0.8), (0.0, 360.0), 100),
    "helix": Bead((0.2, 0.9), (0.0, 360.0), 110),
}


def seam(name: str) -> Float[np.ndarray, "P 3"]:
    """Return the P points [m] of a seam in SEAMS, in the duct's frame."""
    return duct.weld() if name == "weld" else _bead_points(BEADS[name])


def _bead_points(bead: Bead) -> Float[np.ndarray, "P 3"]:
    def on_the_wall(share: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n 3"]:
        x, angle = (first + share * (last - first) for first, last in (bead.x_m, np.deg2rad(bead.angle_deg)))
        return duct.surface(x, angle)

    return duct.equal_steps(on_the_wall, 1.0, bead.points, bead.closed)
