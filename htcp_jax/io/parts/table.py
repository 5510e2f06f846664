"""Reading of points from a table of numbers: text, and numpy's .npy files."""

import math
import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np

from htcp_jax.errors import InputError, Note
from htcp_jax.io.arrays import read_array
from htcp_jax.io.parts.apt import BLOCK, NO_G_CODE
from htcp_jax.io.parts.columns import NEARLY_UNIT, XYZ, ColumnIndices, TablePoints, chosen_columns, columns_of, unit_of
from htcp_jax.io.parts.headings import (
    COORDINATE_NAMES,
    DIRECTION_NAMES,
    Heading,
    cells_of,
    coordinates_in,
    header_of_comments,
    headings,
    is_blank_separated,
    stated_unit,
    units_in,
    with_units,
)
from htcp_jax.io.parts.lengths import PER_METRE
from htcp_jax.system import read_bytes

COMMENTS = ("//", "%")  # beginnings of a line that is a comment; # may stand anywhere in a line
SEPARATOR_LINE = re.compile(r'"?sep=.?"?')  # of spreadsheets
ABOUT_SEAMS = re.compile(r"\b(seam|pass|segment|weld|path|bead|layer)\b", re.IGNORECASE)
DECIMAL_COMMA = re.compile(r"[+-]?[\d.]*\d,\d+(?:[eE][+-]?\d+)?")


def read_table(path: Path, unit: str | None = None) -> TablePoints:
    """Read the points of a cloud from a text file, with rows of x, y, z and further columns.

    Columns are separated by commas, semicolons or blanks. Rows with NaN are read, as points without a measurement.

    Text after a # is a comment, and so is a line that begins with // or %. The first line that is not a comment may be
    a header without numbers, and the next one a row of units. This header, or a comment before the first row, may name
    the columns, see `columns_of` and `header_of_comments`.

    Args:
        path: The file.
        unit: Unit of the coordinates, a key of `columns.PER_METRE`; None: the header's unit, or m if it has none.

    Raises:
        InputError: For too few columns, rows of different lengths, infinite numbers, text that is not a number, and
            decimal commas; the message names the line.
    """
    reader = TableReader(path)
    reader.take_all()
    if unit not in (None, reader.unit or unit):
        raise InputError(f"{path}: the unit is {unit}, but {reader.unit} in the header; omit the key")
    return reader.points(unit)


class TableReader:
    """Reader of a table line by line; the first row determines the columns.

    As long as the first column counts the rows, from 0 or 1, rows are stored: it is ignored only if it counts all rows.
    """

    def __init__(self, path: Path, keep: bool = False, chosen: Mapping[str, int | str] = MappingProxyType({})):
        self.path, self.keep, self._chosen = path, keep, chosen  # keep: a path; else a cloud
        self.chosen: dict[str, int] = {}  # indices of the chosen columns
        self.rows: list[list[str]] = []  # cells of all columns, if `keep`
        self.hidden: list[int] = []  # lines of comments that have the form of a row, if `keep`
        self.blank: list[int] = []  # number of blank lines in sequence before each row, if `keep`
        self.header: list[Heading] | None = None
        self._header_line = ""  # the line without numbers before the first row; "": a comment may be the header
        self._comments: list[str] = []  # before the first row
        self._units: list[str] | None = None  # in the row below the header, or in a comment
        self._stated: list[str] = []  # units in comments such as "unit: mm", and in a title
        self._blank = self._most_blank = 0  # number of blank lines in sequence, and its maximum since the last row
        self.first = self.width = 0  # the line of the first row, and its number of cells
        self._blank_separated = False  # True if blanks separate the cells of the first row
        self.columns: ColumnIndices | None = None
        self._may_count = False  # True if the header does not use the first column for a quantity
        self.xyz: list[list[float]] = []
        self.normals: list[list[float]] | None = None
        self.whole = False  # True if all rows so far are as 1,5,2,5,3,5, where commas may be decimal
        self._counted: list[tuple[int, str, list[str]]] = []  # rows that are kept

    def take_all(self) -> None:
        """Read all lines.

        Raises:
            InputError: See `read_table`.
        """
        lines = _table_text(self.path).replace("\r\n", "\n").replace("\r", "\n").split("\n")
        for number, line in enumerate(lines, start=1):
            self._take(number, line)
        if self._counted:
            number, content, _ = self._counted[0]
            self._begin(number, content, numbered=len(self._counted) > 1)

    def _take(self, number: int, line: str) -> None:
        content, mark, comment = line.partition("#")
        content = content.strip()
        if mark and content and not self.first and self._is_header(content + comment):
            content = content + comment  # a name such as "Point #"
        if content.startswith(COMMENTS):
            content, mark, comment = "", content[:1], content.lstrip("/%")
        if not content.strip(",;\t "):
            self._remark(number, comment.strip(), is_blank=not mark)
            return
        cells = cells_of(content)
        if not self.first and not any(is_numeric_cell(cell) for cell in cells):
            if self._read_heading(number, content, cells):
                return
        self._row(number, content, cells)

    def _read_heading(self, number: int, content: str, cells: list[str]) -> bool:
        """Read a line without numbers before the first row: a title, the header or units; False for any other."""
        if not self._header_line or (not self._is_header(self._header_line) and self._is_header(content)):
            if decimal := _decimal_commas(content):
                raise self._error(number, decimal)
            if self._header_line:
                self._name_title()
            is_directive = SEPARATOR_LINE.fullmatch(content) is not None
            self._header_line, self.header = ("", None) if is_directive else (content, headings(content))
            return True
        if self._units is None and len(cells) == len(self.header) and (units := units_in(cells)):
            self._units = units
            return True
        return False

    @property
    def unit(self) -> str | None:
        """Unit in the header and the comments; two different ones are joined by "and"; None without any."""
        named = [self.columns.unit] if self.columns is not None and self.columns.unit else []
        return " and ".join(dict.fromkeys([*named, *self._stated])) or None

    @staticmethod
    def _is_header(content: str) -> bool:
        return bool(coordinates_in([head.name for head in headings(content)]))

    def points(self, unit: str | None = None) -> TablePoints:
        """Return the points [m], and normals if the table has any.

        Args:
            unit: Unit of the coordinates, a key of `columns.PER_METRE`; None: the header's unit, or m if it has none.

        Raises:
            InputError: If commas may be decimal, and for an unknown unit or two units in the file.
        """
        if self.columns is None:
            return TablePoints(np.empty((0, 3)))
        if self.whole:
            raise self._error(
                self.first, ": all columns contain whole numbers; if the file has decimal commas, write decimal points"
            )
        xyz = np.array(self.xyz, dtype=np.float64).reshape(-1, 3)
        normals = None if self.normals is None else np.array(self.normals, dtype=np.float64)
        return self.columns._replace(unit=self.unit).points(xyz, normals, str(self.path), unit)

    def _remark(self, number: int, comment: str, is_blank: bool) -> None:
        """Count blank lines; store a comment before the first row, which may name columns or units."""
        self._blank = self._blank + 1 if is_blank else 0
        self._most_blank = max(self._most_blank, self._blank)
        if not comment:
            return
        self._state(comment)
        if not self.first:
            self._comments.append(comment)
        elif self.keep and sum(map(is_numeric_cell, row := cells_of(comment))) >= 2 and len(row) == self.width:
            self.hidden.append(number)
        elif self.keep and not self._most_blank and ABOUT_SEAMS.search(comment):
            text = f"the comment {comment[:60]!r} in line {number} does not begin another seam; a blank line would"
            warnings.warn(f"{self.path}: {text}", Note, stacklevel=4)

    def _state(self, text: str) -> None:
        """Store the unit of length that a comment or a title states."""
        if (unit := stated_unit(text)) is not None:
            self._stated.append(unit)

    def _row(self, number: int, content: str, cells: list[str]) -> None:
        if content.count('"') % 2:
            raise self._error(number, " has a quote without its end")
        if self.keep and BLOCK.fullmatch(content.strip()):
            raise self._error(number, f": {NO_G_CODE}")
        if len(cells) < 3 or (self.first and len(cells) != self.width):
            need = "3 are needed (x y z)" if len(cells) < 3 else f"line {self.first} has {self.width}"
            raise self._error(number, _decimal_commas(content) or f" has {len(cells)} columns, {need}")
        if not self.first:
            self._know(number, content, cells)
        if self.keep:
            self.blank.append(self._most_blank)
        self._blank = self._most_blank = 0
        if self.columns is None and self._counts(cells):
            self._counted.append((number, content, cells))
            return
        if self.columns is None:
            self._begin(number, content, numbered=False)
        self._take_row(number, content, cells)

    def _know(self, number: int, content: str, cells: list[str]) -> None:
        """Set the number of columns from the first row, and the header."""
        self.first, self.width, self._blank_separated = number, len(cells), is_blank_separated(content)
        if self._header_line:
            self.header = headings(self._header_line, self.width)
            self._drop_title(numbered=True)
        else:
            self._read_comments()
        units = self._units or next(filter(None, (units_in(cells_of(text)) for text in self._comments)), None)
        if units and self.header and len(units) == len(self.header):
            self.header = with_units(self.header, units, str(self.path))
        elif units and not self.header and len(units) == self.width:
            self._stated += [unit for unit in units if unit in PER_METRE]
        names = [head.name for head in self.header or ()]
        is_named = len(names) != self.width - 1 and (bool(coordinates_in(names)) or "x" in names[:1])
        self._may_count = self.width >= 4 and not self._chosen and not is_named

    def _read_comments(self) -> None:
        """Set the header from the comments; a Note reports a last comment that could name columns."""
        self.header = header_of_comments(self._comments, self.width, self._blank_separated)
        last = headings(self._comments[-1], self.width) if self._comments else []
        if self.header is not None or len(last) != self.width or self._stated:
            return
        if self._chosen:
            self.header = last
            return
        text = f"the comment {self._comments[-1][:60]!r} names none of x, y, z and is not read as a header"
        warnings.warn(f"{self.path}: {text}", Note, stacklevel=4)

    def _drop_title(self, numbered: bool) -> None:
        """Drop a header line that is a title: a text without known names, for another number of columns."""
        if not self._header_line or self._chosen or len(self.header) in (self.width, self.width - int(numbered)):
            return
        known = any(head.name in COORDINATE_NAMES | DIRECTION_NAMES for head in self.header)
        if known or (len(self.header) >= 3 and not is_blank_separated(self._header_line)):
            return
        self._name_title()
        self._header_line = ""
        self._read_comments()

    def _name_title(self) -> None:
        """Report a title; it may state a unit."""
        self._state(self._header_line)
        text = f"the first line is a title, not a header: {self._header_line[:60]!r}"
        warnings.warn(f"{self.path}: {text}", Note, stacklevel=4)

    def _counts(self, cells: list[str]) -> bool:
        """True if the first column counts all rows so far."""
        if not self._may_count:
            return False
        if self.width == 6 and not self.header and _is_unit(cells[3:]):  # coordinates and a normal
            return False
        first = bare(self._counted[0][2][0] if self._counted else cells[0])
        counts = first in ("0", "1") and bare(cells[0]) == str(int(first) + len(self._counted))
        return counts and all(map(is_numeric_cell, cells[1:4]))

    def _begin(self, number: int, content: str, numbered: bool) -> None:
        source = str(self.path)
        self._drop_title(numbered)
        if numbered and self.header is not None and len(self.header) == self.width - 1:
            self.header = [Heading("", "", None), *self.header]
        try:
            self.columns = self._columns(source, numbered)
        except InputError:
            if decimal := _decimal_commas(content):
                raise self._error(number, decimal) from None
            raise
        self.normals = None if self.columns.normals is None else []
        self.whole = not (self.columns.named or numbered) and self.width > 3 and ";" not in content and "," in content
        for row in self._counted:
            self._take_row(*row)
        self._counted = []

    def _columns(self, source: str, numbered: bool) -> ColumnIndices:
        if not self._chosen:
            return columns_of(self.header, self.width, source, numbered=numbered, needs_names=self.keep)
        self.chosen = chosen_columns(self._chosen, self.header, self.width, source)
        xyz = tuple(self.chosen[axis] for axis in XYZ)
        return ColumnIndices(self.width, xyz, None, True, unit_of(self.header or (), xyz, source))

    def _take_row(self, number: int, content: str, cells: list[str]) -> None:
        row = []
        for k in self.columns.xyz:
            if not is_numeric_cell(cells[k]):
                cell = cells[k].strip()
                wrong = f": {cell[:30]!r} is not a number"
                raise self._error(
                    number, _decimal_commas(content) or _decimal_commas(f"{bare(cell)};{bare(cell)}") or wrong
                )
            row.append(value_of(cells[k]))
        if not all(math.isfinite(value) or (not self.keep and math.isnan(value)) for value in row):
            raise self._error(number, " contains NaN or an infinite number")
        self.xyz.append(row)
        if self.keep:
            self.rows.append(cells)
        self.whole = self.whole and all(bare(cell).lstrip("+-").isdigit() for cell in cells)
        if self.normals is not None:
            self._normal(cells)

    def _normal(self, cells: list[str]) -> None:
        if all(is_numeric_cell(cells[k]) for k in self.columns.normals):
            self.normals.append([value_of(cells[k]) for k in self.columns.normals])
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
    return all(map(is_numeric_cell, cells)) and abs(math.hypot(*map(value_of, cells)) - 1.0) < NEARLY_UNIT


def bare(cell: str) -> str:
    """Return a cell without quotes and outer blanks."""
    return cell.strip().strip("\"'").strip()


def is_numeric_cell(cell: str) -> bool:
    """Return True for a cell that contains a number."""
    try:
        value_of(cell)
    except ValueError:
        return False
    return "_" not in cell  # Python reads 1_0 as ten; a table does not


def value_of(cell: str) -> float:
    """Return the number in a cell, which may have quotes.

    Raises:
        ValueError: For any other text.
    """
    try:
        return float(cell)
    except ValueError:
        return float(bare(cell))


def _decimal_commas(line: str) -> str:
    """Return a hint for an error message if a line's numbers have decimal commas, else ""."""
    cells = re.split(r"[;\s]+", line.replace('"', "").strip("; \t"))
    decimal = [cell for cell in cells if DECIMAL_COMMA.fullmatch(cell)]
    others = [cell for cell in cells if "," in cell and cell not in decimal]
    if not decimal or others or len(cells) < 2:
        return ""
    first = decimal[0][:30]
    return f": {first!r} has a decimal comma; write a decimal point, {first.replace('.', '').replace(',', '.')}"
