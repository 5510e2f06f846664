"""Built-in rows of a job's task: a point, an axis or an orientation that is constrained.

    task:
      - {point: tcp, on: path}
      - {axis: tcp.z, towards: -path.normal, cone_deg: 60}
      - {tool_axis: tcp.z, work_angle_deg: 15, travel_angle_deg: [5, 15]}

The names of frames are tcp, or those of sites and bodies of the model. This module contains data only, and does not
import JAX; `rows_of_spec` computes with the rows.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from typing import Any, ClassVar

from htcp_jax.errors import InputError
from htcp_jax.spec.built_in_row import DIRECTIONS, BuiltInRow, axis_parts, check_axis
from htcp_jax.spec.kinds import kind_fault
from htcp_jax.spec.registry import Registry
from htcp_jax.spec.task_row_kind import TaskRowKind
from htcp_jax.spec.tool_angles import ToolAxisRow
from htcp_jax.types import Triple


@dataclass(frozen=True)
class PointRow(BuiltInRow):
    """A point of the arm that is constrained to the path, to a position, or to a plane or a line.

    For a point on the path, `frame` is the frame of `axes`, and may also be path: x along the tangent, z along the
    normal.

    Raises:
        InputError: For an invalid position or direction, and for fields that are missing.
    """

    name: ClassVar[str] = "point"

    point: str  # name of a frame
    offset_m: Triple = (0.0, 0.0, 0.0)  # position of the point in that frame
    on: str | Triple | None = None  # path, plane, line, or a position [m]
    through_m: Triple | None = None  # a point of the plane or the line
    normal: Triple | None = None  # normal of the plane, any length
    direction: Triple | None = None  # direction of the line, any length
    axes: str = "xyz"  # constrained coordinates of a point on the path or at a position
    frame: str = "world"
    within_m: float | None = None  # tolerance to both sides in each direction; None: an equality

    def __post_init__(self):
        self._check_frame()
        if self.on is None or (isinstance(self.on, str) and self.on not in ("path", "plane", "line")):
            raise InputError(f"on is {self.on!r}; valid: path, plane, line, or x,y,z in metres")
        if self.is_on_surface:
            for name in ("through_m", "normal" if self.on == "plane" else "direction"):
                if getattr(self, name) is None:
                    raise InputError(f"set {name} for a point on a {self.on}")
        for name in ("normal", "direction"):
            if (vector := getattr(self, name)) is not None and not math.hypot(*vector) > 0:
                raise InputError(f"{name} is zero; it must have a direction")
        if not self.axes or any(axis not in "xyz" for axis in self.axes) or sorted(set(self.axes)) != list(self.axes):
            raise InputError(f"axes is {self.axes!r}; valid: some of x, y, z, in this order")
        if self.frame == "path" and not self.follows_path:
            raise InputError("frame: path is only for a point on the path; valid: world, workpiece")
        if self.within_m is not None and not 0 < self.within_m <= 1e3:
            raise InputError(f"within_m is {self.within_m:g}; it must be more than 0 and finite")

    @property
    def follows_path(self) -> bool:
        """True if the point is constrained to the path."""
        return self.on == "path"

    @property
    def is_on_surface(self) -> bool:
        """True if the point is constrained to a plane or a line."""
        return self.on in ("plane", "line")

    @property
    def limit(self) -> float | None:
        """Tolerance to both sides in each direction [m]; None if the row is an equality."""
        return self.within_m

    @property
    def is_in_world(self) -> bool:
        """True if the row's position, direction or constrained axes are in the world's frame."""
        return self.frame == "world" and not (self.follows_path and self.axes == "xyz" and self.within_m is None)

    @property
    def uses(self) -> set[str]:
        """Names of the path's directions that the row requires."""
        return {"normals", "tangents"} if self.frame == "path" else set()


@dataclass(frozen=True)
class AxisRow(BuiltInRow):
    """An axis that must point in a direction, or at a position, exactly or within a cone.

    Raises:
        InputError: For an invalid axis or direction, for fields that contradict each other, and for an angle out of
            range.
    """

    name: ClassVar[str] = "axis"
    angular: ClassVar[bool] = True

    axis: str  # axis of a frame, such as tcp.z or its reverse -tcp.z; or one of DIRECTIONS
    towards: str | Triple | None = None  # one of DIRECTIONS, or three numbers, any length
    looks_at_m: Triple | None = None  # position to which the axis points from the origin of its frame
    frame: str = "world"
    cone_deg: float | None = None  # half angle about the direction [degrees, pi rad are 180]; 0 or None: an equality
    within_deg: float | None = None  # as cone_deg

    def __post_init__(self):
        self._check_frame()
        if not self.is_of_path:
            check_axis("axis", self.axis, " or path.normal")
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
        if self.frame == "path" and not isinstance(self.towards, tuple):
            raise InputError("frame: path is for towards: [x, y, z], with x along the tangent and z along the normal")
        self._check_angles("cone_deg", "within_deg")

    @property
    def is_of_path(self) -> bool:
        """True if the axis is the path's normal or tangent, which points in a world direction."""
        return self.axis in DIRECTIONS

    @property
    def along_path(self) -> str | None:
        """The path's direction that the row compares with the arm or the world; None if there is none."""
        return next((name for name in (self.axis, self.towards) if name in DIRECTIONS), None)

    @property
    def is_in_world(self) -> bool:
        """True if the row's direction or position is in the world's frame."""
        return self.frame == "world" and not isinstance(self.towards, str)

    @property
    def limit(self) -> float | None:
        """Half angle of the cone [degrees]; None if the row is an equality."""
        return self.cone_deg or self.within_deg or None

    @property
    def axis_of(self) -> tuple[str, int, float]:
        """Name of the axis's frame, the index of the axis, and its sign, 1 or -1."""
        return axis_parts(self.axis)

    @property
    def uses(self) -> set[str]:
        """Names of the path's directions that the row requires."""
        if self.frame == "path":
            return {"normals", "tangents"}
        return {f"{self.along_path.rpartition('.')[2]}s"} if self.along_path else set()


@dataclass(frozen=True)
class OrientationRow(BuiltInRow):
    """A frame of the arm that must have a given orientation, exactly or within an angle.

    Raises:
        InputError: For an invalid orientation or frame, and for an angle out of range.
    """

    name: ClassVar[str] = "orientation"
    angular: ClassVar[bool] = True

    orientation: str | tuple[float, float, float, float]  # path, or a quaternion without a unit, w first
    of: str = "tcp"  # name of the frame
    frame: str = "world"
    within_deg: float | None = None  # tolerance [degrees, pi rad are 180]; 0 or None: an equality

    def __post_init__(self):
        self._check_frame()
        if self.frame == "path":
            raise InputError("frame: path is not valid here; set orientation: path")
        if isinstance(self.orientation, str) and self.orientation != "path":
            raise InputError(f"orientation is {self.orientation!r}; valid: path, or a quaternion w,x,y,z")
        if isinstance(self.orientation, tuple) and not math.hypot(*self.orientation) > 0:
            raise InputError("orientation is a quaternion of length 0")
        self._check_angles("within_deg")

    def __str__(self) -> str:
        return f"orientation {self.of}"

    @property
    def is_in_world(self) -> bool:
        """True if the row's orientation is in the world's frame."""
        return self.frame == "world" and self.orientation != "path"

    @property
    def limit(self) -> float | None:
        """Tolerance of the angle [degrees]; None if the row is an equality."""
        return self.within_deg or None

    @property
    def uses(self) -> set[str]:
        """Names of the path's directions that the row requires."""
        return {"rotations"} if self.orientation == "path" else set()


TCP_ON_PATH = PointRow(point="tcp", on="path")  # the paper's task, and the default
BUILT_IN: dict[str, type[BuiltInRow]] = {row.name: row for row in (PointRow, AxisRow, OrientationRow, ToolAxisRow)}
# A record of a built-in row has the keys of all classes.
RECORD = {key.name: None if key.default is MISSING else key.default for row in BUILT_IN.values() for key in fields(row)}


def built_in_class(raw: Mapping[str, Any]) -> tuple[type[BuiltInRow], dict[str, Any]]:
    """Return the class of a row that is written without `kind`, and the keys of this class.

    Args:
        raw: The row; keys of other classes may have their defaults, as in records.

    Raises:
        InputError: If not exactly one of point, axis, orientation and tool_axis is given, or for another class's key.
    """
    given = [name for name in BUILT_IN if raw.get(name) is not None]
    if len(given) != 1:
        raise InputError(f"a row must have one of {', '.join(BUILT_IN)}; this row has {' and '.join(given) or 'none'}")
    row = TASK_ROWS.find(given[0])
    keys = [key.name for key in fields(row)]
    for name, default in RECORD.items():
        value = raw.get(name, default)
        if name not in keys and (tuple(value) if isinstance(value, list) else value) != default:
            raise InputError(f"{name} is not a key of a {row.name} row; valid: {', '.join(keys[1:])}")
    return row, {name: raw[name] for name in keys if name in raw}


def path_row(rows: Sequence[TaskRowKind]) -> PointRow | None:
    """Return the first row that constrains a point to the path; None if there is none."""
    return next((row for row in rows if isinstance(row, PointRow) and row.follows_path), None)


def _row_fault(kind: Any) -> str:
    return kind_fault(kind, TaskRowKind, ["features"]) or kind_fault(kind, TaskRowKind, ["error", "slack"])


TASK_ROWS = Registry("htcp_jax.task_rows", "kind of task row", _row_fault, BUILT_IN)
