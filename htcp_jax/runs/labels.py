"""What sets a scenario of a run apart, in a few words: `tilt y 0.2 rad, height -0.1 m, tool 0.05 m`.

Of the columns of a run's scenario table, those that tell no result are parameters; those that vary are the label.
"""

import json
from typing import Any

import numpy as np
import pyarrow as pa

from htcp_jax.motion.motion import MotionFigures
from htcp_jax.runs.timing_file import COLUMNS

RESULTS = (
    "method", "scenario", "group", "targets", "tracked", "complete", "failed_target", "failure", "reason",
    "after_escape", "blocked_paths", "clearance_min_m", "residual_max_m", "joint_motion_rad", "executable",
    *MotionFigures._fields, *COLUMNS,
)  # fmt: skip
SHORT = {
    "rotation_x": "tilt x",
    "rotation_y": "tilt y",
    "rotation_z": "tilt z",
    "shift_x": "x",
    "shift_y": "y",
    "shift_z": "height",
    "tool_extension": "tool",
    "robot.model": "robot",
    "workpiece.cloud": "cloud",
}
UNITS = {"rad": "rad", "m": "m", "mm": "mm", "deg": "deg"}


def labels_of(table: pa.Table) -> dict[int, str]:
    """The label of every scenario in the table, by its number; an empty text where there is but one."""
    numbers, first = np.unique(table["scenario"].to_numpy(), return_index=True)
    table = table.take(pa.array(first))
    columns = varying({name: column_of(table[name]) for name in parameter_names(table)})
    groups = [f"{group}: " if group else "" for group in table["group"].to_pylist()]
    told = [", ".join(part(name, values[k]) for name, values in columns.items()) for k in range(len(numbers))]
    return {int(number): group + text for number, group, text in zip(numbers, groups, told, strict=True)}


def named(number: int, labels: dict[int, str]) -> str:
    """A scenario in a sentence: its number and, where it has one, its label in brackets."""
    return f"{number} ({labels[number]})" if labels.get(number) else str(number)


def counted(number: int, noun: str) -> str:
    """A number with its noun: 1 target, 2 targets."""
    return f"{number:,} {noun}{'s' * (number != 1)}"


def parameter_names(table: pa.Table) -> list[str]:
    """The columns of a scenario table that a grid may vary."""
    return [name for name in table.column_names if name not in RESULTS]


def varying(parameters: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The parameters that vary, without those that another one determines."""
    found: dict[str, np.ndarray] = {}
    for name, values in parameters.items():
        if len(set(values.tolist())) > 1 and not any(_determines(other, values) for other in found.values()):
            found[name] = values
    return found


def part(name: str, value: Any) -> str:
    """One parameter with its value and unit: `tilt y 0.2 rad`."""
    stem, unit = split_unit(name)
    text = f"{value:.6g}" if isinstance(value, float | np.floating) else str(value)
    return " ".join(filter(None, (SHORT.get(stem, stem.removeprefix("start_").replace("_", " ")), text, unit)))


def split_unit(name: str) -> tuple[str, str]:
    """A column's name without its unit, and the unit; none where the name has none."""
    stem, _, unit = name.rpartition("_")
    return (stem, UNITS[unit]) if stem and unit in UNITS else (name, "")


def column_of(column: pa.ChunkedArray) -> np.ndarray:
    """Numbers rounded to what a person writes, so that 0.1 + 0.2 and 0.3 are one value of an axis; where a column has
    JSON of numbers or words, these, and lists as they are written."""
    values = np.array(_read_json(column.to_pylist()))
    return np.round(values, 9) + 0.0 if values.dtype.kind == "f" else values


def _read_json(told: list) -> list:
    try:
        read = [json.loads(text) for text in told]
    except (TypeError, ValueError):
        return told
    kinds = {type(value) for value in read}
    return read if kinds <= {int, float} or kinds == {str} else told


def _determines(these: np.ndarray, those: np.ndarray) -> bool:
    """Whether scenarios that agree in `these` agree in `those`."""
    pairs = {(a, b) for a, b in zip(these.tolist(), those.tolist(), strict=True)}
    return len(pairs) == len(set(these.tolist()))
