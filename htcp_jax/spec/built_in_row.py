"""Base class of a task's built-in rows, and the names of axes and directions in them."""

from typing import ClassVar

from htcp_jax.errors import InputError
from htcp_jax.spec.task_row_kind import TaskRowKind

FRAMES = "world", "workpiece", "path"
DIRECTIONS = "path.normal", "-path.normal", "path.tangent", "-path.tangent"


class BuiltInRow(TaskRowKind):
    """Base class of the built-in rows.

    Attributes:
        frame: Frame of positions and directions given as numbers: world or workpiece. If the part moves, the chain's
            root is the part's link, and world directions are features of the link to which the workshop is fixed.
        limit: Tolerance of an inequality [m, degrees]; None if the row is an equality.
        is_in_world: True if the row's position, direction, orientation or constrained axes are in the world's frame.
        is_of_path: True if the row's axis is the path's normal or tangent, which points in a world direction.
    """

    sampled: ClassVar[bool] = False
    is_of_path: bool = False
    frame: str
    limit: float | None
    is_in_world: bool
    __pydantic_config__: ClassVar = {"allow_inf_nan": False}

    def __str__(self) -> str:
        return f"{self.name} {getattr(self, self.name)}"

    def _check_frame(self) -> None:
        if self.frame not in FRAMES:
            raise InputError(f"frame is {self.frame!r}; valid: {', '.join(FRAMES)}")

    def _check_angles(self, *names: str) -> None:
        for name in names:
            if (value := getattr(self, name)) is not None and not 0 <= value <= 180:
                raise InputError(f"{name} is {value:g}; it must be 0 to 180")


def check_axis(key: str, axis: str, others: str = "") -> None:
    """Check the name of a frame's axis, such as tcp.z or -tcp.z.

    Raises:
        InputError: If it is none; the message begins with the key and ends with `others`, further valid values.
    """
    name, dot, letter = axis.lstrip("-").rpartition(".")
    if not name or not dot or letter not in ("x", "y", "z"):
        raise InputError(f"{key} is {axis!r}; it must be like tcp.z (a frame's name, a dot and x, y or z){others}")


def axis_parts(axis: str) -> tuple[str, int, float]:
    """Return the name of an axis's frame, the index of the axis, and its sign, 1 or -1."""
    name, _, letter = axis.lstrip("-").rpartition(".")
    return name, "xyz".index(letter), -1.0 if axis.startswith("-") else 1.0
