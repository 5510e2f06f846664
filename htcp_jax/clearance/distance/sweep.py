"""Motion of bodies about a configuration, and the clearance that is required along it."""

from typing import NamedTuple

from htcp_jax.types import Array, Float, Scalar


class BodySweep(NamedTuple):
    """Bounds on the motion of K bodies on an interval of a joint path, relative to their positions at its middle."""

    p: Float[Array, "K 3"]  # linear motion of each axis's first end from the middle to either end of the interval [m]
    q: Float[Array, "K 3"]  # linear motion of the second end [m]
    bend: Float[Array, "K"]  # largest distance of any point of the axis from its linear motion [m]
    travel: Float[Array, "K"]  # largest displacement of any point from its position at the middle [m]


class RequiredClearance(NamedTuple):
    """Clearance that a proof requires along a motion [m]."""

    least: Scalar  # the required clearance [m]
    enough: Scalar  # clearances above this value need not be computed exactly [m]
