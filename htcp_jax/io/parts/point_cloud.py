"""Point clouds and tables of points from files.

A reader returns points, or raises InputError with one line. It accepts regular files of at most 2 GiB, runs no code
from a file (no pickles), and follows no reference to another file (textures, materials). Parsers that are not written
in Python run in their own process, see `scan`.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io.files import known_ending, read_bytes
from htcp_jax.io.parts.columns import TablePoints
from htcp_jax.io.parts.obj import read_obj
from htcp_jax.io.parts.ply import read_ply
from htcp_jax.io.parts.scan import PARTS, SCANS, read_part, read_scan
from htcp_jax.io.parts.stl import read_stl
from htcp_jax.io.parts.table import read_npy, read_table
from htcp_jax.model import arrays, mesh_points

TEXT = (".xyz", ".csv", ".txt")
TABLES = (*TEXT, ".npy")
MESHES = (".ply", ".stl", ".obj", *PARTS)
CLOUDS = (*TABLES, *SCANS, *MESHES)


class Geometry(NamedTuple):
    """Content of a file [m]: P points without triangles, or F triangles with their P corners."""

    points: Float[np.ndarray, "P 3"]
    triangles: Float[np.ndarray, "F 3 3"]


def load_geometry(path: str | Path) -> Geometry:
    """Read the points of a cloud file, or the triangles of a mesh [m].

    Formats of clouds: .xyz .csv .txt .npy .pcd .e57 .las .laz, and .ply or .obj without faces. Formats of meshes: .stl
    .obj .ply .step .stp.

    Raises:
        InputError: For a file that cannot be read, for NaN and infinite points, and for fewer than 4 points in a cloud.
    """
    path = Path(path)
    ending = known_ending(path, CLOUDS)
    if ending in MESHES:
        found = _read_mesh(path, ending)
    else:
        found = Geometry(read_points(path).xyz, np.empty((0, 3, 3)))
    arrays.check_points(found.points, str(path), at_least=1 if len(found.triangles) else 4)
    return found


def load_cloud(path: str | Path, *, spacing: float | None = None) -> Float[np.ndarray, "P 3"]:
    """Read the points [m] of a cloud file, or cover the mesh in a file with points, see `mesh_points.cover_mesh`.

    Args:
        path: The file.
        spacing: Widest gap between the points on a mesh [m]; None: see `mesh_points.cover_mesh`.

    Raises:
        InputError: As `load_geometry` does.
    """
    found = load_geometry(path)
    return mesh_points.cover_mesh(found.triangles, str(path), spacing).points if len(found.triangles) else found.points


def read_points(path: str | Path) -> TablePoints:
    """Read the points [m] of a table, such as a tool path, or of a scan, and their normals if the file has any.

    Formats: .xyz .csv .txt .npy .pcd .e57 .las .laz.

    Raises:
        InputError: For a file that cannot be read. Values and number of points are checked by `load_cloud` only.
    """
    path = Path(path)
    ending = known_ending(path, (*TABLES, *SCANS))
    if ending in SCANS:
        return read_scan(path, ending)
    return read_npy(path) if ending == ".npy" else read_table(path)


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
