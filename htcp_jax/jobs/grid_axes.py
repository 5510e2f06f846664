"""Axes of a grid: functions that read them from a file, record them in a manifest and apply them to a job."""

import difflib
import itertools
import math
import os
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from htcp_jax.errors import InputError
from htcp_jax.jobs import draws
from htcp_jax.spec import (
    AUTO,
    DEPENDENT,
    FILES,
    PART_SEAMS,
    SOURCES,
    TOOL_ANGLES,
    PlanConfig,
    SeamConfig,
    strict_model,
)

MOST = 1_000_000  # maximum number of scenarios in a sweep
# Keys that have columns in the tables of every run. Other keys have columns only in runs that vary them.
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
NO_AXIS = "method", "program", "ray"  # keys that cannot vary: methods are listed apart; the others do not affect plans
MOST_ROWS = 8  # axes may vary this many rows of a task
OF_A_ROW = {  # may vary
    "cone_deg": 0.0,
    "within_deg": 0.0,
    "within_m": 0.0,
    "offset_m": (0.0, 0.0, 0.0),
    **dict.fromkeys(TOOL_ANGLES, 0.0),
}
FILE_KEYS = {".".join(key): words for key, words in FILES.items()}
LISTS = "task", "cell.clouds", "cell.fixtures", "cell.obstacles"  # only keys of their elements may vary
LOCKED = "robot.locked"  # a mapping whose keys are names of joints
OF_A_KIND = re.compile(  # keys of obstacles and task rows from other packages, and locked joints
    r"((?:cell\.obstacles|task)\.[1-9]\d*\.[a-zA-Z_]\w*|robot\.locked\.[^.]+)(?:\.([xyz]))?"
)
XYZ = "xyz"
DISTRIBUTIONS = {"uniform": "[LOW, HIGH]", "normal": "[MEAN, SIGMA]"}  # of random axes
SEAM = "seam"  # name of the axis over the seams of a part; its values are their names


def _varied_keys() -> dict[str, Any]:
    """Return the defaults of all keys that an axis may vary, by key."""
    found = {}
    for name, value in PlanConfig().model_dump().items():
        if name == "task":
            found |= {f"task.{k}.{key}": default for k in range(1, MOST_ROWS + 1) for key, default in OF_A_ROW.items()}
        elif name not in NO_AXIS:
            found |= {f"{name}.{key}": v for key, v in value.items()} if isinstance(value, dict) else {name: value}
    for key in LISTS:
        found.pop(key, None)
    return found


KEYS = _varied_keys()


class AxisParameter(NamedTuple):
    """A quantity that an axis may vary: a key of the configuration, or one element of a key's value."""

    name: str  # such as start_rad.joint3
    key: str  # such as start_rad
    element: int | None  # index in the value, such as 2; None: the complete value


class Distribution(NamedTuple):
    """Distribution of a random axis, as written in the sweep file."""

    name: str  # in DISTRIBUTIONS
    numbers: tuple[float, float]
    count: int  # number of values

    def draw(self, seed: int, name: str) -> tuple[float, ...]:
        """Return the values, which the seed and the parameter's name determine, so that other axes do not."""
        return getattr(draws, self.name)(seed, name, *map(float, self.numbers), self.count)


class AxisColumn(NamedTuple):
    """One parameter of an axis, with its values."""

    parameter: AxisParameter
    relative: bool  # True if the values are added to the configuration's value
    values: tuple[Any, ...]
    distribution: Distribution | None = None  # from which the values are drawn; not part of a sweep's identity


GridAxis = tuple[AxisColumn, ...]  # parameters that vary jointly, with equal numbers of values


class Group(NamedTuple):
    """A grid of scenarios; `name` is its key in `groups`, or None if the sweep has `grid` instead."""

    name: str | None
    axes: tuple[GridAxis, ...]

    @property
    def size(self) -> int:
        """Number of scenarios in the grid."""
        return math.prod(len(axis[0].values) for axis in self.axes)

    @property
    def keys(self) -> set[str]:
        """Keys of the configuration that vary."""
        return {column.parameter.key for axis in self.axes for column in axis}

    def with_value(self, key: str, old: Any, new: Any) -> "Group":
        """Return the grid with a value of a key replaced by another one in all axes."""

        def replaced(column: AxisColumn) -> AxisColumn:
            values = tuple(new if value == old else value for value in column.values)
            return column._replace(values=values) if column.parameter.key == key else column

        return self._replace(axes=tuple(tuple(map(replaced, axis)) for axis in self.axes))

    def rows(self) -> Iterator[list[tuple[AxisColumn, Any]]]:
        """Yield, for every scenario, its pairs of column and value; the last axis varies fastest."""
        for rows in itertools.product(*(range(len(axis[0].values)) for axis in self.axes)):
            yield [(column, column.values[row]) for axis, row in zip(self.axes, rows, strict=True) for column in axis]


class ScenarioPoint(NamedTuple):
    """One scenario of a sweep, with the configuration that plans it as a single job."""

    number: int
    group: str | None
    config: PlanConfig
    varied: Mapping[str, str] = {}  # JSON values of the varied keys that are not in PARAMETERS, by key


def read_grid(
    where: str, folder: Path, name: str | None, axes: Sequence[dict], joints: Sequence[str], seed: int
) -> Group:
    """Return the grid that a list of axes in a sweep file describes.

    Args:
        where: Name of the grid, for messages.
        folder: Folder to which file names are relative.
        name: Key of the grid in `groups`; None if the file has `grid` instead.
        axes: The axes as written in the file.
        joints: Names of the robot's joints.
        seed: Seed of the values of random axes.

    Raises:
        InputError: If the grid is empty, an axis is invalid, or a parameter is repeated.
    """
    if not axes:
        raise InputError(f"{where} is empty; it needs at least one axis")
    known = parameters(joints)
    read = tuple(_read_axis(f"{where}, axis {k}", folder, axis, known, seed) for k, axis in enumerate(axes, 1))
    seen = set()
    for column in itertools.chain.from_iterable(read):
        if column.parameter in seen:
            raise InputError(f"{where}: {column.parameter.name} is repeated")
        seen.add(column.parameter)
    return Group(name, read)


def parameters(joints: Sequence[str]) -> dict[str, AxisParameter]:
    """Return all parameters by the names that a sweep file may use; a parameter may have several names."""
    known = {name: AxisParameter(name, name, None) for name in (*PARAMETERS, *KEYS)}
    known[SEAM] = AxisParameter(SEAM, PART_SEAMS, None)
    for k, joint in enumerate(joints):
        known[f"start_rad.{k + 1}"] = known[f"start_rad.{joint}"] = AxisParameter(f"start_rad.{joint}", "start_rad", k)
    for key, default in KEYS.items():
        if isinstance(default, tuple) and len(default) == 3:
            known |= {f"{key}.{axis}": AxisParameter(f"{key}.{axis}", key, k) for k, axis in enumerate(XYZ)}
    return known


def with_seams(group: Group, seams: Sequence[SeamConfig], where: str) -> Group:
    """Return a grid with an axis over its job's seams; unchanged if it has this axis, or if the job has one seam.

    Args:
        group: The grid.
        seams: The seams.
        where: Name of the grid, for messages.

    Raises:
        InputError: If the path varies in addition to the seams.
    """
    if seams and "workpiece.path" in group.keys:
        raise InputError(f"{where}: workpiece.path varies, but the job has seams; vary {SEAM} instead, by their names")
    if len(seams) < 2 or PART_SEAMS in group.keys:
        return group
    column = AxisColumn(AxisParameter(SEAM, PART_SEAMS, None), False, tuple(seam.name for seam in seams))
    return group._replace(axes=(*group.axes, (column,)))


def kind_parameter(name: str) -> AxisParameter | None:
    """Return the parameter with this name: a key of an obstacle or a task row of another package, or a locked joint.

    None for any other name. `put_parameter` checks that the key exists.
    """
    if (found := OF_A_KIND.fullmatch(name)) is None:
        return None
    key, letter = found.groups()
    return AxisParameter(name, key, None if letter is None else XYZ.index(letter))


def put_parameter(raw: dict, column: AxisColumn, value: Any) -> None:
    """Set one parameter in a configuration of plain values.

    Args:
        raw: The configuration; it is modified, but not the mappings and lists in it: those that change are replaced.
        column: The parameter.
        value: The value or the offset.

    Raises:
        InputError: If an offset or an element applies to a missing value, or if the value has no such element.
    """
    parameter = column.parameter
    if parameter.name == SEAM:
        raw["workpiece"] = raw["workpiece"] | {"seams": (_seam(raw["workpiece"].get("seams", ()), value),)}
        return
    owner, key = _own_copy(raw, parameter), parameter.key.rpartition(".")[2]
    old = owner[key]
    if old is None and column.relative:
        raise InputError(f"{parameter.name} is not set, so it cannot have offsets; use values")
    if old == AUTO and (column.relative or parameter.element is not None):
        raise InputError(f"{parameter.name}: {parameter.key} is {AUTO}, which has no joint positions to vary")
    if parameter.element is None:
        owner[key] = _added(parameter, old, value) if column.relative else value
        return
    if old is None or parameter.element >= len(old):
        length = "null" if old is None else f"a list of {len(old)}"
        raise InputError(f"{parameter.name}: {parameter.key} is {length}, so this element cannot vary")
    new = list(old)
    new[parameter.element] = old[parameter.element] + value if column.relative else value
    owner[key] = tuple(new)


def _seam(seams: Sequence[dict], name: Any) -> dict:
    """Return the seam with this name, which waits for no other."""
    for seam in seams:
        if seam["name"] == str(name):
            return seam | {"after": ()}
    names = ", ".join(seam["name"] for seam in seams) or "the job has no key seams"
    raise InputError(f"{SEAM} is {name!r}; valid: {names}")


def _own_copy(raw: dict, parameter: AxisParameter) -> dict:
    """Copy the mapping that contains the parameter's key, and what contains this mapping, in `raw`; return the copy.

    Raises:
        InputError: If the key does not exist.
    """
    section, _, key = parameter.key.rpartition(".")
    owner: Any = raw
    for name in section.split(".") if section else ():
        if isinstance(owner, list) and int(name) > len(owner):
            list_of, rows = ("the task", "rows") if owner is raw["task"] else ("the cell", "obstacles")
            raise InputError(f"{parameter.name}: {list_of} has {len(owner)} {rows}; they are numbered from 1")
        place = int(name) - 1 if isinstance(owner, list) else name
        owner[place] = dict(owner[place]) if isinstance(owner[place], dict) else list(owner[place])
        owner = owner[place]
    if section == LOCKED:
        if key not in owner:
            raise InputError(f"{parameter.name}: robot.locked has no joint {key}; valid: {', '.join(owner) or 'none'}")
        return owner
    if key not in owner or (parameter.key not in KEYS and strict_model.KIND not in owner):
        valid = [name for name in owner if name != strict_model.KIND] if strict_model.KIND in owner else OF_A_ROW
        raise InputError(f"{parameter.name}: {section} has no key {key} that can vary; valid: {', '.join(valid)}")
    return owner


def group_record(group: Group, stated: Collection[str]) -> dict[str, Any]:
    """Return the record of a grid for a manifest, with absolute file names.

    Args:
        group: The grid.
        stated: Keys that the configuration sets; recorded only if the axes affect the defaults of other keys.
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


def drawn_axes(group: Group) -> list[dict[str, Any]]:
    """Return the distributions of a grid's random axes, as in a sweep file, for `Manifest.drawn`."""
    return [
        {"group": group.name, "parameter": column.parameter.name, "relative": column.relative}
        | {given.name: given.numbers, "count": given.count}
        for column in itertools.chain.from_iterable(group.axes)
        if (given := column.distribution)
    ]


def from_record(record: Mapping[str, Any], joints: Sequence[str]) -> Group:
    """Return the grid that a `group_record` describes; unknown entries of the record are ignored.

    Args:
        record: The record.
        joints: Names of the robot's joints.
    """
    known = parameters(joints)

    def column(name: str, values: Mapping[str, list]) -> AxisColumn:
        ((kind, items),) = values.items()
        return AxisColumn(known.get(name) or kind_parameter(name), kind == "offsets", tuple(map(_hashable, items)))

    return Group(record["name"], tuple(tuple(column(*item) for item in axis.items()) for axis in record["axes"]))


def absolute(name: str | None, words: Collection[str | None]) -> str | None:
    """Return a file name as an absolute path. Values in `words`, such as names of built-in parts, are not changed."""
    return name if name in words else str(Path(name).resolve())


def has_own_defaults(group: Group) -> bool:
    """Return True if the scenarios of a grid may have different defaults, see `spec.defaults.own_defaults`."""
    return bool(group.keys & {*SOURCES})


def varied_keys(names: Collection[str]) -> tuple[str, ...]:
    """Return the keys that vary and are not in PARAMETERS, given the names of the parameters of all axes."""
    given = {name: kind_parameter(name) for name in names if name not in KEYS}
    names = [given[name].key if given.get(name) else name for name in names]
    own = tuple(dict.fromkeys(name for name in names if OF_A_KIND.fullmatch(name) and name not in KEYS))
    own += (SEAM,) if SEAM in names else ()
    keys = dict.fromkeys(name if name in KEYS else name.rpartition(".")[0] for name in names)
    if keys.keys() & SOURCES:
        keys |= dict.fromkeys(DEPENDENT)
    return *(key for key in KEYS if key in keys and key not in PARAMETERS), *own


def _read_axis(where: str, folder: Path, raw: dict, known: dict[str, AxisParameter], seed: int) -> GridAxis:
    if not raw:
        raise InputError(f"{where} is empty; it needs at least one parameter")
    axis = tuple(_read_column(where, folder, str(key), value, known, seed) for key, value in raw.items())
    lengths = {column.parameter.name: len(column.values) for column in axis}
    if len(set(lengths.values())) > 1:
        counts = ", ".join(f"{name} has {length} values" for name, length in lengths.items())
        raise InputError(f"{where}: the values of one axis vary jointly, but {counts}")
    return axis


def _read_column(
    where: str, folder: Path, key: str, value: Any, known: dict[str, AxisParameter], seed: int
) -> AxisColumn:
    if (parameter := known.get(key) or kind_parameter(key)) is None:
        raise InputError(f"{where}: {_unknown(key, known)}")
    relative = isinstance(value, dict) and list(value) == ["offsets"]
    if isinstance(value, dict) and list(value) in (["offsets"], ["values"]):
        (value,) = value.values()
    distribution = None
    if isinstance(value, dict) and value.keys() & DISTRIBUTIONS.keys():
        distribution = _distribution(f"{where}: {key}", parameter, value)
        value = distribution.draw(seed, parameter.name)
    if not isinstance(value, list | tuple):
        raise InputError(
            f"{where}: {key} needs a list of values, {{values: [...]}}, {{offsets: [...]}}, "
            "{uniform: [LOW, HIGH], count: N}, {normal: [MEAN, SIGMA], count: N}, {offsets: {uniform: ...}} or "
            "{offsets: {normal: ...}}"
        )
    if not value:
        raise InputError(f"{where}: {key} has no values")
    for item in value:
        _check_value(f"{where}: {key}", parameter, item, relative)
    words = FILE_KEYS.get(parameter.key)
    if words is not None:  # file names are relative to the sweep file's folder
        value = [item if item in words else str(folder / item) for item in value]
    return AxisColumn(parameter, relative, tuple(map(_hashable, value)), distribution)


def _distribution(where: str, parameter: AxisParameter, given: Mapping[str, Any]) -> Distribution:
    """Return the distribution of a random axis.

    Args:
        where: Name of the parameter, for messages.
        parameter: The parameter.
        given: The distribution with two numbers, and the number of values.

    Raises:
        InputError: If the distribution is invalid, or if the parameter does not take numbers that may have decimals.
    """
    default = KEYS.get(parameter.key, 0.0)
    whole = type(default) is int or (isinstance(default, tuple) and parameter.element is None)
    if whole or not isinstance(default, int | float | tuple | None) or parameter.key in FILE_KEYS:
        raise InputError(f"{where} cannot be drawn: only single numbers with decimals can, such as start_rad.3")
    names = [name for name in given if name in DISTRIBUTIONS]
    if len(names) > 1 or given.keys() != {*names, "count"}:
        raise InputError(f"{where}: a random axis has one of {' and '.join(DISTRIBUTIONS)}, and count; no other key")
    (name,), count = names, given["count"]
    pair = given[name] if isinstance(given[name], list | tuple) else ()
    if len(pair) != 2 or not all(map(_is_number, pair)):
        raise InputError(f"{where}: {name} needs two numbers, {DISTRIBUTIONS[name]}, not {given[name]!r}")
    if not (pair[0] < pair[1] if name == "uniform" else pair[1] > 0):
        what = "LOW must be less than HIGH" if name == "uniform" else "SIGMA must be positive"
        raise InputError(f"{where}: {what} in {name}: {given[name]!r}")
    if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= MOST:
        raise InputError(f"{where}: count is {count!r}; valid: 1 to {MOST:,}")
    return Distribution(name, (pair[0], pair[1]), count)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _unknown(key: str, known: Collection[str]) -> str:
    if key.partition(".")[0] in NO_AXIS:
        return f"{key} cannot vary within a sweep; valid: any other key of the job, {', '.join(PARAMETERS)}"
    if key in LISTS:
        return f"{key} is a list, which cannot vary; write one job file per list, and sweep each with --config"
    if key.removeprefix("start_rad.").isdecimal():
        joints = sum(name.removeprefix("start_rad.").isdecimal() for name in known)
        return f"unknown parameter {key}; joints are counted from 1; valid: start_rad.1 to start_rad.{joints}"
    close = difflib.get_close_matches(key, known, n=2, cutoff=0.6)
    hint = f"did you mean {' or '.join(close)}? " if close else ""
    others = f"{', '.join(NO_AXIS[:-1])} and {NO_AXIS[-1]}"
    return f"unknown parameter {key}; {hint}valid: any key of the configuration but {others}; start_rad.3 is joint 3"


def _check_value(where: str, parameter: AxisParameter, item: Any, relative: bool) -> None:
    """Check the type of a parameter's value. The range is checked later, with the configuration.

    Args:
        where: Name of the value, for messages.
        parameter: The parameter.
        item: The value.
        relative: True if the value is an offset.

    Raises:
        InputError: If the value has another type.
    """
    default = KEYS.get(parameter.key)  # None: a key of another package's kind, which checks its own values
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
        if not _is_number(number):
            raise InputError(f"{where} takes finite numbers, not {number!r}")


def _added(parameter: AxisParameter, old: Any, offset: Any) -> Any:
    if not isinstance(old, tuple):
        return old + offset
    if len(old) != len(offset):
        raise InputError(f"{parameter.name} has {len(old)} values, but its offset has {len(offset)}")
    return tuple(a + b for a, b in zip(old, offset, strict=True))


def _hashable(item: Any) -> Any:
    return tuple(item) if isinstance(item, list) else item
