"""Parts of a run for the report: one part for each group of scenarios in the sweep."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
import pyarrow as pa
from jaxtyping import Int

from htcp_jax.motion import Plans, motion
from htcp_jax.report import paper
from htcp_jax.report.validation import read_validation
from htcp_jax.runs import Run, reachability_file
from htcp_jax.runs import labels as scenario_labels
from htcp_jax.runs import tables as scenario_tables

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@runtime_checkable
class SceneOfRun(Protocol):
    """Interface of `cell.OpenedScene`: a run's robot and workpiece."""

    @property
    def problem(self) -> str:
        """Reason why the scene cannot be read; empty if it can."""

    def colliding_bodies(self, method: str) -> dict[int, Any]:
        """Return the colliding body by scenario, for the scenarios in which a method failed."""

    def picture(self, number: int, method: str, title: str) -> "Figure | None":
        """Draw a scenario's arm in its workpiece; return None if the scene cannot be read.

        Args:
            number: The number of the scenario.
            method: The method.
            title: The title of the figure.
        """

    def reach_picture(self, numbers: Int[np.ndarray, "S"], reach: Int[np.ndarray, "S T"], name: str) -> "Figure | None":
        """Draw the workpiece with its targets coloured by reach; return None if the scene cannot be read.

        Args:
            numbers: The numbers of the scenarios.
            reach: Values of `Reach`, a row per scenario.
            name: Name of the group of scenarios, for the title.
        """


@dataclass(frozen=True, eq=False)
class Part:
    """Group of S scenarios, with up to T targets each, that at least one method has planned."""

    run_name: str
    name: str  # name of the run, and of the group if there is one
    numbers: np.ndarray  # (S,) numbers of the scenarios in the run
    parameters: dict[str, np.ndarray]  # values (S,) by parameter: columns of the scenario table that a grid may vary
    plans: dict[str, Plans]  # by method with a finished shard; status -1: the scenario is not planned yet
    motions: dict[str, motion.MotionFigures]  # by method; unknown values are NaN
    timing: dict[str, pa.Table | None]  # by method: a row per scenario, see `timing_file`; None: not timed
    timed_with: dict[str, str]  # by timed method: feed rate and limits as text
    manipulability: dict[str, np.ndarray]  # by method, (S, T) [m/rad], see `motion.manipulability`; NaN if unknown
    reachability: np.ndarray | None  # (S,) lower bound on consecutive reachable targets; None if unknown
    not_excluded: np.ndarray | None  # (S,) upper bound on consecutive reachable targets; None if unknown
    reach: np.ndarray | None  # (S, T) values of `Reach`, each target by itself; None if unknown
    step_s: dict[str, float]  # by method: planning time / number of attempted targets, over the complete run
    joints: tuple[str, ...]
    run: Run
    run_labels: dict[int, str]  # varied parameters as text, by scenario of the run
    validation: dict[str, Any] | None  # contents of validation.json, for the complete run
    scene: SceneOfRun

    @property
    def targets(self) -> int:
        """Largest number of targets T."""
        return max(plans.status.shape[1] for plans in self.plans.values())

    @cached_property
    def axes(self) -> dict[str, np.ndarray]:
        """Sorted values of each parameter that varies, without parameters that another one determines."""
        return {name: np.unique(values) for name, values in scenario_labels.varying(self.parameters).items()}

    def causes(self, method: str) -> dict[int, dict[str, str | None]]:
        """Return the columns `runs.tables.CAUSE` by scenario, for the scenarios with an unusable start."""
        rows = self.run.scenarios(method).select(["scenario", *scenario_tables.CAUSE]).to_pylist()
        return {row["scenario"]: row for row in rows if row["cause"] is not None}

    @cached_property
    def labels(self) -> dict[int, str]:
        """Varied parameters as text, by scenario."""
        own = scenario_labels.varying(self.parameters)
        texts = [
            ", ".join(scenario_labels.part(name, values[s]) for name, values in own.items())
            for s in range(len(self.numbers))
        ]
        return dict(zip(self.numbers.tolist(), texts, strict=True))

    @cached_property
    def paper_table(self) -> paper.PaperTable | None:
        """The paper's table whose grid and start the part has; None if there is no such table."""
        middle = [np.median(self.parameters[f"start_{joint}"]) for joint in self.joints]
        if len(middle) != len(paper.START) or not np.allclose(middle, paper.START) or self.targets != paper.TARGETS:
            return None
        for table in (paper.ROBOT, paper.WORKPIECE):
            same = tuple(self.axes) == table.grid and len(self.numbers) == table.scenarios
            if same and all(table.is_axis(values.tolist()) for values in self.axes.values()):
                return table
        return None

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


def read_parts(run: Run, name: str, scene_of: Callable[[Run, dict[str, Plans]], SceneOfRun]) -> list[Part]:
    """Read the parts of a run, in the order of its scenarios.

    Args:
        run: The run.
        name: The run's name in the report.
        scene_of: Function that returns the scene for a run and its plans by method.

    Raises:
        InputError: If the run has no finished shard, or if a file is missing or damaged.
    """
    methods = [method for method in run.methods if any(shard.method == method for shard in run.manifest.shards)]
    whole = run.scenarios(*methods)
    _, first = np.unique(whole["scenario"].to_numpy(), return_index=True)
    table = whole.take(pa.array(first))
    plans = {method: run.plans(method) for method in methods}
    longest = max(each.status.shape[1] for each in plans.values())
    plans = {method: each.widened(longest) for method, each in plans.items()}
    parameters = {name: scenario_labels.column_of(table[name]) for name in scenario_labels.parameter_names(table)}
    motions = {method: _figures_of_method(run, method) for method in methods}
    manipulability = {method: _manipulability_of_method(run, method, longest) for method in methods}
    timing = {method: run.timing(method) for method in methods}
    numbers, reachability = table["scenario"].to_numpy(), reachability_file.read_reachability(run)
    groups = np.array([group or "" for group in table["group"].to_pylist()])
    shared = {
        "run_name": name,
        "step_s": {method: each.step_s for method, each in plans.items()},
        "joints": run.manifest.joints,
        "run": run,
        "run_labels": scenario_labels.labels_of(whole),
        "timed_with": {method: each.words for method, each in timing.items() if each is not None},
        "validation": read_validation(run),
        "scene": scene_of(run, plans),
    }
    parts = []
    for group in dict.fromkeys(groups.tolist()):
        here = groups == group
        own = {method: each.rows(numbers[here]) for method, each in plans.items()}
        parts.append(
            Part(
                name=f"{name}: {group}" if group else name,
                numbers=numbers[here],
                parameters={key: values[here] for key, values in parameters.items()},
                plans={method: each for method, each in own.items() if each.exists.any()},
                motions={
                    method: motion.MotionFigures(*(c[numbers[here]] for c in each)) for method, each in motions.items()
                },
                timing={
                    m: each and _rows_of_scenarios(each.rows, numbers[here]) for m, each in timing.items() if m in own
                },
                manipulability={method: manipulability[method][numbers[here]] for method in own},
                reachability=None if reachability is None else reachability.prefix[numbers[here]],
                not_excluded=None if reachability is None else reachability.most[numbers[here]],
                reach=None if reachability is None or reachability.each is None else reachability.each[numbers[here]],
                **shared,
            )
        )
    return parts


def _rows_of_scenarios(rows: pa.Table, numbers: np.ndarray) -> pa.Table:
    """Return the rows whose scenario is one of `numbers`."""
    return rows.filter(pa.array(np.isin(rows["scenario"].to_numpy(), numbers)))


def _manipulability_of_method(run: Run, method: str, targets: int) -> np.ndarray:
    """Return the manipulability along a method's plans [m/rad], scenarios by targets; NaN if unknown."""
    table = run.targets(method).select(["scenario", "target", scenario_tables.MANIPULABILITY])
    found = np.full((run.manifest.count, targets), np.nan)
    rows = table["scenario"].to_numpy(), table["target"].to_numpy()
    found[rows] = table[scenario_tables.MANIPULABILITY].to_numpy()
    return found


def _figures_of_method(run: Run, method: str) -> motion.MotionFigures:
    """Return the figures of a method's motions, a row per scenario; NaN if unknown."""
    table = run.scenarios(method)
    found = np.full((len(motion.MotionFigures._fields), run.manifest.count), np.nan)
    for row, name in zip(found, motion.MotionFigures._fields, strict=True):
        row[table["scenario"].to_numpy()] = table[name].cast(pa.float64()).to_numpy()
    return motion.MotionFigures(*found)
