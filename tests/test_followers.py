"""Arms whose joints follow others, imported and read back, beside MuJoCo's model with its constraints solved."""

import json
import re
import warnings

import jax
import made_once
import mujoco
import numpy as np
import pytest
from coupled import COMPILER, joint, mimic, solved, urdf

from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.io.robots import LinkMeshes, import_robot, load_robot
from htcp_jax.model import kinematics
from htcp_jax.spec import ComposedModel, PlacedModel
from htcp_jax.spec import tool as tools

BASE = [joint("a1", "base", "l1", "0 0 1"), joint("a2", "l1", "l2"), joint("a3", "l2", "l3")]
TOOL = joint("a6", "l5", "tcp", "1 0 0")
FREE = ["a1", "a2", "a3"]
# A shaft turns off the chain and drives the last link.
SHAFT = joint("shaft", "l1", "wheel", "1 0 0", limit="-2 3")
MJCF = """<mujoco model="coupled"><compiler angle="radian"/><worldbody><geom name="foot" size="0.02"/>
  <body name="l1" pos="0.1 0 0.2" euler="0.1 0.2 0.3"><joint name="pan" axis="0 0 1" pos="0 0.1 0" range="-3 3"/>
    <joint name="tilt" axis="0 1 0" pos="0.05 0 0" ref="0.4" range="-1 2"/><geom name="upper" size="0.02"/>
    <body name="l2" pos="0.3 0 0"><joint name="reach" type="slide" axis="1 0 0" ref="-0.1" range="-0.2 0.2"/>
      <geom name="middle" size="0.03"/>
      <body name="l3" pos="0.2 0 0"><joint name="bend" axis="0 1 0" ref="0.3" range="-1 2"/>
        <geom name="low" size="0.03"/>
        <body name="l4" pos="0.1 0 0"><joint name="roll" axis="1 0 0"/><geom name="hand" size="0.03"/>
          <site name="tcp" pos="0 0.1 0.2"/></body></body></body>
    <body name="rod" pos="0 0.2 0"><joint name="push" axis="0 1 0" ref="-0.2"/><geom name="rod" size="0.01"/></body>
  </body></worldbody><equality>EQUALITY</equality></mujoco>"""


def mjcf(equality: str) -> str:
    return MJCF.replace("EQUALITY", equality)


# The file, the coordinates, and the range, speed and number of chain joints behind the last coordinate.
ARMS = {
    "a wrist that bends twice": (
        urdf(*BASE, joint("a5", "l3", "l4"), joint("a5b", "l4", "l5", more=mimic("a5")), TOOL),
        [*FREE, "a5", "a6"],
        {"a5": (-1, 1, 2)},
    ),
    "an offset and a negative factor": (
        urdf(
            *BASE, joint("a5", "l3", "l4"), joint("a5b", "l4", "l5", limit="-0.7 1.3", more=mimic("a5", -2, 0.3)), TOOL
        ),
        [*FREE, "a5", "a6"],
        {"a5": (-0.5, 0.5, 1)},
    ),
    "a chain of two": (
        urdf(
            *BASE,
            joint("a4", "l3", "l4", more=mimic("a5", 0.5, 0.1)),
            joint("a5", "l4", "l5", "0 0 1", more=mimic("a3", -1, 0.2)),
            TOOL,
        ),
        [*FREE, "a6"],
        {"a3": (-0.8, 1, 2)},
    ),
    "a lift of two stages": (
        urdf(
            joint("lift", "base", "s1", "0 0 1", kind="prismatic", limit="0 0.4"),
            joint("lift2", "s1", "l1", "0 0 1", kind="prismatic", limit="0 0.3", more=mimic("lift")),
            *BASE[1:],
            joint("a6", "l3", "tcp", "1 0 0"),
        ),
        ["lift", "a2", "a3", "a6"],
        {"lift": (0, 0.3, 2)},
    ),
    "a slide that a screw moves": (
        urdf(
            *BASE,
            joint("a4", "l3", "l4"),
            joint("slide", "l4", "l5", kind="prismatic", limit="-0.1 0.1", more=mimic("a4", 0.05)),
            TOOL,
        ),
        [*FREE, "a4", "a6"],
        {"a4": (-1, 1, 2)},
    ),
    "a master off the chain": (
        urdf(*BASE, SHAFT, joint("a5", "l3", "l5", more=mimic("shaft", 0.5)), TOOL),
        [*FREE, "shaft", "a6"],
        {"shaft": (-2, 2, 2)},
    ),
    "a parallelogram's rods": (
        urdf(
            *BASE,
            joint("a4", "l3", "l5"),
            TOOL,
            joint("lever", "l1", "crank", more=mimic("a2", -1, 0.1)),
            joint("push", "crank", "rod", "0 0 1", more=mimic("a3", 0.5)),
        ),
        [*FREE, "a4", "a6"],
        {"a2": (-0.9, 1, 2), "a3": (-1, 1, 2)},
    ),
    "a factor of 0": (
        urdf(*BASE, joint("a4", "l3", "l4", more=mimic("a3", 0, 0.25)), joint("a5", "l4", "l5"), TOOL),
        [*FREE, "a5", "a6"],
        {},
    ),
    "MJCF, drawn elsewhere": (
        mjcf('<joint joint1="bend" joint2="reach" polycoef="0.1 2"/><joint joint1="push" joint2="bend"/>'),
        ["pan", "tilt", "reach", "roll"],
        {"reach": (-0.2, 0.2, np.inf)},
    ),
    "MJCF, held": (
        mjcf('<joint joint1="bend" polycoef="0.1"/>'),
        ["pan", "tilt", "reach", "roll"],
        {},
    ),
    "MJCF, inactive": (
        mjcf('<joint joint1="bend" joint2="reach" active="false"/><connect body1="l4" anchor="0 0 0" active="false"/>'),
        ["pan", "tilt", "reach", "bend", "roll"],
        {},
    ),
}


@pytest.fixture
def imported(tmp_path, capsys):
    """Import a text, and return the command's JSON and the arm's file."""

    def run(text: str, *words: str):
        file, out = tmp_path / f"model.{'urdf' if '<robot' in text else 'xml'}", tmp_path / "arm.xml"
        file.write_text(text)
        assert main(["robot", str(file), "--tcp", "tcp", "--out", str(out), "--json", "--replace", *words]) == 0
        return json.loads(capsys.readouterr().out), out

    return run


def kinematics_of(arm, rows: np.ndarray) -> list[np.ndarray]:
    """TCP poses, first ends of the capsules and Jacobians of the TCP at configurations (n, N)."""

    def at(x):
        return (
            kinematics.tcp_pose(arm, x),
            kinematics.capsule_segments(arm, x)[0],
            kinematics.jacobian(arm, x),
        )

    return list(map(np.asarray, made_once.quick_jit(jax.vmap(at))(rows)))


def reference(text: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(text.replace("</robot>", f"{COMPILER}</robot>"))


@pytest.mark.parametrize("case", ARMS)
def test_the_arm_moves_as_mujoco_with_its_constraints_solved(imported, case):
    text, names, limits = ARMS[case]
    facts, file = imported(text)
    arm, model = load_robot(file), reference(text)
    assert facts["joints"] == list(arm.joint_names) and sorted(facts["joints"]) == sorted(names)
    for name, expected in limits.items():
        k = arm.joint_names.index(name)
        np.testing.assert_allclose([float(each[k]) for each in (arm.lower, arm.upper, arm.speed)], expected, atol=1e-12)
    low, high = np.maximum(arm.lower, -3), np.minimum(arm.upper, 3)
    rows = np.random.default_rng(0).uniform(low, high, (20, len(low)))
    poses, middles, jacobians = kinematics_of(arm, rows)
    bodies = [name for name in arm.capsule_names if name not in ("base", "foot")]
    of_urdf = "<robot" in text
    for u, pose, middle, jacobian in zip(rows, poses, middles, jacobians, strict=True):
        data, along = solved(model, dict(zip(arm.joint_names, u, strict=True)))
        frame = data.body("tcp") if of_urdf else data.site("tcp")
        place, turn = (frame.xpos, frame.xmat.reshape(3, 3))
        np.testing.assert_allclose(pose[:3, 3], place, rtol=0, atol=1e-9)
        np.testing.assert_allclose(pose[:3, :3], turn, rtol=0, atol=1e-9)
        for name in bodies:
            expected = data.body(name).xpos if of_urdf else data.geom(name).xpos
            np.testing.assert_allclose(middle[arm.capsule_names.index(name)], expected, rtol=0, atol=1e-9, err_msg=name)
        J = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, J, None, place, model.body("tcp" if of_urdf else "l4").id)
        np.testing.assert_allclose(jacobian, J @ along, rtol=0, atol=1e-9)


PARALLELOGRAM = """<mujoco model="parallelogram"><compiler angle="radian" boundmass="1" boundinertia="1"/><worldbody>
  <geom name="foot" size="0.02"/>
  <body name="l1" pos="0 0 0.3"><joint name="a1" axis="0 0 1" range="-3 3"/>
    <body name="lower" pos="0.1 0 0"><joint name="a2" axis="0 1 0" range="-1 1"/><geom name="lower" size="0.03"/>
      <body name="upper" pos="0 0 0.6"><joint name="a3" axis="0 1 0" range="-1 1"/><geom name="upper" size="0.03"/>
        <body name="hand" pos="0.5 0 0"><joint name="a4" axis="1 0 0" range="-2 2"/><site name="tcp" pos="0.2 0 0"/>
        </body></body>
      <body name="crank"><joint name="turn" axis="0 1 0"/><geom name="crank" size="0.02"/>
        <body name="rod" pos="-0.2 0 0"><joint name="push" axis="0 1 0"/>
          <geom name="rod" type="capsule" size="0.02" fromto="0 0 0.05 0 0 0.55"/></body></body>
    </body></body></worldbody><equality>EQUALITY</equality></mujoco>"""


def test_a_rod_stands_where_mujoco_closes_the_parallelogram(imported):
    follow = '<joint joint1="turn" joint2="a3"/><joint joint1="push" joint2="turn" polycoef="0 -1"/>'
    _, file = imported(PARALLELOGRAM.replace("EQUALITY", follow))
    closed = '<connect body1="rod" body2="upper" anchor="0 0 0.6"/>'
    arm, model = load_robot(file), mujoco.MjModel.from_xml_string(PARALLELOGRAM.replace("EQUALITY", closed))
    u = np.random.default_rng(0).uniform(arm.lower, arm.upper, (10, 4))
    rod = arm.capsule_names.index("rod")
    for row, ends in zip(u, kinematics_of(arm, u)[1], strict=True):
        body = solved(model, dict(zip(arm.joint_names, row, strict=True)))[0].body("rod")
        expected = [body.xpos + body.xmat.reshape(3, 3) @ (0, 0, height) for height in (0.05, 0.55)]
        assert min(np.abs(ends[rod] - end).max() for end in expected) < 1e-9


def test_the_file_that_is_read_directly_is_the_arm_that_is_imported(imported, tmp_path):
    _, file = imported(ARMS["MJCF, drawn elsewhere"][0])
    ours, theirs = load_robot(file), load_robot(tmp_path / "model.xml")
    assert ours.joint_names == theirs.joint_names and ours.coupling.joint_names == theirs.coupling.joint_names
    assert ours.coupling.parents == theirs.coupling.parents == (-1, 0, 1, 2, 3, 1)
    for one, other in zip(jax.tree.leaves(ours.coupling), jax.tree.leaves(theirs.coupling), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-15)


def test_followers_are_printed_with_what_they_follow(imported):
    facts, file = imported(ARMS["a chain of two"][0])
    assert facts["followers"] == ["a5 = -a3 + 0.2", "a4 = 0.5 a5 + 0.1"]
    assert '<joint joint1="a4" joint2="a5" polycoef="0.1 0.5 0 0 0" />' in file.read_text()


def test_followers_are_frozen_with_their_master(imported):
    text = ARMS["a chain of two"][0]
    facts, file = imported(text, "--fix", "a3=0.4")
    assert facts["joints"] == ["a1", "a2", "a6"] and "followers" not in facts
    assert facts["fixed"] == ["a3=0.4", "a4=0", "a5=-0.2"]
    data, _ = solved(reference(text), {"a1": 0.1, "a2": 0.2, "a3": 0.4, "a6": 0.3})
    pose = kinematics_of(load_robot(file), np.array([[0.1, 0.2, 0.3]]))[0][0]
    np.testing.assert_allclose(pose[:3, 3], data.body("tcp").xpos, rtol=0, atol=1e-9)


@pytest.mark.parametrize("case", ["a chain of two", "a parallelogram's rods"])
def test_a_job_that_locks_a_master_locks_its_followers(imported, case):
    text, names, _ = ARMS[case]
    _, file = imported(text)
    whole, arm = load_robot(file), load_robot(file, locked={"a3": 0.3})
    u = np.linspace(-0.3, 0.5, len(names))
    u[whole.joint_names.index("a3")] = 0.3
    there = kinematics_of(whole, u[None])[:2]
    here = kinematics_of(arm, np.delete(u, whole.joint_names.index("a3"))[None])[:2]
    assert arm.joint_names == tuple(name for name in whole.joint_names if name != "a3")
    assert (arm.coupling is None) == (case == "a chain of two")
    for one, other in zip(here, there, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)


def test_a_job_cannot_lock_a_follower(imported):
    _, file = imported(ARMS["a chain of two"][0])
    with pytest.raises(InputError, match=r"robot\.locked: a5=0\.1: this joint follows a3; freeze that joint"):
        load_robot(file, locked={"a5": 0.1})


# What is refused, in one line

EQUALITIES = {
    "a circle": (
        '<joint joint1="bend" joint2="reach"/><joint joint1="reach" joint2="tilt"/>'
        '<joint joint1="tilt" joint2="bend"/>',
        "joints follow each other in a circle: bend -> reach -> tilt -> bend",
    ),
    "two masters": (
        '<joint joint1="bend" joint2="reach"/><joint joint1="bend" joint2="tilt"/>',
        "joint 'bend' follows 'reach' and follows 'tilt'; it can follow only one",
    ),
    "an unknown master": ('<joint joint1="bend" joint2="elbow"/>', "unknown element 'elbow' in equality constraint"),
    "a polynomial": (
        '<joint joint1="bend" joint2="reach" polycoef="0 1 2"/>',
        "joint 'bend' follows 'reach' by a polynomial; only factor and offset are supported; freeze that joint with "
        "--fix reach=VALUE",
    ),
    "a polynomial off the chain": (
        '<joint joint1="push" joint2="reach" polycoef="0 1 2"/>',
        "joint 'push' follows 'reach' by a polynomial; only factor and offset are supported; exclude the links that it "
        "moves with --omit rod",
    ),
    "a number that is not finite": (
        '<joint joint1="bend" joint2="reach" polycoef="0 inf"/>',
        "joint 'bend' follows 'reach' by a polycoef that is not finite",
    ),
    "connect": ('<connect body1="l4" anchor="0 0 0"/>', "<connect> of l4 and world in <equality> closes a loop"),
    "weld": ('<weld body1="l4" body2="l2"/>', "<weld> of l4 and l2 in <equality> closes a loop, which is"),
    "a loop with a rod": (
        '<connect body1="rod" body2="l3" anchor="0 0 0"/>',
        "<connect> of rod and l3 in <equality> closes a loop, which is not supported; exclude the links that it moves "
        "with --omit rod",
    ),
    "a tendon": ('<tendon tendon1="cable"/>', "joint 'tilt' is coupled by the tendon cable, which is not supported"),
}  # fmt: skip
CABLE = '<tendon><fixed name="cable"><joint joint="tilt" coef="1"/><joint joint="bend" coef="-1"/></fixed></tendon>'


def refusal(folder, capsys, *words: str) -> str:
    there = sorted(folder.iterdir())
    assert main(["robot", *words, "--tcp", "tcp", "--out", str(folder / "arm.xml")]) == 2
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1 and not printed.out and sorted(folder.iterdir()) == there
    return printed.err


@pytest.mark.parametrize("case", EQUALITIES)
def test_a_coupling_that_is_not_supported_is_one_line(tmp_path, capsys, case):
    equality, message = EQUALITIES[case]
    (tmp_path / "model.xml").write_text(mjcf(equality).replace("</mujoco>", f"{CABLE}</mujoco>"))
    assert message in refusal(tmp_path, capsys, str(tmp_path / "model.xml"))


CIRCLE = urdf(
    *BASE,
    joint("a4", "l3", "l4", more=mimic("a5")),
    joint("a5", "l4", "l5", more=mimic("a4")),
    joint("a6", "l5", "tcp"),
)


def test_a_circle_of_mimic_joints_is_one_line(tmp_path, capsys):
    (tmp_path / "model.urdf").write_text(CIRCLE)
    message = "joints follow each other in a circle: a4 -> a5 -> a4"
    assert message in refusal(tmp_path, capsys, str(tmp_path / "model.urdf"))


def test_limits_without_a_common_value_are_one_line(tmp_path, capsys):
    text = urdf(*BASE, joint("a4", "l3", "l5", limit="0.5 1", more=mimic("a3", 1, -1)), TOOL)
    (tmp_path / "model.urdf").write_text(text)
    message = "joint a3 has no range within the limits of a4 and a3, which move with it"
    assert message in refusal(tmp_path, capsys, str(tmp_path / "model.urdf"))


def test_a_tendon_that_its_default_switches_off_couples_nothing(imported):
    text = mjcf('<tendon tendon1="cable"/>').replace("</mujoco>", f"{CABLE}</mujoco>")
    default = '<default><equality active="false"/></default><worldbody>'
    assert imported(text.replace("<worldbody>", default))[0]["joints"] == ["pan", "tilt", "reach", "bend", "roll"]


OMITTED = {
    "a polynomial": '<joint joint1="push" joint2="reach" polycoef="0 1 2"/>',
    "a loop": '<connect body1="rod" body2="l3" anchor="0 0 0"/>',
    "a follower": '<joint joint1="push" joint2="reach"/>',
}


@pytest.mark.parametrize("case", OMITTED)
def test_a_moving_link_that_is_omitted_is_listed_in_the_file_and_in_plans(imported, case):
    facts, file = imported(mjcf(OMITTED[case]), "--omit", "rod")
    assert facts["omitted"] == ["rod"] and load_robot(file).omitted == ("rod",)


def test_the_name_of_an_omitted_link_may_contain_a_comma(imported):
    facts, file = imported(
        mjcf(OMITTED["a follower"]).replace('body name="rod"', 'body name="rod, thin"'), "--omit", "rod, thin"
    )
    assert facts["omitted"] == ["rod, thin"] and load_robot(file).omitted == ("rod, thin",)


def test_a_loop_above_a_frozen_lift_needs_only_the_links_that_the_loop_moves_omitted(tmp_path):
    text = mjcf(OMITTED["a loop"]).replace(
        '<body name="l1"', '<body name="lift"><joint name="z" type="slide"/><body name="l1"'
    )
    text = text.replace("</worldbody>", "</body></worldbody>")
    (tmp_path / "model.xml").write_text(text)
    with pytest.raises(InputError, match=r"exclude the links that it moves with --omit rod$"):
        import_robot(tmp_path / "model.xml", "tcp", part="lift")
    arm = import_robot(tmp_path / "model.xml", "tcp", part="lift", omit=["rod"])
    assert arm.frozen == ("z", "push") and arm.omitted == ("rod",)


def test_a_link_of_the_chain_is_listed_if_no_capsule_is_left_on_it(imported):
    hand = '<body name="plate"><geom name="plate" size="0.01"/></body><site name="tcp"'
    text = mjcf(OMITTED["a follower"]).replace('<site name="tcp"', hand)
    facts, file = imported(text, "--omit", "l2", "--omit", "plate")
    assert facts["omitted"] == ["l2"] and load_robot(file).omitted == ("l2",)
    assert imported(text, "--omit", "l4", "--omit", "plate")[0]["omitted"] == ["l4", "plate"]


def test_a_mimic_of_a_fixed_joint_holds_the_joint_at_its_offset(imported):
    text = urdf(
        *BASE, joint("mount", "l3", "l4", kind="fixed"), joint("a5", "l4", "l5", more=mimic("mount", 2, 0.3)), TOOL
    )
    facts, _ = imported(text)
    assert facts["joints"] == [*FREE, "a6"] and facts["fixed"] == ["a5=0.3"]


def test_a_tie_to_a_body_that_is_not_the_robots_is_a_warning(tmp_path):
    hand = '<body name="mouse" mocap="true"/></worldbody>'
    text = mjcf('<weld body1="mouse" body2="l4"/>').replace("</worldbody>", hand)
    (tmp_path / "model.xml").write_text(re.sub(r'<body name="rod".*?</body>', "", text))
    with pytest.warns(UserWarning, match="ignored in <equality>: <weld> of mouse and l4$"):
        load_robot(tmp_path / "model.xml")


def test_a_gripper_that_closes_loops_behind_the_tcp_is_frozen(imported):
    jaw = '<body name="jaw{0}" pos="{0} 0 0"><joint name="jaw{0}" axis="0 1 0"/><geom size="0.01"/></body>'
    text = mjcf('<connect body1="jaw1" body2="jaw2" anchor="0 0 0"/>').replace(
        '<site name="tcp"', f'{jaw.format(1)}{jaw.format(2)}<site name="tcp"'
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        facts, _ = imported(text)
    assert facts["frozen"] == ["jaw1", "jaw2", "push"] and "omitted" not in facts


# Cells of several files, meshes, and fixtures

LIFT = urdf(
    joint("lift", "base", "stage", "0 0 1", kind="prismatic", limit="0 0.4"),
    joint("lift2", "stage", "car", "0 0 1", kind="prismatic", limit="0 0.4", more=mimic("lift", 1, 0.1)),
).replace("base", "floor")
TABLE = urdf(
    joint("yoke", "base", "arm", "1 0 0", more=mimic("turn", -0.5, 0.1)), joint("turn", "arm", "table", "0 0 1")
).replace("base", "ground")
WRIST = ARMS["a wrist that bends twice"][0]


def test_a_cell_of_several_files_moves_as_mujoco_with_its_constraints_solved(tmp_path):
    for name, text in {"lift": LIFT, "table": TABLE, "wrist": WRIST}.items():
        (tmp_path / f"{name}.urdf").write_text(text)
    still, turned = (0.0, 0.0, 0.0), (0.0, 0.0, 0.4)
    cell = ComposedModel(
        (
            PlacedModel("robot", tmp_path / "wrist.urdf", "rail.car", (0.0, 0.0, 0.5), turned),
            PlacedModel("rail", tmp_path / "lift.urdf", "world", still, still),
            PlacedModel("positioner", tmp_path / "table.urdf", "world", (1.0, 0.0, 0.0), still),
        ),
        "positioner.table",
    )
    arm = load_robot(cell, tcp_site="tcp")
    assert arm.joint_names == ("turn", "lift", "a1", "a2", "a3", "a5", "a6")
    u = np.random.default_rng(0).uniform(arm.lower, arm.upper, (5, len(arm.joint_names)))
    for row, pose in zip(u, kinematics_of(arm, u)[0], strict=True):
        at = dict(zip(arm.joint_names, row, strict=True))
        table = pose_of(solved(reference(TABLE), {"turn": at.pop("turn")})[0].body("table"))
        car = pose_of(solved(reference(LIFT), {"lift": at.pop("lift")})[0].body("car"))
        tcp = pose_of(solved(reference(WRIST), at)[0].body("tcp"))
        table[0, 3] += 1.0
        expected = np.linalg.inv(table) @ car @ tools.pose((0.0, 0.0, 0.5), turned) @ tcp
        np.testing.assert_allclose(pose, expected, rtol=0, atol=1e-9)


def pose_of(body) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = body.xmat.reshape(3, 3), body.xpos
    return T


def test_the_vendors_meshes_move_with_the_followers(imported):
    text = ARMS["a parallelogram's rods"][0]
    _, file = imported(text)
    arm, meshes = load_robot(file), LinkMeshes.read(file)
    u = np.random.default_rng(0).uniform(arm.lower, arm.upper, (3, len(arm.joint_names)))
    written, read = mujoco.MjModel.from_xml_path(str(file)), meshes.poses(u)
    for k, row in enumerate(u):
        data, _ = solved(reference(text), dict(zip(arm.joint_names, row, strict=True)))
        for name in ("crank", "rod", "tcp"):
            found = read.position[k, written.body(name).id]
            np.testing.assert_allclose(found, data.body(name).xpos, rtol=0, atol=1e-9)


def test_warnings_on_an_arms_file_are_not_repeated_for_its_meshes(imported, tmp_path, monkeypatch):
    _, file = imported(WRIST)
    motor = '<actuator><motor joint="a1" forcerange="-9 9"/></actuator></mujoco>'
    file.write_text(file.read_text().replace("</mujoco>", motor))
    monkeypatch.chdir(tmp_path)
    with pytest.warns(UserWarning, match=r"arm\.xml: not used: 'forcerange' in <actuator>"):
        arm = load_robot("arm.xml")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        arm.meshes.deepest_m(*arm.capsule_names[:2], np.zeros(arm.dof))


def test_an_imported_arm_is_imported_again_with_its_followers(imported):
    first, file = imported(ARMS["a parallelogram's rods"][0])
    whole = load_robot(file)
    again, file = imported(file.read_text())
    assert again["followers"] == first["followers"] and again["joints"] == first["joints"]
    for one, other in zip(jax.tree.leaves(load_robot(file).coupling), jax.tree.leaves(whole.coupling), strict=True):
        np.testing.assert_array_equal(one, other)


def test_limits_from_a_file_hold_for_followers(imported, tmp_path):
    (tmp_path / "limits.yaml").write_text(
        "joint_limits:\n  a5: {min_position: -0.9, max_position: 0.9, max_velocity: 3}\n"
        "  a5b: {min_position: -0.4, max_position: 0.2, max_velocity: 0.5}\n"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        _, file = imported(WRIST, "--limits", str(tmp_path / "limits.yaml"))
        imported_arm, whole = (
            load_robot(file),
            load_robot(tmp_path / "model.urdf", limits=str(tmp_path / "limits.yaml")),
        )
    k = imported_arm.joint_names.index("a5")
    assert [float(each[k]) for each in (imported_arm.lower, imported_arm.upper, imported_arm.speed)] == [-0.4, 0.2, 0.5]
    assert [float(each[k]) for each in (whole.lower, whole.upper)] == [-0.4, 0.2]


def test_omitted_links_of_a_cells_models_are_listed_with_their_model(imported, tmp_path):
    _, arm = imported(mjcf(OMITTED["a follower"]), "--omit", "rod")
    still = (0.0, 0.0, 0.0)
    rail = PlacedModel("rail", arm, "world", still, still)
    (tmp_path / "wrist.urdf").write_text(WRIST)
    robot = PlacedModel("robot", tmp_path / "wrist.urdf", "rail.tcp", still, still)
    assert load_robot(ComposedModel((robot, rail), None), tcp_site="tcp").omitted == ("rail.rod",)
