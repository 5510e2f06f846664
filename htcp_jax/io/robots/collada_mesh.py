"""Reading of Collada meshes (.dae), which many ROS packages contain, with the extra `collada`.

A parser without entities first checks that a file is XML. pycollada then gets the file's bytes, so that it cannot open
other files. Instances are resolved here and counted, because a small file may repeat its nodes and triangles without
bound.

<unit> scales a mesh, and <up_axis> is ignored: authors of URDF files place meshes for RViz and MoveIt, which do the
same.
"""

import importlib.util
import io
import warnings
from pathlib import Path
from xml.parsers import expat

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.io.files import one_line, quiet, read_bytes
from htcp_jax.io.robots.capsule_fit import Triangles
from htcp_jax.model import arrays

ENDING = ".dae"
MOST_NODES, MOST_TRIANGLES = 100_000, 10_000_000  # maximum numbers, with all instances


def read_triangles(path: Path) -> Triangles:
    """Return the triangles of a Collada file's scene [m].

    Raises:
        InputError: If the extra is not installed, for a file that cannot be read completely, and for a skinned mesh.
    """
    if importlib.util.find_spec("collada") is None:
        raise InputError(f"""{path}: reading .dae needs the extra "collada": pip install 'htcp_jax[collada]'""")
    data = read_bytes(path)
    try:
        with quiet():
            # NumPy's warning about text that is no number. pycollada causes other deprecation warnings itself.
            warnings.filterwarnings("error", ".* could not be read to its end", DeprecationWarning)
            triangles = _scene_triangles(data)
    except Exception as error:  # a third-party parser on untrusted bytes: whatever it raises, the file is bad
        raise InputError(f"{path}: not a readable .dae file ({one_line(error)})") from None
    if not (np.abs(triangles) <= arrays.LARGEST_COORDINATE).all():
        raise InputError(f"{path}: a vertex of the mesh is NaN, infinite or too far from the origin")
    return triangles


def _scene_triangles(data: bytes) -> Triangles:
    import collada  # an extra

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = _refuse_doctype
    parser.Parse(data, True)
    file = collada.Collada(io.BytesIO(data))  # unlike trimesh's reader, it refuses broken references
    unit_m = 1.0 if file.assetInfo.unitmeter is None else file.assetInfo.unitmeter
    if not unit_m > 0:
        raise ValueError(f"a unit of {unit_m:g} m")
    stack = [(node, np.eye(4)) for node in file.scene.nodes]
    parts, nodes, count = [np.empty((0, 3, 3))], 0, 0
    while stack:
        node, T = stack.pop()
        if isinstance(node, collada.scene.ControllerNode):
            raise ValueError("a skinned mesh is not rigid")
        if isinstance(node, collada.scene.GeometryNode):
            for part in map(_primitive_triangles, node.geometry.primitives):
                parts.append(part @ T[:3, :3].T + T[:3, 3])
                count += len(part)
        elif isinstance(node, collada.scene.Node):
            stack += [(child, T @ node.matrix) for child in node.children]
        nodes += 1
        if nodes + len(stack) > MOST_NODES or count > MOST_TRIANGLES:
            raise ValueError(f"more than {MOST_NODES:,} nodes or {MOST_TRIANGLES:,} triangles")
    return unit_m * np.concatenate(parts)


def _primitive_triangles(primitive) -> Triangles:
    """Return the triangles of a pycollada primitive; lines have none."""
    import collada

    if isinstance(primitive, collada.polylist.Polylist):
        primitive = primitive.triangleset()
    if not isinstance(primitive, collada.triangleset.TriangleSet) or not len(primitive):
        return np.empty((0, 3, 3))
    if primitive.vertex_index.min() < 0:
        raise ValueError("a negative vertex number")
    corners = primitive.sources["VERTEX"][0][4]
    if "nan" in "".join(corners.xmlnode.itertext()).lower():  # pycollada makes 0 of it
        raise ValueError("a vertex is NaN")
    return np.asarray(primitive.vertex, np.float64)[primitive.vertex_index]


def _refuse_doctype(*_) -> None:
    raise ValueError("a document type (<!DOCTYPE) is not allowed")
