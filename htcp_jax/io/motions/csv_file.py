"""Tables with a column per joint: this package's motion.csv and program CSV, and those of others."""

import csv
import re
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.io.motions.csv_columns import (
    ACCELERATION,
    POSITION,
    SECONDS,
    VELOCITY,
    Columns,
    columns_of,
    scales,
    slides_of,
)
from htcp_jax.io.motions.source import Rows, Source, listed

SEPARATORS = ";\t,"  # in order of precedence
NUMBER = re.compile(r"\s*[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?\s*")
OTHER = re.compile(r"[^-+.0-9eE \t]")  # what no number contains
DECIMAL_COMMA = re.compile(r"\s*[-+]?\d+,\d+(?:[eE][-+]?\d+)?\s*")
FULL_TURN = 2 * np.pi + 0.1  # a larger angle without a unit is refused, as it may be in degrees [rad]


class _Table(NamedTuple):
    header: list[str]
    header_line: int
    rows: list[list[str]]
    lines: list[int]
    notes: list[str]


def read_csv(source: Source) -> Rows:
    """Return the rows of a table.

    Raises:
        InputError: For a missing header, headings that are not the robot's joints, unknown or contradictory units, and
            cells that are not numbers.
    """
    table = _table(source)
    columns = columns_of(source, table.header, table.header_line)
    for number, row in zip(table.lines, table.rows, strict=True):
        if len(row) != len(table.header):
            source.fail(number, f"{len(row)} cells, but the header has {len(table.header)}")
    factors, notes = scales(source, columns, table.header_line)
    joints = columns.joints
    values = _numbers(source, table, [columns.of[POSITION][joint].index for joint in joints])
    slides = slides_of(source)
    bare = [
        m for m, name in enumerate(joints) if columns.of[POSITION][name].unit is None and not slides.get(name, False)
    ]
    check_radians(source, values[:, bare], np.array(table.lines), "line")
    time_s = None
    if columns.time is not None:
        time_s = _numbers(source, table, [columns.time.index])[:, 0] * SECONDS[columns.time.unit or "s"]
    if columns.unused:
        notes.append(f"Columns that are not used: {listed(columns.unused)}.")
    return Rows(
        joints,
        values,
        np.array(table.lines, int),
        scale=np.array([factors[POSITION, joint] for joint in joints]),
        time_s=time_s,
        velocity=_rates(source, table, columns, factors, VELOCITY),
        acceleration=_rates(source, table, columns, factors, ACCELERATION),
        kind=None if columns.kind is None else tuple(cells[columns.kind].strip() for cells in table.rows),
        notes=(*table.notes, *notes),
    )


def check_radians(source: Source, angles: Float[np.ndarray, "n M"], line: np.ndarray, counted: str) -> None:
    """Check that angles without a unit may be in radians.

    Raises:
        InputError: If no unit is requested and an angle exceeds a full turn.
    """
    if source.unit is not None or not angles.size:
        return
    beyond = (np.abs(angles) > FULL_TURN) & np.isfinite(angles)
    if beyond.any():
        n, m = np.argwhere(beyond)[0].tolist()
        text = f"an angle is {angles[n, m]:g}, more than a turn in radians, and no unit is stated"
        source.fail_at(f"{counted} {line[n]}", f"{text}; pass --unit deg or --unit rad")


def _table(source: Source) -> _Table:
    """Split a text into its header and rows."""
    comments, lines, numbers = [], [], []
    for number, line in enumerate(source.text.splitlines(), start=1):
        if line.lstrip().startswith("#"):
            if not lines:
                comments.append((number, line.lstrip().lstrip("#").strip()))
        elif line.strip():
            lines.append(line)
            numbers.append(number)
    if not lines:
        source.fail(max(1, len(comments)), "the file contains no table")
    separator = next((each for each in SEPARATORS if each in lines[0]), None)
    if separator is None and len(lines[0].split()) > 1:
        rows = [line.split() for line in lines]
    else:
        try:
            rows = list(csv.reader(lines, delimiter=separator or ",", strict=True))
        except csv.Error as error:
            source.fail(numbers[0], f"not a table ({error})")
        if len(rows) != len(lines):
            broken = next((k for k, row in enumerate(rows) if any("\n" in cell for cell in row)), 0)
            source.fail(numbers[broken], "a cell is not closed by a quotation mark")
    header, header_line = rows[0], numbers[0]
    if all(NUMBER.fullmatch(cell) or not cell.strip() for cell in header):
        if not comments:
            source.fail(header_line, "the header with the joints' names is missing")
        header_line, text = comments[-1]
        header = next(csv.reader([text], delimiter=separator)) if separator else text.split()
        header = [cell.strip() for cell in header]
    else:
        rows, numbers = rows[1:], numbers[1:]
    if not header[-1].strip() and all(not row[-1].strip() for row in rows if len(row) == len(header)):
        rows = [row[:-1] if len(row) == len(header) else row for row in rows]
        header = header[:-1]
    return _with_points(_Table(header, header_line, rows, numbers, []), separator)


def _with_points(table: _Table, separator: str | None) -> _Table:
    """Return a table with decimal points instead of decimal commas, if its numbers have them and no point."""
    if separator == "," or not any(DECIMAL_COMMA.fullmatch(cell) for row in table.rows for cell in row):
        return table
    if any("." in cell and NUMBER.fullmatch(cell) for row in table.rows for cell in row):
        return table
    rows = [[cell.replace(",", ".") if DECIMAL_COMMA.fullmatch(cell) else cell for cell in row] for row in table.rows]
    return table._replace(rows=rows, notes=["Decimal commas are read as points."])


def _numbers(source: Source, table: _Table, indices: list[int]) -> Float[np.ndarray, "n M"]:
    """Return columns as numbers."""
    found = np.empty((len(table.rows), len(indices)))
    for m, k in enumerate(indices):
        cells = [row[k] for row in table.rows]
        try:
            if not all(cells) or OTHER.search("".join(cells)):
                raise ValueError
            found[:, m] = np.array(cells, str).astype(float)
        except ValueError:  # the first cell that is not a number
            n = next(n for n, cell in enumerate(cells) if NUMBER.fullmatch(cell) is None)
            text = cells[n].strip()[:40]
            what = f"holds {text!r}, which is not a finite number" if text else "is empty"
            source.fail(table.lines[n], f"the cell of {table.header[k].strip()} {what}")
    return found


def _rates(
    source: Source, table: _Table, columns: Columns, factors: dict[tuple[str, str], float], quantity: str
) -> Float[np.ndarray, "n M"] | None:
    """Return velocities or accelerations in the order of the joints; NaN for dependent joints without a column."""
    own = columns.of[quantity]
    if not own:
        return None
    found = np.full((len(table.rows), len(columns.joints)), np.nan)
    for m, joint in enumerate(columns.joints):
        if joint in own:
            found[:, m] = _numbers(source, table, [own[joint].index])[:, 0] * factors[quantity, joint]
    return found
