"""Reading of points from a table of numbers: text, and numpy's .npy files."""

import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.io.files import read_array, read_bytes
from htcp_jax.io.parts.columns import ColumnIndices, TablePoints, columns_of, header_names, without_units

DECIMAL_COMMA = re.compile(r"[+-]?[\d.]*\d,\d+(?:[eE][+-]?\d+)?")


def read_table(path: Path) -> TablePoints:
    """Read rows of x, y, z and further columns from a text file, separated by commas, semicolons or blanks.

    Text after a # is a comment, and so is a line that begins with //. The first other line may be a header without
    numbers. A header, or the last comment before the first row, may name the columns, see `columns_of`.

    Raises:
        InputError: Naming the line, for too few columns, rows of different lengths, NaN, text that is no number, and
            decimal commas.
    """
    reader = _TableReader(path)
    reader.take_all()
    return reader.points()


def read_named(path: Path, families: Sequence[tuple[str, ...]]) -> dict[tuple[str, ...], np.ndarray]:
    """Read further columns of a text file by name: each family (P, k) whose names are all in the header.

    Raises:
        InputError: As `read_table` does, and for values that are not finite numbers, naming the point.
    """
    reader = _TableReader(path, keep=True)
    reader.take_all()
    names, found = reader.names or [], {}
    if reader.columns is None or not reader.columns.named:
        return found
    for family in families:
        if all(names.count(name) == 1 for name in family):
            cells = [[row[names.index(name)] for name in family] for row in reader.rows]
            for k, row in enumerate(cells):
                if not all(_is_numeric_cell(cell) and math.isfinite(float(cell)) for cell in row):
                    raise InputError(f"{path}: {','.join(family)} of point {k + 1} is {','.join(row)[:40]!r}")
            found[family] = np.array(cells, float)
    return found


class _TableReader:
    """A reader of lines; the first row determines the columns."""

    def __init__(self, path: Path, keep: bool = False):
        self.path, self.keep = path, keep
        self.rows: list[list[str]] = []  # cells of all columns, if `keep`
        self.names: list[str] | None = None
        self.header: int | None = None  # its line
        self.first = 0  # the line of the first row
        self.columns: ColumnIndices | None = None
        self.xyz: list[list[float]] = []
        self.normals: list[list[float]] | None = None
        self.whole = False  # True if all rows so far are as 1,5,2,5,3,5, where commas may be decimal

    def take_all(self) -> None:
        lines = _table_text(self.path).replace("\r\n", "\n").replace("\r", "\n").split("\n")
        for number, line in enumerate(lines, start=1):
            self.take(number, line)

    def take(self, number: int, line: str) -> None:
        content, _, comment = line.partition("#")
        content = content.strip()
        if content.startswith("//"):
            content, comment = "", content[2:]
        if not content:
            if self.columns is None and self.header is None:
                self._remark(comment)
            return
        cells = _cells(content)
        if self.columns is None and self.header is None and not any(_is_numeric_cell(cell) for cell in cells):
            if decimal := _decimal_commas(content):
                raise self._error(number, decimal)
            self.header, self.names = number, header_names(_cells(without_units(content).strip()))
        else:
            self._row(number, content, cells)

    def points(self) -> TablePoints:
        if self.columns is None:
            return TablePoints(np.empty((0, 3)))
        if self.whole:
            raise self._error(self.first, ": decimal commas? A whole number in every column; write decimal points")
        xyz = np.array(self.xyz, dtype=np.float64).reshape(-1, 3)
        normals = None if self.normals is None else np.array(self.normals, dtype=np.float64)
        return self.columns.points(xyz, normals, str(self.path))

    def _remark(self, comment: str) -> None:
        """Take a comment as a header if it names x, y and z."""
        names = header_names(_cells(without_units(comment).strip()))
        if {"x", "y", "z"} <= set(names):
            self.names = names

    def _row(self, number: int, content: str, cells: list[str]) -> None:
        if len(cells) < 3 or (self.columns is not None and len(cells) != self.columns.width):
            need = "3 are needed (x y z)" if len(cells) < 3 else f"line {self.first} has {self.columns.width}"
            raise self._error(number, _decimal_commas(content) or f" has {len(cells)} columns, {need}")
        if self.columns is None:
            self._begin(number, content, cells)
        row = []
        for k in self.columns.xyz:
            if not _is_numeric_cell(cells[k]):
                wrong = f": {cells[k].strip()[:30]!r} is not a number"
                raise self._error(number, _decimal_commas(content) or wrong)
            row.append(float(cells[k]))
        if not all(map(math.isfinite, row)):
            raise self._error(number, " holds NaN or an infinite number")
        self.xyz.append(row)
        if self.keep:
            self.rows.append(cells)
        self.whole = self.whole and all(cell.strip().lstrip("+-").isdigit() for cell in cells)
        if self.normals is not None:
            self._normal(cells)

    def _begin(self, number: int, content: str, cells: list[str]) -> None:
        names = self.names
        if self.header is None and names is not None and len(names) != len(cells):
            names = None  # a comment need not fit
        self.first, self.columns = number, columns_of(names, len(cells), str(self.path))
        self.normals = None if self.columns.normals is None else []
        self.whole = not self.columns.named and len(cells) > 3 and ";" not in content and "," in content

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
        InputError: For any other array; pickles are not read.
    """
    array = read_array(read_bytes(path), str(path))
    if array.dtype.kind == "b":
        raise InputError(f"{path}: an array of bool, numbers are needed")
    if array.ndim != 2 or array.shape[1] < 3:
        raise InputError(f"{path}: an array of shape {array.shape}, (points, 3 or more) is needed")
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


def _cells(line: str) -> list[str]:
    for separator in (";", ","):
        if separator in line:
            return line.split(separator)
    return line.split()


def _is_numeric_cell(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell  # Python reads 1_0 as ten; a table does not


def _decimal_commas(line: str) -> str:
    """Return a suggestion if numbers of a line have decimal commas, else ""."""
    cells = re.split(r"[;\s]+", line.strip("; \t"))
    decimal = [cell for cell in cells if DECIMAL_COMMA.fullmatch(cell)]
    others = [cell for cell in cells if "," in cell and cell not in decimal]
    if not decimal or others or len(cells) < 2:
        return ""
    first = decimal[0][:30]
    return f": {first!r} has a decimal comma; write a decimal point, {first.replace('.', '').replace(',', '.')}"
