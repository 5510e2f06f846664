"""`htcp program` on the command line: its table, its file, the check by MuJoCo, and one line for each error."""

import csv
import json
import re
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy
from made_plan import made_plan

from htcp_jax.cli import main
from htcp_jax.io.motions import controller_of, read_motion
from htcp_jax.io.robots import read_joint_limits
from htcp_jax.io.robots.loading import gp50
from htcp_jax.model.kinematics import tcp_pose
from htcp_jax.proving import prove_with_exact_corners
from htcp_jax.runs import open_plans
from htcp_jax.runs.plan_folder import SUMMARY, TRAJECTORY
from htcp_jax.status import Kind
from htcp_jax.system.output_files import write_json
from htcp_jax.trajectory import FORMATS, limits_overrides
from htcp_jax.trajectory.deviation import deviations, worst_deviation
from htcp_jax.trajectory.file_motion import file_motion
from htcp_jax.trajectory.formats import as_jbi
from htcp_jax.trajectory.limits import joint_limits
from htcp_jax.trajectory.plan_program import program_of
from htcp_jax.validation import check_timed
from htcp_jax.validation.records import read_results
from htcp_jax.validation.track import scene_of
from htcp_jax.validation.validate import LoadedParts
from htcp_jax.viewer.arm_pose import arms_at

STEP_S = 1e-3
ROUNDING = 1e-6  # of a limit: third differences of doubles over 1 ms
WELD = "0.1857,-0.1737,0.1708\n0.19,-0.1738,0.1705\n0.195,-0.1739,0.1703\n"
PER_RAD, ZERO_RAD = [9e4, 8e4, -8e4, -5e4, -5e4, -3e4], [0, -1.5, 0, 0, 0, 0]
_POSE = jax.jit(tcp_pose)
PULSES = f"program.pulses={{per_rad: {PER_RAD}, zero_rad: {ZERO_RAD}, source: a drawing}}"


@pytest.fixture(scope="module")
def plans(tmp_path_factory):
    """A folder with an executable plan of three points of the generated duct's weld, and one that is not executable."""
    folder = tmp_path_factory.mktemp("plans")
    (folder / "path.csv").write_text(WELD)
    set_path = ["--set", f"workpiece.path={folder / 'path.csv'}"]
    assert main(["plan", *set_path, "--out", str(folder / "good")]) == 0
    made_plan(folder / "job").save(folder / "bad")
    return folder


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(plans, *words: str) -> int:
    return main(["program", str(plans / "good"), "--feed", "20mm/s", *words])


def limits_file(folder, **limits) -> str:
    """File in which joint6 of the GP50 has other limits than its model states."""
    (folder / "joint_limits.yaml").write_text(json.dumps({"joint_limits": {"joint6": limits}}))
    return str(folder / "joint_limits.yaml")


def test_limits_of_a_file_replace_the_model_s_joint_by_joint_and_set_precedes_them(plans, here, capsys):
    file = limits_file(here, max_velocity=0.25, has_acceleration_limits=False, max_acceleration=9)
    (change,) = limits_overrides(read_joint_limits(file, gp50().joint_names, "gp50"), gp50())
    assert change == f"program.velocity={[*np.asarray(gp50().speed)[:5].tolist(), 0.25]}"
    for words, expected in (([], 0.25), (["--set", "program.velocity=[1, 1, 1, 1, 1, 2]"], 2.0)):
        assert run(plans, "--out", "weld.ros.yaml", "--limits", file, *words, "--json") == 0
        output = capsys.readouterr()
        assert "note: " in output.err and "not used: max_acceleration of joint6" in output.err
        record = json.loads(output.out)
        made = program_of(open_plans(plans / "good"), 0.02, overrides=words[1:] or [change])
        assert made.limits.velocity[5] == expected
        assert record["duration_s"] == pytest.approx(made.program.duration_s)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("joints: {}", "the mapping joint_limits is missing"),
        ("joint_limits: {a1: {max_velocity: 1}}", "no joint of gp50 is listed; valid: joint1, joint2"),
        ("joint_limits: {joint6: 1}", "joint joint6 must be a mapping, such as {max_velocity: 2.0}"),
        (
            "joint_limits: {joint6: {max_velocity: 0}}",
            "max_velocity of joint joint6 is 0; it must be a positive number",
        ),
        ("joint_limits: {joint6: {max_jerk: 1}}", "max_jerk of joint joint1 is missing here and in the model"),
        ("joint_limits: {joint6: {}}", "limits no joint of gp50"),
    ],
)
def test_a_file_without_usable_limits_is_refused(plans, here, capsys, text, line):
    (here / "limits.yaml").write_text(text)
    assert run(plans, "--out", "weld.csv", "--limits", "limits.yaml") == 2
    assert line in capsys.readouterr().err and not (here / "weld.csv").exists()


def at_home(plans) -> np.ndarray:
    """First configuration of the good plan's motion."""
    return open_plans(plans / "good").plans("beam").start[0]


@pytest.mark.parametrize("format", FORMATS)
def test_a_motion_outside_the_ranges_of_a_file_is_refused_in_every_format(plans, here, capsys, format):
    low = float(at_home(plans)[5]) + 0.5
    file = limits_file(here, min_position=low, max_position=low + 1)
    assert run(plans, "--out", "weld.out", "--format", format, "--limits", file) == 2
    line = capsys.readouterr().err
    found = re.search(r"joint joint6 reaches (\S+) rad (at target \d+|in the \w+), (.*) allows (\S+);", line)
    assert line.count("\n") == 1, "no note on elements of a file that is refused"
    assert float(found[1]) < low and found[3] == file and float(found[4]) == pytest.approx(low, abs=1e-4)
    assert not list(here.glob("weld*"))


def test_a_range_that_is_switched_off_or_contains_the_motion_changes_nothing(plans, here):
    written = []
    for limits in (
        {"max_velocity": 3},
        {"max_velocity": 3, "min_position": -3.1, "max_position": 3.1},
        {"max_velocity": 3, "has_position_limits": False, "min_position": 3, "max_position": 3.1},
    ):
        assert run(plans, "--out", "weld.csv", "--limits", limits_file(here, **limits)) == 0
        written.append((here / "weld.csv").read_bytes())
    assert written[0] == written[1] == written[2]


def test_the_retraction_and_the_approach_count_too(plans, here, capsys):
    """The file allows the path only: the motion there, which begins at home, is outside."""
    made = program_of(open_plans(plans / "good"), 0.02).program.motion
    path = made.x[made.kind == Kind.PROCESS]
    far = int(np.abs(at_home(plans) - path[0]).argmax())
    ends = {"min_position": float(path[:, far].min()) - 1e-3, "max_position": float(path[:, far].max()) + 1e-3}
    (here / "joint_limits.yaml").write_text(json.dumps({"joint_limits": {f"joint{far + 1}": ends}}))
    assert run(plans, "--out", "weld.csv", "--limits", "joint_limits.yaml") == 2
    assert f"joint joint{far + 1} reaches" in capsys.readouterr().err


def test_the_table_says_how_long_it_takes_where_the_feed_drops_and_what_is_used_of_each_limit(plans, here, capsys):
    assert run(plans, "--out", "weld.csv") == 0
    output = capsys.readouterr()
    assert output.err == ""
    for name in ("duration", "feed", "velocity", "acceleration", "jerk", "torque", "file"):
        assert sum(line.startswith(f"{name} ") for line in output.out.splitlines()) == 1, name
    assert "20 mm/s, held within 1 % over" in output.out and "stop: the arm starts or stops there" in output.out
    assert "near the part" not in output.out
    assert run(plans, "--out", "weld.csv", "--set", "program.near_part_speed=0.2") == 0
    assert "at most 20 % of full joint speed within 20 mm of it, before and after the path" in capsys.readouterr().out
    assert run(plans, "--out", "weld.csv", "--json") == 0
    record = json.loads(capsys.readouterr().out)
    assert record["path_m"] == pytest.approx(0.0093, abs=2e-4) and 0 < record["held_share"] < 1
    assert all(drop["manipulability_m_rad"] > 0 and drop["target"] >= 0 for drop in record["feed_drops"])
    assert set(record["seconds"]) == {"approach", "process", "retract"}
    assert sum(record["seconds"].values()) == pytest.approx(record["duration_s"])
    assert all(0 < record["shares"][kind]["share"] <= 1 for kind in ("velocity", "acceleration", "jerk"))


def table(file) -> np.ndarray:
    """Times and joint values of a written CSV."""
    rows = csv.reader(line for line in file.read_text().splitlines() if not line.startswith("#"))
    names = next(rows)
    joints = [k for k, name in enumerate(names) if name.endswith("_rad")]
    return np.array([[float(row[0]), *(float(row[k]) for k in joints)] for row in rows])


@pytest.mark.parametrize("feed", ["20mm/s", "0.2m/s"])
def test_no_limit_is_exceeded_by_finite_differences_of_the_written_file(plans, here, feed):
    assert main(["program", str(plans / "good"), "--feed", feed, "--out", "weld.csv"]) == 0
    rows, limits = table(here / "weld.csv"), joint_limits(gp50())
    np.testing.assert_allclose(np.diff(rows[:, 0]), STEP_S, atol=1e-9)
    for order, limit in enumerate(limits, 1):
        rates = np.diff(rows[:, 1:], n=order, axis=0) / STEP_S**order
        assert (np.abs(rates) <= (1 + ROUNDING) * limit).all()


def test_limits_of_the_job_are_kept_and_cost_time(plans, here, capsys):
    slow = [0.2, 0.2, 0.2, 0.2, 0.2, 0.2]
    durations = []
    for words in ((), ("--set", f"program.velocity={slow}")):
        assert run(plans, "--out", "weld.csv", "--json", *words) == 0
        durations.append(json.loads(capsys.readouterr().out)["duration_s"])
    rates = np.diff(table(here / "weld.csv")[:, 1:], axis=0) / STEP_S
    assert np.abs(rates).max() <= 0.2 * (1 + ROUNDING) and durations[1] > durations[0]


def test_the_motion_is_clear_by_mujoco_every_millisecond_and_the_tool_within_its_tolerance(plans):
    made = program_of(open_plans(plans / "good"), 0.02)
    found = check_timed(plans / "good", made.program.timed(STEP_S), "beam")
    assert found.refuted == 0 and found.clearance_min_m > 0
    assert 0 < found.off_max_m <= made.job.settings.tube_m


def test_a_motion_that_leaves_its_path_or_goes_through_the_wall_is_refuted(plans):
    made = program_of(open_plans(plans / "good"), 0.02, retract=False)
    timed = made.program.timed(0.02)
    aside = timed._replace(x=timed.x + np.array([0.005, 0, 0, 0, 0, 0]))  # at a metre and a half: 7 mm
    found = check_timed(plans / "good", aside, "beam")
    assert found.leaves[timed.kind == Kind.PROCESS].all() and not found.leaves[timed.kind != Kind.PROCESS].any()
    down = timed._replace(x=timed.x + np.array([0, 0.3, 0, 0, 0, 0]))
    assert check_timed(plans / "good", down, "beam").touches.any()


def changed(plans, folder, **sections) -> Path:
    """A copy of the plan with other sections in the recorded job."""
    shutil.copytree(plans / "good", folder)
    record = json.loads((folder / SUMMARY).read_text())
    for name, section in sections.items():
        record["config"][name] = {**record["config"][name], **section} if isinstance(section, dict) else section
    write_json(folder / SUMMARY, record)
    return folder


def tool_axis(plans) -> list[float]:
    """Direction of the tool where the weld begins."""
    x = open_plans(plans / "good").plans("beam").x[0, -3]
    return np.asarray(_POSE(gp50(), jnp.asarray(x)))[:3, 2].tolist()


OFF = [
    {"point": "link4", "on": "plane", "through_m": [9, 0, 0], "normal": [1, 0, 0]},
    {"point": "link4", "on": "line", "through_m": [9, 0, 0], "direction": [0, 1, 0], "within_m": 1},
    {"point": "link4", "on": [9, 0, 0], "axes": "xz"},
    {"point": "tcp", "on": [9, 0, 0]},
    {"point": "tcp", "on": "path", "axes": "z", "offset_m": [0, 0, 0.1]},
    {"axis": "tcp.x", "towards": [0, 0, 1], "cone_deg": 5},
    {"axis": "tcp.z", "looks_at_m": [0, 0, 0], "cone_deg": 5},
    {"axis": "tcp.z", "looks_at_m": [0, 0, 0]},
    {"orientation": [1, 0, 0, 0]},
    {"orientation": [1, 0, 0, 0], "within_deg": 5},
]


@pytest.mark.parametrize("row", OFF, ids=lambda row: " ".join(map(str, row.values())))
def test_every_kind_of_row_is_looked_at_every_millisecond_of_the_path(plans, here, row):
    """Check of every kind of row at each sample on the path.

    A plan of the TCP alone, with a recorded row that it violates.
    """
    timed = program_of(open_plans(plans / "good"), 0.02, retract=False).program.timed(0.02)
    folder = changed(plans, here / "other", task=[{"point": "tcp", "on": "path"}, row])
    found = check_timed(folder, timed, "beam")
    np.testing.assert_array_equal(found.breaks, timed.kind == Kind.PROCESS)
    assert found.refuted == found.breaks.sum() > 0


def test_rows_that_hold_are_not_refuted(plans, here):
    timed = program_of(open_plans(plans / "good"), 0.02, retract=False).program.timed(0.02)
    tool = tool_axis(plans)
    task = [{"point": "tcp", "on": "path"}, {"axis": "tcp.z", "towards": tool, "cone_deg": 20}]
    task.append({"point": "tcp", "on": "path", "axes": "xz", "within_m": 0.002})
    assert check_timed(changed(plans, here / "other", task=task), timed, "beam").refuted == 0


def test_a_tool_that_goes_back_along_its_path_is_refuted(plans):
    timed = program_of(open_plans(plans / "good"), 0.02, retract=False).program.timed(STEP_S)
    feeding = np.flatnonzero(timed.kind == Kind.PROCESS)
    x, target = timed.x.copy(), timed.target.copy()
    part = feeding[100:200]
    x[part], target[part] = x[part[::-1]], target[part[::-1]]
    found = check_timed(plans / "good", timed._replace(x=x, target=target), "beam")
    assert found.turns_back[part[1:]].all() and not found.leaves.any()
    assert not found.turns_back[: part[0]].any() and found.turns_back.sum() <= 101


def test_a_bare_tip_that_passes_through_a_wall_is_refuted_where_the_job_guards_it(plans, here):
    """A bare tip in a wall: refuted if the job guards the tip; the bodies stay clear."""
    timed = program_of(open_plans(plans / "good"), 0.02, retract=False).program.timed(0.02)
    on = timed._replace(x=timed.x + np.array([0, 0.04, 0, 0, 0, 0]))
    free = check_timed(plans / "good", on, "beam")
    guarded = check_timed(changed(plans, here / "other", workpiece={"tip_contact_m": 0.01}), on, "beam")
    assert guarded.clearance_min_m == free.clearance_min_m > 0
    assert not free.touches.any() and guarded.touches.any() and not guarded.touches[0]


def test_an_arm_that_respects_itself_is_rounded_by_half_for_two_bodies_may_move_towards_each_other(plans, here):
    """Corner rounding with self-collision: half as wide, as two bodies may move towards each other.

    The recorded clearance is made small, so that corners are as wide as it allows.
    """
    little, farthest = 2e-4, []
    for is_checked in (False, True):
        folder = changed(plans, here / str(is_checked), cell={"self_collision": is_checked})
        with np.load(folder / TRAJECTORY) as file:
            arrays = dict(file)
        arrays["segment_clearance"] = np.full_like(arrays["segment_clearance"], little)
        np.savez(folder / TRAJECTORY, **arrays)
        made = program_of(open_plans(folder), 0.02, retract=False)
        farthest.append(max(from_polyline(each.curve) for each in made.program.blends))
    assert 0.25 * little < farthest[0] <= 0.5 * little
    assert 0.125 * little < farthest[1] <= 0.25 * little


def from_polyline(curve) -> float:
    """Largest distance of any body's end from the straight joint paths between the curve's via points [m]."""
    u = curve.grid(9, 3)
    straight = np.stack([np.interp(u, curve.u, joint) for joint in curve.x.T], axis=1)
    rounded, straight = (arms_at(gp50(), x) for x in (curve.at(u).x, straight))
    ends = [(rounded.p, straight.p), (rounded.q, straight.q)]
    return max(float(np.linalg.norm(a - b, axis=2).max()) for a, b in ends)


def test_check_looks_at_all_of_it_by_mujoco_and_says_what_it_found(plans, here, capsys):
    assert run(plans, "--check", "--json", "--out", "weld.csv") == 0
    found = json.loads(capsys.readouterr().out)["check"]
    assert found["configurations"] == len(table(here / "weld.csv")) and found["refuted"] == 0
    assert found["clearance_min_mm"] > 0 and 0 < found["off_max_mm"] <= 1


def written(plans, out, format: str, *words: str) -> bytes:
    """File of the good plan in a format, written into the folder `out`, which must not exist."""
    out.mkdir()
    own = ["--format", format, "--set", "program.user_frame={number: 3}", "--set", PULSES]
    assert run(plans, *own, *words, "--out", str(out / "weld.txt")) == 0
    return (out / "weld.txt").read_bytes()


@pytest.fixture(scope="module")
def usual(plans, tmp_path_factory):
    """Function of a format: its file with the default number of points, written once."""
    return cache(lambda format: written(plans, tmp_path_factory.mktemp("usual") / "out", format))


@pytest.mark.parametrize("format", FORMATS)
def test_every_format_is_written_from_a_plan_on_record_the_same_twice(plans, usual, here, format):
    again = written(plans, here / "again", format)
    assert again == usual(format) and "tool data" in again.decode().replace("\r\n'", " ")


def test_a_job_of_pulses_passes_the_configurations_of_the_motion_on_record(plans, here):
    assert run(plans, "--format", "jbi-pulses", "--set", PULSES, "--one-way", "--out", "weld.jbi") == 0
    lines = [line for line in (here / "weld.jbi").read_text().splitlines() if line.startswith("C0")]
    pulses = np.array([[int(cell) for cell in line.split("=")[1].split(",")] for line in lines])
    x = pulses / PER_RAD + np.array(ZERO_RAD)
    known = open_plans(plans / "good").plans("beam")
    passed = np.concatenate([known.start[:1], known.x[0]])
    nearest = np.abs(x[:, None] - passed).max(axis=2).min(axis=1)
    assert len(x) >= 13 and nearest.max() <= 0.5 / 3e4


PROCESS = ["--set", "program.process={on: {5: true}, off: {5: false}}"]


@pytest.mark.parametrize(
    ("format", "output", "move"),
    [
        ("krl", "$OUT[5]=TRUE $OUT[5]=FALSE", "PTP"),
        ("ls", "DO[5]=ON DO[5]=OFF", "J P["),
        ("rapid", "SetDO do5,1; SetDO do5,0;", "MoveAbsJ"),
        ("jbi-pulses", "DOUT OT#(5) ON DOUT OT#(5) OFF", "MOVJ"),
    ],
)
def test_a_program_with_outputs_is_proven_and_reads_back_to_the_motion(plans, here, capsys, format, output, move):
    assert run(plans, "--format", format, *PROCESS, "--set", PULSES, "--out", "weld.out", "--json") == 0
    assert json.loads(capsys.readouterr().out)["proof"]["verdict"] == "proven"
    made = program_of(open_plans(plans / "good"), 0.02, overrides=[PULSES])
    own = made.program.at_configurations()
    found = read_motion(here / "weld.out", made.robot, controller_of(made.job, made.robot), format=format)
    assert np.abs(found.x - own.x).max() < 2e-5
    lines = [line.strip() for line in (here / "weld.out").read_text().splitlines()]
    on, off = ([k for k, line in enumerate(lines) if each in line] for each in _halves(output))
    moves = [k for k, line in enumerate(lines) if re.sub(r"^\d+:", "", line).startswith(move)]
    process = np.flatnonzero(own.kind == Kind.PROCESS)
    (begin, end), (start,) = off, on  # off before any motion, too
    assert [sum(k < at for k in moves) for at in (begin, start, end)] == [0, process[0], process[-1] + 1]


def _halves(text: str) -> tuple[str, str]:
    words = text.split()
    return " ".join(words[: len(words) // 2]), " ".join(words[len(words) // 2 :])


def test_formats_without_outputs_refuse_them_in_one_line(plans, here, capsys):
    for format in ("csv", "ros", "ros-json", "keyframes"):
        assert run(plans, "--format", format, *PROCESS, "--out", "weld.out") == 2
        line = capsys.readouterr().err
        assert f"{format} has no outputs, which program.process sets; omit the key, or use jbi, jbi-pulses" in line
        assert line.count("\n") == 1 and not list(here.glob("weld*"))


def proven_ls(made):
    """LS files of a program, and their proof."""
    motion = made.in_file("ls")
    return prove_with_exact_corners(made, "ls", "WELD", motion, made.files("ls", "WELD", motion))


def test_rounded_corners_that_leave_less_than_half_of_the_margin_become_exact(plans):
    made = program_of(open_plans(plans / "good"), 0.02)
    strict = made._replace(job=made.job.model_copy(update={"margin_m": 0.1}))
    (usual,), _ = proven_ls(made)
    (file,), found = proven_ls(strict)
    rounded = np.flatnonzero((found.motion.corner_share > 0).any(axis=1))
    assert found.proof.proven and file.text.count("CNT") < usual.text.count("CNT")
    assert (found.proof.clearance_m[rounded - 1] >= 0.05).all()


def test_the_proof_of_a_program_says_what_it_does(plans):
    made, steps = program_of(open_plans(plans / "good"), 0.02), []
    motion = made.in_file("ls")
    _, found = prove_with_exact_corners(
        made, "ls", "WELD", motion, made.files("ls", "WELD", motion), progress=steps.append
    )
    proving = [step for step in steps if step.startswith("proving the file's motion: ")]
    assert steps[0] == "reading the file back" and "building the scene of the proof" in steps
    first, last = (proving[k].split(": ")[1].split() for k in (0, -1))  # "0 of 120 paths"
    assert first[0] == "0" and last[0] == last[2] == first[2] and int(last[2]) >= len(found.proof.verdict)


def test_a_rapid_program_writes_the_jobs_coupled_axis_as_a_sum_and_the_tcp_of_its_arm(plans, here):
    coupled = "program.coupled={joint3: joint2}"
    for name, words in (("model", ()), ("sums", ("--set", coupled, "--set", "program.tool_name=torch"))):
        assert run(plans, "--format", "rapid", *words, "--out", f"{name}.mod") == 0
    said = (here / "sums.mod").read_text()
    model, sums = (
        np.array([row.split(",") for row in re.findall(r"MoveAbsJ \[\[(.*?)\]", text)], float)
        for text in ((here / "model.mod").read_text(), said)
    )
    assert (np.delete(sums, 2, axis=1) == np.delete(model, 2, axis=1)).all()
    assert np.abs(sums[:, 2] - model[:, 2] - model[:, 1]).max() <= 1.5e-6 + 1e-12
    assert "joint3 is written as its sum with joint2." in said
    assert "in the frame of joint6; torch must have it" in said


def test_rectan_positions_are_the_tcp_by_mujoco_in_the_workpiece(plans, here):
    words = ["--format", "jbi", "--set", "program.user_frame={number: 3}", "--one-way", "--out", "weld.jbi"]
    assert run(plans, *words) == 0
    lines = [line for line in (here / "weld.jbi").read_text().splitlines() if line.startswith("C0")]
    last = np.array([float(cell) for cell in lines[-1].split("=")[1].split(",")])
    target = np.array([float(cell) for cell in WELD.splitlines()[-1].split(",")])  # in the workpiece's frame
    assert np.linalg.norm(last[:3] / 1e3 - target) <= 1e-3


WRONG = [
    (["--set", "margin_m=0"], "--set margin_m: the plan is saved; only keys of program.* can be changed"),
    (["--set", "program.velocty=1"], "unknown key program.velocty; did you mean program.velocity?"),
    (["--set", "program.velocity=[1, 2]"], "program.velocity has 2 values, but the robot gp50 has 6 joints"),
    (["--set", "program.velocity=[1, 1, 1, 1, 1, 0]"], "program.velocity.5 is 0"),
    (["--set", "program.jerk=fast"], "program.jerk is 'fast'"),
    (["--set", "program.full_speed_s=0"], "program.full_speed_s is 0"),
    (["--format", "jbi"], "jbi: the user frame of RECTAN positions is missing; set program.user_frame"),
    (["--format", "jbi", "--set", "program.user_frame={number: 64}"], "program.user_frame.number is 64"),
    (["--format", "jbi-pulses"], "jbi-pulses: the encoder scale is missing; set program.pulses"),
    (["--format", "jbi-pulses", "--set", "program.pulses={per_rad: [1, 2]}"], "program.pulses.source"),
    (
        ["--format", "jbi-pulses", "--set", "program.pulses={per_rad: [1, 2], source: x}"],
        "program.pulses.per_rad has 2 values, but the robot gp50 has 6 joints",
    ),
    (
        ["--format", "rapid", "--set", "program.coupled={joint3: joint7}"],
        "program.coupled: 'joint7' is not a joint; valid: joint1, joint2",
    ),
    (["--format", "rapid", "--set", "program.coupled={joint3: joint3}"], "'joint3' is coupled with itself"),
    (
        ["--format", "rapid", "--set", "program.coupled={joint3: joint2, joint2: joint4, joint4: joint3}"],
        "program.coupled: a circle: joint3 -> joint2 -> joint4 -> joint3; valid: for each coupled axis",
    ),
    (["--format", "rapid", "--set", "program.coupled=[[joint3, joint2], [joint3, joint1]]"], "'joint3' is given twice"),
    (["--format", "rapid", "--set", "program.tool_name=''"], "program.tool_name is ''"),
    (["--feed", "1e-6mm/s"], "more than 86,400 s: the feed is 1e-06 mm/s; choose a higher feed"),
    *(
        (["--set", f"program.{kind}={[1e-9] * 6}"], f" is 1e-09 {unit}; raise it, for example by program.{kind}")
        for kind, unit in (("velocity", "rad/s"), ("acceleration", "rad/s2"), ("jerk", "rad/s3"))
    ),
    (
        ["--set", f"program.acceleration={[1e9] * 6}", "--set", f"program.jerk={[1.0] * 6}"],
        "the motion takes 1e+09 s, more than 86,400 s: the jerk limit of joint1 is 1 rad/s3",
    ),
    (
        ["--set", f"program.velocity={[1e-3] * 6}", "--step-ms", "0.1"],
        "choose a larger --step-ms, or program.control_step_s",
    ),
    (
        ["--set", "program.control_step_s=1e-9", "--format", "urscript"],
        "program.control_step_s is 1e-09: at least 0.0001 is needed",
    ),
    (["--format", "urscript", "--set", "program.coupled={joint3: joint2}"], "does not support program.coupled; remove"),
    (
        ["--format", "rapid", "--set", "program.coupled=joint3"],
        "'joint3' must be a mapping of axes to joints: {AXIS: JOINT",
    ),
    (["--format", "jbi-pulses", "--step-ms", "2"], "jbi-pulses contains only the configurations of the motion; omit"),
    (["--format", "urscript", "--step-ms", "3"], "times must be multiples of the controller's 0.002 s"),
    (["--step-ms", "0"], "--step-ms is 0.0; valid: 0.1 to 1000"),
    (["--max-points", "100", "--step-ms", "5"], "--max-points chooses the times of the configurations; omit --step-ms"),
    (["--max-points", "2"], "the program begins, ends and stops at 4 configurations, so at least 4 are needed"),
    (["--scenario", "1"], "has no scenario 1; valid: 0 to 0"),
    (["--method", "hybrid"], "has no plans by 'hybrid'; valid: beam"),
]


@pytest.mark.parametrize(("words", "says"), WRONG)
def test_what_is_wrong_is_one_line_that_names_it_exit_2_and_no_file(plans, here, capsys, words, says):
    assert run(plans, *words, "--out", "weld.txt") == 2
    output = capsys.readouterr()
    assert says in output.err and output.err.count("\n") == 1 and output.out == ""
    assert not list(here.iterdir())


def test_a_plan_that_is_not_executable_says_how_far_it_is(plans, here, capsys):
    assert main(["program", str(plans / "bad"), "--feed", "20mm/s", "--out", "weld.csv"]) == 2
    assert "the motion leads to only 0 of 10 targets" in capsys.readouterr().err and not list(here.iterdir())


@pytest.mark.parametrize("self_collision", [False, True])
def test_the_check_says_of_every_configuration_what_measuring_each_says(plans, here, self_collision):
    """Clearances and contacts of the check, equal to those measured at each sample.

    Most samples are decided by how far the arm has moved; some motions swing into the part and out of the limits.
    """
    folder = changed(plans, here / "other", cell={"self_collision": self_collision})
    timed = program_of(open_plans(folder), 0.05).program.timed(2e-3)
    swing = np.sin(np.linspace(0, 6 * np.pi, len(timed.x)))[:, None] * np.array([0.5, 0.2, 0.3, 0.4, 1.5, 0.5])
    results = read_results(folder)
    (track,) = results.tracks
    scene = scene_of(results, *LoadedParts(results).of(track), track)[0]
    touched = []
    for share in (0.0, 0.02, 1.0):
        moved = timed._replace(x=timed.x + share * swing)
        found, each = check_timed(folder, moved, "beam"), scene.at(moved.x).clearance
        assert found.clearance_min_m == pytest.approx(each.min(), abs=1e-12)
        np.testing.assert_array_equal(found.touches, each <= 0)
        touched.append(int(found.touches.sum()))
    assert touched[0] == 0 < touched[2] < len(timed.x)


def rows_of(file) -> int:
    """Number of configurations in a ROS message."""
    return file.read_text().count("- positions:")


def test_the_deviation_of_a_file_is_stated_and_that_of_default_steps_is_small(plans, here, capsys):
    """The deviation in the table and in JSON; files are those that the motion alone gives."""
    assert run(plans, "--out", "weld.csv", "--json") == 0
    record = json.loads(capsys.readouterr().out)
    assert record["configurations"] == len(table(here / "weld.csv")) and record["path_tolerance_mm"] == 1
    assert set(record["deviations"]) == {"linear", "quintic"}
    assert all(0 < each["path_mm"] <= each["tcp_mm"] < 0.01 for each in record["deviations"].values())
    assert record["files"] == [{"file": "weld.csv", "first": 0, "configurations": record["configurations"]}]
    assert run(plans, "--out", "weld.mod", "--format", "rapid") == 0
    lines = capsys.readouterr().out.splitlines()
    (deviation,) = [line for line in lines if line.startswith("deviation ")]
    assert re.search(
        r"mm of the TCP at [\d.]+ s, [\d.e-]+ mm on the path; [\d.e-]+ rad of joint\d; joined on the", deviation
    )


def test_a_file_too_far_from_the_path_is_refused_with_a_number_of_points_that_do(plans, here, capsys):
    """A coarse file (regression: written without a word), and more points at the places of fewer_points."""
    name = ["--format", "ros", "--out", "weld.yaml"]
    assert run(plans, *name, "--step-ms", "1000") == 2
    line = capsys.readouterr().err
    found = re.search(
        r"by (\S+) mm on the path at \S+ s; .* is 1 mm; pass --max-points (\d+) or more, or --allow", line
    )
    assert float(found[1]) > 1 and line.count("\n") == 1 and not list(here.iterdir())
    assert run(plans, *name, "--step-ms", "1000", "--allow-deviation", "--json") == 0
    output = capsys.readouterr()
    assert "the file deviates from the program by" in output.err and output.err.count("\n") == 1
    on_path = max(each["path_mm"] for each in json.loads(output.out)["deviations"].values())
    assert on_path == pytest.approx(float(found[1]), rel=5e-3)
    assert run(plans, *name, "--max-points", found[2], "--json") == 0
    record = json.loads(capsys.readouterr().out)
    assert rows_of(here / "weld.yaml") == record["configurations"] <= int(found[2])
    assert max(each["path_mm"] for each in record["deviations"].values()) <= 1


def test_no_more_rows_are_written_than_the_tolerance_requires_if_the_fewest_are_requested(plans, here, capsys):
    name = ["--format", "ros", "--out", "weld.yaml", "--json"]
    assert run(plans, *name, "--max-points", "fewest") == 0
    record = json.loads(capsys.readouterr().out)
    assert max(each["path_mm"] for each in record["deviations"].values()) <= record["path_tolerance_mm"]
    made = program_of(open_plans(plans / "good"), 0.02)
    assert rows_of(here / "weld.yaml") == record["configurations"] < len(made.timed("ros").x)
    tolerance_m = 1e-4
    job = made.job.model_copy(update={"settings": replace(made.job.settings, path_tolerance_m=tolerance_m)})
    fewest = file_motion(made.robot, made.program, job, "csv", max_points="fewest")
    fewer = file_motion(made.robot, made.program, job, "csv", max_points=len(fewest.timed.x) - 1)
    least, most = (worst_deviation(deviations(made.robot, made.program, file)).path_m for file in (fewest, fewer))
    assert least <= tolerance_m < most
    assert run(plans, *name, "--max-points", "few") == 2
    assert "--max-points is 'few'; valid: a whole number, at least 2, or fewest" in capsys.readouterr().err


def test_a_deviation_off_the_path_is_a_warning_if_the_user_chose_the_number_of_points(plans, here, capsys):
    assert run(plans, "--out", "weld.csv", "--max-points", "6", "--json") == 0
    output = capsys.readouterr()
    found = json.loads(output.out)["deviations"]["linear"]
    assert found["path_mm"] < 1 < found["tcp_mm"] and "the file deviates from the program by" in output.err


@pytest.mark.parametrize("format", FORMATS)
def test_every_format_has_at_most_the_number_of_points_and_the_same_file_if_it_has_no_more_anyway(
    plans, usual, here, format
):
    made = program_of(open_plans(plans / "good"), 0.02)
    own = len(made.timed(format).x)
    few = made.timed(format, max_points=10)
    assert len(few.x) <= 10 < own and few.time_s[-1] == pytest.approx(made.program.duration_s, abs=0.002)
    every, fewer = (
        written(plans, here / str(most), format, "--allow-deviation", "--max-points", str(most))
        for most in (own + 1, 10)
    )
    assert every == usual(format) and len(fewer) < len(every)


def test_the_check_of_a_coarse_file_follows_the_file(plans, here, capsys):
    """A file whose motion leaves the path (regression: the program's motion was checked instead)."""
    words = ["--format", "ros", "--step-ms", "1000", "--allow-deviation", "--check", "--json", "--out", "weld.yaml"]
    assert run(plans, *words) == 1
    record = json.loads(capsys.readouterr().out)
    assert record["check"]["refuted"] > 0 and record["check"]["off_max_mm"] > 1


def test_a_script_longer_than_those_that_are_known_to_start_is_a_note(plans, here, capsys):
    assert run(plans, "--format", "urscript", "--out", "weld.script") == 0
    err = capsys.readouterr().err
    assert "note: the file has" in err and "1,000 (reported of a UR10)" in err and err.count("\n") == 1
    assert run(plans, "--format", "urscript", "--max-points", "50", "--out", "weld.script") == 0
    assert "note" not in capsys.readouterr().err


def test_a_program_of_several_files_is_written_next_to_its_main_file_and_its_parts_are_listed(
    plans, here, capsys, monkeypatch
):
    monkeypatch.setattr(as_jbi, "MOST_LINES", 40)
    words = ["--format", "jbi-pulses", "--set", PULSES, "--out", "weld.jbi"]
    assert run(plans, *words, "--json") == 0
    output = capsys.readouterr()
    files = json.loads(output.out)["files"]
    assert [each["file"] for each in files] == ["weld.jbi", *(f"weld-{k}.jbi" for k in range(1, len(files)))]
    assert sum(each["configurations"] for each in files) == json.loads(output.out)["configurations"]
    assert sorted(each["file"] for each in files) == sorted(path.name for path in here.iterdir())
    assert f"it calls {len(files) - 1} parts" in output.err and output.err.count("\n") == 1
    assert run(plans, *words) == 0
    assert "weld-1.jbi" in (said := capsys.readouterr().out) and "configurations 0 to " in said


@pytest.mark.parametrize("effort", [1, 1e3])
def test_an_effort_beyond_its_limit_is_a_warning_and_exit_3_unless_it_is_allowed(here, capsys, effort):
    """Effort beyond its limit: a warning and exit code 3, unless it is allowed (regression: exit code 0)."""
    toy.write_job(here, 3, shift_m=(0.4, 0.02, -0.03), method="baseline", program={"velocity": [1.0] * 4})
    mass = r'\g<0><inertial pos="0 0 0.1" mass="\1" diaginertia="0.1 0.1 0.1"/>'
    arm = re.sub(r'<joint name="j(\d)".*?/>', mass, toy.ARM)
    limit = f'name="j2" actuatorfrcrange="{-effort} {effort}"'
    (here / "arm.xml").write_text(arm.replace('name="j2"', limit))
    assert main(["plan", "job.yaml", "--out", "plan"]) == 0
    for flags, code in (([], 3), (["--allow-effort"], 0)):
        capsys.readouterr()
        assert main(["program", "plan", "--feed", "20mm/s", "--out", "a.csv", *flags]) == (code if effort == 1 else 0)
        err = capsys.readouterr().err
        assert (here / "a.csv").exists() and err.count("\n") == (effort == 1)
        assert effort > 1 or ("of the effort limit" in err and "j2" in err)
        (here / "a.csv").unlink()
