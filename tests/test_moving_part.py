"""Cells in which the part moves: a chain rooted at the part, next to MuJoCo's own tree of the cell."""

import dataclasses
import json
import re
import shutil
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import jax
import made_once
import mujoco
import numpy as np
import pytest
import toy

import htcp_jax
from htcp_jax.cli.main import main
from htcp_jax.errors import InputError
from htcp_jax.io.robots import LinkMeshes, import_robot, load_robot
from htcp_jax.jobs import build, load_config
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.model import kinematics
from htcp_jax.runs.open import open_plans
from htcp_jax.spec.config import RobotConfig
from htcp_jax.trajectory.joint_torques import model_of, torques
from htcp_jax.trajectory.plan_program import program_of
from htcp_jax.validation import validate_results
from htcp_jax.validation.mujoco_arm import MujocoArm

HEAD = """<mujoco model="cell"><compiler angle="radian" boundmass="1e-6" boundinertia="1e-6"/>"""
PART = '<custom><text name="link of the part" data="{}"/></custom>'
ARM = """
<body name="link1" pos="0 0.1 0.3" quat="0.9 0.1 0.2 0"><joint name="a1" axis="0 0 1" range="-2 2"/>
  <geom name="trunk" type="capsule" fromto="0 0 0 0 0 .4" size=".05"/>
  <body name="link2" pos="0 0 .4" quat=".7 .1 .6 0"><joint name="a2" axis="0 1 0" range="-2 1" ref=".3" pos=".01 0 0"/>
    <geom name="boom" type="capsule" fromto="0 0 0 .4 0 0" size=".04"/>
    <body name="link3" pos=".4 0 0" quat=".7 .1 .6 .3"><joint name="a3" axis="1 1 0" range="-1 2" ref=".2"/>
      <geom name="tip" type="capsule" fromto="0 0 0 .3 0 0" size=".03"/>{}</body></body></body>
"""
TCP = '<site name="tcp" pos=".35 0 0" quat=".4 .5 .3 .2"/>'
TABLE = """
<body name="tilt" pos="1 .2 .3" quat=".9 .1 -.3 .2">
  <joint name="b1" axis="1 .1 0" range="-1 1.2" ref=".3" pos=".1 .02 -.05"/>
  <geom name="yoke" type="capsule" fromto="0 0 0 0 0 .1" size=".02"/>
  <body name="table" pos=".1 -.05 .1" quat=".5 .5 -.3 .2">
    <joint name="b2" axis="0 .2 1" range="-3 3" pos=".02 .02 0" ref="-.4"/>
    <joint name="b3" type="slide" axis="0 1 1" range="-.1 .2" ref=".03"/>
    <geom name="plate" type="sphere" size=".05"/></body></body>
"""
RAIL = '<body name="car"><joint name="rail" type="slide" axis="0 1 .1" range="-2 2"/>{}</body>'
FIXED_TOOL = (
    '<geom name="grinder" type="capsule" fromto=".5 .1 0 .5 .1 .4" size=".03"/><site name="tcp" pos=".5 .1 .45"/>'
)


def cell_of(part: str, *shapes: str) -> str:
    return HEAD + PART.format(part) + f"<worldbody>{''.join(shapes)}</worldbody></mujoco>"


CELLS = {
    "a rail below the arm, and a positioner": cell_of("table", TABLE, RAIL.format(ARM.format(TCP))),
    "a positioner of two axes and a slide": cell_of("table", TABLE, ARM.format(TCP)),
    "the part in the hand": cell_of("link3", FIXED_TOOL, ARM.format("")),
}


def in_mujoco(xml: str, joints: tuple[str, ...], part: str, x: np.ndarray) -> tuple[np.ndarray, ...]:
    """TCP's position, its axes and its Jacobian relative to the part, and the middles of capsules, by mj_forward."""
    model = mujoco.MjModel.from_xml_string(xml)
    data, order, root = mujoco.MjData(model), [model.joint(name).id for name in joints], model.body(part).id
    of_tcp, of_part, turns, found = np.zeros((3, model.nv)), np.zeros((3, model.nv)), np.zeros((3, model.nv)), []
    for row in x:
        data.qpos[order] = row
        mujoco.mj_forward(model, data)
        R, t, tcp = data.xmat[root].reshape(3, 3), data.xpos[root], data.site("tcp")
        mujoco.mj_jacSite(model, data, of_tcp, None, model.site("tcp").id)
        mujoco.mj_jac(model, data, of_part, turns, tcp.xpos, root)
        axes = R.T @ tcp.xmat.reshape(3, 3)
        found.append((R.T @ (tcp.xpos - t), axes, R.T @ (of_tcp - of_part)[:, order], (data.geom_xpos - t) @ R))
    return tuple(map(np.array, zip(*found, strict=True)))


@made_once.quick_jit
@partial(jax.vmap, in_axes=(None, 0))
def by_chain(robot, x):
    """The numbers of `in_mujoco`, by the chain from the part."""
    T, (p, q) = kinematics.tcp_pose(robot, x), kinematics.capsule_segments(robot, x)
    return T[:3, 3], T[:3, :3], kinematics.jacobian(robot, x), (p + q) / 2


@pytest.mark.parametrize("name", CELLS)
def test_the_chain_from_the_part_moves_as_mujocos_tree(tmp_path, name):
    (tmp_path / "cell.xml").write_text(CELLS[name])
    robot = load_robot(tmp_path / "cell.xml")
    part = "link3" if "hand" in name else "table"
    x = np.random.default_rng(1).uniform(robot.lower, robot.upper, (1000, len(robot.slides)))
    for ours, theirs in zip(by_chain(robot, x), in_mujoco(CELLS[name], robot.joint_names, part, x), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)


def test_joints_keep_names_limits_and_zeros_and_come_in_the_order_from_the_part(tmp_path):
    (tmp_path / "cell.xml").write_text(CELLS["a rail below the arm, and a positioner"])
    robot = load_robot(tmp_path / "cell.xml")
    assert robot.joint_names == ("b3", "b2", "b1", "rail", "a1", "a2", "a3")
    assert robot.lower.tolist() == [-0.1, -3, -1, -2, -2, -2, -1] and robot.slides == (
        True,
        *2 * (False,),
        True,
        *3 * (False,),
    )
    assert robot.part_moves and robot.world.link == 2 and robot.capsule_link == (1, -1, 4, 5, 6)


def test_with_the_part_on_the_world_the_robot_is_the_same_to_the_last_bit(tmp_path):
    alone = HEAD + f"<worldbody>{ARM.format(TCP)}</worldbody></mujoco>"
    for name, xml in (("a", alone), ("b", cell_of("world", ARM.format(TCP)))):
        (tmp_path / f"{name}.xml").write_text(xml)
    a, b = (load_robot(tmp_path / f"{name}.xml") for name in "ab")
    assert jax.tree.structure(a) == jax.tree.structure(b) and not b.part_moves
    for one, other in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_array_equal(one, other)


# A job: the toy arm next to a turntable

TURNTABLE = """
<body name="stand" pos="0.55 0 0.15"><geom name="post" type="capsule" fromto="0 0 -.1 0 0 0" size=".04"/>
  <body name="table" pos="0 0 .06"><joint name="turn" axis="0 0 1" range="-360 360"/>
    <geom name="plate" type="capsule" fromto="-.08 0 .02 .08 0 .02" size=".03"/></body></body>
"""
PILLAR = '<geom name="pillar" type="box" size=".03 .03 .3" pos="{}"/>'


def job_in(folder, arm: str = toy.ARM) -> dict:
    """Job of the toy arm: half a circle about a disc of points on a turntable, next to a pillar in the world."""
    light = '<compiler boundmass="1e-6" boundinertia="1e-6"/>'
    xml = arm.replace("<worldbody>", light + PART.format("table") + "<worldbody>")
    xml = xml.replace("</worldbody>", TURNTABLE + "</worldbody>")
    (folder / "cell.xml").write_text(xml)
    (folder / "world.xml").write_text(f"<mujoco><worldbody>{PILLAR.format('.35 .3 .5')}</worldbody></mujoco>")
    angle, radius = np.meshgrid(np.linspace(0, 6, 24), np.linspace(0.02, 0.12, 6))
    disc = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(radius.shape, 0.05)], axis=-1)
    turn = np.linspace(-1.5, 1.5, 7)
    path = np.stack([0.1 * np.cos(turn), 0.1 * np.sin(turn), np.full(7, 0.09)], axis=1)
    for name, points in (("disc.xyz", disc.reshape(-1, 3)), ("path.csv", path)):
        np.savetxt(folder / name, points, delimiter=",")
    part = {"cloud": str(folder / "disc.xyz"), "path": str(folder / "path.csv"), "interior": "none"}
    return {
        "robot": {"model": str(folder / "cell.xml")},
        "workpiece": part | {"tip_contact_m": None},
        "cell": {"model": str(folder / "world.xml")},
        "start_rad": "auto",
        "program": {"velocity": [1.0] * 5},
        "settings": dataclasses.replace(toy.SETTINGS, q_weights=(1.0,) * 5),
    }


def composed_in(folder, job: dict) -> dict:
    """The same job with the arm and the turntable in separate files."""
    (folder / "arm.xml").write_text(toy.ARM)
    stand = '<body name="stand" pos="0.55 0 0.15">'
    assert stand in TURNTABLE
    turntable = TURNTABLE.replace(stand, '<body name="stand" pos="0.55 0 0">')
    xml = HEAD.replace(' angle="radian"', "") + f"<worldbody>{turntable}</worldbody></mujoco>"
    (folder / "turntable.xml").write_text(xml)
    return job | {
        "robot": {"model": str(folder / "arm.xml")},
        "positioner": {"model": str(folder / "turntable.xml"), "base_m": [0.0, 0.0, 0.15]},
        "workpiece": {**job["workpiece"], "parent": "positioner.table"},
    }


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    return job_in(tmp_path_factory.mktemp("turntable"))


@pytest.fixture(scope="module")
def planned(job):
    """A plan; all plans of this file share its programs."""
    plan = htcp_jax.plan(job)
    assert plan.complete, plan.failure()
    return plan


@pytest.fixture(scope="module")
def folder(job, planned):
    """Folder with the job's files and the saved plan."""
    folder = Path(job["robot"]["model"]).parent
    planned.save(folder / "plan")
    return folder


def test_a_plan_with_a_turntable_is_confirmed_in_mujocos_tree_and_refuted_with_the_pillar_elsewhere(
    planned, folder, tmp_path
):
    assert np.ptp(planned.plans.x[0, :, 0]) > 0.1  # the table turns
    found = validate_results(folder / "plan")
    assert found.validated, found.refuted[:3]
    shutil.copytree(folder / "plan", tmp_path / "plan")
    summary = json.loads((tmp_path / "plan/summary.json").read_text())
    summary["config"]["settings"]["max_joint_step_rad"] = 0.01
    summary["config"]["cell"]["shift_m"] = [0.1, -0.3, 0.0]
    (tmp_path / "plan/summary.json").write_text(json.dumps(summary))
    found = validate_results(tmp_path / "plan")
    assert not found.validated
    for reason in ("on the segment, more than the job allows", "in collision"):
        assert any(reason in each.reason for each in found.refuted), reason


def test_the_plan_of_a_composed_cell_is_that_of_the_same_tree_in_one_file(planned, job, tmp_path):
    composed = htcp_jax.plan(composed_in(tmp_path, job))
    np.testing.assert_array_equal(np.asarray(composed.plans.x), np.asarray(planned.plans.x))
    composed.save(tmp_path / "plan")
    found = validate_results(tmp_path / "plan")
    assert found.validated, found.refuted[:3]
    made = program_of(open_plans(tmp_path / "plan"), 0.02)
    assert all(name in made.text("ros", "weld") for name in ("turn", "j1", "j4")) and made.text("keyframes", "weld")
    summary = json.loads((tmp_path / "plan/summary.json").read_text())
    summary["config"]["positioner"]["base_m"] = [0.0, 0.02, 0.15]
    (tmp_path / "plan/summary.json").write_text(json.dumps(summary))
    assert not validate_results(tmp_path / "plan").validated


LEANING = toy.ARM.replace('<joint name="j2"', '<joint name="lean" axis="1 0 0" range="-90 90"/><joint name="j2"')


def test_a_plan_with_a_locked_joint_is_confirmed_in_mujocos_tree_and_its_key_frames_hold_the_joint(tmp_path):
    job = job_in(tmp_path, arm=LEANING)
    job["robot"]["locked"] = {"lean": 0.2}
    plan = htcp_jax.plan(job)
    assert plan.robot.joint_names == ("turn", "j1", "j2", "j3", "j4") and plan.complete, plan.failure()
    plan.save(tmp_path / "plan")
    assert validate_results(tmp_path / "plan").validated
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "cell.xml"))
    made = program_of(open_plans(tmp_path / "plan"), 0.02)
    data, keys = mujoco.MjData(model), ElementTree.fromstring(made.text("keyframes", "weld")).findall(".//key")
    data.qpos[:] = [float(number) for number in keys[3].get("qpos").split()]
    assert data.joint("lean").qpos[0] == 0.2
    found = [data.joint(name).qpos[0] for name in plan.robot.joint_names]
    assert found == made.timed("keyframes").rounded.x[3].tolist()


def test_the_world_is_as_far_from_the_arm_as_it_stands_whatever_the_table_does(job):
    config = load_config(job)
    robot = build.robot_of(config.robot, config.cell)
    x = np.random.default_rng(0).uniform(-1, 1, (50, 5))
    still = x.copy()
    still[:, 0] = 0.3
    arm = MujocoArm(Path(job["robot"]["model"]))
    p, _ = made_once.quick_jit(jax.vmap(kinematics.capsule_segments, (None, 0)))(robot, np.vstack([x, still]))
    p = np.asarray(p)
    np.testing.assert_allclose(p[:50, : len(arm.names)], arm.arm_poses(x).p, atol=1e-9)
    pillar, hand = robot.capsule_names.index("pillar"), robot.capsule_names.index("tool")
    apart = np.linalg.norm(p[:, pillar] - p[:, hand], axis=1)
    np.testing.assert_allclose(apart[:50], apart[50:], atol=1e-9)


def test_a_sweep_of_the_mounting_on_the_table_keeps_the_world(job):
    sweep = load_sweep({"grid": [{"workpiece.shift_m.x": [0.0, 0.01]}, {"cell.shift_m.y": [0.0, 0.02]}]}, job)
    batch = sweep.batch()
    assert [len(cell.robot.attached) for cell in batch.cells] == [len(batch.robot.attached)] * len(batch.cells)
    places = {tuple(np.asarray(cell.robot.capsule_p)[cell.robot.attached[0]].tolist()) for cell in batch.cells}
    assert batch.robot.attached and len(places) == 2


def test_programs_have_all_joints_by_name_and_key_frames_are_in_the_order_of_the_file(planned, folder):
    made = program_of(open_plans(folder / "plan"), 0.02)
    names = ["turn", "j1", "j2", "j3", "j4"]
    assert list(planned.robot.joint_names) == names
    assert all(name in made.text(format, "weld") for name in names for format in ("csv", "ros", "keyframes"))
    model = mujoco.MjModel.from_xml_path(str(folder / "cell.xml"))
    data, keys = mujoco.MjData(model), ElementTree.fromstring(made.text("keyframes", "weld")).findall(".//key")
    timed = made.timed("keyframes")
    data.qpos[:] = [float(number) for number in keys[3].get("qpos").split()]
    assert [data.joint(name).qpos[0] for name in names] == timed.rounded.x[3].tolist()
    for name in ("jbi", "urscript"):
        with pytest.raises(
            InputError, match=f"{name} has no external axes, which a moving part needs; valid: csv, ros"
        ):
            made.text(name, "weld")

    def with_groups(groups):
        pulses = "program.pulses={per_rad: [1e4, 1e4, 1e4, 1e4, 1e4], source: a drawing}"
        return program_of(open_plans(folder / "plan"), 0.02, overrides=[pulses, groups])

    for groups, said in (
        ("null", "jbi-pulses: the part moves; set program.groups to the joints of robot, base and station"),
        ("{robot: [j1, j2, j3], station: [turn]}", "program.groups has 'j4' 0 times; each joint must be in one group"),
        ("{robot: [j1, j2, j3, j4], station: [tilt]}", "program.groups: 'tilt' is not a joint; valid: turn, j1, j2"),
    ):
        with pytest.raises(InputError, match=re.escape(said)):
            with_groups(f"program.groups={groups}").text("jbi-pulses", "weld")
    made = with_groups("program.groups={robot: [j1, j2, j3, j4], station: [turn]}")
    assert "+MOVJ EC00000" in made.text("jbi-pulses", "weld")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"robot.base_m": [0, 0, 1]}, "the part moves, so robot.base_m and base_rpy_rad must be 0"),
        ({"cell.self_collision": False}, "self_collision must be true, because 'pillar' moves relative to the part"),
        ({"workpiece.inlet_direction": "world-x"}, "inlet_direction is world-x, but the part moves"),
        ({"task": [{"axis": "tcp.z", "looks_at_m": [0, 0, 1]}]}, "task.1: frame is world, but the part moves"),
        (
            {"cell.clouds": [{"cloud": "disc.xyz"}]},
            "'disc' is a cloud of points; only a box or a mesh can move with a link",
        ),
        ({"cell.model": "floor.xml"}, "is a plane; only a box or a mesh can move with a link"),
    ],
)
def test_what_cannot_move_with_the_world_is_refused_in_one_line(change, message, tmp_path, monkeypatch):
    job = job_in(tmp_path)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "floor.xml").write_text(
        '<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/></worldbody></mujoco>'
    )
    with pytest.raises(InputError) as error:
        config = load_config(job, change)
        robot, *_ = build.scene(config)
        build.obstacles_of(config.cell, robot)
    assert message in str(error.value) and "\n" not in str(error.value)


def test_torques_are_those_of_the_tree_as_it_stands(tmp_path):
    inertia = '<inertial pos=".05 0 .1" mass="2" diaginertia=".1 .1 .1"/>'
    xml = CELLS["a rail below the arm, and a positioner"].replace("<geom", inertia + "<geom")
    lighter = inertia.replace('mass="2"', 'mass="1.5"')  # equal masses of all links would be placeholders
    xml = xml.replace('<body name="car">', f'<body name="car">{lighter}').replace(
        'boundmass="1e-6" boundinertia="1e-6"', ""
    )
    (tmp_path / "cell.xml").write_text(xml)
    names = load_robot(tmp_path / "cell.xml").joint_names
    model = mujoco.MjModel.from_xml_string(xml)
    data, order = mujoco.MjData(model), [model.joint(name).id for name in names]
    x, v, a = np.random.default_rng(0).uniform(-0.1, 0.1, (3, 1, 7))
    data.qpos[order], data.qvel[order], data.qacc[order] = x[0], v[0], a[0]
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    mujoco.mj_inverse(model, data)
    found = torques(model_of(RobotConfig(model=str(tmp_path / "cell.xml"))))(x, v, a)
    np.testing.assert_allclose(found[0], data.qfrc_inverse[order], atol=1e-6)


# Import

SHAPES = (
    CELLS["a rail below the arm, and a positioner"]
    .replace(PART.format("table"), "")
    .replace('<geom name="plate" type="sphere" size=".05"/>', '<geom name="plate" type="box" size=".1 .1 .01"/>')
)


def test_an_imported_cell_stands_as_the_model_does_and_reads_back_with_its_part_and_tcp(tmp_path, capsys):
    (tmp_path / "model.xml").write_text(SHAPES)
    out = tmp_path / "cell.xml"
    assert (
        main(["cell", str(tmp_path / "model.xml"), "--tool", "tcp", "--part", "table", "--out", str(out), "--json"])
        == 0
    )
    facts = json.loads(capsys.readouterr().out)
    assert facts["part"] == "table" and facts["joints"] == ["b3", "b2", "b1", "rail", "a1", "a2", "a3"]
    assert facts["chain"].endswith("-a1- link1 -a2- link2 -a3- link3")
    assert (tmp_path / "cell.png").stat().st_size > 0
    made, given = mujoco.MjModel.from_xml_path(str(out)), mujoco.MjModel.from_xml_string(SHAPES)
    poses = []
    for model in (made, given):
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        poses.append(np.vstack([data.body(name).xpos for name in ("tilt", "table", "link3")]))
        poses.append(data.site("tcp").xmat)
    np.testing.assert_allclose(poses[0], poses[2], atol=1e-9)
    np.testing.assert_allclose(poses[1], poses[3], atol=1e-9)
    robot = load_robot(out)
    x = np.random.default_rng(2).uniform(robot.lower, robot.upper, (20, 7))
    np.testing.assert_allclose(by_chain(robot, x)[0], in_mujoco(SHAPES, robot.joint_names, "table", x)[0], atol=1e-9)


def test_meshes_of_a_cell_are_placed_from_the_part(tmp_path):
    (tmp_path / "model.xml").write_text(SHAPES)
    arm = import_robot(tmp_path / "model.xml", "tcp", part="table")
    x = np.array([[0.05, 0.3, -0.2, 0.4, 0.1, -0.3, 0.2]])
    model = mujoco.MjModel.from_xml_string(SHAPES)
    data = mujoco.MjData(model)
    for name, value in zip(arm.joint_names, x[0], strict=True):
        data.joint(name).qpos = value
    mujoco.mj_kinematics(model, data)
    found = LinkMeshes.of(arm).poses(x)
    np.testing.assert_allclose(found.position[0, arm.model.body("link3").id], data.body("link3").xpos, atol=1e-9)


@pytest.mark.parametrize(
    ("tool", "part", "more", "message"),
    [
        ("tcp", "bench", [], "--part: no link 'bench'; valid: world, tilt, table"),
        ("hook", "table", [], "no site or body 'hook' for the TCP"),
        ("table", "table", [], "both are on link 'table'"),
        ("link3", "link2", ["--fix", "a3=0"], "no joint between the part's link 'link2' and the TCP 'link3'"),
        ("tcp", "link2", [], "1 joints from the part's link 'link2' to the TCP; at least 3 are needed"),
        ("tcp", "table", ["--omit", "bench"], "--omit: no link 'bench'"),
        ("far", "table", [], "10 joints from the part's link 'table' to the TCP; at most 9 are supported"),
    ],
)
def test_a_part_or_tool_that_makes_no_chain_is_refused_in_one_line(tool, part, more, message, tmp_path, capsys):
    ends = "".join(f'<body name="{name}"><joint axis="1 0 0" range="-1 1"/>' for name in ("n1", "n2", "far"))
    (tmp_path / "model.xml").write_text(SHAPES.replace(TCP, TCP + ends + 3 * "</body>" if tool == "far" else TCP))
    given = ["cell", str(tmp_path / "model.xml"), "--tool", tool, "--part", part, "--out", str(tmp_path / "cell.xml")]
    assert main([*given, *more]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert message in error, error
    assert not (tmp_path / "cell.xml").exists()


LOCKED = {"b3": 0.1, "b1": -0.4}


def test_a_cell_with_locked_joints_moves_as_mujocos_tree_with_these_joints_at_their_values(tmp_path):
    (tmp_path / "cell.xml").write_text(CELLS["a rail below the arm, and a positioner"])
    robot = load_robot(tmp_path / "cell.xml", locked=LOCKED)
    assert robot.joint_names == ("b2", "rail", "a1", "a2", "a3")
    x = np.random.default_rng(1).uniform(robot.lower, robot.upper, (200, 5))
    names = (*robot.joint_names, *LOCKED)
    values = np.column_stack([x, np.tile(list(LOCKED.values()), (200, 1))])
    xml = CELLS["a rail below the arm, and a positioner"]
    position, axes, jacobian, middles = in_mujoco(xml, names, "table", values)
    for ours, theirs in zip(by_chain(robot, x), (position, axes, jacobian[..., :5], middles), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)


def test_validation_holds_locked_joints_at_their_values(tmp_path):
    (tmp_path / "cell.xml").write_text(CELLS["a rail below the arm, and a positioner"])
    robot, arm = load_robot(tmp_path / "cell.xml", locked=LOCKED), MujocoArm(tmp_path / "cell.xml", locked=LOCKED)
    assert arm.joints == robot.joint_names
    x = arm.random(200, seed=3)
    *_, middles = by_chain(robot, x)
    posed = arm.arm_poses(x)
    np.testing.assert_allclose((posed.p + posed.q) / 2, middles, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("locked", "words"),
    [
        ("{b9: 0}", "robot.locked: no hinge or slide joint 'b9'; valid: "),
        ("{b1: 2}", "b1=2 is outside the joint's limits, -1 to 1.2 rad"),
        ("{b1: far}", "robot.locked"),
        ("[b1]", "must be a mapping of joints to positions; valid: {JOINT: VALUE, ...}"),
        ("{b1: 0, b2: 0, b3: 0, rail: 0, a1: 0, a2: 0, a3: 0}", "no joint between the part's link 'table' and the TCP"),
    ],
)
def test_bad_locked_joints_are_named_in_one_line(tmp_path, capsys, locked, words):
    (tmp_path / "cell.xml").write_text(CELLS["a rail below the arm, and a positioner"])
    (tmp_path / "job.yaml").write_text(
        f"robot: {{model: cell.xml, locked: {locked}}}\n"
        "start_rad: [0, 0, 0, 0, 0]\nworkpiece: {cloud: none, path: weld}\n"
    )
    assert main(["plan", str(tmp_path / "job.yaml"), "--out", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert words in message and message.count("\n") == 1


def test_a_sweep_varies_a_locked_joint_by_its_name(job):
    job = job | {"robot": job["robot"] | {"locked": {"turn": 0.0}}, "start_rad": [0.0] * 4}
    job |= {"program": {"velocity": [1.0] * 4}, "settings": dataclasses.replace(toy.SETTINGS, q_weights=(1.0,) * 4)}
    spec = load_sweep({"grid": [{"robot.locked.turn": [0.0, 0.4]}]}, job)
    assert [point.config.robot.locked for point in spec.points()] == [(("turn", 0.0),), (("turn", 0.4),)]
    batch = spec.batch()
    offset = [by_chain(cell.robot, np.zeros((1, 4)))[0][0, 0] for cell in batch.cells]
    assert len(batch.cells) == 2 and offset[0] != offset[1]
    with pytest.raises(InputError, match=r"robot.locked.tilt: robot.locked has no joint tilt; valid: turn"):
        list(load_sweep({"grid": [{"robot.locked.tilt": [0.0]}]}, job).points())
