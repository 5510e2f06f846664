"""Job files: defaults from the job's own robot and workpiece, jobs that extend other jobs, files of saved plans."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from hand_made import plans_with

from htcp_jax import api
from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.io.parts.workpiece_source import GeneratedDuct, load_workpiece
from htcp_jax.jobs import load_config, resolve
from htcp_jax.jobs.build import resolved_scene, robot_of, scene
from htcp_jax.model.scenario_setup import place_of
from htcp_jax.spec.config import PlanConfig
from htcp_jax.status import Status
from htcp_jax.validation.records import read_results
from htcp_jax.viewer.replay import open_replays

CONFIGS = Path(__file__).parents[1] / "configs"
ARM = CONFIGS / "pipe" / "arm.xml"
START = [0.0, -0.7, 0.0, -2.0, 0.0, 0.3, 0.0]
OWN = {"robot": {"model": str(ARM)}, "start_rad": START}


@pytest.fixture
def pipe(tmp_path):
    """Copy of the pipe's job, with two points of its seam and some 10,000 on its walls."""
    folder = Path(shutil.copytree(CONFIGS / "pipe", tmp_path / "jobs"))
    np.savetxt(folder / "seam.csv", np.loadtxt(folder / "seam.csv", delimiter=",", ndmin=2)[:2], delimiter=",")
    own = "workpiece:\n  approach_to_path: 1\n  mesh_spacing_m: 0.02"
    text = (folder / "job.yaml").read_text().replace("workpiece:", own, 1)
    (folder / "job.yaml").write_text(text.replace("method: beam", "method: baseline"))
    return folder


def plan_of(job: str | Path) -> api.Plan:
    """Plan of a job in which the first target failed."""
    config, robot, workpiece, scenario = resolved_scene(load_config(job))
    lost = [Status.ITERATION_LIMIT, *[Status.NOT_ATTEMPTED] * (len(scenario.targets) - 1)]
    plans = plans_with([lost], joints=7)._replace(start=scenario.x_start[None], target=scenario.targets[None])
    return api.Plan(config, robot, workpiece, scenario, plans)


def refusal(config, overrides=()) -> str:
    with pytest.raises(InputError) as error:
        load_config(config, overrides)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_another_robot_has_its_model_s_limits_and_weights_of_one():
    """Regression: a job without limits was planned and validated with +-pi, beyond the limits of its model."""
    job = load_config(OWN)
    assert job.robot.limits == "model" and resolve(job, robot_of(job.robot)).settings.q_weights == (1.0,) * 7
    limits = robot_of(load_config(OWN | {"robot.limits": "simulation"}).robot).upper
    assert np.allclose(limits, np.pi) and (np.asarray(robot_of(job.robot).upper) < np.pi).all()


def test_another_robot_without_a_start_is_refused_and_its_joints_are_named(tmp_path):
    """Regression: the GP50's start was used silently, or refused for its length."""
    (tmp_path / "job.yaml").write_text(f"robot: {{model: {ARM}}}\n")
    with pytest.raises(InputError) as error:
        api.plan(tmp_path / "job.yaml")
    first = f"{tmp_path / 'job.yaml'}: robot.model is arm.xml, so start_rad must be given: "
    assert str(error.value) == f"{first}7 joint positions (a1, a2, a3, a4, a5, a6, a7), or auto"


def test_a_job_is_read_without_the_files_that_it_names(tmp_path, capsys):
    """The job is complete, and the command refuses the missing file."""
    (tmp_path / "job.yaml").write_text("robot: {model: no-arm.xml}\nworkpiece: {cloud: no-part.stl}\n")
    job = load_config(tmp_path / "job.yaml")
    assert (job.robot.model, job.start_rad, job.settings.q_weights) == (str(tmp_path / "no-arm.xml"), (), ())
    assert load_config(job.model_dump()) == load_config(json.loads(job.model_dump_json())) == job
    assert main(["plan", str(tmp_path / "job.yaml"), "--out", str(tmp_path / "out")]) == 2
    reported = capsys.readouterr().err
    assert "no-arm.xml: cannot read the model" in reported and reported.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_another_cloud_stands_at_its_own_origin_and_is_not_turned():
    """Regression: a user-supplied cloud got the duct's pose: 0.4 and 0.1 rad about the duct's pivot, and its shift."""
    part = load_config({"workpiece": {"cloud": "box.stl"}}).workpiece
    assert (part.rotation_x_rad, part.rotation_y_rad, part.rotation_z_rad) == (0, 0, 0)
    assert part.neutral_translation_m == part.pivot_m == (0, 0, 0)
    moved = load_config({"workpiece": {"cloud": "box.stl", "neutral_translation_m": [1, 2, 3]}}).workpiece
    assert moved.neutral_translation_m == moved.pivot_m == (1, 2, 3), "it turns about its own origin"


def test_what_a_job_states_always_stands():
    stated = {
        "robot": {"model": str(ARM), "limits": "simulation"},
        "workpiece": {"cloud": "box.stl", "rotation_z_rad": 0.3, "pivot_m": [1, 0, 0]},
        "settings": {"q_weights": [2.0] * 7},
        "start_rad": START,
    }
    job = load_config(stated)
    part = job.workpiece
    assert (job.robot.limits, job.settings.q_weights) == ("simulation", (2.0,) * 7)
    assert (part.rotation_y_rad, part.rotation_z_rad, part.pivot_m) == (0, 0.3, (1, 0, 0))
    assert load_config({"config": str(CONFIGS / "duct.yaml"), "workpiece.cloud": "scan.xyz"}).workpiece == (
        PlanConfig().workpiece.model_copy(update={"cloud": "scan.xyz"})
    ), "duct.yaml states every key, so a scan of the duct stands where the duct does"


POSE = {"neutral_translation_m": (1, 2, 3), "pivot_m": (0, 1, 0), "rotation_y_rad": 0.2, "rotation_z_rad": 0.3}


@pytest.mark.parametrize("pose_in", ["base", "file", "override"])
@pytest.mark.parametrize("cloud_in", ["base", "file", "override"])
@pytest.mark.parametrize("key", [None, *POSE])
def test_where_a_value_stands_makes_no_difference(tmp_path, cloud_in, pose_in, key):
    """An override, else the file, else its base, else the default for the part: only what is stated counts."""
    said = {"base": {}, "file": {}, "override": {}}
    said[cloud_in]["cloud"] = str(tmp_path / "part.stl")
    said[pose_in] |= {} if key is None else {key: POSE[key]}
    for name, first in (("base", {}), ("file", {"config": "base.yaml"})):
        (tmp_path / f"{name}.yaml").write_text(json.dumps(first | {"workpiece": said[name]}))
    overrides = {f"workpiece.{name}": value for name, value in said["override"].items()}
    found = load_config(tmp_path / "file.yaml", overrides).workpiece
    assert found == load_config({"workpiece": {**said["base"], **said["file"], **said["override"]}}).workpiece
    expected = dict.fromkeys(POSE, 0) | {"neutral_translation_m": (0, 0, 0), "pivot_m": (0, 0, 0)}
    expected |= {} if key is None else {key: POSE[key]}
    if key == "neutral_translation_m":
        expected["pivot_m"] = POSE[key]  # a part turns about its own origin
    assert {name: getattr(found, name) for name in POSE} == expected


def test_an_override_comes_before_the_file_and_the_file_before_its_base(tmp_path):
    (tmp_path / "base.yaml").write_text("workpiece: {rotation_y_rad: 0.1, rotation_z_rad: 0.1, rotation_x_rad: 0.1}")
    (tmp_path / "job.yaml").write_text("config: base.yaml\nworkpiece: {rotation_y_rad: 0.2, rotation_z_rad: 0.2}")
    part = load_config(tmp_path / "job.yaml", ["workpiece.rotation_z_rad=0.3"]).workpiece
    assert (part.rotation_x_rad, part.rotation_y_rad, part.rotation_z_rad) == (0.1, 0.2, 0.3)


def test_the_table_says_where_the_part_stands(pipe):
    plan = plan_of(pipe / "job.yaml")
    assert plan.facts()["workpiece"].startswith(
        "origin at (0.75, 0, 0.7) m, turned by 12.8 deg about (-0.045, 0.894, 0.446); extent x 0.7"
    )
    text = place_of(plan.workpiece, np.eye(4))
    low, high = plan.workpiece.cloud.min(axis=0), plan.workpiece.cloud.max(axis=0)
    assert text.startswith("at the world's origin, not turned; extent x ")
    assert text.endswith(f"z {low[2]:.3f} to {high[2]:.3f} m")


def test_a_refusal_of_a_part_without_a_pose_says_first_where_it_stands(pipe):
    own = {"neutral_translation_m": (0, 0, 0), "pivot_m": (0, 0, 0), "rotation_y_rad": 0, "rotation_z_rad": 0}
    own |= {"cloud": "none", "path": str(pipe / "far.csv"), "inlet_m": None}
    (pipe / "far.csv").write_text("5,0,0\n5,0,0.01\n")
    job = load_config(pipe / "job.yaml", {f"workpiece.{key}": value for key, value in own.items()})
    with pytest.raises(InputError, match=r"^the workpiece is at the world's origin, not rotated, as in a job"):
        scene(job)
    turned = job.model_copy(update={"workpiece": job.workpiece.model_copy(update={"rotation_z_rad": 0.1})})
    with pytest.raises(InputError, match=r"^target "):
        scene(turned)


def test_a_mapping_an_override_and_a_file_say_the_same(tmp_path):
    (tmp_path / "job.yaml").write_text(f"robot: {{model: {ARM}}}\nstart_rad: {START}\nmargin_m: 0.25\n")
    said = load_config(tmp_path / "job.yaml")
    assert said == load_config(OWN | {"margin_m": 0.25}) == load_config(None, {"margin_m": 0.25, **OWN})
    assert said == load_config({"robot": {"model": ARM}, "margin_m": 0.25}, {"start_rad": START})


def test_jobs_build_on_each_other_with_files_of_their_own_folders(tmp_path):
    """Check `config:`, by which jobs of one cell share a common file."""
    (tmp_path / "cell").mkdir()
    (tmp_path / "cell" / "base.yaml").write_text(
        f"robot: {{model: {ARM}, base_m: [0, 0, 0.5]}}\nstart_rad: {START}\n"
        "workpiece: {cloud: box.stl, path: a.csv}\n"
    )
    (tmp_path / "middle.yaml").write_text("config: cell/base.yaml\nmargin_m: 0.25\nworkpiece: {path: b.csv}\n")
    (tmp_path / "job.yaml").write_text("config: middle.yaml\nrobot: {base_m: [1, 0, 0]}\nsettings:\nmargin_m: 0.5\n")
    job = load_config(tmp_path / "job.yaml", ["workpiece.path=c.csv"])
    assert (job.robot.base_m, job.margin_m) == ((1, 0, 0), 0.5), "lists are replaced as a unit"
    assert job.robot.model == str(ARM) and job.workpiece.cloud == str(tmp_path / "cell" / "box.stl")
    assert job.workpiece.path == "c.csv" and job.robot.limits == "model"
    assert load_config(tmp_path / "job.yaml").workpiece.path == str(tmp_path / "b.csv")


def test_paper_yaml_builds_on_duct_yaml():
    assert load_config(CONFIGS / "paper.yaml").workpiece == PlanConfig().workpiece


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("config: job.yaml", "job.yaml: the files named by config form a circle: "),
        ("config: other.yaml", "other.yaml: the files named by config form a circle: "),
        ("config: none.yaml", "none.yaml: No such file"),
        ("config: 3", "job.yaml: config is 3; it must name a base file or an example"),
        ("config:", "job.yaml: config is None; it must name a base file"),
        ("config: typo.yaml", "typo.yaml: unknown key margin; did you mean margin_m?"),
        ("config: .", "not a regular file"),
    ],
)
def test_a_base_that_cannot_be_is_one_line(tmp_path, text, line):
    """Check the error line for each bad value of `config:`."""
    (tmp_path / "job.yaml").write_text(text)
    (tmp_path / "other.yaml").write_text("config: job.yaml")
    (tmp_path / "typo.yaml").write_text("margin: 1")
    assert line in refusal(tmp_path / "job.yaml")


@pytest.mark.parametrize(
    ("robot", "line"),
    [
        ("tcp: tool0", "no site or body 'tool0' for the TCP; sites of the model: tcp; bodies: "),
        ("base_m: [0, 0]", "robot.base_m is [0, 0]: at least 3 values"),
        ("base_rpy_rad: [0, 0, .nan]", "robot.base_rpy_rad.2 is nan"),
        ("tool: 3", "robot.tool is 3: "),
        ("tool: {tip: [0, 0, 0]}", "unknown key robot.tool.tip; did you mean robot.tool.tip_m?"),
        ("tool: {tip_m: [0, 0, .nan]}", "robot.tool.tip_m.2 is nan: input should be a finite number"),
        ("tool: {tip_rpy_rad: [0, 0, .inf]}", "robot.tool.tip_rpy_rad.2 is inf: input should be a finite number"),
        ("tool: {bodies: [{name: a, p_m: [0, 0, 0], q_m: [0, 0, 1]}]}", "robot.tool.bodies.0.radius_m is "),
        (f"tool: {{bodies: [{'{name: a, p_m: [0, 0, 0], q_m: [0, 0, 1], radius_m: 0}'}]}}", "radius_m of 'a' is 0.0 m"),
        (f"tool: {{bodies: [{'{name: a, p_m: [0, 0, .nan], q_m: [0, 0, 1], radius_m: 1}'}]}}", "bodies.0.p_m.2 is nan"),
        (f"tool: {{bodies: [{'{name: a, p: [0, 0, 0], q_m: [0, 0, 1], radius_m: 1}'}]}}", "bodies.0.p; did you mean"),
        (
            f"tool: {{bodies: [{', '.join(['{name: a, p_m: [0, 0, 0], q_m: [0, 0, 1], radius_m: 1}'] * 2)}]}}",
            "robot.tool: two bodies are named 'a'",
        ),
        (
            f"tool: {{bodies: [{'{name: wrist, p_m: [0, 0, 0], q_m: [0, 0, 1], radius_m: 1}'}]}}",
            "arm.xml already has a capsule 'wrist'",
        ),
    ],
)
def test_a_cell_that_cannot_be_is_one_line(tmp_path, robot, line):
    """Check the error line for each bad value in the section `robot:`."""
    (tmp_path / "job.yaml").write_text(f"robot:\n  model: {ARM}\n  {robot}\nstart_rad: {START}\n")
    with pytest.raises(InputError) as error:
        robot_of(load_config(tmp_path / "job.yaml").robot)
    assert line in str(error.value) and "\n" not in str(error.value)


def test_a_part_turns_about_world_x_before_y_and_z():
    """Check the rotation with three angles; two could not describe a part on a tilting table."""
    part = load_workpiece(GeneratedDuct(points=100))
    cx, sx, cy, sy, cz, sz = (f(angle) for angle in (0.3, 0.4, 0.1) for f in (np.cos, np.sin))
    about = [[[1, 0, 0], [0, cx, -sx], [0, sx, cx]], [[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]]]
    about.append([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    x, y, z = map(np.array, about)
    T = part.T_world(0.4, 0.1, (0.0, 0.0, 0.5), 0.3)
    np.testing.assert_allclose(T[:3, :3], z @ y @ x, atol=1e-15)
    pivot = part.pivot
    moved = pivot + z @ y @ x @ (part.path[0] + part.neutral_translation - pivot) + (0, 0, 0.5)
    np.testing.assert_allclose(T[:3, :3] @ part.path[0] + T[:3, 3], moved, atol=1e-14)
    assert (part.T_world(0.4, 0.1) == part.T_world(0.4, 0.1, wx=0.0)).all()


def test_a_turn_about_x_is_the_scenario_s(tmp_path):
    job = {"workpiece": {"rotation_x_rad": 0.1, "rotation_y_rad": 0.0, "rotation_z_rad": 0.0}}
    *_, scenario = scene(load_config(job))
    np.testing.assert_allclose(scenario.T_world_workpiece[:3, 1], [0, np.cos(0.1), np.sin(0.1)], atol=1e-15)


def test_a_plan_s_folder_is_opened_from_anywhere(pipe, monkeypatch):
    """Regression: summary.json had file names relative to the working directory of the command."""
    monkeypatch.chdir(pipe)
    plan_of("job.yaml").save("../out")
    monkeypatch.chdir("/")
    assert open_replays(pipe.parent / "out").replay(0, "baseline").failed == 0
    (track,) = read_results(pipe.parent / "out").tracks
    assert Path(track.config.workpiece.cloud) == pipe / "pipe.obj"


@pytest.mark.parametrize("name", ["seam.csv", "pipe.obj", "arm.xml"])
def test_a_plan_whose_file_has_changed_is_refused(pipe, monkeypatch, name, capsys):
    """Regression: validate accepted a changed file of the same name and refuted everything without the reason."""
    plan_of(pipe / "job.yaml").save(pipe / "out")
    assert open_replays(pipe / "out").methods == ("baseline",)
    (pipe / name).write_text((pipe / name).read_text() + "\n")
    with pytest.raises(InputError, match=rf"{name} has changed since .*out was planned"):
        open_replays(pipe / "out")
    assert main(["validate", str(pipe / "out")]) == 2
    assert f"{name} has changed since " in capsys.readouterr().err
    (pipe / name).unlink()
    with pytest.raises(InputError, match=rf"cannot read .*{name}"):
        open_replays(pipe / "out")
