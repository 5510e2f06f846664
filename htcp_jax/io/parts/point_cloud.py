"""Point clouds and tables of points from files.

A reader returns points, or raises InputError with one line. It accepts regular files of at most 2 GiB, runs no code
from a file (no pickles), and follows no reference to another file (textures, materials). Parsers that are not written
in Python run in their own process, see `scan`.
"""

import io
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io.files import known_ending, one_line, quiet, read_bytes
from htcp_jax.io.parts.columns import TablePoints
from htcp_jax.io.parts.scan import PARTS, SCANS, read_part, read_scan
from htcp_jax.io.parts.table import read_npy, read_table
from htcp_jax.model import arrays, mesh_points

TEXT = (".xyz", ".csv", ".txt")
TABLES = (*TEXT, ".npy")
MESHES = (".ply", ".stl", ".obj", *PARTS)
CLOUDS = (*TABLES, *SCANS, *MESHES)

# An OBJ face with relative vertex indices. trimesh uses other vertices without an error.
RELATIVE_FACE = re.compile(rb"^f\b[^\n]*[ \t](?:-\d|0+(?:[/ \t\r]|$))", re.MULTILINE)
PLY_LIST_FIRST = re.compile(rb"^element[ \t]+face[ \t]+\d+[ \t\r]*\n(comment[^\n]*\n)*property[ \t]+list", re.MULTILINE)
PLY_ELEMENT = re.compile(rb"^element[ \t]+(vertex|face)[ \t]+(\d{1,12})[ \t\r]*$", re.MULTILINE)


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
    """Read all vertices and triangles of a mesh file; the parser gets the file's bytes and cannot open other files."""
    if ending in PARTS:
        triangles = read_part(path, ending)
        return triangles.reshape(-1, 3), triangles
    import trimesh  # a slow import that only meshes need

    data = read_bytes(path)
    binary_stl = ending == ".stl" and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")
    if ending == ".obj" or (ending == ".stl" and not binary_stl):
        data = data.decode("utf-8", "replace").encode()  # trimesh would guess at the encoding, slowly
    if ending == ".obj" and RELATIVE_FACE.search(data.replace(b"\\\n", b"")):
        raise InputError(f"{path}: a face has a vertex number below 1; number the vertices from 1")
    try:
        with quiet():
            stream = io.BytesIO(data)
            scene = trimesh.load_scene(stream, file_type=ending[1:], process=False, skip_materials=True)
            meshes = [part for part in scene.geometry.values() if isinstance(part, trimesh.Trimesh)]
            clouds = [part for part in scene.geometry.values() if isinstance(part, trimesh.PointCloud)]
            if any(len(mesh.faces) and mesh.faces.min() < 0 for mesh in meshes):
                raise IndexError("a face with a negative vertex number")
            vertices = [np.asarray(part.vertices, np.float64).reshape(-1, 3) for part in meshes + clouds]
            triangles = [np.asarray(mesh.triangles, np.float64).reshape(-1, 3, 3) for mesh in meshes]
    except Exception as error:  # a third-party parser on untrusted bytes: whatever it raises, the file is bad
        raise InputError(f"{path}: not a readable {ending} file ({one_line(error)})") from None
    geometry = np.concatenate([np.empty((0, 3)), *vertices]), np.concatenate([np.empty((0, 3, 3)), *triangles])
    if ending == ".ply":
        raw = [part.metadata.get("_ply_raw", {}).get("face", {}).get("data") for part in meshes]
        _check_ply_is_complete(path, data, *map(len, geometry), raw)
    return geometry


def _check_ply_is_complete(path: Path, data: bytes, vertices: int, triangles: int, raw: list) -> None:
    """Check that a PLY file is complete, as trimesh accepts truncated files. `raw` are the faces that trimesh has read.

    Raises:
        InputError: For a truncated text, and for a face with fewer corners than declared.
    """
    promised = dict(PLY_ELEMENT.findall(data.partition(b"end_header")[0]))
    if vertices != int(promised.get(b"vertex", vertices)) or triangles < int(promised.get(b"face", 0)):
        raise InputError(f"{path}: damaged: fewer vertices or faces than its header declares")
    for faces in raw:  # of a binary file: numbers of corners and corners, a column for each list
        for name in getattr(getattr(faces, "dtype", None), "names", None) or ():
            if faces[name].dtype.names == ("f0", "f1"):
                _check_corners(path, faces[name]["f0"], np.full(len(faces), faces[name]["f1"].shape[1]))
    header, _, body = data.partition(b"end_header")
    if b"format ascii" in header and PLY_LIST_FIRST.search(header):
        before = header[: PLY_LIST_FIRST.search(header).start()]
        first = sum(int(count) for count in re.findall(rb"^element[ \t]+\w+[ \t]+(\d+)", before, re.MULTILINE))
        rows = [row for line in body.splitlines() if (row := line.split())][first : first + int(promised[b"face"])]
        _check_corners(path, np.array([float(row[0]) for row in rows]), np.array([len(row) - 1 for row in rows]))


def _check_corners(path: Path, promised: np.ndarray, there: np.ndarray) -> None:
    if (bad := np.flatnonzero(promised > there)).size:
        k = bad[0]
        raise InputError(f"{path}: damaged: face {k + 1} has {there[k]} corners instead of {promised[k]:.0f}")
