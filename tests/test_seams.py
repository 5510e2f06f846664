"""Jobs with several seams: their entries, their order, and one proven motion through all of them."""

import csv
import io
import json
import shutil
import warnings
from contextlib import redirect_stdout
from functools import partial

import numpy as np
import pytest
import toy
import yaml
from test_json_schemas import fits

from benchmarks import order
from htcp_jax import api, sequencing
from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.jobs import build, load_config, seam_scenarios
from htcp_jax.jobs.seam_paths import points_of_seams, with_seams_of_files
from htcp_jax.model.path_frames import tangents
from htcp_jax.motion import Problem, motion
from htcp_jax.planning import methods
from htcp_jax.runs import open_plans
from htcp_jax.runs.seam_order import SeamOrder
from htcp_jax.sequencing.seam_plans import _Configurations
from htcp_jax.status import Kind, SegmentStatus
from htcp_jax.viewer import draw_plan

LEFT, RIGHT = (
    {"name": "left", "path": "path.csv", "rows": [0, 5]},
    {"name": "right", "path": "path.csv", "rows": [5, 5]},
)
FAR = {"name": "far", "path": "far.csv"}


def write_job(folder, *seams, **changes):
    """Write the toy arm's job with seams in place of its path, and return its file."""
    file = toy.write_job(folder)
    np.savetxt(folder / "far.csv", [[9.0, 0.0, 0.3], [9.1, 0.0, 0.3]], delimiter=",")
    (folder / "empty.csv").write_text("")
    points = [",".join(map(str, point)) for point in toy.workpiece().path]
    (folder / "two.csv").write_text("\n".join([*points[:5], "", *points[5:], ""]))
    for name, labels in {"returns": "aabba", "empty_cell": ["a", "a", "", "b", "b"]}.items():
        rows = [f"{point},{label}" for point, label in zip(points, labels, strict=False)]
        (folder / f"{name}.csv").write_text("\n".join(["x,y,z,seam", *rows, ""]))
    job = yaml.safe_load(file.read_text())
    del job["workpiece"]["path"]
    file.write_text(json.dumps(job | {"seams": list(seams)} | changes))
    return file


def refusal(folder, *seams, **changes) -> str:
    with pytest.raises(InputError) as error:
        with_seams_of_files(load_config(write_job(folder, *seams, **changes)).workpiece)
    return str(error.value).removeprefix(f"{folder / 'job.yaml'}: ")


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """Folder of a plan by `htcp plan` of two seams, and one out of reach, with the motion back home."""
    folder = tmp_path_factory.mktemp("seams")
    file = write_job(folder, LEFT, RIGHT, FAR)
    with redirect_stdout(io.StringIO()) as printed:
        assert main(["plan", str(file), "--out", str(folder / "out"), "--retract"]) == 3
    assert printed.getvalue().splitlines()[0] in ("beam: toy, left, right", "beam: toy, right, left")
    return folder / "out"


@pytest.fixture(scope="module")
def with_own_keys(tmp_path_factory):
    """Folder of a plan of two seams with margins and feeds of their own, larger than the job's margin."""
    folder = tmp_path_factory.mktemp("own")
    file = write_job(folder, LEFT | {"margin_m": 0.004, "feed": "30mm/s"}, RIGHT | {"margin_m": 0.002})
    assert main(["plan", str(file), "--out", str(folder / "out"), "--retract"]) == 0
    return folder / "out"


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    """Folder of a plan of two seams, the second of which must come first, and backwards."""
    folder = tmp_path_factory.mktemp("ordered")
    file = write_job(folder, LEFT | {"after": ["right"]}, RIGHT | {"direction": "backward"})
    assert main(["plan", str(file), "--out", str(folder / "out"), "--retract"]) == 0
    return folder / "out"


def plan_quickly(file, out) -> None:
    """Plan by the command, with short searches for the order: four seams have 24."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("htcp_jax.sequencing.sequence.BOUND_EFFORT", 0.1)
        patch.setattr(sequencing, "find_sequence", partial(sequencing.find_sequence, effort=0.1))
        assert main(["plan", str(file), "--out", str(out)]) == 0


def rows_of(folder, name="motion.csv") -> list[dict]:
    with open(folder / name) as file:
        return list(csv.DictReader(file))


def summary(folder) -> dict:
    return json.loads((folder / "summary.json").read_text())


def test_a_seam_out_of_reach_is_missing_with_its_reason_and_the_others_are_done(planned):
    order = summary(planned)["order"]
    assert {visit["name"] for visit in order["visits"]} == {"left", "right"}
    assert list(order["missing"]) == ["far"] and order["missing"]["far"].startswith("a target is farther away")
    failure = api.open_plan(planned).failure()
    assert list(failure) == ["seam far", "next"] and failure["next"].startswith("htcp reachability ")


def test_the_way_back_home_is_one_of_its_own_although_a_seam_is_missing(planned):
    """The arm does not go back over the seams that it has done."""
    plan = api.open_plan(planned)
    there, both = plan.motion(), plan.motion(retract=True)
    np.testing.assert_array_equal(both.x[len(there.x) :], plan.plans.retract.x)
    stopped = plan.plans._replace(segment_status=plan.plans.segment_status.copy())
    stopped.segment_status[0, 2] = SegmentStatus.IN_COLLISION  # the motion ends within a seam
    assert stopped.way_back(0) is None


def test_a_job_none_of_whose_seams_is_done_is_a_result_with_their_reasons(tmp_path, capsys):
    narrow = LEFT | {"margin_m": 0.3}, RIGHT | {"margin_m": 0.3}
    assert main(["plan", str(write_job(tmp_path, *narrow)), "--out", str(tmp_path / "out")]) == 3
    printed = capsys.readouterr().out
    assert printed.startswith("beam: toy, no seam\n") and "seam left: " in printed and "seam right: " in printed
    assert f"next: htcp reachability {tmp_path / 'job.yaml'} --each " in printed.replace("\n", "")


def test_a_home_in_collision_is_refused_with_its_body_and_a_clear_one(tmp_path):
    touches = [0.0, 1.5, -0.3, 0.9]
    file = write_job(tmp_path, LEFT, RIGHT, home_rad=touches, start_rad="auto")
    with pytest.raises(InputError, match=r"home is in collision: .* mm inside the workpiece; next: --set 'home_rad="):
        api.plan(file)


def test_the_validation_names_a_missing_seam_and_refutes_nothing(planned, capsys):
    assert main(["validate", str(planned)]) == 0
    assert "The plan lacks the seam 'far', which is not validated: a target is farther" in capsys.readouterr().out


def test_a_program_of_a_plan_without_a_seam_is_refused_with_its_name(planned, tmp_path, capsys):
    assert main(["program", str(planned), "--feed", "60mm/s", "--out", str(tmp_path / "p.csv")]) == 2
    assert "the plan lacks seam 'far'; remove it from the job" in capsys.readouterr().err


def test_the_order_keeps_precedence_and_direction(complete):
    visits = summary(complete)["order"]["visits"]
    assert [visit["name"] for visit in visits] == ["right", "left"]
    assert visits[0]["direction"] == "backward"
    path = np.array([[float(row[f"target_{axis}_m"]) for axis in "xyz"] for row in rows_of(complete, "trajectory.csv")])
    right = toy.workpiece().path[5:10]
    np.testing.assert_allclose(np.diff(path[1:6], axis=0), np.diff(right[::-1], axis=0), atol=1e-9)


def test_the_summary_fits_its_schema(planned, complete):
    fits("plan", summary(planned))
    fits("plan", summary(complete))


def test_the_motion_begins_and_ends_at_home_and_names_seam_and_kind(complete):
    rows = rows_of(complete)
    x = np.array([[float(row[f"j{k}_rad"]) for k in range(1, 5)] for row in rows])
    np.testing.assert_allclose(x[[0, -1]], [toy.START, toy.START])
    assert rows[-1]["kind"] == Kind.RETRACT.name
    seams = [row["seam"] for row in rows if row["kind"] == Kind.PROCESS.name]
    assert seams == ["right"] * 4 + ["left"] * 4
    between = [row["kind"] for row in rows if row["seam"] == "left"]
    assert between[: -4 - between.count(Kind.RETRACT.name)] == [Kind.TRANSFER.name] * between.count(Kind.TRANSFER.name)


def test_the_stated_time_is_that_of_the_motion_at_full_speed_and_not_below_the_bound(complete):
    order = summary(complete)["order"]
    x = np.array([[float(row[f"j{k}_rad"]) for k in range(1, 5)] for row in rows_of(complete)])
    full_speed = 1.0  # the toy's model limits no joint
    assert np.abs(np.diff(x, axis=0) / full_speed).max(axis=1).sum() == pytest.approx(order["time_s"], rel=1e-6)
    assert 0 < order["bound_s"] <= order["time_s"]


def test_the_independent_validation_refutes_no_target_and_no_segment(complete):
    assert main(["validate", str(complete)]) == 0
    assert json.loads((complete / "validation.json").read_text())["refuted"] == []


def test_a_saved_plan_of_two_seams_becomes_one_program_that_is_read_back_and_proven(complete, tmp_path, capsys):
    limits = ["--set", "program.velocity=[1, 1, 1, 1]"]
    command = ["program", str(complete), "--feed", "60mm/s", "--format", "csv", "--out", str(tmp_path / "p.csv")]
    assert main([*command, *limits]) == 0
    assert "proven" in capsys.readouterr().out


def program_of(folder, out, *options) -> list[dict]:
    """Rows of the CSV program of a saved plan."""
    limits = ["--set", "program.velocity=[1, 1, 1, 1]"]
    assert main(["program", str(folder), "--format", "csv", "--out", str(out), *options, *limits]) == 0
    return list(csv.DictReader(line for line in out.read_text().splitlines() if not line.startswith("#")))


@pytest.fixture(scope="module")
def points(tmp_path_factory):
    """Folder of a job with three points and a seam, and of its plan."""
    folder = tmp_path_factory.mktemp("points")
    seams = LEFT | {"rows": [2, 3], "points": True}, RIGHT
    plan_quickly(write_job(folder, *seams), folder / "out")
    return folder


def test_the_program_stops_at_each_point(points, tmp_path):
    program = program_of(points / "out", tmp_path / "p.csv", "--feed", "60mm/s")
    joints = [f"j{k}_rad" for k in range(1, 5)]
    program = np.array([[float(row[name]) for name in joints] for row in program])
    visited = [row for row in rows_of(points / "out", "trajectory.csv") if row["seam"].startswith("left")]
    assert len({row["seam"] for row in visited}) == 3
    for point in visited:
        apart = np.abs(program - [float(point[name]) for name in joints]).max(axis=1)
        assert apart.min() < 1e-8
        assert np.abs(np.diff(program, axis=0)).max(axis=1)[max(0, apart.argmin() - 1)] < 1e-5


def test_a_seam_with_its_own_feed_takes_the_time_that_this_feed_needs(with_own_keys, tmp_path, capsys):
    rows = program_of(with_own_keys, tmp_path / "own.csv", "--set", "program.feed=60mm/s")
    assert "60 mm/s on right" in capsys.readouterr().out
    path = toy.workpiece().path
    for name, feed, points in (("left", 0.03, path[:5]), ("right", 0.06, path[5:])):
        times = [float(row["time_s"]) for row in rows if row["seam"] == name and row["kind"] == Kind.PROCESS.name]
        seconds = np.linalg.norm(np.diff(points, axis=0), axis=1).sum() / feed
        assert seconds < times[-1] - times[0] < seconds + 0.5


def test_the_feed_of_the_command_line_replaces_those_of_seams_with_a_note(with_own_keys, tmp_path, capsys):
    program_of(with_own_keys, tmp_path / "all.csv", "--feed", "60mm/s")
    printed = capsys.readouterr()
    assert "--feed 60mm/s replaces the feeds of seams: left (30mm/s)" in printed.err and "feed" in printed.out
    assert "mm/s on" not in printed.out


def test_a_program_without_a_feed_for_a_seam_is_refused_with_its_name(with_own_keys, tmp_path, capsys):
    assert main(["program", str(with_own_keys), "--out", str(tmp_path / "p.csv")]) == 2
    assert "the feed rate of the seam 'right' is missing: set program.feed" in capsys.readouterr().err


def test_a_program_with_a_column_seam_is_read_and_proven(with_own_keys, tmp_path, capsys):
    program_of(with_own_keys, tmp_path / "own.csv", "--feed", "60mm/s")
    command = ["prove", str(tmp_path / "own.csv"), "--job", str(with_own_keys.parent / "job.yaml")]
    assert main([*command, "--out", str(tmp_path / "proof")]) == 0
    assert "proven: guaranteed clearance" in capsys.readouterr().out


def test_a_proof_of_the_motion_has_the_clearance_that_the_plan_states_for_it_and_the_way_back(with_own_keys, tmp_path):
    command = ["prove", str(with_own_keys / "motion.csv"), "--job", str(with_own_keys.parent / "job.yaml")]
    assert main([*command, "--out", str(tmp_path / "proof")]) == 0
    stated = summary(with_own_keys)
    least = min(stated["motion"]["clearance_m"], stated["order"]["retract_clearance_m"])
    assert json.loads((tmp_path / "proof" / "proof.json").read_text())["clearance_m"] == pytest.approx(least, rel=0.01)


def proof_of(folder, out, *options) -> tuple[int, dict]:
    """Exit code and record of the proof of a plan's motion in its job."""
    motion, job = str(folder / "motion.csv"), str(folder.parent / "job.yaml")
    code = main(["prove", motion, "--job", job, "--out", str(out), *options])
    return code, json.loads((out / "proof.json").read_text())


def test_a_proof_requires_on_each_seam_its_own_margin_and_states_its_clearance(with_own_keys, tmp_path, capsys):
    code, record = proof_of(with_own_keys, tmp_path / "own")
    assert code == 0 and record["margin_m"] == 0
    fits("proof", record)
    assert "clearance above 0 mm; on each seam its margin" in (text := " ".join(capsys.readouterr().out.split()))
    known = {each["seam"]: each for each in record["seams"]}
    assert {name: each["margin_m"] for name, each in known.items()} == {"left": 0.004, "right": 0.002}
    for visit in summary(with_own_keys)["order"]["visits"]:
        own = known[visit["name"]]
        assert own["clearance_m"] >= own["margin_m"] and own["segments"] == 4 and own["verdict"] == "proven"
        assert f"{visit['name']} at least {1e3 * own['clearance_m']:.3g} mm" in text
    larger = f"{1e3 * known['left']['clearance_m'] + 1:g}mm"
    code, record = proof_of(with_own_keys, tmp_path / "own", "--set", f"seams.1.margin_m={0.001 * float(larger[:-2])}")
    assert code == 1 and {each["seam"]: each["verdict"] for each in record["seams"]} == {
        "left": "refuted", "right": "proven"
    }  # fmt: skip


def test_a_margin_of_the_command_line_holds_for_all_seams_and_between_them(with_own_keys, tmp_path):
    code, record = proof_of(with_own_keys, tmp_path / "none", "--margin", "0mm")
    assert code == 0 and {each["margin_m"] for each in record["seams"]} == {0}
    code, record = proof_of(with_own_keys, tmp_path / "large", "--margin", "20mm")
    assert code == 1 and {each["margin_m"] for each in record["seams"]} == {0.02}
    assert record["segments_by_verdict"]["below the margin"] > 0


def test_a_proof_of_a_file_counts_the_points_that_it_visits(points, tmp_path, capsys):
    command = ["prove", str(points / "out" / "motion.csv"), "--out", str(tmp_path / "proof")]
    assert main([*command, "--job", str(points / "job.yaml")]) == 0
    assert "points visited      3 of 3, within 1 mm" in capsys.readouterr().out
    text = (points / "job.yaml").read_text().replace('"rows": [2, 3]', '"rows": [1, 4]')
    (points / "more.yaml").write_text(text)
    assert main([*command, "--job", str(points / "more.yaml")]) == 0
    assert "points visited      3 of 4, within 1 mm; not left 1" in capsys.readouterr().out
    fits("proof", json.loads((tmp_path / "proof" / "proof.json").read_text()))


def test_a_proof_of_points_only_counts_them_without_a_length(points, tmp_path, capsys):
    text = (points / "job.yaml").read_text().replace('"rows": [5, 5]', '"rows": [5, 5], "points": true')
    (points / "only.yaml").write_text(text)
    command = ["prove", str(points / "out" / "motion.csv"), "--out", str(tmp_path / "proof")]
    assert main([*command, "--job", str(points / "only.yaml")]) == 0
    printed = capsys.readouterr().out
    assert "points visited      8 of 8" in printed and "path covered" not in printed


def test_a_saved_plan_whose_seams_do_not_ascend_is_refused(complete, tmp_path, capsys):
    (tmp_path / "summary.json").write_text((complete / "summary.json").read_text())
    arrays = dict(np.load(complete / "trajectory.npz"))
    np.savez(tmp_path / "trajectory.npz", **arrays | {"seam_begins": np.array([99])})
    assert (
        main(["program", str(tmp_path), "--feed", "60mm/s", "--format", "csv", "--out", str(tmp_path / "p.csv")]) == 2
    )
    assert "seam_begins" in capsys.readouterr().err


def test_a_file_with_a_column_seam_is_the_same_job_as_a_list_of_its_seams(tmp_path):
    file = toy.write_job(tmp_path)
    text = [*(f"{x},{y},{z},{name}" for (x, y, z), name in zip(toy.workpiece().path, "aaaaabbbbb", strict=True)), ""]
    (tmp_path / "path.csv").write_text("\n".join(["x,y,z,seam", *text]))
    part = with_seams_of_files(load_config(file).workpiece)
    assert [(seam.name, seam.rows) for seam in part.seams] == [("a", (0, 5)), ("b", (5, 5))]
    again = load_config({"workpiece": part.model_dump() | {"cloud": "none"}}).workpiece
    assert again.seams == part.seams and again.path == ""


def test_a_note_about_the_file_of_a_path_is_given_once(tmp_path):
    file = toy.write_job(tmp_path)
    (tmp_path / "path.csv").write_text("0.4,0,0.3\n0.42,0,0.3")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        build.resolved_scene(load_config(file))
    assert sum("has no line end" in str(one.message) for one in said) == 1


def test_each_row_of_a_seam_with_points_is_a_seam_and_precedence_holds_for_all_of_them(tmp_path):
    job = load_config(write_job(tmp_path, LEFT | {"points": True}, RIGHT | {"after": ["left"]}))
    part = with_seams_of_files(job.workpiece)
    assert [seam.name for seam in part.seams] == [*(f"left {k}" for k in range(1, 6)), "right"]
    assert part.seams[-1].after == tuple(seam.name for seam in part.seams[:5])
    assert points_of_seams(part).begins == (1, 2, 3, 4, 5)


def test_a_closed_seam_begins_and_ends_at_the_same_row(tmp_path):
    job = load_config(write_job(tmp_path, LEFT | {"closed": True, "begins_at": 2}))
    xyz = points_of_seams(with_seams_of_files(job.workpiece)).points.xyz
    np.testing.assert_allclose(xyz, toy.workpiece().path[[2, 3, 4, 0, 1, 2]])


def plans_of(folder, *seams, **changes):
    """Return the variants and the proven motions of a job's seams, and the progress while they were planned."""
    job, robot = build.with_robot(load_config(write_job(folder, *seams, **changes)), "job")
    found, seen = seam_scenarios.seam_scenarios(job, robot), []
    (task,), obstacles = found.tasks, build.obstacles_of(job.cell, robot)
    problem = Problem.of(robot, found.workpiece, found.scenarios, job.settings, task, obstacles)
    home, speed = np.asarray(problem.scenarios.x_home[0]), np.ones(len(robot.joint_names))
    made = sequencing.plan_seams([problem], found.variants, home, speed, methods.find(job.method), seen.append)
    moves = sequencing.moves_between(problem, made.found, home, speed)
    return found, made.found, moves, seen


def test_without_sampled_variants_no_configuration_is_near(tmp_path):
    """As where no draw is clear at the first point of any seam that was planned from home."""
    job, robot = build.with_robot(load_config(write_job(tmp_path, LEFT)), "job")
    found = seam_scenarios.seam_scenarios(job, robot)
    (task,), obstacles = found.tasks, build.obstacles_of(job.cell, robot)
    problem = Problem.of(robot, found.workpiece, found.scenarios, job.settings, task, obstacles)
    near = _Configurations.near([problem], found.variants, np.zeros(0, int), problem.scenarios.x_home)
    assert near.variant.shape == (0,) and near.x.shape == (0, len(robot.joint_names))


def test_one_direction_of_a_seam_is_planned_from_home_and_its_motions_serve_both(tmp_path):
    found, plans, _, seen = plans_of(tmp_path, LEFT, RIGHT)
    assert seen[0].scenarios == 2
    ends = {(plan.variant, plan.start.tobytes(), plan.end.tobytes()) for plan in plans}
    reverse = found.variants.reverse
    assert {variant for variant, *_ in ends} == {0, 1, 2, 3}
    assert {(int(reverse[variant]), end, start) for variant, start, end in ends} == ends


def test_a_motion_backwards_passes_the_via_points_of_inserted_goals_backwards(tmp_path):
    ends = [{**LEFT, "path": "long.csv", "rows": [0, 2]}, RIGHT]
    np.savetxt(tmp_path / "long.csv", toy.workpiece().path[[0, 4]], delimiter=",")
    _, plans, _, _ = plans_of(tmp_path, *ends)
    forward, backward = ([plan for plan in plans if plan.variant == v] for v in (0, 1))
    whole = {motion.motions(plan.plans, 0).x[1:].tobytes() for plan in forward}
    assert any(len(plan.plans.via_points.x) for plan in forward)
    assert {motion.motions(plan.plans, 0).x[:0:-1].tobytes() for plan in backward} & whole


def test_a_point_has_one_direction(tmp_path):
    found, plans, _, _ = plans_of(tmp_path, LEFT | {"points": True})
    assert set(found.variants.seam[[plan.variant for plan in plans]]) == set(range(5))
    assert not any(plan.variant % 2 for plan in plans)


def test_the_progress_counts_the_air_moves_of_an_order_and_another_search_proves_none_again(tmp_path):
    found, plans, moves, _ = plans_of(tmp_path, LEFT, RIGHT)
    seams, seen = found.variants.seam[[plan.variant for plan in plans]], []
    order = sequencing.find_sequence(seams, plans, found.before, moves, 0, seen.append)
    assert seen[-1].targets_tracked == seen[-1].targets > 0 and seen[-1].unit == "air moves"
    seen.clear()
    again = sequencing.find_sequence(seams, plans, found.before, moves, 0, seen.append, effort=1.0)
    assert not seen
    assert again.cost_s == pytest.approx(order.cost_s)
    legs = [leg.time_s for leg in (*again.moves, again.retract)]
    steps = [np.abs(np.diff(motion.motions(plan.plans, 0).x, axis=0)).max(axis=1) for plan in again.visits]
    assert again.cost_s == pytest.approx(sum(legs) + sum(each.sum() for each in steps))


def test_the_benchmark_compares_a_saved_plan_with_nearest_neighbours_and_plans_nothing(complete, monkeypatch):
    monkeypatch.setattr(api, "plan", None)
    lines = list(order.compare_plan(str(complete.parent / "job.yaml"), complete))
    assert lines[0].startswith("plan: 2 of 2 seams") and "nearest neighbours" in lines[-1]
    x = np.array([[float(row[f"j{k}_rad"]) for k in range(1, 5)] for row in rows_of(complete)])
    kinds = [row["kind"] for row in rows_of(complete)]
    steps = np.linalg.norm(np.diff(x, axis=0), axis=1)
    air = steps[[kind not in (Kind.PROCESS.name, Kind.DWELL.name) for kind in kinds[1:]]].sum()
    assert f"{air:.2f} rad" in lines[1]


def test_the_stated_gap_compares_an_order_with_its_lower_bound():
    assert "at most 25.0 % above the shortest order" in SeamOrder((), {}, 5.0, 4.0, 0.001).facts()["order"]
    assert "no lower bound" in SeamOrder((), {}, 5.0, 0.0, 0.001).facts()["order"]


def test_tangents_do_not_cross_from_seam_to_seam():
    duct = load_config({"seams": [{"name": "a", "path": "crown"}, {"name": "b", "path": "weld"}]})
    part = build.workpiece_of(duct.workpiece, build.robot_of(duct.robot))
    first, second = np.split(part.path, part.seam_begins)
    np.testing.assert_array_equal(part.tangents, np.concatenate([tangents(first), tangents(second)]))


@pytest.mark.parametrize("seams, words", [
    ([LEFT, dict(LEFT, rows=[5, 5])], "seams: the name 'left' occurs 2 times; names must differ"),
    ([LEFT | {"after": ["top"]}], "seams: 'left' is after 'top', which is no seam; seams: left"),
    ([LEFT | {"after": ["right"]}, RIGHT | {"after": ["left"]}], "seams: the keys after form a circle: "),
    ([LEFT | {"rows": [8, 5]}], "seam 'left': rows [8, 5]: path.csv has 10 rows"),
    ([LEFT | {"path": "two.csv", "rows": [3, 4]}], "rows [3, 4] are in 2 seams of two.csv: 0 to 4, 5 to 9; choose"),
    ([LEFT | {"path": "returns.csv", "rows": None}], "the name 'left a' occurs 2 times; names must differ"),
    ([LEFT | {"path": "empty_cell.csv", "rows": None}], "row 3 has no value in the column seam; each row"),
    ([LEFT | {"points": True, "direction": "forward"}], "seam 'left' has points: true; its key direction would"),
    ([LEFT | {"begins_at": 2}], "seam 'left': begins_at is for a seam with closed: true"),
    ([LEFT, RIGHT | {"direction": "up"}], "workpiece.seams.2.direction"),
    ([LEFT | {"feed": "20"}], "workpiece.seams.1.feed: feed '20' is not a speed above 0 with a unit"),
    ([LEFT | {"margin_m": -1}], "workpiece.seams.1.margin_m is -1: at least 0 is needed, in metres"),
    ([LEFT | {"task": [{"axis": "tcp.q", "towards": [0, 0, 1]}]}], "workpiece.seams.1.task.1: axis is 'tcp.q'"),
    ([LEFT | {"pth": "x"}], "unknown key workpiece.seams.1.pth"),
    ([LEFT | {"path": "missing.csv", "rows": None}], "missing.csv: no such file"),
    ([LEFT | {"path": "empty.csv", "rows": None}], "seam 'left': "),
])  # fmt: skip
def test_an_invalid_list_of_seams_is_refused_in_one_line(tmp_path, seams, words):
    message = refusal(tmp_path, *seams)
    assert words in message and "\n" not in message


POINT, AXIS = {"point": "tcp", "on": "path"}, {"axis": "tcp.z", "towards": [0, 0, 1], "cone_deg": 90}


def test_on_a_seam_with_its_own_task_the_goals_and_the_margin_are_its_own(tmp_path):
    own = {"task": [POINT, AXIS | {"towards": [1, 0, 0], "cone_deg": 30}], "margin_m": 0.002}
    job = load_config(write_job(tmp_path, LEFT, RIGHT | own, task=[POINT, AXIS], start_rad="auto"))
    *_, scenario = build.resolved_scene(job)
    np.testing.assert_allclose(scenario.goals[:, 3:], [[0, 0, 1, np.pi / 2]] * 6 + [[1, 0, 0, np.pi / 6]] * 5)
    np.testing.assert_allclose(scenario.seam_margins_m[:, 0], [5e-4] * 6 + [2e-3] * 5)
    np.testing.assert_allclose(scenario.goals[1:, :3], toy.workpiece().path)


def test_each_seam_keeps_its_own_margin_and_the_validation_requires_it(with_own_keys, tmp_path):
    rows = rows_of(with_own_keys, "trajectory.csv")
    order, least = summary(with_own_keys)["order"], {"left": 0.004, "right": 0.002}
    for name, margin_m in least.items():
        assert all(float(row["clearance_m"]) >= margin_m for row in rows if row["seam"] == name)
    assert {visit["name"]: visit["margin_m"] for visit in order["visits"]} == least
    assert main(["validate", str(with_own_keys)]) == 0
    shutil.copytree(with_own_keys, tmp_path / "near")
    record = json.loads((tmp_path / "near" / "summary.json").read_text())
    for seam in record["config"]["workpiece"]["seams"]:
        seam["margin_m"] = 0.05 if seam["name"] == "left" else seam["margin_m"]
    (tmp_path / "near" / "summary.json").write_text(json.dumps(record))
    assert main(["validate", str(tmp_path / "near")]) == 1
    refuted = json.loads((tmp_path / "near" / "validation.json").read_text())["refuted"]
    targets = {visit["name"]: range(visit["first"], visit["last"] + 1) for visit in order["visits"]}
    assert refuted and all(one["target"] in targets["left"] for one in refuted)
    assert "less than margin_m" in refuted[0]["reason"]


def test_the_picture_names_the_seams_and_draws_no_line_from_one_to_the_next(with_own_keys):
    plans, names = open_plans(with_own_keys).plans("beam"), ["seam one", "seam two"]
    figure = draw_plan(toy.robot(), toy.workpiece(), toy.scenario(), plans, seams=names)
    _, close_up, chart = figure.axes
    for axes in (close_up, chart):
        assert set(names) <= {text.get_text() for text in axes.texts}
    assert sorted(len(line.get_xdata()) for line in close_up.lines if line.get_linewidth() == 0.6) == [5, 6]
    curve = next(line for line in chart.lines if len(line.get_xdata()) == 12)
    assert np.isnan(curve.get_xdata()).sum() == 1


def test_a_given_inlet_without_a_rule_for_the_inside_gives_a_warning(tmp_path):
    across, along = np.linspace(-0.1, 0.1, 9), np.linspace(0.4, 0.9, 9)
    box = [(x, y, 0.3 + z) for x in along for y in across for z in across if max(abs(y), abs(z)) > 0.09]
    file = write_job(tmp_path, LEFT, RIGHT)
    np.savetxt(tmp_path / "box.xyz", box)
    part = {"workpiece.cloud": str(tmp_path / "box.xyz"), "workpiece.interior": "hull"}
    job, robot = build.with_robot(load_config(file, part | {"workpiece.inlet_m": [0.9, 0, 0.3]}), "the job")
    with pytest.warns(UserWarning, match=r"inlet_m is given, but the rule for the inside of the part is off"):
        seam_scenarios.seam_scenarios(job, robot)


def test_the_own_keys_of_the_only_seam_are_those_of_the_job(tmp_path):
    own = {"task": [POINT, AXIS], "margin_m": 0.002, "feed": "5mm/s"}
    job = build.resolved_scene(load_config(write_job(tmp_path, LEFT | own)))[0]
    assert (job.margin_m, job.program.feed, len(job.task)) == (0.002, "5mm/s", 2)
    assert job.workpiece.seams[0].task == () and job.workpiece.seams[0].margin_m is None


TORCH = {"tool_axis": "-tcp.z", "work_angle_deg": [-60, 60], "travel_angle_deg": [-80, 80]}
TACKS = {"name": "tacks", "path": "path.csv", "rows": [6, 2], "points": True, "task": [POINT]}


@pytest.fixture(scope="module")
def with_other_rows(tmp_path_factory):
    """Folder of a plan whose seams have a cone, angles of a torch, and points without an orientation."""
    folder = tmp_path_factory.mktemp("rows")
    seams = LEFT, RIGHT | {"task": [POINT, TORCH], "margin_m": 0.002}, TACKS
    plan_quickly(write_job(folder, *seams, task=[POINT, AXIS]), folder / "out")
    return folder / "out"


def test_seams_with_other_kinds_of_rows_are_one_motion_that_the_validation_confirms(with_other_rows):
    assert len(summary(with_other_rows)["order"]["visits"]) == 4
    assert main(["validate", str(with_other_rows)]) == 0
    rows = json.loads((with_other_rows / "validation.json").read_text())["methods"]["beam"]["rows"]
    names = {"task.1: point tcp", "task.2: axis tcp.z", "task.2: tool_axis -tcp.z"}
    assert len(rows) == 3 and {row["row"] for row in rows} == names
    assert all(row["off"] <= row["most"] < 1e6 for row in rows)


def test_only_a_seam_with_angles_of_a_torch_has_them_in_tables_and_pictures(with_other_rows):
    rows = rows_of(with_other_rows, "trajectory.csv")
    assert {row["seam"] for row in rows if row["work_angle_deg"]} == {"right"}
    plan = api.open_plan(with_other_rows)
    ((here, row),) = plan.tool_axis_rows
    assert set(plan._seam_names[here]) == {"right"} and row.work_angle_deg == (-60, 60)
    assert len(plan._seam_names[here]) == sum(name == "right" for name in plan._seam_names)


def test_a_row_that_only_one_seam_has_is_validated_on_this_seam_alone(with_other_rows, tmp_path):
    shutil.copytree(with_other_rows, tmp_path / "near")
    record = json.loads((tmp_path / "near" / "summary.json").read_text())
    (right,) = [seam for seam in record["config"]["workpiece"]["seams"] if seam["name"] == "right"]
    right["task"][1]["work_angle_deg"] = [50, 51]
    (tmp_path / "near" / "summary.json").write_text(json.dumps(record))
    assert main(["validate", str(tmp_path / "near")]) == 1
    refuted = json.loads((tmp_path / "near" / "validation.json").read_text())["refuted"]
    (own,) = [each for each in summary(with_other_rows)["order"]["visits"] if each["name"] == "right"]
    on_path = range(max(1, own["first"]), own["last"] + 1)  # target 0 is the first point again, before the path
    assert {one["target"] for one in refuted} == set(on_path)


def test_a_program_and_its_proof_use_each_seams_own_rows(with_other_rows, tmp_path, capsys):
    program = str(tmp_path / "program.csv")
    limits = ["--feed", "60mm/s", "--set", "program.velocity=[1, 1, 1, 1]"]
    words = ["program", str(with_other_rows), "--format", "csv", "--check", "--out", program]
    assert main([*words, *limits]) == 0
    job = str(with_other_rows.parent / "job.yaml")
    assert main(["prove", program, "--job", job, "--out", str(tmp_path / "out")]) == 0
    rows = json.loads((tmp_path / "out" / "proof.json").read_text())["deviation"]["rows"]
    assert [row["row"] for row in rows] == ["point tcp", "axis tcp.z", "tool_axis -tcp.z"]
    assert all(row["error"] < 2e-3 for row in rows)


def test_only_a_seam_whose_rows_use_normals_needs_them_in_its_file(tmp_path):
    tilted = {"axis": "tcp.z", "towards": "path.normal", "cone_deg": 60}
    left = LEFT | {"path": "normals.csv", "task": [POINT, tilted]}
    rows = [",".join(map(str, [*point, 0, 0, -1])) for point in toy.workpiece().path]
    job = load_config(write_job(tmp_path, left, RIGHT, start_rad="auto"))
    (tmp_path / "normals.csv").write_text("\n".join(["x,y,z,nx,ny,nz", *rows, ""]))
    *_, scenario = build.resolved_scene(job)
    np.testing.assert_allclose(scenario.goals[:6, 3:], [[0, 0, -1, np.pi / 3]] * 6, atol=1e-12)
    np.testing.assert_allclose(scenario.goals[6:, :3], toy.workpiece().path[5:])
    job = load_config(write_job(tmp_path, left, RIGHT | {"task": [POINT, tilted | {"cone_deg": 50}]}, start_rad="auto"))
    with pytest.raises(InputError, match=r"seam 'right': task.2 \(axis tcp.z\): point 1 of the path has no normal"):
        build.resolved_scene(job)


def test_a_wrong_number_of_joint_speeds_is_refused_in_one_line(tmp_path, capsys):
    file = write_job(tmp_path, LEFT, RIGHT, program={"velocity": [1.0] * 5})
    assert main(["plan", str(file), "--out", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "program.velocity has 5 values, but the robot toy has 4 joints" in line


def test_an_error_in_a_seams_own_task_names_seam_and_row(tmp_path, capsys):
    file = write_job(tmp_path, LEFT, RIGHT | {"task": [POINT, AXIS | {"axis": "top.z"}]}, task=[POINT, AXIS])
    assert main(["plan", str(file), "--out", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "seam 'right': task.2: " in line


def test_a_path_and_seams_exclude_each_other_in_one_file_and_the_later_one_replaces_the_other(tmp_path):
    both = {"workpiece": {"path": "weld"}, "seams": [{"name": "a", "path": "crown"}]}
    with pytest.raises(InputError, match=r"workpiece\.path and seams are both given; write the path as one of the"):
        load_config(both)
    seams = {"seams": [{"name": "a", "path": "crown"}]}
    assert load_config(seams, ["workpiece.path=left"]).workpiece.seams == ()
    assert load_config(seams, ["seams.1.direction=forward"]).workpiece.seams[0].direction == "forward"
