"""Jobs with several seams: their entries, their order, and one proven motion through all of them."""

import csv
import json
import warnings

import numpy as np
import pytest
import toy
import yaml
from test_json_schemas import fits

from htcp_jax import sequencing
from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.jobs import build, load_config, seam_scenarios
from htcp_jax.jobs.seam_paths import points_of_seams, with_seams_of_files
from htcp_jax.model.path_frames import tangents
from htcp_jax.motion import Problem, motion
from htcp_jax.planning import methods
from htcp_jax.runs.seam_order import SeamOrder
from htcp_jax.status import Kind

LEFT, RIGHT = (
    {"name": "left", "path": "path.csv", "rows": [0, 5]},
    {"name": "right", "path": "path.csv", "rows": [5, 5]},
)
FAR = {"name": "far", "path": "far.csv"}


def write_job(folder, *seams, **changes):
    """Write the toy arm's job with seams in place of its path, and return its file."""
    file = toy.write_job(folder)
    np.savetxt(folder / "far.csv", [[9.0, 0.0, 0.3], [9.1, 0.0, 0.3]], delimiter=",")
    points = [",".join(map(str, point)) for point in toy.workpiece().path]
    (folder / "two.csv").write_text("\n".join([*points[:5], "", *points[5:], ""]))
    for name, labels in {"returns": "aabba", "empty_cell": ["a", "a", "", "b", "b"]}.items():
        rows = [f"{point},{label}" for point, label in zip(points, labels, strict=False)]
        (folder / f"{name}.csv").write_text("\n".join(["x,y,z,seam", *rows, ""]))
    job = yaml.safe_load(file.read_text())
    del job["workpiece"]["path"]
    file.write_text(yaml.safe_dump(job | {"seams": list(seams)} | changes))
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
    assert main(["plan", str(file), "--out", str(folder / "out"), "--retract"]) == 3
    return folder / "out"


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    """Folder of a plan of two seams, the second of which must come first, and backwards."""
    folder = tmp_path_factory.mktemp("ordered")
    file = write_job(folder, LEFT | {"after": ["right"]}, RIGHT | {"direction": "backward"})
    assert main(["plan", str(file), "--out", str(folder / "out"), "--retract"]) == 0
    return folder / "out"


def rows_of(folder, name="motion.csv") -> list[dict]:
    with open(folder / name) as file:
        return list(csv.DictReader(file))


def summary(folder) -> dict:
    return json.loads((folder / "summary.json").read_text())


def test_a_seam_out_of_reach_is_missing_with_its_reason_and_the_others_are_done(planned):
    order = summary(planned)["order"]
    assert {visit["name"] for visit in order["visits"]} == {"left", "right"}
    assert list(order["missing"]) == ["far"] and order["missing"]["far"].startswith("a target is farther away")


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
    command = ["program", str(complete), "--feed", "20mm/s", "--format", "csv", "--out", str(tmp_path / "p.csv")]
    assert main([*command, *limits]) == 0
    assert "proven" in capsys.readouterr().out


def test_the_program_stops_at_each_point(tmp_path):
    seams = LEFT | {"rows": [2, 3], "points": True}, RIGHT
    assert main(["plan", str(write_job(tmp_path, *seams)), "--out", str(tmp_path / "out")]) == 0
    command = [
        "program",
        str(tmp_path / "out"),
        "--feed",
        "20mm/s",
        "--format",
        "csv",
        "--out",
        str(tmp_path / "p.csv"),
    ]
    assert main([*command, "--set", "program.velocity=[1, 1, 1, 1]"]) == 0
    joints = [f"j{k}_rad" for k in range(1, 5)]
    lines = [line for line in (tmp_path / "p.csv").read_text().splitlines() if not line.startswith("#")]
    program = np.array([[float(row[name]) for name in joints] for row in csv.DictReader(lines)])
    points = [row for row in rows_of(tmp_path / "out", "trajectory.csv") if row["seam"].startswith("left")]
    assert len({row["seam"] for row in points}) == 3
    for point in points:
        apart = np.abs(program - [float(point[name]) for name in joints]).max(axis=1)
        assert apart.min() < 1e-8
        assert np.abs(np.diff(program, axis=0)).max(axis=1)[max(0, apart.argmin() - 1)] < 1e-5


def test_a_saved_plan_whose_seams_do_not_ascend_is_refused(complete, tmp_path, capsys):
    (tmp_path / "summary.json").write_text((complete / "summary.json").read_text())
    arrays = dict(np.load(complete / "trajectory.npz"))
    np.savez(tmp_path / "trajectory.npz", **arrays | {"seam_begins": np.array([99])})
    assert (
        main(["program", str(tmp_path), "--feed", "20mm/s", "--format", "csv", "--out", str(tmp_path / "p.csv")]) == 2
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
    task, obstacles = build.task_of_job(job, robot), build.obstacles_of(job.cell, robot)
    problem = Problem.of(robot, found.workpiece, found.scenarios, job.settings, task, obstacles)
    home, speed = np.asarray(problem.scenarios.x_home[0]), np.ones(len(robot.joint_names))
    made = sequencing.plan_seams(problem, found.variants, home, speed, methods.find(job.method), seen.append)
    moves = sequencing.moves_between(problem, made.found, home, speed)
    return found, made.found, moves, seen


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
    assert seen[-1].targets_tracked == seen[-1].targets > 0
    seen.clear()
    again = sequencing.find_sequence(seams, plans, found.before, moves, 0, seen.append, effort=1.0)
    assert not seen
    assert again.cost_s == pytest.approx(order.cost_s)
    legs = [leg.time_s for leg in (*again.moves, again.retract)]
    steps = [np.abs(np.diff(motion.motions(plan.plans, 0).x, axis=0)).max(axis=1) for plan in again.visits]
    assert again.cost_s == pytest.approx(sum(legs) + sum(each.sum() for each in steps))


def test_the_stated_gap_compares_an_order_with_its_lower_bound():
    assert "at most 25.0 % above the shortest order" in SeamOrder((), {}, 5.0, 4.0).facts()["order"]
    assert "no lower bound" in SeamOrder((), {}, 5.0, 0.0).facts()["order"]


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
    ([LEFT | {"direction": "up"}], "direction"),
    ([LEFT | {"pth": "x"}], "unknown key workpiece.seams.0.pth"),
    ([LEFT | {"path": "missing.csv", "rows": None}], "missing.csv"),
])  # fmt: skip
def test_an_invalid_list_of_seams_is_refused_in_one_line(tmp_path, seams, words):
    message = refusal(tmp_path, *seams)
    assert words in message and "\n" not in message


def test_a_path_and_seams_exclude_each_other_in_one_file_and_the_later_one_replaces_the_other(tmp_path):
    both = {"workpiece": {"path": "weld"}, "seams": [{"name": "a", "path": "crown"}]}
    with pytest.raises(InputError, match=r"workpiece\.path and seams are both given; write the path as one of the"):
        load_config(both)
    seams = {"seams": [{"name": "a", "path": "crown"}]}
    assert load_config(seams, ["workpiece.path=left"]).workpiece.seams == ()
    assert load_config(seams, ["seams.1.direction=forward"]).workpiece.seams[0].direction == "forward"


def test_a_sweep_over_a_job_with_several_seams_is_refused_in_one_line(tmp_path, capsys):
    write_job(tmp_path, LEFT, RIGHT)
    (tmp_path / "grid.yaml").write_text(yaml.safe_dump({"config": "job.yaml", "grid": [{"margin_m": [0.001, 0.002]}]}))
    assert main(["sweep", str(tmp_path / "grid.yaml"), "--out", str(tmp_path / "run")]) == 2
    assert "this command plans one seam, but the job has 2: left, right" in capsys.readouterr().err
