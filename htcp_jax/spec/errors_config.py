"""Section `errors` of a job: half-widths of the errors of the part's place, the tool, the joints and the cloud."""

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from htcp_jax.errors import InputError
from htcp_jax.spec.strict_model import FileSection

LARGEST_M, LARGEST_RAD = 1.0, 1.0  # larger errors are usually in mm or degrees


def _three(value: Any) -> Any:
    """Return one number as three equal ones."""
    return (value,) * 3 if isinstance(value, int | float) and not isinstance(value, bool) else value


def _joints(value: Any) -> Any:
    """Return one number as a tuple of one."""
    return (value,) if isinstance(value, int | float) and not isinstance(value, bool) else value


Metres = Annotated[float, Field(ge=0, le=LARGEST_M)]
Radians = Annotated[float, Field(ge=0, le=LARGEST_RAD)]
ThreeMetres = Annotated[tuple[Metres, Metres, Metres], BeforeValidator(_three)]
ThreeRadians = Annotated[tuple[Radians, Radians, Radians], BeforeValidator(_three)]
Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]


def _about(value: Any) -> Any:
    if isinstance(value, str) and value not in ("path", "part"):
        raise InputError(f"{value!r} is not a centre; valid: path, part, or a point [x, y, z] in m")
    return value


About = Annotated[Literal["path", "part"] | tuple[Coordinate, Coordinate, Coordinate], BeforeValidator(_about)]


class PartErrors(FileSection):
    """Half-widths of the part's displacement."""

    shift_m: ThreeMetres = (0.0, 0.0, 0.0)  # along x, y, z of the world, or of the part's link if the part moves
    turn_rad: ThreeRadians = (0.0, 0.0, 0.0)  # of a rotation vector, about the same axes
    # point about which the part turns: the path's centroid, the origin of the part's frame, or a point in the world
    about: About = "path"


class ToolErrors(FileSection):
    """Half-widths of the tool's displacement on the flange."""

    shift_m: ThreeMetres = (0.0, 0.0, 0.0)  # along x, y, z of the flange
    turn_rad: ThreeRadians = (0.0, 0.0, 0.0)  # of a rotation vector, about the flange's origin


class ErrorsConfig(FileSection):
    """Half-widths of all errors; the errors are independent of each other."""

    part: PartErrors | None = None
    tool: ToolErrors | None = None
    # one number, or one per joint [rad or m]
    joints_rad: Annotated[tuple[Radians, ...], BeforeValidator(_joints)] | None = None
    cloud_m: Metres = 0.0  # distance of each of the part's points from its true place

    @model_validator(mode="after")
    def _has_an_error(self) -> "ErrorsConfig":
        part, tool = (() if own is None else (*own.shift_m, *own.turn_rad) for own in (self.part, self.tool))
        if not any((*part, *tool, *(self.joints_rad or ()), self.cloud_m)):
            raise InputError("errors has no value above 0; valid: part, tool, joints_rad, cloud_m")
        return self
