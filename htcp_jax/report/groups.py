"""Parts of a run for the report: one part for each group of scenarios in the sweep."""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import pyarrow as pa

from htcp_jax.errors import InputError, did_you_mean
from htcp_jax.motion import Plans, motion
from htcp_jax.report import paper
from htcp_jax.report.cell import OpenedScene
from htcp_jax.report.validation import read_validation
from htcp_jax.runs import Run, of_job, reachability_file
from htcp_jax.runs import labels as scenario_labels
from htcp_jax.runs import tables as scenario_tables

MOST_LEVELS = 10  # maximum number of random values of an axis that are drawn one by one


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """Group of S scenarios, with up to T targets each, that at least one method has planned."""

    run_name: str
    name: str  # name of the run, and of the group if there is one
    numbers: np.ndarray  # (S,) numbers of the scenarios in the run
    parameters: dict[str, np.ndarray]  # values (S,) by parameter: columns of the scenario table that a grid may vary
    keys: dict[str, str]  # parameters that the run's grid varies, by the names of their keys
    plans: dict[str, Plans]  # by method with a finished shard; status -1: the scenario is not planned yet
    motions: dict[str, motion.MotionFigures]  # by method; unknown values are NaN
    timing: dict[str, pa.Table | None]  # by method: a row per scenario, see `timing_file`; None: not timed
    timed_with: dict[str, str]  # by timed method: feed rate and limits as text
    manipulability: dict[str, np.ndarray]  # by method, (S, T) [m/rad], see `motion.manipulability`; NaN if unknown
    reachability: np.ndarray | None  # (S,) lower bound on consecutive reachable targets; None if unknown
    not_excluded: np.ndarray | None  # (S,) upper bound on consecutive reachable targets; None if unknown
    reach: np.ndarray | None  # (S, T) values of `Reach`, each target by itself; None if unknown
    step_s: dict[str, float]  # by method: planning time / number of attempted targets, over the complete run
    run: Run
    validation: dict[str, Any] | None  # contents of validation.json, for the complete run
    scene: OpenedScene

    @property
    def targets(self) -> int:
        """Largest number of targets T."""
        return max(plans.status.shape[1] for plans in self.plans.values())

    @property
    def grid_name(self) -> tuple[Any, str]:
        """The run's grid and the part's group: equal for parts with the same scenarios."""
        return self.run.manifest.grid, self.name.removeprefix(self.run_name)

    @cached_property
    def varied(self) -> dict[str, np.ndarray]:
        """Values (S,) of each parameter that the grid varies, also of those that vary jointly."""
        return scenario_labels.varying(self.parameters, self.keys.values())

    @cached_property
    def axes(self) -> dict[str, np.ndarray]:
        """Sorted values of each parameter that the grid varies, without parameters that another one determines."""
        return {name: np.unique(values) for name, values in scenario_labels.independent(self.varied).items()}

    def is_drawn(self, name: str) -> bool:
        """Return True if a varied parameter has more than MOST_LEVELS numbers that are in no order, as random ones."""
        values = self.varied[name]
        _, first = np.unique(values, return_index=True)
        order = np.sign(np.diff(first))
        return values.dtype.kind in "if" and len(first) > MOST_LEVELS and not abs(order.sum()) == len(order)

    def column_of(self, name: str) -> str:
        """Return the varied parameter with a name: its column, its key in the sweep file, or the end of this key.

        The end of a key is any of its last parts, such as `shift_m.x` or `x` of `workpiece.shift_m.x`. A joint's key
        has the joint's name or number, as in the sweep file.

        Raises:
            InputError: If there is no such parameter, or if several have this name.
        """
        keys: dict[str, list[str]] = {column: [] for column in self.varied}
        for key, column in self.keys.items():
            if column in keys:
                keys[column].append(key)
        for number, joint in enumerate(self.run.manifest.joints, 1):
            if f"start_{joint}" in keys:
                keys[f"start_{joint}"].append(f"start_rad.{number}")
        ends = {column: {end for key in own for end in _ends_of_key(key)} for column, own in keys.items()}
        exact = [column for column, own in keys.items() if name in (column, *own)]
        found = exact or [column for column, own in ends.items() if name in own]
        if len(found) == 1:
            return found[0]
        valid = ", ".join(keys) or "none, as no parameter varies"
        if found:
            raise InputError(f"over is {name!r}, the name of several parameters: {', '.join(found)}; valid: {valid}")
        known = [*keys, *itertools.chain.from_iterable(ends.values())]
        raise InputError(f"over is {name!r}; {did_you_mean(name, sorted(known))}valid: {valid}")

    def causes(self, method: str) -> dict[int, dict[str, str | None]]:
        """Return the columns `runs.tables.CAUSE` by scenario, for the scenarios with an unusable start."""
        rows = self.run.scenarios(method).select(["scenario", *scenario_tables.CAUSE]).to_pylist()
        return {row["scenario"]: row for row in rows if row["cause"] is not None}

    @cached_property
    def labels(self) -> dict[int, str]:
        """Varied parameters as text, by scenario."""
        return {number: self.label(s) for s, number in enumerate(self.numbers.tolist())}

    def label(self, s: int, most: int | None = None) -> str:
        """Return the varied parameters of the scenario in row s as text, of more than `most` the first ones."""
        texts = [scenario_labels.part(name, values[s]) for name, values in self.varied.items()]
        return scenario_labels.listed(texts, most)

    @cached_property
    def times(self) -> dict[str, dict[int, dict[str, Any]]]:
        """Rows of `Run.times` by method and scenario."""
        found: dict[str, dict[int, dict[str, Any]]] = {method: {} for method in self.plans}
        wanted = {*self.numbers.tolist()}
        for row in self.run.times(*self.plans).to_pylist():
            if row["scenario"] in wanted:
                found[row["method"]][row["scenario"]] = row
        return found

    @cached_property
    def paper_table(self) -> paper.PaperTable | None:
        """The paper's table whose grid and start the part has, or has a part of; None if there is no such table."""
        known = self._grid_parameters
        middle = [np.median(known[f"start_{joint}"]) for joint in self.run.manifest.joints]
        if len(middle) != len(paper.START) or not np.allclose(middle, paper.START) or self.targets != paper.TARGETS:
            return None
        axes = {name: np.unique(values) for name, values in scenario_labels.independent(known).items()}
        for table in (paper.ROBOT, paper.WORKPIECE):
            same = tuple(axes) == table.grid and len(known[table.grid[0]]) == table.scenarios
            same &= {*self.axes} <= {*table.grid}
            if same and all(table.is_axis(values.tolist()) for values in axes.values()):
                return table
        return None

    @property
    def _grid_parameters(self) -> dict[str, np.ndarray]:
        """Values of parameters by name: of the complete grid, if it has as many scenarios as one of the paper's."""
        manifest = self.run.manifest
        is_part = len(self.numbers) < manifest.full and len(manifest.grid) == 1
        if not is_part or manifest.full not in (paper.ROBOT.scenarios, paper.WORKPIECE.scenarios):
            return self.parameters
        jobs = [of_job(point.config) for point in self.run.points(full=True)]
        if any(len(job.start) != len(manifest.joints) for job in jobs):  # the planner chooses them
            return self.parameters
        found = {f"start_{joint}": [job.start[k] for job in jobs] for k, joint in enumerate(manifest.joints)}
        found |= {name: [getattr(job, name) for job in jobs] for name in paper.WORKPIECE.grid}
        return {name: np.round(values, 9) + 0.0 for name, values in found.items()}

    def cells(self, values: np.ndarray, axes: Sequence[str]) -> np.ndarray:
        """Return the mean of the values in each cell of a grid over some parameters.

        Args:
            values: A value per scenario, (S,); NaN if unknown.
            axes: Names of the grid's parameters.

        Returns:
            The means, one dimension per parameter; NaN in cells without known values.
        """
        levels = [np.unique(self.parameters[name], return_inverse=True) for name in axes]
        shape = tuple(len(found) for found, _ in levels)
        where = np.ravel_multi_index([index for _, index in levels], shape)
        known = np.isfinite(values)
        total = np.bincount(where[known], values[known], math.prod(shape))
        count = np.bincount(where[known], minlength=math.prod(shape))
        return np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(shape)


def read_parts(run: Run, name: str) -> list[Part]:
    """Read the parts of a run, in the order of its scenarios.

    Args:
        run: The run.
        name: The run's name in the report.

    Raises:
        InputError: If the run has no finished shard, or if a file is missing or damaged.
    """
    methods = [method for method in run.methods if any(shard.method == method for shard in run.manifest.shards)]
    scenarios = run.scenarios(*methods)
    _, first = np.unique(scenarios["scenario"].to_numpy(), return_index=True)
    table = scenarios.take(pa.array(first))
    numbers, reachability = table["scenario"].to_numpy(), reachability_file.read_reachability(run)
    plans = {method: run.plans(method) for method in methods}
    longest = max(each.status.shape[1] for each in plans.values())
    plans = {method: each.widened(longest) for method, each in plans.items()}
    timing = {method: run.timing(method) for method in methods}
    whole = Part(
        run_name=name,
        name=name,
        numbers=np.arange(run.manifest.rows),
        parameters={},
        keys=scenario_labels.varied_columns(run.manifest.grid, table.column_names),
        plans=plans,
        motions={method: _figures_of_method(run, method) for method in methods},
        timing={method: each and each.rows for method, each in timing.items()},
        timed_with={method: each.words for method, each in timing.items() if each is not None},
        manipulability={method: _manipulability_of_method(run, method, longest) for method in methods},
        reachability=None if reachability is None else reachability.prefix,
        not_excluded=None if reachability is None else reachability.most,
        reach=None if reachability is None else reachability.each,
        step_s={method: each.step_s for method, each in plans.items()},
        run=run,
        validation=read_validation(run),
        scene=OpenedScene(run, plans),
    )
    given = {name: scenario_labels.column_of(table[name]) for name in scenario_labels.parameter_names(table)}
    groups = np.array([group or "" for group in table["group"].to_pylist()])
    parts = []
    for group in dict.fromkeys(groups.tolist()):
        here = groups == group
        own = {key: values[here] for key, values in given.items()}
        parts.append(_with_scenarios(whole, f"{name}: {group}" if group else name, numbers[here], own))
    return parts


def _ends_of_key(key: str) -> list[str]:
    """Return a dotted key and its ends: a.b.c, b.c and c."""
    parts = key.split(".")
    return [".".join(parts[k:]) for k in range(len(parts))]


def _with_scenarios(whole: Part, name: str, numbers: np.ndarray, parameters: dict[str, np.ndarray]) -> Part:
    """Return the part with some of a run's scenarios.

    Args:
        whole: Part with all scenarios of the run.
        name: Name of the part.
        numbers: Numbers of its scenarios.
        parameters: Values of the parameters in these scenarios.
    """
    plans = {method: each.rows(numbers) for method, each in whole.plans.items()}
    bounds = {key: getattr(whole, key) for key in ("reachability", "not_excluded", "reach")}
    return dataclasses.replace(
        whole,
        name=name,
        numbers=numbers,
        parameters=parameters,
        plans={method: each for method, each in plans.items() if each.exists.any()},
        motions={m: motion.MotionFigures(*(values[numbers] for values in each)) for m, each in whole.motions.items()},
        timing={m: rows and rows.filter(np.isin(rows["scenario"], numbers)) for m, rows in whole.timing.items()},
        manipulability={method: values[numbers] for method, values in whole.manipulability.items()},
        **{key: None if values is None else values[numbers] for key, values in bounds.items()},
    )


def _manipulability_of_method(run: Run, method: str, targets: int) -> np.ndarray:
    """Return the manipulability along a method's plans [m/rad], scenarios by targets; NaN if unknown."""
    table = run.targets(method).select(["scenario", "target", scenario_tables.MANIPULABILITY])
    found = np.full((run.manifest.rows, targets), np.nan)
    rows = table["scenario"].to_numpy(), table["target"].to_numpy()
    found[rows] = table[scenario_tables.MANIPULABILITY].to_numpy()
    return found


def _figures_of_method(run: Run, method: str) -> motion.MotionFigures:
    """Return the figures of a method's motions, a row per scenario; NaN if unknown."""
    table = run.scenarios(method)
    found = np.full((len(motion.MotionFigures._fields), run.manifest.rows), np.nan)
    for row, name in zip(found, motion.MotionFigures._fields, strict=True):
        row[table["scenario"].to_numpy()] = table[name].cast(pa.float64()).to_numpy()
    return motion.MotionFigures(*found)
