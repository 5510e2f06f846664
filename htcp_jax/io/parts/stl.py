"""Reading of STL meshes, text and binary. Other readers take a damaged file for a smaller one, see `read_stl`."""

import re
import warnings
from pathlib import Path

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError, Note
from htcp_jax.system import note_missing_line_end

Triangles = Float[np.ndarray, "F 3 3"]

HEADER, RECORD = 84, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
NEAR = 10.0  # a record after the last declared triangle is one, too, if it is within so many sizes of the mesh
_CORNER = r"\s+vertex" + 3 * r"\s+(\S+)"
_START = r"facet(?:\s+normal(?:\s+\S+){3})?\s+outer\s+loop"
FACET = re.compile(rf"\s*{_START}{3 * _CORNER}\s+end\s*loop\s+end\s*facet(?=\s|$)", re.I)
# The name of a solid goes on to the end of the line, or to a facet.
BEGIN, END = (
    re.compile(rf"\s*{word}(?![^\s])((?:(?!(?<!\S){_START})[^\n\r])*)", re.I) for word in ("solid", r"end\s*solid")
)


def read_stl(path: Path, data: bytes) -> Triangles:
    """Return the triangles of an STL file, in its unit.

    A text has a solid, or several, each of which must end with `endsolid`. A binary file must contain as many triangles
    as its header declares. A Note reports other bytes after the last triangle.

    Raises:
        InputError: For a damaged file, and for one without triangles.
    """
    text = data.removeprefix(b"\xef\xbb\xbf").strip(b"\0\x1a \t\r\n")
    declared = int.from_bytes(data[HEADER - 4 : HEADER], "little")
    is_binary = len(data) >= HEADER and len(data) == HEADER + RECORD.itemsize * declared
    if not is_binary and text[:5].lower() == b"solid" and b"\0" not in text:
        triangles = _read_text(path, text.decode("utf-8", "replace"))
        note_missing_line_end(path, data)
    else:
        triangles = _read_binary(path, data, declared)
    if not len(triangles):
        raise InputError(f"{path}: it contains no triangles")
    return triangles


def _read_binary(path: Path, data: bytes, declared: int) -> Triangles:
    there = max(0, len(data) - HEADER) // RECORD.itemsize
    counts = f"the header declares {declared:,} triangles, the file contains {there:,}"
    if len(data) < HEADER:
        raise InputError(f"{path}: not a readable .stl file ({len(data)} bytes; neither text nor a header of {HEADER})")
    if declared > there:
        raise InputError(f"{path}: damaged: {counts}")
    records = np.frombuffer(data, RECORD, there, HEADER)["corners"].astype(np.float64)
    triangles, tail = records[:declared], records[declared:]
    if _are_triangles(tail, triangles):
        raise InputError(f"{path}: damaged: {counts}")
    if rest := len(data) - HEADER - RECORD.itemsize * declared:
        warnings.warn(f"{path}: {rest} bytes after the last of {declared:,} triangles are ignored", Note, stacklevel=3)
    return triangles


def _are_triangles(tail: Triangles, mesh: Triangles) -> bool:
    """True if any record after the last declared triangle is a triangle with an area, near the mesh."""
    with np.errstate(invalid="ignore", over="ignore"):
        middle, size = np.zeros(3), np.inf
        if len(mesh):
            low, high = mesh.min(axis=(0, 1)), mesh.max(axis=(0, 1))
            middle, size = (low + high) / 2, np.linalg.norm(high - low)
        near = (np.abs(tail - middle) <= NEAR * size).all(axis=(1, 2))
        return bool((near & np.cross(tail[:, 1] - tail[:, 0], tail[:, 2] - tail[:, 0]).any(axis=1)).any())


def _read_text(path: Path, text: str) -> Triangles:
    numbers: list[str] = []
    at, solids = 0, 0
    while at < len(text):
        solids += 1
        if not (begin := BEGIN.match(text, at)):
            raise InputError(f"{path}: line {_line(text, at)}: {_word(text, at)!r} where a solid must begin")
        at = begin.end()
        while facet := FACET.match(text, at):
            numbers += facet.groups()
            at = facet.end()
        if not (end := END.match(text, at)):
            raise InputError(f"{path}: {_damage(text, at, begin[1].strip()[:40] or str(solids))}")
        at = end.end()
    try:
        if odd := [number for number in numbers if "_" in number]:  # Python reads 1_0 as ten
            raise ValueError(f"{odd[0][:20]!r} is not a number")
        return np.array(list(map(float, numbers))).reshape(-1, 3, 3)
    except ValueError as error:
        raise InputError(f"{path}: not a readable .stl file ({error})") from None


def _damage(text: str, at: int, solid: str) -> str:
    """Return what is wrong with a solid that goes on at `at` with neither a facet nor its end."""
    if not re.search(r"\bend\s*solid\b", text[at:], re.I):
        return f'damaged: solid "{solid}" has no endsolid'
    if BEGIN.match(text, at):
        return f'damaged: solid "{solid}" has no endsolid before line {_line(text, at)}'
    facet = re.match(r"\s*facet\b.*?\bend\s*facet\b", text[at:], re.I | re.S)
    corners = len(re.findall(r"\bvertex\b", facet[0], re.I)) if facet else 3
    what = f"a facet has {corners} vertices" if corners != 3 else f"{_word(text, at)!r} is not part of a valid facet"
    return f"not a readable .stl file (line {_line(text, at)}: {what})"


def _line(text: str, at: int) -> int:
    return text.count("\n", 0, at + len(text[at:]) - len(text[at:].lstrip())) + 1


def _word(text: str, at: int) -> str:
    return (text[at:].split(None, 1) or [""])[0][:20]
