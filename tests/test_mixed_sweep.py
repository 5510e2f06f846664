"""Sweeps over robots, workpieces and settings: each scenario is planned and opened as if it were alone."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.jobs.build import obstacles_of, robot_of, scene
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.model.kinematics import capsule_segments
from htcp_jax.motion import Problem
from htcp_jax.motion.plans import is_tracked
from htcp_jax.planning import batch
from htcp_jax.report import make_report
from htcp_jax.report.groups import read_parts
from htcp_jax.runs import open_run
from htcp_jax.runs.sweep import sweep
from htcp_jax.viewer.replay import open_replays

ARM = """
<mujoco model="{name}"><worldbody>
  <body><joint name="j1" axis="0 0 1" range="-170 170"/>
    <body pos="0 0 0.3"><joint name="j2" axis="0 1 0" range="-{range} {range}"/>
      <body pos="0 0 {upper}"><joint name="j3" axis="0 1 0" range="-150 150"/>
        <geom name="lower" type="capsule" fromto="0 0 0.1 0 0 0.45" size="0.02"/>
        <body pos="0 0 0.5"><joint name="j4" axis="0 1 0" range="-150 150"/>
          <geom name="tool" type="capsule" fromto="0 0 0.02 0 0 0.1" size="0.01"/>
          <site name="tcp" pos="0 0 0.15"/></body></body></body></body>
</worldbody></mujoco>
"""
GRID = """
config: job.yaml
grid:
  - robot.model: [short/arm.xml, long/arm.xml]
  - workpiece.cloud: [near.xyz, far.xyz]
    settings.max_step_qps: [20, 30]
  - start_rad.2: {offsets: [0.0, 0.1]}
    workpiece.rotation_x_rad: [0.0, 0.1]
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Folder with a grid of two robots, two clouds with a setting each, and two starts with a rotation each.

    Joints, bodies and points are as many as the toy's, whose compiled programs plan it.
    """
    place = tmp_path_factory.mktemp("mixed")
    for name, upper, limit in (("short", 0.5, 120), ("long", 0.7, 110)):
        (place / name).mkdir()
        (place / name / "arm.xml").write_text(ARM.format(name=name, upper=upper, range=limit))
    for name, x in (("near", 1.0), ("far", 1.2)):
        np.savetxt(place / f"{name}.xyz", [(x, y / 60, z / 60) for y in range(-10, 10) for z in range(25, 35)])
    (place / "path.csv").write_text("0.8,0,0.5\n0.8,0.05,0.5\n")
    part = "{path: path.csv, cloud: near.xyz, interior: none, approach_to_inlet: 1, approach_to_path: 0}"
    (place / "job.yaml").write_text(f"workpiece: {part}\nstart_rad: [0, 0.4, 1.2, 0.3]\nmethod: baseline\n")
    (place / "grid.yaml").write_text(GRID)
    return place


@pytest.fixture(scope="module")
def run(place):
    return sweep(place / "grid.yaml", "baseline", place / "run", shard_scenarios=3)


def test_each_scenario_is_what_it_would_be_alone(place, run):
    plans = run.plans("baseline")
    assert is_tracked(plans.status).any()
    for point in load_sweep(place / "grid.yaml").points():
        robot, workpiece, scenario = scene(point.config)
        own = replace(scenario, number=np.asarray(point.number, np.int32))
        beside = obstacles_of(point.config.cell, robot)
        alone = batch.plan(Problem.of(robot, workpiece, own, point.config.settings, obstacles=beside), "baseline")
        for name in ("x", "status", "clearance", "target", "path_clear"):
            np.testing.assert_array_equal(getattr(plans, name)[point.number], getattr(alone, name)[0], name)


def test_how_the_grid_is_cut_has_no_influence(place, run):
    whole = sweep(place / "grid.yaml", "baseline", place / "whole")
    assert whole.targets().equals(run.targets()) and whole.scenarios().equals(run.scenarios())
    assert sweep(place / "grid.yaml", "baseline", place / "run").complete, "it is the same sweep"


def test_the_scenarios_tell_what_varies_and_what_follows_from_it(run):
    rows = run.scenarios().to_pylist()
    assert [json.loads(row["robot.model"]) for row in rows] == ["short/arm.xml"] * 4 + ["long/arm.xml"] * 4
    assert [json.loads(row["workpiece.cloud"]) for row in rows] == ["near.xyz", "near.xyz", "far.xyz", "far.xyz"] * 2
    assert [json.loads(row["settings.max_step_qps"]) for row in rows] == [20, 20, 30, 30] * 2
    assert [row["rotation_x_rad"] for row in rows] == [0.0, 0.1] * 4
    assert {json.loads(row["robot.limits"]) for row in rows} == {"model"}
    assert {tuple(json.loads(row["settings.q_weights"])) for row in rows} == {(1.0,) * 4}
    names = {name.rsplit("/", 1)[-1] for name in run.manifest.files}
    assert names == {"path.csv", "near.xyz", "far.xyz", "arm.xml"} and len(run.manifest.files) == 5


def test_the_manifest_leads_to_the_same_configurations(place, run):
    reported = [point.config.model_dump(mode="json") for point in open_run(place / "run").points()]
    requested = [point.config.model_dump(mode="json") for point in load_sweep(place / "grid.yaml").on("cpu").points()]
    assert reported == requested


def test_a_scenario_is_opened_with_its_own_robot_and_workpiece(place, run):
    replays, axes = open_replays(place / "run"), jax.jit(capsule_segments)
    for point in run.points():
        replay = replays.replay(point.number, "baseline")
        robot = robot_of(point.config.robot)
        assert replay.robot.name == robot.name
        ends = axes(robot, jnp.asarray(replay.x[0]))[0]
        np.testing.assert_allclose(replay.shape.p[0], np.asarray(ends), atol=1e-12)
        if replay.failed != 0:
            near = np.linalg.norm(replay.witness.arm[0] - replay.witness.cloud[0])
            np.testing.assert_allclose(near, replay.clearance[0], atol=1e-12)
    with pytest.raises(InputError, match="has no scenario 8 by baseline; it has 0 to 7"):
        replays.replay(8, "baseline")


def test_it_is_validated_with_each_scenario_s_own_robot_and_workpiece(place, run, capsys):
    assert main(["validate", str(place / "run"), "--between", "0"]) == 0
    found = json.loads((place / "run" / "validation.json").read_text())
    one = found["methods"]["baseline"]
    assert found["validated"] and one["checked"] == int(is_tracked(run.plans("baseline").status).sum())
    assert one["clearance_off_max_mm"] < 1e-9


def test_the_report_has_the_axes(place, run):
    (part,) = read_parts(run, "mixed")
    assert list(part.axes) == ["start_j2_rad", "robot.model", "workpiece.cloud"]
    assert part.parameters["settings.max_step_qps"].tolist() == [20, 20, 30, 30] * 2
    report = make_report(place / "run")
    assert {"robot.model", "workpiece.cloud"} <= set(report.frame("scenarios").columns) and report.figures


def test_a_changed_file_of_an_axis_is_refused(place, run):
    """Check that a run whose cloud has changed is not opened or continued."""
    text = (place / "far.xyz").read_text()
    try:
        (place / "far.xyz").write_text(text + "1.2 0 0.4\n")
        with pytest.raises(InputError, match=r"far\.xyz has changed since .*run was planned"):
            open_replays(place / "run")
        with pytest.raises(InputError, match=r"run contains another sweep: its grid differs"):
            sweep(place / "grid.yaml", "baseline", place / "run")
    finally:
        (place / "far.xyz").write_text(text)


@pytest.mark.parametrize(
    ("grid", "line"),
    [
        ("[method: [baseline]]", "axis 1: method cannot vary within a sweep; valid: any other key"),
        ("[ray.num_cpus: [1, 2]]", "axis 1: ray.num_cpus cannot vary within a sweep"),
        ("[ray: [{}]]", "axis 1: ray cannot vary within a sweep"),
        ("[robot: [{}]]", "unknown parameter robot; "),
        ("[robot.tcp: {offsets: [1]}]", "robot.tcp takes values, not offsets"),
        ("[robot.model: {offsets: [1]}]", "robot.model takes names of files, not 1"),
        ("[robot.model: [3]]", "robot.model takes names of files, not 3"),
        ("[robot.base_m: [[0, 0]]]", "scenario 0: robot.base_m is "),
        ("[robot.base_m.w: [0]]", "unknown parameter robot.base_m.w; did you mean robot.base_m"),
        ("[robot.tool: [{tip: 1}]]", "scenario 0: unknown key robot.tool.tip"),
        ("[settings.clearance_rows: [all]]", "scenario 0: settings.clearance_rows is 'all'"),
        ("[settings.seed: [1.5]]", "scenario 0: settings.seed is 1.5"),
        ("[{workpiece.cloud: [none.xyz], workpiece.path: [path.csv]}]", "none.xyz: no such file"),
        ("[robot.model: [none.xml]]", "none.xml: cannot read the model"),
        ("[robot.model: [gp50, short/arm.xml]]", "short has 4 joints, 0 of them slides; "),
    ],
)
def test_an_axis_that_cannot_be_is_one_line(place, grid, line):
    (place / "wrong.yaml").write_text(f"grid: {grid}")
    config = {"start_rad": [0, -2.3, 0.5, 0, 0.5, -2.0]}
    with pytest.raises(InputError) as error:
        load_sweep(place / "wrong.yaml", config).batch()
    assert line in str(error.value) and "\n" not in str(error.value)


def test_robots_of_a_sweep_need_a_start_that_is_theirs(place):
    """Regression: an axis over robots kept the limits and the start of the GP50."""
    (place / "robots.yaml").write_text("grid: [robot.model: [short/arm.xml, long/arm.xml]]")
    with pytest.raises(InputError, match=r"robot\.model is arm\.xml, so start_rad must be given: 4 joint positions"):
        load_sweep(place / "robots.yaml")
    start = "start_rad: [[0, 0.4, 1.2, 0.3], [0, 0.5, 1.2, 0.3]]"
    (place / "robots.yaml").write_text(f"grid: [{{robot.model: [short/arm.xml, long/arm.xml], {start}}}]")
    jobs = [point.config for point in load_sweep(place / "robots.yaml").points()]
    assert [(job.robot.limits, job.start_rad[1], len(job.settings.q_weights)) for job in jobs] == [
        ("model", 0.4, 4),
        ("model", 0.5, 4),
    ]
    limits = load_sweep(place / "robots.yaml", {"robot.limits": "simulation"}).points()
    assert {point.config.robot.limits for point in limits} == {"simulation"}, "what is stated stands"


def test_files_with_limits_vary_with_the_robots_and_are_relative_to_the_sweep_file(place):
    for name, most in (("short", 0.9), ("long", 0.8)):
        entries = "".join(f"  j{k}: {{min_position: -{most}, max_position: {most}}}\n" for k in (1, 2, 3, 4))
        (place / name / "joint_limits.yaml").write_text(f"joint_limits:\n{entries}")
    models, files = ([f"{name}/{file}" for name in ("short", "long")] for file in ("arm.xml", "joint_limits.yaml"))
    axis = f"{{robot.model: {models}, robot.limits: {files}, start_rad: [[0, 0.4, 0.8, 0.3], [0, 0.5, 0.8, 0.3]]}}"
    (place / "limited.yaml").write_text(f"grid: [{axis}]")
    points = list(load_sweep(place / "limited.yaml").points())
    assert [float(robot_of(point.config.robot).upper[1]) for point in points] == [0.9, 0.8]
    assert [json.loads(point.varied["robot.limits"]) for point in points] == files


def test_a_cloud_of_an_axis_stands_at_its_own_origin_and_the_duct_where_it_does(place):
    (place / "clouds.yaml").write_text("grid: [workpiece.cloud: [duct, near.xyz]]")
    duct, near = [point.config.workpiece for point in load_sweep(place / "clouds.yaml").points()]
    assert duct == load_sweep(place / "clouds.yaml").config.workpiece
    assert (near.rotation_y_rad, near.pivot_m, near.neutral_translation_m) == (0, (0, 0, 0), (0, 0, 0))
    (place / "clouds.yaml").write_text(
        "grid: [{workpiece.cloud: [near.xyz, far.xyz]}, {workpiece.neutral_translation_m.x: [0, 1]}]"
    )
    parts = [point.config.workpiece for point in load_sweep(place / "clouds.yaml").points()]
    assert all(part.pivot_m == part.neutral_translation_m for part in parts)


def test_what_varies_the_robot_stands_in_every_group(place):
    (place / "groups.yaml").write_text("groups: {a: [{robot.model: [short/arm.xml]}], b: [{margin_m: [0]}]}")
    with pytest.raises(InputError, match=r"groups\.b: robot\.model varies in another group; it must vary in every"):
        load_sweep(place / "groups.yaml", {"start_rad": [0, 0.4, 1.2, 0.3]})
