"""Kinds of obstacles of other packages, fixed in the world: one class with one method, the distance of a point.

See `given_obstacle` and docs/add-an-obstacle.md. This module does without JAX, as it reads a job.
"""

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

from htcp_jax.kinds import ExtensionKind, kind_fault
from htcp_jax.model import tool
from htcp_jax.registry import Registry
from htcp_jax.types import Scalar, Vector3


class ObstacleShape(NamedTuple):
    """A shape in the world for MuJoCo and for pictures, in metres and radians.

    type: plane, box, sphere, capsule or cylinder. size_m: as in MuJoCo: sphere (radius,); capsule and cylinder (radius,
    half length), along z; box: half its edges; a plane (), whose free side is +z. rpy_rad: about world x, then y, then
    z.
    """

    type: str
    size_m: Sequence[float] = ()
    position_m: Sequence[float] = tool.ZERO
    rpy_rad: Sequence[float] = tool.ZERO


class ObstacleKind(ExtensionKind):
    """A kind of obstacle: derive a frozen dataclass from it, and define `name` and `distance`.

    convex: True if the obstacle is convex: distances are exact then, and cheaper.
    """

    convex: ClassVar[bool] = False

    def distance(self, point: Vector3) -> Scalar:
        """Return the signed distance of a point in the world from the obstacle's surface [m], negative inside.

        Computed by jax.numpy: exact, or a lower bound. It must not change by more than the point moves.
        """
        raise NotImplementedError

    def shapes(self) -> Sequence[ObstacleShape]:
        """Return the shapes that it is made of, exactly, for `htcp validate` and for pictures; none: not known."""
        return ()


OBSTACLES = Registry(
    "htcp_jax.obstacles", "kind of obstacle", lambda kind: kind_fault(kind, ObstacleKind, ["distance"])
)
