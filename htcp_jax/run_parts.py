"""A run as the report tells it: a part for every group of its sweep, with the plans of each method as arrays."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from htcp_jax import paper
from htcp_jax.errors import InputError
from htcp_jax.metrics import is_tracked
from htcp_jax.plans import Plans
from htcp_jax.run_folder import Run
from htcp_jax.run_tables import NO_TARGET
from htcp_jax.status import Status

CEILING = "ceiling.json"
XYZ = "xyz"


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

    @property
    def targets(self) -> int:
        """T."""
        return max(plans.status.shape[1] for plans in self.plans.values())

    @property
    def axes(self) -> dict[str, np.ndarray]:
        """The parameters that vary, each with its values in order, without those that another one determines."""
        found: dict[str, np.ndarray] = {}
        for name, values in self.parameters.items():
            levels = np.unique(values)
            if len(levels) > 1 and not any(_determines(self.parameters[other], values) for other in found):
                found[name] = levels
        return found

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


class Reachable(NamedTuple):
    """What `htcp ceiling` left in a run's folder."""

    prefix: np.ndarray  # (S,) targets in a row that are known to be reachable, of scenario 0, 1, ...
    draws: int
    seed: int


def read_ceiling(run: Run) -> Reachable | None:
    """The run's ceiling; None where none was searched. Raises InputError for a damaged file, and for one that is of
    another number of scenarios."""
    file = Path(run.folder) / CEILING
    try:
        record = json.loads(file.read_text(encoding="utf-8"))
        found = Reachable(np.asarray(record["prefix"], int), int(record["draws"]), int(record["seed"]))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{file} is damaged or no result of htcp ceiling: {error}") from None
    if found.prefix.shape != (run.manifest.count,):
        raise InputError(f"{file} holds {found.prefix.size} scenarios, the run has {run.manifest.count}")
    return found


def read_parts(run: Run, name: str) -> list[Part]:
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
    names = [*_parameter_names(table, run.manifest.joints), *run.varied]
    parameters = {name: _column(table[name], name in run.varied) for name in names}
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
            )
        )
    return parts


def tracked(status: np.ndarray) -> np.ndarray:
    """Where `status`, of any shape, says tracked; a target that is not there is not."""
    return (status != NO_TARGET) & is_tracked(status)


def _determines(these: np.ndarray, those: np.ndarray) -> bool:
    """Whether scenarios that agree in `these` agree in `those`."""
    pairs = {(a, b) for a, b in zip(these.tolist(), those.tolist(), strict=True)}
    return len(pairs) == len(set(these.tolist()))


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


def _parameter_names(table: pa.Table, joints: Sequence[str]) -> list[str]:
    names = [f"start_{joint}" for joint in joints]
    names += ["rotation_x_rad", "rotation_y_rad", "rotation_z_rad", *(f"shift_{axis}_m" for axis in XYZ)]
    return [*names, "tool_extension_m", "margin_m", "path"]


def _column(column: pa.ChunkedArray, is_json: bool) -> np.ndarray:
    """Numbers rounded to what a person writes, so that 0.1 + 0.2 and 0.3 are one value of an axis; of JSON also words,
    and anything else as it is written."""
    told = column.to_pylist()
    if is_json:
        read = [json.loads(text) for text in told]
        kinds = {type(value) for value in read}
        told = read if kinds <= {int, float} or kinds == {str} else told
    values = np.array(told)
    return np.round(values, 9) + 0.0 if values.dtype.kind == "f" else values
