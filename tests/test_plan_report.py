"""Report of one plan: the numbers of the plan, the program and the job, on one page that stands alone."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from made_plan import A, driven, made_plan, made_plans

from htcp_jax.api import open_plan
from htcp_jax.cli import main
from htcp_jax.report.plan_tables import format_table
from htcp_jax.runs import open_plans
from htcp_jax.trajectory import program_figures, program_of
from htcp_jax.viewer.timed_play import reached_s


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """Folder of a complete plan that was made by hand."""
    folder = tmp_path_factory.mktemp("planned")
    plan = made_plan(folder)
    targets = np.asarray(plan.scenario.targets)
    replace(plan, plans=driven(made_plans(targets, [[A] * len(targets)]))).save(folder / "plan")
    return folder / "plan"


@pytest.fixture(scope="module")
def failed(tmp_path_factory):
    """Folder of a plan that fails at target 8."""
    folder = tmp_path_factory.mktemp("failed")
    made_plan(folder).save(folder / "plan")
    return folder / "plan"


@pytest.fixture(scope="module")
def reported(planned, screenless, tmp_path_factory):
    """Folder with the report of the plan, timed at 200 mm/s, and its tables as JSON."""
    out = tmp_path_factory.mktemp("reported") / "report"
    assert main(["report", str(planned), "--feed", "200mm/s", "--out", str(out)]) == 0
    return out


def cells(page: str) -> list[list[str]]:
    return [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", page)]


def test_the_page_has_the_numbers_of_the_plan_and_of_its_program(reported, planned):
    page, plan = (reported / "report.html").read_text(), open_plan(planned)
    rows = {row[0]: row[1] for row in cells(page) if len(row) == 2}
    facts = plan.facts()
    for name in ("can be run", "guaranteed clearance", "clearance", "TCP distance", "targets tracked"):
        assert rows[name] == facts[name]
    made = program_of(open_plans(planned), 0.2)
    found = program_figures(made.program, made.limits)
    assert rows["duration"].startswith(f"{found.duration_s:.2f} s: ")
    assert f"held within 1 % over {100 * found.held_share:.2f} %" in rows["feed"]
    phases = {row[0]: float(row[2]) for row in cells(page) if len(row) == 4 and row[0] in {*found.seconds, "cycle"}}
    assert phases["cycle"] == pytest.approx(found.duration_s, abs=0.005)
    assert phases["retract"] == pytest.approx(found.seconds["retract"], abs=0.005)
    assert "the job has no cell" in rows["surroundings"] and "htcp validate" in rows["independent check"]
    assert rows["margin"].startswith(f"{1e3 * plan.job.margin_m:g} mm")
    assert any(row[:3] == ["rapid", "-", f"{len(made.timed('rapid').x):,}"] for row in cells(page))


def test_the_clearance_of_the_whole_motion_is_that_of_its_narrowest_phase(reported, planned):
    rows = {row[0]: row[1] for row in cells((reported / "report.html").read_text()) if len(row) == 2}
    plan = open_plan(planned)
    phases = dict(part.split(" at least ") for part in rows["clearance by phase"].split(", "))
    assert list(phases) == ["before the path", "on the path", "on the way back"]
    least = 1e3 * plan.plans.segment_clearance[0]
    first = int(plan.scenario.on_path)
    expected = [np.nanmin(each) for each in (least[: first + 1], least[first + 1 :], least)]
    assert [float(text.removesuffix(" mm")) for text in phases.values()] == pytest.approx(expected, rel=0.01)


def test_formats_that_cannot_couple_axes_are_one_row(planned):
    made = program_of(open_plans(planned), 0.2)
    names = [row[0] for row in format_table(made).rows]
    joints = made.robot.joint_names
    coupled = made.job.program.model_copy(update={"coupled": ((joints[2], joints[1]),)})
    rows = format_table(made._replace(job=made.job.model_copy(update={"program": coupled}))).rows
    assert rows[-1] == ("jbi-pulses, krl, ls, urscript", None, None, "not with program.coupled")
    others = [row[0] for row in rows[:-1]]
    assert others == [name for name in names if name not in rows[-1][0].split(", ")]
    assert not any("coupled" in row[-1] for row in rows[:-1])


def test_the_phases_fill_the_cycle(planned, tmp_path, screenless, capsys):
    assert main(["report", str(planned), "--feed", "200mm/s", "--out", str(tmp_path / "r"), "--json"]) == 0
    *phases, cycle = json.loads(capsys.readouterr().out)["phases"]
    assert sum(each["duration_s"] for each in phases) == pytest.approx(cycle["duration_s"])
    assert sum(each["percent"] for each in phases) == pytest.approx(100)
    assert [each["phase"] for each in phases] == ["approach", "the path", "retract"]


def test_the_page_stands_alone_with_pictures_from_two_sides(reported, planned):
    page = (reported / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 5 and {"arm-1.png", "close-2.png", "along-path.png"} <= {
        file.name for file in reported.iterdir()
    }
    assert not re.search(r"<script|src=\"(?!data:)|href=\"(?!#)|url\(|@import", page) and str(planned) not in page


@pytest.mark.parametrize("width", (400, 800, 1400))
def test_nothing_is_wider_than_the_page(reported, browser, width):
    page = browser.new_page(viewport={"width": width, "height": 900})
    page.goto((reported / "report.html").as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.close()


def test_tables_of_two_columns_fit_their_box_at_400_px(reported, browser):
    page = browser.new_page(viewport={"width": 400, "height": 900})
    page.goto((reported / "report.html").as_uri())
    beyond = page.locator(".wide:not(:has(td:nth-child(3)))").evaluate_all(
        "boxes => boxes.map(each => each.scrollWidth - each.clientWidth)"
    )
    assert len(beyond) >= 5 and max(beyond) <= 1
    page.close()


def test_a_plan_that_fails_has_a_report_that_says_where_and_no_program(failed, screenless, tmp_path):
    assert main(["report", str(failed), "--out", str(tmp_path / "report")]) == 0
    page = (tmp_path / "report" / "report.html").read_text()
    assert "failed at target 8" in page and "there is no program" in page and "<td>cycle</td>" not in page


def test_without_a_feed_the_report_says_what_is_missing(planned, screenless, tmp_path):
    assert main(["report", str(planned), "--out", str(tmp_path / "report")]) == 0
    assert "Pass --feed 20mm/s" in (tmp_path / "report" / "report.html").read_text()


@pytest.mark.parametrize(
    ("more", "line"),
    [
        (["--feed", "fast"], "fast"),
        (["{failed}"], "omit the other folders"),
    ],
)
def test_bad_input_is_one_line_exit_2_and_no_file(planned, failed, tmp_path, capsys, more, line):
    more = [each.format(failed=failed) for each in more]
    assert main(["report", str(planned), *more, "--out", str(tmp_path / "report")]) == 2
    error = capsys.readouterr().err
    assert line in error and error.count("\n") == 1 and not (tmp_path / "report").exists()


def test_targets_are_reached_in_order_and_before_the_retract(planned):
    made = program_of(open_plans(planned), 0.2)
    times, targets = reached_s(made.program)
    assert (np.diff(times) > 0).all() and targets.tolist() == list(range(int(targets[0]), len(made.x)))
    assert times[-1] == pytest.approx(
        made.program.duration_s - program_figures(made.program, made.limits).seconds["retract"]
    )
