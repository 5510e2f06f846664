"""Columns of a table with the coordinates of points, and their normals."""

import re
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError, Note

NORMALS = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"), ("i", "j", "k"))  # i, j, k: of tool paths
UNIT = re.compile(r"\[[^\]]*\]|\([^)]*\)")  # x [m], y (mm)
NEARLY_ALL = 0.95
NEARLY_UNIT = 0.01


class TablePoints(NamedTuple):
    """P points, with normals if known."""

    xyz: Float[np.ndarray, "P 3"]  # [m]
    normals: Float[np.ndarray, "P 3"] | None = None  # unit, or 0 where a point has none; None without such columns


class ColumnIndices(NamedTuple):
    """Columns of coordinates and normals in a table of `width` columns, by their indices from 0."""

    width: int
    xyz: tuple[int, ...]
    normals: tuple[int, ...] | None
    named: bool  # by a header; otherwise the normals are a guess that `points` checks

    def points(self, xyz: np.ndarray, normals: np.ndarray | None, source: str) -> TablePoints:
        """Return the points from these columns' numbers; a Note reports a guess.

        Args:
            xyz: Coordinates (P, 3) [m].
            normals: Normals (P, 3), of any length; None without such columns.
            source: The file, for the Note.
        """
        normals = None if normals is None else _normalised(normals, certain=self.named)
        if not self.named and self.width > 3:
            rest = "and the others ignored" if normals is None else "the others as normals"
            text = f"{self.width} columns; the first three are taken as x, y, z, {rest}"
            warnings.warn(f"{source}: {text}", Note, stacklevel=4)
        return TablePoints(xyz, normals)


def header_names(cells: Sequence[str]) -> list[str]:
    """Return a header's cells as plain names."""
    return [cell.strip().strip("\"'").strip().lower() for cell in cells]


def without_units(header: str) -> str:
    """Return a header line without units in brackets."""
    return UNIT.sub("", header)


def columns_of(names: Sequence[str] | None, width: int, source: str) -> ColumnIndices:
    """Find the columns of a table.

    By its header's names if x, y and z are among them, else the first three, and in a table of six columns the last
    three for normals.

    Args:
        names: The header's names; None without a header.
        width: Number of columns.
        source: The file, for messages.

    Raises:
        InputError: If the header names a coordinate twice, or contradicts the table.
    """
    names = [] if names is None else list(names)
    at = {axis: [k for k, name in enumerate(names) if name == axis] for axis in "xyz"}
    if twice := [axis for axis, places in at.items() if len(places) > 1]:
        raise InputError(f"{source}: the header names {twice[0]} twice")
    if all(at.values()) and len(names) == width:
        known = [family for family in NORMALS if all(names.count(name) == 1 for name in family)]
        normals = tuple(names.index(name) for name in known[0]) if known else None
        return ColumnIndices(width, tuple(places[0] for places in at.values()), normals, named=True)
    if any(places and places[0] != k for k, places in enumerate(at.values())):
        named = f"{len(names)} columns ({' '.join(names)[:40]}), the rows have {width}"
        raise InputError(f"{source}: the header names {named}; name x, y and z, or put them first")
    return ColumnIndices(width, (0, 1, 2), (3, 4, 5) if width == 6 else None, named=False)


def _normalised(vectors: np.ndarray, certain: bool) -> Float[np.ndarray, "P 3"] | None:
    """Normalise vectors, 0 for those without a direction; None for a guess unless NEARLY_ALL are unit vectors."""
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.linalg.norm(vectors, axis=1, keepdims=True)
    if not certain and not np.mean(np.abs(length - 1.0) < NEARLY_UNIT) >= NEARLY_ALL:
        return None
    sound = np.isfinite(length) & (length > 1e-6)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=sound)
