"""Cells composed of several models in a job, next to the same tree written by hand."""

import dataclasses
import json

import numpy as np
import pytest
import toy
from scipy.spatial.transform import Rotation
from test_moving_part import ARM, HEAD, TABLE, TCP, by_chain, cell_of, composed_in, in_mujoco, job_in

from htcp_jax.clearance.obstacles.self_collision import make_self_collision
from htcp_jax.cli.main import main
from htcp_jax.errors import InputError
from htcp_jax.io.robots import LinkMeshes, load_robot
from htcp_jax.jobs import build, load_config
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.runs.identity import identity
from htcp_jax.runs.input_files import anchor_files, file_hashes
from htcp_jax.trajectory.plan_program import planned_tcp
from htcp_jax.validation.mujoco_arm import MujocoArm
from htcp_jax.validation.mujoco_cell import MujocoCell

URDF = """<robot name="track"><link name="floor"/><link name="car"/>
<joint name="rail" type="prismatic"><parent link="floor"/><child link="car"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" velocity="0.5" effort="100"/></joint></robot>"""


def model_of(*bodies: str) -> str:
    return HEAD + f"<worldbody>{''.join(bodies)}</worldbody></mujoco>"


@pytest.fixture
def models(tmp_path):
    """An arm, a positioner and a rail in separate files, and the cell that they form, written by hand."""
    (tmp_path / "arm.xml").write_text(model_of(ARM.format(TCP)))
    (tmp_path / "positioner.xml").write_text(model_of(TABLE))
    (tmp_path / "rail.urdf").write_text(URDF)
    rail = '<body name="floor" pos="0 .2 0" quat=".9 0 .1 0"><body name="car">{}</body></body>'.format(
        '<joint name="rail" type="slide" axis="0 1 0" range="-2 2"/>'
        f'<body pos="0 0 .5" euler="0 0 .3">{ARM.format(TCP)}</body>'
    )
    table = f'<body pos=".1 .2 .3" euler="0.1 0.2 0.3">{TABLE}</body>'
    whole = cell_of("table", rail, table).replace('angle="radian"', 'angle="radian" eulerseq="XYZ"')
    (tmp_path / "whole.xml").write_text(whole)
    return {
        "robot": {
            "model": str(tmp_path / "arm.xml"),
            "parent": "rail.car",
            "base_m": [0, 0, 0.5],
            "base_rpy_rad": [0, 0, 0.3],
        },
        "rail": {
            "model": str(tmp_path / "rail.urdf"),
            "base_m": [0, 0.2, 0],
            "base_rpy_rad": [0, 2 * np.arctan2(0.1, 0.9), 0],
        },
        "positioner": {
            "model": str(tmp_path / "positioner.xml"),
            "base_m": [0.1, 0.2, 0.3],
            "base_rpy_rad": [0.1, 0.2, 0.3],
        },
        "workpiece": {"cloud": "none", "path": "path.csv", "parent": "positioner.table"},
        "start_rad": [0.0] * 7,
    }


def robot_of(job):
    config = load_config(job)
    return build.robot_of(config.robot, config.cell, config.tree)


def test_composed_models_move_as_the_same_tree_written_by_hand_in_mujoco(models, tmp_path):
    robot = robot_of(models)
    assert robot.joint_names == ("b3", "b2", "b1", "rail", "a1", "a2", "a3") and robot.part_moves
    assert robot.capsule_names == ("trunk", "boom", "tip", "positioner.yoke", "positioner.plate")
    x = np.random.default_rng(1).uniform(robot.lower, robot.upper, (1000, 7))
    expected = in_mujoco((tmp_path / "whole.xml").read_text(), robot.joint_names, "table", x)
    for ours, theirs in zip(by_chain(robot, x), expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)
    config = load_config(models)
    arm = MujocoArm(config.tree)
    assert arm.joints == robot.joint_names and arm.names == robot.capsule_names
    np.testing.assert_allclose(arm.arm_poses(x[:20]).tcp, expected[0][:20], rtol=0, atol=1e-9)


LISTED = """<custom><text name="self_collision" data="2 pairs"/>
<tuple name="excluded 1, rule c">
<element objtype="geom" objname="tip" prm=".1"/><element objtype="geom" objname="trunk"/></tuple>
<tuple name="excluded 2, rule b">
<element objtype="geom" objname="tip" prm="1"/><element objtype="geom" objname="boom"/></tuple>
<numeric name="speed" data="1 2 3"/>
<text name="piece of boom" data="0 0 0; .4 0 0; .1 .01 0; .1 0 .01"/><numeric name="radius of boom" data=".01"/>
</custom>"""


def test_a_models_own_list_convex_pieces_and_joint_speeds_hold_in_the_composed_cell(models, tmp_path):
    listed = model_of(ARM.format(TCP)).replace("<worldbody>", LISTED + "<worldbody>")
    (tmp_path / "arm.xml").write_text(listed)
    alone, robot = load_robot(tmp_path / "arm.xml"), robot_of(models)
    excluded = {tuple(sorted((robot.capsule_names[a], robot.capsule_names[b]))) for a, b, *_ in robot.exclusions}
    assert excluded == {("tip", "trunk"), ("boom", "tip")}
    found = make_self_collision(robot)
    checked = {frozenset((robot.capsule_names[a], robot.capsule_names[b])) for a, b in found.pairs}
    assert {"trunk", "boom"} in checked  # adjacent and overlapping, but the arm's list does not exclude it
    assert {"positioner.plate", "tip"} in checked
    unlisted = robot_of(models | {"robot": {**models["robot"], "limits": "simulation"}})
    assert not unlisted.exclusions  # limits wider than the model's
    assert dict(zip(robot.joint_names, robot.speed.tolist(), strict=True)) == {
        **dict.fromkeys(("b1", "b2", "b3"), np.inf),
        "rail": 0.5,
        "a1": 1.0,
        "a2": 2.0,
        "a3": 3.0,
    }
    own = alone.pieces.excess_m.tolist()
    assert own[1] > 0 and robot.pieces.excess_m.tolist() == [*own, 0, 0]
    arm = MujocoArm(load_config(models).tree)
    theirs = MujocoCell(load_config(models).cell, arm, arm)._own
    named = [{frozenset((arm.names[a], arm.names[b])) for a, b in pairs} for pairs in (theirs.checked, theirs.excluded)]
    assert named[0] == checked and {"tip", "trunk"} in named[1]


def test_bodies_that_a_model_excludes_from_its_own_world_are_not_excluded_from_the_cells(models, tmp_path):
    plinth = '<geom name="plinth" type="capsule" fromto="0 .1 0 0 .1 .3" size=".06"/>'
    excluded = '<contact><exclude body1="world" body2="link1"/></contact></mujoco>'
    (tmp_path / "arm.xml").write_text(model_of(plinth, ARM.format(TCP)).replace("</mujoco>", excluded))
    post = '<geom name="post" type="capsule" fromto="0 .5 0 0 .5 .3" size=".02"/>'
    (tmp_path / "positioner.xml").write_text(model_of(post, TABLE))
    job = models | {"robot": {"model": str(tmp_path / "arm.xml")}, "start_rad": [0.0] * 6}
    del job["rail"]
    robot, config = robot_of(job), load_config(job)
    pairs = [{robot.capsule_names[a], robot.capsule_names[b]} for a, b, *_ in robot.exclusions]
    assert pairs == [{"plinth", "trunk"}] and [each.rule for each in robot.exclusions] == ["a"]
    arm = MujocoArm(config.tree)
    own = MujocoCell(config.cell, arm, arm)._own
    checked = [{arm.names[a], arm.names[b]} for a, b in own.checked]
    assert {"positioner.post", "boom"} in checked and {"plinth", "trunk"} not in checked


def test_a_positioner_with_boxes_is_imported_without_a_tool_and_composed(models, tmp_path, capsys):
    plate = '<geom name="plate" type="sphere" size=".05"/>'
    assert plate in TABLE
    boxes = TABLE.replace(plate, '<geom name="plate" type="box" size=".1 .1 .01"/>').replace(
        '<joint name="b3" type="slide" axis="0 1 1" range="-.1 .2" ref=".03"/>', ""
    )
    (tmp_path / "vendor.xml").write_text(model_of(boxes))
    made = tmp_path / "made.xml"
    assert main(["cell", str(tmp_path / "vendor.xml"), "--part", "table", "--out", str(made), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["joints"] == ["b1", "b2"]
    job = models | {"positioner": {"model": str(made)}, "start_rad": [0.0] * 6}
    robot = robot_of(job)
    assert robot.joint_names == ("b2", "b1", "rail", "a1", "a2", "a3")
    assert {"positioner.yoke", "positioner.table"} <= set(robot.capsule_names)
    x = np.zeros((1, 6))
    meshes = LinkMeshes.read(load_config(job).tree)  # of the positioner alone
    assert meshes.deepest_m("positioner.table", "tip", meshes.poses(x)) == 0
    with pytest.raises(InputError, match="2 joints from the world to the TCP; at least 3 are needed"):
        load_robot(made)


# A job: the toy arm next to a turntable. Its plan is compared in test_moving_part.py.


@pytest.fixture
def composed(tmp_path):
    """A job without points, whose cell is composed of an arm's and a turntable's model."""
    job = job_in(tmp_path)
    del job["cell"]
    return composed_in(tmp_path, job | {"workpiece": {"cloud": "none", "path": job["workpiece"]["path"]}})


def test_a_sweep_varies_base_poses_and_locked_joints_of_a_composed_cell(composed):
    composed |= {"start_rad": [0.0] * 4, "program": {"velocity": [1.0] * 4}}
    composed["settings"] = dataclasses.replace(toy.SETTINGS, q_weights=(1.0,) * 4)
    composed["robot"] = composed["robot"] | {"locked": {"turn": 0.0}}
    axes = [{"positioner.base_m.z": [0.15, 0.2]}, {"robot.locked.turn": [0.0, 0.4]}]
    batch = load_sweep({"grid": axes}, composed).batch()
    assert [point.config.tree.models[1].base_m[2] for point in batch.points] == [0.15, 0.15, 0.2, 0.2]
    tcp = np.array([by_chain(batch.cells[k].robot, np.zeros((1, 4)))[0][0] for k in batch.cell])
    np.testing.assert_allclose(tcp[:2, 2] - tcp[2:, 2], 0.05, atol=1e-12)  # seen from the part
    np.testing.assert_allclose(tcp[0, :2] @ tcp[1, :2], np.cos(0.4) * (tcp[0, :2] @ tcp[0, :2]), atol=1e-12)


def test_the_part_in_the_hand_at_a_tool_that_stands_in_the_world(models, tmp_path):
    tool = '<geom name="wheel" type="capsule" fromto="0 0 0 0 0 .4" size=".03"/><site name="tcp" pos="0 0 .45"/>'
    (tmp_path / "grinder.xml").write_text(HEAD + f"<worldbody>{tool}</worldbody></mujoco>")
    site = '<site name="flange" pos=".35 0 0" euler=".1 .2 .3"/>'
    (tmp_path / "arm.xml").write_text(model_of(ARM.format(site)))
    job = {
        "robot": {"model": str(tmp_path / "arm.xml")},
        "tool": {"model": str(tmp_path / "grinder.xml"), "base_m": [0.5, 0.1, 0]},
        "workpiece": models["workpiece"] | {"parent": "robot.flange"},
        "start_rad": [0.0] * 3,
    }
    robot = robot_of(job)
    hand = '<body name="flange" pos=".35 0 0" euler=".1 .2 .3"/>'
    whole = cell_of("flange", f'<body pos=".5 .1 0">{tool}</body>', ARM.format(hand))
    x = np.random.default_rng(2).uniform(robot.lower, robot.upper, (50, 3))
    expected = in_mujoco(whole, robot.joint_names, "flange", x)
    for ours, theirs in zip(by_chain(robot, x)[:3], expected[:3], strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"workpiece.parent": "positioner.bench"},
            "workpiece.parent: no link 'bench' in positioner.xml; valid: tilt, table",
        ),
        (
            {"workpiece.parent": "link9"},
            "workpiece.parent: no link 'link9' in arm.xml; valid: link1, link2, link3, tcp",
        ),
        (
            {"robot.tcp": "torch"},
            "no site or body 'torch' for the TCP; sites of the model: tcp; bodies: rail.floor, rail.car, link1",
        ),
        ({"robot.parent": "rail.cart"}, "robot.parent: no link 'cart' in rail.urdf; valid: floor, car"),
        (
            {"robot.parent": "tool.flange"},
            "robot.parent is on the tool, but tool.model is missing; set it, or choose: world, ",
        ),
        ({"workpiece.parent": "tool.tip"}, "workpiece.parent is on the tool, but tool.model"),
        ({"rail.parent": "link3"}, "the parents form a circle: robot -> rail -> robot"),
        ({"robot.parent": "link3"}, "the parents form a circle: robot -> robot"),
        ({"workpiece.parent": "link3"}, "no joint between the part's link 'link3' and the TCP: both are on 'link3'"),
        (
            {"robot.locked": {"a2": 0, "a3": 0}, "workpiece.parent": "link1"},
            "no joint between the part's link 'link1' and",
        ),
        ({"workpiece.parent": "world"}, "joints off the chain from the world to the TCP: b1, b2, b3; freeze them"),
        ({"tool.base_m": [0, 0, 1]}, "tool: base_m is set, but model is missing"),
        ({"tool.model": "positioner.xml"}, "joint 'b1' is in positioner.model (positioner.xml) and in tool.model"),
        ({"tool.model": "long.xml", "tool.parent": "link3", "robot.tcp": "tool.far"}, "10 joints from the part's link"),
        ({"rail.model": "none.urdf"}, "none.urdf: cannot read the model: No such file"),
    ],
)
def test_models_that_form_no_chain_are_refused_in_one_line(change, message, models, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    far = "".join(f'<body name="{name}"><joint axis="1 0 0" range="-1 1"/>' for name in ("n1", "n2", "far"))
    (tmp_path / "long.xml").write_text(model_of(far + 3 * "</body>"))
    np.savetxt(tmp_path / "path.csv", np.zeros((3, 3)), delimiter=",")
    names = {section: {"model": f"{section}.xml"} for section in ("positioner",)}
    names |= {"robot": {"model": "arm.xml"}, "rail": {"model": "rail.urdf"}}
    job = {key: value | names.get(key, {}) if isinstance(value, dict) else value for key, value in models.items()}
    (tmp_path / "job.json").write_text(json.dumps(job))
    given = [f"--set={key}={json.dumps(value)}" for key, value in change.items()]
    assert main(["plan", "job.json", *given, "--out", "out"]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1, error
    assert not (tmp_path / "out").exists()


def test_a_job_of_one_model_keeps_its_identity_and_the_files_of_a_composed_cell_are_part_of_it(composed):
    config = load_config().model_dump(mode="json")
    before = {key: value for key, value in config.items() if key not in ("positioner", "rail", "tool")}
    for section in ("robot", "workpiece"):
        before[section] = {key: value for key, value in before[section].items() if key != "parent"}
    assert identity(config, [], "float64", {}) == identity(before, [], "float64", {})
    composed = load_config(composed).model_dump(mode="json")
    files = file_hashes(anchor_files(composed))
    assert composed["positioner"]["model"] in files
    other = {**composed, "positioner": {**composed["positioner"], "base_m": [0, 0, 1]}}
    assert identity(composed, [], "float64", files) != identity(other, [], "float64", files)


def test_all_joints_of_an_indexed_model_are_indexed_and_no_others(models):
    robot = robot_of(models | {"positioner": models["positioner"] | {"indexed": True}})
    assert robot.indexed == {"b1", "b2", "b3"}
    robot = robot_of(
        models | {"rail": models["rail"] | {"indexed": True}, "robot": models["robot"] | {"indexed": ["a1"]}}
    )
    assert robot.indexed == {"rail", "a1"} and not robot_of(models).indexed
    lock = {"locked": {"b1": 0.0, "b2": 0.0}}
    robot = robot_of(
        models
        | {"positioner": models["positioner"] | {"indexed": True}, "robot": models["robot"] | lock}
        | {"start_rad": [0.0] * 5}
    )
    assert robot.indexed == {"b3"}


def test_a_programs_tcp_is_stated_in_the_frame_that_carries_the_tool(models, tmp_path):
    """As a controller needs it, whose tool data are relative to the flange, not to the last joint."""
    T_tip = np.eye(4)
    T_tip[:3, :3], T_tip[:3, 3] = Rotation.from_euler("XYZ", [0.2, 0.7, -0.1]).as_matrix(), [0.01, -0.02, 0.3]
    tip = '<site name="tcp" pos="0.01 -0.02 0.3" euler="0.2 0.7 -0.1"/>'
    wire = f'<geom name="wire" type="capsule" fromto="0 0 0 0 0 .2" size=".01"/>{tip}'
    (tmp_path / "torch.xml").write_text(model_of(wire))
    (tmp_path / "arm.xml").write_text(model_of(ARM.format('<site name="tcp" pos=".35 0 0" euler=".1 .2 .3"/>')))
    job = {
        "robot": {"model": str(tmp_path / "arm.xml")},
        "tool": {"model": str(tmp_path / "torch.xml"), "parent": "robot.tcp"},
        "workpiece": {"cloud": "none", "path": "path.csv"},
        "start_rad": [0.0] * 3,
    }
    stated = planned_tcp(load_config(job), robot_of(job))
    assert stated.frame == "tcp, which carries the tool"
    np.testing.assert_allclose(stated.T_frame_tcp, T_tip, atol=1e-9)
