"""Reading of Wavefront OBJ meshes and clouds. Other readers drop elements that hold geometry without a message."""

import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.errors import InputError, Note
from htcp_jax.io.parts import polygons
from htcp_jax.system import note_missing_line_end

FACES, VERTEX, MATERIAL = ("f", "fo"), "v", "usemtl"
FREE_FORM = {"curv", "curv2", "surf", "bzp", "bsp", "cdc", "cdp", "res", "call"}
IGNORED = {"l": "lines", "p": "points"}  # elements without a surface
HARMLESS = {  # names, colours, normals, rendering; and the parts of free-form elements
    *("vt", "vn", "vp", "o", "g", "s", "mg", "usemap", "mtllib", "maplib", "shadow_obj", "trace_obj", "csh", "lod"),
    *("bevel", "c_interp", "d_interp", "cstype", "deg", "bmat", "step", "parm", "trim", "hole", "scrv", "sp", "end"),
    *("con", "ctech", "stech"),
}
MOST_DIGITS = 12
CORNER = re.compile(rf"([+-]?\d{{1,{MOST_DIGITS}}})(?:/[+-]?\d*){{0,2}}")


class _FaceLine(NamedTuple):
    number: int  # of the line
    words: list[str]  # its corners
    before: int  # number of vertices before the line
    material: int


class _Faces(NamedTuple):
    """Faces, in the file's order."""

    corners: Int[np.ndarray, "C"]  # indices of vertices, from 0, of one face after the other
    counts: Int[np.ndarray, "n"]  # number of corners
    widths: Int[np.ndarray, "n"]  # number of integers on the face's line
    materials: Int[np.ndarray, "n"]


def read_obj(path: Path, data: bytes) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "F 3 3"]]:
    """Return all vertices and the triangles of an OBJ file, in its unit.

    Faces of all objects and groups are read; polygons are divided, see `polygons`. Negative numbers count back from the
    last vertex before the face. The material's file is not opened.

    Raises:
        InputError: For a damaged line, for a face without vertex, and for free-form curves and surfaces.
    """
    vertices: list[list[float]] = []
    lines: list[_FaceLine] = []
    materials: dict[str, int] = {"": 0}
    material, others = 0, dict[str, int]()
    for number, words in _statements(data):
        key = words[0]
        if key == VERTEX:
            vertices.append(_vertex(path, number, words))
        elif key in FACES:
            lines.append(_FaceLine(number, words[1:], len(vertices), material))
        elif key == MATERIAL:
            material = materials.setdefault(" ".join(words[1:]), len(materials))
        elif key in FREE_FORM:
            raise InputError(f"{path}: line {number}: {key!r} is not a polygon; export the part as triangles")
        elif key in IGNORED:
            others[key] = others.get(key, 0) + 1
        elif key not in HARMLESS:
            what = f"line {number}: unknown key {key[:20]!r}; write # before the line if it may be ignored"
            raise InputError(f"{path}: not a readable .obj file ({what})")
    faces = _faces(path, lines)
    if not vertices:
        raise InputError(f"{path}: not a readable .obj file (it contains no vertices)")
    _name(path, others, len(lines), len(vertices))
    xyz = np.array(vertices, np.float64).reshape(-1, 3)
    triangles = _triangles(path, xyz, faces)
    note_missing_line_end(path, data)
    return xyz, triangles


def _statements(data: bytes) -> Iterator[tuple[int, list[str]]]:
    """Yield the number of the first line, and the words, of each statement. A backslash in a comment joins no lines."""
    text = data.decode("utf-8-sig", "replace").replace("\r\n", "\n").replace("\r", "\n")
    begun, first = "", 0
    for number, line in enumerate(text.split("\n"), start=1):
        content = begun + (line.partition("#")[0] if "#" in line else line)
        first = first if begun else number
        begun = content[:-1] if line.endswith("\\") and "#" not in line else ""
        if not begun and (words := content.split()):
            yield first, words
    if words := begun.split():
        yield first, words


def _vertex(path: Path, number: int, words: list[str]) -> list[float]:
    try:
        x, y, z = map(float, words[1:4])
        if "_" in "".join(words[1:4]):  # Python reads 1_0 as ten
            raise ValueError
    except ValueError:
        raise InputError(f"{path}: not a readable .obj file (line {number}: a vertex needs three numbers)") from None
    return [x, y, z]


def _faces(path: Path, lines: list[_FaceLine]) -> _Faces:
    counts = np.array([len(line.words) for line in lines], int)
    materials = np.array([line.material for line in lines], int)
    words = [word for line in lines for word in line.words]
    joined = "".join(words)
    if joined.isascii() and joined.isdigit() and max(map(len, words)) <= MOST_DIGITS:  # the usual case, in one step
        numbers = np.array(list(map(int, words)))
        if numbers.all():
            return _Faces(numbers - 1, counts, counts, materials)
    corners = [_corner(path, line, word) for line in lines for word in line.words]
    widths = [sum(len(word.replace("/", " ").split()) for word in line.words) for line in lines]
    return _Faces(np.array(corners, int), counts, np.array(widths, int), materials)


def _corner(path: Path, line: _FaceLine, word: str) -> int:
    if not (found := CORNER.fullmatch(word)):
        raise InputError(f"{path}: not a readable .obj file (line {line.number}: {word[:20]!r} is not a corner)")
    vertex = int(found[1])
    if vertex == 0 or vertex < -line.before:
        raise InputError(f"{path}: line {line.number}: there is no vertex {vertex}; the first vertex is 1")
    return vertex - 1 if vertex > 0 else line.before + vertex


def _name(path: Path, others: dict[str, int], faces: int, vertices: int) -> None:
    """Report elements that are not used, and a file without faces."""
    for key, count in others.items():
        if faces or key != "p":
            warnings.warn(f"{path}: its {count} {IGNORED[key]} ({key}) are ignored", Note, stacklevel=3)
    if vertices and not faces:
        warnings.warn(f"{path}: it has no faces; its {vertices} vertices are read as a cloud", Note, stacklevel=3)


def _triangles(path: Path, vertices: Float[np.ndarray, "V 3"], faces: _Faces) -> Float[np.ndarray, "F 3 3"]:
    """Return the triangles of faces. Materials follow each other from the last to the first, as in earlier versions."""
    counts = faces.counts
    if not counts.size:
        return np.empty((0, 3, 3))
    found = polygons.triangulate(vertices, faces.corners, counts, str(path))
    order = polygons.rolled_quads(found, counts)
    groups = [np.flatnonzero(faces.materials == each) for each in dict.fromkeys(faces.materials.tolist())]
    parts = []
    for group in reversed(groups):
        rows = np.flatnonzero(np.isin(found.polygon, group)) if len(groups) > 1 else np.arange(len(order))
        if len({*faces.widths[group].tolist()}) == 1 and counts[group[0]] == 4:
            rows = rows[np.argsort(found.rank[rows], kind="stable")]
        parts.append(order[rows])
    return vertices[np.concatenate(parts)]
