"""Path files as other programs export them, and parts in coordinates of a map."""

import warnings

import numpy as np
import pytest

from htcp_jax.cli import main
from htcp_jax.errors import InputError, Note
from htcp_jax.io.parts.path_file import read_path_points
from htcp_jax.io.parts.point_cloud import read_points
from htcp_jax.io.parts.workpiece_source import GeneratedDuct, NoCloud, PointCloud, TriangleMesh, load_workpiece

RNG = np.random.default_rng(1)
POINTS = RNG.uniform(-0.5, 0.5, (6, 3))
NORMALS = (lambda n: n / np.linalg.norm(n, axis=1, keepdims=True))(RNG.normal(size=(6, 3)))
QUATERNIONS = (lambda q: q / np.linalg.norm(q, axis=1, keepdims=True))(RNG.normal(size=(6, 4)))
NUMBERS = np.arange(1.0, 7.0)[:, None]
MAP = np.array([500_321.0, 4_600_123.0, 312.0])
EAST = np.array([10_000.0, 0.0, 0.0])


def write(folder, header, *columns, separator=","):
    rows = np.concatenate(columns, axis=1)
    lines = [separator.join(f"{value:.17g}" for value in row) for row in rows]
    file = folder / "path.csv"
    file.write_text(header + "\n".join(lines) + "\n")
    return file


def read(file, **choices):
    """Points and frames of a path's file, and the warnings about it."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = read_path_points(file, **choices)
    return found, [(one.category, str(one.message).removeprefix(f"{file}: ")) for one in said]


def refusal(file, **choices) -> str:
    with pytest.raises(InputError) as error:
        read(file, **choices)
    assert "\n" not in str(error.value)
    return str(error.value).removeprefix(f"{file}: ")


@pytest.mark.parametrize("header, per_metre", [
    ("x,y,z", 1), ("X,Y,Z", 1), ("x_m,y_m,z_m", 1), ("x_mm,y_mm,z_mm", 1e3), ("X [mm],Y [mm],Z [mm]", 1e3),
    ("X (cm),Y (cm),Z (cm)", 1e2), ("x [in],y [in],z [in]", 1 / 0.0254), ('"x [mm]","y [mm]","z [mm]"', 1e3),
    ("px,py,pz", 1), ("position.x,position.y,position.z", 1), ("Pos X,Pos Y,Pos Z", 1),
    ("tcp_x_mm,tcp_y_mm,tcp_z_mm", 1e3),
    ("pose.position.x,pose.position.y,pose.position.z", 1), ("x,y,z [mm]", 1e3),
    ("x [inch],y,z", 1 / 0.0254), ("[x],[y],[z]", 1),
    ('"Points:0","Points:1","Points:2"', 1), ("Points_0,Points_1,Points_2", 1), ("X/mm,Y/mm,Z/mm", 1e3),
    ("X in mm,Y in mm,Z in mm", 1e3),
    ("field.pose.pose.position.x,field.pose.pose.position.y,field.pose.pose.position.z", 1),
    ("/arm/tcp/position/x,/arm/tcp/position/y,/arm/tcp/position/z", 1), ("East,North,Up", 1),
    ("transform.translation.x,transform.translation.y,transform.translation.z", 1),
])  # fmt: skip
@pytest.mark.parametrize("separator", [",", ";"])
def test_common_headers_name_coordinates_and_their_unit(tmp_path, header, per_metre, separator):
    header = separator.join(["No", *header.split(",")]) + "\n"
    found, said = read(write(tmp_path, header, NUMBERS, per_metre * POINTS, separator=separator))
    assert np.allclose(found.xyz, POINTS, rtol=1e-15, atol=0) and said == []


@pytest.mark.parametrize("before", ["# timestamp tx ty tz qx qy qz qw\n", "timestamp tx ty tz qx qy qz qw\n",
                                    "# a run\n#time tx ty tz q_x q_y q_z q_w\n"])  # fmt: skip
def test_tx_ty_tz_next_to_a_quaternion_are_coordinates(tmp_path, before):
    times = 0.25 * NUMBERS
    found, said = read(write(tmp_path, before, times, POINTS, QUATERNIONS[:, [1, 2, 3, 0]], separator=" "))
    plain, _ = read(write(tmp_path, "x,y,z,qw,qx,qy,qz\n", POINTS, QUATERNIONS))
    assert np.array_equal(found.xyz, POINTS) and found.frames.tangents is None and said == []
    assert np.array_equal(found.frames.rotations, plain.frames.rotations)


def test_tx_ty_tz_next_to_x_y_z_are_tangents(tmp_path):
    found, _ = read(write(tmp_path, "x,y,z,tx,ty,tz,qw,qx,qy,qz\n", POINTS, NORMALS, QUATERNIONS))
    assert np.array_equal(found.xyz, POINTS) and np.allclose(found.frames.tangents, NORMALS)


def test_tx_ty_tz_may_be_chosen_as_coordinates(tmp_path):
    file = write(tmp_path, "t,tx,ty,tz,n\n", NUMBERS, POINTS, NUMBERS)
    found, said = read(file, chosen={"x": "tx", "y": "ty", "z": "tz"})
    assert np.array_equal(found.xyz, POINTS) and found.frames.tangents is None and said == []


@pytest.mark.parametrize("header", ["time,lat,lon,alt\n", "#time,lat,lon,alt\n", "%time,lat,lon,alt\n", "t,tx,ty,tz\n"])
def test_a_header_that_names_none_of_x_y_z_is_refused_with_its_columns_and_the_key(tmp_path, header):
    file = write(tmp_path, header, NUMBERS, POINTS)
    listed = header.strip("#%\n").replace(",", ", ")
    assert refusal(file).startswith(f"the header names none of x, y, z: {listed}; name x, y and z in the header")
    assert "workpiece.path_columns" in refusal(file)
    assert np.array_equal(read(file, chosen={"x": 2, "y": 3, "z": 4})[0].xyz, POINTS)


@pytest.mark.parametrize("header", ["# tx ty tz qx qy qz qw\n", "# x y\n# qw qx qy qz nx ny nz x y z\n"])
def test_a_comment_of_known_names_for_another_number_of_columns_is_refused(tmp_path, header):
    words = refusal(write(tmp_path, header, 0.25 * NUMBERS, POINTS, QUATERNIONS, separator=" "))
    assert words.startswith("the header names ") and "the rows have 8" in words


@pytest.mark.parametrize("header", ["# made by hand\n", "# lat lon alt\n", "Seam of housing 3b\n"])
def test_a_comment_or_title_that_names_no_column_is_named(tmp_path, header):
    found, said = read(write(tmp_path, header, POINTS, separator=" "))
    assert np.array_equal(found.xyz, POINTS)
    assert [kind for kind, _ in said] == [Note] and header.strip("#\n ") in said[0][1]


def test_a_header_may_be_separated_by_tabs(tmp_path):
    file = write(tmp_path, "Time [s]\tPos X [mm]\tPos Y [mm]\tPos Z [mm]\n", NUMBERS, 1e3 * POINTS, separator="\t")
    assert np.allclose(read(file)[0].xyz, POINTS, rtol=1e-15, atol=0)


@pytest.mark.parametrize("header", [
    "x,y,z,v\nmm,mm,mm,mm/s\n", "v,x,y,z\n[mm/s],[mm],[mm],[mm]\n", "# x,y,z,v\n# mm,mm,mm,mm/s\n",
    "# unit: mm\nx,y,z,v\n", "% unit mm\nx,y,z,v\n",
    "# Einheit: mm\nx,y,z,v\n", "// made by hand, units = mm\n# x,y,z,v\n",
    "# all lengths in mm\nx,y,z,v\n", "# coordinates [mm]\nx,y,z,v\n", "# Units: millimeters, deg\nx,y,z,v\n",
    "# speed in m/s\n# Units: mm\nx,y,z,v\n",
])  # fmt: skip
def test_a_row_of_units_and_a_comment_state_the_unit(tmp_path, header):
    columns = [NUMBERS + 0.5, 1e3 * POINTS] if header.startswith("v") else [1e3 * POINTS, NUMBERS]
    found, said = read(write(tmp_path, header, *columns))
    assert np.allclose(found.xyz, POINTS, rtol=1e-15, atol=0) and said == []


@pytest.mark.parametrize("header, words", [
    ("x,y,z\nmm,mm,m\n", "coordinates in mm and m: x, y, z"),
    ("x [m],y [m],z [m]\nmm,mm,mm\n", "the unit of x [m] is mm in the row below the header"),
    ("x,y,z\nfurlong,mm,mm\n", "line 2: 'furlong' is not a number"),
])  # fmt: skip
def test_a_row_of_units_that_contradicts_is_refused(tmp_path, header, words):
    assert refusal(write(tmp_path, header, POINTS)) == words


@pytest.mark.parametrize("header, units", [
    ("# unit: mm\nx [m],y [m],z [m]\n", "m and mm"), ("# unit: mm\n# unit: m\nx,y,z\n", "mm and m"),
])  # fmt: skip
def test_stated_units_that_contradict_each_other_are_refused_unless_the_job_states_one(tmp_path, header, units):
    file = write(tmp_path, header, 1e3 * POINTS)
    assert refusal(file).startswith(f"the unit in the header is '{units}'; valid: m, mm")
    assert np.allclose(read(file, unit="mm")[0].xyz, POINTS)


def test_a_unit_below_the_rows_counts(tmp_path):
    file = write(tmp_path, "x,y,z\n", 1e3 * POINTS)
    file.write_text(file.read_text() + "# unit: mm\n")
    assert np.allclose(read(file)[0].xyz, POINTS)


@pytest.mark.parametrize("comment", ["coordinates in robot frame", "units: deg, s", "gap in mm", "speed unit: mm/s",
                                     "points in the plane, 3 mm apart", "unit vectors"])  # fmt: skip
def test_a_comment_about_something_else_states_no_unit_of_length(tmp_path, comment):
    assert np.array_equal(read(write(tmp_path, f"# {comment}\nx,y,z\n", POINTS))[0].xyz, POINTS)


def test_numbers_in_quotes_are_read(tmp_path):
    rows = "".join(",".join(f'"{value!r}"' for value in row) + "\n" for row in POINTS.tolist())
    (tmp_path / "path.csv").write_text('"x","y","z"\n' + rows)
    assert np.array_equal(read(tmp_path / "path.csv")[0].xyz, POINTS)
    (tmp_path / "path.csv").write_text('"x","y","z"\n"1,5","2,5","3,5"\n')
    assert refusal(tmp_path / "path.csv") == "line 2: '1,5' has a decimal comma; write a decimal point, 1.5"


@pytest.mark.parametrize(
    "header", ["sep=,\nx,y,z\n", "Point #,X,Y,Z\n", "#,x,y,z\n", ",x,y,z\n", "Nr.,xpos,ypos,zpos\n"]
)
def test_headers_of_spreadsheets_and_point_lists_are_read(tmp_path, header):
    columns = [POINTS] if header.startswith("sep") else [10 * NUMBERS, POINTS]
    found, said = read(write(tmp_path, header, *columns))
    assert np.array_equal(found.xyz, POINTS) and said == []


def test_a_title_above_the_header_is_named(tmp_path):
    found, said = read(write(tmp_path, "Export of Monday\nz [mm],y [mm],x [mm]\n", 1e3 * POINTS[:, ::-1]))
    assert np.allclose(found.xyz, POINTS, rtol=1e-15, atol=0)
    assert said == [(Note, "the first line is a title, not a header: 'Export of Monday'")]


def test_a_comment_below_a_title_names_the_columns(tmp_path):
    file = write(tmp_path, "Left seam of housing\n# z y x\n", POINTS[:, ::-1], separator=" ")
    assert np.array_equal(read(file)[0].xyz, POINTS)


@pytest.mark.parametrize("names, there, lacking", [
    ("nx,ny,n", "nx, ny", "nz"), ("qx,qy,qz", "qx, qy, qz", "qw"), ("tx,t,tz", "tx, tz", "ty"),
    ("A,B,speed", "a, b", "c"), ("O,A,speed", "o, a", "t"),
    ("rx,ry,speed", "rx, ry", "rz"),
])  # fmt: skip
def test_columns_that_lack_others_of_their_kind_are_named(tmp_path, names, there, lacking):
    found, said = read(write(tmp_path, f"x,y,z,{names}\n", POINTS, NORMALS))
    assert all(field is None for field in found.frames)
    assert said == [(Note, f"columns {there} are not read, as there is no {lacking}")]


def test_a_second_set_of_normals_is_named(tmp_path):
    found, said = read(write(tmp_path, "x,y,z,nx,ny,nz,i,j,k\n", POINTS, NORMALS, NORMALS[::-1]))
    assert np.allclose(found.frames.normals, NORMALS) and said[0][1] == "nx ny nz are read, and i j k ignored"


@pytest.mark.parametrize("names, text", [
    ("qw,qx,qy,qz,W,P,R", "qw qx qy qz are read, and w p r ignored"),
    ("a,b,c,W,P,R,speed", "w p r are read, and a b c ignored"),
    ("qw,qx,qy,qz,roll,speed,gap", "column roll is not read, as there is no pitch, yaw"),
    ("qw,qx,qy,qz,roll,pitch,speed", "columns roll, pitch are not read, as there is no yaw"),
])  # fmt: skip
def test_orientations_next_to_others_are_named(tmp_path, names, text):
    found, said = read(write(tmp_path, f"x,y,z,{names}\n", POINTS, QUATERNIONS, NORMALS))
    assert found.frames.rotations is not None and said == [(Note, text)]


def test_a_repeated_name_of_a_quaternion_is_refused_next_to_chosen_coordinates(tmp_path):
    file = write(tmp_path, "x,y,z,qw,qx,qy,qz,qw\n", POINTS, QUATERNIONS, NUMBERS)
    assert refusal(file, chosen={"x": 1, "y": 2, "z": 3}).startswith("the header names qw twice")


def test_colours_and_single_letters_are_no_part_of_angles(tmp_path):
    assert read(write(tmp_path, "x,y,z,r,g,b,a\n", POINTS, QUATERNIONS))[1] == []
    assert read(write(tmp_path, "x,y,z,t,speed,gap\n", POINTS, NORMALS))[1] == []


def test_a_header_between_blanks_has_units_in_brackets(tmp_path):
    found, _ = read(write(tmp_path, "# x [mm] y [mm] z [mm] nx ny nz\n", 1e3 * POINTS, NORMALS, separator=" "))
    assert np.allclose(found.xyz, POINTS, rtol=1e-15, atol=0) and np.allclose(found.frames.normals, NORMALS)


@pytest.mark.parametrize("header, others", [("", []), ("No,East,North,Up\n", []), ("", [NORMALS]), ("x,y,z\n", [])])
@pytest.mark.parametrize("first", [0, 1])
def test_a_first_column_that_counts_the_rows_is_ignored_with_a_note(tmp_path, header, others, first):
    file = write(tmp_path, header, NUMBERS - 1 + first, POINTS, *others)
    found, said = read(file)
    assert np.array_equal(found.xyz, POINTS)
    assert not said or (
        said[0][0] is Note and "the first counts the rows, the next three are taken as x, y, z" in said[0][1]
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Note)
        assert np.array_equal(read_points(file).xyz, POINTS), "a cloud is read alike"


def test_a_straight_seam_with_normals_and_no_header_is_no_numbered_table(tmp_path):
    """Steps of 1 mm count like rows (regression: y, z and nx were read as the point)."""
    points = np.stack([np.arange(5.0), np.full(5, 10.25), np.full(5, 5.5)], axis=1)
    found, said = read(write(tmp_path, "", points, np.tile([0.0, 0.0, 1.0], (5, 1))))
    assert np.array_equal(found.xyz, points) and all("counts the rows" not in text for _, text in said)


def test_normals_chosen_by_number_need_no_header_of_the_same_width(tmp_path):
    file = write(tmp_path, "Point No x y z nx ny nz\n", NUMBERS, POINTS, NORMALS, separator=" ")
    chosen = {name: k for k, name in enumerate(("x", "y", "z", "nx", "ny", "nz"), 2)}
    assert np.allclose(read(file, chosen=chosen)[0].frames.normals, NORMALS)


@pytest.mark.parametrize("column", [NUMBERS + 0.5, 2 * NUMBERS, NUMBERS + 1, NUMBERS[::-1]])
def test_a_first_column_that_does_not_count_from_0_or_1_is_x(tmp_path, column):
    found, _ = read(write(tmp_path, "", column, POINTS))
    assert np.array_equal(found.xyz[:, 0], column[:, 0])


def test_a_single_row_does_not_count(tmp_path):
    assert read(write(tmp_path, "", NUMBERS[:1], POINTS[:1]))[0].xyz[0, 0] == 1.0


def test_a_named_x_is_no_row_number(tmp_path):
    found, said = read(write(tmp_path, "x,y,z,speed\n", NUMBERS, POINTS))
    assert np.array_equal(found.xyz[:, 0], NUMBERS[:, 0]) and said == []


@pytest.mark.parametrize("names", ["qw,qx,qy,qz", "qx,qy,qz,qw", "quat_w,quat_x,quat_y,quat_z"])
def test_quaternions_are_found_by_name_in_any_order(tmp_path, names):
    order = ["wxyz".index(name[-1]) for name in names.split(",")]
    found, _ = read(write(tmp_path, f"x_mm,y_mm,z_mm,{names}\n", 1e3 * POINTS, QUATERNIONS[:, order]))
    plain, _ = read(write(tmp_path, "x,y,z,qw,qx,qy,qz\n", POINTS, QUATERNIONS))
    assert np.array_equal(found.frames.rotations, plain.frames.rotations)


def test_i_j_k_are_normals_if_they_are_unit_vectors(tmp_path):
    found, said = read(write(tmp_path, "x,y,z,i,j,k\n", POINTS, NORMALS))
    assert np.allclose(found.frames.normals, NORMALS) and said == []
    found, said = read(write(tmp_path, "x,y,z,i,j,k\n", POINTS, 3 * NORMALS))
    assert found.frames.normals is None and "i, j, k are ignored" in said[0][1]


def test_columns_are_chosen_by_number_and_by_name(tmp_path):
    file = write(tmp_path, "A;X [mm];Y [mm];Z [mm];U;V;W\n", 7 * NUMBERS, 1e3 * POINTS, NORMALS, separator=";")
    chosen = {"x": 2, "y": "Y [mm]", "z": "z", "nx": "u", "ny": 6, "nz": "W"}
    found, said = read(file, chosen=chosen)
    assert np.allclose(found.xyz, POINTS, rtol=1e-15, atol=0) and np.allclose(found.frames.normals, NORMALS)
    assert said == []


def test_chosen_columns_need_no_header(tmp_path):
    file = write(tmp_path, "", POINTS, QUATERNIONS[:, [1, 2, 3, 0]])
    found, said = read(file, chosen={"x": 3, "y": 2, "z": 1, "qx": 4, "qy": 5, "qz": 6, "qw": 7})
    assert np.array_equal(found.xyz, POINTS[:, ::-1]) and found.frames.rotations is not None and said == []


@pytest.mark.parametrize("chosen, words", [
    ({"x": 5}, "workpiece.path_columns.x is 5: no such column; it has 4 columns: No, X, Y, X"),
    ({"x": "Q"}, "workpiece.path_columns.x is 'Q': no such column; it has 4 columns: No, X, Y, X"),
    ({"x": "X"}, "workpiece.path_columns.x is 'X': 2 columns have this name; it has 4 columns: No, X, Y, X"),
    ({"x": 2, "y": 2}, "workpiece.path_columns.y is 2: column 2 is already used as x"),
])  # fmt: skip
def test_a_chosen_column_that_is_missing_or_ambiguous_is_refused_with_what_there_is(tmp_path, chosen, words):
    file = write(tmp_path, "No,X,Y,X\n", NUMBERS, POINTS)
    assert words in refusal(file, chosen={"x": 2, "y": 3, "z": 4} | chosen)


def test_a_name_without_a_header_is_refused(tmp_path):
    words = refusal(write(tmp_path, "", POINTS), chosen={"x": "X", "y": 2, "z": 3})
    assert words == "workpiece.path_columns.x is 'X': no such column; it has 3 columns, without a header"


@pytest.mark.parametrize("names", ["x_ft,y_ft,z_ft", "X feet,Y feet,Z feet", "A [um],B [um],C [um]"])
def test_chosen_columns_keep_the_unit_of_the_header(tmp_path, names):
    words = refusal(write(tmp_path, f"{names}\n", POINTS), chosen={"x": 1, "y": 2, "z": 3})
    assert words.startswith("the unit in the header is") and "workpiece.path_unit" in words


def test_six_columns_without_a_header_are_points_and_normals(tmp_path):
    file, normals = tmp_path / "path.csv", np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0]])
    np.savetxt(file, np.hstack([POINTS[:2], normals]), delimiter=",")
    with pytest.warns(Note, match="6 columns; the first three are taken as x, y, z, the others as normals"):
        found = read_path_points(file)
    assert np.allclose(found.frames.normals, normals) and np.allclose(found.xyz, POINTS[:2])


def test_a_row_that_ends_within_quotes_is_refused(tmp_path):
    file = tmp_path / "path.csv"
    file.write_text('"0.1","0.2","0.3"\n"0.1","0.2","0.')
    assert refusal(file) == "line 2 has a quote without its end"


def test_comments_that_have_the_form_of_a_row_are_named(tmp_path):
    file = tmp_path / "path.csv"
    file.write_text("x,y,z\n0.1,0.2,0.3\n#REF!,0.25,0.3\n0.2,0.2,0.3\n# a remark, with 2, commas\n")
    with pytest.warns(Note, match="comments in the form of a row are ignored; the first of 1 is line 3"):
        assert len(read_path_points(file).xyz) == 2


@pytest.mark.parametrize("header, words", [
    ("x,y,z,nx,ny,nz,nx", "the header names nx twice: x, y, z, nx, ny, nz, nx"),
    ("x,y,z,qw,qx,qy,qw", "the header names qw twice"),
    ("x,y,z,X [mm],b,c,d", "the header names x twice: x, y, z, X [mm], b, c, d"),
    ("a,tcp_x,tcp_y,tcp_z,target_x,target_y,target_z",
     "the header names tcp_x tcp_y tcp_z and target_x target_y target_z"),
    ("a,x,y,h,b,c,d", "the header names no z: a, x, y, h, b, c, d"),
    ("x [mm],y [mm],z [in],b,c,d,e", "coordinates in mm and in: x [mm], y [mm], z [in], b"),
])  # fmt: skip
def test_a_header_that_is_ambiguous_is_refused_with_its_names(tmp_path, header, words):
    assert words in refusal(write(tmp_path, f"{header}\n", POINTS, QUATERNIONS))


@pytest.mark.parametrize("header, unit", [
    ("x [ft],y [ft],z [ft]", "ft"), ("# units: ft\nx,y,z", "ft"), ("# Unit = 0.001 m", "0.001 m"),
    ("X (Feet),y,z", "feet"), ("# x y z [100 mm]", "100_mm"),
])  # fmt: skip
def test_an_unknown_unit_of_a_header_is_refused_unless_the_job_states_one(tmp_path, header, unit):
    file = write(tmp_path, f"{header}\n", POINTS)
    valid = "m, mm, cm, in, or workpiece.path_unit for a path"
    assert refusal(file) == f"the unit in the header is {unit!r}; valid: {valid}"
    assert np.allclose(read(file, unit="in")[0].xyz, 0.0254 * POINTS)


def test_the_job_s_unit_takes_precedence_over_the_header_s_with_a_warning(tmp_path):
    found, said = read(write(tmp_path, "x_m,y_m,z_m\n", 1e3 * POINTS), unit="mm")
    assert np.allclose(found.xyz, POINTS, rtol=1e-15, atol=0)
    assert said == [(UserWarning, "the unit is m in the header and mm in the job; the job's is used")]
    assert read(write(tmp_path, "x,y,z\n", 1e3 * POINTS), unit="mm")[1] == []


@pytest.mark.parametrize("key, value, words", [
    ("path_unit", "furlong", "workpiece.path_unit is 'furlong': input should be 'm', 'mm', 'cm' or 'in'"),
    ("path_columns", "{x: 1, y: 2}", "workpiece.path_columns.z"),
    ("path_columns", "{x: 0, y: 2, z: 3}", "0 is not a column; valid: a number from 1, or a name"),
    ("path_columns", "{x: 1, y: 2, z: 3, nx: 4}", "path_columns has only nx; all of nx, ny, nz are needed"),
    ("path_unit", "mm", "workpiece.path_unit is 'mm', but the path is a seam"),
    ("origin_m", "[1, 2]", "workpiece.origin_m"),
])  # fmt: skip
def test_bad_keys_are_one_line_and_exit_code_2(tmp_path, monkeypatch, capsys, key, value, words):
    monkeypatch.chdir(tmp_path)
    assert main(["plan", "--set", f"workpiece.{key}={value}"]) == 2
    reported = capsys.readouterr().err
    assert words in reported and reported.count("\n") == 1 and not list(tmp_path.iterdir())


# Coordinates of a map

CUBE = np.stack(np.meshgrid(*[np.linspace(-0.3, 0.3, 5)] * 3), axis=-1).reshape(-1, 3)
CORNERS = CUBE[:9].reshape(3, 3, 3)
HERE = {"pivot": (0.0, 0.0, 0.0), "neutral_translation": (0.0, 0.0, 0.0), "interior": "none"}


@pytest.mark.parametrize("source", [PointCloud(CUBE), TriangleMesh(CORNERS, spacing_m=0.1), NoCloud()])
def test_a_part_on_a_map_is_the_part_about_the_origin(source):
    moved = source._replace(points=source.points + MAP) if isinstance(source, PointCloud) else source
    moved = source._replace(triangles=CORNERS + MAP) if isinstance(source, TriangleMesh) else moved
    with pytest.warns(Note, match=r"\(500321, 4600123, 312\) m is subtracted from cloud, path and inlet"):
        far = load_workpiece(moved, POINTS + MAP, inlet=MAP + 0.1, **HERE)
    near = load_workpiece(source, POINTS, inlet=(0.1, 0.1, 0.1), **HERE)
    assert np.array_equal(far.origin, MAP) and not near.origin.any()
    for name in ("path", "inlet", "triangles") + (("cloud",) if isinstance(source, PointCloud) else ()):
        assert np.allclose(getattr(far, name), getattr(near, name), atol=2e-9), name


def test_a_part_that_is_10_km_away_at_most_stays_where_it_is():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        part = load_workpiece(PointCloud(CUBE + EAST), POINTS + EAST, **HERE)
    assert not part.origin.any() and part.path[0, 0] > 9_999


def test_the_origin_may_be_given():
    part = load_workpiece(PointCloud(CUBE), POINTS, origin=(0.1, 0.2, 0.3), inlet=(0.1, 0.2, 0.3), **HERE)
    assert np.array_equal(part.cloud, CUBE - (0.1, 0.2, 0.3)) and not part.inlet.any()
    stays = load_workpiece(PointCloud(CUBE + MAP), POINTS + MAP, origin=(0.0, 0.0, 0.0), **HERE)
    assert np.array_equal(stays.path, POINTS + MAP)
    with pytest.raises(InputError, match="origin_m applies to files only"):
        load_workpiece(GeneratedDuct(100), origin=(1.0, 0.0, 0.0))


@pytest.mark.filterwarnings("ignore::htcp_jax.errors.Note")
def test_coordinates_of_a_map_in_32_bits_are_reported_and_refused_where_they_are_too_coarse():
    def rounded(origin):
        return PointCloud((CUBE + origin).astype(np.float32).astype(float)), POINTS + origin

    with pytest.raises(InputError, match=r"32-bit numbers, rounded to 500 mm .* relative to a point near the part"):
        load_workpiece(*rounded(MAP), **HERE)
    with pytest.warns(UserWarning, match="32-bit numbers, rounded to 0.977 mm"):
        load_workpiece(*rounded(np.array([12_000.0, 0, 0])), **HERE)
