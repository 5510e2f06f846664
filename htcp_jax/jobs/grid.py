"""Sweep files: a grid of scenarios that vary one configuration.

    config: ../configs/paper.yaml                      # the job that is varied; without this key: the default job
    grid:                                              # all combinations of its axes; the last one varies fastest
      - start_rad.3: {offsets: [-0.1, 0, 0.1]}         # added to the configuration's value
      - workpiece.rotation_y_rad: [0.4, 0.5]           # parameters of one axis vary jointly (zipped)
        workpiece.rotation_z_rad: [0.1, 0.2]           # this grid has 3 x 2 scenarios

In place of a list, values and offsets may be drawn: `{uniform: [LOW, HIGH], count: N}`, `{normal: [MEAN, SIGMA],
count: N}`, or `{offsets: {normal: [0, 0.1], count: N}}`. The seed (`settings.seed`) and the parameter's name determine
the draws, so other axes do not change them, and a larger count appends values. The drawn values are recorded.

A parameter is any key of the configuration except `method`, `program` and `ray`, see `grid_axes`. A joint is given by
its number, from 1, or by its name. Axes are applied in order: one axis may set `start_rad`, and later axes may change
single joints. If the job has several seams, the last axis is `seam`, over all of them, unless the grid has this axis.
Each scenario plans one seam, in its direction `backward` or else forward.

In place of `grid`, a file may have `groups`: a mapping of names to grids, whose scenarios are concatenated. A
scenario's number is its index in the complete grid. It determines the scenario's random keys.
"""

import itertools
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from htcp_jax.errors import InputError
from htcp_jax.jobs.batch import Batch, batch_of
from htcp_jax.jobs.build import with_robot
from htcp_jax.jobs.grid_axes import FILE_KEYS, KEYS, MOST, Group, ScenarioPoint, read_grid, with_seams
from htcp_jax.jobs.grid_points import points_of
from htcp_jax.jobs.load_config import load_config, read_config, source_of
from htcp_jax.model import Robot
from htcp_jax.settings import AUTO_QP, Settings
from htcp_jax.spec import (
    DEPENDENT,
    PlanConfig,
    example_or_path,
    is_other_arm,
    keys_of,
    put_key,
    read_mapping,
    strict_model,
)


class SweepFile(strict_model.FileSection):
    """Content of a sweep file. The axes are checked later, by `grid_axes`."""

    config: str | None = None
    grid: tuple[dict, ...] | None = None
    groups: dict[str, tuple[dict, ...]] | None = None


@dataclass(frozen=True)
class Sweep:
    """A validated sweep, with the robot of its configuration.

    Attributes:
        name: Stem of the file's name.
        config: Configuration shared by all scenarios.
        robot: The configuration's robot.
        groups: The grids.
        stated: Keys that the configuration sets, see `grid_points.points_of`.
        alone: True if all scenarios use the random keys of number 0, as a single job does.
    """

    name: str
    config: PlanConfig
    robot: Robot
    groups: tuple[Group, ...]
    stated: frozenset[str]
    alone: bool = False

    def __len__(self) -> int:
        return sum(group.size for group in self.groups)

    def on(self, platform: str) -> "Sweep":
        """Return the sweep with the QP solvers that `auto` selects on a platform, such as "cpu", see `Settings.on`."""
        auto, settings = Settings(qp=AUTO_QP).on(platform).qp, self.config.settings.on(platform)
        groups = tuple(group.with_value("settings.qp", AUTO_QP, auto) for group in self.groups)
        return replace(self, config=self.config.model_copy(update={"settings": settings}), groups=groups)

    def points(self, limit: int | None = None, numbers: Collection[int] | None = None) -> tuple[ScenarioPoint, ...]:
        """Return number and configuration of the first `limit` scenarios, or of those with some numbers; None: of all.

        Raises:
            InputError: If a value is out of its range.
        """
        if limit is not None and not 1 <= limit <= MOST:
            raise InputError(f"limit is {limit}; valid: 1 to {MOST:,}")
        only = None if numbers is None else {*numbers}
        points = points_of(self.name, self.config, self.groups, self.stated, len(self.robot.joint_names), only)
        return tuple(itertools.islice(points, limit))

    def batch(self, limit: int | None = None, numbers: Collection[int] | None = None) -> Batch:
        """Build the first `limit` scenarios with their planner inputs, or those with some numbers; None: all.

        Raises:
            InputError: If a start is outside the joint limits, or if the robots have different joints. The message
                names the scenario.
        """
        columns = (column for group in self.groups for axis in group.axes for column in axis)
        drawn = any(column.distribution and column.parameter.key in ("start_rad", "home_rad") for column in columns)
        remedy = "; its values are drawn: choose a smaller SIGMA, or uniform within the limits" if drawn else ""
        return batch_of(self.name, self.config, self.robot, self.points(limit, numbers), self.alone, remedy)


def load_sweep(
    spec: str | Path | Mapping[str, Any],
    config: str | Path | Mapping[str, Any] | None = None,
    overrides: Sequence[str] | Mapping[str, Any] = (),
) -> Sweep:
    """Return the sweep that a file or a mapping describes.

    Args:
        spec: Path of the sweep file, name of an example, or a mapping {"grid": [...]}. File names in a mapping are
            relative to the working folder.
        config: Configuration that replaces the sweep's own; None: the sweep's own.
        overrides: Changes to the configuration before the axes are applied, see `load_config`.

    Raises:
        InputError: If the file is invalid, if a parameter is unknown, or if the grid is empty.
    """
    path, raw = read_mapping(spec, "sweep")
    file: SweepFile = strict_model.validate_model(raw, SweepFile, str(path))
    if config is None and file.config is not None:
        config = example_or_path(file.config, path.parent)
    if (file.grid is None) == (file.groups is None):
        raise InputError(f"{path}: a sweep must have either `grid`, a list of axes, or `groups`, named lists of axes")
    grids = {None: file.grid} if file.groups is None else file.groups
    if not grids:
        raise InputError(f"{path}: groups is empty; it needs at least one grid")
    raw, source = read_config(config, overrides)
    stated = keys_of(raw)
    first = _first_values(raw, grids, path.parent)
    for key, value in first.items():
        put_key(raw, key, value)
    base, robot = with_robot(strict_model.validate_model(raw, PlanConfig, source), source)
    groups = []
    for name, axes in grids.items():
        where = f"{path}: grid" if name is None else f"{path}: groups.{name}"
        group = read_grid(where, path.parent, name, axes, robot.joint_names, base.settings.seed)
        groups.append(with_seams(group, base.workpiece.seams, where))
        for key in first.keys() - groups[-1].keys:
            raise InputError(f"{where}: {key} varies in another group; it must vary in every group")
    if (size := sum(group.size for group in groups)) > MOST:
        raise InputError(f"{path}: the grid has {size:,} scenarios; at most {MOST:,} are allowed")
    return Sweep(path.stem, base, robot, tuple(groups), DEPENDENT & stated)


def load_sweep_or_job(
    spec: str | Path | Mapping[str, Any],
    config: str | Path | Mapping[str, Any] | None = None,
    overrides: Sequence[str] | Mapping[str, Any] = (),
) -> Sweep:
    """Return a sweep, or a job as a sweep of one scenario.

    Args:
        spec: A sweep as for `load_sweep`, or a job as for `load_config`; a job has neither `grid` nor `groups`.
        config: Configuration that replaces the sweep's own. It must be None for a job.
        overrides: Changes to the configuration, see `load_config`.

    Raises:
        InputError: See `load_sweep` and `load_config`; also for a job with `config`.
    """
    path, raw = read_mapping(spec, "sweep")
    if not isinstance(raw, dict) or {"grid", "groups"} & raw.keys():
        return load_sweep(spec, config, overrides)
    if config is not None:
        raise InputError(f"{path} is a job; omit config (--config), which replaces the job of a sweep")
    job, robot = with_robot(load_config(spec, overrides), source_of(spec))
    name = "job" if isinstance(spec, Mapping) else path.stem
    grid = with_seams(Group(None, ()), job.workpiece.seams, name)
    return Sweep(name, job, robot, (grid,), frozenset(), alone=True)


def _first_values(raw: dict, grids: Mapping[str | None, Sequence[dict]], folder: Path) -> dict[str, Any]:
    """Return values of the axes that complete the shared configuration: a robot and a start, by key.

    If axes vary the robot, these are the first values of its keys and of the start. If the configuration has another
    robot than the GP50 and no start, it is the first value of the start. Otherwise the result is empty.
    """
    first: dict[str, Any] = {}
    for axis in itertools.chain.from_iterable(grids.values()):
        for key, value in axis.items():
            items = value.get("values") if isinstance(value, dict) else value
            if isinstance(items, list | tuple) and items:
                first.setdefault(str(key), items[0])
    if "robot.model" not in first:
        lacks_start = is_other_arm(raw) and "start_rad" not in raw
        return {key: value for key, value in first.items() if key == "start_rad" and lacks_start}
    for key, words in FILE_KEYS.items():
        name = first.pop(key, None)
        if isinstance(name, str | os.PathLike):
            first[key] = name if name in words else str(folder / name)
    return {
        key: value for key, value in first.items() if key == "start_rad" or (key.startswith("robot.") and key in KEYS)
    }
