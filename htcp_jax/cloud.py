"""Point clouds and tables of points from files.

A reader returns points or raises InputError with one line. It takes regular files of at most 2 GB, runs no
code from a file (no pickles), and follows no reference from one file to another (textures, materials).
"""

import contextlib
import io
import logging
import re
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.mesh_points import cover

TEXT = (".xyz", ".csv", ".txt")
MESHES = (".ply", ".stl", ".obj")
CLOUDS = (*TEXT, ".npy", *MESHES)

NPY_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
# An OBJ face that counts its vertices back from its own line. trimesh takes other vertices and says nothing.
RELATIVE_FACE = re.compile(rb"^f\b[^\n]*[ \t](?:-\d|0+(?:[/ \t\r]|$))", re.MULTILINE)
PLY_ELEMENT = re.compile(rb"^element[ \t]+(vertex|face)[ \t]+(\d{1,12})[ \t\r]*$", re.MULTILINE)
LARGEST_FILE = 2 * 2**30
LARGEST_COORDINATE = 1e9  # [m]
METRES_AT_MOST = 20.0  # no part inside a robot's reach is larger; one given in millimetres is


class Geometry(NamedTuple):
    """What a file holds: P points and no triangles, or F triangles with their P corners [m]."""

    points: Float[np.ndarray, "P 3"]
    triangles: Float[np.ndarray, "F 3 3"]


def load_geometry(path: str | Path) -> Geometry:
    """The points of a cloud file (.xyz .csv .txt .npy, a .ply or .obj without faces), or the triangles of a mesh
    (.stl .obj .ply) [m]. Raises InputError for a file that cannot be read, for NaN and infinite points, and for fewer
    than 4 points of a cloud. Warns (UserWarning) when the extent says millimetres."""
    path = Path(path)
    ending = known_ending(path, CLOUDS)
    if ending in TEXT:
        found = Geometry(read_table(path), np.empty((0, 3, 3)))
    elif ending == ".npy":
        found = Geometry(_read_npy(path), np.empty((0, 3, 3)))
    else:
        found = _read_mesh(path, ending)
    check_points(found.points, str(path), at_least=1 if len(found.triangles) else 4)
    warn_if_millimetres(found.points, str(path))
    return found


def load_cloud(
    path: str | Path, *, spacing: float | None = None, thinnest_m: float = np.inf
) -> Float[np.ndarray, "P 3"]:
    """Points [m] of a cloud file, as they are, or points that cover a mesh, see `mesh_points.cover`. Raises InputError
    and warns as `load_geometry` does."""
    found = load_geometry(path)
    return cover(found.triangles, str(path), spacing, thinnest_m).points if len(found.triangles) else found.points


def read_table(path: Path) -> Float[np.ndarray, "P 3"]:
    """Rows of three numbers from a text file, separated by commas, semicolons or blanks.

    What follows a # is a comment, and the first other line may be a header without numbers. Raises InputError
    naming the line.
    """
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file of points (it is not UTF-8)") from None
    rows, header = [], False
    for number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), start=1):
        content = line.split("#", 1)[0].strip()
        if not content:
            continue
        cells = _cells(content)
        if not rows and not header and not any(_is_number(cell) for cell in cells):
            header = True
            continue
        rows.append(_row(path, number, cells))
    return np.array(rows, dtype=np.float64).reshape(-1, 3)


def check_points(points: Float[np.ndarray, "P 3"], source: str, at_least: int) -> None:
    """Raise InputError unless there are `at_least` points, all finite and none absurdly far."""
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        raise InputError(f"{source}: row {bad[0] + 1} holds NaN or an infinite number ({bad.size} such rows)")
    if len(points) < at_least:
        raise InputError(f"{source}: {len(points)} points, at least {at_least} are needed")
    if np.abs(points).max() > LARGEST_COORDINATE:
        raise InputError(f"{source}: a coordinate of {np.abs(points).max():.3g} m; coordinates are metres")


def warn_if_millimetres(points: Float[np.ndarray, "P 3"], source: str) -> None:
    """UserWarning when the points extend over more than 20 m."""
    extent = np.ptp(points, axis=0).max()
    if extent > METRES_AT_MOST:
        text = f"the points extend over {extent:.4g} m; are they in millimetres? Metres are expected"
        warnings.warn(f"{source}: {text}", UserWarning, stacklevel=3)


def known_ending(path: Path, endings: tuple[str, ...]) -> str:
    """The file's ending in lower case; InputError when it is not among `endings`."""
    ending = path.suffix.lower()
    if ending not in endings:
        raise InputError(f"{path}: unknown ending {ending!r}; valid are {' '.join(endings)}")
    return ending


def read_bytes(path: Path) -> bytes:
    """The bytes of a regular file. A pipe or a device would never end, so those are refused."""
    try:
        if not path.exists():
            raise InputError(f"{path}: no such file")
        if not path.is_file():
            raise InputError(f"{path}: not a regular file")
        if path.stat().st_size > LARGEST_FILE:
            raise InputError(f"{path}: {path.stat().st_size} bytes; the largest file read is 2 GB")
        return path.read_bytes()
    except (OSError, MemoryError) as error:
        raise InputError(f"{path}: cannot be read ({one_line(error)})") from None


def one_line(error: BaseException) -> str:
    """An exception in one short line, without the control characters that a damaged file brings into it."""
    words = "".join(letter if letter.isprintable() else " " for letter in str(error)[:120]).split()
    return " ".join([f"{type(error).__name__}:", *words]) if words else type(error).__name__


def _cells(line: str) -> list[str]:
    for separator in (";", ","):
        if separator in line:
            return line.split(separator)
    return line.split()


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell  # Python reads 1_0 as ten; no table means that


def _row(path: Path, number: int, cells: list[str]) -> list[float]:
    if len(cells) != 3:
        raise InputError(f"{path}: line {number} has {len(cells)} columns, 3 are needed (x y z)")
    for cell in cells:
        if not _is_number(cell):
            raise InputError(f"{path}: line {number}: {cell.strip()[:30]!r} is not a number")
    row = [float(cell) for cell in cells]
    if not np.isfinite(row).all():
        raise InputError(f"{path}: line {number} holds NaN or an infinite number")
    return row


def _read_npy(path: Path) -> Float[np.ndarray, "P 3"]:
    data = read_bytes(path)
    # numpy's reader believes the shape in the header and asks for that much memory before it looks at the
    # data. Read the header alone, then take the bytes that are there. Object arrays (pickles) are refused.
    try:
        with _quiet():
            stream = io.BytesIO(data)
            read_header = NPY_HEADERS[np.lib.format.read_magic(stream)]
            shape, by_column, dtype = read_header(stream)
    except Exception as error:  # a foreign parser on foreign bytes: whatever it raises, the file is bad
        raise InputError(f"{path}: not a .npy array ({one_line(error)})") from None
    if dtype.kind not in "fiu":
        raise InputError(f"{path}: an array of {dtype.name}, numbers are needed")
    if len(shape) != 2 or shape[1] != 3:
        raise InputError(f"{path}: an array of shape {shape}, (points, 3) is needed")
    if shape[0] < 0 or len(data) - stream.tell() != shape[0] * 3 * dtype.itemsize:
        raise InputError(f"{path}: damaged, its length is not that of its header's shape {shape}")
    array = np.frombuffer(data, dtype, offset=stream.tell()).reshape(shape, order="F" if by_column else "C")
    return np.ascontiguousarray(array, dtype=np.float64)


def _read_mesh(path: Path, ending: str) -> Geometry:
    vertices, triangles = _geometry(path, ending)
    corners = triangles.reshape(-1, 3)
    if not np.isfinite(corners).all() or np.abs(corners).max(initial=0.0) > LARGEST_COORDINATE:
        raise InputError(f"{path}: a vertex of the mesh is NaN, infinite or absurdly far away")
    return Geometry(corners if len(corners) else vertices, triangles)


def _geometry(path: Path, ending: str) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "F 3 3"]]:
    """All vertices and all triangles of a mesh file, read from memory so that no other file is opened."""
    import trimesh  # here, because only meshes need it, and it takes a while to load

    data = read_bytes(path)
    binary_stl = ending == ".stl" and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")
    if ending == ".obj" or (ending == ".stl" and not binary_stl):
        data = data.decode("utf-8", "replace").encode()  # trimesh would guess at the encoding, slowly
    if ending == ".obj" and RELATIVE_FACE.search(data.replace(b"\\\n", b"")):
        raise InputError(f"{path}: a face with a negative vertex number or 0; number the vertices from 1")
    try:
        with _quiet():
            stream = io.BytesIO(data)
            scene = trimesh.load_scene(stream, file_type=ending[1:], process=False, skip_materials=True)
            meshes = [part for part in scene.geometry.values() if isinstance(part, trimesh.Trimesh)]
            clouds = [part for part in scene.geometry.values() if isinstance(part, trimesh.PointCloud)]
            if any(len(mesh.faces) and mesh.faces.min() < 0 for mesh in meshes):
                raise IndexError("a face with a negative vertex number")
            vertices = [np.asarray(part.vertices, np.float64).reshape(-1, 3) for part in meshes + clouds]
            triangles = [np.asarray(mesh.triangles, np.float64).reshape(-1, 3, 3) for mesh in meshes]
    except Exception as error:  # a foreign parser on foreign bytes: whatever it raises, the file is bad
        raise InputError(f"{path}: not a readable {ending} file ({one_line(error)})") from None
    geometry = np.concatenate([np.empty((0, 3)), *vertices]), np.concatenate([np.empty((0, 3, 3)), *triangles])
    if ending == ".ply":
        _check_ply_is_whole(path, data, *map(len, geometry))
    return geometry


def _check_ply_is_whole(path: Path, data: bytes, vertices: int, triangles: int) -> None:
    """trimesh takes what there is of a text that was cut off, and says nothing."""
    promised = dict(PLY_ELEMENT.findall(data.partition(b"end_header")[0]))
    if vertices != int(promised.get(b"vertex", vertices)) or triangles < int(promised.get(b"face", 0)):
        raise InputError(f"{path}: damaged, it holds fewer vertices or faces than its header says")


@contextlib.contextmanager
def _quiet():
    """Silence a foreign parser: its warnings, and trimesh's logger, which prints whole tracebacks."""
    logger = logging.getLogger("trimesh")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)  # of the loggers below it too
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
