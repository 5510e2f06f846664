"""The sweep file: a grid of scenarios around one configuration.

    config: ../configs/paper.yaml            # what all scenarios share; without it the default job
    grid:                                    # axes multiply; the last one moves fastest
      - start_rad.3: {offsets: [-0.1, 0, 0.1]}    # added to the configuration's value
      - workpiece.rotation_y_rad: [0.4, 0.5]      # parameters of one axis go together, value by value
        workpiece.rotation_z_rad: [0.1, 0.2]      # so this grid has 3 x 2 scenarios

A parameter is a key of the configuration that scenarios may differ in: see `PARAMETERS`. Joints go by number, from 1,
or by name. Later axes act on what earlier ones left, so an axis may set `start_rad` and the next ones move single
joints. Instead of `grid`, `groups` maps names to grids; their scenarios follow each other. A scenario's number, which
its random keys hang on, is its place in the full grid.
"""

import difflib
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from htcp_jax.config import PlanConfig, Section, load_config, validate
from htcp_jax.errors import InputError
from htcp_jax.job import robot_of, scenario_of, workpiece_of
from htcp_jax.robot import Robot
from htcp_jax.scenario import Scenario, stack
from htcp_jax.strict_yaml import read_yaml
from htcp_jax.workpiece import Workpiece

PARAMETERS = (
    "start_rad",
    "workpiece.rotation_y_rad",
    "workpiece.rotation_z_rad",
    "workpiece.shift_m",
    "workpiece.path",
    "robot.tool_extension_m",
    "margin_m",
)
MOST = 1_000_000  # scenarios of a grid; more is a slip of the pen


class SweepFile(Section):
    """What a person writes; `_read_axis` checks the axes."""

    config: str | None = None
    grid: tuple[dict, ...] | None = None
    groups: dict[str, tuple[dict, ...]] | None = None


class Parameter(NamedTuple):
    """What an axis may vary: a key of the configuration, or one element of a key's value."""

    name: str  # start_rad.joint3
    key: str  # start_rad
    element: int | None  # 2


class Column(NamedTuple):
    """One parameter of an axis."""

    parameter: Parameter
    relative: bool  # whether the values are added
    values: tuple[Any, ...]


Axis = tuple[Column, ...]  # columns of equal length


class Group(NamedTuple):
    """A grid; `name` is None where a file has just one."""

    name: str | None
    axes: tuple[Axis, ...]

    @property
    def size(self) -> int:
        """The number of its scenarios."""
        return math.prod(len(axis[0].values) for axis in self.axes)


class Point(NamedTuple):
    """One scenario of a sweep: its configuration, as if it were planned alone."""

    number: int
    group: str | None
    config: PlanConfig


class Batch(NamedTuple):
    """Scenarios ready to be planned."""

    robot: Robot
    workpiece: Workpiece
    scenarios: Scenario  # stacked
    points: tuple[Point, ...]


@dataclass(frozen=True)
class Sweep:
    """A sweep file, read and checked, with the robot of its configuration."""

    name: str
    config: PlanConfig
    robot: Robot
    groups: tuple[Group, ...]

    def __len__(self) -> int:
        return sum(group.size for group in self.groups)

    def points(self, limit: int | None = None) -> tuple[Point, ...]:
        """The scenarios in order, the first `limit` of them. Raises InputError for a value out of its range."""
        return tuple(itertools.islice(self._points(), limit))

    def batch(self, limit: int | None = None) -> Batch:
        """The scenarios with what they need, the first `limit` of them.

        Raises InputError, naming the scenario, for a start outside the joint limits and targets beyond reach.
        """
        points = self.points(limit)
        workpieces = {
            path: workpiece_of(self.config.workpiece.model_copy(update={"path": path}), self.robot)
            for path in dict.fromkeys(point.config.workpiece.path for point in points)
        }
        scenarios = [_scenario(point, self.robot, workpieces[point.config.workpiece.path]) for point in points]
        # The workpieces differ in their path alone, which the scenarios have turned into targets.
        return Batch(self.robot, next(iter(workpieces.values())), stack(scenarios), points)

    def _points(self) -> Iterator[Point]:
        base = self.config.model_dump()
        number = itertools.count()
        for group in self.groups:
            for rows in itertools.product(*(range(len(axis[0].values)) for axis in group.axes)):
                raw = _copy(base)
                for axis, row in zip(group.axes, rows, strict=True):
                    for column in axis:
                        _put(raw, column.parameter, column.values[row], column.relative)
                k = next(number)
                yield Point(k, group.name, validate(raw, PlanConfig, f"{self.name}: scenario {k}"))


def load_sweep(
    spec: str | Path | Mapping[str, Any],
    config: str | Path | Mapping[str, Any] | None = None,
    overrides: Sequence[str] | Mapping[str, Any] = (),
) -> Sweep:
    """The sweep file at the path `spec`, or the sweep that `spec` spells as a file would, {"grid": [...]}, whose files
    are then relative to the working folder. `config` takes the place of its own; `overrides`, see `load_config`,
    change the configuration before the axes do.

    Raises InputError for what is wrong with either file, for an unknown parameter and for an empty grid.
    """
    path, raw = (Path("sweep"), dict(spec)) if isinstance(spec, Mapping) else (Path(spec), read_yaml(spec))
    file: SweepFile = validate(raw, SweepFile, str(path))
    if config is None and file.config is not None:
        config = path.parent / file.config
    base = load_config(config, overrides)
    robot = robot_of(base.robot)
    if (file.grid is None) == (file.groups is None):
        raise InputError(f"{path}: a sweep has either a grid or groups, a list of axes or several under their names")
    grids = {None: file.grid} if file.groups is None else file.groups
    if not grids:
        raise InputError(f"{path}: groups is empty")
    groups = tuple(_read_grid(path, name, axes, robot.joint_names) for name, axes in grids.items())
    if (size := sum(group.size for group in groups)) > MOST:
        raise InputError(f"{path}: the grid has {size:,} scenarios; at most {MOST:,} make a sweep")
    return Sweep(path.stem, base, robot, groups)


def _read_grid(path: Path, name: str | None, axes: Sequence[dict], joints: Sequence[str]) -> Group:
    where = f"{path}: grid" if name is None else f"{path}: groups.{name}"
    if not axes:
        raise InputError(f"{where} is empty; it needs at least one axis")
    known = _parameters(joints)
    read = tuple(_read_axis(path, f"{where}, axis {k}", axis, known) for k, axis in enumerate(axes, 1))
    seen = set()
    for column in itertools.chain.from_iterable(read):
        if column.parameter in seen:
            raise InputError(f"{where}: {column.parameter.name} stands in it twice")
        seen.add(column.parameter)
    return Group(name, read)


def _read_axis(path: Path, where: str, raw: dict, known: dict[str, Parameter]) -> Axis:
    if not raw:
        raise InputError(f"{where} is empty; it needs at least one parameter")
    axis = tuple(_read_column(path, where, str(key), value, known) for key, value in raw.items())
    lengths = {column.parameter.name: len(column.values) for column in axis}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{name} has {length} values" for name, length in lengths.items())
        raise InputError(f"{where}: what stands in one axis goes together, value by value, but {told}")
    return axis


def _read_column(path: Path, where: str, key: str, value: Any, known: dict[str, Parameter]) -> Column:
    if key not in known:
        close = difflib.get_close_matches(key, known, n=2, cutoff=0.6)
        hint = f"did you mean {' or '.join(close)}? " if close else ""
        raise InputError(
            f"{where}: unknown parameter {key}; {hint}valid: {', '.join(PARAMETERS)}, one joint as start_rad.3"
        )
    relative = isinstance(value, dict) and list(value) == ["offsets"]
    if isinstance(value, dict) and list(value) in (["offsets"], ["values"]):
        (value,) = value.values()
    if not isinstance(value, list):
        raise InputError(f"{where}: {key} needs a list of values, {{values: [...]}} or {{offsets: [...]}}")
    if not value:
        raise InputError(f"{where}: {key} has no values")
    for item in value:
        _check_value(f"{where}: {key}", known[key], item, relative)
    if key == "workpiece.path":  # relative to the sweep file, as in any configuration
        value = [item if item == "weld" else str(path.parent / item) for item in value]
    return Column(known[key], relative, tuple(tuple(item) if isinstance(item, list) else item for item in value))


def _parameters(joints: Sequence[str]) -> dict[str, Parameter]:
    """Every spelling that a sweep file may use."""
    known = {name: Parameter(name, name, None) for name in PARAMETERS}
    for k, joint in enumerate(joints):
        known[f"start_rad.{k + 1}"] = known[f"start_rad.{joint}"] = Parameter(f"start_rad.{joint}", "start_rad", k)
    for k, axis in enumerate("xyz"):
        known[f"workpiece.shift_m.{axis}"] = Parameter(f"workpiece.shift_m.{axis}", "workpiece.shift_m", k)
    return known


def _check_value(where: str, parameter: Parameter, item: Any, relative: bool) -> None:
    """Raise InputError unless `item` is of the parameter's kind; its range is checked with the configuration."""
    if parameter.key == "workpiece.path":
        if relative or not isinstance(item, str):
            raise InputError(f"{where} takes names of files, not {item!r}")
        return
    whole = parameter.name in ("start_rad", "workpiece.shift_m")
    if whole and not isinstance(item, list):
        raise InputError(f"{where} takes lists of numbers, not {item!r}")
    for number in item if whole else [item]:
        if isinstance(number, bool) or not isinstance(number, int | float) or not math.isfinite(number):
            raise InputError(f"{where} takes finite numbers, not {number!r}")


def _put(raw: dict, parameter: Parameter, value: Any, relative: bool) -> None:
    """Set one parameter in the plain form of a configuration."""
    section, _, key = parameter.key.rpartition(".")
    owner = raw[section] if section else raw
    old = owner[key]
    if parameter.element is None:
        owner[key] = _added(parameter, old, value) if relative else value
        return
    if parameter.element >= len(old):
        raise InputError(f"{parameter.name}: {parameter.key} has {len(old)} values only")
    new = list(old)
    new[parameter.element] = old[parameter.element] + value if relative else value
    owner[key] = tuple(new)


def _added(parameter: Parameter, old: Any, offset: Any) -> Any:
    if not isinstance(old, tuple):
        return old + offset
    if len(old) != len(offset):
        raise InputError(f"{parameter.name} has {len(old)} values, an offset of it {len(offset)}")
    return tuple(a + b for a, b in zip(old, offset, strict=True))


def _copy(raw: dict) -> dict:
    return {key: dict(value) if isinstance(value, dict) else value for key, value in raw.items()}


def _scenario(point: Point, robot: Robot, workpiece: Workpiece) -> Scenario:
    try:
        return scenario_of(point.config, robot, workpiece, point.number, beyond_reach="record")
    except InputError as error:
        raise InputError(f"scenario {point.number}: {error}") from None
