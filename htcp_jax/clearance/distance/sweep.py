"""Motion of bodies about a configuration, and the clearance that is required along it."""

from typing import NamedTuple

from htcp_jax.types import Array, Bool, Float, Scalar


class BodySweep(NamedTuple):
    """Bounds on the motion of K bodies on an interval of a joint path, relative to their positions at its middle."""

    p: Float[Array, "K 3"]  # linear motion of each axis's first end from the middle to either end of the interval [m]
    q: Float[Array, "K 3"]  # linear motion of the second end [m]
    bend: Float[Array, "K"]  # largest distance of any point of the axis from its linear motion [m]
    travel: Float[Array, "K"]  # largest displacement of any point from its position at the middle [m]


class SweptCapsules(NamedTuple):
    """Capsules, and bounds on the displacement of their points."""

    p: Float[Array, "n 3"]  # first ends of the axes, world [m]
    q: Float[Array, "n 3"]  # second ends, world [m]
    radius: Float[Array, "n"]  # [m]
    moves: Float[Array, "n"]  # largest displacement of any point of the capsule [m]


class RequiredClearance(NamedTuple):
    """Clearance that a proof requires along a motion [m]."""

    requested: Bool[Array, "*K"]  # True for the bodies that a bound is computed for
    least: Scalar  # the required clearance [m]
    enough: Scalar  # clearances above this value need not be computed exactly [m]
