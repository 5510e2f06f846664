"""Reading of PLY meshes and clouds: text, and binary in both byte orders.

Faces, polygons and triangle strips are read. Other elements that hold indices of vertices are refused, as the vertices
alone would be another part. A file must contain as many values as its header declares.
"""

import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.errors import InputError, Note
from htcp_jax.io.parts import polygons
from htcp_jax.system import note_missing_line_end, one_line

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "int64": "i8", "uint64": "u8",
    "float16": "f2", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
POLYGONS, STRIPS = ("face", "faces", "polygon", "polygons"), ("tristrips", "tristrip", "tri_strips", "strips")
INDICES = ("vertex_indices", "vertex_index")
UNUSED = ("edge", "edges", "range_grid")  # they name vertices, but have no surface; a range grid is a cloud
NUMBERED = re.compile(r".*vert.*\d", re.I)  # vertex1, vertex2: each a vertex
OF_COLOURS = re.compile(r".*tex(ture|coord)|.*(red|green|blue|alpha)$", re.I)  # integers that are no vertices


class _Property(NamedTuple):
    name: str
    type: np.dtype
    length: np.dtype | None  # type of a list's length; None: not a list


class _Element(NamedTuple):
    name: str
    count: int
    properties: list[_Property]


class _Lists(NamedTuple):
    """The lists of a property, one after the other, and their lengths."""

    values: np.ndarray
    counts: Int[np.ndarray, "n"]


_Values = dict[str, np.ndarray | _Lists]  # of an element, by property
_At = Int[np.ndarray, "n"]  # positions in the file
_Reader = Callable[[_At, np.dtype], np.ndarray]


def read_ply(path: Path, data: bytes) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "F 3 3"]]:
    """Return all vertices and the triangles of a PLY file, in its unit; polygons are divided, see `polygons`.

    Raises:
        InputError: For a file that is damaged, too short or too long, and for elements that hold indices of vertices in
            a way that is not read.
    """
    try:
        is_text, elements, start = _read_header(data)
        vertices = next((each for each in elements if each.name == "vertex"), _Element("vertex", 0, []))
        if missing := sorted({*"xyz"} - {each.name for each in vertices.properties if each.length is None}):
            raise ValueError(f"its vertices have no {', '.join(missing)}")
        _check_elements(path, elements)
        values = (_read_text if is_text else _read_binary)(path, data[start:], elements)
        xyz = np.column_stack([values["vertex"][axis] for axis in "xyz"]).astype(np.float64)
        triangles = _triangles(path, xyz, values)
    except InputError:
        raise
    except (ValueError, OverflowError) as error:
        raise InputError(f"{path}: not a readable .ply file ({one_line(error)})") from None
    if not len(triangles) and any(each.count for each in elements if each is not vertices):
        warnings.warn(f"{path}: it has no faces; its {len(xyz)} vertices are read as a cloud", Note, stacklevel=2)
    if is_text:
        note_missing_line_end(path, data)
    return xyz, triangles


def _read_header(data: bytes) -> tuple[bool, list[_Element], int]:
    """Return True for a text, the elements, and the position of the first value."""
    if not (begin := re.match(rb"(?:\xef\xbb\xbf)?ply[ \t]*(\r\n|\n|\r)", data)):
        raise ValueError("no header")
    line_end = rb"\r" if begin[1] == b"\r" else rb"\r?\n"
    if not (end := re.compile(rb"[\r\n][ \t]*end_header[ \t]*" + line_end).search(data, begin.end() - 1)):
        raise ValueError("its header has no end")
    order, elements = None, list[_Element]()
    for line in data[begin.end() : end.start()].decode("utf-8", "replace").splitlines():
        match line.split():
            case [] | ["comment", *_] | ["obj_info", *_]:
                continue
            case ["format", name, "1.0"] if name in FORMATS and order is None:
                order = FORMATS[name]
                continue
            case ["element", name, count] if count.isdigit() and len(count) <= 12 and order is not None:
                if name not in {each.name for each in elements}:
                    elements.append(_Element(name, int(count), []))
                    continue
            case ["property", *kinds, name] if elements and kinds and {*kinds} <= {"list", *TYPES}:
                own = elements[-1].properties
                found = _property(name, kinds, order)
                if found is not None and name not in {each.name for each in own}:
                    own.append(found)
                    continue
        raise ValueError(f"its header has the line {line[:60]!r}")
    if order is None:
        raise ValueError(f"its header has no format; valid: {', '.join(FORMATS)}")
    return order == "", elements, end.end()


def _property(name: str, kinds: list[str], order: str) -> _Property | None:
    types = [np.dtype(order + TYPES[kind]) for kind in kinds if kind != "list"]
    if kinds[0] != "list" and len(kinds) == 1:
        return _Property(name, types[0], None)
    is_list = kinds[0] == "list" and len(types) == 2 == len(kinds) - 1 and types[0].kind in "iu"
    return _Property(name, types[1], types[0]) if is_list else None


def _check_elements(path: Path, elements: list[_Element]) -> None:
    """Refuse elements that hold indices of vertices in an unknown way; a Note names other unused elements."""
    for element in elements:
        if element.name in ("vertex", *POLYGONS, *STRIPS) or not element.count:
            continue
        if element.name not in UNUSED and _may_hold_vertices(element):
            text = f"its {element.count} elements {element.name!r} may hold vertices"
            raise InputError(f"{path}: {text}; save the mesh with faces (valid: {', '.join((*POLYGONS, *STRIPS))})")
        warnings.warn(f"{path}: its {element.count} elements {element.name!r} are ignored", Note, stacklevel=3)


def _may_hold_vertices(element: _Element) -> bool:
    """True for a list of integers, for three integers, and for an integer with the name of a numbered vertex."""
    integers = [each for each in element.properties if each.type.kind in "iu" and not OF_COLOURS.match(each.name)]
    return len(integers) >= 3 or any(each.length is not None or NUMBERED.fullmatch(each.name) for each in integers)


def _read_text(path: Path, body: bytes, elements: list[_Element]) -> dict[str, _Values]:
    rows, at, found = [row for line in body.splitlines() if (row := line.split())], 0, {}
    for element in elements:
        own = rows[at : at + element.count]
        if len(own) < element.count:
            raise InputError(f"{path}: damaged: {_counts(element)}, the file contains {len(own)}")
        if b"_" in b"".join(map(b"".join, own)):  # Python reads 1_0 as ten
            raise ValueError(f"a word among the numbers of {element.name!r}")
        numbers = np.array([float(number) for row in own for number in row])
        ends = np.cumsum([len(row) for row in own], dtype=int)
        starts = np.concatenate([[0], ends[:-1]])[: len(own)].astype(int)

        def read(at: _At, kind: np.dtype, numbers=numbers) -> np.ndarray:
            values = numbers[at].astype(kind)
            if kind.kind in "iu" and (values != numbers[at]).any():
                raise ValueError(f"{numbers[at][values != numbers[at]][0]:g} is not of the type {kind.name}")
            return values

        found[element.name], stop = _read_rows(path, element, read, starts, ends, lambda kind: 1)
        if (wrong := np.flatnonzero(stop != ends)).size:
            raise InputError(f"{path}: {element.name} {wrong[0] + 1} has more numbers than its header declares")
        at += element.count
    if len(rows) > at:
        raise InputError(f"{path}: damaged: it has {len(rows) - at} lines more than its header declares")
    return found


def _read_binary(path: Path, body: bytes, elements: list[_Element]) -> dict[str, _Values]:
    values, at, found = np.frombuffer(body, np.uint8), 0, {}

    def read(at: _At, kind: np.dtype) -> np.ndarray:
        return values[at[:, None] + np.arange(kind.itemsize)].view(kind)[:, 0]

    for element in elements:
        starts = _row_starts(path, element, body, at)
        found[element.name], stop = _read_rows(path, element, read, starts, len(body), lambda kind: kind.itemsize)
        at = int(stop[-1]) if len(stop) else at
    if (rest := body[at:]).strip(b"\0 \t\r\n"):
        raise InputError(f"{path}: damaged: it has {len(rest)} bytes more than its header declares")
    if rest:
        warnings.warn(f"{path}: {len(rest)} bytes after the last element are ignored", Note, stacklevel=4)
    return found


def _row_starts(path: Path, element: _Element, body: bytes, at: int) -> _At:
    """Return the positions of an element's rows, which have different lengths if their lists have."""
    sizes = [(each.length or each.type).itemsize for each in element.properties]
    least = sum(sizes)
    if element.count and (not least or at + least * element.count > len(body)):
        there = (len(body) - at) // least if least else 0
        raise InputError(f"{path}: damaged: {_counts(element)}, the file contains at most {there}")
    if all(each.length is None for each in element.properties):
        return at + least * np.arange(element.count)
    starts = np.empty(element.count, int)
    order = "big" if ">" in {(each.length or each.type).byteorder for each in element.properties} else "little"
    steps = [
        (size, each.type.itemsize if each.length else 0) for size, each in zip(sizes, element.properties, strict=True)
    ]
    for k in range(element.count):
        starts[k] = at
        for size, each in steps:
            at += size + (each and each * int.from_bytes(body[at : at + size], order))
    return starts


def _read_rows(
    path: Path, element: _Element, read: _Reader, at: _At, ends: _At | int, size: Callable[[np.dtype], int]
) -> tuple[_Values, _At]:
    """Return the values of an element, and the positions behind its rows."""
    found: _Values = {}

    def check(stop: _At) -> None:
        if (short := np.flatnonzero(stop > ends)).size:
            raise InputError(f"{path}: damaged: {element.name} {short[0] + 1} of {element.count} is not complete")

    for each in element.properties:
        counts = None
        if each.length is not None:
            check(at + size(each.length))
            counts = read(at, each.length).astype(int)
            if (counts < 0).any():
                raise InputError(f"{path}: damaged: {element.name} has a list of {counts.min()} values")
            at = at + size(each.length)
        step = size(each.type)
        stop = at + step * (1 if counts is None else counts)
        check(stop)
        if counts is None:
            found[each.name] = read(at, each.type)
        else:
            inner = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
            found[each.name] = _Lists(read(np.repeat(at, counts) + step * inner, each.type), counts)
        at = stop
    return found, at


def _triangles(
    path: Path, vertices: Float[np.ndarray, "V 3"], values: dict[str, _Values]
) -> Float[np.ndarray, "F 3 3"]:
    """Return the triangles of all faces: first triangles, then quads, then polygons; then strips."""
    found = [np.empty((0, 3), int)]
    for name in POLYGONS:
        lists = _indices(path, name, values.get(name, {}))
        if lists is None or not len(lists.counts):
            continue
        corners, counts = lists.values.astype(int), lists.counts
        divided = polygons.triangulate(vertices, corners, counts, str(path))
        corners_of, own = polygons.rolled_quads(divided, counts), counts[divided.polygon]
        order = np.lexsort((np.where(own == 4, divided.rank, 0), np.minimum(own, 5)))
        found.append(corners_of[order])
    for name in STRIPS:
        lists = _indices(path, name, values.get(name, {}))
        for strip in () if lists is None else np.split(lists.values.astype(int), np.cumsum(lists.counts)[:-1]):
            found += [_strip(path, each) for each in np.split(strip, np.flatnonzero(strip == -1))]
    flat = np.concatenate(found)
    polygons.check_faces(len(vertices), flat.ravel(), np.full(len(flat), 3), str(path))
    return vertices[flat]


def _strip(path: Path, strip: Int[np.ndarray, "n"]) -> Int[np.ndarray, "t 3"]:
    """Return the triangles of a strip, with one sense; those between two parts, which repeat a corner, are omitted."""
    strip = strip[1:] if len(strip) and strip[0] == -1 else strip
    if len(strip) in (1, 2):
        raise InputError(f"{path}: damaged: a triangle strip has {len(strip)} corners; at least 3 are needed")
    triangles = np.stack([strip[:-2], strip[1:-1], strip[2:]], axis=1) if len(strip) else np.empty((0, 3), int)
    triangles[1::2] = triangles[1::2, [1, 0, 2]]
    a, b, c = triangles.T
    return triangles[(a != b) & (b != c) & (c != a)]


def _indices(path: Path, name: str, values: _Values) -> _Lists | None:
    """Return the lists of vertices of an element of faces or strips; None for an element that is not there."""
    lists = {key: each for key, each in values.items() if isinstance(each, _Lists) and each.values.dtype.kind in "iu"}
    known = [key for key in INDICES if key in lists] or list(lists)
    if not values:
        return None
    if len(known) != 1:
        text = f"its elements {name!r} have the lists {', '.join(lists) or 'none'}"
        raise InputError(f"{path}: {text}; one with the vertices is needed, {INDICES[0]}")
    if known[0] not in INDICES:
        warnings.warn(
            f"{path}: the list {known[0]!r} of its elements {name!r} is read as their vertices", Note, stacklevel=5
        )
    return lists[known[0]]


def _counts(element: _Element) -> str:
    return f"its header declares {element.count:,} elements {element.name!r}"
