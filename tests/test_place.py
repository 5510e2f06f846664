"""Placement searches by real planners: each ranked mounting holds when planned alone, perturbed, and by MuJoCo.

Neither threads nor kills have any influence on the results. The toy's shelf is moved away until the arm reaches it no
more; some slow searches move a plate behind a path of two points towards the GP50 until nothing fits.
"""

import json
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import toy
from stranger_jobs import small_box_job
from sweep_process import JOB, environment, make_sweep

import htcp_jax
from htcp_jax.cli import main
from htcp_jax.errors import InputError, Interrupted
from htcp_jax.io.arrays import parquet_bytes
from htcp_jax.placement import PlacementResult, place
from htcp_jax.placement.clock import FIRST, Clock, PlanTime
from htcp_jax.placement.place_file import load_search
from htcp_jax.placement.placement_result import locked_search
from htcp_jax.placement.progress import PlaceProgress
from htcp_jax.placement.scores import MountingPlanner, MountingScores, sweep_of
from htcp_jax.report.place_tables import read_search
from htcp_jax.runs import open_plans, open_run
from htcp_jax.runs.sweep import sweep
from htcp_jax.status import SegmentStatus
from htcp_jax.trajectory import time_run
from htcp_jax.trajectory.plan_program import program_of

FILE = """
config: job.yaml
place:
  workpiece.rotation_y_rad: [0.3, 0.5]
  workpiece.shift_m: [[-1.85, -0.8], 0.02, 0.0]
objective: [clearance, joint motion]
within: {scenarios: 12}
perturbation: {mm: 20, deg: 1}
best: 3
"""
TOY_FILE = """
config: job.yaml
place:
  workpiece.rotation_y_rad: [-0.3, 0.3]
  workpiece.shift_m: [[0.4, 0.6], 0.02, 0.0]
objective: [clearance, joint motion]
within: {scenarios: 12}
perturbation: {mm: 20, deg: 3}
best: 3
tolerances: 1
"""
TOY_BEAM = [
    f"settings.{name}={getattr(toy.SETTINGS, name)}" for name in ("beam_width", "min_beam_width", "self_motions")
]
FEWER_TARGETS = "  approach_to_inlet: 1\n  approach_to_path: 1\n"
SMALL_BEAM = "settings: {beam_width: 6, min_beam_width: 4, self_motions: 6, self_motion_rounds: 2, smooth: false}\n"
RESULTS = "ranked.json", "mountings.parquet", "ranked/manifest.json"
KILLS = 20


def make(folder: Path) -> Path:
    """Write a search in front of the GP50."""
    make_sweep(folder)
    (folder / "job.yaml").write_text(JOB + FEWER_TARGETS + SMALL_BEAM)
    (folder / "place.yaml").write_text(FILE)
    return folder


def make_toy(folder: Path) -> Path:
    """Write a search with the toy arm, which takes seconds."""
    toy.write_job(folder, 3, replace(toy.SETTINGS, smooth=False), program={"velocity": [2.0] * 4})
    (folder / "place.yaml").write_text(TOY_FILE)
    return folder


def place_toy(folder: Path, out: str, **choices) -> PlacementResult:
    """Search in quick plans with the toy's beam, whose programs are compiled anyway."""
    return place(folder / "place.yaml", folder / out, overrides=TOY_BEAM, **choices)


def results(folder: Path) -> dict[str, bytes]:
    """Ranking files of a search, and the rows of all its runs, however they are divided into shards."""
    rows = {str(file.parent.relative_to(folder)): open_run(file.parent) for file in folder.rglob("manifest.json")}
    tables = {name: (run.targets().combine_chunks(), run.scenarios().combine_chunks()) for name, run in rows.items()}
    files = {
        name: b"".join(parquet_bytes(table.replace_schema_metadata()) for table in two) for name, two in tables.items()
    }
    return {name: (folder / name).read_bytes() for name in RESULTS[:2]} | files


@pytest.fixture(scope="module")
def heard() -> list[PlaceProgress]:
    """Progress of the uninterrupted search."""
    return []


@pytest.fixture(scope="module")
def found(tmp_path_factory, heard) -> PlacementResult:
    """An uninterrupted search."""
    return place_toy(make_toy(tmp_path_factory.mktemp("placed")), "out", progress=heard.append)


@pytest.fixture
def here(tmp_path) -> Path:
    return make_toy(tmp_path)


@pytest.fixture(scope="module")
def stopped(tmp_path_factory) -> Path:
    """Folder with a search in `out` that was stopped before the confirmation, with the message in `message.txt`."""
    folder = make_toy(tmp_path_factory.mktemp("stopped"))
    with pytest.raises(Interrupted) as message:
        place_toy(folder, "out", progress=stop_at("confirm"))
    (folder / "message.txt").write_text(str(message.value))
    return folder


@pytest.fixture
def stopped_here(stopped, tmp_path) -> Path:
    """Copy of that folder."""
    return shutil.copytree(stopped, tmp_path, dirs_exist_ok=True)


@pytest.fixture
def plate(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return make(tmp_path)


def start(folder: Path, out: str) -> subprocess.Popen:
    """Start the command as a process of its own."""
    words = [sys.executable, "-m", "htcp_jax", "place", "place.yaml", "--out", out]
    words += [word for change in TOY_BEAM for word in ("--set", change)]
    pipe = subprocess.PIPE
    return subprocess.Popen(words, cwd=folder, env=environment(), stdout=pipe, stderr=pipe, text=True)


def killed_somewhere(folder: Path, out: str, files: int, later_s: float) -> None:
    """Start the command, and kill it some time after it has written that many row files."""
    with start(folder, out) as process:
        while process.poll() is None and len(list((folder / out).rglob("*.parquet"))) < files:
            time.sleep(0.002)
        time.sleep(later_s)
        process.kill()
    assert process.returncode in (-signal.SIGKILL, 0)


def test_some_mountings_are_complete_and_some_are_not_and_the_table_has_them_all(found):
    table = pq.read_table(found.folder / "mountings.parquet").to_pydict()
    assert len(table["complete"]) == 12 == found.scenarios and 0 < sum(table["complete"]) < 12
    assert [words is None for words in table["lost"]] == table["complete"]
    assert [share == 1 for share in table["done"]] == table["complete"]
    assert set(table["workpiece.rotation_y_rad"]) == set(np.concatenate([e.values for e in found.scores])[:, 0])


def test_a_driver_killed_goes_on_to_the_same_bytes_with_another_number_of_threads(found, here):
    killed_somewhere(here, "out", 3, 0.02)
    assert not (here / "out" / "ranked.json").exists()
    place_toy(here, "out", threads=1)
    assert results(here / "out") == results(found.folder)


def test_every_ranked_mounting_planned_alone_is_the_motion_that_the_table_says(found):
    """Plans of the ranked placements: the same motion, margin and clearance as in the table (regression)."""
    assert found.mountings
    reported = json.loads((found.folder / "ranked.json").read_text())["ranked"]
    for rank, one in enumerate(found.mountings):
        (name,) = reported[rank]["jobs"]
        plan = htcp_jax.plan(found.folder / name)
        assert plan.complete and plan.job.margin_m == reported[rank]["margin_m"] == one.margin_m
        assert plan.plans.segment_clearance.min() == one.objective[0]
        ranked = open_run(found.folder / "ranked").plans("beam")
        np.testing.assert_array_equal(plan.plans.x[0], ranked.x[rank])


def test_complete_are_mountings_in_which_a_motion_leads_to_the_end(found):
    """Complete placements: only those with a proven motion to the end (regression: tracked ones counted, too)."""
    for scores in found.scores:
        assert (scores.complete == scores.plans.outcomes.can_be_driven).all()
    no_motion = found.scores[0].plans
    no_motion = no_motion._replace(segment_status=np.full_like(no_motion.segment_status, SegmentStatus.REVERSES))
    tracked = MountingScores(found.search, found.scores[0].run, "beam", found.scores[0].values, plans=no_motion)
    assert no_motion.outcomes.complete.any() and not tracked.complete.any() and not tracked.done.any()
    assert "reverses" in tracked.lost()


def test_the_default_screen_finds_motions_in_a_box_whether_the_start_is_given_or_chosen(tmp_path):
    """Complete placements of the default screen in a box, for a given start and `start_rad: auto` (regression)."""
    job = small_box_job(tmp_path)
    ranges = {"workpiece.shift_m.z": [0.14, 0.18]}
    for start in ([], ["start_rad=auto"]):
        search = load_search({"place": ranges}, job, start)
        scores = MountingPlanner(search, sweep).evaluate_quickly(np.array([[0.15], [0.17]]), None)
        assert scores.complete.any()


def test_a_search_that_is_stopped_before_the_end_leaves_a_ranking_that_says_so(here):
    """Ranking of an interrupted search: written, and marked as unfinished (regression)."""
    with pytest.raises(Interrupted):
        place_toy(here, "out", changes={"best": 1}, progress=stop_at("tolerance"))
    reported = json.loads((here / "out" / "ranked.json").read_text())
    assert reported["ranked"] and reported["finished"] is False and reported["ranked"][0]["success_rate"] is None
    assert read_search(here / "out").is_final is False
    assert htcp_jax.plan(here / "out" / "best-1.yaml").complete


def test_a_search_that_is_stopped_before_its_first_ranking_leaves_one_of_the_quick_plans(stopped_here):
    """Regression: "no plan was finished and no file was written" after minutes of search."""
    here = stopped_here
    reported, message = json.loads((here / "out" / "ranked.json").read_text()), (here / "message.txt").read_text()
    assert re.match(r"stopped; the ranking so far of \d mountings? is in .*ranked.json; ", message)
    assert f"of {len(reported['ranked'])} mounting" in message and reported["finished"] is False
    clearances = [one["objective"]["clearance"] for one in reported["ranked"]]
    assert clearances == sorted(clearances, reverse=True)
    plan = htcp_jax.plan(here / "out" / "best-1.yaml")  # the same motion as that of the ranking
    assert plan.complete and plan.motion_summary.clearance_m == pytest.approx(clearances[0], abs=1e-12)
    before = (here / "out" / "ranked.json").read_bytes()
    with pytest.raises(Interrupted):  # fewer plans are known than before
        place_toy(here, "out", progress=stop_at("search"))
    assert (here / "out" / "ranked.json").read_bytes() == before


def test_better_mountings_are_reported_as_they_are_found(found, heard):
    news = [line for now in heard for line in now.news]
    searched = [line for line in news if "is complete: clearance " in line]
    values = [float(re.search(r"clearance ([\d.]+) mm; ", line)[1]) for line in searched]
    assert values and values == sorted(values) and len(searched) < len(news)
    numbers = [int(re.match(r"mounting (\d+) ", line)[1]) for line in searched]
    assert numbers == sorted(numbers) and numbers[-1] <= sum(len(each.values) for each in found.scores)
    assert f"{1e3 * found.mountings[0].objective[0]:.3g} mm" in news[-1] or len(found.mountings) > 1
    assert news[-1].startswith("confirmed as a proven motion: clearance ") and "rotation y" in news[-1]


def test_the_time_between_two_calls_of_the_planner_counts_and_is_kept(tmp_path):
    now = time.monotonic()
    clock = Clock(tmp_path, 100.0, now - 20.0)
    clock.add("rounds/000", PlanTime(8, 10.0, True), now)
    assert clock.used == pytest.approx(0.3, abs=1e-3)
    clock.add("confirmed/000", PlanTime(1, 5.0, False), now + 7.0)
    assert clock.used == pytest.approx(0.42, abs=2e-2)
    again = Clock(tmp_path, 100.0, now + 50.0)
    for name in ("rounds/000", "confirmed/000"):
        again.add(name, PlanTime(8, 0.1, True), now + 51.0)
    assert again.used == clock.used


def test_a_confirmation_that_the_time_limit_ends_leaves_a_ranking_of_the_quick_plans(here):
    changes = {"within": {"seconds": 1000}, "objective": "joint motion", "best": 1}
    (here / "out").mkdir()
    first = {"rounds/000": PlanTime(FIRST, 950.0, True)._asdict()}  # as if it had taken nearly all of the time
    (here / "out" / "seconds.json").write_text(json.dumps({"calls": first}))
    found = place_toy(here, "out", changes=changes)
    assert found.mountings and not found.is_final and not list((here / "out" / "confirmed").rglob("*.parquet"))
    before = (here / "out" / "ranked.json").read_bytes()
    place_toy(here, "out", changes=changes)
    assert (here / "out" / "ranked.json").read_bytes() == before


def test_as_many_tolerances_are_determined_as_the_file_says(found, heard, here):
    stages: list[PlaceProgress] = []
    none = place_toy(here, "out", changes={"best": 1, "tolerances": 0}, progress=stages.append)
    for made, progress, count in ((found, heard, 1), (none, stages, 0)):
        assert sum(one.tolerance is not None for one in made.mountings) == count < len(made.mountings)
        assert ("tolerance" in {now.stage for now in progress}) == bool(count) == bool(progress[0].most["tolerance"])


def stop_at(stage: str) -> Callable[[PlaceProgress], None]:
    """Function for the progress of a search that presses Ctrl-C at the beginning of a stage."""

    def stop(now: PlaceProgress) -> None:
        if now.stage == stage:
            raise KeyboardInterrupt

    return stop


def test_finished_plans_are_counted_and_not_planned_again(found, here):
    with pytest.raises(Interrupted, match="run the same command to resume") as stopped:
        place_toy(here, "out", progress=stop_at("perturb"))
    shards = {file: (file.stat().st_ino, file.read_bytes()) for file in (here / "out").rglob("[0-9]*/*/*.parquet")}
    shards |= {file: (file.stat().st_ino, file.read_bytes()) for file in (here / "out").rglob("confirmed/*/*.parquet")}
    rows = sum(pq.read_metadata(file).num_rows for file in shards if file.parent.name == "scenarios")
    assert f"; {rows} finished plans are in " in str(stopped.value)
    count = len(json.loads((here / "out" / "ranked.json").read_text())["ranked"])
    assert str(stopped.value).startswith(f"stopped; the ranking so far of {count} mountings is in ")
    heard: list[PlaceProgress] = []
    place_toy(here, "out", progress=heard.append)
    assert {now.kept for now in heard} == {rows}
    assert all((file.stat().st_ino, file.read_bytes()) == before for file, before in shards.items())
    assert results(here / "out") == results(found.folder)


@pytest.mark.parametrize(
    ("file", "was", "now", "says"),
    [
        ("job.yaml", "samples: 8", "samples: 9", "settings.samples was 8, now 9"),
        ("arm.xml", 'size="0.03"', 'size="0.031"', "robot.model was arm.xml, SHA-256"),
        ("path.csv", "4.1", "4.2", "workpiece.path was path.csv, SHA-256"),
    ],
)
def test_a_search_with_another_job_or_another_file_is_not_continued(stopped_here, file, was, now, says):
    here = stopped_here
    before, text = results_so_far(here / "out"), (here / file).read_text()
    assert was in text
    (here / file).write_text(text.replace(was, now, 1))
    with pytest.raises(InputError, match=re.escape(says)):
        place_toy(here, "out")
    assert results_so_far(here / "out") == before


def results_so_far(folder: Path) -> dict[Path, bytes]:
    return {file: file.read_bytes() for file in folder.rglob("*") if file.is_file() and file.name != ".lock"}


def test_a_second_search_in_the_folder_is_refused_while_the_first_runs(here):
    search = load_search(here / "place.yaml", overrides=TOY_BEAM)
    with locked_search(here / "out", search), pytest.raises(InputError, match="out is in use by another command"):
        place_toy(here, "out")


def test_progress_counts_the_plans_of_each_stage_that_was_announced(found, heard):
    """Stages and counts of the progress (regression: "tolerance 64 of 32 scenarios", a search that stayed at 0)."""
    most = heard[0].most
    assert list(dict.fromkeys(now.stage for now in heard)) == list(most)
    assert all(now.scenarios <= now.of == most[now.stage] for now in heard)
    for stage in most:
        counts = [now.scenarios for now in heard if now.stage == stage]
        assert counts == sorted(counts) and counts[-1] > 0


def test_the_objectives_are_those_of_the_programs_and_plans(found):
    for scores in found.scores:
        reported = scores.objective[scores.complete]
        plans = scores.plans.rows(np.flatnonzero(scores.complete))
        np.testing.assert_array_equal(reported[:, 0], plans.clearance.min(axis=1))
        steps = np.diff(np.concatenate([plans.start[:, None], plans.x], axis=1), axis=1)
        np.testing.assert_allclose(-reported[:, 1], np.linalg.norm(steps, axis=2).sum(axis=1), rtol=1e-9)


def test_cycle_time_is_that_of_the_program_and_unknown_where_there_is_no_motion(found):
    search = found.search._replace(file=found.search.file.model_copy(update={"objective": ("cycle time",)}))
    ranked = time_run(open_run(found.folder / "ranked"), "20mm/s")
    times = MountingScores(search, ranked, "beam", np.array([one.values for one in found.mountings])).objective[:, 0]
    reported = [program_of(open_plans(ranked.folder), 0.02, "beam", k).program.duration_s for k in range(len(times))]
    assert times.tolist() == [-seconds for seconds in reported]
    (scores,) = found.scores
    screened = MountingScores(search, time_run(scores.run, "20mm/s"), scores.method, scores.values)
    assert np.isneginf(screened.objective[~screened.complete]).all()


def test_the_ranking_is_by_what_is_left_under_perturbation_and_the_best_of_either_objective_are_on_the_pareto_front(
    found,
):
    objective = np.array([one.objective for one in found.mountings])
    order = [(-one.success_rate, -one.worst[0], -one.objective[0]) for one in found.mountings]
    assert order == sorted(order)
    for objective_name in range(2):
        assert found.mountings[int(objective[:, objective_name].argmax())].pareto_front
    assert all((one.worst <= one.objective).all() for one in found.mountings)


def disturbances_hold(found: PlacementResult, folder: Path, count: int, seed: int) -> None:
    """Check that `count` random placements within the stated tolerance of the first are complete when planned anew."""
    first, axes, off = found.mountings[0], found.search.ranges.axes, found.search.file.perturbation
    half = np.array([axis.perturbed(1e-3 * off.mm, off.deg) for axis in axes]) * first.tolerance.together
    assert (half > 0).all()
    shifts = np.random.default_rng(seed).uniform(-1, 1, (count, len(axes))) * half
    run = sweep(sweep_of(found.search, first.values + shifts), [found.search.file.confirm], folder)
    assert run.plans(found.search.file.confirm).outcomes.can_be_driven.all()


def test_a_few_disturbances_within_the_stated_tolerance_are_complete(found, tmp_path):
    disturbances_hold(found, tmp_path / "perturbation", 20, 5)


@pytest.mark.slow
def test_1000_disturbances_within_the_stated_tolerance_are_complete(found, tmp_path):
    disturbances_hold(found, tmp_path / "perturbation", 1000, 6)


def test_mujoco_refutes_none_of_the_ranked_motions(found, capsys):
    assert main(["validate", str(found.folder / "ranked")]) == 0


def test_the_numbers_in_the_files_are_json_and_ranked_in_their_order(found):
    reported = json.loads((found.folder / "ranked.json").read_text(), parse_constant=pytest.fail)
    assert [row["parameters"]["workpiece.rotation_y_rad"] for row in reported["ranked"]] == [
        one.values[0] for one in found.mountings
    ]
    assert reported["complete"] == found.complete


# Slow


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes_on_ray_and_another_seed_others(found, here):
    pytest.importorskip("ray", reason="Ray is an extra")
    place_toy(here, "ray", on="ray")
    assert results(here / "ray") == results(found.folder)
    place_toy(here, "other", changes={"seed": 1})
    other = results(here / "other")
    assert all(other[name] != results(found.folder)[name] for name in RESULTS[:2])


@pytest.mark.slow
def test_20_kills_lose_nothing(found, here):
    draw, undisturbed = random.Random(0), results(found.folder)
    for kill in range(KILLS):
        killed_somewhere(here, f"out{kill}", draw.randrange(len(undisturbed)), draw.uniform(0, 0.3))
        place_toy(here, f"out{kill}")
        assert results(here / f"out{kill}") == undisturbed


@pytest.mark.slow
def test_one_search_killed_again_and_again_comes_to_the_same(found, here):
    draw = random.Random(1)
    for _ in range(6):
        done = len(list((here / "out").rglob("*.parquet")))
        killed_somewhere(here, "out", done + draw.randrange(3), draw.uniform(0, 0.3))
    place_toy(here, "out")
    assert results(here / "out") == results(found.folder)


@pytest.mark.slow
def test_ctrl_c_ends_it_with_130_and_one_line_how_to_go_on(found, here):
    with start(here, "out") as process:
        while process.poll() is None and len(list((here / "out").rglob("*.parquet"))) < 4:
            time.sleep(0.002)
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate()
    assert process.returncode == 130 and output.startswith("up to ") and output.count("\n") == 1  # as at the start
    last = errors.strip().splitlines()[-1]
    so_far = r"(the ranking so far of \d+ mountings? is in out/ranked.json; )?"
    assert re.fullmatch(rf"htcp: stopped; {so_far}\d+ finished plans are in out; run the same command to resume", last)
    place_toy(here, "out")
    assert results(here / "out") == results(found.folder)


@pytest.mark.slow
def test_a_search_by_time_that_was_stopped_repeats_its_rounds_and_goes_on(plate):
    def stop(now) -> None:
        if now.scenarios > 600:
            raise KeyboardInterrupt

    changes = {"within": {"seconds": 20}, "best": 1, "objective": "clearance"}
    with pytest.raises(Interrupted, match="finished plans are in out"):
        place("place.yaml", "out", changes=changes, progress=stop)
    rounds = sorted((plate / "out" / "rounds").glob("[0-9]*"))
    found = place("place.yaml", "out", changes=changes)
    assert len(found.scores) > len(rounds) > 1
    again = place("place.yaml", "out", changes=changes)
    assert again.record() == found.record() and len(again.scores) == len(found.scores)


@pytest.mark.slow
@pytest.mark.parametrize("within", [1, 2, 5])
def test_a_budget_of_a_few_scenarios_is_kept_to(plate, within):
    found = place("place.yaml", "out", changes={"within": {"scenarios": within}, "objective": "joint motion"})
    assert found.scenarios == within and len(found.mountings) <= within


@pytest.mark.slow
@pytest.mark.parametrize(
    "ranges",
    [
        {"workpiece.rotation_y_rad": [0.3, 0.5]},
        {"robot.base_m": [[-0.05, 0.05], [-0.05, 0.05], 0.0]},
        {"start_rad.3": [0.4, 0.6]},
    ],
)
def test_what_may_vary_is_searched(plate, ranges):
    changes = {"place": ranges, "best": 1, "within": {"scenarios": 6}, "objective": "clearance"}
    found = place("place.yaml", "out", changes=changes)
    assert found.mountings and len(found.mountings[0].values) == len(found.search.ranges.axes)


@pytest.mark.slow
def test_several_seams_are_done_only_where_all_of_them_are(plate):
    (plate / "behind.csv").write_text("0.6,-0.1737,0.1708\n0.61,-0.1738,0.1705\n")
    seams = "seams=[{name: path, path: path.csv}, {name: behind, path: behind.csv}]"
    near = {"workpiece.shift_m.x": [-0.1, 0.1]}
    changes = {"place": near, "confirm": "keep-clear", "objective": "clearance"}
    changes["screen"] = "keep-clear"
    found = place("place.yaml", "out", overrides=[seams], changes=changes)
    assert found.scenarios == 12 and found.complete == 0 and not found.mountings
    seams = found.seams()
    assert seams["path"][0] > 0 and seams["behind"][0] == 0 and seams["path"][1] == 1 and seams["behind"][1] < 1
