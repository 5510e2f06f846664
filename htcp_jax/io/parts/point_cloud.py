"""Point clouds and tables of points from files.

A reader returns points, or raises InputError with one line. It accepts regular files of at most 2 GiB, runs no code
from a file (no pickles), and follows no reference to another file (textures, materials). What a file states about its
geometry is used or refused, or a Note names it. Parsers that are not written in Python run in their own process, see
`scan`.
"""

import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.errors import InputError, Note
from htcp_jax.io.parts.columns import PER_METRE, TablePoints
from htcp_jax.io.parts.obj import read_obj
from htcp_jax.io.parts.ply import read_ply
from htcp_jax.io.parts.scan import OF_ONE_UNIT, PARTS, SCANS, read_part, read_scan
from htcp_jax.io.parts.stl import read_stl
from htcp_jax.io.parts.table import read_npy, read_table
from htcp_jax.model import arrays
from htcp_jax.system import known_ending, note_missing_line_end, read_bytes, read_tail

TEXT = (".xyz", ".csv", ".txt")
TABLES = (*TEXT, ".npy")
MESHES = (".ply", ".stl", ".obj", *PARTS)
CLOUDS = (*TABLES, *SCANS, *MESHES)
AT_ORIGIN = 10  # number of points at 0 0 0 from which on they may be places where a scanner measured nothing


class Geometry(NamedTuple):
    """Content of a file [m]: P points without triangles, or F triangles with their P corners."""

    points: Float[np.ndarray, "P 3"]
    triangles: Float[np.ndarray, "F 3 3"]


def load_geometry(path: str | Path, unit: str | None = None) -> Geometry:
    """Read the points of a cloud file, or the triangles of a mesh [m].

    Formats of clouds: .xyz .csv .txt .npy .pcd .e57 .las .laz, and .ply or .obj without faces. Formats of meshes: .stl
    .obj .ply .step .stp. Points of a cloud with a NaN coordinate, and those that the file marks as invalid or withheld,
    are ignored; a Note contains their number.

    Args:
        path: The file.
        unit: Unit of its coordinates, a key of `columns.PER_METRE`; None: m, or the unit that the file states.

    Raises:
        InputError: For a file that cannot be read, for infinite points, for fewer than 4 points in a cloud, and for a
            unit of a file that states its own.
    """
    path = Path(path)
    ending = known_ending(path, CLOUDS)
    _check_unit(path, unit)
    if ending in MESHES:
        found = _read_mesh(path, ending)
        if unit is not None:
            found = Geometry(found.points / PER_METRE[unit], found.triangles / PER_METRE[unit])
    else:
        found = Geometry(_read_table_or_scan(path, ending, unit).xyz, np.empty((0, 3, 3)))
    if not len(found.triangles):
        found = found._replace(points=found.points[_measured(path, found.points)])
    arrays.check_points(found.points, str(path), at_least=1 if len(found.triangles) else 4)
    if ending in TEXT:
        note_missing_line_end(path, read_tail(path))
    return found


def read_points(path: str | Path, unit: str | None = None) -> TablePoints:
    """Read the points [m] of a cloud, and their normals if the file has any.

    Formats: .xyz .csv .txt .npy .pcd .e57 .las .laz. Points with a NaN coordinate are ignored, with a Note.

    Args:
        path: The file.
        unit: Unit of its coordinates, see `load_geometry`.

    Raises:
        InputError: For a file that cannot be read. Values and number of points are checked by `load_geometry` only.
    """
    path = Path(path)
    _check_unit(path, unit)
    found = _read_table_or_scan(path, known_ending(path, (*TABLES, *SCANS)), unit)
    measured = _measured(path, found.xyz)
    return TablePoints(found.xyz[measured], None if found.normals is None else found.normals[measured])


def _check_unit(path: Path, unit: str | None) -> None:
    if unit is not None and unit not in PER_METRE:
        raise InputError(f"{path}: the unit is {unit!r}; valid: {', '.join(PER_METRE)}")
    ending = path.suffix.lower()
    if (ending in PARTS and unit is not None) or (ending in OF_ONE_UNIT and unit not in (None, "m")):
        why = "states its own unit" if ending in PARTS else "is in metres"
        raise InputError(f"{path}: the unit is {unit}, but a {ending} file {why}; omit the key")


def _read_table_or_scan(path: Path, ending: str, unit: str | None) -> TablePoints:
    if ending in TEXT:
        return read_table(path, unit)
    found = read_npy(path) if ending == ".npy" else read_scan(path, ending)
    return found if unit is None else found._replace(xyz=found.xyz / PER_METRE[unit])


def _measured(path: Path, points: Float[np.ndarray, "P 3"]) -> Bool[np.ndarray, "P"]:
    """Return False for points with a NaN coordinate, where a scanner measured nothing.

    Notes count them, and points at the origin, which some scanners write instead.

    Raises:
        InputError: If fewer than 4 points remain.
    """
    is_nan = np.isnan(points).any(axis=1)
    if is_nan.any() and len(points) - is_nan.sum() < 4:
        what = f"{len(points) - is_nan.sum()} points, at least 4 are needed; {is_nan.sum()} of {len(points)} are NaN"
        raise InputError(f"{path}: {what}")
    if is_nan.any():
        warnings.warn(f"{path}: {is_nan.sum()} of {len(points)} points are NaN and are ignored", Note, stacklevel=3)
    if (at_origin := int((points == 0.0).all(axis=1).sum())) >= AT_ORIGIN:
        text = f"{at_origin} of {len(points)} points are 0 0 0; delete them if the scanner measured nothing there"
        warnings.warn(f"{path}: {text}", Note, stacklevel=3)
    return ~is_nan


def _read_mesh(path: Path, ending: str) -> Geometry:
    vertices, triangles = _geometry(path, ending)
    corners = triangles.reshape(-1, 3)
    if not np.isfinite(corners).all() or np.abs(corners).max(initial=0.0) > arrays.LARGEST_COORDINATE:
        raise InputError(f"{path}: a vertex of the mesh is NaN, infinite or too far from the origin")
    return Geometry(corners if len(corners) else vertices, triangles)


def _geometry(path: Path, ending: str) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "F 3 3"]]:
    """Read all vertices and triangles of a mesh file."""
    if ending in PARTS:
        triangles = read_part(path, ending)
    elif ending == ".stl":
        triangles = read_stl(path, read_bytes(path))
    else:
        return (read_ply if ending == ".ply" else read_obj)(path, read_bytes(path))
    return triangles.reshape(-1, 3), triangles
