"""Base class for obstacles of other packages, fixed in the world: its main method is the distance of a point.

See `given_obstacle` and docs/add-an-obstacle.md. This module does not import JAX, as it is loaded to read a job.
"""

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

from htcp_jax.spec.kinds import ExtensionKind, kind_fault
from htcp_jax.spec.registry import Registry
from htcp_jax.types import Scalar, Vector3


class ObstacleShape(NamedTuple):
    """A shape in the world for MuJoCo and for pictures, in metres and radians.

    Attributes:
        type: plane, box, sphere, capsule or cylinder.
        size_m: Sizes as in MuJoCo. Sphere: radius. Capsule and cylinder, along z: radius, half length. Box: half of
            each edge. Plane: none; its free side is +z.
        position_m: Position of the shape's frame.
        rpy_rad: Rotations about world x, then y, then z.
    """

    type: str
    size_m: Sequence[float] = ()
    position_m: Sequence[float] = (0.0, 0.0, 0.0)
    rpy_rad: Sequence[float] = (0.0, 0.0, 0.0)


class ObstacleKind(ExtensionKind):
    """Base class of a kind of obstacle: derive a frozen dataclass from it, and define `name` and `distance`.

    Attributes:
        convex: Set it to True for a convex obstacle: distances of bodies are then exact and cheaper.
    """

    convex: ClassVar[bool] = False

    def distance(self, point: Vector3) -> Scalar:
        """Return the signed distance of a point in the world from the obstacle's surface [m], negative inside.

        Compute the distance by jax.numpy. It may be a lower bound, and must not change by more than the point moves.
        """
        raise NotImplementedError

    def shapes(self) -> Sequence[ObstacleShape]:
        """Return the shapes that the obstacle consists of exactly, for `htcp validate` and for pictures.

        Return none (the default) if they are not known.
        """
        return ()


OBSTACLES = Registry(
    "htcp_jax.obstacles", "kind of obstacle", lambda kind: kind_fault(kind, ObstacleKind, ["distance"])
)
