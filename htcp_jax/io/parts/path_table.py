"""Table of a path's file: its rows by seam, with columns by name."""

import math
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError, Note
from htcp_jax.io.parts.headings import Heading, listed
from htcp_jax.io.parts.seams import SeamRows, seam_rows
from htcp_jax.io.parts.table import TableReader, bare, is_numeric_cell
from htcp_jax.model import arrays
from htcp_jax.system import known_ending, note_missing_line_end, read_tail

COLOURS = {"r", "g", "b"}
ENDINGS = (".xyz", ".csv", ".txt")


class PathTable:
    """Rows of a path's file: its points, and further columns by name."""

    def __init__(
        self, path: Path, chosen: Mapping[str, int | str] = MappingProxyType({}), unit: str | None = None
    ) -> None:
        """Read the file; blank lines between rows, and a column `seam`, mean several seams, see `seam_rows`.

        A Note reports a last line without a line end.

        Args:
            path: The file.
            chosen: The column of each quantity, see `columns.chosen_columns`, in place of the header's names; empty, or
                with x, y and z.
            unit: Unit of the coordinates, a key of `columns.PER_METRE`; None: the header's unit, or m if the header has
                none. A UserWarning reports a header with a different unit.

        Raises:
            InputError: As `read_table`, `chosen_columns` and `seam_rows` do, for an unknown ending, and for no points.
        """
        known_ending(path, ENDINGS)
        self._path, self._reader = path, TableReader(path, keep=True, chosen=chosen)
        self._reader.take_all()
        columns, header = self._reader.columns, self._reader.header or ()
        points = self._reader.points(unit)
        self.xyz: Float[np.ndarray, "P 3"] = points.xyz  # [m]
        if not len(self.xyz):
            raise InputError(f"{path}: the tool path is empty")
        arrays.check_points(self.xyz, str(path), at_least=1)
        # Unit normals, or 0, in the last columns of a table without names; None if there are none.
        self.guessed_normals = None if columns is None or columns.named else points.normals
        self._header = header if columns is not None and len(header) == columns.width and columns.named else ()
        self.seams = [SeamRows("1", 0, len(self.xyz))]
        if columns is None:
            return
        self.seams = seam_rows(str(path), self._reader.rows, self._reader.blank, self._header)
        if unit not in (None, self._reader.unit or unit):
            text = f"the unit is {self._reader.unit} in the header and {unit} in the job; the job's is used"
            warnings.warn(f"{path}: {text}", UserWarning, stacklevel=4)
        if hidden := self._reader.hidden:
            text = f"comments in the form of a row are ignored; the first of {len(hidden)} is line {hidden[0]}"
            warnings.warn(f"{path}: {text}", Note, stacklevel=4)
        note_missing_line_end(path, read_tail(path))

    def headings(self, family: Sequence[str]) -> list[Heading] | None:
        """Return the headings of the columns with these names; None if the table lacks one of them.

        Raises:
            InputError: If the header has one of the names twice.
        """
        if (places := self._places(family)) is None:
            return None
        names = [head.name for head in self._header]
        for name in family:
            if name not in self._reader.chosen and names.count(name) > 1:
                raise InputError(f"{self._path}: the header names {name} twice: {listed(self._header)}")
        return [self._heading(k) for k in places]

    def numbers(self, family: Sequence[str]) -> Float[np.ndarray, "P k"] | None:
        """Return the columns with these k names; None if the table lacks one of them, or has points in one of them.

        Raises:
            InputError: For values that are not finite numbers, with the point, and for a name that occurs twice.
        """
        if self.headings(family) is None:
            return None
        places = self._places(family)
        cells = [[bare(row[k]) for k in places] for row in self._reader.rows]
        for k, row in enumerate(cells):
            if not all(is_numeric_cell(cell) and math.isfinite(float(cell)) for cell in row):
                raise InputError(f"{self._path}: {','.join(family)} of point {k + 1} is {','.join(row)[:40]!r}")
        return np.array(cells, float)

    def families(self, families: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
        """Return the families all of whose columns the table has; a Note names the columns of incomplete ones.

        A single letter alone, or next to the colours r, g and b, usually means something else and is not named.
        """
        found = [family for family in families if self._places(family) is not None]
        chosen = self._reader.chosen.values()
        names = {head.name for k, head in enumerate(self._header) if k not in chosen}
        names -= {name for family in found for name in family} | (COLOURS | {"a"} if names >= COLOURS else set())
        for family in families:
            there = [name for name in family if name in names]
            if family in found or len(there) == len(family) or len("".join(there)) < 2:
                continue
            names.difference_update(there)
            lacking = ", ".join(name for name in family if name not in there)
            what = f"columns {', '.join(there)} are" if there[1:] else f"column {there[0]} is"
            self._note(f"{what} not read, as there is no {lacking}")
        return found

    def name_ignored(self, family: Sequence[str], found: Sequence[tuple[str, ...]]) -> None:
        """Report the families among those found that are ignored because another one is read."""
        if others := " and ".join(" ".join(each) for each in found if each != family):
            self._note(f"{' '.join(family)} are read, and {others} ignored")

    def _note(self, text: str) -> None:
        warnings.warn(f"{self._path}: {text}", Note, stacklevel=5)

    def _places(self, family: Sequence[str]) -> list[int] | None:
        names = [head.name for head in self._header]
        chosen = self._reader.chosen
        places = [chosen.get(name, names.index(name) if name in names else None) for name in family]
        if any(name not in chosen and place in chosen.values() for name, place in zip(family, places, strict=True)):
            return None
        if self._reader.columns is None or None in places or not set(places).isdisjoint(self._reader.columns.xyz):
            return None
        return places

    def _heading(self, place: int) -> Heading:
        return self._header[place] if self._header else Heading("", "", None)
