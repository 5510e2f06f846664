"""Validation: correct plans pass, wrong ones are refuted and named, and no point is left unmeasured."""

import json
import re
import shutil
import time
from pathlib import Path

import jax.numpy as jnp
import made_once
import numpy as np
import pytest
import toy
import yaml
from hand_made import plans_with
from small_run import LONGER, TOY_TARGETS, spoil, toy_run

from htcp_jax.clearance.obstacles.tip_guard import make_tip_guard
from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.io.parts.workpiece_source import GeneratedDuct, load_workpiece, read_source
from htcp_jax.io.robots.loading import gp50, load_robot
from htcp_jax.jobs import load_config
from htcp_jax.jobs.build import robot_of, workpiece_key, workpiece_of
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.model import Robot
from htcp_jax.model.duct import POINTS
from htcp_jax.model.robot import lengthen_tool
from htcp_jax.report import make_report
from htcp_jax.report.document import markdown
from htcp_jax.report.validation import notes, read_validation, validated, verdict
from htcp_jax.runs import open_run
from htcp_jax.runs.plan_folder import VALIDATION
from htcp_jax.runs.sweep import keep_plans, sweep
from htcp_jax.spec import GP50, SEAMS
from htcp_jax.status import SegmentStatus, Status
from htcp_jax.validation import STEP_RAD, track, validate_results
from htcp_jax.validation.mujoco_arm import MujocoArm
from htcp_jax.validation.mujoco_clearance import CheckedScene, Wall, wall_of
from htcp_jax.validation.records import data_of
from htcp_jax.validation.track import samples_between

PIPE = Path(__file__).parents[1] / "configs" / "pipe" / "job.yaml"


@pytest.fixture
def real(planned, tmp_path):
    """Copy of the small real run that a test may change."""
    return shutil.copytree(planned / "run", tmp_path / "run")


@pytest.fixture
def run(tmp_path):
    """Copy of the toy's run that a test may change."""
    return shutil.copytree(toy_run() / "run", tmp_path / "run")


def mesh_job(folder: Path, **cell) -> Path:
    """Job of the toy arm under a shelf of two triangles."""
    job = toy.write_job(folder, 3, shift_m=(0.4, 0.02, -0.03), cell={"self_collision": False} | cell)
    corners = [(x, y, toy.SHELF_M) for x, y in ((0.42, -0.2), (0.8, -0.2), (0.8, 0.2), (0.42, 0.2))]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["f 1 2 3", "f 1 3 4"]
    (folder / "shelf.obj").write_text("\n".join(lines) + "\n")
    raw = yaml.safe_load(job.read_text())
    raw["workpiece"] |= {"cloud": "shelf.obj", "mesh_spacing_m": 0.02}
    job.write_text(yaml.safe_dump(raw))
    return job


def scene(extension_m: float, rotation_y_rad: float, points: int = POINTS) -> CheckedScene:
    """Scene of a scenario of the run, posed by workpiece.py; optionally with a smaller cloud."""
    part = load_workpiece(GeneratedDuct(points=points))
    T = part.T_world(rotation_y_rad, 0.1)
    wall = Wall(np.asarray(part.cloud), "hull")
    return CheckedScene(MujocoArm(GP50, extension_m, "simulation"), wall, T[:3, :3], T[:3, 3], part.interior_depth_m)


def clearance(where: CheckedScene, x: np.ndarray) -> float:
    return where.at(x[None]).clearance[0]


def into_the_wall(where: CheckedScene, x: np.ndarray, depth_m: float) -> np.ndarray:
    """Move a configuration down the gradient of its clearance until it is that deep in the wall."""
    for _ in range(100):
        now = clearance(where, x)
        if abs(now + depth_m) < 1e-5:
            return x
        slope = np.array([clearance(where, x + 1e-6 * e) - now for e in np.eye(6)]) / 1e-6
        x = x - slope * min(now + depth_m, 1e-3) / (slope @ slope)
    raise AssertionError("the wall is out of reach")


def inside(planned, spread_rad: float, count: int) -> np.ndarray:
    """Random configurations about one that is deep in the duct."""
    x = open_run(planned / "run").plans("baseline").x[0]
    last = x[np.isfinite(x).all(axis=1)][-1]
    return last + np.random.default_rng(2).uniform(-spread_rad, spread_rad, (count, 6))


def test_a_run_validates(real, capsys):
    assert main(["validate", str(real)]) == 0
    printed = capsys.readouterr().out
    assert "validated" in printed and "minimum clearance" in printed and "Deepest overlap" not in printed
    assert len(printed.splitlines()) <= 8
    found = json.loads((real / VALIDATION).read_text())
    one = found["methods"]["baseline"]
    assert found["validated"] and one["refuted"] == 0
    assert one["checked"] == sum(open_run(real).scenarios("baseline")["tracked"].to_pylist()) > 60
    assert 0 < one["clearance_min_mm"] and one["tcp_error_max_mm"] <= 1
    assert max(one[f"{name}_off_max_mm"] for name in ("clearance", "tcp", "target")) < 1e-9
    assert one["paths_touching"] == one["paths_blocked"]
    assert one["clearance_between_min_mm"] <= one["clearance_min_mm"]
    scenario, target = one["clearance_min_at"]
    recorded = open_run(real).plans("baseline").clearance
    assert recorded[scenario, target] == np.nanmin(recorded)
    assert validated(read_validation(open_run(real))) is True


def test_the_report_says_that_a_run_is_validated(run):
    assert main(["validate", str(run)]) == 0
    found = json.loads((run / VALIDATION).read_text())
    text = markdown(make_report([run]).blocks)
    checked, paths, touching = (
        sum(check[name] for check in found["methods"].values()) for name in ("checked", "paths", "paths_touching")
    )
    reported = (
        f"Validated: MuJoCo refutes none of {checked} tracked targets; {touching} of the {paths} joint paths between"
    )
    assert "## Validation" in text and reported in text


def test_a_mesh_has_both_distances_and_a_long_check_is_announced(tmp_path, monkeypatch, capsys):
    """Both distances to a mesh, and an announcement of long checks (regression: only one distance)."""
    job, run = mesh_job(tmp_path), tmp_path / "run"
    sweep({"grid": [{"workpiece.rotation_y_rad": [0.0, 0.1]}]}, ["baseline"], run, config=job)
    monkeypatch.setattr(time, "perf_counter", lambda clock=time.perf_counter: 1e6 * clock())  # as on a slow machine
    assert main(["validate", str(run), "--between", "0", "--verbose"]) == 0
    output = capsys.readouterr()
    assert "less cover" in output.out and re.match(r"about [\d,]+ s for 2 plans", output.err)
    one = json.loads((run / VALIDATION).read_text())["methods"]["baseline"]
    cover = 1e3 * workpiece_of(workpiece_key(load_config(job)), robot_of(load_config(job).robot)).covering_radius_m
    recorded = 1e3 * np.nanmin(open_run(run).plans("baseline").clearance)
    np.testing.assert_allclose(one["clearance_less_cover_min_mm"], one["clearance_min_mm"] - cover)
    assert one["clearance_less_cover_min_mm"] <= recorded + 1e-6 < one["clearance_min_mm"]


def test_the_progress_within_one_plan_is_reported_and_does_not_change_its_result(run, monkeypatch):
    whole, shares = validate_results(run), []
    monkeypatch.setattr(track, "SAMPLES", 200)
    parts = validate_results(run, progress=lambda done, count: shares.append(done))
    assert any(0 < share < 1 for share in shares) and shares == sorted(shares)
    assert parts._replace(seconds=0.0) == whole._replace(seconds=0.0)


def test_the_cover_of_a_mesh_is_not_subtracted_from_distances_to_the_cell(tmp_path):
    """The arm is upright, and its tool ends 1 mm below a ceiling."""
    top = 0.3 + 0.4 + 0.4 + 0.16 + 0.02  # of the tool's capsule
    ceiling = tmp_path / "ceiling.xml"
    ceiling.write_text(
        f'<mujoco><worldbody><geom type="box" size="1 1 .01" pos="0 0 {top + 1e-3 + 0.01}"/></worldbody></mujoco>'
    )
    spec = load_sweep({"grid": [{"margin_m": [0.001]}]}, mesh_job(tmp_path, model=str(ceiling)))
    upright = plans_with([[Status.TRACKED] * TOY_TARGETS], joints=4)
    run = keep_plans(spec, {"baseline": upright}, tmp_path / "run").folder
    found = validate_results(run, between=0).methods["baseline"]
    np.testing.assert_allclose([found.clearance_min_mm, found.clearance_less_cover_min_mm], 1.0, atol=1e-3)


def test_the_wall_of_a_mesh_is_moved_by_the_origin_of_its_coordinates(tmp_path):
    job = load_config(str(mesh_job(tmp_path)))
    part = load_workpiece(read_source(job.workpiece.cloud), job.workpiece.path, origin=(0.1, 0.2, 0.3))
    wall = wall_of(job.workpiece, data_of(part))
    np.testing.assert_allclose(wall.corners.min(axis=0), np.array([0.42, -0.2, toy.SHELF_M]) - [0.1, 0.2, 0.3])


def test_a_report_does_not_call_other_results_validated_than_those_that_were(run):
    main(["validate", str(run), "--between", "0"])
    spoil(run, 0, 5, iterations=1)
    assert validated(
        read_validation(open_run(run))
    ) is None and "No validation of these results is stored in this run" in verdict(read_validation(open_run(run)))


def test_a_weaker_validation_never_replaces_a_stronger_one_of_the_same_results(run, capsys):
    """Saved validation: a weaker one never replaces a stronger one of the same results (regression)."""
    main(["validate", str(run), "--between", "2"])
    before = (run / VALIDATION).read_bytes()
    capsys.readouterr()
    assert main(["validate", str(run), "--between", "0", "--feed-mm-s", "50", "--json"]) == 0
    shown = capsys.readouterr()
    assert json.loads(shown.out)["between"] == 0 and (run / VALIDATION).read_bytes() == before
    assert (
        "validation.json is not overwritten: it validates the same results with more samples" in shown.err
        and shown.err.count("\n") == 1
    )
    assert main(["validate", str(run), "--between", "2", "--feed", "3m/min"]) == 0
    assert json.loads((run / VALIDATION).read_text())["feed_mm_s"] == 50  # as strong: the later one stays
    spoil(run, 0, 5, iterations=1)
    assert main(["validate", str(run), "--between", "0"]) == 0
    assert json.loads((run / VALIDATION).read_text())["between"] == 0  # of other results


def test_a_refutation_and_what_tells_more_replace_a_stronger_validation(run, capsys):
    main(["validate", str(run), "--between", "2"])
    strong = json.loads((run / VALIDATION).read_text())
    for other in (strong | {"validated": False}, {key: strong[key] for key in strong if key != "versions"}):
        (run / VALIDATION).write_text(json.dumps(other))
        assert main(["validate", str(run), "--between", "0"]) == 0
        assert json.loads((run / VALIDATION).read_text())["between"] == 0
    assert capsys.readouterr().err == ""


def test_a_damaged_validation_is_named(run):
    main(["validate", str(run), "--between", "0"])
    whole = json.loads((run / VALIDATION).read_text())
    for damaged in ({}, whole | {"methods": 3}, whole | {"refuted_count": None}, {k: whole[k] for k in ("files",)}):
        (run / VALIDATION).write_text(json.dumps(damaged))
        with pytest.raises(InputError, match=VALIDATION):
            validated(read_validation(open_run(run)))


def test_between_two_targets_no_joint_turns_far_from_one_look_to_the_next(planned):
    plans = open_run(planned / "run").plans("baseline")
    tracked = [x[good] for x, good in zip(plans.x, plans.tracked, strict=True)]
    a, b = (np.concatenate([x[part] for x in tracked]) for part in (slice(-1), slice(1, None)))
    path, x = samples_between(a, b, between=3)
    segments = [np.concatenate([a[[k]], x[path == k], b[[k]]]) for k in np.unique(path)]
    furthest = max(abs(np.diff(segment, axis=0)).max() for segment in segments)
    assert 0.8 * STEP_RAD < furthest <= STEP_RAD * (1 + 1e-9) and min(map(len, segments)) == 2 + 2


def test_the_tip_passes_through_the_discs_that_the_planner_places_in_its_own_way():
    part = load_workpiece(GeneratedDuct(points=3000), tip_contact_m=0.01)
    where = scene(0.0, 0.4, points=3000)
    nominal, rng = np.array([0.0, -2.3, 0.5, 0.0, 0.5, -2.0]), np.random.default_rng(0)
    arm_poses = where.arm.arm_poses(nominal + rng.uniform(-0.05, 0.05, (1000, 6)))
    where.translate = arm_poses.tcp[0] - where.rotate @ part.cloud[0]  # the wall lies at the TCP
    ends = (where.local(end) for end in (where.arm.tip_start(arm_poses), arm_poses.tcp))
    expected = make_tip_guard(part).passes(*ends)
    assert where.tip_crosses(arm_poses, 0.01).tolist() == expected.tolist() and 100 < expected.sum() < 900


@pytest.mark.parametrize("seam", SEAMS)
def test_normals_and_tangents_are_those_that_the_planner_computes_in_its_own_way(seam):
    part = load_workpiece(GeneratedDuct(points=5000, seam=seam))
    data = data_of(part)
    np.testing.assert_allclose(data.normals, part.normals, atol=1e-12)
    np.testing.assert_allclose(data.tangents, part.tangents, atol=1e-12)


@pytest.mark.parametrize("path", [
    [[0, 0, 0], [1, 0, 0], [1, 0, 0], [2, 1, 0], [1, 0, 0], [0, 0, 3]],
    [[0, 0, 0], [1e-3, 0, 0], [1e-3, 5e-6, 0], [2e-3, 0, 0], [3e-3, 0, 0], [3e-3, 5e-6, 0]],
    [[0, 0, 0], [0.1, 0, 0], [0.1, 7e-6, 0], [0.1, 14e-6, 0], [0.2, 0, 0]],
])  # fmt: skip
def test_tangents_of_a_path_that_pauses_and_reverses_are_the_planners(path):
    own = load_workpiece(GeneratedDuct(points=100), np.array(path, float))
    np.testing.assert_allclose(data_of(own).tangents, own.tangents, atol=1e-12)


def test_a_configuration_5_mm_in_the_wall_is_refuted_and_named(real, capsys):
    plans = open_run(real).plans("baseline")
    target = int(np.nanargmin(plans.clearance[3]))
    x = into_the_wall(scene(LONGER, 0.5), plans.x[3, target], 5e-3)
    spoil(real, 3, target, **{f"joint{j + 1}_rad": float(value) for j, value in enumerate(x)})
    assert main(["validate", str(real), "--between", "0"]) == 1
    label = f"rotation y 0.5 rad, tool extension {LONGER} m"
    assert f"baseline, scenario 3 ({label}), target {target}: " in capsys.readouterr().out
    found = json.loads((real / VALIDATION).read_text())
    (refuted,) = found["refuted"]
    assert not found["validated"] and "the arm is in collision: clearance -5.0" in refuted["reason"]


def test_a_recorded_clearance_that_is_1_mm_off_is_refuted(run):
    recorded = open_run(run).plans("baseline").clearance[1, 7]
    spoil(run, 1, 7, clearance_m=float(recorded + 1e-3))
    found = validate_results(run, between=0)
    (refuted,) = found.refuted
    assert (refuted.scenario, refuted.target) == (1, 7) and f"{1e3 * recorded + 1:.3f} mm was saved" in refuted.reason
    assert found.methods["baseline"].clearance_off_max_mm == pytest.approx(1.0)


def test_the_path_deviation_is_that_of_segments_with_a_proven_motion(run):
    before = validate_results(run).methods["baseline"]
    scenario, target = before.line_deviation_max_at
    spoil(run, scenario, target, segment_status=SegmentStatus.OFF_PATH.name)
    after = validate_results(run).methods["baseline"]
    assert after.line_deviation_max_at != (scenario, target)
    assert 0 < after.line_deviation_max_mm <= before.line_deviation_max_mm


def test_the_largest_tcp_error_is_printed_with_its_target_scenario_and_method(run, capsys):
    assert main(["validate", str(run)]) == 0
    checks = json.loads((run / VALIDATION).read_text())["methods"]
    method = max(checks, key=lambda name: checks[name]["tcp_error_max_mm"])
    scenario, target = checks[method]["tcp_error_max_at"]
    place = f"of each target (target {target} of scenario {scenario} by {method}), and, on proven segments, within"
    assert place in " ".join(capsys.readouterr().out.split())


def test_a_joint_beyond_its_limits_is_refuted_and_a_configuration_that_is_not_there_is_an_error(run):
    x = open_run(run).plans("baseline").x[0, 3]
    spoil(run, 0, 3, j4_rad=float(x[3] - 2 * np.pi))
    ((place, reason),) = {
        (one.scenario, one.target): one.reason for one in validate_results(run, between=0).refuted
    }.items()
    assert place == (0, 3) and "j4 is outside its limits" in reason
    spoil(run, 2, 4, j1_rad=None)
    with pytest.raises(InputError, match=r"j1_rad is missing or NaN in row 4 \(scenario 2, target 4\)"):
        validate_results(run, between=0)


@pytest.mark.parametrize("values", [([np.nan] * 4, [0.5]), ([0.0] * 4, [np.inf])])
def test_a_run_with_a_via_point_that_is_no_number_is_refused(run, values):
    spoil(run, 1, 7, **dict(zip(("via_points", "via_shares"), values, strict=True)))
    with pytest.raises(
        InputError, match=r"a value of via_\w+ is (missing or NaN|inf) in row \d+ \(scenario 1, target 7\)"
    ):
        validate_results(run, between=0)


@pytest.mark.parametrize("name", ["tcp_error", "clearance", "clearance_off", "tcp_off", "target_off"])
def test_a_figure_that_is_no_number_refutes_a_configuration(name):
    good = dict.fromkeys(("tcp_error", "clearance_off", "tcp_off", "target_off", "through"), 0.0) | {"clearance": 0.1}
    arm, x = MujocoArm(GP50), np.zeros(6)
    assert not track._failure_reasons(arm, 1e-3, 1e-6, x, 0.1, good)
    assert len(track._failure_reasons(arm, 1e-3, 1e-6, x, 0.1, good | {name: np.nan})) == 1


def test_a_longer_tool_is_the_planner_s():
    x = np.random.default_rng(1).uniform(-3, 3, (20, 6))
    for extension in (0.0, 0.05, -0.02):
        _assert_same_configurations(MujocoArm(GP50, extension), lengthen_tool(gp50(), extension), x)


def _assert_same_configurations(arm: MujocoArm, robot: Robot, x: np.ndarray) -> None:
    """Check both readings of the arm; MuJoCo has the ends of an axis in either order."""
    at = arm.arm_poses(x)
    p, q, tcp = map(np.asarray, made_once.ENDS(robot, jnp.asarray(x)))
    np.testing.assert_allclose(at.tcp, tcp, atol=1e-12)
    np.testing.assert_allclose(at.p + at.q, p + q, atol=1e-12)
    np.testing.assert_allclose(abs(at.p - at.q), abs(p - q), atol=1e-12)
    np.testing.assert_array_equal(arm.radius, robot.capsule_radius)


OWN = """
<mujoco>
  <worldbody>
    <body><joint type="slide" axis="1 0 0"/><geom size="0.1"/><geom type="box" size="0.1 0.1 0.1"/>
      <body pos="0 0 0.5"><joint axis="0 1 0"/><geom type="capsule" size="0.05" fromto="0 0 0 0.3 0 0.1"/>
        <body pos="0.4 0 0"><joint axis="0 0 1" pos="0.1 0 0"/>
          <geom size="0.03" pos="0.1 0.1 0"/><site name="tip" pos="0.2 0 0" euler="20 30 0"/></body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def test_models_of_one_s_own_are_read_as_the_planner_reads_them(tmp_path):
    """User-supplied models, read as by the planner: a slide, an ignored box, a site as TCP, a longer tool."""
    file = tmp_path / "own.xml"
    file.write_text(OWN)
    robot, x = load_robot(file, limits="simulation"), np.random.default_rng(4).uniform(-1, 1, (20, 3))
    arm = MujocoArm(file, 0.1, "simulation")
    np.testing.assert_array_equal([arm.lower, arm.upper, arm.speed], [robot.lower, robot.upper, robot.speed])
    _assert_same_configurations(arm, lengthen_tool(robot, 0.1), x)


def test_no_point_is_left_out_that_could_be_the_nearest(planned):
    """Nearest point, by brute force over every capsule and point, also for configurations deep in the wall."""
    where = scene(0.0, 0.4, points=400)
    x = inside(planned, 0.03, 25)
    points = where.wall.middle @ where.rotate.T + where.translate
    capsule, point = (index.ravel() for index in np.indices((8, 400)))
    brute = np.array([where.arm.distances(row, capsule, points[point]).min() for row in x])
    found = where.at(x)
    in_hull = ~(found.outside > 0).any(axis=1)
    assert (brute < -0.01).any() and (brute > 0).any() and 5 < in_hull.sum()
    np.testing.assert_allclose(found.clearance[in_hull], brute[in_hull], atol=1e-12)
    assert (found.clearance[~in_hull] < 0).all()


def test_between_two_configurations_nothing_below_the_bound_is_missed(planned):
    """Clearance between configurations: all below the bound, as measured at each step."""
    where = scene(0.0, 0.4, points=2000)
    ends = inside(planned, 0.02, 12)
    steps = np.arange(1, 10) / 10
    segment_status = (ends[:-1, None] + steps[None, :, None] * np.diff(ends, axis=0)[:, None]).reshape(-1, 6)
    _, found = where.between(segment_status, np.repeat(np.arange(11), 9), where.at(ends), 0.005)
    each = where.at(segment_status).clearance
    assert (each < 0).any() and (each > 0.005).any()
    np.testing.assert_allclose(found, np.where(each <= 0.005, each, np.inf), atol=1e-12)


ROUND = """
<mujoco>
  <worldbody>
    <body><joint axis="0 0 1"/><geom type="capsule" size="0.08" fromto="0 0 0 0 0 0.32"/>
      <body pos="0 0 0.32"><joint axis="0 1 0"/><geom type="capsule" size="0.06" fromto="0 0 0 0.6 0 0"/>
        <body pos="0.6 0 0"><joint axis="0 0 1"/><geom type="capsule" size="0.05" fromto="0 0 0 0.3 0 0"/>
          <site name="tip" pos="0.35 0 0"/></body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def test_round_numbers_in_a_model_are_cut_into_the_same_pieces_in_every_configuration(tmp_path):
    """Samples of an axis in a model with round numbers: the same count in every configuration.

    Axes of 4, 10 and 6 radii. If computed from poses, rounding decided between n and n + 1 samples (regression).
    """
    file = tmp_path / "round.xml"
    file.write_text(ROUND)
    cloud = np.random.default_rng(0).uniform(-1, 1, (500, 3))
    where = CheckedScene(MujocoArm(file), Wall(cloud, "none"), np.eye(3), np.zeros(3), 0.2)
    segments = np.random.default_rng(1).uniform(-3, 3, (40, 3))
    counts = {where.at(x[None]).samples.shape[1] for x in segments}
    assert counts == {4 + 2 + 10 + 2 + 6 + 2}
    known = where.at(segments)
    for k in range(39):
        _, found = where.between(segments[k : k + 1] * (1 + 1e-9), np.array([k]), known, 1.0)
        assert found[0] == pytest.approx(known.clearance[k], abs=1e-6)


@pytest.mark.slow
def test_the_documented_job_validates(tmp_path):
    """Validation of the documented job (regression): the forearm of configs/pipe is 0.32 m long and 0.08 m thick."""
    out = tmp_path / "pipe"
    main(["plan", str(PIPE), "--out", str(out)])
    assert main(["validate", str(out)]) == 0


def test_joint_speeds_are_in_proportion_to_the_feed_rate(planned):
    slow, fast = (
        validate_results(planned / "run", between=0, feed_mm_s=feed).methods["baseline"] for feed in (10.0, 30.0)
    )
    assert fast.speed_ratio_max == pytest.approx(3 * slow.speed_ratio_max) and slow.paths_touching is None


def test_joint_speeds_are_those_at_the_feed_that_the_job_states(tmp_path):
    spec = load_sweep(toy_run() / "grid.yaml", None, ["program.feed=8mm/s"])
    run = keep_plans(spec, {"baseline": open_run(toy_run() / "run").plans("baseline")}, tmp_path / "run")
    assert validate_results(run, between=0).feed_mm_s == pytest.approx(8.0)


def test_a_plan_validates_and_its_summary_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(toy_run())
    out = tmp_path / "plan"
    main(["plan", "job.yaml", "--method", "baseline", "--out", str(out)])
    capsys.readouterr()
    assert main(["validate", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["methods"]["baseline"]["checked"] == TOY_TARGETS
    summary = json.loads((out / "summary.json").read_text())
    assert summary["validated"] is True and summary["method"] == "baseline"
    (out / "trajectory.npz").write_bytes(b"PK")
    assert main(["validate", str(out)]) == 2
    assert "is damaged" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words, reason",
    [
        (["nowhere"], "contains neither a run"),
        (["run", "--between", "-1"], "between is -1"),
        (["run", "--feed-mm-s", "0"], "must be positive"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(monkeypatch, capsys, words, reason):
    monkeypatch.chdir(toy_run())
    before = sorted((file.name, file.stat().st_mtime_ns) for file in Path("run").iterdir())
    assert main(["validate", *words]) == 2
    error = capsys.readouterr().err
    assert reason in error and error.count("\n") == 1
    assert before == sorted((file.name, file.stat().st_mtime_ns) for file in Path("run").iterdir())


def test_a_path_that_has_changed_since_is_bad_input(run, capsys):
    path = toy_run() / "path.csv"
    before = path.read_text()
    try:
        path.write_text(before + "0.9,0,0\n")
        assert main(["validate", str(run)]) == 2
    finally:
        path.write_text(before)
    assert "has changed since" in capsys.readouterr().err


def test_without_a_column_of_joint_speeds_the_notes_say_why():
    """Notes on missing joint speeds: the reason is named (regression)."""
    method = {"paths": 3, "speed_ratio_max": None}
    reported = {"between": 0, "feed_mm_s": 10.0, "methods": {"baseline": method}}
    assert notes(reported) == ["There are no joint speeds, because the model file has no velocity limits."]
    assert "feed rate of 10 mm/s" in notes(reported | {"methods": {"baseline": method | {"speed_ratio_max": 0.5}}})[0]
