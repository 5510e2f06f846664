"""Readers of clouds and paths: every listed format is read, and bad files give one-line errors."""

import io
import os
import pickle
import re

import numpy as np
import pytest
import trimesh
from made_once import load_cloud

from htcp_jax.errors import InputError
from htcp_jax.io.parts import load_geometry
from htcp_jax.io.parts.point_cloud import CLOUDS
from htcp_jax.io.parts.scan import PARTS, SCANS

POINTS = np.random.default_rng(0).uniform(-1.0, 1.0, (40, 3))
BOX = trimesh.creation.box(extents=(1.0, 2.0, 3.0))
HERE = [ending for ending in CLOUDS if ending not in SCANS and ending not in PARTS]  # for the others see test_scan


def write(folder, name, content):
    file = folder / name
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return file


def table(separator):
    return "\n".join(separator.join(f"{value:.17g}" for value in row) for row in POINTS) + "\n"


def npy(array):
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def fails(file, *words, **options):
    """Error message of the reader: one line with the file's name and the words."""
    with pytest.raises(InputError) as caught:
        load_cloud(file, **options)
    message = str(caught.value)
    assert "\n" not in message and str(file) in message
    for word in words:
        assert word in message, message
    return message


TABLES = {
    "plain.xyz": table(" "),
    "tabs.txt": table("\t"),
    "commas.csv": table(","),
    "semicolons.csv": table("; "),
    "header.csv": "x,y,z [m]\n" + table(","),
    "comments.csv": "# made by hand\n\n  # twice\nx,y,z\n" + table(",").replace("\n", " # a remark\n", 1),
    "windows.CSV": "\ufeff" + table(",").replace("\n", "\r\n"),
    "mac.txt": table(" ").replace("\n", "\r"),
}


@pytest.mark.parametrize("name", TABLES)
def test_a_text_table_comes_back_exactly(tmp_path, name):
    assert np.array_equal(load_cloud(write(tmp_path, name, TABLES[name])), POINTS)


@pytest.mark.parametrize("order, kind", ["Cd", "Fd", ("C", ">f8"), "Cf", ("C", "i2")])
def test_a_npy_array_comes_back_exactly(tmp_path, order, kind):
    array = np.array(POINTS * 10, dtype=kind, order=order)
    read = load_cloud(write(tmp_path, "cloud.npy", npy(array)))
    assert read.dtype == np.float64 and np.array_equal(read, array)


@pytest.mark.parametrize("encoding", ["binary", "ascii"])
def test_a_ply_without_faces_is_a_cloud(tmp_path, encoding):
    ply = trimesh.PointCloud(POINTS).export(file_type="ply", encoding=encoding)
    np.testing.assert_allclose(load_cloud(write(tmp_path, "cloud.ply", ply)), POINTS, atol=1e-6)


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "obj", "ply"])
def test_a_mesh_is_its_triangles_whatever_the_file(tmp_path, kind):
    file = write(tmp_path, f"box.{kind.split('_')[0]}", BOX.export(file_type=kind))
    found = load_geometry(file)
    assert sorted(map(tuple, found.points.round(6))) == sorted(map(tuple, BOX.triangles.reshape(-1, 3).round(6)))
    points = load_cloud(file, spacing=0.1)
    depth = np.array([0.5, 1.0, 1.5]) - np.abs(points)
    assert np.abs(depth.min(axis=1)).max() < 1e-6  # on a face, not outside
    assert np.array_equal(points, load_cloud(file, spacing=0.1))


def test_an_obj_opens_no_other_file(tmp_path, monkeypatch):
    """Check that references to other files, such as material libraries, are not followed."""
    file = write(tmp_path, "box.obj", "mtllib secret.mtl\n" + BOX.export(file_type="obj"))
    write(tmp_path, "secret.mtl", "newmtl secret\nmap_Kd secret.png\n")
    load_cloud(file, spacing=0.5)  # first, so that trimesh's own imports do not count
    opened = []

    def note(name, *args, **kwargs):
        opened.append(str(name))
        return open(name, *args, **kwargs)

    monkeypatch.setattr(io, "open", note)
    monkeypatch.setattr(os, "open", lambda name, *rest, own=os.open: opened.append(str(name)) or own(name, *rest))
    load_cloud(file, spacing=0.5)
    assert opened == [str(file)]


def test_files_that_are_not_there_or_no_files(tmp_path):
    fails(tmp_path / "missing.csv", "no such file")
    fails(tmp_path / ("x" * 300 + ".csv"), "cannot be read")
    (tmp_path / "folder.csv").mkdir()
    fails(tmp_path / "folder.csv", "not a regular file")
    os.mkfifo(tmp_path / "pipe.xyz")  # opening it would block without end
    fails(tmp_path / "pipe.xyz", "not a regular file")


def test_an_unknown_ending_names_the_valid_ones(tmp_path):
    fails(write(tmp_path, "cloud.dxf", b""), "'.dxf'", *CLOUDS)
    fails(write(tmp_path, "cloud", b""), "''", *CLOUDS)


@pytest.mark.parametrize("line", ["1,inf,2", "1,2,-Infinity", "1e999,2,3"])
def test_a_number_that_is_none_names_its_line(tmp_path, line):
    fails(write(tmp_path, "a.csv", "# c\n1,2,3\n" + line + "\n4,5,6\n"), "line 3", "NaN or an infinite")


def test_an_infinite_number_in_an_array_names_its_row(tmp_path):
    bad = POINTS.copy()
    bad[6, 1] = np.inf
    fails(write(tmp_path, "a.npy", npy(bad)), "row 7", "1 such rows")


@pytest.mark.parametrize("line, words", [
    ("1,2", "line 3 has 2 columns, 3 are needed"), ("1,2,3,4", "line 3 has 4 columns, line 2 has 3"),
    ("1,2,3,", "line 3 has 4"), ("1 2 3 4", "line 3 has 4"), ("x,y,z", "line 3: 'x' is not a number"),
    ("1,,2", "line 3: '' is not"), ("1_0,2,3", "line 3: '1_0' is not a number"), ("0x1,2,3", "line 3: '0x1'"),
])  # fmt: skip
def test_a_bad_line_is_named(tmp_path, line, words):
    fails(write(tmp_path, "a.csv", f"x,y,z\n1,2,3\n{line}\n4,5,6\n"), words)


@pytest.mark.parametrize("content", ["", "# nothing\n", "x,y,z\n", "1,2,3\n4,5,6\n7,8,9\n"])
def test_fewer_than_four_points(tmp_path, content):
    fails(write(tmp_path, "a.csv", content), "at least 4")


@pytest.mark.parametrize("array, words", [
    (POINTS[:, :2], "shape (40, 2)"), (POINTS.ravel(), "shape (120,)"), (POINTS[:3], "at least 4"),
    (POINTS.astype(complex), "complex128"), (np.full((5, 3), "a"), "numbers"),
    (np.ones((5, 3), bool), "bool"),
])  # fmt: skip
def test_wrong_arrays(tmp_path, array, words):
    fails(write(tmp_path, "a.npy", npy(array)), words)


class Bomb:
    def __reduce__(self):
        return (pytest.fail, ("a pickle was run",))


def test_pickles_are_refused_and_never_run(tmp_path):
    stream = io.BytesIO()
    np.save(stream, np.full((5, 3), Bomb(), dtype=object), allow_pickle=True)
    fails(write(tmp_path, "object.npy", stream.getvalue()), "it must be an array of numbers")
    for ending in HERE:
        fails(write(tmp_path, f"pickle{ending}", pickle.dumps(Bomb())))


def test_a_header_that_claims_more_than_the_file_holds_takes_no_memory(tmp_path):
    fails(write(tmp_path, "huge.npy", npy(POINTS).replace(b"(40, 3)", b"(9999999999, 3)", 1)[:400]))
    ply = trimesh.PointCloud(POINTS).export(file_type="ply")
    fails(write(tmp_path, "huge.ply", ply.replace(b"element vertex 40", b"element vertex 99999999999")))


@pytest.mark.parametrize("ending", HERE)
def test_garbage_and_truncation_give_one_line_and_print_nothing(tmp_path, capfd, ending):
    good = {".npy": npy(POINTS), ".ply": BOX.export(file_type="ply"), ".stl": BOX.export(file_type="stl"),
            ".obj": BOX.export(file_type="obj").encode()}.get(ending, table(",").encode())  # fmt: skip
    rng = np.random.default_rng(1)
    for size in range(0, 200, 10):
        fails(write(tmp_path, f"noise{ending}", rng.bytes(size)))
    for cut in (0, 5, 20, len(good) // 4):
        fails(write(tmp_path, f"cut{ending}", good[:cut] + b"\xff\xfe\x1b[2J"))
    assert capfd.readouterr() == ("", "")


def test_a_parsers_own_log_stays_silent(tmp_path, caplog):
    """Check that no log appears: trimesh logs a traceback for a bad normal and ignores it."""
    stl = re.sub(r"normal \S+", "normal abc", BOX.export(file_type="stl_ascii"))
    assert load_cloud(write(tmp_path, "a.stl", stl), spacing=0.5).shape[1] == 3
    assert not caplog.records


def test_words_among_an_ascii_ply_or_stl_are_not_skipped(tmp_path):
    ply = trimesh.PointCloud(POINTS).export(file_type="ply", encoding="ascii")
    fails(write(tmp_path, "a.ply", ply.replace(b"\n0.", b"\nabc 0.", 1)), "not a readable .ply")
    stl = BOX.export(file_type="stl_ascii").replace("vertex ", "vertex abc ", 1)
    fails(write(tmp_path, "a.stl", stl), "not a readable .stl")


@pytest.mark.parametrize("shape", [trimesh.PointCloud(POINTS), BOX])
def test_an_ascii_ply_that_was_cut_off_is_not_taken_for_a_smaller_one(tmp_path, shape):
    lines = shape.export(file_type="ply", encoding="ascii").splitlines(keepends=True)
    fails(write(tmp_path, "a.ply", b"".join(lines[:-3])), "a.ply: ")
    assert len(load_cloud(write(tmp_path, "b.ply", b"".join(lines)), spacing=0.5))


def test_meshes_that_cannot_be_sampled(tmp_path):
    line = "v 0 0 0\nv 1 0 0\nv 2 0 0\n"
    fails(write(tmp_path, "a.obj", line + "f 1 2 3\n"), "no area")
    fails(write(tmp_path, "b.obj", line + "f 1 2 9\n"), "damaged: face 1 has vertex 9; the file has 3 vertices")
    fails(write(tmp_path, "d.obj", "v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n"), "NaN")
    box = write(tmp_path, "box.stl", BOX.export(file_type="stl"))
    fails(box, "more than 3,000,000 points at a spacing of 1e-06 m; increase workpiece.mesh_spacing_m", spacing=1e-6)
    for wrong in (0.0, -1.0, float("nan"), float("inf")):
        fails(box, "must be more than 0", spacing=wrong)


def test_coordinates_beyond_any_sense_are_refused(tmp_path):
    fails(write(tmp_path, "far.npy", npy(1e12 * POINTS)), "which is too large; give metres")
