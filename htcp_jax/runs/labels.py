"""Labels that describe a run's scenarios by their parameters: `rotation y 0.2 rad, shift z -0.1 m`.

The parameters are the columns of the scenario table that are not in RESULTS. A label contains those that the grid
varies: all parameters of an axis whose parameters vary jointly.
"""

import json
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from htcp_jax.runs import columns, parameters

RESULTS = {*columns.SCENARIOS, *columns.TIMING} - {*parameters.ROTATIONS, parameters.TOOL, "margin_m", "path"}


def labels_of(table: pa.Table, keys: Collection[str] = ()) -> dict[int, str]:
    """Return the label of every scenario in a scenario table, by number; "" if neither group nor parameter varies.

    Args:
        table: The scenario table.
        keys: Parameters that the grid varies, see `varied_columns`; empty: unknown.
    """
    numbers, first = np.unique(table["scenario"].to_numpy(), return_index=True)
    table = table.take(pa.array(first))
    given = varying({name: column_of(table[name]) for name in parameter_names(table)}, keys)
    groups = [f"{group}: " if group else "" for group in table["group"].to_pylist()]
    reported = [", ".join(part(name, values[k]) for name, values in given.items()) for k in range(len(numbers))]
    return {int(number): group + text for number, group, text in zip(numbers, groups, reported, strict=True)}


def named_scenario(number: int, labels: dict[int, str]) -> str:
    """Return a scenario's number, followed by its label in brackets unless the label is empty."""
    return f"{number} ({labels[number]})" if labels.get(number) else str(number)


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, such as "1 target" or "2 targets"."""
    return f"{number:,} {noun}{'s' * (number != 1)}"


def parameter_names(table: pa.Table) -> list[str]:
    """Return the names of the columns that a grid may vary: all columns that are not in RESULTS."""
    return [name for name in table.column_names if name not in RESULTS]


def varied_columns(grid: Sequence[Mapping[str, Any]], names: Collection[str]) -> dict[str, str]:
    """Return the columns that a grid varies, by the keys in its axes; keys without a column are not included.

    Args:
        grid: The groups of a run's grid, see `Manifest.grid`.
        names: Names of the columns that a grid may vary, see `parameter_names`.
    """
    found = {}
    for key in (key for group in grid for axis in group["axes"] for key in axis):
        section, _, last = key.rpartition(".")
        others = {
            "start_rad": (f"start_{last}_rad", f"start_{last}_m"),
            "workpiece.shift_m": (f"shift_{last}_m",),
            **dict.fromkeys(("robot", "workpiece"), (last,)),
        }
        column = next((name for name in (key, *others.get(section, ()), section) if name in names), None)
        found |= {} if column is None else {key: column}
    return found


def varying(parameters: dict[str, np.ndarray], keys: Collection[str] = ()) -> dict[str, np.ndarray]:
    """Return the parameters that vary: those of the grid, or, if none is known, the independent ones.

    Args:
        parameters: Values in the scenarios, by parameter.
        keys: Parameters that the grid varies, see `varied_columns`.
    """
    known = {name: values for name, values in parameters.items() if name in keys and len(set(values.tolist())) > 1}
    return known or independent(parameters)


def independent(parameters: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the parameters that vary, except those whose value follows from another varying parameter."""
    found: dict[str, np.ndarray] = {}
    for name, values in parameters.items():
        if len(set(values.tolist())) > 1 and not any(_determines(other, values) for other in found.values()):
            found[name] = values
    return found


def listed(names: Sequence[str], most: int | None = None) -> str:
    """Return names as text, separated by commas; after the first `most`, "and N more"."""
    if most is None or len(names) <= most:
        return ", ".join(names)
    return f"{', '.join(names[:most])} and {len(names) - most} more"


def part(name: str, value: Any) -> str:
    """Return the text of one parameter with its value and unit, such as `rotation y 0.2 rad`."""
    column = columns.column(name)
    text = f"{value:.6g}" if isinstance(value, float | np.floating) else str(value)
    return f"{column.heading} {text} {column.unit}".rstrip()


def column_of(column: pa.ChunkedArray) -> np.ndarray:
    """Return the values of a column as an array. JSON numbers and strings are decoded; lists remain JSON text.

    Floats are rounded to 9 decimals, so that 0.1 + 0.2 equals 0.3.
    """
    values = np.array(_read_json(column.to_pylist()))
    return np.round(values, 9) + 0.0 if values.dtype.kind == "f" else values


def _read_json(reported: list) -> list:
    try:
        read = [json.loads(text) for text in reported]
    except (TypeError, ValueError):
        return reported
    kinds = {type(value) for value in read}
    return read if kinds <= {int, float} or kinds == {str} else reported


def _determines(these: np.ndarray, those: np.ndarray) -> bool:
    """Return True if equal values in `these` imply equal values in `those`."""
    pairs = {(a, b) for a, b in zip(these.tolist(), those.tolist(), strict=True)}
    return len(pairs) == len(set(these.tolist()))
