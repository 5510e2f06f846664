"""Reader of a path's file: points, normals, tangents and orientations."""

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float, Int

from htcp_jax.errors import InputError, Note
from htcp_jax.io.parts import angles, apt, columns, headings
from htcp_jax.io.parts.path_table import ENDINGS, PathTable
from htcp_jax.io.parts.seams import SeamRows, name_jumps
from htcp_jax.model import ONE_POINT_M, PathFrames
from htcp_jax.system import known_ending

PARALLEL = 0.05  # sine of the smallest angle between the plates of a fillet
GUESSED = ("i", "j", "k")  # read as normals only if they are unit vectors; they may also be indices of cells


class PathPoints(NamedTuple):
    """Points of a path, and the directions in its file."""

    xyz: Float[np.ndarray, "T 3"]  # [m]
    frames: PathFrames
    seams: Sequence[SeamRows] = ()  # the seams in the file
    feeds_m_s: Sequence[float | None] = ()  # feed of each seam; None: unknown; empty: the file has no feeds
    unit: str | None = None  # unit in which an APT source was read; None: see the table's header

    def rows(self, rows: slice | Int[np.ndarray, "n"]) -> "PathPoints":
        """Return some of the points as one seam, in another order or backwards.

        Tangents are in the direction of travel: those that the file gives are reversed if the rows descend.
        """
        indices = np.arange(len(self.xyz))[rows]
        frames = PathFrames(*(None if each is None else each[indices] for each in self.frames))
        if frames.tangents is not None and len(indices) > 1 and indices[1] < indices[0]:
            frames = frames._replace(tangents=-frames.tangents)
        return PathPoints(self.xyz[indices], frames, unit=self.unit)


def read_path_points(
    path: Path,
    chosen: Mapping[str, int | str] = MappingProxyType({}),
    unit: str | None = None,
    maker: angles.Maker | None = None,
) -> PathPoints:
    """Read a path's file: points, and the directions that its header or the caller names.

    If the file has the normals of a fillet's plates, but no normals, these are half way between the plates' normals.

    Args:
        path: The file.
        chosen: The column of each quantity, see `columns.chosen_columns`; empty: the columns that the header names, or
            without a header the first three.
        unit: Unit of the points, a key of `columns.PER_METRE`; None: the header's unit, or m if the header has none.
        maker: The maker whose order and unit the angles have, see `angles.rotations_of`.

    Raises:
        InputError: As `PathTable` and `angles.rotations_of` do, for a normal or tangent whose length is not 1, for a
            quaternion of length 0, and for plates that are parallel.
    """
    if known_ending(path, (*ENDINGS, *apt.ENDINGS, *apt.G_CODE)) not in ENDINGS:
        return _of_apt(path, chosen, unit, maker)
    table = PathTable(path, chosen, unit)
    for seam in table.seams:
        name_jumps(str(path), table.xyz, ONE_POINT_M, seam)
    normals, tangents = (
        None if (names := _family(table, families)) is None else _unit_vectors(table, names, what, path)
        for families, what in ((headings.NORMALS, "normal"), (headings.TANGENTS, "tangent"))
    )
    if normals is None and table.guessed_normals is not None:
        normals = table.guessed_normals
        if len(wrong := np.flatnonzero(~normals.any(axis=1))):
            raise InputError(f"{path}: the normal at point {wrong[0] + 1} has the length 0; it must be 1")
    plates = _plates(table, path)
    if normals is None and plates is not None:
        normals = plates.sum(axis=1)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return PathPoints(table.xyz, PathFrames(normals, tangents, _rotations(table, maker, path), plates), table.seams)


def has_feeds(path: Path) -> bool:
    """Return True for a file whose kind states feeds: an APT source or a CLS file."""
    return path.suffix.lower() in apt.ENDINGS


def _of_apt(path: Path, chosen: Mapping[str, int | str], unit: str | None, maker: angles.Maker | None) -> PathPoints:
    """Return the points of an APT or CLS file.

    Raises:
        InputError: If columns or angles are chosen, which the file does not have.
    """
    found = apt.read_apt(path, unit)
    for key, value in (("workpiece.path_columns", chosen), (angles.KEY, maker)):
        if value:
            raise InputError(f"{path}: {key} is for tables, but the path is an APT source; omit the key")
    return PathPoints(found.xyz, PathFrames(found.normals), found.seams, found.feeds_m_s, found.unit)


def _family(table: PathTable, families: Sequence[tuple[str, ...]]) -> tuple[str, ...] | None:
    """Return the first family of names that a table has; a Note names the others."""
    if not (found := table.families(families)):
        return None
    table.name_ignored(found[0], found)
    return found[0]


def _rotations(table: PathTable, maker: angles.Maker | None, path: Path) -> Float[np.ndarray, "T 3 3"] | None:
    """Return the orientations of quaternions or angles; None if the table has neither."""
    found = table.families((*headings.QUATERNIONS, *angles.FAMILIES))
    names = found[0] if found else None
    if names not in headings.QUATERNIONS:
        return angles.rotations_of(table, found, maker, str(path))
    table.name_ignored(names, found)
    if maker is not None:
        raise InputError(f"{path}: {angles.KEY} is {maker}, but the path has quaternions; omit the key")
    quaternions = table.numbers(names)
    if len(wrong := np.flatnonzero(~(np.linalg.norm(quaternions, axis=1) > 1e-9))):
        raise InputError(f"{path}: the quaternion at point {wrong[0] + 1} has the length 0")
    return scipy.spatial.transform.Rotation.from_quat(quaternions, scalar_first=True).as_matrix()


def _plates(table: PathTable, path: Path) -> Float[np.ndarray, "T 2 3"] | None:
    """Return the normals of both plates of a fillet; None if the table has none.

    Raises:
        InputError: For a normal whose length is not 1, and for plates that are parallel.
    """
    if (names := _family(table, headings.PLATES)) is None:
        return None
    both = [_unit_vectors(table, own, f"normal of plate {k}", path) for k, own in ((1, names[:3]), (2, names[3:]))]
    if len(flat := np.flatnonzero(np.linalg.norm(np.cross(*both), axis=1) < PARALLEL)):
        raise InputError(f"{path}: the plates are parallel at point {flat[0] + 1}; their normals must differ")
    return np.stack(both, axis=1)


def _unit_vectors(table: PathTable, names: tuple[str, ...], what: str, path: Path) -> np.ndarray | None:
    values = table.numbers(names)
    length = np.linalg.norm(values, axis=1)
    if len(wrong := np.flatnonzero(~(np.abs(length - 1.0) < columns.NEARLY_UNIT))):
        off = f"at point {wrong[0] + 1} has the length {length[wrong[0]]:.4g}"
        if names != GUESSED:
            raise InputError(f"{path}: the {what} {off}; it must be 1")
        warnings.warn(
            f"{path}: columns i, j, k are ignored: as a {what}, the vector {off} instead of 1", Note, stacklevel=4
        )
        return None
    return values / length[:, None]
