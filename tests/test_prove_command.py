"""`htcp prove` on the toy arm at its shelf: verdicts, limits, the path, files, and bad input.

All commands prove the same scene, so that its functions are compiled once.
"""

import json
import subprocess
import sys

import numpy as np
import pyarrow.parquet as pq
import pytest
import toy
from test_json_schemas import fits

from htcp_jax import prove_file
from htcp_jax.cli import main
from htcp_jax.cli.prove import unproven_table
from htcp_jax.motion import start_cause
from htcp_jax.proving import proof_record
from htcp_jax.report.charts import proof_chart
from htcp_jax.runs import columns
from htcp_jax.status import SegmentStatus
from htcp_jax.viewer import replays_of_file
from htcp_jax.viewer.browser.texts import target_facts

JOINTS = "j1", "j2", "j3", "j4"
START = np.array(toy.START)
TURN = np.array([1.0, 0.0, 0.0, 0.0])  # of the first joint: the arm stays clear of the shelf in front of it


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    """The job of the toy arm, the shelf and its path."""
    return toy.write_job(tmp_path_factory.mktemp("toy"))


@pytest.fixture(scope="module")
def tracked():
    """Configurations of a plan before the path and on it; none of the joint paths between them collides."""
    return toy.plans_by().x[0, 1:14]


def table(file, x, time_s=None, velocity=None, kind=None):
    """Write a table with a column per joint, and return the file."""
    head, parts = list(JOINTS), [np.asarray(x)]
    if time_s is not None:
        head, parts = ["time_s", *head], [np.asarray(time_s)[:, None], *parts]
    if velocity is not None:
        head, parts = [*head, *(f"{name}_velocity" for name in JOINTS)], [*parts, velocity]
    rows = [[repr(float(value)) for value in row] for row in np.concatenate(parts, axis=1)]
    if kind is not None:
        head, rows = [*head, "kind"], [[*row, word] for row, word in zip(rows, kind, strict=True)]
    file.write_text("\n".join(",".join(row) for row in [head, *rows]) + "\n")
    return file


@pytest.fixture
def proven(job, tmp_path, capsys):
    """Function that proves a file and returns the exit code, the written JSON, and what is printed."""

    def run(file, *words):
        code = main(["prove", str(file), "--job", str(job), "--out", str(tmp_path / "out"), *map(str, words)])
        record = json.loads((tmp_path / "out" / "proof.json").read_text())
        fits("proof", record)
        assert record["exit_code"] == code
        return code, record, capsys.readouterr().out

    return run


def into_the_shelf(tracked):
    """The plan's first configurations and one that raises the forearm into the shelf."""
    return np.concatenate([tracked[:4], tracked[3:4] - [0.0, 0.0, 0.35, 0.0], tracked[3:4]])


def test_a_clear_motion_is_proven_with_a_clearance_that_a_thousand_samples_keep(proven, tmp_path):
    x = START + np.outer([0.0, 0.4, 0.8, 0.3], TURN)
    code, record, printed = proven(table(tmp_path / "clear.csv", x))
    assert code == 0 and record["verdict"] == "proven" and not record["unproven"]
    assert printed.startswith("proven: guaranteed clearance ")
    samples = np.linspace(x[:-1], x[1:], 334).reshape(-1, 4)
    least = toy.measured(toy.scenario(), samples)[0].min()
    assert 0 < record["clearance_m"] <= least


def test_a_collision_is_refuted_with_its_line_body_obstacle_and_depth(proven, tracked, tmp_path):
    code, record, printed = proven(table(tmp_path / "hit.csv", into_the_shelf(tracked)))
    assert code == 1 and record["verdict"] == "refuted"
    assert printed.startswith("refuted: first contact on lines ") and "inside the workpiece" in printed
    deepest = max(record["unproven"], key=lambda row: row["depth_m"])
    a, b = (into_the_shelf(tracked)[deepest["line_begin"] - 2 + k] for k in (0, 1))
    clearance = toy.measured(toy.scenario(), (a + deepest["deepest_share"] * (b - a))[None])[0][0]
    assert deepest["verdict"] == "IN_COLLISION" and deepest["other"] == "the workpiece"
    assert deepest["body"].removeprefix("capsule ") in ("forearm", "tool")
    assert -deepest["depth_m"] == pytest.approx(clearance, abs=1e-6)
    assert f"{1e3 * deepest['depth_m']:.3g} mm inside" in printed


def test_the_required_clearance_refutes_a_motion_that_is_nearer(proven, tmp_path):
    file = table(tmp_path / "clear.csv", START + np.outer([0.0, 0.4], TURN))
    clear = proven(file)[1]["clearance_m"]
    assert proven(file, "--margin", f"{0.5e3 * clear}mm")[0] == 0
    code, record, printed = proven(file, "--margin", "1m")
    assert code == 1 and record["unproven"][0]["verdict"] == "BELOW_MARGIN"
    assert "less than the margin of 1000 mm" in printed


def test_a_motion_that_only_its_tracking_error_may_lead_into_the_shelf_is_undecided(proven, tracked, tmp_path):
    file = table(tmp_path / "near.csv", tracked[:6])
    assert proven(file)[0] == 0
    code, record, printed = proven(file, "--tracking", "20deg")
    assert code == 4 and record["verdict"] == "undecided" and printed.startswith("undecided: lines ")
    assert {(row["verdict"], row["cause"]) for row in record["unproven"]} == {("UNDECIDED", "TRACKING")}
    assert "clear on the motion itself, not proven within the tracking" in " ".join(printed.split())
    assert record["tracking"] == pytest.approx([np.radians(20)] * 4)


def test_a_collision_is_refuted_with_any_tracking_error(proven, tracked, tmp_path):
    assert proven(table(tmp_path / "hit.csv", into_the_shelf(tracked)), "--tracking", "1deg")[0] == 1


def test_a_cubic_motion_is_proven_between_its_configurations(proven, tmp_path):
    """Velocities at both ends lead the motion away from the straight joint path, beyond the joint limit."""
    x, time_s = START + np.outer([2.5, 2.9], TURN), [0.0, 1.0]
    straight = proven(table(tmp_path / "straight.csv", x, time_s))
    assert straight[0] == 0 and straight[1]["interpolation"] == "linear"
    velocity = np.outer([0.0, -1.5], TURN)
    code, record, printed = proven(table(tmp_path / "c.csv", x, time_s, velocity), "--interpolation", "cubic")
    assert record["verdict"] == "proven" and record["interpolation"] == "cubic"
    assert code == 1 and record["limits_violated"] and "limit violated: position of j1" in printed
    uses = {use["quantity"]: use for use in record["limits"]}
    s = np.linspace(0, 1, 100_001)
    curve = np.polynomial.Polynomial([2.5, 0.0, 3 * 0.4 + 1.5, -1.5 - 2 * 0.4])
    assert 0 <= uses["position"]["largest"] - curve(s).max() < 2e-3 and uses["position"]["is_violated"]
    for rate, quantity in enumerate(("velocity", "acceleration", "jerk"), start=1):
        most = np.abs(curve.deriv(rate)(s)).max()
        assert most - 1e-9 <= uses[quantity]["largest"] <= 1.01 * most and uses[quantity]["limit"] is None


def test_the_speed_is_compared_with_the_job_s_limits(proven, tmp_path):
    file = table(tmp_path / "fast.csv", START + np.outer([0.0, 0.4], TURN), [0.0, 0.2])
    limits = "--set", "program.velocity=[1.6, 3, 3, 3]"
    code, record, printed = proven(file, *limits)
    (use,) = (use for use in record["limits"] if use["quantity"] == "velocity")
    assert code == 1 and use["is_violated"] and use["share"] == pytest.approx(2.0 / 1.6) and use["joint"] == "j1"
    assert "125 % of the limit" in printed


def test_the_distance_from_the_job_s_path_is_measured_where_the_motion_is_on_it(proven, tracked, tmp_path):
    kind = ["approach"] * 5 + ["process"] * (len(tracked) - 5)
    record = proven(table(tmp_path / "weld.csv", tracked, kind=kind))[1]
    found, rows = record["deviation"], np.linspace(tracked[4:-1], tracked[5:], 10).reshape(-1, 4)
    a, b = toy.workpiece().path[:-1], toy.workpiece().path[1:]
    path = (a[:, None] + np.linspace(0, 1, 400)[None, :, None] * (b - a)[:, None]).reshape(-1, 3)
    apart = np.linalg.norm(toy.measured(toy.scenario(), rows)[1][:, None] - path, axis=2).min(axis=1)
    assert found["distance_m"] == pytest.approx(apart.max(), abs=1e-5)
    assert found["distance_m"] == pytest.approx(found["rows"][0]["error"], abs=1e-9)
    assert 0.5 < found["covered_m"] / found["length_m"] <= 1.0 + 1e-9


def test_the_table_of_segments_equals_the_json_and_describes_its_columns(proven, tracked, tmp_path):
    record = proven(table(tmp_path / "hit.csv", into_the_shelf(tracked)))[1]
    rows = pq.read_table(tmp_path / "out" / "segments.parquet")
    assert [row for row in rows.to_pylist() if row["verdict"] != "VALID"] == record["unproven"]
    assert len(rows) == record["segments"] == sum(record["segments_by_verdict"].values())
    assert sum(rows["queries"].to_pylist()) == record["queries"]
    assert set(rows.column_names) == set(columns.SEGMENTS)
    about = {field.name: field.metadata[b"description"].decode() for field in rows.schema}
    assert about == {name: columns.SEGMENTS[name] for name in rows.column_names}
    assert (tmp_path / "out" / "proof.png").read_bytes().startswith(b"\x89PNG")


def test_json_on_the_terminal_is_the_file_s(proven, tmp_path):
    _, record, printed = proven(table(tmp_path / "clear.csv", START + np.outer([0.0, 0.4], TURN)), "--json")
    assert json.loads(printed) == record


def test_the_function_returns_what_the_command_writes(job, proven, tracked, tmp_path):
    file = table(tmp_path / "hit.csv", into_the_shelf(tracked))
    found, record = prove_file(file, job), proven(file)[1]
    assert [found.contacts[row["segment"]].body for row in record["unproven"]] == [
        r["body"] for r in record["unproven"]
    ]
    assert found.proof.verdict.tolist() == [
        SegmentStatus[name].value
        for name in pq.read_table(tmp_path / "out" / "segments.parquet")["verdict"].to_pylist()
    ]


def test_a_file_is_replayed_with_its_verdicts_its_clearance_and_its_deepest_contacts(job, tracked, tmp_path):
    x = into_the_shelf(tracked)
    found = prove_file(table(tmp_path / "hit.csv", x), job)
    replay = replays_of_file(found).replay(0, "file")
    at_lines = np.array([place.startswith("line ") for place in replay.file.places])
    np.testing.assert_array_equal(replay.x[at_lines], x)
    assert replay.segment_status[at_lines][1:].tolist() == found.proof.verdict.tolist()
    np.testing.assert_array_equal(replay.x[~at_lines], [each.x for each in found.contacts.values()])
    clearance, tcp = toy.measured(toy.scenario(), replay.x)
    np.testing.assert_allclose(replay.clearance, clearance, atol=1e-9)
    np.testing.assert_allclose(replay.target, tcp, atol=1e-9)
    assert replay.path == 1


def test_a_played_file_says_the_verdict_on_its_segments_and_begins_at_its_deepest_contact(job, tracked, tmp_path):
    found = prove_file(table(tmp_path / "hit.csv", into_the_shelf(tracked)), job)
    replay = replays_of_file(found).replay(0, "file")
    shown, contact = replay.file, min(found.contacts.values(), key=lambda each: each.clearance_m)
    assert shown.headline.startswith("refuted: first contact on lines ") and "; deepest: lines " in shown.headline
    np.testing.assert_array_equal(replay.x[shown.first], contact.x)
    assert shown.places[0] == "line 2" and shown.segments[0] == "The motion begins here."
    assert "Lines 2 to 3: proven, at least " in shown.segments[1]
    assert "inside the workpiece" in shown.segments[shown.first]
    assert [style.name for style in replay.styles if style.where.any()] == ["proven", "refuted"]
    facts = target_facts(replay, shown.first)
    assert "in collision, **" in facts and "tracked" not in facts and "nan" not in target_facts(replay, 0)


def test_the_viewer_of_a_file_shows_no_planner_and_begins_at_the_deepest_contact(job, tracked, tmp_path):
    viser_viewer = pytest.importorskip("htcp_jax.viewer.browser.page", reason="the extra `view` is not installed")
    replays = replays_of_file(prove_file(table(tmp_path / "hit.csv", into_the_shelf(tracked)), job))
    viewer = viser_viewer.Viewer(replays, port=0)
    try:
        assert viewer.target == replays.file.first and "in collision, **" in viewer.facts
        assert not viewer._method.visible and not viewer._scenario.visible
        assert " deep at lines " in viewer.stage.label
    finally:
        viewer.stop()


def test_options_of_files_need_a_job(tmp_path, capsys):
    assert main(["view", str(tmp_path), "--unit", "deg"]) == 2
    assert "--unit is an option of files; pass --job, too" in capsys.readouterr().err


def test_a_proven_file_is_played_from_its_begin_and_marks_its_nearest_place(job, tmp_path):
    x = START + np.outer([0.0, 0.4, 0.8, 0.3], TURN)
    replay = replays_of_file(prove_file(table(tmp_path / "clear.csv", x), job)).replay(0, "file")
    assert replay.file.first == 0 and " mm clear" in replay.file.mark and replay.narrow is not None
    assert np.isfinite(replay.narrow.seen_m) and replay.narrow.seen_m <= replay.clearance.min() + 1e-9


def test_poses_are_compared_with_the_path_and_not_proven(proven, tmp_path):
    """The TCP's positions at the path's points; what the controller does between them is unknown."""
    lines = [f"C{k:05d}={','.join(f'{value:.3f}' for value in (*1e3 * point, 180.0, 0.0, 0.0))}"
             for k, point in enumerate(toy.workpiece().path)]  # fmt: skip
    moves = [f"MOVL C{k:05d} V=10.0" for k in range(len(lines))]
    head = ["/JOB", "//NAME WELD", "//POS", f"///NPOS {len(lines)},0,0,0,0,0", "///TOOL 0", "///POSTYPE ROBOT"]
    head += ["///RECTAN", "///RCONF 0,0,0,0,0,0,0,0"]
    (tmp_path / "weld.jbi").write_text("\n".join([*head, *lines, "//INST", "NOP", *moves, "END", ""]))
    code, record, printed = proven(tmp_path / "weld.jbi")
    assert code == 4 and record["verdict"] == "not proven" and "the controller's own" in printed
    assert record["deviation"]["distance_m"] < 1e-5
    assert record["deviation"]["covered_m"] == pytest.approx(record["deviation"]["length_m"], abs=1e-5)


@pytest.mark.parametrize(
    ("text", "words", "says"),
    [
        ("j1,j2,j3\n0,0,0\n", (), "the file lacks j4"),
        ("j1,j2,j3,j4,j5\n0,0,0,0,0\n", (), "the robot lacks j5"),
        ("j1,j2,j3,j4\n0,0,1.7,0.5\n", (), "one configuration"),
        ("j1,j2,j3,j4\n0,0,1.7,0.5\n0,nan,1.7,0.5\n", (), "line 3"),
        ("time_s,j1,j2,j3,j4\n1,0,0,1.7,0.5\n0.5,0,0,1.7,0.5\n", (), "times must increase"),
        ("j1,j2,j3,j4\n0,0,1.7,0.5\n0,0,1.6,0.5\n", ("--interpolation", "cubic"), "needs times and velocities"),
        ("j1,j2,j3,j4\n0,0,1.7,0.5\n0,0,1.6,0.5\n", ("--interpolation", "spline"), "valid: linear, cubic, quintic"),
        ("j1,j2,j3,j4\n0,0,1.7,0.5\n0,0,1.6,0.5\n", ("--format", "word"), "valid: csv"),
        ("j1,j2,j3,j4\n0,0,1.7,0.5\n0,0,1.6,0.5\n", ("--unit", "grad"), "valid: rad, deg"),
        ("j1,j2,j3,j4\n0,0,1.7,0.5\n0,0,1.6,0.5\n", ("--margin", "1"), "--margin 1: it must be a number of 0 or more"),
        ("j1,j2,j3,j4\n0,0,1.7,0.5\n0,0,1.6,0.5\n", ("--tracking", "-1deg"), "units: deg, rad"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(job, tmp_path, capsys, text, words, says):
    (tmp_path / "bad.csv").write_text(text)
    out = tmp_path / "out"
    assert main(["prove", str(tmp_path / "bad.csv"), "--job", str(job), "--out", str(out), *words]) == 2
    printed = capsys.readouterr()
    assert says in printed.err and printed.err.count("\n") == 1 and not printed.out
    assert not out.exists()


def test_a_missing_file_and_a_missing_job_are_named(tmp_path, capsys):
    assert main(["prove", str(tmp_path / "none.csv"), "--job", str(tmp_path / "none.yaml")]) == 2
    assert "none.yaml" in capsys.readouterr().err
    assert main(["prove", str(tmp_path / "none.csv")]) == 2
    assert "--job" in capsys.readouterr().err


def test_a_job_without_a_part_names_the_fixture_and_is_played(tmp_path, capsys):
    """A box in front of the arm, and a motion that turns into it."""
    (tmp_path / "arm.xml").write_text(toy.ARM)
    box = '<body name="box" pos="0 0.5 0.55"><geom type="box" size="0.1 0.1 0.1"/></body>'
    (tmp_path / "cell.xml").write_text(f"<mujoco><worldbody>{box}</worldbody></mujoco>")
    job = tmp_path / "job.yaml"
    job.write_text("robot: {model: arm.xml}\ncell: {model: cell.xml}\n")
    file = table(tmp_path / "turn.csv", [[0, 0.8, 0.7, 0.0], [1.0, 0.8, 0.7, 0.0], [1.6, 0.8, 0.7, 0.0]])
    assert main(["prove", str(file), "--job", str(job), "--out", str(tmp_path / "out")]) == 1
    printed = capsys.readouterr().out
    assert "the fixture 'box'" in printed.splitlines()[0] and "path" not in printed
    assert "inside the fixture 'box'" in printed.splitlines()[1]
    replay = replays_of_file(prove_file(file, job)).replay(0, "file")
    assert len(replay.x) == 4 and replay.clearance[2] <= replay.clearance[3] < 0 < replay.clearance[0]  # 2: deepest


def test_a_refuted_motion_names_its_first_contact_and_then_its_deepest_with_another_obstacle(tmp_path, capsys):
    """The arm turns past a post, into which its tip reaches by 5 mm, and then into a box."""
    (tmp_path / "arm.xml").write_text(toy.ARM)
    post = '<body name="post" pos="0.679 0.679 0.618" euler="0 0 45"><geom type="box" size="0.1 0.1 0.1"/></body>'
    box = '<body name="box" pos="0 0.5 0.55"><geom type="box" size="0.1 0.1 0.1"/></body>'
    (tmp_path / "cell.xml").write_text(f"<mujoco><worldbody>{post}{box}</worldbody></mujoco>")
    job, out = tmp_path / "job.yaml", tmp_path / "out"
    job.write_text("robot: {model: arm.xml}\ncell: {model: cell.xml}\n")
    turns = np.array([0.0, 0.6, 1.0, 1.6])
    file = table(tmp_path / "turn.csv", [[turn, 0.8, 0.7, 0.0] for turn in turns], time_s=[0.0, 1.0, 2.0, 4.0])
    assert main(["prove", str(file), "--job", str(job), "--out", str(out)]) == 1
    first_line, second_line = capsys.readouterr().out.splitlines()[:2]
    record = json.loads((out / "proof.json").read_text())
    fits("proof", record)
    first, deepest = record["first_contact"], record["deepest_contact"]
    assert (first["line_begin"], first["line_end"], first["other"]) == (3, 4, "the fixture 'post'")
    assert (deepest["line_begin"], deepest["line_end"], deepest["other"]) == (4, 5, "the fixture 'box'")
    assert first["time_s"] == pytest.approx(1 + first["place_share"]) and first["segment_depth_m"] < 0.006
    assert first_line.startswith(
        f"refuted: first contact on lines 3 to 4, {100 * first['place_share']:.0f} % of the way"
    )
    assert f"({first['time_s']:.4g} s)" in first_line
    place = ", ".join(f"{value:.3f}" for value in first["point_m"])
    assert first_line.endswith(
        f"{first['body']} and the fixture 'post' at ({place}) m, "
        f"{1e3 * first['segment_depth_m']:.3g} mm deep on these lines"
    )
    c = np.sqrt(0.5)  # the point is on the surface of the post, which is turned by 45 degrees
    inside = np.abs(np.array([[c, c, 0], [-c, c, 0], [0, 0, 1]]) @ (np.array(first["point_m"]) - [0.679, 0.679, 0.618]))
    assert inside.max() == pytest.approx(0.1, abs=1e-5)
    assert second_line.startswith("deepest: lines 4 to 5, ")
    assert second_line.endswith(f"{1e3 * deepest['depth_m']:.3g} mm inside the fixture 'box'")
    # the motion is clear up to this place, and touches there
    problem, x = prove_file(file, job).scene.problem, np.tile([0.0, 0.8, 0.7, 0.0], (2001, 1))
    x[:, 0] = np.linspace(0.0, 0.6 + 0.4 * first["place_share"], 2001)
    clearance = start_cause.clearances_at(problem, x)
    assert (clearance[:-1] > 0).all() and clearance[-1] == pytest.approx(0, abs=1e-6)


def test_columns_with_other_names_are_proven_by_joints_and_refused_before_the_part_is_read(job, tmp_path, capsys):
    file, part, out = tmp_path / "foreign.csv", tmp_path / "part.ply", tmp_path / "out"
    part.write_text("this is no part\n")
    file.write_text("time_s,A1,A2,A3,A4\n0,0,0,100,30\n1,30,0,100,30\n")
    words = ["prove", str(file), "--job", str(job), "--unit", "deg", "--out", str(out)]
    assert main([*words, "--set", f"workpiece.cloud={part}"]) == 2
    assert capsys.readouterr().err.endswith("pass --joints A1,A2,A3,A4\n")
    for names, says in (
        ("A1,A2,A3", "--joints has 3 names: A1, A2, A3; toy has 4 joints: j1, j2, j3, j4"),
        ("A1,A2,A3,A5", "no column is named A5, as --joints requires"),
        ("A1,A2,A3,A3", "--joints has 'A3' 2 times"),
    ):
        assert main([*words, "--joints", names]) == 2
        printed = capsys.readouterr()
        assert says in printed.err and printed.err.count("\n") == 1 and not out.exists()
    assert main([*words, "--joints", "A1,A2,A3,A4"]) == 0
    found = prove_file(file, job, unit="deg", joints=["A1", "A2", "A3", "A4"])
    np.testing.assert_allclose(found.motion.x[1], np.radians([30, 0, 100, 30]))


def test_the_command_keeps_its_compiled_programs():
    """Regression: the command imported JAX too late for the folder of compiled programs, and compiled each time."""
    code = "from htcp_jax.cli.main import _imported; _imported('prove'); import jax"
    shown = "; print(jax.config.jax_compilation_cache_dir)"
    found = subprocess.run([sys.executable, "-c", code + shown], capture_output=True, text=True)
    assert found.stdout.strip() not in ("", "None"), found.stderr


def test_a_group_of_segments_names_each_link_and_obstacle_that_collide_and_the_chart_too(tmp_path, capsys):
    (tmp_path / "arm.xml").write_text(toy.ARM)
    bodies = "".join(
        f'<body name="{name}" pos="{place}" euler="0 0 45"><geom type="box" size="0.1 0.1 0.05"/></body>'
        for name, place in (("post", "0.679 0.679 0.618"), ("step", "0.36 0.36 0.68"))
    )
    (tmp_path / "cell.xml").write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    job = tmp_path / "job.yaml"
    job.write_text("robot: {model: arm.xml}\ncell: {model: cell.xml}\n")
    file = table(tmp_path / "turn.csv", [[turn, 0.8, 0.7, 0.0] for turn in (0.0, 0.6, 1.0)])
    found = prove_file(file, job)
    (group,) = proof_record.unproven_groups(found)
    pairs = proof_record.worst_pairs(found, group)
    assert [(each.body, each.other) for each in pairs] == [
        ("capsule tool", "the fixture 'post'"),
        ("capsule forearm", "the fixture 'step'"),
    ]
    assert [each.clearance_m for each in pairs] == sorted(each.clearance_m for each in pairs)
    assert pairs[0] is found.contacts[group.deepest] and all(each.clearance_m < 0 for each in pairs)
    assert [row[-1] for row in unproven_table(found).rows] == [each.text for each in pairs]
    above, below = proof_chart(found).axes
    assert [text.get_text() for text in below.get_legend().get_texts()] == [
        f"{each.body} and {each.other}" for each in pairs
    ]
    # the measured distance is nowhere below the guaranteed lower bound
    (line,) = (each for each in above.lines if len(each.get_xdata()) > 1)
    begin = found.proof.verdict == SegmentStatus.VALID
    assert (line.get_ydata()[: begin.sum()] >= 1e3 * found.proof.clearance_m[begin]).all()
