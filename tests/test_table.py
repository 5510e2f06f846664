"""Tables as written by scanners and CAM programs: more than three columns, in any order, and decimal commas."""

import io
import warnings

import numpy as np
import pytest
from made_once import load_cloud

from htcp_jax.cli import main
from htcp_jax.errors import InputError, Note
from htcp_jax.io.parts.point_cloud import read_points
from htcp_jax.io.parts.workpiece_source import read_path

RNG = np.random.default_rng(0)
POINTS = RNG.uniform(-1.0, 1.0, (40, 3))
NORMALS = (lambda n: n / np.linalg.norm(n, axis=1, keepdims=True))(RNG.normal(size=(40, 3)))
COLOURS = RNG.integers(0, 256, (40, 3))


def table(*columns, separator=" ", header="") -> str:
    rows = np.concatenate(columns, axis=1)
    return header + "\n".join(separator.join(f"{value:.17g}" for value in row) for row in rows) + "\n"


def write(folder, content, name="scan.xyz"):
    file = folder / name
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return file


def read(file):
    """The points read from a file and the notes about it. As a cloud and as a path it gives the same points."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = read_points(file)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Note)
        assert np.array_equal(load_cloud(file), found.xyz)
        if file.suffix != ".npy":
            assert np.array_equal(read_path(file), found.xyz)
    assert all(issubclass(one.category, Note) for one in said)
    return found, [str(one.message).removeprefix(f"{file}: ") for one in said]


def refusal(file) -> str:
    messages = set()
    for reader in (load_cloud, read_path):
        with pytest.raises(InputError) as caught:
            reader(file)
        messages.add(str(caught.value).removeprefix(f"{file}: "))
    (message,) = messages
    assert "\n" not in message
    return message


def npy(array) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def close(normals, expected):
    return normals is not None and np.allclose(normals, expected, atol=1e-12)


@pytest.mark.parametrize("separator", [" ", ",", "; ", "\t"])
def test_six_columns_are_points_and_normals(tmp_path, separator):
    """Six columns: points and normals (regression)."""
    found, said = read(write(tmp_path, table(POINTS, NORMALS, separator=separator)))
    assert np.array_equal(found.xyz, POINTS) and close(found.normals, NORMALS)
    assert said == ["6 columns; the first three are taken as x, y, z, the others as normals"]


@pytest.mark.parametrize("others", [COLOURS, COLOURS[:, :1], np.hstack([NORMALS, COLOURS]), NORMALS[:, :2]])
def test_what_follows_the_points_and_is_no_normal_is_left_out_with_a_note(tmp_path, others):
    """Further columns that are no normals: excluded, with a note (regression: coloured scanner clouds)."""
    found, said = read(write(tmp_path, table(POINTS, others)))
    assert np.array_equal(found.xyz, POINTS) and found.normals is None
    count = 3 + others.shape[1]
    assert said == [f"{count} columns; the first three are taken as x, y, z, and the others ignored"]


def test_a_few_points_without_a_normal_do_not_hide_the_others(tmp_path):
    some = NORMALS * (np.arange(40) != 7)[:, None]
    found, _ = read(write(tmp_path, table(POINTS, some)))
    assert close(found.normals, some)


@pytest.mark.parametrize("header, columns, separator", [
    ("x,y,z,nx,ny,nz\n", (POINTS, NORMALS), ","),
    ("NX;NY;NZ;X [m];Y [m];Z [m]\n", (NORMALS, POINTS), ";"),
    ("//X Y Z R G B Nx Ny Nz\n", (POINTS, COLOURS, NORMALS), " "),
    ("# made by hand\n# x y z normal_x normal_y normal_z\n", (POINTS, NORMALS), " "),
    ('"id","x","y","z","i","j","k"\n', (np.arange(40)[:, None], POINTS, NORMALS), ","),
    ("k,j,i,z,y,x\n", (NORMALS[:, ::-1], POINTS[:, ::-1]), ","),
])  # fmt: skip
def test_a_header_names_the_columns_in_any_order(tmp_path, header, columns, separator):
    """Columns by the names in a header, in any order and without a note (regression)."""
    found, said = read(write(tmp_path, table(*columns, separator=separator, header=header)))
    assert np.array_equal(found.xyz, POINTS) and close(found.normals, NORMALS) and said == []


def test_a_header_turns_three_columns_too(tmp_path):
    found, said = read(write(tmp_path, table(POINTS[:, ::-1], separator=",", header="z,y,x\n")))
    assert np.array_equal(found.xyz, POINTS) and found.normals is None and said == []


def test_columns_that_are_not_asked_for_may_hold_words(tmp_path):
    rows = "".join(f"P{k},{x!r},{y!r},{z!r},seam {k}\n" for k, (x, y, z) in enumerate(POINTS.tolist()))
    found, _ = read(write(tmp_path, "point,x,y,z,of\n" + rows))
    assert np.array_equal(found.xyz, POINTS)
    assert "line 1: 'P0' is not a number" in refusal(write(tmp_path, rows))


@pytest.mark.parametrize("header", ["cloud of the duct\n", "x y z [m]\n", "# x y\n", "// by hand\n"])
def test_a_header_that_names_nothing_else_leaves_the_first_three(tmp_path, header):
    found, _ = read(write(tmp_path, table(POINTS, COLOURS, header=header)))
    assert np.array_equal(found.xyz, POINTS)


@pytest.mark.parametrize("header, words", [
    ("nx,ny,nz,x,y,z,w\n", "the header names 7 columns (nx ny nz x y z w), the rows have 6"),
    ("id,x,y,z,r,g,b\n", "name x, y and z, or put them first"),
    ("y,x,height,r,g,b\n", "the header names no z: y, x, height, r, g, b; name x, y and z in the header"),
    ("a,b,c,d,e,f\n", "the header names none of x, y, z: a, b, c, d, e, f; name x, y and z in the header"),
    ("x,y,z,x,g,b\n", "the header names x twice"),
])  # fmt: skip
def test_a_header_that_does_not_fit_is_refused(tmp_path, header, words):
    assert words in refusal(write(tmp_path, table(POINTS, COLOURS, separator=",", header=header)))


@pytest.mark.parametrize("rows, words", [
    ("1 2 3 4 5 6\n1 2 3 4 5\n", "line 2 has 5 columns, line 1 has 6"),
    ("# c\n\n1 2 3\n1 2 3 4\n", "line 4 has 4 columns, line 3 has 3"),
    ("1,2,3,\n1,2,3\n", "line 2 has 3 columns, line 1 has 4"),
    ("1 2\n", "line 1 has 2 columns, 3 are needed (x y z)"),
    ("1 2 3 4\ninf 2 3 4\n", "line 2 contains NaN or an infinite number"),
])  # fmt: skip
def test_rows_of_different_lengths_are_refused_by_line(tmp_path, rows, words):
    assert words in refusal(write(tmp_path, rows))


@pytest.mark.parametrize("row, first", [
    ("1,234;5,678;9,0", "'1,234' has a decimal comma; write a decimal point, 1.234"),
    ("1,5 2,5 3,5", "'1,5' has a decimal comma; write a decimal point, 1.5"),
    ("1,5\t2,5\t3,5", "'1,5' has a decimal comma"), ("0 2,5 3", "'2,5' has a decimal comma"),
    ("-1,5e-3;2,5;3", "'-1,5e-3' has a decimal comma; write a decimal point, -1.5e-3"),
    ("1.234,5;2;3", "'1.234,5' has a decimal comma; write a decimal point, 1234.5"),
    ("P1;1,5;2,5;3,5", "'1,5' has a decimal comma"), ("1,5;2,5", "'1,5' has a decimal comma"),
])  # fmt: skip
def test_decimal_commas_are_named_in_the_first_row_already(tmp_path, row, first):
    """Error for decimal commas, already in the first row (regression: it silently passed for a header)."""
    assert refusal(write(tmp_path, f"{row}\n" * 5)).startswith(f"line 1: {first}")
    assert refusal(write(tmp_path, f"# c\n{row}\n" * 5)).startswith(f"line 2: {first}")
    assert refusal(write(tmp_path, f"a;b;c\n{row}\n" * 5)).startswith(f"line 2: {first}")


@pytest.mark.parametrize("row", ["1,234,5,678,9,012", "0,1,0,0", "-1,5,2,3,5"])
def test_decimal_commas_among_commas_are_suspected(tmp_path, row):
    """Suspicion of decimal commas among commas: 1,5,2,5,3,5 is ambiguous (regression)."""
    assert refusal(write(tmp_path, f"{row}\n" * 5)).startswith("line 1: all columns contain whole numbers")
    assert "columns" in read(write(tmp_path, f"{row}\n" * 5 + row.replace(",", ".1,") + "\n"))[1][0]


def test_whole_numbers_in_three_columns_or_under_names_are_no_decimal_commas(tmp_path):
    assert read(write(tmp_path, "1,2,3\n" * 4))[0].xyz[0].tolist() == [1.0, 2.0, 3.0]
    assert read(write(tmp_path, "x,y,z,r,g,b\n" + "1,2,3,4,5,6\n" * 4))[0].xyz[0].tolist() == [1.0, 2.0, 3.0]
    assert read(write(tmp_path, "1;2;3;4\n" * 4))[0].xyz[0].tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("others, kept", [(NORMALS, True), (COLOURS, False), (NORMALS[:, :2], False)])
def test_an_array_has_more_columns_too(tmp_path, others, kept):
    """Further columns of an array (regression)."""
    array = np.hstack([POINTS, others])
    found, said = read(write(tmp_path, npy(np.asfortranarray(array)), "scan.npy"))
    assert np.array_equal(found.xyz, POINTS) and (found.normals is not None) is kept
    assert said[0].startswith(f"{array.shape[1]} columns; the first three are taken as x, y, z")


def test_the_command_prints_the_note_in_one_line(tmp_path, capsys, monkeypatch):
    """Note about the columns in one line of the command's output (regression)."""
    monkeypatch.chdir(tmp_path)
    normals = np.tile([0.0, 0.0, 1.0], (2, 1))
    write(tmp_path, table(np.array([[0.1857, -0.1737, 0.1708], [0.19, -0.1738, 0.1705]]), normals), "path.csv")
    assert main(["plan", "--set", "workpiece.path=path.csv"]) == 0
    assert capsys.readouterr().err == (
        "htcp: note: path.csv: 6 columns; the first three are taken as x, y, z, the others as normals\n"
    )
