"""What a person writes in YAML for one plan, checked and turned into values.

    load_config("plan.yaml", ["margin_m=0.001", "settings.alpha_rad=0.05"]) -> PlanConfig

Unknown keys are errors that name the nearest valid key. Files named in a YAML file are relative to its
folder; files named in an override are relative to the working folder, as on any command line.
"""

import copy
import difflib
import re
import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from htcp_jax.errors import InputError
from htcp_jax.escape import METHODS
from htcp_jax.settings import Settings
from htcp_jax.strict_yaml import parse_yaml, read_yaml
from htcp_jax.workpiece import GATE_DEPTH_M, NEUTRAL_TRANSLATION, PIVOT

TIP_CONTACT_M = 0.01
LARGEST = 1e6  # of lengths [m] and joint positions: beyond, the tolerance is lost to rounding
Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Point = tuple[Number, Number, Number]
Steps = Annotated[int, Field(ge=0, le=10_000)]
NAME = re.compile(r"[a-z0-9-]+")  # of a method; it stands in names of files
RECORD = "of results"


class Section(BaseModel):
    """A mapping in the file. Values are immutable; numbers are finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class RobotConfig(Section):
    """The arm and its tool."""

    model: str = "gp50"  # or an MJCF or URDF file
    limits: Literal["simulation", "datasheet", "model"] = "simulation"
    tool_extension_m: Number = 0.0


class WorkpieceConfig(Section):
    """The cloud, the tool path in its frame, its pose, and the approach to the path."""

    cloud: str = "duct"  # the generated duct, or a file of points or a mesh
    path: str = "weld"  # the generated duct's weld, or a CSV file of x,y,z [m]
    inlet_m: Point | None = None  # centre of the inlet; without it the duct's, or none for another cloud
    interior: Literal["hull", "none"] = "hull"  # what bounds the inside, deeper than gate_depth_m
    gate_depth_m: float = Field(GATE_DEPTH_M, ge=0, le=LARGEST)
    inlet_direction: Point | Literal["world-x"] | None = None  # into the part; see `load_workpiece`
    mesh_spacing_m: Annotated[float, Field(gt=0, le=LARGEST)] | None = None  # widest gap of the points on a mesh
    tip_contact_m: Annotated[float, Field(ge=0, le=LARGEST)] | None = None  # of the bare tip, from the TCP; null: all
    pivot_m: Point = PIVOT  # world point that the rotations turn about
    neutral_translation_m: Point = NEUTRAL_TRANSLATION  # of the workpiece frame, before they turn it
    rotation_y_rad: float = 0.4
    rotation_z_rad: float = 0.1
    shift_m: Point = (0.0, 0.0, 0.0)
    approach_to_inlet: Steps = 5  # equal steps from the start's TCP to the inlet
    approach_to_path: Steps = 5  # and from there to the first point of the path

    @model_validator(mode="before")
    @classmethod
    def _own_part(cls, raw: Any) -> Any:
        """The tip of a tool stays out of the walls of a part of one's own; the paper's duct exempts it."""
        if isinstance(raw, dict) and raw.get("cloud", "duct") != "duct":
            return {"tip_contact_m": TIP_CONTACT_M} | raw
        return raw


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
    def _known_method(cls, name: str, info) -> str:
        of_record = info.context is RECORD and NAME.fullmatch(name)  # by a planner of one's own, which is not here now
        if name not in METHODS and not of_record:
            raise InputError(f"{name!r} is no method; valid: {', '.join(METHODS)}")
        return name


FILES = {("robot", "model"): "gp50", ("workpiece", "cloud"): "duct", ("workpiece", "path"): "weld"}


def load_config(
    path: str | Path | Mapping[str, Any] | None = None, overrides: Sequence[str] | Mapping[str, Any] = ()
) -> PlanConfig:
    """The default job, changed by the YAML file at `path`, then by `overrides`: "dotted.key=value" each, or a mapping.

    A mapping in the place of the path spells a job as a file would, {"workpiece": {"rotation_y_rad": 0.5}}; files in it
    are relative to the working folder.

    Raises InputError for a file that cannot be read, is no YAML mapping or repeats a key, for an unknown key
    and for a value of the wrong type or outside its range.
    """
    raw, source = {}, "the default configuration"
    if isinstance(path, Mapping):
        raw, source = copy.deepcopy(dict(path)), "the configuration"
    elif path is not None:
        source = str(path)
        raw = read_yaml(path)
        _anchor_files(raw, Path(path).parent)
    pairs = overrides.items() if isinstance(overrides, Mapping) else map(_parsed, overrides)
    for dotted, value in pairs:
        _set(raw, dotted, value)
    return validate(raw, PlanConfig, source)


def validate(raw: dict, model: type[BaseModel], source: str, *, of_record: bool = False) -> Any:
    """`raw` as a `model`; `of_record`: of results that are there, by a method that need not be known.

    Raises InputError that names the first offender and how many more there are."""
    _refuse_unknown(raw, model, source)
    try:
        return model.model_validate(raw, context=RECORD if of_record else None)
    except ValidationError as error:
        first, *more = error.errors()
        others = f" (and {len(more)} more)" if more else ""
        raise InputError(f"{source}: {_sentence(first)}{others}") from None


def _anchor_files(raw: dict, folder: Path) -> None:
    """Make file names in `raw` relative to `folder`; the words of the built-in parts stay."""
    for (section, key), word in FILES.items():
        value = raw.get(section)
        if isinstance(value, dict) and isinstance(value.get(key), str) and value[key] != word:
            value[key] = str(folder / value[key])


def _parsed(override: str) -> tuple[str, Any]:
    dotted, equals, text = override.partition("=")
    if not equals or not dotted:
        raise InputError(f"--set expects key=value, not {override!r}")
    return dotted, parse_yaml(text, f"--set {override}")


def _set(raw: dict, dotted: str, value: Any) -> None:
    *sections, key = dotted.split(".")
    for section in sections:
        if not isinstance(raw.get(section), dict):
            raw[section] = {}
        raw = raw[section]
    raw[key] = value


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
        is_section = is_dataclass(kinds[key]) or hasattr(kinds[key], "model_fields")
        if is_section and value is None:
            del raw[key]  # a section whose lines are all commented out
        elif is_section and isinstance(value, dict):
            _refuse_unknown(value, kinds[key], source, f"{prefix}{key}.")
        elif kinds[key] is not bool and any(isinstance(item, bool) for item in _items(value)):
            raise InputError(f"{source}: {prefix}{key} is {reprlib.repr(value)}: true and false are no numbers")


def _items(value: Any) -> Sequence[Any]:
    return value if isinstance(value, list | tuple) else [value]


def _sentence(error: dict) -> str:
    """One pydantic error in our words."""
    where = ".".join(str(part) for part in error["loc"])
    cause = error.get("ctx", {}).get("error")
    if isinstance(cause, InputError):
        return f"{where}.{cause}" if where == "settings" else f"{where}: {cause}"
    return f"{where} is {reprlib.repr(error['input'])}: {error['msg'][0].lower()}{error['msg'][1:]}"
