"""`htcp robot --fix`: joints that are frozen at a value; compared with MuJoCo's reading of the whole model."""

import json

import mujoco
import numpy as np
import pytest

from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.io.robots import load_robot

# Two joints on one body, with anchors and a joint that is drawn turned; a slide; two fingers, of which one follows.
MJCF = """
<mujoco model="toy"><compiler angle="radian"/><worldbody>
  <body name="a" pos="0.1 0 0.2" euler="0.1 0.2 0.3">
    <joint name="pan" axis="0 0 1" pos="0 0.1 0" range="-3 3"/>
    <joint name="tilt" axis="0 1 0" pos="0.05 0 0" ref="0.4" range="-1 2"/>
    <geom name="upper" type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
    <body name="b" pos="0.3 0 0"><joint name="reach" type="slide" axis="1 0 0" range="0 0.2"/>
      <geom name="middle" size="0.03"/>
      <body name="c" pos="0.2 0 0"><joint name="bend" axis="0 1 0"/><geom name="lower" size="0.03"/>
        <body name="d" pos="0.1 0 0"><joint name="roll" axis="1 0 0"/><geom name="hand" size="0.03"/>
          <site name="tcp" pos="0 0.1 0.2"/></body></body></body></body>
</worldbody></mujoco>"""
FINGER = """<link name="{0}"><collision><origin xyz="0.1 0 0"/><geometry><sphere radius="0.01"/></geometry></collision>
  </link>
  <joint name="{0}" type="prismatic"><parent link="l3"/><child link="{0}"/><axis xyz="0 {1} 0"/>
    <limit lower="0" upper="0.04" velocity="1" effort="1"/>{2}</joint>"""
LINK = """<link name="l{1}"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
  <joint name="j{1}" type="revolute"><parent link="l{0}"/><child link="l{1}"/><origin xyz="0.3 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>"""
URDF = f"""<robot name="gripper"><link name="l0"/>{"".join(LINK.format(k, k + 1) for k in range(3))}
  {FINGER.format("left", 1, "")}{FINGER.format("right", -1, '<mimic joint="left" multiplier="0.5" offset="0.01"/>')}
  </robot>"""


@pytest.fixture
def toy(tmp_path):
    (tmp_path / "toy.xml").write_text(MJCF)
    (tmp_path / "gripper.urdf").write_text(URDF)
    return tmp_path


def imported(folder, model, *words, capsys):
    """The command's JSON, and the arm that it wrote, as MuJoCo reads it."""
    out = folder / "arm.xml"
    assert main(["robot", str(folder / model), "--out", str(out), "--json", "--replace", *words]) == 0
    return json.loads(capsys.readouterr().out), mujoco.MjModel.from_xml_path(str(out))


def at(model, **joints) -> mujoco.MjData:
    data = mujoco.MjData(model)
    for name, value in joints.items():
        data.joint(name).qpos[:] = value
    mujoco.mj_kinematics(model, data)
    return data


@pytest.mark.parametrize(
    "fixed", [{"pan": 0.7}, {"tilt": -0.6}, {"pan": 0.7, "tilt": -0.6}, {"reach": 0.15}, {"bend": -9.0}], ids=str
)
def test_the_arm_moves_as_the_model_with_that_joint_held(toy, capsys, fixed):
    words = [word for name, value in fixed.items() for word in ("--fix", f"{name}={value}")]
    facts, arm = imported(toy, "toy.xml", *words, capsys=capsys)
    whole, x = mujoco.MjModel.from_xml_string(MJCF), {"pan": -0.4, "tilt": 1.1, "reach": 0.1, "bend": 2.0, "roll": 0.5}
    free = {name: value for name, value in x.items() if name not in fixed}
    assert facts["joints"] == list(free) and [arm.joint(j).name for j in range(arm.njnt)] == list(free)
    ours, theirs = at(arm, **free), at(whole, **x | fixed)
    np.testing.assert_allclose(ours.site("tcp").xpos, theirs.site("tcp").xpos, rtol=0, atol=1e-12)
    np.testing.assert_allclose(ours.site("tcp").xmat, theirs.site("tcp").xmat, rtol=0, atol=1e-12)
    for name in ("upper", "middle", "lower", "hand"):
        np.testing.assert_allclose(ours.geom(name).xpos, theirs.geom(name).xpos, rtol=0, atol=1e-12, err_msg=name)


def test_a_finger_is_opened_and_the_one_that_follows_it_too(toy, capsys):
    facts, arm = imported(toy, "gripper.urdf", "--tcp", "l3", "--fix", "left=0.03", capsys=capsys)
    assert facts["fixed"] == ["left=0.03", "right=0.025"] and not facts["frozen"]
    data = at(arm)
    np.testing.assert_allclose(data.geom("left").xpos - data.body("l3").xpos, [0.1, 0.03, 0], atol=1e-12)
    np.testing.assert_allclose(data.geom("right").xpos - data.body("l3").xpos, [0.1, -0.025, 0], atol=1e-12)
    assert "Frozen at a value: left=0.03, right=0.025." in (toy / "arm.xml").read_text()


def test_a_follower_may_be_named_only_with_the_value_that_its_master_gives(toy, capsys):
    words = ["--tcp", "l3", "--fix", "left=0.03", "--fix", "right=0.025"]
    assert imported(toy, "gripper.urdf", *words, capsys=capsys)[0]["fixed"] == ["left=0.03", "right=0.025"]


# A rod beside a moving joint, which it mimics through a crank, as in a parallel linkage.
CRANK = """<link name="crank"/><joint name="turn" type="continuous"><parent link="l1"/><child link="crank"/>
  <axis xyz="0 1 0"/><mimic joint="j2" multiplier="-1"/></joint>"""
ROD = """<link name="rod"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>
  <joint name="push" type="continuous"><parent link="crank"/><child link="rod"/><axis xyz="0 1 0"/>
  <mimic joint="turn"/></joint>"""
COUPLED = """<body name="rod"><joint name="push" axis="0 1 0" ref="0.5"/><geom size="0.01"/></body>
  </worldbody><equality><joint joint1="push" joint2="reach" polycoef="0 -1 0 0 0"/></equality>"""
LINKAGES = {
    "linkage.urdf": (URDF.replace("</robot>", CRANK + ROD + "</robot>"), ["turn = -j2", "push = turn"], "l3"),
    "linkage.xml": (MJCF.replace("</worldbody>", COUPLED), ["push = -reach + 0.5"], "tcp"),
}


@pytest.mark.parametrize("command", ["robot", "cell"])
@pytest.mark.parametrize("file", LINKAGES)
def test_a_rod_that_follows_a_moving_joint_has_capsules_until_it_is_omitted(tmp_path, capsys, file, command):
    text, follow, tcp = LINKAGES[file]
    (tmp_path / file).write_text(text)
    end = ["--tool", tcp, "--part", "world"] if command == "cell" else ["--tcp", tcp]
    words = [command, str(tmp_path / file), *end, "--out", str(tmp_path / "arm.xml"), "--replace", "--json"]
    assert main(words) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["followers"] == follow and "omitted" not in facts
    assert 'name="rod' in (tmp_path / "arm.xml").read_text().replace('<body name="rod', "")
    assert main([*words, "--omit", "rod"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["followers"] == follow and facts["omitted"] == ["rod"]
    assert load_robot(tmp_path / "arm.xml").omitted == ("rod",)
    assert 'name="rod' not in (tmp_path / "arm.xml").read_text().replace('<body name="rod', "")


ONE_LINE = {
    "elbow=1": "no hinge or slide joint 'elbow'; valid: pan, tilt, reach, bend, roll",
    "tilt=-1.01": "tilt=-1.01 is outside the joint's limits, -1 to 2 rad",
    "reach=0.3": "reach=0.3 is outside the joint's limits, 0 to 0.2 m",
    "tilt": "--fix tilt: it must be JOINT=VALUE with a number, in rad or m",
    "tilt=": "it must be JOINT=VALUE",
    "=1": "it must be JOINT=VALUE",
    "tilt=inf": "it must be JOINT=VALUE",
    "tilt=20deg": "it must be JOINT=VALUE",
    "pan=0": "--fix pan=0: pan is fixed twice",
}
FOLLOWER = {  # options that name a follower, and the end of the message
    ("right=0.01",): "right=0.01: this joint follows left; freeze that joint instead",
    ("right=0.01", "left=0.03"): "right=0.01: this joint follows left; it is at 0.025",
}


@pytest.mark.parametrize("option", ONE_LINE)
def test_bad_input_is_one_line_and_nothing_is_written(toy, capsys, option):
    words = ["--fix", "pan=0.1"] if option == "pan=0" else []
    there = sorted(toy.iterdir())
    assert main(["robot", str(toy / "toy.xml"), "--out", str(toy / "arm.xml"), *words, "--fix", option]) == 2
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1 and ONE_LINE[option] in printed.err and not printed.out
    assert sorted(toy.iterdir()) == there


@pytest.mark.parametrize("options", FOLLOWER)
def test_a_follower_with_another_value_is_one_line(toy, capsys, options):
    words = [word for option in options for word in ("--fix", option)]
    assert main(["robot", str(toy / "gripper.urdf"), "--tcp", "l3", "--out", str(toy / "arm.xml"), *words]) == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1 and printed.endswith(f"{FOLLOWER[options]}\n")


BEYOND = {  # what is changed in the gripper, further options, and the message
    "a factor of 3": (
        (' multiplier="0.5" offset="0.01"', ' multiplier="3"'),
        ["--fix", "left=0.03"],
        "right=0.09 is outside the joint's limits, 0 to 0.04 m; this joint follows left at 0.03",
    ),
    "held": (
        ('multiplier="0.5" offset="0.01"', 'multiplier="0" offset="-0.01"'),
        [],
        "right=-0.01 is outside the joint's limits, 0 to 0.04 m; this joint follows left",
    ),
}


@pytest.mark.parametrize("case", BEYOND)
def test_a_follower_is_not_frozen_beyond_its_own_limits(toy, capsys, case):
    change, words, message = BEYOND[case]
    (toy / "gripper.urdf").write_text(URDF.replace(*change))
    words = ["robot", str(toy / "gripper.urdf"), "--tcp", "l3", "--out", str(toy / "arm.xml"), *words]
    assert main(words) == 2
    assert capsys.readouterr().err.endswith(f"{message}\n")
    with pytest.raises(InputError, match=r"robot\.locked: right=.* is outside"):
        load_robot(toy / "gripper.urdf", tcp_site="l3", locked={"left": 0.03})


def test_too_few_joints_are_left(toy, capsys):
    words = [word for name in ("pan", "tilt", "reach") for word in ("--fix", f"{name}=0.1")]
    assert main(["robot", str(toy / "toy.xml"), "--out", str(toy / "arm.xml"), *words]) == 2
    assert "2 joints from the world to the TCP; at least 3 are needed" in capsys.readouterr().err
