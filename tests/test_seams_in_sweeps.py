"""Rows per seam: sweeps, reachability and placement searches of jobs with several seams."""

import json
from pathlib import Path

import numpy as np
import pytest
import toy
import yaml
from test_json_schemas import fits
from test_place import TOY_BEAM
from test_seams import LEFT, RIGHT, write_job

import htcp_jax
from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.jobs import load_config, load_sweep
from htcp_jax.placement import PlacementResult
from htcp_jax.placement.clock import FIRST, Clock, PlanTime
from htcp_jax.runs import open_run

BACK = RIGHT | {"name": "back", "direction": "backward", "after": ["left"]}
MARGINS = {"margin_m": [0.001, 0.002]}
PLACE = {"workpiece.shift_m.x": [-0.02, 0.02]}


def write_sweep(folder: Path, *axes, seams=(LEFT, BACK)) -> Path:
    """Write the toy job with seams and a sweep of it, and return the sweep's file."""
    write_job(folder, *seams)
    file = folder / "grid.yaml"
    file.write_text(yaml.safe_dump({"config": "job.yaml", "grid": list(axes)}))
    return file


def sweep(file: Path, out: Path, shard: int, method: str = "beam", *words: str) -> None:
    """Plan a sweep by the command, in shards of a size."""
    assert main(["sweep", str(file), "--methods", method, "--shard", str(shard), "--out", str(out), *words]) == 0


def place(folder: Path, out: str, **changes) -> PlacementResult:
    """Search for mountings of the toy's shelf for two seams by quick plans."""
    job = write_job(folder, LEFT, BACK, program={"velocity": [2.0] * 4})
    spec = {"place": PLACE, "perturbation": {"mm": 1}, "best": 1} | changes
    return htcp_jax.place(spec, folder / out, config=job, overrides=[*TOY_BEAM, "settings.smooth=false"])


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """Folder with a sweep of two margins and two seams in `run`, planned in shards of 3."""
    folder = tmp_path_factory.mktemp("swept")
    sweep(write_sweep(folder, MARGINS), folder / "run", 3)
    return folder


@pytest.fixture(scope="module")
def placed(tmp_path_factory):
    """Result of a search with two mountings, in the folder `out` next to its job."""
    return place(tmp_path_factory.mktemp("placed"), "out", within={"scenarios": 4})


def test_each_combination_has_a_row_for_each_seam_in_the_order_of_the_list(swept):
    run = open_run(swept / "run")
    rows = run.scenarios().to_pylist()
    assert [(row["margin_m"], json.loads(row["seam"])) for row in rows] == [
        (margin, seam) for margin in MARGINS["margin_m"] for seam in ("left", "back")
    ]
    assert run.labels() == {
        0: "margin 0.001 m, seam left", 1: "margin 0.001 m, seam back",
        2: "margin 0.002 m, seam left", 3: "margin 0.002 m, seam back",
    }  # fmt: skip


def test_a_row_has_its_seams_own_task_margin_and_feed(tmp_path):
    task = [{"point": "tcp", "on": "path", "axes": "xyz"}]
    own = LEFT | {"margin_m": 0.003, "feed": "7mm/s", "task": task}
    sweep = load_sweep(write_sweep(tmp_path, {"workpiece.shift_m.x": [0.0]}, seams=(own, BACK)))
    left, back = (point.config for point in sweep.points())
    assert sweep.batch().scenarios.margin_m.tolist() == [0.003, back.margin_m]
    assert (left.program.feed, len(left.task)) == ("7mm/s", 1) and back.margin_m != 0.003


def test_seams_with_other_kinds_of_rows_are_planned_validated_and_tested_for_reach_in_one_sweep(tmp_path, capsys):
    axis = {"axis": "tcp.z", "towards": [0, 0, 1], "cone_deg": 90}
    point = {"point": "tcp", "on": "path"}
    file = write_sweep(tmp_path, MARGINS, seams=(LEFT | {"task": [point, axis]}, BACK))
    sweep(file, tmp_path / "run", 3, "baseline", "--set", "start_rad=auto")  # fewer programs than a beam
    assert open_run(tmp_path / "run").plans("baseline").outcomes.can_be_driven.all()
    assert main(["validate", str(tmp_path / "run")]) == 0
    (method,) = json.loads((tmp_path / "run" / "validation.json").read_text())["methods"].values()
    assert [row["row"] for row in method["rows"]] == ["task.1: point tcp", "task.2: axis tcp.z"]
    assert main(["reachability", str(file), "--each", "--out", str(tmp_path / "reach")]) == 0


def test_a_row_plans_its_seam_as_a_job_of_this_seam_alone_in_its_direction(swept):
    points = load_sweep(swept / "grid.yaml").points()
    (left,), (back,) = (point.config.workpiece.seams for point in points[:2])
    assert left.after == back.after == () and back.direction == "backward"
    plans = open_run(swept / "run").plans("beam")
    alone = htcp_jax.plan(write_job(swept / "run", LEFT), ["margin_m=0.001"]).plans
    count = alone.status.shape[1]
    np.testing.assert_array_equal(plans.x[0, :count], alone.x[0])
    path = plans.target[1][plans.exists[1]][-5:]
    np.testing.assert_allclose(np.diff(path, axis=0), np.diff(toy.workpiece().path[5:10][::-1], axis=0), atol=1e-9)


def test_results_do_not_depend_on_the_shards(swept):
    sweep(swept / "grid.yaml", swept / "whole", 4)
    tables = [open_run(swept / name).targets().combine_chunks() for name in ("run", "whole")]
    assert tables[0].replace_schema_metadata() == tables[1].replace_schema_metadata()


def test_a_grid_may_choose_seams_and_vary_other_keys_with_them(tmp_path):
    file = write_sweep(tmp_path, {"seam": ["back", "left"], "margin_m": [0.001, 0.002]})
    jobs = [point.config for point in load_sweep(file).points()]
    assert [(job.workpiece.seams[0].name, job.margin_m) for job in jobs] == [("back", 0.001), ("left", 0.002)]


@pytest.mark.parametrize(
    ("axis", "says"),
    [
        ({"seam": ["left", "top"]}, r"seam is 'top'; valid: left, back"),
        ({"workpiece.path": ["path.csv"]}, r"workpiece\.path varies, but the job has seams; vary seam instead"),
    ],
)
def test_an_unknown_seam_and_a_path_next_to_seams_are_refused_in_one_line(tmp_path, axis, says):
    with pytest.raises(InputError, match=says) as refused:
        load_sweep(write_sweep(tmp_path, axis)).points()
    assert "\n" not in str(refused.value)


def test_an_axis_of_seams_needs_a_job_with_seams(tmp_path):
    toy.write_job(tmp_path)
    with pytest.raises(InputError, match="seam is 'left'; valid: the job has no key seams"):
        load_sweep({"grid": [{"seam": ["left"]}]}, tmp_path / "job.yaml").points()


def test_a_path_file_of_two_seams_has_two_rows(tmp_path):
    write_job(tmp_path, LEFT)
    sweep = load_sweep({"grid": [MARGINS]}, tmp_path / "job.yaml", {"workpiece.path": str(tmp_path / "two.csv")})
    assert [json.loads(point.varied["seam"]) for point in sweep.points()] == ["1", "2"] * 2


def test_the_gate_and_the_report_name_the_seam(swept, capsys):
    run, baseline = str(swept / "run"), str(swept / "baseline.yaml")
    assert main(["gate", run, "--baseline", baseline, "--update"]) == 0
    assert main(["gate", run, "--baseline", baseline]) == 0
    assert main(["report", run, "--out", str(swept / "report")]) == 0
    text = "".join(file.read_text() for file in (swept / "report").glob("*.md"))
    assert "seam" in text and "back" in text and "path left, back" in text
    capsys.readouterr()


def test_a_run_is_timed_with_each_seams_own_feed_unless_one_is_given(tmp_path, capsys):
    file = write_sweep(tmp_path, {"margin_m": [0.001]}, seams=(LEFT | {"feed": "7mm/s"}, BACK))
    job = yaml.safe_load((tmp_path / "job.yaml").read_text())
    program = {"feed": "20mm/s", "velocity": [2.0] * 4}
    (tmp_path / "job.yaml").write_text(yaml.safe_dump(job | {"program": program}))
    sweep(file, tmp_path / "run", 2)
    assert main(["program", str(tmp_path / "run"), "--all"]) == 0
    own = open_run(tmp_path / "run").scenarios().to_pylist()
    assert "7 to 20 mm/s by seam" in capsys.readouterr().out
    assert main(["program", str(tmp_path / "run"), "--all", "--feed", "20mm/s"]) == 0
    same = open_run(tmp_path / "run").scenarios().to_pylist()
    assert [row["feed_m_s"] for row in own + same] == [0.007, 0.02, 0.02, 0.02]
    assert own[0]["path_time_s"] > 2 * same[0]["path_time_s"] and own[1]["path_time_s"] == same[1]["path_time_s"]


def test_reachability_has_a_row_for_each_seam(swept, capsys):
    job = str(write_job(swept, LEFT, BACK))
    words = ["--resolution", "0.5", "--proof-cells", "0", "--out", str(swept / "reach"), "--json"]
    assert main(["reachability", job, *words]) == 0
    found = json.loads(capsys.readouterr().out)
    assert len(found["prefix"]) == 2 and found["seams"] == ["left", "back"]
    fits("reachability", found)


def test_a_mounting_is_complete_if_all_seams_are_and_its_job_has_all_of_them(placed):
    assert placed.scenarios == 4 and placed.complete == 2 and set(placed.seams()) == {"left", "back"}
    job = load_config(placed.folder / "best-1.yaml")
    given = load_config(placed.folder.parent / "job.yaml")
    assert [seam.model_dump() for seam in job.workpiece.seams] == [
        seam.model_dump() | {"path": str(Path(seam.path).resolve())} for seam in given.workpiece.seams
    ]
    assert placed.jobs == [["best-1.yaml"]]


def test_the_job_of_the_best_mounting_is_planned_with_both_seams(placed):
    out = placed.folder / "planned"
    assert main(["plan", str(placed.folder / "best-1.yaml"), "--out", str(out)]) == 0
    visits = json.loads((out / "summary.json").read_text())["order"]["visits"]
    assert [visit["name"] for visit in visits] == ["left", "back"]


def test_a_search_whose_time_ends_during_its_first_plans_is_refused_and_leaves_no_times(tmp_path):
    (tmp_path / "out").mkdir()
    with pytest.raises(InputError, match="the time limit of 1e-06 s ended the first quick plans; allow more time"):
        place(tmp_path, "out", within={"seconds": 1e-6})
    assert not list((tmp_path / "out").glob("*.json"))


def test_a_search_whose_time_is_nearly_up_after_one_call_confirms_one_mounting_and_perturbs_none(tmp_path):
    (tmp_path / "out").mkdir()
    first = {"rounds/000": PlanTime(FIRST, 8.5e4, quick=True)._asdict()}
    (tmp_path / "out" / "seconds.json").write_text(json.dumps({"calls": first}))
    found = place(tmp_path, "out", within={"seconds": 1e5}, best=2)
    assert found.scenarios == FIRST and len(found.mountings) == 1 and found.mountings[0].tolerance is None
    assert np.isnan(found.mountings[0].success_rate)
    assert not (found.folder / "perturbed").exists() and not (found.folder / "confirmed" / "001").exists()
    again = place(tmp_path, "out", within={"seconds": 1e5}, best=2)
    assert again.record()["ranked"][0]["objective"] == found.record()["ranked"][0]["objective"]


def test_a_call_grows_to_a_share_of_the_time_limit_and_what_does_not_fit_is_omitted(tmp_path):
    clock = Clock(tmp_path, 100.0, 0.0)
    clock.add("rounds/000", PlanTime(FIRST, FIRST * 0.01, quick=True), 0.0)
    assert clock.plans_together() == 4 * FIRST
    clock.add("rounds/001", PlanTime(4 * FIRST, 4 * FIRST * 0.5, quick=True), 0.0)
    assert clock.plans_together() == 10 and clock.fits(100, quick=True) and not clock.fits(200, quick=True)
    assert clock.fits(40, quick=False) and not clock.fits(50, quick=False)
    resumed = Clock(tmp_path, 100.0, 0.0)
    resumed.add("rounds/000", PlanTime(FIRST, 0.0, quick=True), 0.0)
    resumed.add("rounds/001", PlanTime(4 * FIRST, 0.0, quick=True), 0.0)
    assert resumed.used == clock.used
