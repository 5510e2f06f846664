"""Files of paths with several seams, jumps, and files that may be cut."""

import warnings

import numpy as np
import pytest
from made_once import load_cloud

from htcp_jax.errors import InputError, Note
from htcp_jax.io.parts import NoCloud, load_workpiece
from htcp_jax.io.parts.path_file import read_path_points

LEFT = [f"{0.1 + 0.01 * k:.2f},0.0,0.3" for k in range(6)]
RIGHT = [f"{0.1 + 0.01 * k:.2f},0.08,0.3" for k in range(6)]
PLAIN = np.array([[float(cell) for cell in row.split(",")] for row in LEFT])


def write(folder, text):
    file = folder / "seams.csv"
    file.write_bytes(text.encode())
    return file


def seams_in(file) -> list[tuple]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Note)
        return [tuple(seam) for seam in read_path_points(file).seams]


def read(file):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = read_path_points(file)
    assert all(one.category is Note for one in said)
    return found.xyz, [str(one.message).removeprefix(f"{file}: ") for one in said]


def refusal(file) -> str:
    with pytest.raises(InputError) as error:
        read(file)
    return str(error.value).removeprefix(f"{file}: ")


@pytest.mark.parametrize("between", ["\n", "\r\n \t\n", ",,\n", "\n# the other side\n", "# the other side\n\n\n"])
def test_a_blank_line_between_rows_means_two_seams(tmp_path, between):
    file = write(tmp_path, "\n".join(["x,y,z", *LEFT, ""]) + between + "\n".join([*RIGHT, ""]))
    assert seams_in(file) == [("1", 0, 6), ("2", 6, 6)]


def test_a_part_from_a_file_of_two_seams_is_refused_where_a_path_is_one_seam(tmp_path):
    file = write(tmp_path, "\n".join(["x,y,z", *LEFT, "", *RIGHT, ""]))
    with pytest.raises(InputError, match=r"seams.csv: 2 seams \(rows 1 to 6, rows 7 to 12\); here a path is one seam"):
        load_workpiece(NoCloud(), file)


def test_blank_lines_in_a_cloud_do_not_matter(tmp_path):
    file = write(tmp_path, "\n".join(["x,y,z", *LEFT, "", *RIGHT, ""]))
    assert len(load_cloud(file)) == 12


@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r\r\n", "\n\n", "\r\n\r\n"])
@pytest.mark.parametrize("before, after", [("", ""), ("\n\n", "\n\n"), ("# seam\n\n", " \n\t\n")])
def test_leading_trailing_and_doubled_line_ends_do_not_matter(tmp_path, ending, before, after):
    xyz, said = read(write(tmp_path, before + ending.join(["x,y,z", *LEFT, ""]) + after))
    assert np.array_equal(xyz, PLAIN) and said == []


def test_two_seams_are_found_between_doubled_line_ends(tmp_path):
    text = "\r\r\n".join(["x,y,z", *LEFT, "", *RIGHT, ""])
    assert seams_in(write(tmp_path, text)) == [("1", 0, 6), ("2", 6, 6)]


@pytest.mark.parametrize("name", ["seam", "Seam ID", "SeamID", "seamid", "seam no"])
def test_a_column_seam_that_divides_the_rows_means_several_seams(tmp_path, name):
    rows = [f"{row},{word}" for rows, word in ((LEFT, "A"), (RIGHT, '"B"'), (LEFT, "2.0")) for row in rows]
    file = write(tmp_path, "\n".join([f"x,y,z,{name}", *rows, ""]))
    assert seams_in(file) == [("A", 0, 6), ("B", 6, 6), ("2", 12, 6)]


@pytest.mark.parametrize("name", ["path", "segment_no", "pass", "type", "id", "weld number", "weld line", "WeldLine",
                                  "Arc On", "Naht", "Naht-Nr", "traj_id", "laser", "weldNo"])  # fmt: skip
def test_another_column_that_divides_the_rows_is_refused_with_the_remedy(tmp_path, name):
    rows = [f"{row},{word}" for rows, word in ((LEFT, "A"), (RIGHT, '"B"'), (LEFT, "A")) for row in rows]
    words = refusal(write(tmp_path, "\n".join([f"x,y,z,{name}", *rows, ""])))
    assert words.startswith(f"3 seams (rows 1 to 6, rows 7 to 12, rows 13 to 18), by column {name}; if these are seams")


@pytest.mark.parametrize("name, values", [("seam", ["7"] * 6), ("id", "123456"), ("type", ["1", "1.0", '"1"'] * 2),
                                          ("feed", "112233"), ("weld speed", "112233")])  # fmt: skip
def test_a_column_with_one_value_or_one_for_each_row_is_one_seam(tmp_path, name, values):
    rows = [f"{value},{row}" for row, value in zip(LEFT, values, strict=True)]
    xyz, said = read(write(tmp_path, "\n".join([f"{name},x,y,z", *rows, ""])))
    assert np.array_equal(xyz, PLAIN) and said == []


def test_a_jump_of_many_usual_steps_is_named_with_rows_and_length(tmp_path):
    across = [f"{0.1 + 0.01 * k:.2f},0.12,0.3" for k in range(5, -1, -1)]
    twice = [row for row in (*LEFT, *across) for row in (row, row.replace("0.3", "0.3000001"))]
    assert "from row 12 to 13 by 120 mm" in read(write(tmp_path, "\n".join([*twice, ""])))[1][0]
    _, said = read(write(tmp_path, "\n".join([*LEFT, *across, ""])))
    assert len(said) == 1 and said[0].startswith(
        "the path jumps from row 6 to 7 by 120 mm; its usual step is 10 mm; if"
    )


def test_a_step_of_a_few_usual_ones_and_a_short_one_are_no_jumps(tmp_path):
    assert read(write(tmp_path, "\n".join([*LEFT, "0.24,0.0,0.3", ""])))[1] == []
    assert read(write(tmp_path, "0,0,0\n0,0,1e-4\n0,0,2e-4\n0,0,3e-4\n0,0,9e-3\n"))[1] == []


@pytest.mark.parametrize("end", ["", "\n# end", "\n# end\n", "\n  ", "  "])
def test_a_last_line_without_a_line_end_is_read_with_the_same_note_in_paths_and_clouds(tmp_path, end):
    file = write(tmp_path, "\n".join(["x,y,z", *LEFT]) + end)
    xyz, said = read(file)
    is_cut = end in ("", "\n# end", "  ")
    assert said == ["its last line has no line end; check that the file is complete"] * is_cut
    with warnings.catch_warnings(record=True) as of_cloud:
        warnings.simplefilter("always")
        assert np.array_equal(load_cloud(file), xyz) and np.array_equal(xyz, PLAIN)
    assert [str(one.message).removeprefix(f"{file}: ") for one in of_cloud] == said


def test_a_path_that_is_cut_anywhere_is_refused_or_read_with_a_note_unless_it_ends_with_a_row(tmp_path):
    text = "\n".join(["x,y,z,seam", *(f"{row},1" for row in LEFT), ""])
    for end in range(len("x,y,z,seam\n") + 1, len(text)):
        try:
            xyz, said = read(write(tmp_path, text[:end]))
        except InputError:
            continue
        assert said or text[end - 1] == "\n", text[:end]
        assert len(xyz) <= text[:end].count("\n")
