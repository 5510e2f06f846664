"""LS programs: what is written, what is read, and what is refused with its line."""

import re

import numpy as np
import pytest
from motion_files import controller, hinged, railed, random_motion, read_text, refusal, write
from test_krl import weld

from htcp_jax.errors import InputError
from htcp_jax.io.motions import JobController, read_motion
from htcp_jax.trajectory.controller_data import ProcessOutputs, SeamSpan
from htcp_jax.trajectory.exact_corners import with_exact_corners
from htcp_jax.trajectory.formats.writers import program_text

ROUNDING = np.radians(1e-6)  # of the sum of two rounded angles


def test_joint_positions_read_back_within_the_last_digit_with_their_groups_and_times(tmp_path):
    for arm in (hinged(), railed()):
        rounding = np.where(arm.sliding, 0.5e-9, ROUNDING) * (1 + 1e-9)
        for seed in range(20):
            for j3_from in ("upper_arm", "horizontal"):
                timed, own = random_motion(arm, seed), controller(arm, j3_from=j3_from)
                found = read_motion(write(tmp_path, "ls", timed, own), arm, own)
                assert (np.abs(found.x - timed.x) <= rounding).all()
                assert found.format == "ls" and (len(timed.x) < 2 or np.abs(found.time_s - timed.time_s).max() < 1e-8)
    text = program_text("ls", random_motion(railed(), 3), controller(railed(), name="WELD"))
    assert re.search(r"GP1:\s+UF : 0, UT : 0,\s+J1=.*J6= *\S+ deg,\s+E1= *\S+  mm\s+GP2:\s+UF.*J1=", text, re.DOTALL)
    assert "DEFAULT_GROUP\t= 1,1,*,*,*;" in text


def test_j3_is_written_as_counted_from_the_horizontal(tmp_path):
    """If the upper arm of the model turns alone, the forearm turns with it: J3 of the controller changes by -J2."""
    timed = weld()
    text = program_text("ls", timed, controller(hinged(), name="WELD"))
    written = {int(n): float(v) for n, v in re.findall(r"P\[(\d+)\]\{.*?J3= *(\S+) deg", text, re.DOTALL)}
    assert written[3] == pytest.approx(np.degrees(timed.x[2, 2] - timed.x[2, 1]), abs=1e-6)
    assert read_text(tmp_path, "a.ls", text).x[2, 2] == pytest.approx(timed.x[2, 2], abs=1e-8)
    as_written = read_text(tmp_path, "a.ls", text, given=JobController(j3_from="horizontal")).x[2, 2]
    assert as_written == pytest.approx(timed.x[2, 2] - timed.x[2, 1], abs=1e-8)


def test_times_are_rounded_up_and_corners_are_cnt_except_at_stops(tmp_path):
    timed = weld()._replace(time_s=np.array([0, 0.0101, 0.5, 40.5, 40.5001]), blended=np.array([0, 1, 0, 1, 0.0]))
    text = program_text("ls", timed, controller(hinged(), name="WELD"))
    moves = re.findall(r"J P\[\d\] (.*) ;", text)
    assert moves == ["5% FINE", "11msec CNT100", "490msec FINE", "40.0sec CNT100", "1msec FINE"]
    found = read_text(tmp_path, "a.ls", text)
    assert found.corner_share[:, 0].tolist() == [0, 0.5, 0, 0.5, 0]
    assert found.time_s.tolist() == pytest.approx([0, 0.011, 0.501, 40.501, 40.502])


def test_corners_of_the_path_that_leave_its_tolerance_are_exact():
    straight = np.zeros((5, 6))
    straight[:, 1] = 0.01 * np.arange(5)
    kinds = weld()._replace(x=straight)
    kinds = kinds._replace(kind=np.full(5, kinds.kind[-1]))
    assert with_exact_corners(hinged(), kinds, 1e-3).blended.tolist() == [1, 1, 1, 1, 1]
    sharp = straight.copy()
    sharp[3:, 0] = 0.01
    assert with_exact_corners(hinged(), kinds._replace(x=sharp), 1e-3).blended.tolist() == [1, 1, 0, 0, 1]
    assert with_exact_corners(hinged(), kinds._replace(x=sharp), 1.0).blended.tolist() == [1, 1, 1, 1, 1]


def test_seams_are_comments_and_outputs_are_set_at_both_ends_after_an_exact_stop():
    seams = (SeamSpan("rib; of ü", 2, 4), SeamSpan("boss", 5, 7))
    process = ProcessOutputs(on=((5, True),), off=((5, False), (6, True)))
    text = program_text("ls", weld(2), controller(hinged(), name="WELD", seams=seams, process=process))
    lines = [re.sub(r"^ *\d+: *| ;$|\d+msec |\[\d\]", "", line) for line in text.splitlines()]
    short = [line for line in lines if line.startswith(("J P", "DO", "!seam", "!process", "!air"))]
    rib = ["!air move", "J P CNT100", "J P FINE", "!seam rib, of ?", "DO=ON", "!process", "J P CNT100", "J P FINE"]
    boss = ["!air move", "J P FINE", "!seam boss", "DO=ON", "!process", "J P CNT100", "J P FINE"]
    assert short == ["DO=OFF", "DO=ON", "J P 5% FINE", *rib, "DO=OFF", "DO=ON", *boss, "DO=OFF", "DO=ON"]


def program(*lines: str, positions: str | None = None) -> str:
    """A program of one group; its positions P[1] to P[3] differ in J1."""
    own = "".join(
        f"P[{k}]{{\n   GP1:\n\tUF : 0, UT : 1,\t\n\tJ1= {k}.5 deg,\tJ2= 10 deg,\tJ3= -20.25 deg,\n\tJ4= 0 deg,"
        "\tJ5=.5 deg,\tJ6= 0.0 deg\n};\n"
        for k in (1, 2, 3)
    )
    body = "\n".join(f"{k:4d}:{line} ;" for k, line in enumerate(lines, start=1))
    return (
        f"/PROG A\n/ATTR\nOWNER = MNEDITOR;\n/APPL\n/MN\n{body}\n/POS\n{own if positions is None else positions}/END\n"
    )


def test_programs_of_others_are_read(tmp_path):
    lines = (
        "  UFRAME_NUM=0",
        "J P[1:home] 100% FINE    ",
        "  !a comment",
        "J P[2] 2.5sec CNT50 ACC80",
        "  DO[1:gun]=ON",
        "",
    )
    more = "J P[3] 200msec CNT0", "J P[2] 12% CNT R[3] PTH", "J P[1] 50% FINE"
    found = read_text(tmp_path, "a.ls", program(*lines, *more))

    assert np.degrees(found.x[0]).tolist() == pytest.approx([1.5, 10, -10.25, 0, 0.5, 0])
    assert found.line.tolist() == [7, 9, 12, 13, 14] and found.time_s is None
    assert found.corner_share.tolist() == [[0, 0], [0.5, 0.5], [0.5, 0.5], [0.5, 0.5], [0, 0]]
    assert "Instructions that do not move are not read: DO, UFRAME_NUM." in found.notes
    assert any("J3 + J2" in note for note in found.notes)


POSE = "P[1]{\n   GP1:\n UF : 0, UT : 1, CONFIG : 'N U T, 0, 0, 0',\n X = 1 mm, Y = 2 mm, Z = 3 mm,\n W = 0 deg\n};\n"
SHORT = "P[1]{\n   GP1:\n UF : 0, UT : 1,\n J1= 1 deg\n};\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (program("L P[1] 20mm/sec FINE"), ", line 6: 'L P[1] 20mm/sec FINE' moves in a way that cannot be read"),
        (program("J PR[1] 20% FINE"), ", line 6: 'J PR[1] 20% FINE' moves in a way"),
        (program("C P[1]"), ", line 6: 'C P[1]' moves in a way"),
        (program("J P[1] 20% FINE Offset,PR[1]"), ", line 6: 'Offset,PR[1]' after FINE cannot be read"),
        (program("J P[1] R[1]% FINE"), ", line 6: 'J P[1] R[1]% FINE' moves in a way"),
        (program("J P[9] 20% FINE"), ", line 6: position P[9] is not in the program"),
        (program("IF DI[1]=ON,JMP LBL[1]"), ", line 6: IF controls the flow"),
        (program("CALL GRIP"), ", line 6: CALL controls the flow"),
        (program("Arc Start[1]"), ", line 6: 'Arc Start[1]' is not known, it may move"),
        (program("J P[1] 5% FINE", positions=POSE), ", line 8: a pose; only joint values"),
        (program("J P[1] 5% FINE", positions=SHORT), ", line 8: J2 of group 1 is missing"),
        (
            program("J P[1] 5% FINE", positions=SHORT.replace("1 deg", "1 deg, J7= 3 deg")),
            ", line 8: J7 of group 1 is an axis",
        ),
        (program("J P[1] 5% FINE", positions=SHORT.replace("deg", "mm")), ", line 8: J1 of group 1 is in mm"),
        (program("J P[1] 5% FINE", positions=SHORT + SHORT), ", line 13: position P[1] is given twice"),
        (program("J P[1] 5% FINE", positions="P[1] = 3\n"), ", line 8: 'P[1] = 3' is not a position"),
        (program("J P[1] 5% FINE").removesuffix("/END\n"), ", line 26: /END is missing"),
        (program(), " contains no configuration"),
    ],
)
def test_what_cannot_be_read_is_refused_with_its_line(text, message, tmp_path):
    assert refusal(tmp_path, "a.ls", text).startswith(f"a.ls{message}")


def test_an_arm_that_no_group_holds_is_refused():
    timed = random_motion(railed(), 1)
    with pytest.raises(InputError, match=r"ls: a robot of 8 joints; group 1 has 6; set program\.groups"):
        program_text("ls", timed, controller(railed(), name="WELD", groups=None))
    with pytest.raises(InputError, match="ls: program name 'weld' is not valid"):
        program_text("ls", weld(), controller(hinged()))
    with pytest.raises(InputError, match=r"ls: a move of 4000 s that ends 4000 s from the start; at most 3200 s"):
        program_text("ls", weld()._replace(time_s=4000.0 * np.arange(5)), controller(hinged(), name="WELD"))
