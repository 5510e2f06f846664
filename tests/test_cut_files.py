"""Files that end too early: at 200 places each is refused, or is the complete part, or is named in a line.

Formats without an end, whose rows may end at any line end, are the exceptions; docs/bring-a-scan.md lists them.
"""

import io
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from collada_box import DAE

from htcp_jax.errors import InputError, Note
from htcp_jax.io.parts import parsers
from htcp_jax.io.parts.point_cloud import load_geometry
from htcp_jax.io.robots.collada_mesh import read_triangles

CUTS = 200
POINTS = np.random.default_rng(0).uniform(-1.0, 1.0, (60, 3))
BOXES = trimesh.util.concatenate([trimesh.creation.box((1, 2, 3)), trimesh.creation.annulus(4, 5, 1, sections=12)])
ROWS = "".join(f"{x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in POINTS)
TWO_SOLIDS = "".join(
    each.export(file_type="stl_ascii").replace("solid", f"solid part{k}").rstrip() + "\n"
    for k, each in enumerate(BOXES.split())
)
WITHOUT_AN_END = "obj", "xyz", "csv", "txt", "several solids.stl"  # a cut at a line end cannot be seen


def npy() -> bytes:
    stream = io.BytesIO()
    np.save(stream, POINTS)
    return stream.getvalue()


def ply(shape: trimesh.Trimesh | trimesh.PointCloud, kind: str) -> bytes:
    if kind != "big":
        return shape.export(file_type="ply", encoding=kind)
    header = f"ply\nformat binary_big_endian 1.0\nelement vertex {len(shape.vertices)}\nproperty float x\n"
    header += "property float y\nproperty float z\n"
    data = shape.vertices.astype(">f4").tobytes()
    if isinstance(shape, trimesh.Trimesh):
        header += f"element face {len(shape.faces)}\nproperty list uchar int vertex_indices\n"
        rows = np.zeros(len(shape.faces), [("n", "u1"), ("corners", ">i4", 3)])
        rows["n"], rows["corners"] = 3, shape.faces
        data += rows.tobytes()
    return (header + "end_header\n").encode() + data


SAMPLES = {
    "one solid.stl": BOXES.export(file_type="stl_ascii").encode(),
    "several solids.stl": TWO_SOLIDS.encode(),
    "binary.stl": BOXES.export(file_type="stl"),
    **{f"mesh {kind}.ply": ply(BOXES, kind) for kind in ("ascii", "binary", "big")},
    **{f"cloud {kind}.ply": ply(trimesh.PointCloud(POINTS), kind) for kind in ("ascii", "binary", "big")},
    "mesh.obj": BOXES.export(file_type="obj").rstrip().encode() + b"\n",
    "cloud.xyz": ROWS.encode(),
    "cloud.csv": b"x,y,z\n" + ROWS.replace(" ", ",").encode(),
    "cloud.txt": ROWS.encode(),
    "cloud.npy": npy(),
    "box.dae": DAE.encode(),
}


def check(name: str, data: bytes, folder: Path, read) -> list[str]:
    """Return what was lost silently; `read` returns an array."""
    file, lost = folder / name.replace(" ", "-"), []
    file.write_bytes(data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        complete = read(file)
    for cut in np.linspace(0, len(data) - 1, CUTS).astype(int):
        file.write_bytes(data[:cut])
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            try:
                found = read(file)
            except Exception as error:
                assert not isinstance(error, AttributeError | NameError | UnboundLocalError)
                continue
        at_line_end = name.endswith(WITHOUT_AN_END) and data[cut - 1 : cut] == b"\n"
        named = any("has no line end" in str(each.message) for each in said if each.category is Note)
        if not (at_line_end or named or np.array_equal(found, complete)):
            lost.append(f"{cut} of {len(data)} bytes: {len(found)} of {len(complete)}")
    return lost


def geometry(file: Path) -> np.ndarray:
    if file.suffix == ".dae":
        return read_triangles(file)
    found = load_geometry(file)
    return found.triangles if len(found.triangles) else found.points


@pytest.mark.parametrize("name", SAMPLES)
def test_a_file_that_was_cut_is_not_read_as_a_smaller_part(tmp_path, name):
    assert check(name, SAMPLES[name], tmp_path, geometry) == []
