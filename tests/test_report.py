"""The report: its numbers from plans made by hand, on the paper's own grids; its files; and the inputs it rejects."""

import csv
import json
import re
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import stranger_report
import yaml
from hand_made import plans_with
from markdown_it import MarkdownIt
from small_run import edit_manifest, toy_run

import htcp_jax
from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.model import Scenario
from htcp_jax.motion import Plans
from htcp_jax.motion.motion import MotionFigures
from htcp_jax.reachability import Obstruction
from htcp_jax.report import Table, make_report, paper, tables, write_report
from htcp_jax.report.best import best_scenarios
from htcp_jax.report.cell import OpenedScene
from htcp_jax.report.chapter import answer, chapter, choice, part_facts, tables_of
from htcp_jax.report.document import Heading, Picture, html, markdown, png
from htcp_jax.report.groups import Part, read_parts
from htcp_jax.report.motions import meaning, motion_table
from htcp_jax.report.part_charts import charts_of
from htcp_jax.report.report import Report, overview
from htcp_jax.runs import Column, Run, columns, open_run
from htcp_jax.runs.manifest import MANIFEST
from htcp_jax.runs.reachability_file import REACHABILITY
from htcp_jax.runs.sweep import keep_plans
from htcp_jax.spec import PlanConfig
from htcp_jax.spec.examples import examples
from htcp_jax.status import SegmentStatus, Status

pytestmark = pytest.mark.filterwarnings("ignore:.*have gaps of")  # a cloud of eight points
ALONG = "along-task-2-cone_deg"
POSES = """
  - workpiece.rotation_y_rad: [0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]
  - workpiece.rotation_z_rad: [-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3]
"""
STARTS = "".join(f"\n  - start_rad.{k}: {{offsets: [-0.2, -0.1, 0.0, 0.1, 0.2]}}" for k in (3, 4, 5)) + "\n"
SHELF = "".join(f"{0.18 + 0.02 * k:.2f} -0.17 0.1\n" for k in range(20))  # under the path
BOX = "\n".join(f"{1.3 * x} {y} {z}" for x in (0, 1) for y in (-1, 1) for z in (-1, 1))


def by_hand(scenarios: Scenario, method: str) -> Plans:
    """Plans made by hand, as returned by the planner.

    The baseline loses scenario k's last k % 4 targets, the others none; each second target of the baseline lies behind
    a blocked joint path.
    """
    targets = scenarios.targets.shape[1]
    lost = [number % 4 if method == "baseline" else 0 for number in scenarios.number.tolist()]
    ends = [[Status.ITERATION_LIMIT] + [Status.NOT_ATTEMPTED] * (n - 1) if n else [] for n in lost]
    plans = plans_with([[Status.TRACKED] * (targets - len(end)) + end for end in ends], joints=6)
    open_path = np.where(plans.status <= 1, 1, -1).astype(np.int8)
    open_path[:, 1::2] -= (method == "baseline") * (open_path[:, 1::2] == 1).astype(np.int8)
    segments = np.where(open_path == 1, SegmentStatus.VALID, SegmentStatus.IN_COLLISION).astype(np.int8)
    return plans._replace(
        start=scenarios.x_start,
        target=scenarios.targets,
        path_clear=open_path,
        segment_status=segments,
        segment_clearance=np.where(segments == SegmentStatus.VALID, 0.002, np.nan),
    )


def kept(file: str | Path, methods: str, out: Path, **how) -> Run:
    """The run of a sweep file, with plans made by hand."""
    spec = load_sweep(file)
    scenarios = spec.batch().scenarios
    return keep_plans(spec, {method: by_hand(scenarios, method) for method in methods.split(",")}, out, **how)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with runs: the paper's two grids, with the paper's choices; and a list of smaller ones."""
    with pytest.MonkeyPatch.context() as patch:
        place = tmp_path_factory.mktemp("runs")
        patch.chdir(place)
        (place / "box.xyz").write_text(f"{BOX}\n{SHELF}\n")
        choices = yaml.safe_load(examples()["paper"].read_text())
        del choices["config"]
        for name, count in (("path", 94), ("short", 2)):
            rows = [f"{0.1857 + 0.004 * k},-0.17,0.17" for k in range(count)]
            (place / f"{name}.csv").write_text("\n".join(rows) + "\n")
            scene = {"workpiece": {"cloud": "box.xyz", "path": f"{name}.csv", "inlet_m": [0, 0, 0.19]}}
            (place / f"{name}.yaml").write_text(yaml.safe_dump(scene))
            (place / f"{name}-paper.yaml").write_text(yaml.safe_dump(scene | choices))
        short = "start_rad.6: [-2.0, -1.9]"
        grids = {
            "poses": ("path-paper", f"grid:{POSES}"),
            "starts": ("path-paper", f"grid:{STARTS}"),
            "measuring": ("path", f"grid:\n  - start_rad.6: [0.0]{POSES}"),
            "one": ("short", f"grid:\n  - {short}"),
            "groups": ("short", f"groups:\n  first:\n    - {short}\n  second:\n    - margin_m: [0.001, 0.002, 0.003]"),
            "jointly": (
                "short",
                "grid:\n  - start_rad.6: {uniform: [-2.0, -1.9], count: 40}\n"
                "    start_rad.5: {uniform: [0.1, 0.2], count: 40}",
            ),
            "shifts": ("short", "grid:" + "".join(f"\n  - workpiece.shift_m.{k}: [0.0, 0.001]" for k in "xz")),
            "four": ("short", "grid:" + "".join(f"\n  - start_rad.{k}: [0.1, 0.2]" for k in (1, 4, 5, 6))),
        }
        for name, (config, text) in grids.items():
            (place / f"{name}.yaml").write_text(f"config: {config}.yaml\n{text}\n")
            kept(f"{name}.yaml", "baseline,hybrid", place / name)
    return place


HOSTILE = '<img src=x onerror="owned=1">', "[x](https:x)", "![x](x)", "<script>owned=1<!", "`_*x*_` | &amp;"


@pytest.mark.parametrize("name", HOSTILE)
def test_no_script_in_the_name_of_a_run_runs_in_its_report(folder, tmp_path, browser, name):
    """Escaped names in reports: no script in the name of a run is run (regression)."""
    shutil.copytree(folder / "one", tmp_path / name)
    report = make_report(tmp_path / name)
    write_report(report, tmp_path)
    blocks = MarkdownIt().enable("table").parse((tmp_path / "report.md").read_text())
    found = [token for block in blocks for token in (block, *(block.children or ()))]
    assert not {token.type for token in found} & {"html_block", "html_inline", "link_open", "code_inline", "em_open"}
    assert {token.attrs["src"] for token in found if token.type == "image"} == {
        f"{each}.png" for each in report.figures
    }
    assert "".join(each.content for each in blocks[1].children) == f"Sweep report: {name}"
    page = browser.new_page()
    page.goto((tmp_path / "report.html").as_uri())
    assert page.locator("h1").inner_text() == f"Sweep report: {name}"
    assert (
        page.locator("[src=x], [onerror], script, a:not([href^='#section-'])").count() == 0
        and page.evaluate("window.owned") is None
    )
    page.close()


def test_a_long_text_is_no_column_of_single_words_on_a_narrow_screen(tmp_path, browser):
    names = Column("a", "a" * 60), Column("b", "b" * 60), Column("text", "at targets")
    (tmp_path / "report.html").write_text(html([Table("t", names, (("a", "b", "one, two, three, " * 9),))], {}))
    page = browser.new_page(viewport={"width": 400, "height": 900})
    page.goto((tmp_path / "report.html").as_uri())
    assert page.locator("td:last-child").evaluate("cell => cell.clientWidth") > 200
    page.close()


def read_part(folder: Path, name: str) -> Part:
    (part,) = read_parts(open_run(folder / name), name)
    return part


part_of = cache(read_part)  # where no test has changed the folder


@cache
def report_of(folder: Path, *names: str) -> Report:
    """Report on runs that no test has changed."""
    return make_report([folder / name for name in names])


def rows_of(table: Table) -> dict[str, dict]:
    return {next(iter(row.values())): row for row in table.records()}


@pytest.mark.parametrize("table", [paper.ROBOT, paper.WORKPIECE], ids=lambda table: table.sweep)
def test_every_percentage_of_the_paper_is_a_whole_count_of_targets(table):
    for method, row in table.rows.items():
        exact = 100 * table.tracked(method) / (table.scenarios * paper.TARGETS)
        assert abs(exact - row.success_percent) < 0.00501, method


def test_the_results_hold_the_counts_behind_each_percentage(folder):
    rows = rows_of(tables.results(part_of(folder, "poses")))
    lost = sum(k % 4 for k in range(49))
    base = rows["baseline"]
    assert (base["tracked"], base["targets"], base["complete"], base["scenarios"]) == (5145 - lost, 5145, 13, 49)
    assert base["tracked_percent"] == pytest.approx(100 * (5145 - lost) / 5145)
    assert base["clearance_min_mm"] == pytest.approx(1.0)
    assert rows["hybrid"]["tracked_percent"] == 100
    attempted = 5145 - lost + 36  # the failed targets, one a scenario
    assert base["step_ms"] == pytest.approx(1e3 / attempted)


def test_a_method_is_compared_with_the_best_one_scenario_by_scenario(folder):
    part = part_of(folder, "poses")
    base, best = (part.plans[method].executable.sum(axis=1) for method in ("baseline", "hybrid"))
    more, fewer, equal = (int(which.sum()) for which in (base > best, base < best, base == best))
    assert more == 0 < fewer and equal == 49 - fewer
    first, *_ = tables.pairs(part).records()
    assert tables.pairs(part).title == "Compared with hybrid, the method with the most executable targets"
    equal_plans = replace(part, plans=dict.fromkeys(("baseline", "hybrid"), part.plans["hybrid"]))
    assert "baseline, one of the methods with the most" in tables.pairs(equal_plans).title
    counts = {"more": 0, "fewer": fewer, "equal": equal}
    named = {"method": "baseline", "other": "hybrid", "criterion": "executable targets", "test": "sign test"}
    assert first == {**named, **counts, "p": first["p"]}
    assert first["p"] == pytest.approx(2 * 0.5**fewer)  # all of them to one side, or all to the other


def test_methods_are_compared_by_complete_scenarios_with_the_exact_test_of_mcnemar(folder):
    _, complete, driven = tables.pairs(part_of(folder, "poses")).records()
    assert complete["criterion"] == "complete" and complete["test"] == driven["test"] == "McNemar"
    assert (complete["more"], complete["fewer"], complete["equal"]) == (0, 36, 13)  # the baseline completes 13 of 49
    assert complete["p"] == pytest.approx(2 * 0.5**36) and driven["p"] == pytest.approx(2 * 0.5**49)


def test_the_papers_four_columns_stand_next_to_ours_for_its_methods_on_its_grids_alone(folder):
    (row,) = tables.paper(part_of(folder, "poses")).records()
    theirs = {key: value for key, value in row.items() if key.startswith("paper_")}
    assert theirs == pytest.approx(
        {
            "paper_tracked_percent": 39.16, "paper_step_ms": 278.9, "paper_tcp_distance_mm": 0.4831,
            "paper_safe_distance_mm": 12.0973,
        }
    )  # fmt: skip
    ours = rows_of(tables.results(part_of(folder, "poses")))[row["method"]]
    assert row["method"] == "baseline" and all(row[key] == ours[key] for key in row.keys() & ours.keys())
    assert not tables.paper(part_of(folder, "one")).rows
    found = {name: part_of(folder, name).paper_table for name in ("poses", "starts", "measuring", "one")}
    assert found == {"poses": paper.WORKPIECE, "starts": paper.ROBOT, "measuring": None, "one": None}


def test_the_stops_count_reasons_and_name_the_targets(folder):
    (row,) = tables.stop_table(part_of(folder, "poses")).records()
    assert (row["method"], row["reason"], row["scenarios"]) == ("baseline", "iteration limit", 36)
    assert (row["first_target"], row["median_target"], row["last_target"]) == (102, 103, 104)
    assert row["targets"] == "102 (12), 103 (12), 104 (12)"


def test_blocked_joint_paths_are_counted_of_all_accepted_steps_and_cut_the_prefix(folder):
    rows = rows_of(tables.steps(part_of(folder, "one")))
    base = rows["baseline"]  # two scenarios of 13 targets, the second without its last
    assert (base["accepted"], base["blocked"], base["not_checked"]) == (25, 12, 0)
    assert base["scenarios_blocked"] == 2 and base["tracked_before"] == 2
    assert rows["hybrid"]["blocked"] == 0 and rows["hybrid"]["tracked_before_percent"] == 100


def test_the_axes_are_what_varies_without_what_follows_from_another(folder):
    part = part_of(folder, "starts")
    assert list(part.axes) == ["start_joint3_rad", "start_joint4_rad", "start_joint5_rad"]
    np.testing.assert_allclose(part.axes["start_joint3_rad"], [0.3, 0.4, 0.5, 0.6, 0.7])
    doubled = replace(part, parameters={**part.parameters, "margin_m": 2 * part.parameters["start_joint3_rad"]})
    assert list(doubled.axes) == list(part.axes)


def test_cells_are_means_over_the_other_axes_and_leave_out_what_is_not_known(folder):
    part = part_of(folder, "four")
    values = part.parameters["start_joint4_rad"] + 10 * part.parameters["start_joint6_rad"]
    cells = part.cells(values, ["start_joint4_rad", "start_joint1_rad"])
    np.testing.assert_allclose(cells, [[1.6, 1.6], [1.7, 1.7]])
    unknown = np.where(part.parameters["start_joint4_rad"] == 0.1, np.nan, values)
    assert np.isnan(part.cells(unknown, ["start_joint4_rad"])).tolist() == [True, False]


def test_the_headline_counts_what_can_be_driven_next_to_what_is_tracked(folder):
    """Headline with executable targets next to tracked ones (regression: 97.28 % tracked, 69.66 % executable)."""
    part = part_of(folder, "one")
    base, hybrid = tables.results(part).records()
    assert (base["tracked"], base["executable"], base["targets"]) == (25, 2, 26)
    assert base["executable_percent"] == pytest.approx(100 * 2 / 26)
    assert hybrid["tracked"] == hybrid["executable"] == 26
    figures = report_of(folder, "one").figures
    texts = [text.get_text() for text in figures["success"].axes[0].texts]
    assert texts[::2] == [
        "targets 96.15 %  (25 of 26), executable 7.69 %",
        "targets 100.00 %  (26 of 26), executable 100.00 %",
    ]


def test_the_maps_count_what_can_be_driven(folder):
    """Maps of executable targets (regression: the map showed tracked targets only)."""
    part = part_of(folder, "poses")
    figure = report_of(folder, "poses").figures["map"]
    cells = [text.get_text() for text in figure.axes[0].texts]
    assert cells[:4] == ["1\n(105)", "1\n(104)", "1\n(103)", "1\n(102)"] and len(cells) == len(part.numbers)
    assert [text.get_text() for text in figure.axes[1].texts] == ["105"] * 49


def test_the_report_shows_the_cell_and_the_best_scenarios_with_their_parameters(folder):
    """Picture of the cell, and the best scenarios with their parameters (regression: neither was shown)."""
    made = report_of(folder, "poses")
    assert "cell" in made.figures
    rows = made.frame("best").to_dict("records")
    assert [row["method"] for row in rows] == ["baseline"] * 3 + ["hybrid"] * 3
    ranks = [(-row["executable"], -row["clearance_min_mm"], row["joint_motion_rad"]) for row in rows]
    assert ranks[:3] == sorted(ranks[:3]) and ranks[3:] == sorted(ranks[3:])
    given = part_of(folder, "poses").parameters["rotation_y_rad"]
    assert [row["rotation_y_rad"] for row in rows] == [given[row["scenario"]] for row in rows]
    table = next(block for block in made.blocks if isinstance(block, Table) and block.name == "best")
    assert "rotation y [rad]" in [column.title for column in table.columns]


def test_the_best_scenario_is_the_one_that_gets_furthest_then_the_clearest(folder):
    part = part_of(folder, "one")
    plans = part.plans["hybrid"]
    clearance = plans.clearance + np.array([[0.0], [0.001]])
    clearer = replace(part, plans={"hybrid": plans._replace(clearance=clearance)})
    assert [row["scenario"] for row in best_scenarios(clearer).records()] == [1, 0]
    status = plans.status.copy()
    status[1, -1] = Status.ITERATION_LIMIT
    shorter = replace(part, plans={"hybrid": plans._replace(clearance=clearance, status=status)})
    assert [row["scenario"] for row in best_scenarios(shorter).records()] == [0, 1]


def test_a_run_whose_cloud_is_gone_is_reported_without_its_picture(folder):
    cloud = (folder / "box.xyz").read_text()
    (folder / "box.xyz").write_text(cloud + "0 0 0\n")
    made = make_report([folder / "one"])
    (folder / "box.xyz").write_text(cloud)
    assert "cell" not in made.figures
    assert any(
        "no picture of the cell" in block and "box.xyz" in block for block in made.blocks if isinstance(block, str)
    )


def test_the_stops_say_which_bodies_are_in_collision(folder):
    """Colliding bodies in the table of stops (regression: only `recovery exhausted`)."""
    part = part_of(folder, "poses")
    (row,) = tables.stop_table(part).records()
    counts = [int(count) for count in re.findall(r"\((\d+)\)", row["cause"])]
    assert sum(counts) == row["scenarios"] and counts == sorted(counts, reverse=True)
    made = report_of(folder, "poses").blocks
    assert any("Cause: the colliding body" in block for block in made if isinstance(block, str))


class _Found(OpenedScene):
    """Scene of a run in which a body is inside the workpiece at the failed target of scenario 1 only."""

    def __init__(self):
        super().__init__(run=None, plans={})

    def colliding_bodies(self, method):
        one = Obstruction("spindle", np.zeros(3), 0.002, 0.0, True, np.zeros(6))
        return {number: one if number == 1 else one._replace(depth_m=-0.041) for number in range(49)}


def test_a_body_counts_as_colliding_only_where_it_collides_and_else_the_end_of_the_search_is_reported(folder):
    """Stops by colliding body, else by the end of the search (regression: bodies that were 41 to 75 mm clear)."""
    part = replace(part_of(folder, "poses"), scene=_Found())
    (row,) = tables.stop_table(part).records()
    assert row["cause"] == f"step QPs out of iterations ({row['scenarios'] - 1}), spindle (1)"
    reported = [each["cause"] for each in tables.scenarios(part).records()]
    assert sum(text.startswith("no body collides") for text in reported if text) == 2 * 48


def test_tracked_targets_that_are_not_executable_are_counted_by_the_result_of_the_motion_check(folder):
    """Tracked targets that are not executable, by the result of the motion check (regression: no reason given)."""
    part = part_of(folder, "poses")
    plans = part.plans["baseline"]
    segment_status = plans.segment_status.copy()
    segment_status[0, 1], segment_status[1, 1] = SegmentStatus.REVERSES, SegmentStatus.UNDECIDED
    part = replace(part, plans={"baseline": plans._replace(segment_status=segment_status)})
    table = tables.motion_ends(part)
    rows = {row["reason"]: row for row in table.records()}
    (result,) = tables.results(part).records()
    assert set(rows) == {"in collision", "reverses", "undecided"}
    assert rows["reverses"]["scenarios"] == rows["undecided"]["scenarios"] == 1
    assert sum(row["targets"] for row in rows.values()) == result["tracked"] - result["executable"]
    assert table in chapter(part, tables_of(part) | {table.name: table}, "", 2)


def test_a_chapter_begins_with_the_scenarios_that_can_be_run_and_their_guaranteed_clearance(folder):
    part = part_of(folder, "poses")
    done = part.plans["baseline"].outcomes.can_be_driven
    known = part.motions["baseline"].segment_clearance_min_m
    first = chapter(part, tables_of(part), "", 2)[0]
    assert first == answer(part) and first.startswith("A proven motion leads to the last target in ")
    assert f"{done.sum()} of {len(done)} scenarios by baseline" in first or f"{done.sum()} by baseline" in first
    if done.any():
        assert f"{1e3 * known[done].min():.3g} mm" in first
    unknown = part.motions["baseline"]._replace(segment_clearance_min_m=np.full(len(done), np.nan))
    alone = replace(part, plans={"baseline": part.plans["baseline"]}, motions={"baseline": unknown})
    assert answer(alone).endswith(f" {done.sum()} of {len(done)} scenarios by baseline.")


def test_a_study_with_a_scene_of_its_own_is_not_compared_with_the_paper_s(folder):
    """Comparison with the paper's configuration: none for a study with its own scene (regression)."""
    names = [block.name for block in report_of(folder, "one").blocks if isinstance(block, Table)]
    assert "configuration" not in names
    (table,) = (
        block
        for block in report_of(folder, "one", "measuring").blocks
        if isinstance(block, Table) and block.name == "configuration"
    )
    assert [column.key for column in table.columns] == ["key", "one", "measuring"]
    assert {row["key"] for row in table.records()} == {"workpiece.path"}


def test_a_study_with_the_built_in_scene_lists_the_keys_that_differ_from_the_default_job(tmp_path):
    (tmp_path / "study.yaml").write_text("grid:\n  - start_rad.6: [-2.0, -1.9]\nconfig: job.yaml\n")
    for margin, keys in ((0.002, [["margin_m"]]), (PlanConfig().margin_m, [])):
        (tmp_path / "job.yaml").write_text(f"margin_m: {margin}\n")
        report = make_report(kept(tmp_path / "study.yaml", "baseline", tmp_path / f"run-{margin}"))
        listed = [block for block in report.blocks if isinstance(block, Table) and block.name == "configuration"]
        assert [[row["key"] for row in table.records()] for table in listed] == keys
        assert not listed or [column.key for column in listed[0].columns] == ["key", "study", "duct.yaml"]


def test_ranges_and_slices_carry_their_units(folder):
    """Units of ranges and slices (regression: "rotation y = 0.2", without a unit)."""
    reported = " ".join(part_facts(part_of(folder, "poses")))
    assert "rotation y (0.2 to 0.8 rad, 11.5 to 45.8 degrees)" in reported
    titles = [axes.get_title() for axes in report_of(folder, "starts").figures["map"].axes]
    assert "start joint3 = 0.3 rad" in titles


def test_what_was_run_is_reported_with_every_deviation(folder):
    assert choice(part_of(folder, "poses")).startswith("paper.yaml, apart from workpiece.cloud box.xyz, ")
    reported = choice(part_of(folder, "measuring"))
    assert reported == "margin 0.5 mm, default settings"
    assert str(folder) not in " ".join(part_facts(part_of(folder, "poses")))


def test_every_column_of_the_report_has_the_heading_of_its_key(folder):
    """All tables but those whose columns are runs."""
    blocks = report_of(folder, "poses", "starts").blocks
    tables = [each for each in blocks if isinstance(each, Table) and each.name not in ("overview", "configuration")]
    shown = {(column.key, column.heading) for table in tables for column in table.columns}
    assert len(shown) > 40
    assert {key for key, heading in shown if heading not in (columns.column(key).heading, "of")} == set()


def test_groups_are_parts_with_tables_of_their_own(folder):
    report = report_of(folder, "groups", "one")
    assert [part.name for part in report.parts] == ["groups: first", "groups: second", "one"]
    assert [len(part.numbers) for part in report.parts] == [2, 3, 2]
    assert [
        column.heading
        for column in overview(
            {p.name: t["results"] for p, t in zip(report.parts, report.part_tables, strict=True)}
        ).columns
    ] == [
        "method",
        "groups: first",
        "groups: second",
        "one",
    ]
    (first, *_) = overview({"one": report.part_tables[2]["results"]}).rows
    assert first[1] == report.part_tables[2]["results"].records()[0]["executable_percent"]
    scenarios = {table.name: table for table in report.tables}["scenarios"].records()
    assert [row["run"] for row in scenarios].count("groups: second") == 6


def test_an_unfinished_run_is_reported_as_far_as_it_is(folder, tmp_path):
    run = kept(folder / "groups.yaml", "baseline,hybrid,keep-clear", tmp_path / "half", shard_scenarios=1)
    unfinished = run.manifest.model_copy(update={"shards": run.manifest.shards[:6]})  # five of baseline, one of hybrid
    (run.folder / MANIFEST).write_text(unfinished.model_dump_json())
    report = make_report([tmp_path / "half"])
    first, second = report.parts
    assert rows_of(tables.results(first))["hybrid"]["scenarios"] == 1
    assert "Scenarios still to plan: hybrid: 4, keep-clear: 5." in " ".join(part_facts(second))
    assert list(second.plans) == ["baseline"]


def test_the_reach_of_each_target_is_a_table_and_a_picture_and_an_unknown_word_is_refused(folder):
    file = folder / "one" / REACHABILITY
    each = [["not judged"] * 3 + ["reachable"] * 8 + ["tool", "undecided"]] * 2
    known = {"prefix": [11, 11], "most": [11, 11], "resolution_rad": 0.1, "seed": 0}
    try:
        file.write_text(json.dumps(known | {"each": each}))
        rows = rows_of(tables.reach_table(read_part(folder, "one")))
        assert {reach: row["targets"] for reach, row in rows.items()} == {
            "reachable": 16,
            "excluded: tool": 2,
            "undecided": 2,
        }
        assert "reach" in {block.name for block in make_report([folder / "one"]).blocks if isinstance(block, Picture)}
        file.write_text(json.dumps(known | {"each": [["perhaps"]] * 2}))
        with pytest.raises(InputError, match=REACHABILITY):
            read_part(folder, "one")
    finally:
        file.unlink()


def test_the_reachability_is_compared_with_and_what_beats_it_is_named(folder, tmp_path):
    file = folder / "one" / REACHABILITY
    try:
        file.write_text(json.dumps({"prefix": [12, 13], "most": [13, 13], "resolution_rad": 0.1, "seed": 0}))
        part = read_part(folder, "one")
        rows = rows_of(tables.reachability_table(part))
        assert (rows["baseline"]["reachable"], rows["baseline"]["of_reachable_percent"]) == (25, 100)
        assert (rows["baseline"]["short"], rows["baseline"]["beyond"]) == (1, 1)
        assert "Scenarios with more tracked than reachable targets: baseline in 1 (0); hybrid in 1 (0)." in markdown(
            make_report([folder / "one"]).blocks
        )
        other = '"most": [13, 13], "resolution_rad": 0.1, "seed": 0}'
        wrong = (f'{{"prefix": {prefix}, {other}' for prefix in ("[1]", '["x", 2]'))
        for damaged in ("{", "[]", '{"prefix": [12, 13]}', *wrong):
            file.write_text(damaged)
            with pytest.raises(InputError, match=REACHABILITY):
                read_part(folder, "one")
    finally:
        file.unlink()


def test_the_command_prints_the_table_and_writes_a_report_that_stands_alone(folder, tmp_path, capsys):
    assert main(["report", str(folder / "poses"), "--out", str(tmp_path / "report")]) == 0
    output = capsys.readouterr()
    assert re.search(r"baseline +98\.60 +5,073 +5,145 +49 +0\.95 +26\.53\n", output.out) and output.err == ""
    page = (tmp_path / "report" / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 9
    assert not re.search(r"<script|src=\"(?!data:)|href=\"(?!#)|url\(|@import", page)
    text = (tmp_path / "report" / "report.md").read_text()
    pictures = re.findall(r"!\[.+\]\((.+)\)", text)
    assert len(pictures) == 9 and all((tmp_path / "report" / name).stat().st_size for name in pictures)
    assert str(folder) not in page + text
    with open(tmp_path / "report" / "results.csv", newline="") as stream:
        (base, hybrid) = csv.DictReader(stream)
    assert float(base["tracked_percent"]) == 100 * 5073 / 5145 and float(hybrid["tracked_percent"]) == 100
    assert sorted(file.name for file in (tmp_path / "report").glob("*.csv")) == [
        "best.csv", "joint-steps.csv", "motion-ends.csv", "motions.csv", "pairs.csv", "paper.csv", "results.csv",
        "scenario-rates.csv", "scenarios.csv", "spread.csv", "stops.csv", "times.csv",
    ]  # fmt: skip


def test_the_motions_of_a_part_are_counted_and_measured(folder):
    """Motions in the report: counts, costs and dwells.

    The arm of `by_hand` goes from its start to zero, and rests; the baseline's motions end before the second target.
    """
    rows = rows_of(motion_table(part_of(folder, "poses")))
    base, hybrid = rows["baseline"], rows["hybrid"]
    assert (base["executable"], base["complete_motions"], hybrid["executable"], hybrid["complete_motions"]) == (
        49,
        0,
        5145,
        49,
    )
    assert hybrid["dwells"] == hybrid["dwelling"] == hybrid["path_step_max_rad"] == hybrid["curvature_max_rad_m2"] == 0
    assert hybrid["cost_median_rad2"] == pytest.approx(2.3**2 + 0.5**2 + 0.5**2 + 2.0**2)
    assert base["cost_median_rad2"] is base["path_step_max_rad"] is base["cost_common_rad2"] is None


def test_costs_are_compared_where_every_method_s_motion_leads_to_the_end(folder):
    """Common cost of the scenarios that every method completes.

    Scenarios 0 to 3, of three targets; one method loses the last of 1, and the cost of 2 is unknown.
    """
    part = part_of(folder, "one")
    plans = plans_with([[Status.TRACKED] * 3] * 4)
    plans = plans._replace(segment_status=np.full_like(plans.segment_status, SegmentStatus.VALID))
    short = plans._replace(
        segment_status=np.where(np.arange(12).reshape(4, 3) == 5, SegmentStatus.OFF_PATH, plans.segment_status).astype(
            np.int8
        )
    )

    def figures(dwells, costs, steps, bends):
        return MotionFigures(*(np.array(column, float) for column in (dwells, costs, steps, bends, [1e-3] * 4)))

    nan = np.nan
    known = {
        "a": figures([0, 2, nan, 1], [2.0, 3.0, nan, 8.0], [0.1, 0.5, nan, 0.2], [10, 20, nan, nan]),
        "b": figures([0, 0, nan, 0], [1.0, 9.0, nan, 4.0], [0.3, 0.1, nan, 0.2], [1, 2, nan, 3]),
    }
    made = replace(part, numbers=np.arange(4), plans={"a": plans, "b": short}, motions=known)
    a, b = rows_of(motion_table(made)).values()
    assert (a["executable"], a["complete_motions"], b["executable"], b["complete_motions"]) == (12, 4, 11, 3)
    assert (a["dwells"], a["dwelling"], b["dwells"], b["dwelling"]) == (3, 2, 0, 0)
    assert (a["cost_median_rad2"], b["cost_median_rad2"]) == (3.0, 2.5)
    assert (a["cost_common_rad2"], b["cost_common_rad2"]) == (pytest.approx(4.0), pytest.approx(2.0))
    assert (a["path_step_max_rad"], a["curvature_median_rad_m2"], a["curvature_max_rad_m2"]) == (0.5, 15, 20)
    assert "the 3 scenarios in which every method's motion does" in meaning(made)


def test_compilation_has_a_row_of_its_own_as_methods_share_programs(folder):
    part = part_of(folder, "one")
    *methods, last = tables_of(part)["times"].records()
    assert [row["method"] for row in methods] == list(part.plans)
    assert [row["run_s"] for row in methods] == [plans.run_s for plans in part.plans.values()]
    assert all(row["compile_s"] is None for row in methods) and last["run_s"] is None
    compile_s = sum(p.compile_s for p in part.plans.values())
    assert last == {"method": "all methods", "run_s": None, "cpu_s": None, "compile_s": compile_s}


def wilson(k: int, n: int, sign: int) -> float:
    """Bound of the 95 % confidence interval of a rate in percent; Wilson (1927)."""
    z, p = 1.959963984540054, k / n
    return 100 * (p + z * z / (2 * n) + sign * z * ((p * (1 - p) + z * z / (4 * n)) / n) ** 0.5) / (1 + z * z / n)


def test_rates_of_scenarios_have_the_interval_of_wilson(folder):
    records = tables_of(part_of(folder, "poses"))["scenario-rates"].records()
    rows = {(row["method"], row["criterion"]): row for row in records}
    driven = "executable to the last target"
    for key, k in {("baseline", "complete"): 13, ("baseline", driven): 0, ("hybrid", driven): 49}.items():
        row = rows[key]
        assert (row["scenarios"], row["planned"], row["rate_percent"]) == (k, 49, pytest.approx(100 * k / 49))
        bounds = [row[f"rate_{end}_percent"] for end in ("low", "high")]
        assert bounds == pytest.approx([wilson(k, 49, sign) for sign in (-1, 1)], abs=1e-9)


def test_quartiles_are_over_scenarios_and_motion_and_times_of_those_that_have_them(folder):
    part = part_of(folder, "poses")
    base, hybrid = tables_of(part)["spread"].records()
    executable = 100 * part.plans["baseline"].executable.sum(axis=1) / 105
    assert [base[f"executable_{q}_percent"] for q in ("q1", "median", "q3")] == np.quantile(
        executable, (0.25, 0.5, 0.75)
    ).tolist()
    motion = part.plans["hybrid"].joint_step.sum(axis=1)
    assert hybrid["joint_motion_median_rad"] == np.median(motion) and base["joint_motion_median_rad"] is None
    attempted = part.plans["baseline"].attempted.sum(axis=1)
    assert base["planning_q3_ms"] == pytest.approx(1e3 * np.quantile(attempted / attempted.sum(), 0.75))  # of 1 s
    assert "cycle_q1_s" not in base


def test_the_paper_s_values_stand_next_to_a_part_of_its_scenarios_with_a_sentence(folder, tmp_path):
    spec = load_sweep(folder / "poses.yaml")
    run = keep_plans(spec, {"baseline": by_hand(spec.batch().scenarios, "baseline")}, tmp_path / "run", 7)
    some = {"count": 14, "limit": 14, "shards": run.manifest.shards[:2], "targets": 14 * 105}
    (run.folder / MANIFEST).write_text(run.manifest.model_copy(update=some).model_dump_json())
    report = make_report(run.folder)
    (part,) = report.parts
    assert part.paper_table is paper.WORKPIECE and len(part.numbers) == 14
    assert report.frame("paper").paper_tracked_percent.tolist() == [39.16]
    assert "The paper's values are for all 49 scenarios, ours for 14 of them." in markdown(report.blocks)


def test_the_lowest_feed_is_mentioned_only_for_a_timed_run(folder):
    part = part_of(folder, "one")
    known = {method: np.full(plans.status.shape, 0.1) for method, plans in part.plans.items()}
    alone = replace(part, manipulability=known)
    assert charts_of(alone)["manipulability"].alt.endswith("by method")
    ones = dict.fromkeys(("cycle_time_s", "feed_held_share", "feed_target"), [1] * len(part.numbers))
    rows = pa.table({"scenario": part.numbers, **ones})
    timed = replace(alone, timing=alone.timing | {"hybrid": rows})
    assert charts_of(timed)["manipulability"].alt.endswith("and where the feed is lowest")


def test_one_chart_is_drawn_without_the_rest_of_the_report(folder, monkeypatch):
    whole = report_of(folder, "poses").figures["map"]
    monkeypatch.setattr(OpenedScene, "picture", None)  # the picture of the cell would fail
    assert png(htcp_jax.chart(folder / "poses", "map")) == png(whole)
    runs = [folder / "groups", folder / "one"]
    assert (
        htcp_jax.chart(runs, "groups-second-success").axes[0].get_xlabel() == "targets tracked, scenarios complete [%]"
    )
    with pytest.raises(InputError, match=r"no chart 'sucess'; did you mean success\?"):
        htcp_jax.chart(folder / "poses", "sucess")


def test_every_parameter_that_varies_jointly_is_named_wherever_a_scenario_or_the_study_is(folder):
    part = part_of(folder, "jointly")
    both = [part.parameters[f"start_joint{k}_rad"] for k in (5, 6)]
    label = ", ".join(f"start joint{k} {own[3]:.6g} rad" for k, own in zip((5, 6), both, strict=True))
    assert part.labels[3] == part.run.labels()[3] == label and part.label(3, 1).endswith(" and 1 more")
    first = part_facts(part)[0]
    ranges = {5: "[0.1, 0.2] rad", 6: "[-2, -1.9] rad"}
    assert all(f"start joint{k} (drawn uniform in {interval})" in first for k, interval in ranges.items())
    assert first.startswith("40 scenarios over ") and ", an independent draw of each in every scenario; up to" in first
    assert {"start_joint5_rad", "start_joint6_rad"} <= {column.key for column in best_scenarios(part).columns}


@pytest.mark.parametrize("name", ["start_rad.joint5", "start_rad.5", "joint5", "start_joint5_rad"])
def test_random_parameters_are_drawn_as_rates_in_bins_with_intervals_and_each_can_be_chosen(folder, name):
    part, (axes, *more) = part_of(folder, "jointly"), htcp_jax.chart(folder / "jointly", "map", over=name).axes
    values, done = part.parameters["start_joint5_rad"], part.plans["hybrid"].outcomes.can_be_driven
    bins = np.array_split(np.argsort(values), 4)  # of ten scenarios
    (line,) = [each for each in axes.lines if each.get_label() == "hybrid"]
    assert not more and line.get_ydata().tolist() == [100 * done[rows].mean() for rows in bins] == [100.0] * 4
    for method in axes.lines:  # all methods' points at the mean, also next to each other
        np.testing.assert_allclose(method.get_xdata(), [values[rows].mean() for rows in bins])
    assert len({method.get_marker() for method in axes.lines}) == len(axes.lines) == 2
    assert "a bin of 10 scenarios with similar values, at their mean" in axes.figure.texts[1].get_text()
    interval = axes.collections[1].get_segments()[0][:, 1]
    np.testing.assert_allclose(interval, [wilson(10, 10, sign) for sign in (-1, 1)])
    labels = [panel.get_xlabel() for panel in htcp_jax.chart(folder / "jointly", "map").axes]
    assert labels == ["start joint5 [rad]", "start joint6 [rad]"] and "[%]" in axes.get_ylabel()


def test_a_chart_over_an_unknown_parameter_names_the_valid_ones(folder):
    with pytest.raises(InputError, match=r"over is 'joint4'; .*valid: start_joint5_rad, start_joint6_rad"):
        htcp_jax.chart(folder / "jointly", "map", over="joint4")
    with pytest.raises(InputError, match=r"over is 'start_rad.joint4'; did you mean start_rad.joint[56]\?"):
        htcp_jax.chart(folder / "jointly", "map", over="start_rad.joint4")
    with pytest.raises(InputError, match="argument of the chart 'map', not of 'survival'"):
        htcp_jax.chart(folder / "jointly", "survival", over="joint5")


@pytest.mark.parametrize("name", ["workpiece.shift_m.x", "shift_m.x", "x", "shift_x_m"])
def test_an_element_of_a_vector_is_chosen_by_its_key_in_the_sweep_file_or_by_the_end_of_this_key(folder, name):
    part = part_of(folder, "shifts")
    assert part.column_of(name) == "shift_x_m"
    with pytest.raises(InputError, match=r"did you mean shift_m.x\?"):
        part.column_of("shift_mm.x")
    double = replace(part, keys=part.keys | {"cell.shift_m.x": "shift_z_m"})
    if name in ("shift_m.x", "x"):
        with pytest.raises(InputError, match="name of several parameters: shift_x_m, shift_z_m"):
            double.column_of(name)


def test_the_default_chart_of_several_runs_has_a_bar_for_each_method_and_run(folder):
    axes = htcp_jax.chart([folder / "poses", folder / "starts"]).axes[0]
    names = [text.get_text() for text in axes.get_yticklabels()]
    assert names == ["baseline, poses", "baseline, starts", "hybrid, poses", "hybrid, starts"]
    hatches = [bar.get_hatch() or "" for bar in axes.patches[2::3]]  # of the scenarios
    assert hatches[:2] == hatches[2:] and len({*hatches}) == 2
    done = [part_of(folder, name).plans["hybrid"].outcomes.complete for name in ("poses", "starts")]
    assert [bar.get_width() for bar in axes.patches[8::3]] == [100 * each.mean() for each in done]
    rate, low, high = done[0].mean(), *(wilson(done[0].sum(), len(done[0]), sign) for sign in (-1, 1))
    lines = [line.get_xdata() for line in axes.lines[1::2]]
    np.testing.assert_allclose(lines[2], [low, high])
    assert f"scenarios {100 * rate:.2f} %" in axes.texts[5].get_text()
    assert axes.figure.texts[0].get_text() == "Targets tracked and scenarios complete, by method and run"
    assert "success" in report_of(folder, "poses", "one").figures


def test_two_runs_of_a_grid_are_compared_method_by_method_with_both_tests(folder, tmp_path):
    spec = load_sweep(folder / "poses.yaml")
    first = spec.batch().scenarios
    run = keep_plans(spec, {"baseline": by_hand(first, "hybrid"), "hybrid": by_hand(first, "hybrid")}, tmp_path / "b")
    report = make_report([folder / "poses", run.folder])
    base, same = (rows.set_index("criterion") for _, rows in report.frame("between-runs").groupby("method"))
    assert base.fewer.to_dict() == {"executable targets": 49, "complete": 36, "executable to the last target": 49}
    assert base.p["complete"] == pytest.approx(2 * 0.5**36) and same.p.isna().all() and set(same.run) == {"poses"}
    assert not tables.between_runs(make_report([folder / "poses", folder / "starts"]).parts).rows  # other grids


def test_two_runs_by_other_code_of_one_version_are_told_apart(folder, tmp_path):
    """Heads of two runs: each names the method's package, and a sentence says whose code differs."""
    runs = [shutil.copytree(folder / "one", tmp_path / name) for name in ("a", "b")]
    for run in runs:
        added = {"code": {"method hybrid": run.name}, "plugins": {"method hybrid": "mine 1.0"}, "name": run.name}
        edit_manifest(run, lambda manifest, added=added: manifest.update(added))
    text = markdown(make_report(runs).blocks)
    assert "The code of the method hybrid differs between a and b: mine 1.0 in both." in text
    assert text.count("From other packages: method hybrid (mine 1.0).") == 2
    edit_manifest(runs[1], lambda manifest: manifest.update(plugins={"method hybrid": "mine 2.0"}))
    text = markdown(make_report(runs).blocks)
    assert "between a and b: mine 1.0 and mine 2.0." in text
    assert "From other packages: method hybrid (mine 2.0)." in text


def test_both_percentages_of_success_stand_in_the_first_table_with_their_definitions(folder):
    base = rows_of(tables.results(part_of(folder, "poses")))["baseline"]
    assert base["complete_percent"] == pytest.approx(100 * 13 / 49)
    text = markdown(report_of(folder, "poses").blocks)
    assert all(f"{words}:" in text for words in ("Targets tracked", "Scenarios complete")) and "success [" not in text


def test_every_chart_of_a_report_is_drawn_by_its_name(folder):
    known = {name for name in report_of(folder, "four").figures if name != "cell"}
    assert known == {*charts_of(part_of(folder, "four"))} and len(known) == 9


def test_methods_with_equal_results_share_a_sentence(folder):
    part = part_of(folder, "poses")
    both = replace(
        part, plans=part.plans | {"beam": part.plans["hybrid"]}, motions=part.motions | {"beam": part.motions["hybrid"]}
    )
    assert "49 of 49 scenarios by hybrid and beam (guaranteed" in answer(both)


def test_the_page_s_contents_lead_to_its_sections(folder, tmp_path, browser):
    report = report_of(folder, "poses", "one")
    write_report(report, tmp_path)
    page = browser.new_page()
    page.goto((tmp_path / "report.html").as_uri())
    texts = page.locator("nav a").all_inner_texts()
    assert texts == [block.text for block in report.blocks if isinstance(block, Heading) and block.level in (2, 3)]
    for link in page.locator("nav a").all():
        assert page.locator(f"{link.get_attribute('href')}:text-is('{link.inner_text()}')").count() == 1
    page.close()


@pytest.mark.parametrize("width", [400, 700, 1200])
def test_no_table_is_wider_than_the_page(folder, tmp_path, browser, width):
    write_report(report_of(folder, "poses"), tmp_path)
    page = browser.new_page(viewport={"width": width, "height": 900})
    page.goto((tmp_path / "report.html").as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.close()


def test_success_is_drawn_along_a_parameter_of_the_task_with_what_is_reachable_next_to_it(folder):
    part = part_of(folder, "four")
    [name, *_], reachability = part.axes, np.arange(len(part.numbers))
    parameters = {"task.2.cone_deg": part.parameters[name], **part.parameters}
    keys = {each: each for each in parameters if each in (*part.axes, "task.2.cone_deg")}
    requested = replace(part, parameters=parameters, reachability=reachability, keys=keys)
    [drawn] = [one for one in chapter(requested, tables_of(requested), "", 2) if getattr(one, "name", "") == ALONG]
    [dashed] = [line for line in drawn.figure.axes[0].lines if line.get_linestyle() == "--"]
    np.testing.assert_allclose(dashed.get_ydata(), part.cells(reachability.astype(float), [name]))
    assert not [one for one in chapter(part, tables_of(part), "", 2) if getattr(one, "name", "") == ALONG]


def test_grids_of_any_number_of_axes_are_drawn(folder):
    pictures = {name: re.findall(r"\((map.*)\)", markdown(report_of(folder, name).blocks)) for name in ("one", "four")}
    assert pictures == {"one": ["map.png"], "four": ["map-1-2.png", "map-3-4.png"]}


def test_json_holds_the_tables_as_records(folder, tmp_path, capsys):
    assert main(["report", str(folder / "one"), "--json", "--out", str(tmp_path / "out")]) == 0
    (run,) = json.loads(capsys.readouterr().out)["runs"]
    assert run["results"][1]["method"] == "hybrid" and run["results"][1]["tracked"] == 26
    assert run["validated"] is None and run["configuration"].startswith("margin 0.5 mm")


def check_by_a_stranger(run: Path, out: Path) -> int:
    """Check that a script without this package finds every number of a report; return how many numbers there are."""
    out.mkdir(exist_ok=True)
    write_report(make_report(run), out)
    found, checked = stranger_report.report_of(run), 0
    for file in out.glob("*.csv"):
        with file.open(newline="") as stream:
            rows = list(csv.DictReader(stream))
        theirs = found[file.stem]
        if file.stem in ("stops", "motion-ends"):  # in the order of their statuses' codes
            places = {(row["method"], row["reason"].lower()): k for k, row in enumerate(rows)}
            theirs = sorted(theirs, key=lambda row, places=places: places[row["method"], row["reason"]])
        if file.stem == "paper":
            theirs = [row for row in theirs if row["method"] in [each["method"] for each in rows]]
        assert len(rows) == len(theirs), file.name
        for k, (row, own) in enumerate(zip(rows, theirs, strict=True)):
            for key, text in row.items():
                if key in TEXTS or key.startswith("paper_"):
                    continue
                value = own.get(key)
                if isinstance(value, int | float) and not isinstance(value, bool):
                    assert float(text) == pytest.approx(value, rel=1e-9), (file.name, k, key)
                    checked += 1
                else:
                    assert text.lower() == str(value or "").lower(), (file.name, k, key)
    return checked


TEXTS = {"run", "cause", "motion_end", "package", "reachable"}


@pytest.mark.parametrize("name", ["poses", "starts", "one", "four"])
def test_a_stranger_s_script_finds_every_number_of_the_report_in_the_run_s_files(folder, tmp_path, name):
    assert check_by_a_stranger(folder / name, tmp_path) > 100


def test_a_stranger_s_script_finds_every_number_of_a_planned_run(planned, tmp_path):
    assert check_by_a_stranger(planned / "run", tmp_path / "report") > 200


def test_a_stranger_s_script_finds_every_number_of_a_timed_run(tmp_path):
    run = shutil.copytree(toy_run() / "run", tmp_path / "run")
    assert main(["program", str(run), "--all", "--feed", "20mm/s"]) == 0
    assert check_by_a_stranger(run, tmp_path / "report") > 200
    assert (tmp_path / "report" / "timing.csv").exists()


def test_bad_input_is_one_line_and_exit_2(folder, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    shard = next((folder / "measuring" / "targets").iterdir())
    whole = shard.read_bytes()
    try:
        shard.write_bytes(whole[:100])
        for name, line in {
            tmp_path / "empty": "contains neither a run (manifest.json) nor a plan (summary.json)",
            tmp_path / "none": "contains no run",
            folder / "measuring": shard.name,
        }.items():
            assert main(["report", str(name), "--out", str(tmp_path / "out")]) == 2
            output = capsys.readouterr()
            assert line in output.err and output.err.count("\n") == 1 and output.out == ""
            assert not (tmp_path / "out").exists()
    finally:
        shard.write_bytes(whole)


def test_tables_are_aligned_and_safe_in_markdown_and_html():
    columns = Column("a_mm", "a <i>", "mm", ".2f"), Column("b", "b")
    table = Table("t", columns, ((1.5, "x|y"), (float("nan"), "<b>"), (1000.0, "")))
    lines = markdown([table]).splitlines()
    assert len({len(line.replace("\\|", "\\|")) for line in lines}) == 1 and "x\\|y" in lines[2]
    page = html([Heading(1, "A & B"), table], {})
    assert "&lt;b&gt;" in page and "<b>" not in page and "A &amp; B" in page
    assert table.records()[1] == {"a_mm": None, "b": "<b>"}


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("start_joint3_rad", "start joint3 [rad]"),
        ("rotation_y_rad", "rotation y [rad]"),
        ("shift_x_m", "shift x [m]"),
        ("tool_extension_m", "tool extension [m]"),
        ("path", "path"),
    ],
)
def test_parameters_have_readable_names_with_units(name, text):
    assert columns.column(name).title == text
