"""Scans and STEP parts, read by optional libraries; a damaged file gives one line at most."""

import importlib.util
import os
import pickle
from pathlib import Path

import numpy as np
import pytest

from htcp_jax.cli import main
from htcp_jax.errors import InputError, Note
from htcp_jax.io.parts.point_cloud import load_cloud, read_points
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


def las(file, points=POINTS):
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales = [1e-6] * 3
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = points.T
    cloud.write(str(file))
    return file


def e57(file, *scans):
    """Write an E57 file of scans, given as pairs of a quaternion and a translation."""
    with pye57.E57(str(file), mode="w") as written:
        for rotation, translation in scans or [(np.array([1.0, 0, 0, 0]), np.zeros(3))]:
            data = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), POINTS.T.copy(), strict=True))
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
    flat = np.concatenate([POINTS, np.zeros((400, 3))])  # something to compress
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
    points = load_cloud(step(tmp_path / "part.STEP"))
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
        f"htcp: part{ending}: reading {ending} needs the extra \"{extra}\": pip install 'htcp_jax[{extra}]'\n"
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
