"""Refusal of missing and infinite numbers in tables and arrays that are read; `columns.NEEDED` has the rules.

A number of the magnitude `files.LARGEST_NUMBER` or more counts as infinite, because computations with it overflow.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Bool, Float, Int

from htcp_jax.errors import InputError
from htcp_jax.motion import plans as plan_arrays
from htcp_jax.runs import columns
from htcp_jax.status import MOTION, SegmentStatus, Status
from htcp_jax.system import files

PLACE = "scenario", "target"  # columns whose values identify a row in a message
_TRACKED = pa.array([status.name for status in Status if status.tracked])
_PROVEN = pa.array([SegmentStatus(code).name for code in MOTION])


def check_table(rows: pa.Table, table: str, file: Path, joints: Sequence[str] = ()) -> None:
    """Check the values in a table that was read from a file.

    Args:
        rows: The table.
        table: Its name in `columns.TABLES`.
        file: The file, for messages.
        joints: Names of the columns of x, see `tables.joint_columns`.

    Raises:
        InputError: If a value is missing where one is needed, or if a number is infinite.
    """
    names = [name for name in PLACE if name in rows.column_names]

    def place(row: int) -> str:
        found = ", ".join(f"{name} {rows[name][row].as_py()}" for name in names)
        return f"row {row} ({found})" if found else f"row {row}"

    masks = _rows_of(rows, table)
    for name in rows.column_names:
        needed, values = columns.needed_in(name, table, joints), rows[name]
        if pa.types.is_list(values.type):  # each of a list's values is needed
            row, values = pc.list_parent_indices(values).to_numpy(), pc.list_flatten(values)
            _check(f"{file}: a value of {name}", _numbers(values), np.ones(len(row), bool), needed, place, row)
        else:
            _check(f"{file}: {name}", _numbers(values), masks[needed], needed, place)


def check_arrays(arrays: Mapping[str, np.ndarray], keys: Mapping[str, str], file: Path) -> None:
    """Check the arrays of one plan that were read from a file.

    Args:
        arrays: Fields of `Plans` by name, for the plan's only scenario; each has one row per target, except `start`.
        keys: For each field, its key in `columns.TARGETS`.
        file: The file, for messages.

    Raises:
        InputError: See `check_table`.
    """
    tracked = plan_arrays.is_tracked(arrays["status"])
    masks = {None: np.zeros(len(tracked), bool), columns.ALWAYS: np.ones(len(tracked), bool), columns.TRACKED: tracked}
    masks[columns.PROVEN] = tracked & np.isin(arrays["segment_status"], MOTION)
    for name, key in keys.items():
        needed = columns.NEEDED["targets"].get(key)
        _check(f"{file}: {name}", arrays[name], masks[needed], needed, lambda row: f"row {row}")
    _check(f"{file}: start", arrays["start"][None], np.ones(1, bool), None, lambda _: "row 0")


def _check(
    what: str,
    values: Float[np.ndarray, "n *k"],
    needed: Bool[np.ndarray, "n"],
    rule: str | None,
    place: Callable[[int], str],
    rows: Int[np.ndarray, "n"] | None = None,
) -> None:
    """Raise an error for the first row with an infinite value, or without a value although it is needed."""
    values = values[:, None] if values.ndim == 1 else values
    wrong = np.where(np.isnan(values), needed[:, None], ~(np.abs(values) < files.LARGEST_NUMBER))
    for k in np.flatnonzero(wrong.any(axis=1))[:1].tolist():
        value, where = values[k, wrong[k].argmax()], place(k if rows is None else int(rows[k]))
        if np.isnan(value):
            raise InputError(f"{what} is missing or NaN in {where}; a value is needed {rule or 'there'}")
        raise InputError(f"{what} is {value:g} in {where}; {files.NOT_FINITE}")


def _rows_of(rows: pa.Table, table: str) -> dict[str | None, Bool[np.ndarray, "n"]]:
    """Return the mask of the rows that each rule of `columns.NEEDED` names."""
    masks = {None: np.zeros(len(rows), bool), columns.ALWAYS: np.ones(len(rows), bool)}
    if table == "targets":
        masks[columns.TRACKED] = _mask(pc.is_in(rows["status"], _TRACKED))
        masks[columns.PROVEN] = masks[columns.TRACKED] & _mask(pc.is_in(rows["segment_status"], _PROVEN))
    elif table == "scenarios":
        masks[columns.TRACKED] = _mask(pc.greater(rows["tracked"], 0).fill_null(False))
    return masks


def _mask(column: pa.ChunkedArray) -> Bool[np.ndarray, "n"]:
    return column.to_numpy().astype(bool)


def _numbers(column: pa.ChunkedArray) -> Float[np.ndarray, "n"]:
    """Return a column as floats; NaN for null, and 0 for a text."""
    if pa.types.is_floating(column.type):
        return column.cast(pa.float64()).fill_null(np.nan).to_numpy()
    return np.where(column.is_null().to_numpy(), np.nan, 0.0)
