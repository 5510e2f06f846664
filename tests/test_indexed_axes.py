"""Indexed axes: joints that stand still within each seam, and move before the path and between seams."""

import csv
import json
import shutil

import numpy as np
import pytest
import toy
import yaml
from test_json_schemas import fits
from test_moving_part import composed_in, job_in
from test_seams import LEFT, RIGHT

from htcp_jax.cli import main
from htcp_jax.jobs import build, load_config
from htcp_jax.motion import Problem
from htcp_jax.status import Kind

J3 = "j3_rad"
SHORT = "beam_width", "min_beam_width", "self_motions", "self_motion_rounds", "samples", "sample_steps"


def write_job(folder, *seams, indexed=("j3",), **changes):
    """Write the toy arm's job with the shelf above the arm, so that it need not fold, and indexed axes."""
    file = toy.write_job(folder, robot={"model": "arm.xml", "indexed": list(indexed)})
    np.savetxt(folder / "shelf.xyz", toy.workpiece().cloud + np.array([0.0, 0.0, 0.4]))
    job = yaml.safe_load(file.read_text())
    if seams:
        del job["workpiece"]["path"]
        job["seams"] = list(seams)
    file.write_text(json.dumps(job | changes))
    return file


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """Folder of a job with two seams, and of its plan in `out`."""
    folder = tmp_path_factory.mktemp("indexed")
    assert main(["plan", str(write_job(folder, LEFT, RIGHT)), "--out", str(folder / "out"), "--retract"]) == 0
    return folder


def rows_of(file) -> list[dict]:
    with open(file) as opened:
        return list(csv.DictReader(opened))


def written(file, rows) -> None:
    with open(file, "w", newline="") as opened:
        writer = csv.DictWriter(opened, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def test_the_axis_has_one_position_on_each_seam_and_moves_with_the_arm_between_them(planned):
    rows, summary = rows_of(planned / "out/motion.csv"), json.loads((planned / "out/summary.json").read_text())
    targets = rows_of(planned / "out/trajectory.csv")
    fits("plan", summary)
    on_seam = {name: {row[J3] for row in rows if row["seam"] == name and row["kind"] == Kind.PROCESS.name}
               for name in ("left", "right")}  # fmt: skip
    assert all(len(positions) == 1 for positions in on_seam.values())
    assert len({row[J3] for row in rows}) > 1
    for entry in summary["indexed"]:
        assert entry["still"] and {repr(entry["positions"]["j3"])} == on_seam[entry["seam"]]
        assert {row[J3] for row in targets[1:] if row["seam"] == entry["seam"]} == on_seam[entry["seam"]]
    assert [entry["seam"] for entry in summary["indexed"]] == [visit["name"] for visit in summary["order"]["visits"]]


def test_from_home_the_axis_moves_to_a_position_that_the_planner_chooses(tmp_path, capsys):
    folded = [0.0, 0.0, 2.4, -0.8]  # with j3 at 2.4 rad the arm is too short for the path
    file = write_job(tmp_path, start_rad="auto", home_rad=folded)
    assert main(["plan", str(file), "--out", str(tmp_path / "out")]) == 0
    rows = rows_of(tmp_path / "out/motion.csv")
    (position,) = {float(row[J3]) for row in rows if row["kind"] == Kind.PROCESS.name}
    assert float(rows[0][J3]) == 2.4 and position < 2.2
    assert f"j3 at {np.rad2deg(position):.4g} deg" in capsys.readouterr().out


def test_the_independent_validation_refutes_an_axis_that_moves_within_a_seam_by_any_amount(planned, tmp_path):
    shutil.copytree(planned / "out", tmp_path / "out")
    assert main(["validate", str(tmp_path / "out")]) == 0
    arrays = dict(np.load(tmp_path / "out/trajectory.npz"))
    arrays["x"][3, 2] += 1e-12
    np.savez(tmp_path / "out/trajectory.npz", **arrays)
    assert main(["validate", str(tmp_path / "out")]) == 1
    refuted = json.loads((tmp_path / "out/validation.json").read_text())["refuted"]
    assert {one["target"] for one in refuted} == {3, 4}
    assert all(one["reason"] == "j3 moves on the segment, but is an indexed axis" for one in refuted)


def test_a_proof_of_the_motion_states_whether_the_axis_stands_still_along_the_path(planned, tmp_path, capsys):
    job = ["--job", str(planned / "job.yaml"), "--out", str(tmp_path / "proof")]
    assert main(["prove", str(planned / "out/motion.csv"), *job]) == 0
    assert "j3 stands still along the path" in capsys.readouterr().out
    rows = rows_of(planned / "out/motion.csv")
    number = [k for k, row in enumerate(rows) if row["kind"] == Kind.PROCESS.name][2]
    rows[number][J3] = repr(float(rows[number][J3]) + 1e-9)
    written(tmp_path / "moved.csv", rows)
    assert main(["prove", str(tmp_path / "moved.csv"), *job]) == 1
    printed = capsys.readouterr().out
    assert "indexed axis moves: j3" in printed and "j3 moves by up to 5.73e-08 deg on lines" in printed
    record = json.loads((tmp_path / "proof/proof.json").read_text())
    fits("proof", record)
    (axis,) = record["deviation"]["indexed"]
    assert axis["joint"] == "j3" and axis["travel"] == pytest.approx(1e-9, rel=1e-5)


def test_a_program_holds_the_axis_and_its_proof_says_so(planned, tmp_path, capsys):
    file = tmp_path / "program.csv"
    words = [str(planned / "out"), "--feed", "50mm/s", "--format", "csv", "--out", str(file)]
    assert main(["program", *words, "--set", "program.velocity=[1, 1, 1, 1]"]) == 0
    job = ["--job", str(planned / "job.yaml"), "--out", str(tmp_path / "proof")]
    capsys.readouterr()
    assert main(["prove", str(file), *job]) == 0
    assert "j3 stands still along the path" in capsys.readouterr().out


RAIL = """<robot name="track"><link name="floor"/><link name="car"/>
<joint name="rail" type="prismatic"><parent link="floor"/><child link="car"/><axis xyz="0 1 0"/>
<limit lower="-0.2" upper="0.2" velocity="0.5" effort="100"/></joint></robot>"""


def test_in_a_composed_cell_rail_and_positioner_stand_still_on_both_seams(tmp_path, capsys):
    """Targets are inserted on these seams, so they have more rows than their path."""
    job = composed_in(tmp_path, job_in(tmp_path))
    (tmp_path / "rail.urdf").write_text(RAIL)
    path = job["workpiece"].pop("path")
    job |= {
        "robot": {**job["robot"], "parent": "rail.car"},
        "rail": {"model": str(tmp_path / "rail.urdf"), "indexed": True},
        "positioner": {**job["positioner"], "indexed": True},
        "program": {"velocity": [1.0] * 6},
        "seams": [{"name": name, "path": path, "rows": [row, 3]} for name, row in (("first", 0), ("second", 4))],
        "settings": {"q_weights": [1.0] * 6, **{name: getattr(toy.SETTINGS, name) for name in SHORT}},
    }
    (tmp_path / "job.yaml").write_text(json.dumps(job))
    assert main(["plan", str(tmp_path / "job.yaml"), "--out", str(tmp_path / "out")]) == 0
    rows = rows_of(tmp_path / "out/motion.csv")
    for seam in ("first", "second"):
        own = [row for row in rows if row["seam"] == seam and row["kind"] == Kind.PROCESS.name]
        assert len(own) > 2 and len({(row["turn_rad"], row["rail_m"]) for row in own}) == 1
    assert main(["validate", str(tmp_path / "out")]) == 0
    given = str(tmp_path / "out/motion.csv"), "--job", str(tmp_path / "job.yaml")
    assert main(["prove", *given, "--out", str(tmp_path / "proof")]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "turn stands still along the path; rail stands still along the path" in printed


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"indexed": ["j9"]}, "robot.indexed: 'j9' is not a joint that the planner moves; valid: j1, j2, j3, j4"),
        ({"indexed": ["j1", "j2", "j3", "j4"]}, "all joints of toy are indexed (j1, j2, j3, j4)"),
        ({"indexed": ["j1", "j2"]}, "the task has 3 equations, more than the joints that move along a seam, j3, j4"),
        ({"method": "baseline"}, "indexed axes (j3) need the method beam; baseline moves every joint along a seam"),
        ({"positioner": {"indexed": True}}, "indexed is set, but model is missing"),
    ],
)
def test_invalid_indexed_axes_are_refused_in_one_line(tmp_path, capsys, changes, words):
    assert main(["plan", str(write_job(tmp_path, **changes)), "--out", str(tmp_path / "out")]) == 2
    (line,) = [each for each in capsys.readouterr().err.splitlines() if words in each]
    assert line.startswith("htcp: ") and not (tmp_path / "out").exists()


def test_a_locked_joint_cannot_be_indexed(tmp_path, capsys):
    file = write_job(tmp_path, robot={"model": "arm.xml", "indexed": ["j3"], "locked": {"j3": 1.0}})
    assert main(["plan", str(file), "--out", str(tmp_path / "out")]) == 2
    assert "robot.indexed: 'j3' is locked, see robot.locked" in capsys.readouterr().err


def test_without_indexed_axes_the_lanes_and_the_record_of_a_job_are_as_before(tmp_path):
    job = load_config(write_job(tmp_path, robot={"model": "arm.xml"}))
    assert "indexed" not in job.robot.model_dump() and "indexed" not in job.positioner.model_dump()
    job, robot, workpiece, scenario = build.resolved_scene(job)
    problem = Problem.of(robot, workpiece, scenario, job.settings)
    inputs = problem.inputs(np.zeros(2, int), 1)
    assert problem.with_still_joints(inputs, np.zeros(2, int), np.ones(2, int)) is inputs and inputs.still is None
    assert not problem.settings.transfers
