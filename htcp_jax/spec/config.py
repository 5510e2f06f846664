"""Schema of a job file: the sections, their keys, and the default job.

`load_config` makes a PlanConfig. Some defaults below are for the built-in arm (GP50) and the generated duct; those of
the module `defaults` replace them for another robot or another part.
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
    WrapValidator,
    field_validator,
    model_validator,
)

from htcp_jax.errors import InputError
from htcp_jax.settings import Settings
from htcp_jax.spec import model_source, obstacle_kind, strict_model
from htcp_jax.spec.choices import (
    CHOSEN_ANGLES,
    GP50,
    INTERIOR_DEPTH_M,
    LIMITS_FILE,
    NEUTRAL_TRANSLATION,
    PIVOT,
    LengthUnit,
    Maker,
    is_limits_file,
)
from htcp_jax.spec.config_file import BUILT_IN_ARM, DUCT, LIMIT_PROFILES, NO_CLOUD, merged
from htcp_jax.spec.defaults import own_defaults
from htcp_jax.spec.errors_config import ErrorsConfig
from htcp_jax.spec.feed import Feed
from htcp_jax.spec.given_kinds import Row, kind_validator, needs_kind, record_of
from htcp_jax.spec.model_source import WORLD
from htcp_jax.spec.process_config import ProcessConfig
from htcp_jax.spec.registry import NAME
from htcp_jax.spec.seam_list import SeamConfig, check_seams
from htcp_jax.spec.tool import Tool

FARTHEST = 1e9  # maximum coordinate in a file [m]
LARGEST = 1e6  # maximum length [m] and joint position; rounding errors of larger values exceed the tolerance
Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
PointM = tuple[Number, Number, Number]
FileCoordinate = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]
FilePointM = tuple[FileCoordinate, FileCoordinate, FileCoordinate]
Turn = Annotated[float, Field(ge=-2 * math.pi, le=2 * math.pi)]  # larger values are usually degrees
ApproachSteps = Annotated[int, Field(ge=0, le=10_000)]
FASTEST = 1e9  # maximum joint rate, and maximum encoder count per unit
JointRates = tuple[Annotated[float, Field(gt=0, le=FASTEST)], ...]  # one limit per joint, for both directions
Moment = Annotated[float, Field(gt=0, le=100)]  # [s]
AUTO = "auto"  # value of start_rad: the planner chooses the start


def _start(value: Any, numbers: Callable[[Any], tuple[float, ...]]) -> Any:
    """Return validated joint positions, or AUTO.

    Args:
        value: Value of start_rad.
        numbers: Function that validates joint positions.

    Raises:
        InputError: If the value is a text other than AUTO.
    """
    if isinstance(value, str) and value != AUTO:
        raise InputError(f"{value!r} is not a start configuration; valid: {AUTO}, or a list of joint positions")
    return value if value == AUTO else numbers(value)


def _pairs(value: Any, form: str) -> tuple[tuple, ...]:
    """Return the pairs of a mapping.

    Args:
        value: A mapping, or a list of pairs, as in a saved job.
        form: The valid form, for messages.

    Raises:
        InputError: If the value is neither of these.
    """
    pairs = tuple(value.items()) if isinstance(value, dict) else value
    if not isinstance(pairs, tuple | list) or any(isinstance(pair, str) for pair in pairs):
        raise InputError(f"{value!r} must be a mapping of {form}")
    return tuple(map(tuple, pairs))


def _coupled(value: Any) -> tuple[tuple, ...]:
    """Return the pairs (axis, joint) of `program.coupled`."""
    return _pairs(value, "axes to joints: {AXIS: JOINT, ...}")


def _without_circle(pairs: tuple[tuple[str, str], ...]) -> tuple[tuple[str, str], ...]:
    """Return the pairs of `program.coupled`.

    Raises:
        InputError: If an axis is given twice, or if axes are coupled in a circle.
    """
    following = dict(pairs)
    for axis in following:
        if sum(own == axis for own, _ in pairs) > 1:
            raise InputError(f"{axis!r} is given twice; valid: one joint for each coupled axis")
        circle = [axis]
        while (joint := following.get(circle[-1])) is not None and joint not in circle:
            circle.append(joint)
        if joint == axis:
            around = f"a circle: {' -> '.join([*circle, axis])}"
            what = around if circle[1:] else f"{axis!r} is coupled with itself"
            raise InputError(f"{what}; valid: for each coupled axis, the joint that moves it, without a circle")
    return pairs


def _locked(value: Any) -> tuple[tuple, ...]:
    """Return the pairs (joint, position) of `robot.locked`, sorted by joint."""
    return tuple(sorted(_pairs(value, "joints to positions; valid: {JOINT: VALUE, ...}")))


def _column(value: Any) -> int | str:
    """Return a validated column of a CSV file: its number, counted from 1, or its name in the header.

    Raises:
        InputError: If the value is neither of these.
    """
    if (isinstance(value, int) and not isinstance(value, bool) and value >= 1) or (isinstance(value, str) and value):
        return value
    raise InputError(f"{value!r} is not a column; valid: a number from 1, or a name in the file's header")


def _link(name: str) -> str:
    """Return the name of a link without the prefix "robot."."""
    return name.removeprefix("robot.")


PathColumn = Annotated[int | str, PlainValidator(_column)]
Link = Annotated[str, Field(min_length=1), AfterValidator(_link)]  # name of a link or site, world, or SECTION.LINK
LockedJoints = Annotated[tuple[tuple[str, Number], ...], BeforeValidator(_locked), PlainSerializer(dict)]
CoupledAxes = Annotated[
    tuple[tuple[str, str], ...], BeforeValidator(_coupled), AfterValidator(_without_circle), PlainSerializer(dict)
]
StartAngles = Annotated[tuple[Number, ...], WrapValidator(_start), PlainSerializer(lambda value: value)]

# An entry {kind: NAME, ...} has a kind from another package.
Obstacle = Annotated[
    Any,
    AfterValidator(needs_kind),
    WrapValidator(kind_validator(obstacle_kind.OBSTACLES, obstacle_kind.ObstacleKind)),
    PlainSerializer(record_of),
]


def _limits_source(value: str) -> str:
    """Return a validated source of joint limits: a profile, or the name of a file.

    Raises:
        InputError: If it is neither of these.
    """
    if value in LIMIT_PROFILES or is_limits_file(value):
        return value
    valid = f"{', '.join(LIMIT_PROFILES)}, or {LIMITS_FILE}"
    raise InputError(f"{Path(value).name!r} is not a source of joint limits; valid: {valid}")


JointLimitsSource = Annotated[str, AfterValidator(_limits_source)]


class RobotConfig(strict_model.FileSection):
    """The arm, its pose, and its tool."""

    model: str = BUILT_IN_ARM  # the built-in arm, or an MJCF or URDF file
    # source of the joint limits: a profile, see `load_robot`, or a file such as MoveIt's joint_limits.yaml
    limits: JointLimitsSource = "simulation"
    parent: Link = WORLD  # the world, or the link of the rail, positioner or tool that carries the arm
    tcp: Link | None = None  # site or body at the TCP, or at the flange if `tool` is given; None: see `load_robot`
    base_m: PointM = (0.0, 0.0, 0.0)  # position of the model's base frame in the parent's frame
    base_rpy_rad: tuple[Turn, Turn, Turn] = (0.0, 0.0, 0.0)  # rotations about the parent's x, then y, then z
    tool: Tool | None = None
    tool_extension_m: Number = 0.0
    locked: LockedJoints = ()  # names of joints that do not move, and their values [rad or m]
    # names of joints that stand still within each seam, and move before the path and between seams
    indexed: tuple[str, ...] = Field((), exclude_if=lambda names: not names)
    # collision bodies: "capsules", or "meshes", where convex pieces decide; None: "meshes" if the model has pieces
    bodies: Literal["capsules", "meshes"] | None = None

    @property
    def limits_file(self) -> str | None:
        """Name of the file with joint limits; None if the limits are a profile of the model."""
        return None if self.limits in LIMIT_PROFILES else self.limits

    @property
    def is_gp50(self) -> bool:
        """True if the arm is the built-in GP50."""
        return self.model == BUILT_IN_ARM

    @property
    def file(self) -> Path:
        """Path of the arm's model file; for the built-in arm, the shipped one."""
        return GP50 if self.is_gp50 else Path(self.model)


class ModelConfig(strict_model.FileSection):
    """A positioner, a rail or a tool with its own model, which is joined with the robot's model."""

    model: str | None = None  # an MJCF or URDF file; None: no such model
    parent: Link = WORLD  # the world, or a link of another model that carries this one
    base_m: PointM = (0.0, 0.0, 0.0)  # position of the model's base frame in the parent's frame
    base_rpy_rad: tuple[Turn, Turn, Turn] = (0.0, 0.0, 0.0)  # rotations about the parent's x, then y, then z
    # True: its joints stand still within each seam, and move before the path and between seams
    indexed: bool = Field(False, exclude_if=lambda indexed: not indexed)

    @model_validator(mode="after")
    def _has_a_model(self) -> "ModelConfig":
        given = [name for name, field in type(self).model_fields.items() if getattr(self, name) != field.default]
        if self.model is None and given:
            raise InputError(f"{given[0]} is set, but model is missing; set model, too")
        return self


class PathColumnsConfig(strict_model.FileSection):
    """Columns of a path's file for the coordinates of points, normals, plates, tangents, quaternions and angles."""

    x: PathColumn
    y: PathColumn
    z: PathColumn
    nx: PathColumn | None = None
    ny: PathColumn | None = None
    nz: PathColumn | None = None
    n1x: PathColumn | None = None  # normals of both plates of a fillet
    n1y: PathColumn | None = None
    n1z: PathColumn | None = None
    n2x: PathColumn | None = None
    n2y: PathColumn | None = None
    n2z: PathColumn | None = None
    tx: PathColumn | None = None
    ty: PathColumn | None = None
    tz: PathColumn | None = None
    qw: PathColumn | None = None
    qx: PathColumn | None = None
    qy: PathColumn | None = None
    qz: PathColumn | None = None
    angle_1: PathColumn | None = None  # angles in the order of the maker that path_angles names
    angle_2: PathColumn | None = None
    angle_3: PathColumn | None = None

    @model_validator(mode="after")
    def _is_complete(self) -> "PathColumnsConfig":
        plates = "n1x", "n1y", "n1z", "n2x", "n2y", "n2z"
        for family in (("nx", "ny", "nz"), plates, ("tx", "ty", "tz"), ("qw", "qx", "qy", "qz"), CHOSEN_ANGLES):
            given = [name for name in family if getattr(self, name) is not None]
            if given and len(given) < len(family):
                raise InputError(f"path_columns has only {', '.join(given)}; all of {', '.join(family)} are needed")
        return self

    @property
    def given(self) -> dict[str, int | str]:
        """The given columns: numbers or names in the header, by coordinate."""
        return self.model_dump(exclude_none=True)


class PlatesConfig(strict_model.FileSection):
    """Search for the two plates of a fillet in the part's mesh, see `model.fillet_plates`."""

    within_m: Annotated[float, Field(gt=0, le=LARGEST)]  # radius around a point of the path
    plate_1_faces: PointM  # direction in the part's frame; plate 1 is the plate that faces it more

    @field_validator("plate_1_faces")
    @classmethod
    def _is_a_direction(cls, direction: PointM) -> PointM:
        if not any(direction):
            raise InputError("plate_1_faces is zero; it must be a direction, such as [0, 0, 1]")
        return direction


class WorkpieceConfig(strict_model.FileSection):
    """The workpiece: its cloud or mesh, the tool path in its frame, its pose, and the approach to the path."""

    cloud: str = DUCT  # the generated duct, a file of points or a mesh, or "none"
    unit: LengthUnit | None = None  # unit of the cloud's file; None: the unit that the file states, or m
    parent: Link | None = None  # link or site that carries the part; None: the link that robot.model names, or world
    path: str = "weld"  # a seam of the generated duct, see `io.parts`, or a CSV file of x,y,z
    # seams in the order of work, in place of `path`; the key `seams` of a job is the same
    seams: tuple[SeamConfig, ...] = Field((), exclude_if=lambda seams: not seams)
    path_columns: PathColumnsConfig | None = None  # columns of the CSV file; None: the header's, or the first ones
    path_unit: LengthUnit | None = None  # unit of the CSV file; None: the header's unit, or m
    path_angles: Maker | None = None  # maker whose order the angles in the CSV file have; None: the header decides
    # plates of a fillet, found in the mesh; None: those of the path's file, if it has some
    plates: PlatesConfig | None = Field(None, exclude_if=lambda plates: plates is None)
    origin_m: FilePointM | None = None  # point subtracted from cloud, path and inlet; None: see `load_workpiece`
    inlet_m: FilePointM | None = None  # centre of the inlet; None: the duct's inlet, or no inlet for another cloud
    interior: Literal["hull", "none"] = "hull"  # convex hull, or no boundary, deeper than interior_depth_m
    interior_depth_m: float = Field(INTERIOR_DEPTH_M, ge=0, le=LARGEST)
    inlet_direction: PointM | Literal["world-x"] | None = "world-x"  # direction into the part; see `InletDirection`
    mesh_spacing_m: Annotated[float, Field(ge=1e-5, le=LARGEST)] | None = None  # maximum gap of the points on a mesh
    # length of the bare tip, from the TCP, that may touch walls [m]; None: the complete tip
    tip_contact_m: Annotated[float, Field(ge=0, le=LARGEST)] | None = None
    pivot_m: PointM = PIVOT  # world point about which the workpiece is rotated
    neutral_translation_m: PointM = NEUTRAL_TRANSLATION  # translation before the rotations
    rotation_x_rad: Turn = 0.0  # rotation about world x, applied first, then y, then z
    rotation_y_rad: Turn = 0.4
    rotation_z_rad: Turn = 0.1
    shift_m: PointM = (0.0, 0.0, 0.0)  # translation in the world, after the rotations
    approach_to_inlet: ApproachSteps = 5  # number of equal steps from the start's TCP to the inlet
    approach_to_path: ApproachSteps = 5  # number of equal steps from the inlet to the first point of the path

    @field_validator("seams")
    @classmethod
    def _are_ordered(cls, seams: tuple[SeamConfig, ...]) -> tuple[SeamConfig, ...]:
        check_seams(seams)
        return seams

    @property
    def path_label(self) -> str:
        """The name of the path's file or seam, or the names of all seams."""
        return ", ".join(dict.fromkeys(seam.name for seam in self.seams)) or Path(self.path).name

    @property
    def is_duct(self) -> bool:
        """True if the workpiece is the generated duct."""
        return self.cloud == DUCT

    @property
    def has_cloud(self) -> bool:
        """True if the workpiece has walls; False if the job has only a path."""
        return self.cloud != NO_CLOUD

    @property
    def is_along_world_x(self) -> bool:
        """True if the direction into the part is the world's x, for any rotation of the part."""
        return self.inlet_direction == "world-x" or (self.is_duct and self.inlet_direction is None)


class CloudConfig(strict_model.FileSection):
    """A cloud or mesh of the work cell, in addition to the workpiece."""

    cloud: str  # a file of points or a mesh
    # unit of the file, omitted in manifests if None: the unit that the file states, or m
    unit: LengthUnit | None = Field(None, exclude_if=lambda unit: unit is None)
    base_m: PointM = (0.0, 0.0, 0.0)  # position of the cloud's own frame in the world
    base_rpy_rad: tuple[Turn, Turn, Turn] = (0.0, 0.0, 0.0)  # rotations about world x, then y, then z


class FixtureConfig(strict_model.FileSection):
    """The parent of a shape or cloud of the cell, and the links that the shape or cloud may touch."""

    name: str  # name of a geom in `model`, or else of its body; or the stem of a file in `clouds`
    parent: Link = WORLD  # the world, or a link of the arm; on a link, the pose is in the link's frame
    exclude: tuple[Link, ...] = ()  # links that the shape or cloud is not tested against


class CellConfig(strict_model.FileSection):
    """Collision objects in addition to the workpiece: the arm itself, and the work cell."""

    self_collision: bool = False
    model: str | None = None  # an MJCF file
    moved: str | None = None  # name of the body to rotate and translate; None: the complete cell
    shift_m: PointM = (0.0, 0.0, 0.0)  # translation in the world
    rpy_rad: tuple[Turn, Turn, Turn] = (0.0, 0.0, 0.0)  # rotations about world x, then y, then z
    clouds: tuple[CloudConfig, ...] = ()
    fixtures: tuple[FixtureConfig, ...] = ()  # shapes and clouds that a link carries, or that may touch links
    obstacles: tuple[Obstacle, ...] = ()  # obstacles of kinds from other packages

    @property
    def is_carried(self) -> bool:
        """True if a link carries any shape or cloud of the cell."""
        return any(each.parent != WORLD for each in self.fixtures)


class UserFrameConfig(strict_model.FileSection):
    """A user frame of the controller, by number. RECTAN positions are written in this frame."""

    number: int = Field(ge=1, le=63)
    on: Literal["workpiece", "world"] = "workpiece"  # the object to which it is fixed


class PulsesConfig(strict_model.FileSection):
    """Encoder pulses of the joints, for robot programs that contain pulses."""

    per_rad: tuple[Annotated[float, Field(ge=-FASTEST, le=FASTEST)], ...]  # pulses per rad or m; < 0: reversed
    # joint values at 0 pulses [rad or m]; None: 0
    zero_rad: tuple[Annotated[float, Field(ge=-FASTEST, le=FASTEST)], ...] | None = None
    source: str = Field(min_length=1, max_length=200)  # text that names the origin of these numbers


class JointGroupsConfig(strict_model.FileSection):
    """Names of the joints in each group of the controller, in the controller's order."""

    robot: tuple[str, ...] = Field(min_length=1)
    base: tuple[str, ...] = ()  # axes that carry the robot: a rail
    station: tuple[str, ...] = ()  # axes of the positioner


class ProgramConfig(strict_model.FileSection):
    """Feed rate, joint limits and controller data for robot programs; without influence on plans."""

    feed: Feed | None = None  # feed rate of the TCP on the path, with its unit: 20mm/s
    velocity: JointRates | None = None  # [rad/s or m/s]; None: the model's
    acceleration: JointRates | None = None  # [rad/s2 or m/s2]; None: the model's, or by full_speed_s
    jerk: JointRates | None = None  # [rad/s3 or m/s3]; None: by full_acceleration_s
    full_speed_s: Moment = 0.2  # time to reach the velocity limit, without acceleration limits
    full_acceleration_s: Moment = 0.1  # time to reach the acceleration limit, without jerk limits
    # before and after the path, largest share of full joint speed where the part is nearer than near_part_m
    near_part_speed: float = Field(1.0, ge=0.001, le=1)  # [1]
    near_part_m: float = Field(0.02, ge=0, le=10)
    tool: int = Field(0, ge=0, le=63)  # number of the tool in the controller
    tool_name: str | None = Field(None, min_length=1)  # name of the tool data, for rapid; None: tool<number>
    # for rapid: axes whose value is the sum of their own joint and another joint, such as {joint_3: joint_2}
    coupled: CoupledAxes = ()
    # joints in programs if joints follow others: commanded, or also those that follow; None: chosen by the format
    axes: Literal["commanded", "all"] | None = None
    user_frame: UserFrameConfig | None = None
    pulses: PulsesConfig | None = None
    groups: JointGroupsConfig | None = None  # for formats with external axes; None: all joints are in the robot's group
    process: ProcessConfig | None = None  # outputs at both ends of each seam; None: none
    # for ls: where the model counts joint 3 of a FANUC arm from; the controller counts from the horizontal
    j3_from: Literal["upper_arm", "horizontal"] = "upper_arm"
    control_step_s: float = Field(0.002, ge=1e-4, le=0.1)  # time step of the controller


class RayConfig(strict_model.FileSection):
    """Ray resources for each shard (work unit) of a sweep; without influence on results."""

    num_cpus: float = Field(1.0, gt=0)
    num_gpus: float = Field(0.0, ge=0)  # if below 1, several shards share a GPU
    retries: int = Field(3, ge=0)  # maximum number of retries of a shard whose worker or node died


class PlanConfig(strict_model.FileSection):
    """The configuration of one plan; its defaults are the default job."""

    robot: RobotConfig = RobotConfig()
    positioner: ModelConfig = ModelConfig()
    rail: ModelConfig = ModelConfig()
    tool: ModelConfig = ModelConfig()
    workpiece: WorkpieceConfig = WorkpieceConfig()
    cell: CellConfig = CellConfig()
    start_rad: StartAngles = (0.0, -2.3, 0.5, 0.0, 0.5, -2.0)  # auto: the planner chooses a start on the path
    home_rad: tuple[Number, ...] | None = None  # first configuration of the motion; None: the start
    task: tuple[Row, ...] = ()  # rows of the task; empty: the TCP on the path
    margin_m: float = Field(5e-4, ge=0, le=1)  # required clearance
    margin_on: Literal["segments", "targets"] = "segments"  # segments: also between targets, where targets needs D > 0
    transfer_margin_m: float = Field(5e-3, ge=0, le=1)  # required clearance before the path, if possible; 0: D > 0
    # distance of the TCP from either end of a transfer or approach within which transfer_margin_m falls off
    transfer_falloff_m: float = Field(0.05, ge=1e-6, le=10)
    method: str = "beam"
    settings: Settings = Settings()
    program: ProgramConfig = ProgramConfig()
    # errors for which proofs state their largest scale; without influence on plans
    errors: ErrorsConfig | None = Field(None, exclude_if=lambda errors: errors is None)
    ray: RayConfig = RayConfig()

    @model_validator(mode="before")
    @classmethod
    def _own_defaults(cls, raw: Any) -> Any:
        return merged((own_defaults(raw), raw)) if isinstance(raw, dict) else raw

    @property
    def tasks(self) -> tuple[tuple[Row, ...], ...]:
        """Rows of the task on each seam; for a job without seams, the job's rows."""
        return tuple(seam.task or self.task for seam in self.workpiece.seams) or (self.task,)

    @property
    def task_rows(self) -> tuple[Row, ...]:
        """Rows of the job's task and of its seams' own tasks."""
        return (*self.task, *(row for seam in self.workpiece.seams for row in seam.task))

    @property
    def stated_feeds(self) -> tuple[str | None, ...]:
        """Feed rate on each seam, its own or the job's, with its unit; for a job without seams, the job's."""
        return tuple(seam.feed or self.program.feed for seam in self.workpiece.seams) or (self.program.feed,)

    @property
    def segment_margin_m(self) -> float:
        """Required clearance on the segments of the path [m]; 0: only D > 0."""
        return self.margin_m if self.margin_on == "segments" else 0.0

    @property
    def has_own_arm(self) -> bool:
        """False if the robot is the GP50 without a positioner, rail or tool model."""
        return self.tree is not None or not self.robot.is_gp50

    @property
    def tree(self) -> model_source.ComposedModel | None:
        """The models of arm, positioner, rail and tool as one tree; None if only `robot.file` is used."""
        sections = {key: getattr(self, key) for key in model_source.KEYS}
        files = {key: Path(own.model) for key, own in sections.items() if own.model and own is not self.robot}
        if not files and self.robot.parent == WORLD and self.workpiece.parent is None:
            return None
        models = [
            model_source.PlacedModel(
                key,
                file,
                sections[key].parent,
                sections[key].base_m,
                sections[key].base_rpy_rad,
                key != model_source.ROBOT and sections[key].indexed,
            )
            for key, file in {model_source.ROBOT: self.robot.file, **files}.items()
        ]
        return model_source.ComposedModel(tuple(models), self.workpiece.parent)

    @property
    def start(self) -> tuple[float, ...] | None:
        """The start configuration [rad or m]; None if the planner chooses the start."""
        return None if isinstance(self.start_rad, str) else self.start_rad

    @property
    def begins_rad(self) -> tuple[float, ...]:
        """First configuration of the motion: home, or else the start; () without home and with start_rad: auto."""
        begins = self.start if self.home_rad is None else self.home_rad
        return () if begins is None else begins

    @property
    def approach(self) -> tuple[int, int]:
        """Numbers of steps to the inlet, and from there to the path; (0, 0) with start_rad: auto."""
        part = self.workpiece
        return (0, 0) if self.start is None else (part.approach_to_inlet, part.approach_to_path)

    @property
    def on_path(self) -> int:
        """Index of the first target on the path. The targets before it are the start's TCP and the approach."""
        return 1 + sum(self.approach)

    @field_validator("method")
    @classmethod
    def _could_be_a_method(cls, name: str) -> str:
        if not NAME.fullmatch(name):  # the planner checks that the method exists
            raise InputError(f"{name!r} is not a method; names consist of lower-case letters, digits and hyphens")
        return name
