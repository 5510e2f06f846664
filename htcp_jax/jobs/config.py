"""Schema of a job file: the sections, their keys, and the default job.

A PlanConfig is made by `load_config`. Some defaults are for the GP50 and the duct; with another robot or another cloud
`defaults` replaces them.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PlainSerializer,
    PlainValidator,
    WrapSerializer,
    WrapValidator,
    field_validator,
    model_validator,
)

from htcp_jax.clearance.obstacles import obstacle_kind
from htcp_jax.errors import InputError
from htcp_jax.io import strict_model
from htcp_jax.jobs.config_file import BUILT_IN_ARM, DUCT, NO_CLOUD
from htcp_jax.jobs.feed import feed_of
from htcp_jax.jobs.given_kinds import given_kind_of, needs_kind, record_of
from htcp_jax.model import TaskRow, Tool, duct, task_row_kind
from htcp_jax.registry import NAME
from htcp_jax.settings import Settings

FARTHEST = 1e9  # of coordinates in files [m]
LARGEST = 1e6  # of lengths [m] and joint positions; beyond, rounding exceeds the tolerance
Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
PointM = tuple[Number, Number, Number]
FileCoordinate = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]
FilePointM = tuple[FileCoordinate, FileCoordinate, FileCoordinate]
Turn = Annotated[float, Field(ge=-2 * math.pi, le=2 * math.pi)]  # larger values are usually degrees
ApproachSteps = Annotated[int, Field(ge=0, le=10_000)]
FASTEST = 1e9  # of any rate or count
JointRates = tuple[Annotated[float, Field(gt=0, le=FASTEST)], ...]  # of the joints, in both directions
Moment = Annotated[float, Field(gt=0, le=100)]  # [s]
AUTO = "auto"  # a start that the planner chooses
WORLD = "world"  # the carrier of fixtures that stand still


def _start(value: Any, numbers: Callable[[Any], tuple[float, ...]]) -> Any:
    """Validate joint positions, or the word AUTO.

    Raises:
        InputError: For any other word.
    """
    if isinstance(value, str) and value != AUTO:
        raise InputError(f"{value!r} is not a start; valid: {AUTO}, or a list of joint positions")
    return value if value == AUTO else numbers(value)


def _column(value: Any) -> int | str:
    """Validate a column: its number from 1, or its name in the header.

    Raises:
        InputError: For anything else.
    """
    if (isinstance(value, int) and not isinstance(value, bool) and value >= 1) or (isinstance(value, str) and value):
        return value
    raise InputError(f"{value!r} is not a column; valid: a number from 1, or a name in the file's header")


def _locked(value: Any) -> Any:
    """Return the pairs of joint and value of a mapping.

    Raises:
        InputError: For anything else.
    """
    pairs = tuple(value.items()) if isinstance(value, dict) else value  # a record has pairs
    if not isinstance(pairs, tuple | list) or any(isinstance(pair, str) for pair in pairs):
        raise InputError(f"{value!r} are no locked joints; valid: {{JOINT: VALUE, ...}}")
    return tuple(sorted(map(tuple, pairs)))


PathColumn = Annotated[int | str, PlainValidator(_column)]
LockedJoints = Annotated[tuple[tuple[str, Number], ...], BeforeValidator(_locked), PlainSerializer(dict)]
StartAngles = Annotated[tuple[Number, ...], WrapValidator(_start), PlainSerializer(lambda value: value)]

# Entries {kind: NAME, ...} of a job are of other packages; a row without a kind is a `TaskRow`.
Row = Annotated[
    TaskRow, WrapValidator(given_kind_of(task_row_kind.TASK_ROWS, task_row_kind.TaskRowKind)), WrapSerializer(record_of)
]
Obstacle = Annotated[
    Any,
    AfterValidator(needs_kind),
    WrapValidator(given_kind_of(obstacle_kind.OBSTACLES, obstacle_kind.ObstacleKind)),
    WrapSerializer(record_of),
]

SOURCES = ("robot.model", "workpiece.cloud")  # keys that determine the defaults of DEPENDENT
DEPENDENT = (
    "robot.limits",
    "settings.q_weights",
    "workpiece.rotation_y_rad",
    "workpiece.rotation_z_rad",
    "workpiece.neutral_translation_m",
    "workpiece.pivot_m",
    "workpiece.inlet_direction",
    "workpiece.tip_contact_m",
    "cell.self_collision",
)


class RobotConfig(strict_model.FileSection):
    """The arm, its pose, and its tool."""

    model: str = BUILT_IN_ARM  # or an MJCF or URDF file
    limits: Literal["simulation", "datasheet", "model"] = "simulation"
    tcp: str | None = None  # site or body at the TCP, or at the flange of a `tool`; default: see `load_robot`
    base_m: PointM = (0.0, 0.0, 0.0)  # of the model's own frame, in the world
    base_rpy_rad: tuple[Turn, Turn, Turn] = (0.0, 0.0, 0.0)  # about world x, then y, then z
    tool: Tool | None = None
    tool_extension_m: Number = 0.0
    locked: LockedJoints = ()  # joints of the file that do not move, by their names, and their positions [rad or m]
    bodies: Literal["capsules", "meshes"] | None = None  # meshes: their convex pieces; None: meshes where there are any

    @property
    def is_gp50(self) -> bool:
        """True for the built-in arm."""
        return self.model == BUILT_IN_ARM

    @property
    def file(self) -> Path:
        """The model's file."""
        from htcp_jax.model import robot as robots  # here, as it imports JAX

        return robots.GP50 if self.is_gp50 else Path(self.model)


class PathColumnsConfig(strict_model.FileSection):
    """Columns of a path's file by what they hold: points, normals, tangents, quaternions."""

    x: PathColumn
    y: PathColumn
    z: PathColumn
    nx: PathColumn | None = None
    ny: PathColumn | None = None
    nz: PathColumn | None = None
    tx: PathColumn | None = None
    ty: PathColumn | None = None
    tz: PathColumn | None = None
    qw: PathColumn | None = None
    qx: PathColumn | None = None
    qy: PathColumn | None = None
    qz: PathColumn | None = None

    @model_validator(mode="after")
    def _is_complete(self) -> "PathColumnsConfig":
        for family in (("nx", "ny", "nz"), ("tx", "ty", "tz"), ("qw", "qx", "qy", "qz")):
            given = [name for name in family if getattr(self, name) is not None]
            if given and len(given) < len(family):
                raise InputError(f"path_columns has {', '.join(given)}; all of {', '.join(family)} are needed")
        return self

    @property
    def given(self) -> dict[str, int | str]:
        """The columns that are given."""
        return self.model_dump(exclude_none=True)


class WorkpieceConfig(strict_model.FileSection):
    """The cloud, the tool path in its frame, its pose, and the approach to the path."""

    cloud: str = DUCT  # the generated duct, a file of points or a mesh, or none
    path: str = "weld"  # a seam of the generated duct, see `io.parts`, or a CSV file of x,y,z
    path_columns: PathColumnsConfig | None = None  # of the CSV file; None: those that its header names, or the first
    path_unit: Literal["m", "mm", "cm", "in"] | None = None  # of the CSV file; None: as its header says, or m
    origin_m: FilePointM | None = None  # subtracted from cloud, path and inlet; None: see `load_workpiece`
    inlet_m: FilePointM | None = None  # centre of the inlet; None: the duct's, or none for another cloud
    interior: Literal["hull", "none"] = "hull"  # boundary of the interior deeper than interior_depth_m
    interior_depth_m: float = Field(duct.INTERIOR_DEPTH_M, ge=0, le=LARGEST)
    inlet_direction: PointM | Literal["world-x"] | None = "world-x"  # into the part; see `InletDirection`
    mesh_spacing_m: Annotated[float, Field(ge=1e-5, le=LARGEST)] | None = None  # widest gap of the points on a mesh
    tip_contact_m: Annotated[float, Field(ge=0, le=LARGEST)] | None = None  # of the bare tip, from the TCP; null: all
    pivot_m: PointM = duct.PIVOT  # world point that the rotations turn about
    neutral_translation_m: PointM = duct.NEUTRAL_TRANSLATION  # of the workpiece frame, before the rotations
    rotation_x_rad: float = 0.0  # about world x first, then y, then z
    rotation_y_rad: float = 0.4
    rotation_z_rad: float = 0.1
    shift_m: PointM = (0.0, 0.0, 0.0)
    approach_to_inlet: ApproachSteps = 5  # equal steps from the start's TCP to the inlet
    approach_to_path: ApproachSteps = 5  # and from there to the first point of the path

    @property
    def is_duct(self) -> bool:
        """True for the generated duct."""
        return self.cloud == DUCT

    @property
    def has_cloud(self) -> bool:
        """True unless the job has a path without walls."""
        return self.cloud != NO_CLOUD

    @property
    def is_along_world_x(self) -> bool:
        """True if the interior lies along the world's x, for any rotation of the part."""
        return self.inlet_direction == "world-x" or (self.is_duct and self.inlet_direction is None)


class CloudConfig(strict_model.FileSection):
    """A further cloud or mesh, fixed in the world."""

    cloud: str  # a file of points or a mesh
    base_m: PointM = (0.0, 0.0, 0.0)  # of its own frame, in the world
    base_rpy_rad: tuple[Turn, Turn, Turn] = (0.0, 0.0, 0.0)  # about world x, then y, then z


class FixtureConfig(strict_model.FileSection):
    """The carrier of a shape or cloud of the cell, and links that it may touch."""

    name: str  # of a shape of `model`: its geom's, or else its body's; or of one of the `clouds`: its file's stem
    parent: str = WORLD  # or a link of the arm: its pose is then in the link's frame, and it moves with the link
    exclude: tuple[str, ...] = ()  # links that it is not tested against


class CellConfig(strict_model.FileSection):
    """Collision objects in addition to the workpiece: the arm itself, and the work cell."""

    self_collision: bool = False
    model: str | None = None  # an MJCF file
    moved: str | None = None  # the body to rotate and translate; None: the complete cell
    shift_m: PointM = (0.0, 0.0, 0.0)
    rpy_rad: tuple[Turn, Turn, Turn] = (0.0, 0.0, 0.0)  # about world x, then y, then z
    clouds: tuple[CloudConfig, ...] = ()
    fixtures: tuple[FixtureConfig, ...] = ()  # those not carried by the world, or with links that they may touch
    obstacles: tuple[Obstacle, ...] = ()  # of other packages

    @property
    def is_carried(self) -> bool:
        """True if any fixture is carried by a link."""
        return any(each.parent != WORLD for each in self.fixtures)


class UserFrameConfig(strict_model.FileSection):
    """A frame with a number at the controller; RECTAN positions are in it."""

    number: int = Field(ge=1, le=63)
    on: Literal["workpiece", "world"] = "workpiece"  # the object to which it is fixed


class PulsesConfig(strict_model.FileSection):
    """Encoder scale of a controller."""

    per_rad: tuple[Annotated[float, Field(ge=-FASTEST, le=FASTEST)], ...]  # or per m; negative: opposite direction
    zero_rad: tuple[Annotated[float, Field(ge=-FASTEST, le=FASTEST)], ...] | None = None  # or m, at 0 pulses; None: 0
    source: str = Field(min_length=1, max_length=200)  # of these numbers


class JointGroupsConfig(strict_model.FileSection):
    """Names of the joints in the controller's groups, each in the controller's order."""

    robot: tuple[str, ...] = Field(min_length=1)
    base: tuple[str, ...] = ()  # axes that carry the robot: a rail
    station: tuple[str, ...] = ()  # axes of the positioner


class ProgramConfig(strict_model.FileSection):
    """Section `program` of a job; it has no influence on plans."""

    feed: str | None = None  # of the TCP on the path, with its unit: 20mm/s
    velocity: JointRates | None = None  # [rad/s or m/s]; None: the model's
    acceleration: JointRates | None = None  # [rad/s2 or m/s2]; None: the model's, or full speed in full_speed_s
    jerk: JointRates | None = None  # [rad/s3 or m/s3]; None: full acceleration in full_acceleration_s
    full_speed_s: Moment = 0.2
    full_acceleration_s: Moment = 0.1
    tool: int = Field(0, ge=0, le=63)  # its number at the controller
    user_frame: UserFrameConfig | None = None
    pulses: PulsesConfig | None = None
    groups: JointGroupsConfig | None = None  # for formats with external axes; None: all joints are the robot's
    control_step_s: Moment = 0.002  # of the controller

    @field_validator("feed", mode="before")
    @classmethod
    def _is_a_speed(cls, feed: Any) -> Any:
        if feed is not None:
            feed_of(str(feed))
        return feed


class RayConfig(strict_model.FileSection):
    """Ray resources per shard of a sweep; no influence on results."""

    num_cpus: float = Field(1.0, gt=0)
    num_gpus: float = Field(0.0, ge=0)  # a part below 1 shares the GPU
    retries: int = Field(3, ge=0)  # of a shard after its worker or node died


class PlanConfig(strict_model.FileSection):
    """One plan; the defaults are the default job."""

    robot: RobotConfig = RobotConfig()
    workpiece: WorkpieceConfig = WorkpieceConfig()
    cell: CellConfig = CellConfig()
    start_rad: StartAngles = (0.0, -2.3, 0.5, 0.0, 0.5, -2.0)  # or auto: chosen at the path's first point
    home_rad: tuple[Number, ...] | None = None  # first configuration of the motion; None: the start
    task: tuple[Row, ...] = ()  # none: the TCP on the path
    margin_m: float = Field(5e-4, ge=0, le=1)  # required clearance at a target
    method: str = "beam"
    settings: Settings = Settings()
    program: ProgramConfig = ProgramConfig()
    ray: RayConfig = RayConfig()

    @property
    def start(self) -> tuple[float, ...] | None:
        """The given start; None if the planner chooses it."""
        return None if isinstance(self.start_rad, str) else self.start_rad

    @property
    def begins_rad(self) -> tuple[float, ...]:
        """First configuration of the motion: home, or the start without a home; empty if the planner chooses it."""
        begins = self.start if self.home_rad is None else self.home_rad
        return () if begins is None else begins

    @property
    def approach(self) -> tuple[int, int]:
        """Steps to the inlet and from there to the path; 0 if the planner chooses a start on the path."""
        part = self.workpiece
        return (0, 0) if self.start is None else (part.approach_to_inlet, part.approach_to_path)

    @property
    def on_path(self) -> int:
        """Index of the first target on the path, after the start's TCP and the approach."""
        return 1 + sum(self.approach)

    @field_validator("method")
    @classmethod
    def _could_be_a_method(cls, name: str) -> str:
        if not NAME.fullmatch(name):  # whether it exists is checked by the planner
            raise InputError(f"{name!r} is not a method; their names are small letters, digits and hyphens")
        return name
