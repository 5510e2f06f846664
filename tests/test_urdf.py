"""What a URDF states about its joints, and elements that no reader knows: used, refused, or named in one line."""

import re
import warnings

import mujoco
import numpy as np
import pytest

import htcp_jax
from htcp_jax.cli import main
from htcp_jax.errors import InputError, Note
from htcp_jax.io.robots import import_robot
from htcp_jax.io.robots.safe_xml import read_spec
from htcp_jax.spec.model_source import ComposedModel, PlacedModel
from htcp_jax.trajectory.limits import joint_limits

RANGE = '<limit lower="-1" upper="2" velocity="1" effort="5"/>'
BALL = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'


def joint(name: str, parent: str, child: str, content: str = RANGE, kind: str = "revolute") -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{content}</joint>'


def arm(content: str = RANGE, kind: str = "revolute", more: str = "") -> str:
    """An arm of three joints, whose elbow is of a kind and has a content of its own."""
    links = "".join(f'<link name="{name}">{BALL}</link>' for name in ("base", "upper", "lower", "hand"))
    joints = joint("shoulder", "base", "upper"), joint("elbow", "upper", "lower", content, kind)
    return f'<robot name="r">{links}{"".join(joints)}{joint("wrist", "lower", "hand")}{more}</robot>'


def readings(folder, text: str):
    """Load and import a URDF with its TCP at the hand: functions without arguments."""
    file = folder / "arm.urdf"
    file.write_text(text)
    return lambda: htcp_jax.load_robot(file, tcp_site="hand"), lambda: import_robot(file, "hand")


def loaded(folder, text: str):
    return readings(folder, text)[0]()


def refusals(folder, text: str) -> list[str]:
    """The messages by which loading and importing refuse a URDF, without its path."""
    found = []
    for read in readings(folder, text):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with pytest.raises(InputError) as caught:
                read()
        assert "\n" not in str(caught.value) and str(caught.value).startswith(str(folder / "arm.urdf"))
        found.append(str(caught.value).removeprefix(f"{folder / 'arm.urdf'}: "))
    return found


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize(
    "content",
    ["", '<limit effort="9" velocity="2"/>', '<limit lower="0" upper="0" velocity="2"/>', '<limit lower="0.0"/>'],
)
def test_a_joint_without_a_range_is_refused_with_the_remedies(tmp_path, kind, content):
    by_load, by_import = refusals(tmp_path, arm(content, kind))
    assert by_load.startswith("no range for elbow: ") and by_import.startswith("no range for elbow: ")
    assert "robot.limits: FILE" in by_load and "robot.locked: {elbow: VALUE}" in by_load
    assert "--limits FILE" in by_import and "--fix elbow=VALUE" in by_import


def test_the_refusal_names_all_joints_without_a_range(tmp_path):
    for message in refusals(tmp_path, arm("").replace(RANGE, '<limit lower="0" upper="0"/>')):
        assert message.startswith("no range for shoulder, elbow, wrist: ")


@pytest.mark.parametrize(
    ("content", "limits"),
    [
        ('<limit upper="2"/>', (0, 2)),
        ('<limit lower="-2"/>', (-2, 0)),
        ('<limit lower="0" upper="0.5"/>', (0, 0.5)),
        ('<limit lower="-0.5" upper="0"/>', (-0.5, 0)),
        ('<limit lower="-2e5" upper="9e5"/>', (-2e5, 9e5)),
    ],
)
def test_a_range_with_one_bound_of_zero_is_a_range_in_the_arm_and_in_the_file_that_htcp_robot_writes(
    tmp_path, content, limits
):
    assert (loaded(tmp_path, arm(content)).lower[1], loaded(tmp_path, arm(content)).upper[1]) == limits
    assert main(["robot", str(tmp_path / "arm.urdf"), "--tcp", "hand", "--out", str(tmp_path / "arm.xml")]) == 0
    written = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml")).joint("elbow")
    assert written.range.tolist() == list(limits)


@pytest.mark.parametrize("content", ["", '<limit velocity="3" effort="9"/>', '<limit lower="0" upper="0"/>'])
def test_a_continuous_joint_is_unlimited_without_a_message(tmp_path, content):
    read, imported = readings(tmp_path, arm(content, "continuous"))
    assert np.isinf(read().lower[1]) and np.isinf(read().upper[1]) and imported().joint_names[1] == "elbow"


def test_the_range_of_a_continuous_joint_is_named(tmp_path):
    for read in readings(tmp_path, arm(RANGE, "continuous")):
        with pytest.warns(Note, match="the range of a continuous joint is not used: elbow$"):
            read()


def test_joints_off_the_chain_and_frozen_joints_need_no_range(tmp_path):
    finger = f'<link name="jaw"/>{joint("finger", "hand", "jaw", "", "prismatic")}'
    assert readings(tmp_path, arm(more=finger))[1]().frozen == ("finger",)
    assert import_robot(tmp_path / "arm.urdf", "jaw", fixed={"finger": 0.02}).fixed == {"finger": 0.02}
    assert htcp_jax.load_robot(tmp_path / "arm.urdf", tcp_site="jaw", locked={"finger": 0.0}).joint_names[-1] == "wrist"


@pytest.mark.parametrize("content", ['<limit lower="-1e16" upper="1e16"/>', '<limit lower="-inf" upper="inf"/>'])
def test_a_hinge_range_beyond_a_million_radians_counts_as_unlimited(tmp_path, content):
    for read in readings(tmp_path, arm(content)):
        with pytest.warns(Note, match="a range beyond 1e6 rad counts as unlimited: elbow$"):
            read()
    with pytest.warns(Note):
        assert np.isinf(loaded(tmp_path, arm(content)).upper[1])


def test_a_range_that_is_unlimited_on_one_side_is_refused(tmp_path):
    for message in refusals(tmp_path, arm('<limit lower="0" upper="1e16"/>')):
        assert message.startswith(
            "joint 'elbow' has range 0 to 1e+16, which is unlimited on one side; give both limits"
        )


@pytest.mark.parametrize(
    ("soft", "limits"),
    [
        ('soft_lower_limit="-0.5" soft_upper_limit="1.5"', (-0.5, 1.5)),
        ('soft_lower_limit="-9" soft_upper_limit="1.5"', (-1, 1.5)),
        ('soft_upper_limit="1.5"', (0, 1.5)),
        ('soft_lower_limit="-0.5" soft_upper_limit="0"', (-0.5, 0)),
    ],
)
def test_soft_limits_are_used_where_they_are_tighter(tmp_path, soft, limits):
    text = arm(f'{RANGE}<safety_controller {soft} k_velocity="1"/>')
    for read in readings(tmp_path, text):
        with pytest.warns(Note, match="soft limits of <safety_controller>, .* are the range of elbow$"):
            read()
    with pytest.warns(Note):
        robot = loaded(tmp_path, text)
    assert (robot.lower[1], robot.upper[1]) == limits


@pytest.mark.parametrize(
    "soft",
    [
        "",
        'soft_lower_limit="0" soft_upper_limit="0"',
        'soft_lower_limit="0.5" soft_upper_limit="0.5"',
        'soft_lower_limit="-3" soft_upper_limit="3"',
    ],
)
def test_soft_limits_that_are_equal_missing_or_wider_change_nothing(tmp_path, soft):
    robot = loaded(tmp_path, arm(f'{RANGE}<safety_controller {soft} k_velocity="1"/>'))
    assert (robot.lower[1], robot.upper[1]) == (-1, 2)


@pytest.mark.parametrize(
    ("soft", "message"),
    [
        ('soft_lower_limit="3" soft_upper_limit="4"', "joint 'elbow': the soft limits 3 to 4 are outside of its range"),
        ('soft_lower_limit="1" soft_upper_limit="-1"', "joint 'elbow' has soft limits 1 to -1; they must ascend"),
    ],
)
def test_soft_limits_that_contradict_the_range_are_refused(tmp_path, soft, message):
    for found in refusals(tmp_path, arm(f"{RANGE}<safety_controller {soft}/>")):
        assert found.startswith(message)


def test_a_speed_of_zero_is_named_and_a_program_needs_it(tmp_path):
    text = arm('<limit lower="-1" upper="1" velocity="0"/>')
    for read in readings(tmp_path, text):
        with pytest.warns(Note, match="the speed of elbow is not positive and counts as missing"):
            read()
    with pytest.warns(Note):
        robot = loaded(tmp_path, text)
    with pytest.raises(InputError, match=r"no velocity limit for joint elbow; .*program\.velocity"):
        joint_limits(robot)


@pytest.mark.parametrize("acceleration", ["0", "-2"])
def test_an_acceleration_that_is_not_positive_is_named(tmp_path, acceleration):
    text = arm(f'<limit lower="-1" upper="1" velocity="1" acceleration="{acceleration}"/>')
    for read in readings(tmp_path, text):
        with pytest.warns(Note, match="the acceleration of elbow is not positive and counts as missing"):
            read()


def test_joints_of_a_positioner_need_ranges_too(tmp_path):
    (tmp_path / "arm.urdf").write_text(arm())
    table = '<robot name="p"><link name="floor"/><link name="table"/>{}</robot>'
    (tmp_path / "table.urdf").write_text(table.format(joint("tilt", "floor", "table", '<limit lower="0" upper="0"/>')))
    still = (0.0, 0.0, 0.0)
    files = [("robot", "arm.urdf"), ("positioner", "table.urdf")]
    models = tuple(PlacedModel(key, tmp_path / file, "world", still, still) for key, file in files)
    with pytest.raises(InputError, match=r"no range for tilt: .* robot\.locked: \{tilt: VALUE\}"):
        htcp_jax.load_robot(ComposedModel(models, "positioner.table"), tcp_site="hand")


def test_limits_from_a_file_replace_those_of_the_imported_model(tmp_path, capsys):
    (tmp_path / "arm.urdf").write_text(arm('<limit lower="0" upper="0" velocity="0"/>'))
    (tmp_path / "limits.yaml").write_text(
        "joint_limits:\n"
        "  shoulder: {has_position_limits: true, min_position: -0.5, max_position: 0.25}\n"
        "  elbow: {min_position: -2, max_position: 0, max_velocity: 1.5}\n"
        "  wrist: {max_velocity: 3, max_acceleration: 7}\n"
    )
    words = ["--tcp", "hand", "--limits", str(tmp_path / "limits.yaml"), "--out", str(tmp_path / "arm.xml")]
    assert main(["robot", str(tmp_path / "arm.urdf"), *words]) == 0
    robot = htcp_jax.load_robot(tmp_path / "arm.xml")
    assert (robot.lower.tolist(), robot.upper.tolist()) == ([-0.5, -2, -1], [0.25, 0, 2])
    assert robot.speed.tolist() == [1, 1.5, 3] and robot.acceleration.tolist() == [np.inf, np.inf, 7]
    assert "counts as missing" not in capsys.readouterr().err


def test_limits_from_a_file_give_a_directly_read_arm_its_ranges(tmp_path):
    (tmp_path / "arm.urdf").write_text(arm("").replace(RANGE, '<limit lower="0" upper="0" velocity="1"/>'))
    rows = [f"  {name}: {{min_position: -1, max_position: 0.5}}\n" for name in ("shoulder", "elbow", "wrist")]
    (tmp_path / "limits.yaml").write_text("joint_limits:\n" + "".join(rows))
    robot = htcp_jax.load_robot(tmp_path / "arm.urdf", tcp_site="hand", limits=str(tmp_path / "limits.yaml"))
    assert robot.lower.tolist() == [-1, -1, -1] and robot.upper.tolist() == [0.5, 0.5, 0.5]
    (tmp_path / "limits.yaml").write_text("joint_limits:\n" + "".join(rows[:2]))
    with pytest.warns(Note), pytest.raises(InputError, match="no range for wrist: "):
        htcp_jax.load_robot(tmp_path / "arm.urdf", tcp_site="hand", limits=str(tmp_path / "limits.yaml"))


# Kinds of joints, and the tree

REFUSED = {
    "a floating joint": (arm("", "floating"), "joint 'elbow' between base and TCP has type floating"),
    "a planar joint": (arm("", "planar"), "joint 'elbow' between base and TCP has type planar"),
    "a ball joint": (arm("", "spherical"), "joint 'elbow' between base and TCP has type spherical"),
    "an unknown kind": (arm(RANGE, "screw"), "joint 'elbow' has type 'screw'; valid: revolute, continuous"),
    "a second root": (arm(more='<link name="x"/>'), "2 links have no parent: base, x; connect all links but one"),
    "a missing parent": (arm().replace('parent link="upper"', 'parent link="arm"'), "joint 'elbow': no link 'arm'"),
    "a link with two parents": (
        arm(more=joint("strut", "base", "hand", "", "fixed")),
        "link 'hand' is the child of joints 'wrist' and 'strut'; it must have one parent",
    ),
    "a circle": (
        arm(more='<link name="x"/><link name="y"/>' + joint("a", "x", "y") + joint("b", "y", "x")),
        "link 'x' is its own ancestor",
    ),
    "a joint twice": (arm(more=joint("elbow", "base", "x") + '<link name="x"/>'), "repeated names: joint 'elbow'"),
    "a link twice": (arm(more='<link name="lower"/>'), "repeated names: link 'lower'"),
    "an axis of zero": (arm().replace('"0 1 0"', '"0 0 0"', 1), "joint 'shoulder': <axis xyz='0 0 0'> has no"),
    "an unknown master": (arm(f'{RANGE}<mimic joint="x"/>'), "joint 'elbow' mimics the unknown joint 'x'; freeze it"),
    "a misspelt factor": (
        arm(f'{RANGE}<mimic joint="shoulder" multiplyer="-1"/>'),
        "joint 'elbow': <mimic> has an unknown attribute 'multiplyer'; valid: joint, multiplier, offset",
    ),
    "no master": (arm(f'{RANGE}<mimic multiplier="-1"/>'), "joint 'elbow': <mimic> has no attribute 'joint'"),
    "its own master": (arm(f'{RANGE}<mimic joint="elbow"/>'), "joint 'elbow' mimics itself"),
    "two ranges": (arm(RANGE + RANGE), "joint 'elbow': <joint> has 2 <limit>; it must have one"),
    "a joint without a name": (arm().replace('"wrist"', '""'), "joint '': <joint> has no attribute 'name'"),
    "no child": (arm().replace('<child link="hand"/>', ""), "joint 'wrist': <joint> has no <child>"),
    "a word as a bound": (arm('<limit lower="low" upper="1"/>'), "joint 'elbow': <limit lower='low'> is not a number"),
    "a word as Drake's acceleration": (
        arm('<limit lower="-1" upper="1" drake:acceleration="a"/>').replace("<robot", '<robot xmlns:drake="d"'),
        "joint 'elbow': <limit drake:acceleration='a'> is not a number",
    ),
    "an underscore": (arm('<limit lower="-1_0" upper="1"/>'), "joint 'elbow': <limit lower='-1_0'> is not a number"),
    "nan as a bound": (arm('<limit lower="nan" upper="1"/>'), "joint 'elbow': <limit lower='nan'> is not a number"),
    "two angles": (arm().replace('xyz="0 0 0.3"', 'rpy="0 1"', 1), "joint 'shoulder': <origin rpy='0 1'> is not 3"),
    "two shapes": (arm().replace("<sphere", '<box size="1 1 1"/><sphere', 1), "link 'base': <geometry> contains <box>"),
    "a scale of one number": (
        arm().replace('<sphere radius="0.1"/>', '<mesh filename="a.stl" scale="0.001"/>', 1),
        "link 'base': <mesh scale='0.001'> is not 3 numbers",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_a_damaged_urdf_is_refused_in_its_own_words(tmp_path, case):
    text, message = REFUSED[case]
    for found in refusals(tmp_path, text):
        assert found.startswith(message)


def test_a_follower_is_frozen_with_its_master(tmp_path):
    readings(tmp_path, arm(f'{RANGE}<mimic joint="shoulder" multiplier="-2"/>'))
    found = import_robot(tmp_path / "arm.urdf", "hand", fixed={"shoulder": 0.2}, fewest=1)
    assert found.joint_names == ("wrist",) and found.fixed == {"shoulder": 0.2, "elbow": -0.4}


@pytest.mark.parametrize("kind", ["floating", "planar", "spherical"])
def test_joints_of_other_kinds_are_frozen_off_the_chain(tmp_path, kind):
    imported = readings(tmp_path, arm(more=f'<link name="x">{BALL}</link>{joint("loose", "hand", "x", "", kind)}'))[1]()
    assert imported.joint_names == ("shoulder", "elbow", "wrist")
    assert all(name.startswith("loose") for name in imported.frozen)


def test_a_frozen_follower_stands_at_its_offset(tmp_path):
    rods = f'<link name="x">{BALL}</link><link name="y">{BALL}</link>{joint("jaw", "hand", "x")}'
    rods += joint("other", "hand", "y", f'{RANGE}<mimic joint="jaw" multiplier="2" offset="0.25"/>')
    free = readings(tmp_path, arm(more=rods))[1]()
    held = import_robot(tmp_path / "arm.urdf", "hand", fixed={"jaw": 0.0})
    assert free.fixed == {"other": 0.25} and free.frozen == ("jaw",)
    np.testing.assert_array_equal(free.model.body("y").quat, held.model.body("y").quat)
    assert free.model.body("y").quat[0] == pytest.approx(np.cos(0.125))


# Elements that are not read

NAMED = {
    "misspelt": (f"{RANGE}<dynamic/>", "<dynamic> of joint 'elbow'"),
    "at another place": (f"{RANGE}<collision/>", "<collision> of joint 'elbow'"),
    "a misspelt attribute": ('<limit lowr="-1" upper="2"/>', "'lowr' in <limit> of joint 'elbow'"),
    "a rotation of another program": (
        RANGE.replace("/>", '/><origin quat_xyzw="0 0 1 0"/>'),
        "'quat_xyzw' in <origin> of joint 'elbow'",
    ),
    "text": (RANGE.replace("/>", ">1 2</limit>"), "text '1 2' in <limit> of joint 'elbow'"),
    "kinematics with a prefix": (f'{RANGE}<drake:mimic joint="shoulder"/>', "<drake:mimic> of joint 'elbow'"),
}


@pytest.mark.parametrize("case", NAMED)
def test_an_element_that_is_not_read_is_named(tmp_path, case):
    content, named = NAMED[case]
    text = arm(content).replace('<origin xyz="0 0 0.3"/>', "") if "<origin" in content else arm(content)
    for read in readings(tmp_path, text):
        with pytest.warns(UserWarning, match=re.escape(f"not used: {named}") + "$"):
            read()


def test_elements_of_simulators_controllers_and_pictures_are_not_named(tmp_path):
    more = '<gazebo reference="base"><x y="1"/></gazebo><transmission name="t"/><material name="m"/><a:b c="1"/>'
    content = f'{RANGE}<dynamics damping="1"/><calibration rising="0"/>'
    assert loaded(tmp_path, arm(content, more=more)).joint_names == ("shoulder", "elbow", "wrist")


def test_the_warning_about_unread_elements_is_bounded(tmp_path):
    more = "".join(f"<x{k}{'y' * 500}/>" for k in range(100))
    with pytest.warns(UserWarning, match="and 92 more") as caught:
        loaded(tmp_path, arm(more=more))
    assert len(str(caught[0].message)) < 1500


def test_an_axis_that_is_no_unit_vector_is_named(tmp_path):
    text = arm().replace('"0 1 0"', '"0 2 0"', 1)
    with pytest.warns(Note, match="the length of the <axis> of shoulder is not 1"):
        robot = loaded(tmp_path, text)
    np.testing.assert_array_equal(robot.axis, loaded(tmp_path, arm()).axis)


def test_an_impossible_inertia_is_named_and_does_not_matter_to_poses(tmp_path):
    inertia = '<inertial><mass value="1"/><inertia ixx="1" ixy="2" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    own = {"inertia": arm().replace('<link name="lower">', f'<link name="lower">{inertia}'), "none": arm()}
    found = {}
    for name, text in own.items():
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            found[name] = loaded(tmp_path, text), import_robot(tmp_path / "arm.urdf", "hand").massive
        named = "masses of bodies whose inertia has a negative eigenvalue are not used: lower"
        assert [str(each.message).endswith(named) for each in caught] == ([True] * 2 if name == "inertia" else [])
    for field in ("T_parent_joint", "axis", "lower", "upper"):
        np.testing.assert_array_equal(*(getattr(robot, field) for robot, _ in found.values()))
    assert found["inertia"][1] == ()


UNUSED = {  # text of the file, and what the ledger counts and names
    "a picture of a link": ('<visual><geometry><box size="1 1 1"/></geometry></visual>', "<visual> 1", None),
    "a prefix of another program": ("<klampt:x/>", "<klampt:x> 1", None),
    "a misspelt element": ("<colision/>", "<colision> 1", "not used: <colision> of link 'hand'"),
}


@pytest.mark.parametrize("case", UNUSED)
def test_the_ledger_counts_what_is_not_used_and_names_what_is_not_harmless(tmp_path, case):
    text, counted, named = UNUSED[case]
    read = readings(tmp_path, arm().replace('<link name="hand">', f'<link name="hand">{text}'))[1]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert read().unused == (counted,)
    found = [str(each.message).removeprefix(f"{tmp_path / 'arm.urdf'}: ") for each in caught]
    assert found == ([named] if named else [])


def test_the_ledger_of_an_mjcf_file_names_soft_bodies_and_limits_of_motors(tmp_path):
    body = '<geom size="0.1"/>'
    for name in "cba":
        body = f'<body name="{name}" pos="0 0 0.3"><joint name="j{name}" range="-1 1" damping="2"/>{body}</body>'
    rest = '<deformable><skin name="s" file="a.skn"/></deformable><keyframe/>'
    rest += '<actuator><motor joint="ja" forcerange="-9 9"/></actuator>'
    (tmp_path / "arm.xml").write_text(f"<mujoco><worldbody>{body}</worldbody>{rest}</mujoco>")
    with pytest.warns(UserWarning, match=r"arm.xml: not used: 'forcerange' in <actuator>, <deformable>$"):
        unused = import_robot(tmp_path / "arm.xml", "c").unused
    counts = ["'damping' in <joint> 3", "<actuator> 1", "<deformable> 1", "<keyframe> 1", "<skin> 1"]
    assert sorted(unused) == sorted(["'forcerange' in <actuator> 1", *counts])


BOUNDS = {  # text in an MJCF file with a joint that follows another one, and what is named
    "a tendon's range": (
        '<tendon><fixed name="cable" range="0 1"><joint joint="ja" coef="1"/></fixed></tendon>',
        "'range' in <fixed> of cable",
    ),
    "a tendon without limits": (
        '<tendon><fixed range="0 1" limited="false"><joint joint="ja" coef="1"/></fixed></tendon>',
        None,
    ),
    "a flag": ('<option><flag equality="disable"/></option>', "equality='disable' in <flag>"),
    "a soft body's constraint": ('<equality><flexvert flex="f"/></equality>', "<flexvert>"),
}


@pytest.mark.parametrize("case", BOUNDS)
def test_limits_of_tendons_and_flags_of_constraints_are_named(tmp_path, case):
    text, named = BOUNDS[case]
    body = '<body><joint name="ja"/><geom size="0.1"/><body><joint name="jb"/><geom size="0.1"/></body></body>'
    pair = '<equality><joint joint1="jb" joint2="ja"/></equality>'
    (tmp_path / "arm.xml").write_text(f"<mujoco><worldbody>{body}</worldbody>{pair}{text}</mujoco>")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_spec(tmp_path / "arm.xml")
    found = [str(each.message).removeprefix(f"{tmp_path / 'arm.xml'}: not used: ") for each in caught]
    assert found == ([named] if named else [])


def test_verbose_lists_the_ledger(tmp_path, capsys):
    (tmp_path / "arm.urdf").write_text(arm().replace("</robot>", '<material name="a"/><material name="b"/></robot>'))
    words = ["robot", str(tmp_path / "arm.urdf"), "--tcp", "hand", "--out", str(tmp_path / "arm.xml"), "--replace"]
    assert main(words) == 0 and "not used" not in capsys.readouterr().out
    assert main([*words, "--verbose"]) == 0
    assert "not used            <material> 2" in capsys.readouterr().out
