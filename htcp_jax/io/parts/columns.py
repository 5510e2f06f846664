"""Columns of a table: coordinates with their unit, and directions, found by the header's names or by position."""

import warnings
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError, Note
from htcp_jax.io.parts.headings import (
    COORDINATE_NAMES,
    DIRECTION_NAMES,
    NORMALS,
    XYZ,
    Heading,
    coordinates_in,
    heading,
    listed,
)
from htcp_jax.io.parts.lengths import PER_METRE

KEY = "workpiece.path_columns"
CHOOSE = f"; for a path, {KEY} chooses columns"
REMEDY = f"name x, y and z in the header{CHOOSE}"
NEARLY_ALL = 0.95
NEARLY_UNIT = 0.01


class TablePoints(NamedTuple):
    """P points, with normals if the table has any."""

    xyz: Float[np.ndarray, "P 3"]  # [m]
    normals: Float[np.ndarray, "P 3"] | None = None  # unit, or 0 for a point without one; None: no such columns


class ColumnIndices(NamedTuple):
    """Indices, from 0, of the columns of coordinates and normals in a table of `width` columns."""

    width: int
    xyz: tuple[int, ...]
    normals: tuple[int, ...] | None
    named: bool  # True if a header or the caller names the columns; otherwise `points` checks the guessed normals
    unit: str | None = None  # unit of the coordinates in the header; None if the header contains none
    numbered: bool = False  # True if the first column counts the rows and is ignored

    def points(self, xyz: np.ndarray, normals: np.ndarray | None, source: str, unit: str | None = None) -> TablePoints:
        """Return points [m] and normals from the numbers in these columns; a Note reports guessed normals.

        Args:
            xyz: Coordinates (P, 3), in `unit`.
            normals: Normals (P, 3), of any length; None without such columns.
            source: The file, for the Note.
            unit: A key of PER_METRE; None: the header's unit, or m if the header has none.

        Raises:
            InputError: If the header's unit is not a key of PER_METRE.
        """
        unit = unit or self.unit or "m"
        if unit not in PER_METRE:
            valid = f"{', '.join(PER_METRE)}, or workpiece.path_unit for a path"
            raise InputError(f"{source}: the unit in the header is {unit!r}; valid: {valid}")
        normals = None if normals is None else _normalised(normals, certain=self.named)
        if not self.named and self.width > 3:
            rest = "and the others ignored" if normals is None else "the others as normals"
            text = f"{self.width} columns; the first three are taken as x, y, z, {rest}"
            if self.numbered:
                rest = f", {rest}" if self.width > 4 else ""
                text = f"{self.width} columns; the first counts the rows, the next three are taken as x, y, z{rest}"
            warnings.warn(f"{source}: {text}", Note, stacklevel=4)
        return TablePoints(xyz / PER_METRE[unit], normals)


def columns_of(
    header: Sequence[Heading] | None, width: int, source: str, *, numbered: bool = False, needs_names: bool = False
) -> ColumnIndices:
    """Find the columns of a table.

    A header decides: it must name one family of `headings.COORDINATES`, or begin with x, y, z. Without a header the
    first three columns are coordinates, and the last three of a table with six columns are normals. A first column that
    counts the rows is skipped.

    Args:
        header: The header; None if the table has none.
        width: Number of columns.
        source: The file, for messages.
        numbered: True if the first column counts the rows.
        needs_names: True to refuse repeated names of tangents and quaternions, too.

    Raises:
        InputError: If the header repeats a name, names two sets of coordinates or none, or contradicts the table.
    """
    header, first = list(header or ()), int(numbered)
    names = [head.name for head in header]
    _refuse_repeated(header, width, source, needs_names)
    if len(names) == width:
        xyz = _coordinates(header, source)
        normals = next((family for family in NORMALS if all(name in names for name in family)), None)
        indices = None if normals is None else tuple(names.index(name) for name in normals)
        return ColumnIndices(width, xyz, indices, True, unit_of(header, xyz, source))
    if header and (numbered or tuple(names[:3]) != XYZ):
        named = f"{len(names)} columns ({' '.join(names)[:40]}), the rows have {width}"
        raise InputError(f"{source}: the header names {named}; name x, y and z, or put them first{CHOOSE}")
    xyz = tuple(range(first, first + 3))
    guess = tuple(range(first + 3, first + 6)) if width - first == 6 else None
    return ColumnIndices(width, xyz, guess, False, unit_of(header, xyz, source), numbered)


def _refuse_repeated(header: Sequence[Heading], width: int, source: str, needs_names: bool) -> None:
    """Raise InputError if the header names a column twice that it must identify."""
    names = [head.name for head in header]
    known = COORDINATE_NAMES | (DIRECTION_NAMES if needs_names else {name for family in NORMALS for name in family})
    for name in filter(known.__contains__, names) if len(names) == width else XYZ:
        if names.count(name) > 1:
            raise InputError(f"{source}: the header names {name} twice: {listed(header)}")


def _coordinates(header: Sequence[Heading], source: str) -> tuple[int, ...]:
    """Return the indices of the columns that a header with a name for each column names as coordinates."""
    names = [head.name for head in header]
    found = coordinates_in(names)
    if len(found) > 1:
        sets = " and ".join(" ".join(family) for family in found)
        raise InputError(f"{source}: the header names {sets}: {listed(header)}; for a path, choose one with {KEY}")
    if not found:
        lacking = [axis for axis in XYZ if axis not in names]
        what = "none of x, y, z" if len(lacking) == len(XYZ) else f"no {', '.join(lacking)}"
        raise InputError(f"{source}: the header names {what}: {listed(header)}; {REMEDY}")
    return tuple(names.index(name) for name in found[0])


def chosen_columns(
    chosen: Mapping[str, int | str], header: Sequence[Heading] | None, width: int, source: str
) -> dict[str, int]:
    """Return the indices, from 0, of the columns that the caller chooses.

    Args:
        chosen: The column of each quantity x, y, z, nx, ...: its name in the header, or its number from 1.
        header: The header; None if the table has none.
        width: Number of columns.
        source: The file, for messages.

    Raises:
        InputError: For a column that is missing or ambiguous, and for one that is chosen twice.
    """
    header = list(header or ())
    there = f"it has {width} columns" + (f": {listed(header)}" if header else ", without a header")
    found: dict[str, int] = {}
    for role, name in chosen.items():
        where = f"{source}: {KEY}.{role} is {name!r}"
        if isinstance(name, int):
            if not 1 <= name <= width:
                raise InputError(f"{where}: no such column; {there}")
            k = name - 1
        else:
            if header and len(header) != width:
                raise InputError(
                    f"{where}, but the header has {len(header)} names: {listed(header)}; the rows have {width}"
                )
            wanted = heading(name)
            same = [k for k, head in enumerate(header) if wanted.text == head.text]
            same = same or [k for k, head in enumerate(header) if wanted.name == head.name]
            if len(same) != 1:
                what = f"{len(same)} columns have this name" if same else "no such column"
                raise InputError(f"{where}: {what}; {there}")
            (k,) = same
        if k in found.values():
            other = next(other for other, place in found.items() if place == k)
            raise InputError(f"{where}: column {k + 1} is already used as {other}; {there}")
        found[role] = k
    return found


def unit_of(header: Sequence[Heading], xyz: Sequence[int], source: str) -> str | None:
    """Return the unit of the coordinates in a header; None if the header contains none.

    Raises:
        InputError: If the coordinates have different units.
    """
    units = list(dict.fromkeys(head.unit for head in (header[k] for k in xyz if k < len(header)) if head.unit))
    if len(units) > 1:
        raise InputError(f"{source}: coordinates in {' and '.join(units)}: {listed(header)}")
    return units[0] if units else None


def _normalised(vectors: np.ndarray, certain: bool) -> Float[np.ndarray, "P 3"] | None:
    """Normalise vectors; vectors without a direction become 0.

    None if the columns are only a guess (`certain` is False) and a share of less than NEARLY_ALL are unit vectors.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.linalg.norm(vectors, axis=1, keepdims=True)
    if not certain and not np.mean(np.abs(length - 1.0) < NEARLY_UNIT) >= NEARLY_ALL:
        return None
    sound = np.isfinite(length) & (length > 1e-6)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=sound)
