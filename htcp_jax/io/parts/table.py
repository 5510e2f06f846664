"""Reading of points from a table of numbers: text, and numpy's .npy files."""

import math
import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io.files import read_array, read_bytes
from htcp_jax.io.parts.columns import (
    NEARLY_UNIT,
    XYZ,
    ColumnIndices,
    Heading,
    TablePoints,
    cells_of,
    chosen_columns,
    columns_of,
    coordinates_in,
    headings,
    unit_of,
)

DECIMAL_COMMA = re.compile(r"[+-]?[\d.]*\d,\d+(?:[eE][+-]?\d+)?")


def read_table(path: Path, unit: str | None = None) -> TablePoints:
    """Read the points of a cloud from a text file, with rows of x, y, z and further columns.

    Columns are separated by commas, semicolons or blanks. Rows with NaN are read, as points without a measurement.

    Text after a # is a comment, and so is a line that begins with //. The first line that is not a comment may be a
    header without numbers. This header, or the last comment before the first row, may name the columns, see
    `columns_of`.

    Args:
        path: The file.
        unit: Unit of the coordinates, a key of `columns.PER_METRE`; None: the header's unit, or m if it has none.

    Raises:
        InputError: For too few columns, rows of different lengths, infinite numbers, text that is not a number, and
            decimal commas; the message names the line.
    """
    reader = _TableReader(path, is_cloud=True)
    reader.take_all()
    stated = None if reader.columns is None else reader.columns.unit
    if unit not in (None, stated or unit):
        raise InputError(f"{path}: the unit is {unit}, but {stated} in the header; omit the key")
    return reader.points(unit)


class NamedColumns(NamedTuple):
    """Points of a table, and further columns by their quantities."""

    xyz: Float[np.ndarray, "P 3"]  # [m]
    found: dict[tuple[str, ...], Float[np.ndarray, "P k"]]  # by family of names


def read_named(
    path: Path,
    families: Sequence[tuple[str, ...]],
    chosen: Mapping[str, int | str] = MappingProxyType({}),
    unit: str | None = None,
) -> NamedColumns:
    """Read the points of a text file, and further columns by name.

    Args:
        path: The file.
        families: Names of further columns; a family of k names is read, as (P, k), if all of them are in the header.
        chosen: The column of each quantity, see `columns.chosen_columns`, in place of the header's names; empty, or
            with x, y and z.
        unit: Unit of the coordinates, a key of `columns.PER_METRE`; None: the header's unit, or m if the header has
            none. A UserWarning reports a header with a different unit.

    Raises:
        InputError: As `read_table` and `chosen_columns` do, and for values that are not finite numbers; the message
            names the point.
    """
    reader = _TableReader(path, keep=True, chosen=chosen)
    reader.take_all()
    xyz, found = reader.points(unit).xyz, {}
    if reader.columns is None:
        return NamedColumns(xyz, found)
    if unit not in (None, reader.columns.unit or unit):
        text = f"the unit is {reader.columns.unit} in the header and {unit} in the job; the job's is used"
        warnings.warn(f"{path}: {text}", UserWarning, stacklevel=3)
    header = reader.header if reader.columns.named and len(reader.header or ()) == reader.columns.width else None
    names = [head.name for head in header or ()]
    for family in families:
        places = [reader.chosen.get(name, names.index(name) if name in names else None) for name in family]
        if None in places:
            continue
        cells = [[row[k] for k in places] for row in reader.rows]
        for k, row in enumerate(cells):
            if not all(_is_numeric_cell(cell) and math.isfinite(float(cell)) for cell in row):
                raise InputError(f"{path}: {','.join(family)} of point {k + 1} is {','.join(row)[:40]!r}")
        found[family] = np.array(cells, float)
    return NamedColumns(xyz, found)


class _TableReader:
    """Reader of a table line by line; the first row determines the columns.

    As long as the first column counts the rows, from 0 or 1, rows are stored: it is ignored only if it counts all rows.
    """

    def __init__(
        self,
        path: Path,
        keep: bool = False,
        chosen: Mapping[str, int | str] = MappingProxyType({}),
        is_cloud: bool = False,
    ):
        self.path, self.keep, self._chosen, self._is_cloud = path, keep, chosen, is_cloud
        self.chosen: dict[str, int] = {}  # indices of the chosen columns
        self.rows: list[list[str]] = []  # cells of all columns, if `keep`
        self.header: list[Heading] | None = None
        self._has_header_line = False  # otherwise the header is a comment, which need not fit
        self.first = self.width = 0  # the line of the first row, and its number of cells
        self.columns: ColumnIndices | None = None
        self.xyz: list[list[float]] = []
        self.normals: list[list[float]] | None = None
        self.whole = False  # True if all rows so far are as 1,5,2,5,3,5, where commas may be decimal
        self._counted: list[tuple[int, str, list[str]]] = []  # rows that are kept

    def take_all(self) -> None:
        lines = _table_text(self.path).replace("\r\n", "\n").replace("\r", "\n").split("\n")
        for number, line in enumerate(lines, start=1):
            self.take(number, line)
        if self._counted:
            self._begin(*self._counted[0], numbered=len(self._counted) > 1)

    def take(self, number: int, line: str) -> None:
        content, _, comment = line.partition("#")
        content = content.strip()
        if content.startswith("//"):
            content, comment = "", content[2:]
        if not content:
            if not self.first and not self._has_header_line:
                self._remark(comment)
            return
        cells = cells_of(content)
        if not self.first and not self._has_header_line and not any(_is_numeric_cell(cell) for cell in cells):
            if decimal := _decimal_commas(content):
                raise self._error(number, decimal)
            self._has_header_line, self.header = True, headings(content)
        else:
            self._row(number, content, cells)

    def points(self, unit: str | None = None) -> TablePoints:
        if self.columns is None:
            return TablePoints(np.empty((0, 3)))
        if self.whole:
            raise self._error(
                self.first, ": all columns contain whole numbers; if the file has decimal commas, write decimal points"
            )
        xyz = np.array(self.xyz, dtype=np.float64).reshape(-1, 3)
        normals = None if self.normals is None else np.array(self.normals, dtype=np.float64)
        return self.columns.points(xyz, normals, str(self.path), unit)

    def _remark(self, comment: str) -> None:
        """Use a comment as the header if it names coordinates."""
        found = headings(comment)
        if coordinates_in([head.name for head in found]):
            self.header = found

    def _row(self, number: int, content: str, cells: list[str]) -> None:
        if len(cells) < 3 or (self.first and len(cells) != self.width):
            need = "3 are needed (x y z)" if len(cells) < 3 else f"line {self.first} has {self.width}"
            raise self._error(number, _decimal_commas(content) or f" has {len(cells)} columns, {need}")
        if not self.first:
            self._know(number, cells)
        if self.columns is None and self._counts(cells):
            self._counted.append((number, content, cells))
            return
        if self.columns is None:
            self._begin(number, content, cells, numbered=False)
        self._take_row(number, content, cells)

    def _know(self, number: int, cells: list[str]) -> None:
        """Set the number of columns from the first row."""
        self.first, self.width = number, len(cells)
        if not self._has_header_line and self.header is not None and len(self.header) != self.width:
            self.header = None

    def _counts(self, cells: list[str]) -> bool:
        """True if the first column counts all rows so far, and the header does not use it for a quantity."""
        names = [head.name for head in self.header or ()]
        if (
            self.width < 4
            or self._chosen
            or (len(names) != self.width - 1 and (coordinates_in(names) or "x" in names[:1]))
        ):
            return False
        if not names and self.width == 6 and _is_unit(cells[3:]):  # coordinates and a normal
            return False
        first = _bare(self._counted[0][2][0] if self._counted else cells[0])
        counts = first in ("0", "1") and _bare(cells[0]) == str(int(first) + len(self._counted))
        return counts and all(map(_is_numeric_cell, cells[1:4]))

    def _begin(self, number: int, content: str, cells: list[str], numbered: bool) -> None:
        source = str(self.path)
        if numbered and self.header is not None and len(self.header) == self.width - 1:
            self.header = [Heading("", "", None), *self.header]
        known = self.header
        if self._chosen:
            self.chosen = chosen_columns(self._chosen, known, self.width, source)
            xyz = tuple(self.chosen[axis] for axis in XYZ)
            self.columns = ColumnIndices(self.width, xyz, None, True, unit_of(known or (), xyz, source))
        else:
            self.columns = columns_of(known, self.width, source, numbered=numbered, needs_names=self.keep)
        self.normals = None if self.columns.normals is None else []
        self.whole = not (self.columns.named or numbered) and self.width > 3 and ";" not in content and "," in content
        for row in self._counted:
            self._take_row(*row)
        self._counted = []

    def _take_row(self, number: int, content: str, cells: list[str]) -> None:
        row = []
        for k in self.columns.xyz:
            if not _is_numeric_cell(cells[k]):
                wrong = f": {cells[k].strip()[:30]!r} is not a number"
                raise self._error(number, _decimal_commas(content) or wrong)
            row.append(float(cells[k]))
        if not all(math.isfinite(value) or (self._is_cloud and math.isnan(value)) for value in row):
            raise self._error(number, " contains NaN or an infinite number")
        self.xyz.append(row)
        if self.keep:
            self.rows.append(cells)
        self.whole = self.whole and all(cell.strip().lstrip("+-").isdigit() for cell in cells)
        if self.normals is not None:
            self._normal(cells)

    def _normal(self, cells: list[str]) -> None:
        if all(_is_numeric_cell(cells[k]) for k in self.columns.normals):
            self.normals.append([float(cells[k]) for k in self.columns.normals])
        elif self.columns.named:
            self.normals.append([0.0, 0.0, 0.0])
        else:
            self.normals = None

    def _error(self, number: int, words: str) -> InputError:
        return InputError(f"{self.path}: line {number}{words}")


def read_npy(path: Path) -> TablePoints:
    """Read the points of a .npy file, an array of numbers (P, 3 or more).

    Raises:
        InputError: For an array of any other shape or type; pickles are refused.
    """
    array = read_array(read_bytes(path), str(path))
    if array.dtype.kind == "b":
        raise InputError(f"{path}: an array of bool; it must be an array of numbers")
    if array.ndim != 2 or array.shape[1] < 3:
        raise InputError(f"{path}: the array has the shape {array.shape}; it must be (points, 3 or more)")
    columns = columns_of(None, array.shape[1], str(path))
    xyz, *normals = (
        np.ascontiguousarray(array[:, which], dtype=np.float64)
        for which in (columns.xyz, columns.normals)
        if which is not None
    )
    return columns.points(xyz, normals[0] if normals else None, str(path))


def _table_text(path: Path) -> str:
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file of points (it is not UTF-8)") from None


def _is_unit(cells: Sequence[str]) -> bool:
    return all(map(_is_numeric_cell, cells)) and abs(math.hypot(*map(float, cells)) - 1.0) < NEARLY_UNIT


def _bare(cell: str) -> str:
    return cell.strip().strip("\"'").strip()


def _is_numeric_cell(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell  # Python reads 1_0 as ten; a table does not


def _decimal_commas(line: str) -> str:
    """Return a hint for an error message if a line's numbers have decimal commas, else ""."""
    cells = re.split(r"[;\s]+", line.strip("; \t"))
    decimal = [cell for cell in cells if DECIMAL_COMMA.fullmatch(cell)]
    others = [cell for cell in cells if "," in cell and cell not in decimal]
    if not decimal or others or len(cells) < 2:
        return ""
    first = decimal[0][:30]
    return f": {first!r} has a decimal comma; write a decimal point, {first.replace('.', '').replace(',', '.')}"
