"""The task of a job file: a list of rows, each a point, an axis or an orientation that is constrained.

    task:
      - {point: tcp, on: path}
      - {axis: tcp.z, towards: -path.normal, cone_deg: 60}

`goals` converts them to the planner's kinds of rows, with goals at every target, by `listed_rows`. This module does
without JAX until a method is called, as it reads a job.
"""

import math
from dataclasses import dataclass, fields
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.model.task_row_kind import PlacedPath, TaskRowKind
from htcp_jax.types import Triple

if TYPE_CHECKING:
    from htcp_jax.model.robot import Robot
    from htcp_jax.model.task_rows import Row

FRAMES = "world", "workpiece", "path"
DIRECTIONS = "path.normal", "-path.normal", "path.tangent", "-path.tangent"
# Allowed keys by the key that names the row's kind.
KINDS = {
    "point": ("offset_m", "on", "through_m", "normal", "direction", "axes", "frame", "within_m"),
    "axis": ("towards", "looks_at_m", "frame", "cone_deg", "within_deg"),
    "orientation": ("of", "frame", "within_deg"),
}
NEEDED = {"path": (), "plane": ("through_m", "normal"), "line": ("through_m", "direction")}


@dataclass(frozen=True)
class TaskRow(TaskRowKind):
    """One row; `KINDS` lists which fields belong together.

    A name is the TCP's, tcp, or that of a site or body of the model. frame: for places and directions given in numbers,
    the workpiece's or the world's; for a point on the path, the frame of its axes, which may also be the path's own,
    with x along the tangent and z along the normal. If the part moves, the chain's root is its link, and directions of
    the world are features of the link that the world is.

    Raises:
        InputError: For fields that do not belong together, an invalid place or direction, and an angle out of its
            range.
    """

    name: ClassVar[str] = "built-in"
    sampled: ClassVar[bool] = False

    point: str | None = None  # a name
    offset_m: Triple = (0.0, 0.0, 0.0)  # of the point, in the frame of that name
    on: str | Triple | None = None  # path, plane, line, or a place [m]
    through_m: Triple | None = None  # a point of the plane or the line
    normal: Triple | None = None  # of the plane, any length
    direction: Triple | None = None  # of the line, any length
    axes: str = "xyz"  # in which a point on the path or at a place is constrained
    frame: str = "world"
    within_m: float | None = None  # tolerance to both sides in each direction; None: exactly
    axis: str | None = None  # a name and x, y or z of its frame, tcp.z; a minus reverses it; or one of DIRECTIONS
    towards: str | Triple | None = None  # one of DIRECTIONS, or in numbers, of any length
    looks_at_m: Triple | None = None  # a place, from the origin of the axis's frame
    cone_deg: float | None = None  # half angle [degrees, pi rad are 180]; 0 or None: exactly
    within_deg: float | None = None  # the same, and of an orientation [degrees, pi rad are 180]
    orientation: str | tuple[float, float, float, float] | None = None  # path, or a quaternion without a unit, w first
    of: str = "tcp"  # a name: whose orientation

    def __post_init__(self):
        given = [name for name in KINDS if getattr(self, name) is not None]
        if len(given) != 1:
            raise InputError(f"a row is one of {', '.join(KINDS)}; this one is {' and '.join(given) or 'none of them'}")
        self._check_keys(given[0])
        if self.frame not in FRAMES:
            raise InputError(f"frame is {self.frame!r}; valid: {', '.join(FRAMES)}")
        {"point": self._check_point, "axis": self._check_axis, "orientation": self._check_orientation}[given[0]]()
        for name in ("cone_deg", "within_deg"):
            value = getattr(self, name)
            if value is not None and not 0 <= value <= 180:
                raise InputError(f"{name} is {value:g}; it must be 0 to 180")
        if self.within_m is not None and not 0 < self.within_m <= 1e3:
            raise InputError(f"within_m is {self.within_m:g}; it must be more than 0 and finite")

    @property
    def angular(self) -> bool:
        """True for an axis and for an orientation."""
        return self.point is None

    def part(self, robot: "Robot") -> "Row":
        """Return the row for a robot. Raises InputError for a name that it lacks, and for a place in a moving world."""
        if robot.part_moves and self.is_in_world and (self.point is not None or self.looks_at_m is not None):
            valid = "workpiece" if self.angular else "workpiece, path"
            raise InputError(f"frame is world, and the part moves; valid for a place: {valid}")
        return _listed_rows().row_of_task(self, robot)

    def goals(self, part: "Row", posed: PlacedPath) -> Float[np.ndarray, "T g"]:
        """Return the goals of the row at the points of the path."""
        return _listed_rows().goals_of_row(self, part, posed)

    def drawn(self, part: "Row", rng: np.random.Generator) -> Float[np.ndarray, "g"]:
        """Return a random goal."""
        return part.drawn(rng)

    @property
    def is_in_world(self) -> bool:
        """True if places, directions or axes of the row are the world's."""
        by_axes = self.axes != "xyz" or self.within_m is not None
        given = self.towards, self.orientation, self.looks_at_m, self.on
        numbers = any(isinstance(each, tuple) for each in given) or self.on in ("plane", "line")
        return self.frame == "world" and (numbers or (self.on == "path" and by_axes))

    @property
    def is_of_path(self) -> bool:
        """True for an axis that is the path's normal or tangent, towards a direction in the world."""
        return self.axis in DIRECTIONS

    @property
    def limit_deg(self) -> float | None:
        """Half angle of a cone or an angle tolerance; None if the row is an equality."""
        return (self.cone_deg if self.cone_deg is not None else self.within_deg) or None

    @property
    def axis_of(self) -> tuple[str, int, float]:
        """Name of an axis's frame, the index of the axis, and its sign, 1 or -1."""
        name, _, letter = self.axis.lstrip("-").rpartition(".")
        return name, "xyz".index(letter), -1.0 if self.axis.startswith("-") else 1.0

    @property
    def uses(self) -> set[str]:
        """Path frames that the row requires: normals, tangents, rotations."""
        found = {"rotations"} if self.orientation == "path" else set()
        if (direction := self.axis if self.is_of_path else self.towards) in DIRECTIONS:
            found.add("normals" if direction.endswith("normal") else "tangents")
        return found | ({"normals", "tangents"} if self.on == "path" and self.frame == "path" else set())

    def __str__(self) -> str:
        what = next(name for name in KINDS if getattr(self, name) is not None)
        return f"{what} {getattr(self, what) if what != 'orientation' else self.of}"

    def _check_keys(self, kind: str) -> None:
        for field in fields(self):
            stated = getattr(self, field.name) != field.default
            if stated and field.name != kind and field.name not in KINDS[kind]:
                raise InputError(f"{field.name} is not a key of a row of {kind}; valid: {', '.join(KINDS[kind])}")

    def _check_point(self) -> None:
        if self.on is None or (isinstance(self.on, str) and self.on not in NEEDED):
            raise InputError(f"on is {self.on!r}; valid: {', '.join(NEEDED)}, or x,y,z in metres")
        for name in NEEDED[self.on] if isinstance(self.on, str) else ():
            if getattr(self, name) is None:
                raise InputError(f"a point on a {self.on} needs {name}")
        for name in ("normal", "direction"):
            if (vector := getattr(self, name)) is not None and not math.hypot(*vector) > 0:
                raise InputError(f"{name} is zero; it must point somewhere")
        if not self.axes or any(axis not in "xyz" for axis in self.axes) or sorted(set(self.axes)) != list(self.axes):
            raise InputError(f"axes is {self.axes!r}; valid: some of x, y, z, in this order")
        if self.frame == "path" and self.on != "path":
            raise InputError("frame is path, which a point on the path alone has; valid: world, workpiece")

    def _check_axis(self) -> None:
        name, dot, letter = self.axis.lstrip("-").rpartition(".")
        if not self.is_of_path and (not name or not dot or letter not in ("x", "y", "z")):
            raise InputError(f"axis is {self.axis!r}; it is a name and x, y or z, as in tcp.z, or a path's direction")
        if self.is_of_path and not (isinstance(self.towards, tuple) and self.frame == "world"):
            raise InputError(f"axis is {self.axis}, the part's own; it needs towards: [x, y, z] in frame: world")
        if (self.towards is None) == (self.looks_at_m is None):
            raise InputError(f"an axis needs either towards ({', '.join(DIRECTIONS)}, or x,y,z) or looks_at_m")
        if isinstance(self.towards, str) and self.towards not in DIRECTIONS:
            raise InputError(f"towards is {self.towards!r}; valid: {', '.join(DIRECTIONS)}, or x,y,z")
        if isinstance(self.towards, tuple) and not math.hypot(*self.towards) > 0:
            raise InputError("towards is zero; it must point somewhere")
        if self.cone_deg is not None and self.within_deg is not None:
            raise InputError("cone_deg and within_deg are the same; leave out one")
        if self.frame == "path":
            raise InputError("frame is path; write towards: path.tangent or path.normal")

    def _check_orientation(self) -> None:
        if self.frame == "path":
            raise InputError("frame is path; write orientation: path")
        if isinstance(self.orientation, str) and self.orientation != "path":
            raise InputError(f"orientation is {self.orientation!r}; valid: path, or a quaternion w,x,y,z")
        if isinstance(self.orientation, tuple) and not math.hypot(*self.orientation) > 0:
            raise InputError("orientation is a quaternion of length 0")


def _listed_rows() -> ModuleType:
    """Return the module that computes, imported when it is used, as it imports JAX."""
    return import_module("htcp_jax.model.listed_rows")
