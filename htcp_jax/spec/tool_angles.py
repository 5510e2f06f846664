"""Row of a task with the angles of a tool along a path, as welders and grinders state them.

    task:
      - {point: tcp, on: path}
      - {tool_axis: tcp.z, work_angle_deg: 15, travel_angle_deg: [5, 15], spin_deg: free}

With n the path's normal, t its tangent in the direction of travel, and h the tool's direction from tip to handle:

    work angle      in the plane across the seam: from n to h, positive towards n x t
    travel angle    in the plane of t and n: from n to h, positive (push) if h leans against the direction of travel
    spin            about the tool's axis: from the direction of travel to the tool's next axis
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator

from htcp_jax.errors import InputError
from htcp_jax.spec.built_in_row import BuiltInRow, axis_parts, check_axis
from htcp_jax.spec.task_row_kind import TaskRowKind


def _angle(value: Any) -> Any:
    """Return an angle or a range as numbers; any other value is refused."""
    numbers = value if isinstance(value, list | tuple) else [value]
    try:
        found = tuple(float(number) for number in numbers if not isinstance(number, bool))
    except (TypeError, ValueError):
        found = ()
    if value == "free":
        return value
    if len(found) != len(numbers) or not len(found) == (2 if numbers is value else 1):
        raise InputError(f"{value!r} is no angle; valid: a number of degrees, a range such as [42, 48], or free")
    return found if numbers is value else found[0]


# Any angle, one angle, or a range [degrees].
Angle = Annotated[Literal["free"] | float | tuple[float, float], BeforeValidator(_angle)]
PLATES = "plate_1", "plate_2"
TOOL_ANGLES = "work_angle_deg", "travel_angle_deg", "spin_deg"


@dataclass(frozen=True)
class ToolAxisRow(BuiltInRow):
    """The angles of a tool's axis along a path. Each is one angle, a range of two angles, or free.

    Raises:
        InputError: For an invalid axis, an empty range, an angle out of range, and a row without any angle.
    """

    name: ClassVar[str] = "tool_axis"
    angular: ClassVar[bool] = True
    frame: ClassVar[str] = "workpiece"  # the row has no numbers in a frame
    is_in_world: ClassVar[bool] = False
    limit: ClassVar[float | None] = None

    tool_axis: str  # axis of a frame from the tool's handle to its tip, such as tcp.z, or its reverse -tcp.z
    work_angle_deg: Angle = "free"
    travel_angle_deg: Angle = "free"
    spin_deg: Angle = "free"
    work_angle_from: str = "normal"  # normal; or plate_1 or plate_2: the work angle from that plate's surface

    def __post_init__(self):
        check_axis("tool_axis", self.tool_axis)
        for name, value in self.angles():
            if value == "free":
                continue
            lower, upper = self.bounds_deg(name)
            least, most = self._limits(name)
            if isinstance(value, tuple) and not lower < upper:
                way = f"write {lower:g}" if lower == upper else "the first angle must be less"
                if name == "spin_deg" and upper + 180 <= lower < upper + 360:
                    way = f"for a range across 180 write [{lower:g}, {upper + 360:g}]"
                raise InputError(f"{name} is the empty range {lower:g} to {upper:g}; {way}")
            if not least <= lower <= upper <= most:
                shown = f"{lower:g} to {upper:g}" if isinstance(value, tuple) else f"{lower:g}"
                raise InputError(f"{name} is {shown}; it must be {least} to {most}, or free")
            if upper - lower > 180:
                raise InputError(f"{name} is a range of {upper - lower:g} degrees; at most 180 are possible, or free")
            if not isinstance(value, tuple) and name != "spin_deg" and not least < value < most:
                raise InputError(f"{name} is {value:g}; it must be between {least} and {most}")
        if all(value == "free" for _, value in self.angles()):
            raise InputError(f"all angles are free; set at least one of {', '.join(TOOL_ANGLES)}")
        if self.work_angle_from not in ("normal", *PLATES):
            raise InputError(f"work_angle_from is {self.work_angle_from!r}; valid: normal, {', '.join(PLATES)}")
        if self.work_angle_from != "normal" and self.work_angle_deg == "free":
            raise InputError("work_angle_from would have no effect, because work_angle_deg is free; omit it")

    def angles(self) -> Iterator[tuple[str, Angle]]:
        """Return the names of the three angles, and what the row says about them."""
        return ((name, getattr(self, name)) for name in TOOL_ANGLES)

    def bounds_deg(self, name: str) -> tuple[float, float]:
        """Return the smallest and the largest allowed value of an angle that is not free [degrees]."""
        value = getattr(self, name)
        return value if isinstance(value, tuple) else (value, value)

    @property
    def axis_of(self) -> tuple[str, int, float]:
        """Name of the axis's frame, the index of the axis, and its sign, 1 or -1."""
        return axis_parts(self.tool_axis)

    @property
    def plate(self) -> int | None:
        """Index of the plate from whose surface the work angle is measured, 0 or 1; None: from the normal."""
        return None if self.work_angle_from == "normal" else PLATES.index(self.work_angle_from)

    @property
    def uses(self) -> set[str]:
        """Names of the path's directions that the row requires."""
        plates = {"plates"} if self.work_angle_from != "normal" else set()
        return {"normals", "tangents"} | plates

    def _limits(self, name: str) -> tuple[int, int]:
        if name == "spin_deg":
            return -360, 360
        return (0, 180) if name == "work_angle_deg" and self.work_angle_from != "normal" else (-90, 90)


def tool_axis_row(rows: Sequence[TaskRowKind]) -> ToolAxisRow | None:
    """Return the first row with tool angles; None if there is none."""
    return next((row for row in rows if isinstance(row, ToolAxisRow)), None)
