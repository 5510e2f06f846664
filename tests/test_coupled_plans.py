"""Plans and programs of an arm with a wrist whose second bend follows the first, and a rod next to its upper arm."""

import csv
import dataclasses
import itertools
import json
import re
import xml.etree.ElementTree as ET
from typing import NamedTuple

import mujoco
import numpy as np
import pyarrow.parquet as pq
import pytest
import toy
from coupled import solved

import htcp_jax
from htcp_jax.api import Plan
from htcp_jax.cli.main import main
from htcp_jax.io.robots.joint_limits import JointLimits, StatedLimits
from htcp_jax.io.robots.loading import load_robot
from htcp_jax.runs import open_plans, open_run
from htcp_jax.spec.config import RobotConfig
from htcp_jax.trajectory.joint_torques import model_of, torques
from htcp_jax.trajectory.limits import own_rates

PLACES = 1000  # per segment
ARM = """
<mujoco model="bent"><compiler boundmass="1e-3" boundinertia="1e-3"/><worldbody>
  <body pos="0 0 0.3"><joint name="j1" axis="0 0 1" range="-170 170"/>
    <body pos="-0.1 0 0"><joint name="rod" axis="0 1 0" range="-150 150"/>
      <geom name="rod" type="capsule" size="0.015" fromto="0 0 0.02 0 0 0.38"/></body>
    <body><joint name="j2" axis="0 1 0" range="-120 120"/>
      <geom name="upper" type="capsule" size="0.03" fromto="0 0 0.05 0 0 0.35"/>
      <body pos="0 0 0.4"><joint name="j3" axis="0 1 0" range="-150 150"/>
        <geom name="forearm" type="capsule" size="0.03" fromto="0 0 0.08 0 0 0.32"/>
        <body pos="0 0 0.36"><joint name="j4" axis="0 1 0" range="-150 150"/>
          <body pos="0 0 0.05"><joint name="j4b" axis="0 1 0" range="-90 90"/>
            <geom name="tool" type="capsule" size="0.02" fromto="0 0 0.03 0 0 0.16"/><site name="tcp" pos="0 0 0.2"/>
  </body></body></body></body></body></worldbody>
  <equality><joint joint1="j4b" joint2="j4" polycoef="0.1 0.5 0 0 0"/><joint joint1="rod" joint2="j2"/></equality>
  <custom><numeric name="speed" data="3 3 3 3 3 0.8"/></custom>
</mujoco>
"""
START = np.radians([0.0, 0.0, 100.0, 16.0]).round(6).tolist()


class Made(NamedTuple):
    """The arm's plan, its folder, and the arm in MuJoCo."""

    plan: Plan
    folder: str
    model: mujoco.MjModel


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Made:
    folder = tmp_path_factory.mktemp("bent")
    job = toy.write_job(folder, 5, start_rad=START)
    (folder / "arm.xml").write_text(ARM)
    found = htcp_jax.plan(str(job))
    found.save(folder / "plan")
    return Made(found, str(folder / "plan"), mujoco.MjModel.from_xml_string(ARM))


def program(made: Made, tmp_path, format: str, *words: str):
    file = tmp_path / f"program.{format}"
    assert main(["program", made.folder, "--feed", "20mm/s", "--format", format, "--out", str(file), *words]) == 0
    return file.read_text()


def test_a_proven_motion_is_clear_at_1000_places_of_each_segment_by_mujoco_with_its_constraints_solved(made):
    plan, model = made.plan, made.model
    assert plan.complete and plan.robot.joint_names == ("j1", "j2", "j3", "j4")
    T = plan.scenario.T_world_workpiece
    cloud = plan.workpiece.cloud @ T[:3, :3].T + T[:3, 3]
    geoms = [model.geom(name).id for name in plan.robot.capsule_names]
    pairs = [(model.geom("rod").id, model.geom(name).id) for name in ("forearm", "tool")]
    x, target, least = plan.motion().x, plan.motion().target, np.full(plan.plans.x.shape[1], np.inf)
    data, along = solved(model, dict(zip(plan.robot.joint_names, x[0].tolist(), strict=True)))
    start = data.qpos.copy()
    for a, b, to in zip(x[:-1], x[1:], target[1:], strict=True):
        for share in np.linspace(0, 1, PLACES):
            data.qpos[:] = start + along @ (a + share * (b - a) - x[0])
            mujoco.mj_kinematics(model, data)
            half = model.geom_size[geoms, 1][:, None] * data.geom_xmat[geoms, 2::3]
            p, d = data.geom_xpos[geoms] - half, 2 * half
            t = np.clip(((cloud - p[:, None]) * d[:, None]).sum(-1) / (d * d).sum(-1)[:, None], 0, 1)
            away = np.linalg.norm(cloud - p[:, None] - t[..., None] * d[:, None], axis=-1).min(axis=1)
            apart = [mujoco.mj_geomDistance(model, data, *pair, 1.0, None) for pair in pairs]
            least[to] = min(least[to], (away - model.geom_size[geoms, 0]).min(), *apart)
    assert (least >= plan.plans.segment_clearance[0] - 1e-9).all() and least.min() > 0


def test_a_plan_validates_with_mujocos_own_constraints(made):
    assert main(["validate", made.folder]) == 0  # 1 if a target or a joint path is refuted


def test_followers_stand_next_to_the_joints_in_motions_and_tables(made):
    with open(f"{made.folder}/motion.csv") as file:
        rows = list(csv.DictReader(file))
    assert [*rows[0]][2:] == ["j1_rad", "j2_rad", "j3_rad", "j4_rad", "q_j4b_rad", "q_rod_rad"]
    for row in (*rows, *made.plan.frame().to_dict("records")):
        assert float(row["q_j4b_rad"]) == pytest.approx(0.1 + 0.5 * float(row["j4_rad"]), abs=1e-12)
        assert float(row["q_rod_rad"]) == float(row["j2_rad"])
    np.testing.assert_array_equal(open_plans(made.folder).plans("beam").x, made.plan.plans.x)


def test_a_sweep_keeps_the_followers_of_every_target(tmp_path):
    toy.write_sweep(tmp_path, start_rad=START)
    (tmp_path / "arm.xml").write_text(ARM)
    run = str(tmp_path / "run")
    assert main(["sweep", str(tmp_path / "grid.yaml"), "--methods", "baseline", "--out", run]) == 0
    rows = open_run(run).targets("baseline")
    assert b"follows another joint" in rows.schema.field("q_j4b_rad").metadata[b"description"]
    np.testing.assert_allclose(rows["q_j4b_rad"], 0.1 + 0.5 * rows["j4_rad"].to_numpy(), atol=1e-12)


def test_a_sweep_of_joints_that_are_named_like_followers_columns_is_opened(tmp_path):
    toy.write_sweep(tmp_path, start_rad=START)
    (tmp_path / "arm.xml").write_text(ARM.replace("j1", "q_j4b"))
    run = str(tmp_path / "run")
    assert main(["sweep", str(tmp_path / "grid.yaml"), "--methods", "baseline", "--out", run]) == 0
    rows = open_run(run).targets("baseline")
    np.testing.assert_array_equal(rows["q_j4b_rad"], open_run(run).plans("baseline").x[..., 0].ravel())
    made = pq.read_table(next((tmp_path / "run" / "targets").iterdir()))
    np.testing.assert_allclose(made["q_q_j4b_rad"], 0.1 + 0.5 * made["j4_rad"].to_numpy(), atol=1e-12)
    assert b"joint j4b, which follows" in made.schema.field("q_q_j4b_rad").metadata[b"description"]


def test_programs_contain_the_joints_that_their_controllers_take(made, tmp_path):
    names = '["j1", "j2", "j3", "j4"'
    assert f"joint_names: [{names[1:]}]" in program(made, tmp_path, "ros")
    both = json.loads(program(made, tmp_path, "ros-json", "--set", "program.axes=all"))["message"]
    assert both["joint_names"] == ["j1", "j2", "j3", "j4", "j4b", "rod"]
    words = ["--set", "program.axes=all", "--max-points", "60"]
    few = json.loads(program(made, tmp_path, "ros-json", *words))["message"]
    assert 50 <= len(few["points"]) <= 60 < len(both["points"])
    for point in [*both["points"], *few["points"]]:
        np.testing.assert_allclose(point["positions"][4], 0.1 + 0.5 * point["positions"][3], atol=1e-9)
        following = [0.5 * point["velocities"][3], point["velocities"][1]]
        np.testing.assert_allclose(point["velocities"][4:], following, atol=1e-9)
    for key in ET.fromstring(program(made, tmp_path, "keyframes")).iter("key"):  # the file's order
        qpos = np.array(key.get("qpos").split(), float)
        np.testing.assert_allclose(qpos[[1, 5]], [qpos[2], 0.1 + 0.5 * qpos[4]], atol=1e-9)


@pytest.mark.parametrize(
    ("format", "key", "message"),
    [
        ("keyframes", "axes=commanded", "keyframes does not support program.axes: commanded; valid: all"),
        ("rapid", "axes=all", "rapid does not support program.axes: all; valid: commanded"),
        ("rapid", "coupled={j4b: j1}", "program.coupled: 'j4b' follows another joint; valid: j1, j2, j3, j4"),
        (
            "csv",
            "velocity=[1, 2]",
            "has 2 values, but the robot bent has 4 joints (j1, j2, j3, j4; j4b, rod follow them)",
        ),
    ],
)
def test_keys_that_do_not_fit_followers_are_refused_by_name(made, tmp_path, capsys, format, key, message):
    words = ["--feed", "20mm/s", "--format", format, "--out", str(tmp_path / "program"), "--set", f"program.{key}"]
    assert main(["program", made.folder, *words]) == 2
    assert message in " ".join(capsys.readouterr().err.split())


def test_a_home_with_a_value_for_a_follower_names_the_joints(made, tmp_path, capsys):
    job = toy.write_job(tmp_path, 2, start_rad=[*START, 0.2])
    (tmp_path / "arm.xml").write_text(ARM)
    assert main(["plan", str(job)]) == 2
    assert "5 joint positions, the robot bent has 4 joints (j1, j2, j3, j4; j4b, rod follow" in capsys.readouterr().err


def test_speed_limits_in_a_file_are_those_of_the_joints_that_move(made):
    robot = made.plan.robot
    np.testing.assert_allclose(robot.speed, [3, 3, 3, 1.6])  # j4b turns at half of j4's speed
    order = robot.all_joint_names
    nothing = (StatedLimits(),) * len(order)
    own = dataclasses.replace(robot.coupling, speed=tuple(4.0 if name == "rod" else 3.0 for name in order))
    faster = dataclasses.replace(robot, coupling=own)
    for arm, name, speed, expected in (
        (robot, "j4b", 0.1, [3, 3, 3, 0.2]),
        (robot, "j2", 0.1, [3, 0.1, 3, 1.6]),
        (robot, "rod", 0.1, [3, 0.1, 3, 1.6]),
        (faster, "j2", 5.0, [3, 4, 3, 3]),  # the file's limit replaces that of j2, and the rod keeps its own
    ):
        k = order.index(name)
        rows = (*nothing[:k], StatedLimits(velocity=speed), *nothing[k + 1 :])
        stated = JointLimits("limits.yaml", order, rows, (), (), (), False)
        np.testing.assert_allclose(own_rates(arm, stated)["velocity"], expected)


def test_a_coordinate_bears_the_weight_of_all_that_it_moves(tmp_path):
    """The torque at rest is the derivative of the potential energy, by MuJoCo with its constraints solved."""
    masses = itertools.count(2)  # equal ones would be placeholders
    inertial = '<inertial pos="0.02 0 0.1" mass="{}" diaginertia=".1 .1 .1"/>'
    text = re.sub(r'(<joint name="[^>]*>)', lambda joint: joint[1] + inertial.format(next(masses)), ARM)
    (tmp_path / "arm.xml").write_text(text)
    model, robot = model_of(RobotConfig(model=str(tmp_path / "arm.xml"))), load_robot(tmp_path / "arm.xml")
    x, h = np.array([[0.3, 0.4, 0.5, -0.6]]), 1e-5
    found = torques(model, (), robot.coupling)(x, 0 * x, 0 * x)[0]

    def energy(u: np.ndarray) -> float:
        own = mujoco.MjModel.from_xml_string(text)
        data, _ = solved(own, dict(zip(robot.joint_names, u.tolist(), strict=True)))
        return 9.81 * float(own.body_mass @ data.xipos[:, 2])

    steps = h * np.eye(4)
    np.testing.assert_allclose(found, [(energy(x[0] + s) - energy(x[0] - s)) / (2 * h) for s in steps], atol=1e-6)
