"""Programs of several files: read in order, the parts are the program in one piece; known limits of controllers."""

import re
from pathlib import Path

import numpy as np
import pytest
from test_program_formats import GROUPS, Job, a_motion, controller, read_rapid, table_of, whole

from htcp_jax.trajectory import FORMATS
from htcp_jax.trajectory.formats import as_jbi, as_rapid, controller_limits
from htcp_jax.trajectory.formats.controller_limits import exceeded_limits
from htcp_jax.trajectory.formats.parts import split
from htcp_jax.trajectory.formats.writers import program_files, program_text
from htcp_jax.trajectory.timed_motion import TimedMotion

PAGE = (Path(__file__).parents[1] / "docs" / "program-formats.md").read_text()


def long_motion(rows: int, joints: int = 6) -> TimedMotion:
    """A slow motion of many configurations, with joints of different speeds."""
    time = 0.01 * np.arange(rows)
    x = 1e-3 * np.cumsum(np.sin(time[:, None] * np.arange(1, joints + 1)), axis=0)
    one = a_motion(joints)
    kind = one.kind[np.minimum(np.arange(rows) * 3 // rows, 2)]
    return TimedMotion(time, x, x, x, kind, np.arange(rows), one.joint_names)


@pytest.fixture
def few_lines(monkeypatch):
    """Limits so low that motions of a few rows are split."""
    monkeypatch.setattr(as_jbi, "MOST_LINES", 60)
    monkeypatch.setattr(as_rapid, "RAPID_LINES", controller_limits.RAPID_LINES._replace(most=60))


@pytest.mark.parametrize("format", ["jbi", "jbi-pulses"])
def test_jobs_read_in_the_order_of_their_calls_are_the_job_in_one_piece(format, few_lines, monkeypatch):
    timed = long_motion(170, 6 if format == "jbi" else 8)
    given = whole(timed)
    given = given._replace(speed=np.full(timed.x.shape[1], 10.0))
    main, *parts = program_files(format, timed, given)
    calls = re.findall(r"^CALL JOB:(\S+)\r$", main.text, re.MULTILINE)
    assert calls == [f"WELD-{k}" for k in range(1, len(parts) + 1)] and len(parts) == 4
    assert Job(main.text).fields["NPOS"] == "0,0,0,0,0,0" and not re.search("MOV[JL]", main.text)
    read = [Job(part.text) for part in parts]
    assert [job.fields["NAME"] for job in read] == calls and [part.suffix for part in parts] == ["-1", "-2", "-3", "-4"]
    for part in parts:
        assert part.text.split("\r\nNOP\r\n")[1].count("\r\n") + 1 <= 60
    monkeypatch.setattr(as_jbi, "MOST_LINES", 9999)
    one = Job(program_text(format, timed, given))
    np.testing.assert_array_equal(np.concatenate([job.array() for job in read]), one.array())
    speeds = [[move[0], *move[2:]] for job in read for move in job.moves]
    assert speeds == [[move[0], *move[2:]] for move in one.moves]
    assert sum("PL=0" in move for move in speeds) == 1 and "PL=0" in speeds[-1]
    assert [list(part.rows) for part in parts] == [list(rows) for rows in split(170, 60 - 2 - as_jbi.PART_REMARKS)]


def test_a_job_with_groups_is_split_in_all_of_them(few_lines):
    timed = long_motion(100, 9)
    main, *parts = program_files("jbi-pulses", timed, controller(timed, pulses=table_of(9), groups=GROUPS))
    for kind in ("C", "BC", "EC"):
        assert sum(len(Job(part.text).array(kind)) for part in parts) == 100
    fields = [Job(each.text).fields for each in (main, *parts)]
    assert {each["GROUP1"] for each in fields} == {"RB1,BS1"} and {each["GROUP2"] for each in fields} == {"ST1"}


def test_a_job_of_more_than_9999_lines_is_several_and_none_has_more():
    timed = long_motion(12000)
    main, *parts = program_files("jbi-pulses", timed, whole(timed)._replace(speed=np.full(6, 10.0)))
    assert len(parts) == 2 and sum(len(part.rows) for part in parts) == 12000
    for each in (main, *parts):
        instructions = each.text.split("\r\nNOP\r\n")[1]
        assert instructions.count("\r\n") + 1 <= 9999


def test_procedures_read_in_the_order_of_their_calls_are_the_procedure_in_one_piece(few_lines, monkeypatch):
    timed = long_motion(130)
    main, *parts = program_files("rapid", timed, whole(timed))
    assert re.findall(r"^    (\w+);$", main.text, re.MULTILINE) == ["WELD_1", "WELD_2", "WELD_3"]
    assert "MODULE WELDModule" in main.text and "tool data" in main.text
    assert all(part.text.count("\n") <= 60 for part in parts)
    moves = [re.findall(r"^    (MoveAbsJ .*)$", part.text, re.MULTILINE) for part in parts]
    assert [part.text.splitlines()[0] for part in parts] == [f"MODULE WELD_{k}Module" for k in (1, 2, 3)]
    monkeypatch.setattr(as_rapid, "RAPID_LINES", controller_limits.RAPID_LINES)
    one = program_text("rapid", timed, whole(timed))
    assert [line for part in moves for line in part] == re.findall(r"^    (MoveAbsJ .*)$", one, re.MULTILINE)
    assert len(read_rapid(one)[0]) == 130


@pytest.mark.parametrize("format", FORMATS)
def test_a_short_program_is_one_file_with_the_same_text(format):
    (one,) = program_files(format, a_motion(), whole(a_motion()))
    assert one.suffix == "" and one.text == program_text(format, a_motion(), whole(a_motion()))
    assert list(one.rows) == [0, 1, 2]


def test_limits_that_a_split_does_not_satisfy_are_listed_from_their_numbers_on():
    assert exceeded_limits("ros", 100) == [] == exceeded_limits("jbi", 10**6) == exceeded_limits("csv", 10**6)
    assert [each.whose for each in exceeded_limits("ros-json", 101)] == ["abb_driver"]
    assert [each.most for each in exceeded_limits("urscript", 3000)] == [1000, 2500]


@pytest.mark.parametrize("limit", controller_limits.LIMITS, ids=lambda each: f"{each.formats[0]} {each.most}")
def test_the_page_lists_every_limit_with_its_source(limit):
    rows = [line for line in PAGE.splitlines() if line.startswith("|") and limit.source in line]
    assert any(f"{limit.most:,} {limit.what}" in row for row in rows)
