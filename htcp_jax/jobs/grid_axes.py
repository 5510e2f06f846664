"""Axes of a grid: their keys, reading from a file, recording in a manifest, application to a configuration."""

import difflib
import itertools
import math
import os
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from htcp_jax.errors import InputError
from htcp_jax.io import strict_model
from htcp_jax.jobs.config import AUTO, DEPENDENT, SOURCES, PlanConfig
from htcp_jax.jobs.config_file import FILES

MOST = 1_000_000  # scenarios of a grid
# Keys with columns of their own in the tables of a run.
PARAMETERS = (
    "start_rad",
    "workpiece.rotation_x_rad",
    "workpiece.rotation_y_rad",
    "workpiece.rotation_z_rad",
    "workpiece.shift_m",
    "workpiece.path",
    "robot.tool_extension_m",
    "margin_m",
)
NO_AXIS = "method", "program", "ray"  # a sweep has its own list of methods; the others have no influence on plans
MOST_ROWS = 8  # of a task that an axis may name
OF_A_ROW = {"cone_deg": 0.0, "within_deg": 0.0, "within_m": 0.0, "offset_m": (0.0, 0.0, 0.0)}  # keys that may vary
FILE_KEYS = {".".join(key): words for key, words in FILES.items()}
LOCKED = "robot.locked"  # its keys are the names of the joints
OF_A_KIND = re.compile(  # of other packages, and of locked joints
    r"((?:cell\.obstacles|task)\.[1-9]\d*\.[a-zA-Z_]\w*|robot\.locked\.[^.]+)(?:\.([xyz]))?"
)
XYZ = "xyz"


def _varied_keys() -> dict[str, Any]:
    """Return every key that an axis may vary, with its default."""
    found = {}
    for name, value in PlanConfig().model_dump().items():
        if name == "task":
            found |= {f"task.{k}.{key}": default for k in range(1, MOST_ROWS + 1) for key, default in OF_A_ROW.items()}
        elif name not in NO_AXIS:
            found |= {f"{name}.{key}": v for key, v in value.items()} if isinstance(value, dict) else {name: value}
    for name in ("clouds", "fixtures", "obstacles"):  # lists
        del found[f"cell.{name}"]
    return found


KEYS = _varied_keys()


class AxisParameter(NamedTuple):
    """A quantity that an axis may vary: a key of the configuration, or one element of its value."""

    name: str  # start_rad.joint3
    key: str  # start_rad
    element: int | None  # 2


class AxisColumn(NamedTuple):
    """One parameter of an axis."""

    parameter: AxisParameter
    relative: bool  # True if the values are offsets
    values: tuple[Any, ...]


GridAxis = tuple[AxisColumn, ...]  # columns of equal length


class Group(NamedTuple):
    """A grid; `name` is None if the file has only one."""

    name: str | None
    axes: tuple[GridAxis, ...]

    @property
    def size(self) -> int:
        """Number of scenarios."""
        return math.prod(len(axis[0].values) for axis in self.axes)

    @property
    def keys(self) -> set[str]:
        """Keys that vary."""
        return {column.parameter.key for axis in self.axes for column in axis}

    def rows(self) -> Iterator[list[tuple[AxisColumn, Any]]]:
        """Yield the columns with their values for every scenario; the last axis moves fastest."""
        for rows in itertools.product(*(range(len(axis[0].values)) for axis in self.axes)):
            yield [(column, column.values[row]) for axis, row in zip(self.axes, rows, strict=True) for column in axis]


class ScenarioPoint(NamedTuple):
    """One scenario of a sweep: its configuration, as if it were planned alone."""

    number: int
    group: str | None
    config: PlanConfig
    varied: Mapping[str, str] = {}  # JSON by key, for varied keys without a column of their own


def read_grid(where: str, folder: Path, name: str | None, axes: Sequence[dict], joints: Sequence[str]) -> Group:
    """Read a grid from a sweep file.

    Args:
        where: Name of the grid, for messages.
        folder: Folder to which file names are relative.
        name: Name of the group; None without groups.
        axes: The axes as in the file.
        joints: Names of the robot's joints.

    Raises:
        InputError: For an empty grid, an invalid axis, and a repeated parameter.
    """
    if not axes:
        raise InputError(f"{where} is empty; it needs at least one axis")
    known = parameters(joints)
    read = tuple(_read_axis(f"{where}, axis {k}", folder, axis, known) for k, axis in enumerate(axes, 1))
    seen = set()
    for column in itertools.chain.from_iterable(read):
        if column.parameter in seen:
            raise InputError(f"{where}: {column.parameter.name} is repeated")
        seen.add(column.parameter)
    return Group(name, read)


def parameters(joints: Sequence[str]) -> dict[str, AxisParameter]:
    """Return all parameters by every name that a sweep file may use."""
    known = {name: AxisParameter(name, name, None) for name in (*PARAMETERS, *KEYS)}
    for k, joint in enumerate(joints):
        known[f"start_rad.{k + 1}"] = known[f"start_rad.{joint}"] = AxisParameter(f"start_rad.{joint}", "start_rad", k)
    for key, default in KEYS.items():
        if isinstance(default, tuple) and len(default) == 3:
            known |= {f"{key}.{axis}": AxisParameter(f"{key}.{axis}", key, k) for k, axis in enumerate(XYZ)}
    return known


def kind_parameter(name: str) -> AxisParameter | None:
    """Return the parameter of an obstacle or a row of another package, or of a locked joint; None for other names.

    Whether there is such a key is checked by `put_parameter`.
    """
    if (found := OF_A_KIND.fullmatch(name)) is None:
        return None
    key, letter = found.groups()
    return AxisParameter(name, key, None if letter is None else XYZ.index(letter))


def put_parameter(raw: dict, column: AxisColumn, value: Any) -> None:
    """Set one parameter in a plain configuration.

    Raises:
        InputError: For an offset or an element of a value that is not given, and for an element that it lacks.
    """
    parameter = column.parameter
    owner, key = _owner(raw, parameter), parameter.key.rpartition(".")[2]
    old = owner[key]
    if old is None and column.relative:
        raise InputError(f"{parameter.name} is not given, so nothing can be added to it")
    if old == AUTO and (column.relative or parameter.element is not None):
        raise InputError(f"{parameter.name}: {parameter.key} is {AUTO}, which has no joint positions to vary")
    if parameter.element is None:
        owner[key] = _added(parameter, old, value) if column.relative else value
        return
    if old is None or parameter.element >= len(old):
        raise InputError(f"{parameter.name}: {parameter.key} has {len(old or ())} values only")
    new = list(old)
    new[parameter.element] = old[parameter.element] + value if column.relative else value
    owner[key] = tuple(new)


def _owner(raw: dict, parameter: AxisParameter) -> dict:
    """Return the part of a plain configuration that has the parameter's key.

    Raises:
        InputError: If it has no such key.
    """
    section, _, key = parameter.key.rpartition(".")
    if section == LOCKED:
        owner = raw["robot"]["locked"] = dict(raw["robot"]["locked"])
        if key not in owner:
            raise InputError(f"{parameter.name}: robot.locked has no joint {key}; valid: {', '.join(owner) or 'none'}")
        return owner
    owner = _task_row(raw, parameter) if section[-1:].isdecimal() else raw[section] if section else raw
    if key not in owner or (parameter.key not in KEYS and strict_model.KIND not in owner):
        valid = (
            ", ".join(name for name in owner if name != strict_model.KIND)
            if strict_model.KIND in owner
            else ", ".join(OF_A_ROW)
        )
        raise InputError(f"{parameter.name}: {section} has no key {key} that may vary; valid: {valid}")
    return owner


def _task_row(raw: dict, parameter: AxisParameter) -> dict:
    """Return the row of the task, or the obstacle, to which a parameter belongs.

    The list in `raw` is replaced by a copy.
    """
    *sections, name, number, _ = parameter.key.split(".")
    for section in sections:
        raw = raw[section]
    rows = raw[name] = tuple(dict(row) for row in raw[name])
    if int(number) > len(rows):
        what = f"the task has {len(rows)} rows" if name == "task" else f"the cell has {len(rows)} obstacles"
        raise InputError(f"{parameter.name}: {what}")
    return rows[int(number) - 1]


def group_record(group: Group, stated: Collection[str]) -> dict[str, Any]:
    """Return a group as recorded in a manifest, with absolute file names.

    It contains the `stated` keys if the group's axes affect defaults.
    """

    def values(column: AxisColumn) -> list:
        words = FILE_KEYS.get(column.parameter.key)
        return [value if words is None else absolute(value, words) for value in column.values]

    axes = [
        {column.parameter.name: {"offsets" if column.relative else "values": values(column)} for column in axis}
        for axis in group.axes
    ]
    known = {"stated": sorted(stated)} if has_own_defaults(group) else {}
    return {"name": group.name, "axes": axes, **known}


def from_record(record: Mapping[str, Any], joints: Sequence[str]) -> Group:
    """Return the group of a `group_record`; other entries are ignored."""
    known = parameters(joints)

    def column(name: str, values: Mapping[str, list]) -> AxisColumn:
        ((kind, items),) = values.items()
        return AxisColumn(known.get(name) or kind_parameter(name), kind == "offsets", tuple(map(_hashable, items)))

    return Group(record["name"], tuple(tuple(column(*item) for item in axis.items()) for axis in record["axes"]))


def absolute(name: str | None, words: Collection[str | None]) -> str | None:
    """Return an absolute file name; None and the names of built-in parts stay if they are among `words`."""
    return name if name in words else str(Path(name).resolve())


def has_own_defaults(group: Group) -> bool:
    """Return True if the defaults depend on the scenario, see `defaults.own_defaults`."""
    return bool(group.keys & {*SOURCES, "workpiece.neutral_translation_m"})


def varied_keys(names: Collection[str]) -> tuple[str, ...]:
    """Return the varied keys without a column of their own, given the names of all axes' parameters."""
    given = {name: kind_parameter(name) for name in names if name not in KEYS}
    names = [given[name].key if given.get(name) else name for name in names]
    own = tuple(dict.fromkeys(name for name in names if OF_A_KIND.fullmatch(name) and name not in KEYS))
    keys = dict.fromkeys(name if name in KEYS else name.rpartition(".")[0] for name in names)
    if keys.keys() & SOURCES or "workpiece.neutral_translation_m" in keys:
        keys |= dict.fromkeys(DEPENDENT)
    return *(key for key in KEYS if key in keys and key not in PARAMETERS), *own


def _read_axis(where: str, folder: Path, raw: dict, known: dict[str, AxisParameter]) -> GridAxis:
    if not raw:
        raise InputError(f"{where} is empty; it needs at least one parameter")
    axis = tuple(_read_column(where, folder, str(key), value, known) for key, value in raw.items())
    lengths = {column.parameter.name: len(column.values) for column in axis}
    if len(set(lengths.values())) > 1:
        counts = ", ".join(f"{name} has {length} values" for name, length in lengths.items())
        raise InputError(f"{where}: the values of one axis vary jointly, but {counts}")
    return axis


def _read_column(where: str, folder: Path, key: str, value: Any, known: dict[str, AxisParameter]) -> AxisColumn:
    if (parameter := known.get(key) or kind_parameter(key)) is None:
        raise InputError(f"{where}: {_unknown(key, known)}")
    relative = isinstance(value, dict) and list(value) == ["offsets"]
    if isinstance(value, dict) and list(value) in (["offsets"], ["values"]):
        (value,) = value.values()
    if not isinstance(value, list | tuple):
        raise InputError(f"{where}: {key} needs a list of values, {{values: [...]}} or {{offsets: [...]}}")
    if not value:
        raise InputError(f"{where}: {key} has no values")
    for item in value:
        _check_value(f"{where}: {key}", parameter, item, relative)
    words = FILE_KEYS.get(parameter.key)
    if words is not None:  # relative to the sweep file's folder
        value = [item if item in words else str(folder / item) for item in value]
    return AxisColumn(parameter, relative, tuple(map(_hashable, value)))


def _unknown(key: str, known: Collection[str]) -> str:
    if key.partition(".")[0] in NO_AXIS:
        return f"{key} cannot vary within a sweep; valid is any other key of the configuration, {', '.join(PARAMETERS)}"
    close = difflib.get_close_matches(key, known, n=2, cutoff=0.6)
    hint = f"did you mean {' or '.join(close)}? " if close else ""
    others = f"{', '.join(NO_AXIS[:-1])} and {NO_AXIS[-1]}"
    return f"unknown parameter {key}; {hint}valid: any key of the configuration but {others}, one joint as start_rad.3"


def _check_value(where: str, parameter: AxisParameter, item: Any, relative: bool) -> None:
    """Check that `item` has the parameter's type; its range is checked with the configuration.

    Raises:
        InputError: If it has not.
    """
    default = KEYS.get(parameter.key)  # None: of a kind, which checks its values itself
    if parameter.key in FILE_KEYS:
        if relative or not (item in FILE_KEYS[parameter.key] or isinstance(item, str | os.PathLike)):
            raise InputError(f"{where} takes names of files, not {item!r}")
        return
    is_list = isinstance(default, tuple) and parameter.element is None
    is_list |= parameter.key not in KEYS and relative and isinstance(item, list | tuple)
    is_number = is_list or parameter.element is not None or type(default) in (int, float)
    is_number |= parameter.key not in KEYS and relative
    if not is_number:
        if relative:
            raise InputError(f"{where} takes values, not offsets")
        return
    if is_list and not isinstance(item, list | tuple):
        raise InputError(f"{where} takes lists of numbers, not {item!r}")
    for number in item if is_list else [item]:
        if isinstance(number, bool) or not isinstance(number, int | float) or not math.isfinite(number):
            raise InputError(f"{where} takes finite numbers, not {number!r}")


def _added(parameter: AxisParameter, old: Any, offset: Any) -> Any:
    if not isinstance(old, tuple):
        return old + offset
    if len(old) != len(offset):
        raise InputError(f"{parameter.name} has {len(old)} values, an offset of it {len(offset)}")
    return tuple(a + b for a, b in zip(old, offset, strict=True))


def _hashable(item: Any) -> Any:
    return tuple(item) if isinstance(item, list) else item
