"""Parts of a run for the report, one for every group of its sweep, with the plans of each method as arrays."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
import pyarrow as pa
from jaxtyping import Int
from matplotlib.figure import Figure

from htcp_jax.motion import Plans, motion
from htcp_jax.report import paper
from htcp_jax.report.validation import read_validation
from htcp_jax.runs import Run, reachability_file
from htcp_jax.runs import labels as scenario_labels
from htcp_jax.runs import tables as scenario_tables


@runtime_checkable
class SceneOfRun(Protocol):
    """Interface to a run's robot and workpiece, see `cell.OpenedScene`."""

    @property
    def problem(self) -> str:
        """Reason why there is no scene; empty if there is one."""

    def colliding_bodies(self, method: str) -> dict[int, Any]:
        """Colliding bodies in the scenarios that a method failed, by their numbers."""

    def picture(self, number: int, method: str, title: str) -> Figure | None:
        """Draw the arm in the workpiece of a scenario; None if there is no scene.

        Args:
            number: The scenario.
            method: The method.
            title: The title of the figure.
        """

    def reach_picture(self, numbers: Int[np.ndarray, "S"], reach: Int[np.ndarray, "S T"], name: str) -> Figure | None:
        """Draw the part with the targets by their reach; None if there is no scene.

        Args:
            numbers: The scenarios.
            reach: Numbers of `Reach`.
            name: Name of the scenarios.
        """


@dataclass(frozen=True, eq=False)
class Part:
    """Group of S scenarios that at least one method has planned, with up to T targets each."""

    run_name: str
    name: str  # the run's, and the group's if there is one
    numbers: np.ndarray  # (S,) of the scenarios in the run
    parameters: dict[str, np.ndarray]  # columns of the scenario table that a grid may vary, (S,) each
    plans: dict[str, Plans]  # by method with a finished shard; the status is -1 for scenarios not planned yet
    motions: dict[str, motion.MotionFigures]  # by method; NaN if unknown
    timing: dict[str, pa.Table | None]  # by method, rows of its scenarios as in `timing_file`; None if not timed
    timed_with: dict[str, str]  # by method that is timed: description of its feed and limits
    manipulability: dict[str, np.ndarray]  # by method, (S, T) [m/rad], see `motion.manipulability`; NaN if unknown
    reachability: np.ndarray | None  # (S,) reachable targets in a row, a lower bound
    not_excluded: np.ndarray | None  # (S,) not proven unreachable, an upper bound
    reach: np.ndarray | None  # (S, T) numbers of `Reach`, every target by itself
    step_s: dict[str, float]  # run time by attempted targets, over the complete run
    joints: tuple[str, ...]
    run: Run
    run_labels: dict[int, str]  # varied parameters of each scenario of the run, by its number
    validation: dict[str, Any] | None  # of the complete run, as in validation.json
    scene: SceneOfRun

    @property
    def targets(self) -> int:
        """Largest number of targets T."""
        return max(plans.status.shape[1] for plans in self.plans.values())

    @cached_property
    def axes(self) -> dict[str, np.ndarray]:
        """Parameters that vary, each with its values in order, without those that another one determines."""
        return {name: np.unique(values) for name, values in scenario_labels.varying(self.parameters).items()}

    def causes(self, method: str) -> dict[int, dict[str, str | None]]:
        """Columns `tables.CAUSE` of the scenarios that could not begin, by their numbers."""
        rows = self.run.scenarios(method).select(["scenario", *scenario_tables.CAUSE]).to_pylist()
        return {row["scenario"]: row for row in rows if row["cause"] is not None}

    @cached_property
    def labels(self) -> dict[int, str]:
        """Varied parameters of each scenario, by its number."""
        own = scenario_labels.varying(self.parameters)
        texts = [
            ", ".join(scenario_labels.part(name, values[s]) for name, values in own.items())
            for s in range(len(self.numbers))
        ]
        return dict(zip(self.numbers.tolist(), texts, strict=True))

    @cached_property
    def paper_table(self) -> paper.PaperTable | None:
        """The paper's table of the same grid about the same start, if there is one."""
        middle = [np.median(self.parameters[f"start_{joint}"]) for joint in self.joints]
        if len(middle) != len(paper.START) or not np.allclose(middle, paper.START) or self.targets != paper.TARGETS:
            return None
        for table in (paper.ROBOT, paper.WORKPIECE):
            same = tuple(self.axes) == table.grid and len(self.numbers) == table.scenarios
            if same and all(table.is_axis(values.tolist()) for values in self.axes.values()):
                return table
        return None

    def cells(self, values: np.ndarray, axes: Sequence[str]) -> np.ndarray:
        """Mean of values (S,) over the scenarios of each cell of these axes; NaN where there are none."""
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
        scene_of: Function for the scene of the run and its plans.

    Raises:
        InputError: For a run without a finished shard, and for a file that is missing or damaged.
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
    """Select the rows of some scenarios."""
    return rows.filter(pa.array(np.isin(rows["scenario"].to_numpy(), numbers)))


def _manipulability_of_method(run: Run, method: str, targets: int) -> np.ndarray:
    """Manipulability of a method's scenarios at their targets, row s of scenario s."""
    table = run.targets(method).select(["scenario", "target", scenario_tables.MANIPULABILITY])
    found = np.full((run.manifest.count, targets), np.nan)
    rows = table["scenario"].to_numpy(), table["target"].to_numpy()
    found[rows] = table[scenario_tables.MANIPULABILITY].to_numpy()
    return found


def _figures_of_method(run: Run, method: str) -> motion.MotionFigures:
    """Figures of a method's motions, row s of scenario s."""
    table = run.scenarios(method)
    found = np.full((len(motion.MotionFigures._fields), run.manifest.count), np.nan)
    for row, name in zip(found, motion.MotionFigures._fields, strict=True):
        row[table["scenario"].to_numpy()] = table[name].cast(pa.float64()).to_numpy()
    return motion.MotionFigures(*found)
