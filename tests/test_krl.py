"""KRL programs: what is written, what is read, and what is refused with its line."""

import re

import numpy as np
import pytest
from motion_files import GROUPS, controller, hinged, railed, random_motion, read_text, refusal, write

from htcp_jax.errors import InputError
from htcp_jax.io.motions import read_motion
from htcp_jax.proving.curves import corners_in_shares
from htcp_jax.status import Kind
from htcp_jax.trajectory import TimedMotion
from htcp_jax.trajectory.controller_data import ProcessOutputs, SeamSpan
from htcp_jax.trajectory.formats.writers import program_text

ROUNDING = np.radians(0.5e-5)
SPEED = np.full(6, 2.0)  # [rad/s]


def weld(seams: int = 1) -> TimedMotion:
    """An approach of two rows, and seams of three points each with an air move between them."""
    kinds, targets = [Kind.TRANSFER, Kind.APPROACH], [0, 0]
    for k in range(seams):
        kinds += [Kind.TRANSFER, Kind.PROCESS, Kind.PROCESS]
        targets += [3 * k, 3 * k + 1, 3 * k + 2]
    n = len(kinds)
    x = 0.01 * np.arange(n)[:, None] * np.array([1.0, -1, 0.5, 0, 2, -2]) ** 2
    velocity = np.ones_like(x)
    velocity[[0, -1]] = 0.0
    return TimedMotion(
        np.arange(n) * 1.0, x, velocity, 0 * x, np.array(kinds, np.int8), np.array(targets), hinged().joint_names
    )


def statements(text: str) -> list[str]:
    """The file's lines without comments."""
    return [line for line in text.splitlines() if not line.startswith(";")]


def test_axis_values_read_back_within_the_last_digit_with_external_axes_in_their_groups(tmp_path):
    for arm in (hinged(), railed()):
        rounding = np.where(arm.sliding, 0.5e-8, ROUNDING) * (1 + 1e-9)
        for seed in range(20):
            timed, own = random_motion(arm, seed), controller(arm)
            found = read_motion(write(tmp_path, "krl", timed, own), arm, own)
            assert (np.abs(found.x - timed.x) <= rounding).all()
            assert (found.format, found.time_s, found.corner_m) == ("krl", None, None)
    text = program_text("krl", random_motion(railed(), 3), controller(railed()))
    assert re.search(r"^PTP \{E6AXIS: A1 \S+, A2 .*, A6 \S+, E1 \S+, E2 \S+\}", text, re.MULTILINE)
    assert GROUPS.base == (0,) and "$VEL_EXTAX[2]=" in text


def test_corners_are_rounded_within_the_proven_blend_and_stops_are_exact(tmp_path):
    timed = weld()._replace(blended=np.array([0, 0.5, 0.2, 0.001, 0]))
    text = program_text("krl", timed, controller(hinged(), speed=SPEED))
    found = read_text(tmp_path, "a.src", text)
    assert re.findall(r"\$APO\.CPTP=(\d+)", text) == ["15", "6", "1"], "31.25 percent of a leg per blended half"
    assert found.corner_share.tolist() == [[0, 0], [0.075, 0.5], [0.03, 0.5], [0.005, 0.5], [0, 0]]


def test_the_displacement_of_a_rounded_corner_is_within_that_of_the_program_s_blend():
    """A path within d of a corner is at most d times the slope's change away; the blend 5/32 of its length."""
    x = np.array([[0.0, 0], [1, 0], [1, 2]])
    found = corners_in_shares(x, np.array([[0, 0], [0.1, 0.5], [0, 0]]))
    points = np.concatenate([found.coefficients[:, 0], found.coefficients.sum(axis=1)])
    assert found.segment.tolist() == sorted(found.segment.tolist()) and (points.min(), points.max()) == (0.0, 2.0)
    inside = ~found.is_certain
    assert inside.sum() >= 2 and (found.coefficients[inside, 0, 0] >= 0.9 - 1e-12).all(), (
        "from 0.1 before the corner on"
    )


def test_speeds_are_percents_of_the_full_speeds_with_a_factor_for_each_move():
    text = program_text("krl", weld(), controller(hinged(), speed=SPEED))
    velocity = [int(v) for v in re.findall(r"\$VEL_AXIS\[1\]=(\d+)", text)]
    factor = [int(v) for v in re.findall(r"\$RED_VEL=(\d+)", text)]
    said = "slowly to the first configuration; then 0.04 of 2 rad/s, which is 2 percent; full speed for other programs"
    assert velocity == [5, 2, 100], said
    assert factor == [100, 100]
    slow = weld()._replace(time_s=10.0 * np.arange(5.0))
    assert "$VEL_AXIS[6]=1\r\n$RED_VEL=20" in program_text("krl", slow, controller(hinged(), speed=SPEED))


def test_seams_are_comments_and_outputs_are_set_at_both_ends_after_an_exact_stop():
    seams = (SeamSpan("rib", 2, 4), SeamSpan("a long\r\nname ü", 5, 7))
    process = ProcessOutputs(on=((5, True), (6, False)), off=((5, False),))
    text = program_text("krl", weld(2), controller(hinged(), speed=SPEED, seams=seams, process=process))
    lines = [line for line in text.splitlines() if line.startswith(("PTP", "$OUT", "; seam", "; process", "; air"))]
    short = [re.sub(r" \{.*\}", "", line) for line in lines]
    on, off = ["$OUT[5]=TRUE", "$OUT[6]=FALSE"], ["$OUT[5]=FALSE"]
    rib = ["; air move", "PTP C_PTP", "PTP", "; seam rib", *on, "; process", "PTP C_PTP", "PTP", *off]
    boss = ["; air move", "PTP", "; seam a long name ?", *on, "; process", "PTP C_PTP", "PTP", *off]
    assert short == [*off, "PTP", *rib, *boss]


HEAD, TAIL = "DEF a()\n", "END\n"
HOME = "PTP {A1 0, A2 -90, A3 90, A4 0, A5 0, A6 0}\n"


def test_programs_of_others_are_read(tmp_path):
    text = (
        "&ACCESS RVP\nDEF a ( )\nDECL E6AXIS XP1\nINT I\n;FOLD INI\nBAS (#INITMOV,0)\nFOR I=1 TO 6\n$VEL_AXIS[I]=25\n"
        "ENDFOR\n$APO.CPTP = 40 ; percent\nXP1={A1 1.5,A2 -90.0,A3 +90,A4 0,A5 1e1,A6 .5,E1 0,E2 0}\n"
        f"{HOME}ptp xp1 c_ptp c_dis\nPTP {{AXIS: A1 3, A2 0, A3 0, A4 0, A5 0, A6 0}} C_PTP\nWAIT SEC 0.5\n"
        f"$OUT[3]=TRUE\nlabel:\n{HOME}END\nDEF other()\n$OUT[1]=FALSE\nEND\n"
    )
    found = read_text(tmp_path, "a.src", text)
    assert np.degrees(found.x[1]).tolist() == pytest.approx([1.5, -90, 90, 0, 10, 0.5])
    assert found.line.tolist() == [12, 13, 14, 18] and found.corner_share[:, 0].tolist() == [0, 0.2, 0.2, 0]
    assert "Statements that do not move are not read: $APO, $OUT, $VEL_AXIS, BAS, WAIT, XP1." in found.notes


def test_corners_without_a_stated_size_are_read_as_the_largest_ones(tmp_path):
    found = read_text(tmp_path, "a.src", f"{HEAD}{HOME}{HOME.strip()} C_PTP\n{HOME}{TAIL}")
    assert found.corner_share.tolist() == [[0, 0], [0.5, 0.5], [0, 0]]
    assert any("as if it were 100" in note for note in found.notes)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (f"{HOME}LIN {{X 1, Y 0, Z 0}}\n", ", line 3: LIN moves in a way that cannot be read; only PTP can be"),
        (f"{HOME}PTP_REL {{A1 1}}\n", ", line 3: PTP_REL moves in a way"),
        (f"{HOME}SPLINE\n", ", line 3: SPLINE moves in a way"),
        ("PTP {X 1, Y 0, Z 0, A 0, B 0, C 0}\n", ", line 2: the target {X 1, Y 0, Z 0, A 0, B 0, C 0} is a pose"),
        ("PTP XHOME\n", ", line 2: the target XHOME cannot be read; valid: axis values"),
        ("PTP {A1 x}\n", ", line 2: the target {A1 x} cannot be read"),
        ("PTP {A1 0, A2 0}\n", ", line 2: A3 is missing; the job's groups have A1, A2"),
        (f"{HOME.replace('}', ', E1 5}')}", ", line 2: E1 is an axis that the job's groups do not have"),
        (f"{HOME.strip()} C_XYZ\n", ", line 2: 'PTP {A1 0, A2 -90, A3 90, A4 0, A5 0, A6 0} C_XYZ' cannot be read"),
        (f"IF $IN[1] THEN\n{HOME}ENDIF\n", ", line 2: IF controls the flow"),
        (f"FOR I=1 TO 3\n{HOME}ENDFOR\n", ", line 2: FOR controls the flow"),
        (f"{HOME}GRIP_OPEN()\n", ", line 3: GRIP_OPEN() is not known, it may move"),
        (f"{HOME}BAS(#PTP_AND_MORE)\n", ", line 3: 'BAS(#PTP_AND_MORE)' is not known, it may move"),
        ("$APO.CPTP=150\n", ", line 2: $APO.CPTP=150 cannot be read; valid: a number from 0 to 100"),
        (f"{HOME}END\nDEF b()\n{HOME}", ", line 5: a move in b, which cannot be read; only those of a can be"),
        ("DEF b()\n", ", line 2: a routine in the routine a; END is missing"),
        ("", " contains no configuration"),
    ],
)
def test_what_cannot_be_read_is_refused_with_its_line(body, message, tmp_path):
    assert refusal(tmp_path, "a.src", f"{HEAD}{body}{TAIL}").startswith(f"a.src{message}")


def test_a_program_without_its_end_or_in_other_units_is_refused(tmp_path):
    assert "the END of a is missing" in refusal(tmp_path, "a.src", f"{HEAD}{HOME}")
    with pytest.raises(InputError, match="KRL holds deg; --unit rad contradicts that"):
        read_text(tmp_path, "a.src", f"{HEAD}{HOME}{TAIL}", unit="rad")
