"""A run as the report tells it: a part for every group of its sweep, with the plans of each method as arrays."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure

from htcp_jax.planner.plans import Plans, is_tracked
from htcp_jax.report import paper
from htcp_jax.runs.ceiling_file import read_ceiling
from htcp_jax.runs.labels import column_of, parameter_names, part, varying
from htcp_jax.runs.run_folder import Run
from htcp_jax.runs.tables import NO_TARGET
from htcp_jax.status import Status


@runtime_checkable
class SceneOfRun(Protocol):
    """What can be said of a run's robot and workpiece, see `cell.RunScene`."""

    def trouble(self) -> str:
        """Why nothing can; empty where something can."""

    def in_the_way(self, method: str) -> dict[int, Any]:
        """What is in the way in the scenarios that a method lost, by their numbers."""

    def picture(self, number: int, method: str, title: str) -> Figure | None:
        """The arm in the workpiece of a scenario."""


class Part(NamedTuple):
    """The scenarios of one group that at least one method has planned: S of them, with up to T targets each."""

    run_name: str
    name: str  # the run's, and that of the group where there is one
    numbers: np.ndarray  # (S,) of the scenarios in the run
    parameters: dict[str, np.ndarray]  # columns of the scenario table that a grid may vary, (S,) each
    plans: dict[str, Plans]  # by method that has begun; the status is -1 where it has not planned a scenario yet
    ceiling: np.ndarray | None  # (S,) targets in a row that are known to be reachable
    step_s: dict[str, float]  # run time by attempted targets, over the whole run
    joints: tuple[str, ...]
    run: Run
    scene: SceneOfRun

    @property
    def targets(self) -> int:
        """T."""
        return max(plans.status.shape[1] for plans in self.plans.values())

    @property
    def axes(self) -> dict[str, np.ndarray]:
        """The parameters that vary, each with its values in order, without those that another one determines."""
        return {name: np.unique(values) for name, values in varying(self.parameters).items()}

    @property
    def labels(self) -> dict[int, str]:
        """What sets each scenario apart from the others of the part, by its number."""
        own = varying(self.parameters)
        told = [", ".join(part(name, values[s]) for name, values in own.items()) for s in range(len(self.numbers))]
        return dict(zip(self.numbers.tolist(), told, strict=True))

    @property
    def paper_table(self) -> paper.Table | None:
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
        """The mean of values (S,) over the scenarios of each cell of these axes; NaN where there are none."""
        levels = [np.unique(self.parameters[name], return_inverse=True) for name in axes]
        shape = tuple(len(found) for found, _ in levels)
        where = np.ravel_multi_index([index for _, index in levels], shape)
        known = np.isfinite(values)
        total = np.bincount(where[known], values[known], math.prod(shape))
        count = np.bincount(where[known], minlength=math.prod(shape))
        return np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(shape)


def read_parts(run: Run, name: str, scene: SceneOfRun) -> list[Part]:
    """The parts of a run that is called `name`, in the order of its scenarios.

    Raises InputError for a run without a finished shard, and naming a file that is missing or damaged.
    """
    methods = [method for method in run.methods if any(shard.method == method for shard in run.manifest.shards)]
    table = run.scenarios(*methods)
    _, first = np.unique(table["scenario"].to_numpy(), return_index=True)
    table = table.take(pa.array(first))
    plans = {method: run.plans(method) for method in methods}
    longest = max(whole.status.shape[1] for whole in plans.values())
    plans = {method: _widened(whole, longest) for method, whole in plans.items()}
    parameters = {name: column_of(table[name]) for name in parameter_names(table)}
    numbers = table["scenario"].to_numpy()
    ceiling = read_ceiling(run)
    groups = np.array([group or "" for group in table["group"].to_pylist()])
    parts = []
    for group in dict.fromkeys(groups.tolist()):
        here = groups == group
        parts.append(
            Part(
                run_name=name,
                name=f"{name}: {group}" if group else name,
                numbers=numbers[here],
                parameters={key: values[here] for key, values in parameters.items()},
                plans={m: rows for m, whole in plans.items() if _any_planned(rows := _rows(whole, numbers[here]))},
                ceiling=None if ceiling is None else ceiling.prefix[numbers[here]],
                step_s={method: _step_s(whole) for method, whole in plans.items()},
                joints=run.manifest.joints,
                run=run,
                scene=scene,
            )
        )
    return parts


def tracked(status: np.ndarray) -> np.ndarray:
    """Where `status`, of any shape, says tracked; a target that is not there is not."""
    return (status != NO_TARGET) & is_tracked(status)


def drivable(plans: Plans) -> np.ndarray:
    """Where a target is tracked and no straight joint path up to it, from the start, is known to collide."""
    good = tracked(plans.status)
    return good & ~np.logical_or.accumulate(good & (plans.path_clear == 0), axis=1)


def _rows(plans: Plans, numbers: np.ndarray) -> Plans:
    """The plans of the scenarios with these numbers."""
    arrays = {key: value[numbers] for key, value in plans._asdict().items() if isinstance(value, np.ndarray)}
    return plans._replace(**arrays)


def _any_planned(plans: Plans) -> bool:
    return bool((plans.status != NO_TARGET).any())


def _widened(plans: Plans, targets: int) -> Plans:
    """The plans with columns for this many targets."""
    more = targets - plans.status.shape[1]
    empty = {"status": NO_TARGET, "path_clear": -1, "iterations": 0, "escape": 0}
    arrays = {
        key: np.pad(value, [(0, 0), (0, more)] + [(0, 0)] * (value.ndim - 2), constant_values=empty.get(key, np.nan))
        for key, value in plans._asdict().items()
        if isinstance(value, np.ndarray)
    }
    return plans._replace(**arrays)


def _step_s(plans: Plans) -> float:
    attempted = int(((plans.status != NO_TARGET) & (plans.status != Status.NOT_ATTEMPTED)).sum())
    return plans.run_s / attempted if attempted else math.nan
