"""APT sources and CLS files as paths: points to the digit, contours as seams, and what is refused with its line."""

import warnings
from pathlib import Path
from random import Random

import numpy as np
import pytest

from htcp_jax.errors import InputError, Note
from htcp_jax.io.parts import load_workpiece, read_path_points
from htcp_jax.io.robots.loading import gp50
from htcp_jax.jobs import load_config
from htcp_jax.jobs.resolve import with_seams
from htcp_jax.jobs.seam_paths import points_of_seams

START = "UNITS/MM\nRAPID\nGOTO/0,0,0\nFEDRAT/600,MMPM\n"
PER_METRE = {"MM": 1e3, "INCHES": 1 / 0.0254, "CM": 1e2}


def read(folder: Path, text: str, name: str = "part.apt", **how):
    """The path in a text; notes are not errors."""
    (folder / name).write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Note)
        return read_path_points(folder / name, **how)


def number(draw: Random, value: float) -> str:
    """A number as one of the systems writes it; the value has four decimals."""
    form = draw.choice(["f", "bare", "E", "D", "point"])
    if form == "E" or form == "D":
        mantissa, exponent = f"{value:.8E}".split("E")
        return f"{mantissa}{form}{int(exponent):+03d}"
    text = f"{value:.4f}"
    if form == "bare":
        return text.replace("0.", ".", 1) if abs(value) < 1 else text.rstrip("0")
    return f"+{text}" if form == "point" and value > 0 else text


def record(draw: Random, word: str, cells: list[str]) -> str:
    """A record with blanks, on one line or continued, with comments."""
    slash = draw.choice(["/", " / ", "/ ", "  /   "])
    parts = [cells[0]]
    for cell in cells[1:]:
        parts.append(draw.choice([",", ", ", ",  ", ",$\n   ", " , $ continued\n"]) + cell)
    return f"{draw.choice(['', '  '])}{word}{slash}{''.join(parts)}{draw.choice(['', '', ' $$ a comment, GOTO/1,2,3'])}"


def generated(seed: int):
    """A file, and its contours: points [m], axes and the feed [m/s]."""
    draw = Random(seed)
    unit = draw.choice([*PER_METRE])
    scale, with_axes = PER_METRE[unit], seed % 3 != 0
    lines = ["PARTNO GENERATED $ 7", f"{draw.choice(['UNITS / ', 'UNITS/'])}{unit}", "$$ GOTO/9,9,9", "MULTAX/ON"]
    contours, axis = [], np.array([0.0, 0, 1])

    def point(word: str):
        nonlocal axis
        xyz = np.array([round(draw.uniform(-500, 500), 4) for _ in range(3)])
        cells = [number(draw, value) for value in xyz.tolist()]
        if with_axes and (not contours or draw.random() < 0.7):
            tilted = np.array([round(draw.gauss(0, 0.3), 6), round(draw.gauss(0, 0.3), 6), 1.0])
            axis = np.round(tilted / np.linalg.norm(tilted), 9)
            cells += [f"{value:.9f}" for value in axis.tolist()]
        lines.append(record(draw, word, cells))
        return xyz / scale, axis / np.linalg.norm(axis)

    at = point("FROM")
    for _ in range(draw.randint(1, 5)):
        for _ in range(draw.randint(1, 3)):
            lines.append(draw.choice(["RAPID", " RAPID  ", "RAPID $$ up"]))
            at = point("GOTO")
        mm_min = draw.randint(100, 6000)
        lines.append(
            draw.choice([f"FEDRAT/ {mm_min}.0000,MMPM", f"FEDRAT/MMPM,{mm_min}", f"FEDRAT / {mm_min}. , MMPM"])
        )
        lines += draw.choice([[], ["SPINDL/ 70.0,RPM,CLW"], ["PPRINT GOTO/1,2,3"], ["COOLNT/ON", "REMARK move"]])
        contour = [at, *(point("GOTO") for _ in range(draw.randint(1, 40)))]
        at = contour[-1]
        contours.append((np.array([p for p, _ in contour]), np.array([a for _, a in contour]), mm_min / 60e3))
    lines.append("FINI")
    return "\n".join(lines) + "\n", contours, with_axes


@pytest.mark.parametrize("seed", range(20))
def test_a_generated_file_reads_to_the_digit(seed, tmp_path):
    text, contours, with_axes = generated(seed)
    found = read(tmp_path, text, ("part.apt", "part.cls", "PART.APTSOURCE")[seed % 3])
    assert found.xyz.tolist() == np.concatenate([xyz for xyz, _, _ in contours]).tolist()
    assert [each.count for each in found.seams] == [len(xyz) for xyz, _, _ in contours]
    assert found.feeds_m_s == pytest.approx([feed for _, _, feed in contours], rel=1e-12)
    if with_axes:
        axes = np.concatenate([axes for _, axes, _ in contours])
        assert np.abs(found.frames.normals - axes).max() < 1e-15
    else:
        assert found.frames.normals is None


def test_a_contour_begins_where_its_first_move_at_a_feed_begins_and_rapids_divide(tmp_path):
    moves = "GOTO/1,0,0\nGOTO/2,0,0\nRAPID\nGOTO/2,0,9\nGOTO/3,0,0\nGODLTA/0,1,0\n"
    found = read(tmp_path, START + moves)
    assert (1e3 * found.xyz).round(9).tolist() == [[0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 0, 9], [3, 0, 0], [3, 1, 0]]
    assert [tuple(seam) for seam in found.seams] == [("1", 0, 3), ("2", 3, 3)]


def test_the_tool_axis_holds_until_it_changes_and_begins_with_z(tmp_path):
    found = read(tmp_path, f"{START}GOTO/1,0,0\nTLAXIS/0,1,0\nGOTO/2,0,0\nGOTO/3,0,0,0,0,-1\nMULTAX/OFF\nGOTO/4,0,0\n")
    assert found.frames.normals.tolist() == [[0, 0, 1], [0, 0, 1], [0, 1, 0], [0, 0, -1], [0, 0, -1]]


def test_a_wrong_unit_in_a_file_is_named_with_the_right_one(tmp_path):
    (tmp_path / "weld.apt").write_text("UNITS/INCHES\nRAPID\nGOTO/0,0,0,0,0,1\nGOTO/300,0,0\nGOTO/300,300,0\nFINI\n")
    cube = 0.3 * np.random.default_rng(0).random((400, 3))
    said = "it was read as inches, but seems to be in millimetres; set workpiece.path_unit: mm$"
    with pytest.raises(InputError, match=said):
        load_workpiece(cube, read_path_points(tmp_path / "weld.apt"), interior="none", robot=gp50())


def test_two_units_in_one_file_are_refused_with_both_lines(tmp_path):
    (tmp_path / "weld.apt").write_text("UNITS/MM\nUNITS/INCHES\nRAPID\nGOTO/0,0,0\nGOTO/1,0,0\n")
    with pytest.raises(InputError, match="line 2: UNITS/INCHES, but line 1 has another unit"):
        read_path_points(tmp_path / "weld.apt")


def test_moves_along_the_tools_axis_at_the_ends_of_a_contour_are_no_part_of_the_seam(tmp_path):
    weld = "GOTO/0,0,50,0,0,1\nGOTO/0,0,20\nGOTO/0,0,0\nGOTO/9,0,0\nGOTO/9,9,0\nGOTO/9,9,40\n"
    (tmp_path / "weld.apt").write_text(f"UNITS/MM\nRAPID\n{weld}FINI\n")
    with pytest.warns(Note, match="along the tool's axis, to or from the ends of contours, are not used: 3"):
        found = read_path_points(tmp_path / "weld.apt")
    np.testing.assert_allclose(1e3 * found.xyz, [[0, 0, 0], [9, 0, 0], [9, 9, 0]], atol=1e-12)
    drill = "GOTO/0,0,50,0,0,1\nGOTO/0,0,0\n"
    assert len(read(tmp_path, f"UNITS/MM\nRAPID\n{drill}").xyz) == 2


def test_contours_are_called_as_their_operations(tmp_path):
    nx = "TOOL PATH/RIB,TOOL,MILL\nRAPID\nGOTO/0,0,0\nGOTO/1,0,0\nRAPID\nGOTO/5,0,0\nGOTO/6,0,0\nEND-OF-PATH\n"
    found = read(tmp_path, f"UNITS/MM\n{nx}PPRINT OPERATION NAME : Boss\nRAPID\nGOTO/7,0,0\nGOTO/8,0,0\n")
    assert [seam.label for seam in found.seams] == ["RIB 1", "RIB 2", "Boss"]


@pytest.mark.parametrize(
    ("feed", "mm_s"),
    [
        ("FEDRAT/600", 10), ("FEDRAT/600.,PERMIN", 10), ("FEDRAT/MMPM,1.2E3", 20), ("FEDRAT/60,IPM", 25.4),
        ("FEDRAT/0.2,MMPR", None), ("", None),
    ],
)  # fmt: skip
def test_feeds_are_read_with_their_units(feed, mm_s, tmp_path):
    found = read(tmp_path, f"UNITS/MM\n{feed}\nGOTO/0,0,0\nGOTO/1,0,0\n")
    assert found.feeds_m_s == [None if mm_s is None else pytest.approx(1e-3 * mm_s)]


def test_contours_become_seams_with_their_direction_and_the_feed_of_the_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    two = "GOTO/1,0,0,0,0,1\nRAPID\nGOTO/5,0,0\nFEDRAT/60,MMPM\nGOTO/6,0,0\nFINI\n"
    (tmp_path / "part.apt").write_text(START + two)
    given = ["workpiece.path=part.apt", "workpiece.cloud=none"]
    job = with_seams(load_config(None, given))
    assert [(seam.name, seam.rows, seam.direction, seam.feed) for seam in job.workpiece.seams] == [
        ("1", (0, 2), "forward", "10mm/s"), ("2", (2, 2), "forward", "1mm/s"),
    ]  # fmt: skip
    assert points_of_seams(job.workpiece).begins == (2,)
    own = "{name: a, path: part.apt, rows: [2, 2]}, {name: b, path: part.apt, rows: [0, 2], direction: either}"
    listed = with_seams(load_config(None, ["workpiece.cloud=none", f"seams=[{own}]"]))
    assert [seam.direction for seam in listed.workpiece.seams] == ["forward", "either"]
    stated = with_seams(load_config(None, [*given, "program.feed=3mm/s"]))
    assert [seam.feed for seam in stated.workpiece.seams] == [None, None]
    (tmp_path / "part.apt").write_text(START + "GOTO/1,0,0,0,0,1\nFINI\n")
    assert with_seams(load_config(None, given)).program.feed == "10mm/s"  # of the only contour


def test_the_jobs_unit_precedes_the_files_with_a_warning(tmp_path):
    with pytest.warns(UserWarning, match="the unit is mm in UNITS and cm in the job; the job's is used"):
        assert read(tmp_path, f"{START}GOTO/1,0,0\n", unit="cm").xyz[1, 0] == 0.01
    assert read(tmp_path, "GOTO/0,0,0\nGOTO/1,0,0\n", unit="mm").xyz[1, 0] == 1e-3


def test_what_is_not_used_is_named(tmp_path):
    text = (
        "UNITS/MM\nMSYS/0,0,5,1,0,0,0,1,0\nLOADTL/1\nLOADTL/2\nRAPID\nGOTO/0,0,0\nFEDRAT/60,MMPM\nGOTO/1,0,0\n"
        "FEDRAT/90,MMPM\nGOTO/2,0,0\n"
    )
    (tmp_path / "part.cls").write_text(text)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_path_points(tmp_path / "part.cls")
    notes = " ".join(str(each.message) for each in caught)
    for said in (
        "complete",
        "not used: LOADTL",
        "its frame (MSYS, CSYS, CATIA0) is not applied",
        "2 tools",
        "several feeds along the contour without a name, such as 1, 1.5 mm/s",
    ):
        assert said in notes


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{START}CYCLE/DRILL,5\n", ", line 5: CYCLE moves in a way that cannot be read; let the CAM system"),
        (f"{START}CIRCLE/0,0,0,0,0,1,5\n", ", line 5: CIRCLE moves in a way that cannot be read"),
        (f"{START}ARCSLP/ON\n", ", line 5: ARCSLP moves in a way"),
        (f"{START}TLON,GOFWD/(CIRCLE/0,0,0,$\n5),ON,(LINE/0,0,0,1,1,1)\n", ", line 5: TLON,GOFWD moves in a way"),
        (f"{START}ROTABL/90\n", ", line 5: ROTABL is not known, it may move; only GOTO"),
        (f"{START}TRACUT/1\n", ", line 5: TRACUT is not known"),
        (f"{START}CUTCOM/LEFT\n", ", line 5: CUTCOM moves in a way that cannot be read"),
        (f"{START}MULTAX/3\n", ", line 5: MULTAX is not known"),
        (f"{START}ORIGIN/1,0,0\n", ", line 5: ORIGIN is not known"),
        (f"{START}GOTO/1,2\n", ", line 5: GOTO has 2 values; valid: 3 or 6"),
        (f"{START}GOTO/1,1 5,2\n", ", line 5: GOTO holds '1 5', which is not a number"),
        (f"{START}GOTO/1,1,2,0,0,2\n", ", line 5: the tool axis has the length 2; it must be 1"),
        (f"{START}GOTO/1,1,$\n", ", line 5: the record is continued by $, but the file ends"),
        (f"{START}FEDRAT/0\n", ", line 5: the feed is 0; it must be above 0"),
        (f"{START}FEDRAT/1,FPM\n", ", line 5: FEDRAT/1,FPM cannot be read"),
        ("UNITS/FEET\n", ", line 1: UNITS/FEET is not known; valid: MM, INCH, INCHES, IN, CM"),
        ("GOTO/0,0,0\n", ", line 1: the unit is unknown: UNITS is missing; set workpiece.path_unit"),
        ("UNITS/MM\nGODLTA/0,0,1\n", ", line 2: GODLTA without a position before it"),
        (f"MSYS/0,0,0,1,0,0,0,1,0\n{START}GOTO/1,0,0\nMSYS/0,0,1,1,0,0,0,1,0\n", ", line 7: a second MSYS"),
        ("%\nO0001\nG90 G54\n", ", line 1: G-code is not read: its rotations are the axes of one machine"),
        ("N10 G1 X1 Y2 B30 F500\n", ", line 1: G-code is not read"),
        ("UNITS/MM\nRAPID\nGOTO/0,0,0\n", ": no contour"),
        ("", ": no contour"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_refused_with_its_line(text, message, tmp_path):
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    assert str(caught.value).startswith(f"{tmp_path / 'part.apt'}{message}") and "\n" not in str(caught.value)


def test_g_code_and_columns_are_refused(tmp_path):
    with pytest.raises(InputError, match="G-code is not read"):
        read(tmp_path, "X1\n", "part.nc")
    for text in ("%\nG90\nG21\nG01 X1 Y2 Z3 A10 C20\n", "N10 G1 X1 Y2 Z3\nN20 X2 Y2 Z3\n"):
        with pytest.raises(InputError, match=r"line [23]: G-code is not read"):
            read(tmp_path, text, "part.txt")
    with pytest.raises(InputError, match="line 1: G-code is not read"):
        read(tmp_path, "X1 Y2 Z3 A10 C20\n")
    with pytest.raises(InputError, match=r"workpiece\.path_columns is for tables"):
        read(tmp_path, f"{START}GOTO/1,0,0\n", chosen={"x": 1, "y": 2, "z": 3})
    with pytest.raises(InputError, match=r"unknown ending '\.foo'; valid: \.xyz \.csv \.txt \.apt \.cls"):
        read(tmp_path, "X1\n", "part.foo")
