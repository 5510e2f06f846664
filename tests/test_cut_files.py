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


def lost(name: str, data: bytes, folder: Path, read, refusal: type[BaseException]) -> list[str]:
    """Return the cuts that lose geometry silently; `read` returns an array and remarks."""
    file, found = folder / name.replace(" ", "-"), []
    file.write_bytes(data)
    complete, _ = read(file)
    for cut in np.linspace(0, len(data) - 1, CUTS).astype(int):
        file.write_bytes(data[:cut])
        try:
            part, remarks = read(file)
        except refusal:
            continue
        at_line_end = name.endswith(WITHOUT_AN_END) and data[cut - 1 : cut] == b"\n"
        is_named = any("has no line end" in remark for remark in remarks)
        if not (at_line_end or is_named or np.array_equal(part, complete)):
            found.append(f"{cut} of {len(data)} bytes: {len(part)} of {len(complete)}")
    return found


def geometry(file: Path) -> tuple[np.ndarray, list[str]]:
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        if file.suffix == ".dae":
            found = read_triangles(file)
        else:
            points, triangles = load_geometry(file)
            found = triangles if len(triangles) else points
    return found, [str(each.message) for each in said if each.category is Note]


@pytest.mark.parametrize("name", SAMPLES)
def test_a_file_that_was_cut_is_not_read_as_a_smaller_part(tmp_path, name):
    assert lost(name, SAMPLES[name], tmp_path, geometry, InputError) == []


def scan(file: Path, kind: str) -> bytes:
    """Write a scan and return its bytes."""
    if file.suffix == ".pcd":
        points = np.concatenate([POINTS, np.zeros((30, 3))])  # something to compress
        cloud = pytest.importorskip("pypcd4").PointCloud.from_points(points, tuple("xyz"), (np.float64,) * 3)
        cloud.save(file, encoding=pytest.importorskip("pypcd4").Encoding(kind))
    elif file.suffix in (".las", ".laz"):
        header = pytest.importorskip("laspy").LasHeader(point_format=3, version="1.2")
        header.scales = [1e-6] * 3
        cloud = pytest.importorskip("laspy").LasData(header)
        cloud.x, cloud.y, cloud.z = POINTS.T
        cloud.write(str(file))
    elif file.suffix == ".e57":
        with pytest.importorskip("pye57").E57(str(file), mode="w") as written:
            written.write_scan_raw(dict(zip(("cartesianX", "cartesianY", "cartesianZ"), POINTS.T.copy(), strict=True)))
    else:
        pytest.importorskip("cascadio")
        file.write_text((Path(__file__).parent / "data" / "cylinder.step").read_text())
    return file.read_bytes()


SCANS = ("pcd", "ascii"), ("pcd", "binary"), ("pcd", "binary_compressed"), ("las", ""), ("laz", ""), ("e57", "")


@pytest.mark.parametrize("kind, encoding", [*SCANS, ("step", "")])
def test_a_scan_or_step_part_that_was_cut_is_not_read_as_a_smaller_one(tmp_path, kind, encoding):
    """The parsers run in this process here, as it takes long to start one for each cut."""
    parse = getattr(parsers, kind.replace("laz", "las"))

    def read(file: Path) -> tuple[np.ndarray, list[str]]:
        found = parse(file)
        return found["triangles" if kind == "step" else "points"], found["remarks"].tolist()

    assert lost(f"scan.{kind}", scan(tmp_path / f"first.{kind}", encoding), tmp_path, read, BaseException) == []
