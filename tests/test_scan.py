"""Scans and STEP parts, read by optional libraries; a damaged file gives one line at most."""

import importlib.util
import os
import pickle
from pathlib import Path

import numpy as np
import pytest
from made_once import load_cloud

from htcp_jax.cli import main
from htcp_jax.errors import InputError, Note, install_command
from htcp_jax.io.parts.point_cloud import load_geometry, read_points
from htcp_jax.io.parts.scan import PARTS, SCANS, parsed, read_part

laspy, pye57 = pytest.importorskip("laspy"), pytest.importorskip("pye57")
pypcd4, _ = pytest.importorskip("pypcd4"), pytest.importorskip("cascadio")

POINTS = np.random.default_rng(0).uniform(-1.0, 1.0, (40, 3))
CYLINDER = (Path(__file__).parent / "data" / "cylinder.step").read_text()  # radius 200 mm, z from 0 to 900 mm
MILLIMETRE = "#1=( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.) );"
METRE = "#1=( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT($,.METRE.) );"
INCH = """#900=DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.);
#901=( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.) );
#902=LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),#901);
#1=( CONVERSION_BASED_UNIT('INCH',#902) LENGTH_UNIT() NAMED_UNIT(#900) );"""


def pcd(file, encoding="binary", points=POINTS, names=("x", "y", "z")):
    types = (np.float64,) * len(names)
    pypcd4.PointCloud.from_points(points, names, types).save(file, encoding=pypcd4.Encoding(encoding))
    return file


def las(file, points=POINTS, **columns):
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales = [1e-6] * 3
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = points.T
    for name, values in columns.items():
        setattr(cloud, name, values)
    cloud.write(str(file))
    return file


def e57(file, *scans, **columns):
    """Write an E57 file of scans, given as pairs of a quaternion and a translation, with further columns."""
    with pye57.E57(str(file), mode="w") as written:
        for rotation, translation in scans or [(np.array([1.0, 0, 0, 0]), np.zeros(3))]:
            data = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), POINTS.T.copy(), strict=True)) | columns
            written.write_scan_raw(data, rotation=rotation, translation=translation)
    return file


def step(file, text=CYLINDER):
    file.write_text(text)
    return file


WRITE = {".pcd": pcd, ".las": las, ".laz": las, ".e57": e57, ".step": step, ".stp": step}


def refusal(file) -> str:
    with pytest.raises(InputError) as caught:
        load_cloud(file)
    message = str(caught.value)
    assert "\n" not in message and len(message) < 1000 and message.startswith(f"{file}: ")
    return message.removeprefix(f"{file}: ")


def test_every_ending_is_tested():
    assert set(WRITE) == {*SCANS, *PARTS}


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_a_pcd_cloud_comes_back(tmp_path, encoding):
    """Points of a PCD file, in every encoding."""
    flat = np.concatenate([POINTS, np.ones((400, 3))])  # something to compress
    file = pcd(tmp_path / "scan.PCD", encoding, flat)
    assert f"DATA {encoding}\n".encode() in file.read_bytes()
    np.testing.assert_allclose(load_cloud(file), flat, atol=1e-9)


def test_a_pcd_cloud_keeps_its_normals_and_leaves_out_what_was_not_seen(tmp_path):
    normals = np.tile([0.0, 0.6, 0.8], (40, 1))
    points = POINTS.copy()
    points[3] = np.nan
    names = ("intensity", "x", "y", "z", "normal_x", "normal_y", "normal_z")
    file = pcd(tmp_path / "scan.pcd", points=np.hstack([np.ones((40, 1)), points, normals]), names=names)
    with pytest.warns(Note, match=r"scan.pcd: 1 of 40 points are NaN and are ignored"):
        found = read_points(file)
    assert np.array_equal(found.xyz, np.delete(POINTS, 3, axis=0))
    np.testing.assert_allclose(found.normals, normals[1:], atol=1e-12)


@pytest.mark.parametrize("ending", [".las", ".laz"])
def test_a_las_cloud_comes_back_to_its_resolution(tmp_path, ending):
    """Points of a LAS or LAZ file, to its resolution."""
    np.testing.assert_allclose(load_cloud(las(tmp_path / f"scan{ending}")), POINTS, atol=1e-6)


@pytest.mark.parametrize("ending", [".las", ".laz"])
def test_withheld_points_of_a_las_cloud_are_ignored_with_their_number(tmp_path, ending):
    file = las(tmp_path / f"scan{ending}", withheld=np.arange(40) < 3)
    with pytest.warns(Note, match=f"scan{ending}: 3 of 40 points are marked as withheld and are ignored"):
        np.testing.assert_allclose(load_cloud(file), POINTS[3:], atol=1e-6)


@pytest.mark.parametrize("words", ['UNIT["US survey foot",0.3048006096]', 'LENGTHUNIT["foot",0.3048]'])
def test_a_las_cloud_in_feet_is_refused(tmp_path, words):
    las(file := tmp_path / "scan.las")
    cloud = laspy.read(file)
    cloud.header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(f'PROJCS["a",{words}]'))
    cloud.write(str(file))
    assert "its coordinate system is in feet; convert the cloud to metres" in refusal(file)


def test_noise_in_a_las_cloud_is_named(tmp_path):
    file = las(tmp_path / "scan.las", classification=np.where(np.arange(40) < 5, 7, 2).astype(np.uint8))
    with pytest.warns(Note, match=r"5 points are classified as noise \(7, 18\) and are used"):
        assert len(load_cloud(file)) == 40


def test_a_las_cloud_with_more_points_than_declared_is_refused(tmp_path):
    file = las(tmp_path / "scan.las")
    data = bytearray(file.read_bytes())
    data[107:111] = (30).to_bytes(4, "little")
    file.write_bytes(data)
    assert "the header declares 30 points, the file contains 40" in refusal(file)


def test_invalid_points_of_an_e57_file_are_ignored_with_their_number(tmp_path):
    file = e57(tmp_path / "scan.e57", cartesianInvalidState=np.isin(np.arange(40), [0, 7]).astype(np.int8))
    with pytest.warns(Note, match=r"scan.e57: 2 of 40 points are marked as invalid and are ignored"):
        np.testing.assert_allclose(load_cloud(file), np.delete(POINTS, [0, 7], axis=0), atol=1e-6)


def test_an_e57_file_is_in_metres_whatever_the_job_says(tmp_path):
    file = e57(tmp_path / "scan.e57")
    with pytest.raises(InputError, match=r"scan.e57: the unit is mm, but a .e57 file is in metres; omit the key"):
        load_geometry(file, unit="mm")
    assert np.array_equal(load_geometry(file, unit="m").points, load_cloud(file))


def test_an_e57_file_with_spherical_coordinates_alone_is_read(tmp_path):
    lib, distance = pye57.libe57, np.linalg.norm(POINTS, axis=1)
    angles = np.arctan2(POINTS[:, 1], POINTS[:, 0]), np.arcsin(POINTS[:, 2] / distance)
    columns = dict(zip(("sphericalRange", "sphericalAzimuth", "sphericalElevation"), (distance, *angles), strict=True))
    with pye57.E57(str(tmp_path / "scan.e57"), mode="w") as written:
        scan, kinds = lib.StructureNode(written.image_file), lib.StructureNode(written.image_file)
        for name in columns:
            kinds.set(name, lib.FloatNode(written.image_file, 0.0, lib.E57_DOUBLE, -10.0, 10.0))
        points = lib.CompressedVectorNode(written.image_file, kinds, lib.VectorNode(written.image_file, True))
        scan.set("points", points)
        written.data3d.append(scan)
        buffers = lib.VectorSourceDestBuffer()
        for name, values in columns.items():
            buffers.append(lib.SourceDestBuffer(written.image_file, name, values, len(values), True, True))
        writer = points.writer(buffers)
        writer.write(len(POINTS))
        writer.close()
    np.testing.assert_allclose(load_cloud(tmp_path / "scan.e57"), POINTS, atol=1e-12)


def test_a_pcd_cloud_with_a_viewpoint_is_not_moved_but_named(tmp_path):
    file = pcd(tmp_path / "scan.pcd")
    file.write_bytes(file.read_bytes().replace(b"VIEWPOINT 0.0 0.0 0.0 1.0", b"VIEWPOINT 0.0 0.0 1.5 1.0", 1))
    with pytest.warns(Note, match="its VIEWPOINT is not applied: 0 0 1.5 1 0 0 0"):
        assert np.array_equal(load_cloud(file), POINTS)


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
@pytest.mark.parametrize("count", [39, 41])
def test_a_pcd_cloud_with_another_number_of_points_is_refused(tmp_path, encoding, count):
    file = pcd(tmp_path / "scan.pcd", encoding)
    text = file.read_bytes()
    for key in (b"WIDTH", b"POINTS"):
        text = text.replace(key + b" 40", key + b" %d" % count, 1)
    file.write_bytes(text)
    assert f"the header declares {count} points, the file contains 40" in refusal(file)


@pytest.mark.parametrize("encoding", ["binary", "binary_compressed"])
def test_bytes_after_the_last_point_of_a_pcd_cloud_are_padding_or_damage(tmp_path, encoding):
    file = pcd(tmp_path / "scan.pcd", encoding)
    content = file.read_bytes()
    file.write_bytes(content + bytes(100))
    with pytest.warns(Note, match="scan.pcd: 100 bytes after the last of 40 points are ignored"):
        np.testing.assert_allclose(load_cloud(file), POINTS, atol=1e-6)
    file.write_bytes(content + b"end")
    assert "damaged: it has 3 bytes more than its header declares" in refusal(file)


SPOILED = np.where(np.arange(40)[:, None] == 4, [0.5, np.nan, 0.5], POINTS)


@pytest.mark.parametrize("ending", [".xyz", ".csv", ".txt", ".npy", ".pcd", ".ply", ".obj"])
def test_nan_points_are_ignored_with_their_number_in_every_format(tmp_path, ending):
    file = tmp_path / f"scan{ending}"
    rows = "\n".join(" ".join(map(str, row)) for row in SPOILED.tolist()) + "\n"
    header = "ply\nformat ascii 1.0\nelement vertex 40\n" + "".join(f"property double {axis}\n" for axis in "xyz")
    if ending == ".npy":
        np.save(file, SPOILED)
    elif ending == ".pcd":
        pcd(file, points=SPOILED)
    elif ending == ".obj":
        file.write_text("".join(f"v {row}\n" for row in rows.splitlines()))
    else:
        file.write_text(f"{header}end_header\n{rows}" if ending == ".ply" else rows)
    with pytest.warns(Note) as said:
        found = load_cloud(file)
    np.testing.assert_allclose(found, np.delete(POINTS, 4, axis=0), atol=1e-6)
    assert f"{file}: 1 of 40 points are NaN and are ignored" in [str(each.message) for each in said]


def test_points_at_the_origin_are_named(tmp_path):
    with pytest.warns(Note, match="10 of 50 points are 0 0 0; delete them if the scanner measured nothing there"):
        load_cloud(pcd(tmp_path / "scan.pcd", points=np.concatenate([POINTS, np.zeros((10, 3))])))


STEP_FAULTS = {
    "cut": (CYLINDER[-60:], "", "damaged: it does not end with END-ISO-10303-21;"),
    "a face that is not there": ("#38=ADVANCED_FACE('',(#37),#35,.T.);", "", "damaged: it refers to #38"),
    "a face without extent": ("CYLINDRICAL_SURFACE('',#34,200.0)", "CYLINDRICAL_SURFACE('',#34,0.0)",
                              "1 of 3 faces cannot be read; repair the part and export it again"),
    "a face without edges": ("EDGE_LOOP('',(#39))", "EDGE_LOOP('',())", "1 of 3 faces cannot be read"),
    "no unit": ("LENGTH_UNIT() ", "", "it states no unit of length"),
}  # fmt: skip


@pytest.mark.parametrize("case", STEP_FAULTS)
def test_a_step_part_that_is_not_complete_is_refused(tmp_path, case):
    old, new, words = STEP_FAULTS[case]
    assert old in CYLINDER
    assert words in refusal(step(tmp_path / "part.step", CYLINDER.replace(old, new)))


def test_curves_of_a_step_part_are_named(tmp_path):
    curve = "#80=GEOMETRIC_CURVE_SET('',(#23));\n#63=ADVANCED"
    text = CYLINDER.replace("#63=ADVANCED", curve).replace("(#62,#58),#5", "(#62,#58,#80),#5")
    with pytest.warns(Note, match="part.step: its 1 sets of curves are ignored, as they have no faces"):
        load_geometry(step(tmp_path / "part.step", text))


def test_the_scans_of_an_e57_file_come_back_in_one_frame(tmp_path):
    """Scans of an E57 file, all in one frame."""
    quarter = np.sqrt([0.5, 0.0, 0.0, 0.5])  # about z
    file = e57(tmp_path / "scan.e57", (np.array([1.0, 0, 0, 0]), np.zeros(3)), (quarter, np.array([1.0, 2.0, 3.0])))
    turned = np.stack([1.0 - POINTS[:, 1], 2.0 + POINTS[:, 0], 3.0 + POINTS[:, 2]], axis=1)
    np.testing.assert_allclose(load_cloud(file), np.concatenate([POINTS, turned]), atol=1e-6)  # pye57 writes floats


@pytest.mark.parametrize("unit, size", [(MILLIMETRE, 200.0), (METRE, 0.2), (INCH, 7.874015748)])
def test_a_step_part_comes_in_metres_whatever_its_unit(tmp_path, capfd, unit, size):
    """Triangles of a STEP part in metres, for every unit; at most 0.05 mm from a curved face."""
    assert CYLINDER.count(MILLIMETRE) == 1
    text = CYLINDER.replace(MILLIMETRE, unit).replace("200.0", str(size)).replace("900.0", str(4.5 * size))
    triangles = read_part(step(tmp_path / "part.stp", text), ".stp")
    np.testing.assert_allclose(triangles.min(axis=(0, 1)), [-0.2, -0.2, 0.0], atol=5e-5)
    np.testing.assert_allclose(triangles.max(axis=(0, 1)), [0.2, 0.2, 0.9], atol=5e-5)
    inner = np.einsum("ck,fkx->fcx", np.random.default_rng(0).dirichlet(np.ones(3), 200), triangles).reshape(-1, 3)
    side = np.ptp(triangles[:, :, 2], axis=1).repeat(200) > 0.1
    depth = 0.2 - np.hypot(*inner[side, :2].T)
    assert -1e-6 < depth.min() and 1e-6 < depth.max() < 5e-5
    assert capfd.readouterr() == ("", "")


def test_a_step_part_is_a_mesh_like_any_other(tmp_path):
    """Points on a STEP part, as on any other mesh."""
    points = load_cloud(step(tmp_path / "part.STEP"), spacing=0.02)
    outside = np.maximum(np.hypot(*points[:, :2].T) - 0.2, np.abs(points[:, 2] - 0.45) - 0.45)
    assert len(points) > 1000 and np.abs(outside).max() < 5e-5


@pytest.mark.parametrize(
    ("old", "new"), [(b"COUNT 1 1 1", b"COUNT 1 1 1000000000"), (b"POINTS 40", b"POINTS 4000000000")]
)
def test_a_pcd_that_promises_more_than_it_can_hold_is_refused_before_it_is_laid_out(tmp_path, old, new):
    """PCD headers that announce too much: refused before memory is allocated (regression: 3.9 GB and 53 s)."""
    file = pcd(tmp_path / "scan.pcd")
    assert old in file.read_bytes()
    file.write_bytes(file.read_bytes().replace(old, new).replace(b"WIDTH 40", b"WIDTH 4000000000"))
    assert "do not fit into" in refusal(file)


@pytest.mark.parametrize("ending", WRITE)
def test_without_the_extra_one_line_says_how_to_get_it(tmp_path, monkeypatch, capsys, ending):
    """Error without the optional library: one line that names the extra, exit code 2."""
    monkeypatch.chdir(tmp_path)
    WRITE[ending](Path(f"part{ending}"))
    Path("seam.csv").write_text("0,0,0\n")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert main(["plan", "--set", f"workpiece.cloud=part{ending}", "--set", "workpiece.path=seam.csv"]) == 2
    extra = "cad" if ending in PARTS else "scan"
    assert capsys.readouterr().err == (
        f'htcp: part{ending}: reading {ending} needs the extra "{extra}": {install_command(extra)}\n'
    )


@pytest.mark.parametrize("ending", [".pcd", ".las", ".e57", ".step"])
def test_garbage_and_damage_give_one_line_and_print_nothing(tmp_path, capfd, ending):
    file = WRITE[ending](tmp_path / f"scan{ending}")
    good = file.read_bytes()
    for content in (b"", pickle.dumps(POINTS) + b"\xff\xfe\x1b[2J", good[: len(good) * 2 // 3]):
        file.write_bytes(content)
        assert "not a readable" in refusal(file)
    assert capfd.readouterr() == ("", "")


def test_no_file_and_no_regular_file(tmp_path):
    for ending in WRITE:
        assert refusal(tmp_path / f"missing{ending}") == "no such file"
    os.mkfifo(tmp_path / "pipe.e57")  # opening it would block without end
    assert refusal(tmp_path / "pipe.e57") == "not a regular file"


CRASH = "import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)\n"
HANG = "import time\ntime.sleep(60)\n"
PRINT = "print('a parser that talks')\nraise BaseException('a panic\\nin two lines')\n"


@pytest.mark.parametrize("parser, words", [
    (CRASH, "not a readable .las file (its parser ended with SIGSEGV)"),
    (PRINT, "not a readable .las file (BaseException: a panic in two lines)"),
])  # fmt: skip
def test_a_parser_may_crash_and_talk(tmp_path, monkeypatch, capfd, parser, words):
    (tmp_path / "laspy.py").write_text(parser)
    file = las(tmp_path / "scan.las")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert words in refusal(file)
    assert capfd.readouterr() == ("", "")


def test_a_parser_that_hangs_is_ended(tmp_path, monkeypatch):
    (tmp_path / "laspy.py").write_text(HANG)
    file = las(tmp_path / "scan.las")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(InputError, match="not read within"):
        parsed(file, SCANS[".las"], longest_s=2)


def test_a_header_that_promises_too_much_takes_neither_time_nor_memory(tmp_path):
    """Headers that announce too much: refused at once.

    laspy would look for four thousand million records, pypcd4 allocate memory for as many points.
    """
    data = bytearray(las(tmp_path / "scan.las").read_bytes())
    data[100:104] = b"\xff\xff\xff\xff"
    (tmp_path / "scan.las").write_bytes(data)
    assert "it declares more variable length records than fit into the file" in refusal(tmp_path / "scan.las")
    text = pcd(tmp_path / "scan.pcd").read_bytes()
    for promised in (b"9999999999", b"41"):
        (tmp_path / "scan.pcd").write_bytes(text.replace(b"POINTS 40", b"POINTS " + promised))
        assert "not a readable .pcd file" in refusal(tmp_path / "scan.pcd")
