"""The task of a job file: a list of rows, each a point, an axis or an orientation that is constrained.

    task:
      - {point: tcp, on: path}
      - {axis: tcp.z, towards: -path.normal, cone_deg: 60}

`goals` and `listed_rows` convert the list to the planner's rows and their goals at every target. This module reads
jobs, and does not import JAX until a method is called.
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
    """One row of a task list; `KINDS` lists the fields that may be combined.

    A name is tcp, or the name of a site or body of the model. `frame` is world or workpiece, for positions and
    directions given as numbers. For a point on the path it is the frame of `axes`, and may also be path: x along the
    tangent, z along the normal. If the part moves, the chain's root is the part's link, and world directions are
    features of the link to which the workshop is fixed.

    Raises:
        InputError: For fields that may not be combined, an invalid position or direction, and an angle out of range.
    """

    name: ClassVar[str] = "built-in"
    sampled: ClassVar[bool] = False

    point: str | None = None  # name of a frame, see above
    offset_m: Triple = (0.0, 0.0, 0.0)  # position of the point in that frame
    on: str | Triple | None = None  # path, plane, line, or a position [m]
    through_m: Triple | None = None  # a point of the plane or the line
    normal: Triple | None = None  # normal of the plane, any length
    direction: Triple | None = None  # direction of the line, any length
    axes: str = "xyz"  # constrained coordinates of a point on the path or at a position
    frame: str = "world"
    within_m: float | None = None  # tolerance to both sides in each direction; None: an equality
    axis: str | None = None  # axis of a frame, such as tcp.z or its reverse -tcp.z; or one of DIRECTIONS
    towards: str | Triple | None = None  # one of DIRECTIONS, or three numbers, any length
    looks_at_m: Triple | None = None  # position to which the axis points from the origin of its frame
    cone_deg: float | None = None  # half angle about the direction [degrees, pi rad are 180]; 0 or None: an equality
    within_deg: float | None = None  # as cone_deg; for an orientation its tolerance [degrees, pi rad are 180]
    orientation: str | tuple[float, float, float, float] | None = None  # path, or a quaternion without a unit, w first
    of: str = "tcp"  # name of the frame that `orientation` constrains

    def __post_init__(self):
        given = [name for name in KINDS if getattr(self, name) is not None]
        if len(given) != 1:
            raise InputError(f"a row must have one of {', '.join(KINDS)}; this row has {' and '.join(given) or 'none'}")
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
        """Return the planner's row for a robot.

        Raises:
            InputError: For a name that the robot lacks, and for a position in the world if the part moves.
        """
        if robot.part_moves and self.is_in_world and (self.point is not None or self.looks_at_m is not None):
            valid = "workpiece" if self.angular else "workpiece, path"
            raise InputError(f"frame is world, but the part moves; valid for a position: {valid}")
        return _listed_rows().row_of_task(self, robot)

    def goals(self, part: "Row", posed: PlacedPath) -> Float[np.ndarray, "T g"]:
        """Return the goals of the row at the T points of the path."""
        return _listed_rows().goals_of_row(self, part, posed)

    def drawn(self, part: "Row", rng: np.random.Generator) -> Float[np.ndarray, "g"]:
        """Return a random goal, for checks of the task's rank."""
        return part.drawn(rng)

    @property
    def is_in_world(self) -> bool:
        """True if the row's positions, directions or constrained axes are in the world's frame."""
        by_axes = self.axes != "xyz" or self.within_m is not None
        given = self.towards, self.orientation, self.looks_at_m, self.on
        numbers = any(isinstance(each, tuple) for each in given) or self.on in ("plane", "line")
        return self.frame == "world" and (numbers or (self.on == "path" and by_axes))

    @property
    def is_of_path(self) -> bool:
        """True if the row's axis is the path's normal or tangent, which points in a world direction."""
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
        """Names of the path's data that the row requires: normals, tangents, rotations."""
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
                raise InputError(f"{field.name} is not a key of a {kind} row; valid: {', '.join(KINDS[kind])}")

    def _check_point(self) -> None:
        if self.on is None or (isinstance(self.on, str) and self.on not in NEEDED):
            raise InputError(f"on is {self.on!r}; valid: {', '.join(NEEDED)}, or x,y,z in metres")
        for name in NEEDED[self.on] if isinstance(self.on, str) else ():
            if getattr(self, name) is None:
                raise InputError(f"set {name} for a point on a {self.on}")
        for name in ("normal", "direction"):
            if (vector := getattr(self, name)) is not None and not math.hypot(*vector) > 0:
                raise InputError(f"{name} is zero; it must have a direction")
        if not self.axes or any(axis not in "xyz" for axis in self.axes) or sorted(set(self.axes)) != list(self.axes):
            raise InputError(f"axes is {self.axes!r}; valid: some of x, y, z, in this order")
        if self.frame == "path" and self.on != "path":
            raise InputError("frame: path is only for a point on the path; valid: world, workpiece")

    def _check_axis(self) -> None:
        name, dot, letter = self.axis.lstrip("-").rpartition(".")
        if not self.is_of_path and (not name or not dot or letter not in ("x", "y", "z")):
            raise InputError(
                f"axis is {self.axis!r}; it must be like tcp.z (a frame's name, a dot and x, y or z) or path.normal"
            )
        if self.is_of_path and not (isinstance(self.towards, tuple) and self.frame == "world"):
            raise InputError(f"axis is {self.axis}, a direction of the part; set towards: [x, y, z] and frame: world")
        if (self.towards is None) == (self.looks_at_m is None):
            raise InputError(f"set either towards ({', '.join(DIRECTIONS)}, or x,y,z) or looks_at_m for an axis")
        if isinstance(self.towards, str) and self.towards not in DIRECTIONS:
            raise InputError(f"towards is {self.towards!r}; valid: {', '.join(DIRECTIONS)}, or x,y,z")
        if isinstance(self.towards, tuple) and not math.hypot(*self.towards) > 0:
            raise InputError("towards is zero; it must have a direction")
        if self.cone_deg is not None and self.within_deg is not None:
            raise InputError("cone_deg and within_deg mean the same; omit one")
        if self.frame == "path":
            raise InputError("frame: path is not valid here; set towards: path.tangent or path.normal")

    def _check_orientation(self) -> None:
        if self.frame == "path":
            raise InputError("frame: path is not valid here; set orientation: path")
        if isinstance(self.orientation, str) and self.orientation != "path":
            raise InputError(f"orientation is {self.orientation!r}; valid: path, or a quaternion w,x,y,z")
        if isinstance(self.orientation, tuple) and not math.hypot(*self.orientation) > 0:
            raise InputError("orientation is a quaternion of length 0")


def _listed_rows() -> ModuleType:
    """Import module `listed_rows` on first use, as it imports JAX."""
    return import_module("htcp_jax.model.listed_rows")
