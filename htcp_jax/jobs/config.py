"""What a person writes in YAML for one plan, checked and turned into values.

    load_config("plan.yaml", ["margin_m=0.001", "settings.alpha_rad=0.05"]) -> PlanConfig

A file may build on another one, see `config_file`. Unknown keys are errors that name the nearest valid key. Files named
in a YAML file are relative to its folder; files named in an override are relative to the working folder, as on any
command line.

Some defaults are the GP50's and the duct's. With another robot or another cloud they are what `own_defaults` says.
"""

import difflib
import math
import reprlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from htcp_jax.errors import InputError
from htcp_jax.jobs.config_file import FILES, layers, layers_of, merged, parse_override, put
from htcp_jax.planner.registry import NAME
from htcp_jax.scene.robot import load_robot
from htcp_jax.scene.tool import Tool
from htcp_jax.scene.workpiece import GATE_DEPTH_M, NEUTRAL_TRANSLATION, PIVOT
from htcp_jax.settings import Settings

TIP_CONTACT_M = 0.01  # of a part of one's own
LARGEST = 1e6  # of lengths [m] and joint positions: beyond, the tolerance is lost to rounding
Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Point = tuple[Number, Number, Number]
Turn = Annotated[float, Field(ge=-2 * math.pi, le=2 * math.pi)]  # degrees are mostly beyond
Steps = Annotated[int, Field(ge=0, le=10_000)]


class Section(BaseModel):
    """A mapping in the file. Values are immutable; numbers are finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class RobotConfig(Section):
    """The arm, where it stands, and its tool."""

    model: str = "gp50"  # or an MJCF or URDF file
    limits: Literal["simulation", "datasheet", "model"] = "simulation"
    tcp: str | None = None  # site or body at the TCP, or at the flange of a `tool`; without it see robot.load_robot
    base_m: Point = (0.0, 0.0, 0.0)  # of the model's own frame, in the world
    base_rpy_rad: tuple[Turn, Turn, Turn] = (0.0, 0.0, 0.0)  # about world x, then y, then z
    tool: Tool | None = None
    tool_extension_m: Number = 0.0


class WorkpieceConfig(Section):
    """The cloud, the tool path in its frame, its pose, and the approach to the path."""

    cloud: str = "duct"  # the generated duct, or a file of points or a mesh
    path: str = "weld"  # the generated duct's weld, or a CSV file of x,y,z [m]
    inlet_m: Point | None = None  # centre of the inlet; without it the duct's, or none for another cloud
    interior: Literal["hull", "none"] = "hull"  # what bounds the inside, deeper than gate_depth_m
    gate_depth_m: float = Field(GATE_DEPTH_M, ge=0, le=LARGEST)
    inlet_direction: Point | Literal["world-x"] | None = "world-x"  # into the part; see `load_workpiece`
    mesh_spacing_m: Annotated[float, Field(gt=0, le=LARGEST)] | None = None  # widest gap of the points on a mesh
    tip_contact_m: Annotated[float, Field(ge=0, le=LARGEST)] | None = None  # of the bare tip, from the TCP; null: all
    pivot_m: Point = PIVOT  # world point that the rotations turn about
    neutral_translation_m: Point = NEUTRAL_TRANSLATION  # of the workpiece frame, before they turn it
    rotation_x_rad: float = 0.0  # about world x first, then y, then z
    rotation_y_rad: float = 0.4
    rotation_z_rad: float = 0.1
    shift_m: Point = (0.0, 0.0, 0.0)
    approach_to_inlet: Steps = 5  # equal steps from the start's TCP to the inlet
    approach_to_path: Steps = 5  # and from there to the first point of the path


class RayConfig(Section):
    """What a shard of a sweep asks of a Ray cluster; has no influence on results."""

    num_cpus: float = Field(1.0, gt=0)
    num_gpus: float = Field(0.0, ge=0)  # a part below 1 shares the GPU
    retries: int = Field(3, ge=0)  # of a shard whose worker or node died


class PlanConfig(Section):
    """One plan; the defaults are the default job."""

    robot: RobotConfig = RobotConfig()
    workpiece: WorkpieceConfig = WorkpieceConfig()
    start_rad: tuple[Number, ...] = (0.0, -2.3, 0.5, 0.0, 0.5, -2.0)
    margin_m: float = Field(5e-4, ge=0, le=1)  # least clearance with which a target counts
    method: str = "nspace-sqp"
    settings: Settings = Settings()
    ray: RayConfig = RayConfig()

    @field_validator("method")
    @classmethod
    def _could_be_a_method(cls, name: str) -> str:
        if not NAME.fullmatch(name):  # which there are, the planner says
            raise InputError(f"{name!r} is no method; their names are small letters, digits and hyphens")
        return name


def load_config(
    config: str | Path | Mapping[str, Any] | None = None, overrides: Sequence[str] | Mapping[str, Any] = ()
) -> PlanConfig:
    """The default job, changed by `config`, a YAML file or a mapping that spells one, then by `overrides`:
    "dotted.key=value" each, or a mapping. Files in a mapping are relative to the working folder.

    Raises InputError for a file that cannot be read, is no YAML mapping or repeats a key, for files that build on each
    other in a circle, for an unknown key, for a value of the wrong type or outside its range, and for a robot other
    than the GP50 without a start.
    """
    raw, source = read_config(config, overrides)
    fill_in(raw, stated=keys_of(raw), source=source)
    return validate(raw, PlanConfig, source)


def read_config(
    config: str | Path | Mapping[str, Any] | None, overrides: Sequence[str] | Mapping[str, Any]
) -> tuple[dict, str]:
    """What `load_config` is given as one mapping, without any default, and what to call it. Raises InputError."""
    source, found = "the default configuration", []
    if isinstance(config, Mapping):
        source = "the configuration"
        found = layers_of(config, source)
    elif config is not None:
        source = str(config)
        found = layers(Path(config))
    for name, raw in found:
        _refuse_unknown(raw, PlanConfig, name)
    raw = merged(raw for _, raw in found)
    pairs = overrides.items() if isinstance(overrides, Mapping) else map(parse_override, overrides)
    for dotted, value in pairs:
        put(raw, dotted, value)
    _refuse_unknown(raw, PlanConfig, source)
    return raw, source


SOURCES = ("robot.model", "workpiece.cloud")  # what the next ones hang on, where they are not stated
DEPENDENT = (
    "robot.limits",
    "settings.q_weights",
    "workpiece.rotation_y_rad",
    "workpiece.rotation_z_rad",
    "workpiece.neutral_translation_m",
    "workpiece.pivot_m",
    "workpiece.inlet_direction",
    "workpiece.tip_contact_m",
)


def own_defaults(raw: dict, stated: Collection[str]) -> dict[str, Any]:
    """The `DEPENDENT` keys with their defaults, given the parts that `raw` names and what is stated of it.

    A robot other than the GP50 has its model's own limits and weights of 1; a cloud other than the duct is not turned
    and not moved, and turns about its own origin, wherever `neutral_translation_m` puts it; its inlet faces where its
    hull does, and the tip of the tool stays out of its walls, from which the paper's duct exempts it.
    """
    found = {key: value_at(_DEFAULTS, key) for key in DEPENDENT}
    if is_other(raw, "robot.model"):
        start = value_at(raw, "start_rad")
        found["robot.limits"] = "model"
        found["settings.q_weights"] = (1.0,) * len(start) if isinstance(start, list | tuple) else ()
    if is_other(raw, "workpiece.cloud"):
        origin = value_at(raw, "workpiece.neutral_translation_m")
        known = "workpiece.neutral_translation_m" in stated and _is_point(origin)
        found["workpiece.rotation_y_rad"] = found["workpiece.rotation_z_rad"] = 0.0
        found["workpiece.neutral_translation_m"] = (0.0, 0.0, 0.0)
        found["workpiece.pivot_m"] = tuple(origin) if known else (0.0, 0.0, 0.0)
        found["workpiece.inlet_direction"], found["workpiece.tip_contact_m"] = None, TIP_CONTACT_M
    return found


def fill_in(raw: dict, stated: Collection[str], source: str) -> None:
    """Put `own_defaults` into `raw` wherever a key is not stated. Raises InputError for a robot other than the GP50
    whose start is not stated."""
    if is_other(raw, "robot.model") and "start_rad" not in stated:
        raise InputError(_no_start(raw["robot"], source))
    sections = {key: raw.get(key, {}) for key in ("robot", "workpiece", "settings")}
    for key, default in own_defaults(raw, stated).items():
        if key not in stated and isinstance(sections[key.partition(".")[0]], dict):
            put(raw, key, default)


def keys_of(raw: dict, prefix: str = "") -> set[str]:
    """The dotted keys in `raw`."""
    found = set()
    for key, value in raw.items():
        found |= {f"{prefix}{key}"} | (keys_of(value, f"{prefix}{key}.") if isinstance(value, dict) else set())
    return found


def value_at(raw: dict, dotted: str) -> Any:
    """The value of a key; None where it is not there."""
    for key in dotted.split("."):
        if not isinstance(raw, dict) or key not in raw:
            return None
        raw = raw[key]
    return raw


def is_other(raw: dict, key: str) -> bool:
    """Whether the part is another than the built-in one."""
    name = value_at(raw, key)
    return isinstance(name, str) and name != FILES[tuple(key.split("."))]


def _is_point(value: Any) -> bool:
    numbers = value if isinstance(value, list | tuple) else ()
    return len(numbers) == 3 and all(type(n) in (int, float) and math.isfinite(n) for n in numbers)


def _no_start(robot: dict, source: str) -> str:
    tcp = robot.get("tcp")
    joints = load_robot(robot["model"], tcp_site=tcp if isinstance(tcp, str) else "tcp").joint_names
    return (
        f"{source}: robot.model is {Path(robot['model']).name}, so start_rad must be given: "
        f"{len(joints)} joint positions ({', '.join(joints)})"
    )


_DEFAULTS = PlanConfig().model_dump()


def validate(raw: dict, model: type[BaseModel], source: str) -> Any:
    """`raw` as a `model`. Raises InputError that names the first offender and how many more there are."""
    _refuse_unknown(raw, model, source)
    try:
        return model.model_validate(raw)
    except ValidationError as error:
        first, *more = error.errors()
        others = f" (and {len(more)} more)" if more else ""
        raise InputError(f"{source}: {_sentence(first)}{others}") from None


def _refuse_unknown(raw: dict, model: type, source: str, prefix: str = "") -> None:
    """Raise InputError for the first key of `raw` that `model`, a pydantic model or a dataclass, lacks."""
    kinds = (
        {field.name: field.type for field in fields(model)}
        if is_dataclass(model)
        else {name: field.annotation for name, field in model.model_fields.items()}
    )
    for key, value in list(raw.items()):
        if key not in kinds:
            close = difflib.get_close_matches(str(key), kinds, n=1, cutoff=0.5)
            hint = f"did you mean {prefix}{close[0]}?" if close else f"valid: {', '.join(kinds)}"
            raise InputError(f"{source}: unknown key {prefix}{key}; {hint}")
        if value is None and _is_section(kinds[key]):
            del raw[key]  # a section whose lines are all commented out
            continue
        sections = [kind for kind in (kinds[key], *get_args(kinds[key])) if _is_section(kind)]
        for section in sections:
            items = enumerate(value) if isinstance(value, list) else [(None, value)]
            if get_origin(kinds[key]) is dict and isinstance(value, dict):
                items = value.items()
            for k, item in items:
                if isinstance(item, dict):
                    _refuse_unknown(item, section, source, f"{prefix}{key}." + ("" if k is None else f"{k}."))
        if not sections and kinds[key] is not bool and any(isinstance(item, bool) for item in _items(value)):
            raise InputError(f"{source}: {prefix}{key} is {reprlib.repr(value)}: true and false are no numbers")


def _is_section(kind: Any) -> bool:
    return is_dataclass(kind) or hasattr(kind, "model_fields")


def _items(value: Any) -> Sequence[Any]:
    return value if isinstance(value, list | tuple) else [value]


def _sentence(error: dict) -> str:
    """One pydantic error in our words."""
    where = ".".join(str(part) for part in error["loc"])
    cause = error.get("ctx", {}).get("error")
    if isinstance(cause, InputError):
        return f"{where}.{cause}" if where == "settings" else f"{where}: {cause}"
    if error["type"] == "missing" and isinstance(error["loc"][-1], int):  # of a list, which is too short
        key = ".".join(str(part) for part in error["loc"][:-1])
        return f"{key} is {reprlib.repr(error['input'])}: {error['loc'][-1] + 1} values or more are needed"
    return f"{where} is {reprlib.repr(error['input'])}: {error['msg'][0].lower()}{error['msg'][1:]}"
