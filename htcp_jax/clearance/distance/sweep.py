"""Motion of bodies about a configuration, and the clearance that is required along it."""

from typing import NamedTuple

from htcp_jax.types import Array, Float, Scalar


class BodySweep(NamedTuple):
    """Bounds on the motion of K bodies about their positions, along a joint path that extends to both sides."""

    p: Float[Array, "K 3"]  # travel of each axis's first end along its velocity, to either side [m]
    q: Float[Array, "K 3"]  # the same for the second end
    bend: Float[Array, "K"]  # largest distance of any point of the axis from that linear motion [m]
    travel: Float[Array, "K"]  # largest distance from its position in the middle [m]


class RequiredClearance(NamedTuple):
    """Clearance that bodies have to keep [m]."""

    least: Scalar  # required
    enough: Scalar  # larger values need not be computed
