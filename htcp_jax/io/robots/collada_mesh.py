"""Reading of Collada meshes (.dae), which many ROS packages contain, with the extra `collada`.

A parser without entities first checks that a file is XML. pycollada then gets the file's bytes, so that it cannot open
other files. Instances are resolved here and counted, because a small file may repeat its nodes and triangles without
bound. Lists must have the lengths that the file states, and polygons with holes are refused: pycollada would read what
is there, and omit the holes.

<unit> scales a mesh, and <up_axis> is ignored: authors of URDF files place meshes for RViz and MoveIt, which do the
same.
"""

import importlib.util
import io
import warnings
from pathlib import Path
from xml.parsers import expat

import numpy as np

from htcp_jax.errors import InputError, Note, install_command
from htcp_jax.io.parts.polygons import triangulate
from htcp_jax.io.robots.capsule_fit import Triangles
from htcp_jax.model import arrays
from htcp_jax.system import one_line, quiet, read_bytes

ENDING = ".dae"
MOST_NODES, MOST_TRIANGLES = 100_000, 10_000_000  # maximum numbers, with all instances


def read_triangles(path: Path) -> Triangles:
    """Return the triangles of a Collada file's scene [m].

    Raises:
        InputError: If the extra is not installed, for a file that cannot be read completely, and for a skinned mesh.
    """
    if importlib.util.find_spec("collada") is None:
        raise InputError(f'{path}: reading .dae needs the extra "collada": {install_command("collada")}')
    data = read_bytes(path)
    try:
        triangles = _scene_triangles(path, data)
    except InputError:
        raise
    except Exception as error:  # a third-party parser on untrusted bytes: whatever it raises, the file is bad
        raise InputError(f"{path}: not a readable .dae file ({one_line(error)})") from None
    if not (np.abs(triangles) <= arrays.LARGEST_COORDINATE).all():
        raise InputError(f"{path}: a vertex of the mesh is NaN, infinite or too far from the origin")
    return triangles


def _scene_triangles(path: Path, data: bytes) -> Triangles:
    import collada  # an extra

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = _refuse_doctype
    parser.Parse(data, True)
    with quiet():
        # NumPy's warning about text that is no number. pycollada causes other deprecation warnings itself.
        warnings.filterwarnings("error", ".* could not be read to its end", DeprecationWarning)
        file = collada.Collada(io.BytesIO(data))  # unlike trimesh's reader, it refuses broken references
    _check_lists(file.xmlnode.getroot())
    unit_m = 1.0 if file.assetInfo.unitmeter is None else file.assetInfo.unitmeter
    if not unit_m > 0:
        raise ValueError(f"a unit of {unit_m:g} m")
    stack = [(node, np.eye(4)) for node in file.scene.nodes]
    parts, nodes, count, lines = [np.empty((0, 3, 3))], 0, 0, 0
    while stack:
        node, T = stack.pop()
        if isinstance(node, collada.scene.ControllerNode):
            raise ValueError("a skinned mesh is not rigid")
        if isinstance(node, collada.scene.GeometryNode):
            for primitive in node.geometry.primitives:
                part = _primitive_triangles(primitive, str(path))
                parts.append(part @ T[:3, :3].T + T[:3, 3])
                count += len(part)
                lines += isinstance(primitive, collada.lineset.LineSet)
        elif isinstance(node, collada.scene.Node):
            stack += [(child, T @ node.matrix) for child in node.children]
        nodes += 1
        if nodes + len(stack) > MOST_NODES or count > MOST_TRIANGLES:
            raise ValueError(f"more than {MOST_NODES:,} nodes or {MOST_TRIANGLES:,} triangles")
    if lines:
        warnings.warn(f"{path}: its {lines} sets of lines are ignored", Note, stacklevel=3)
    return unit_m * np.concatenate(parts)


def _primitive_triangles(primitive, source: str) -> Triangles:
    """Return the triangles of a pycollada primitive; lines have none."""
    import collada

    is_polygons = isinstance(primitive, collada.polylist.Polylist)
    if not (is_polygons or isinstance(primitive, collada.triangleset.TriangleSet)) or not len(primitive):
        return np.empty((0, 3, 3))
    if primitive.vertex_index.min() < 0:
        raise ValueError("a negative vertex number")
    corners = primitive.sources["VERTEX"][0][4]
    if "nan" in "".join(corners.xmlnode.itertext()).lower():  # pycollada makes 0 of it
        raise ValueError("a vertex is NaN")
    vertices = np.asarray(primitive.vertex, np.float64)
    if is_polygons:
        return vertices[triangulate(vertices, primitive.vertex_index, primitive.vcounts, source).corners]
    return vertices[primitive.vertex_index]


def _check_lists(root) -> None:
    """Check that lists have the stated lengths, and that no polygon has a hole.

    Raises:
        ValueError: Otherwise.
    """
    if root.find(".//{*}ph") is not None:
        raise ValueError("a polygon with a hole (<ph>); divide it into triangles")
    for node in root.iterfind(".//{*}float_array"):
        _check_count(node, len((node.text or "").split()))
    for name, corners in (("triangles", 3), ("polylist", 0), ("polygons", 0)):
        for node in root.iterfind(f".//{{*}}{name}"):
            offsets = [int(each.get("offset", 0)) for each in node.iterfind("{*}input")]
            lists = [len((each.text or "").split()) // (max(offsets, default=0) + 1) for each in node.iterfind("{*}p")]
            counts = [int(each) for vcount in node.iterfind("{*}vcount") for each in (vcount.text or "").split()]
            _check_count(node, sum(lists) // 3 if corners else len(lists) if name == "polygons" else len(counts))
            if name == "polylist" and sum(counts) != sum(lists):
                raise ValueError(f"damaged: a polylist has {sum(lists)} corners instead of {sum(counts)}")
            if corners and len(lists) > 1:
                raise ValueError("damaged: triangles have several lists of corners")


def _check_count(node, there: int) -> None:
    if (declared := node.get("count")) is not None and int(declared) != there:
        name = node.tag.rpartition("}")[2]
        raise ValueError(f"damaged: an element {name} declares {declared} entries, the file contains {there}")


def _refuse_doctype(*_) -> None:
    raise ValueError("a document type (<!DOCTYPE) is not allowed")
