"""A TCP on a gripper's moving jaw, and one with too few joints: which frames the command names instead."""

import warnings

import pytest

from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.io.robots.vendor_import import import_robot

BALL = '<collision><geometry><sphere radius="0.05"/></geometry></collision>'
JOINT = """<link name="{child}">{ball}</link><joint name="{name}" type="{kind}"><parent link="{parent}"/>
  <child link="{child}"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/><limit lower="-1" upper="1"/>{more}</joint>"""


def joint(name, parent, child, kind="revolute", more="") -> str:
    return JOINT.format(name=name, parent=parent, child=child, kind=kind, more=more, ball=BALL)


ARM = f'<link name="base">{BALL}</link>' + "".join(
    joint(f"j{k}", parent, f"l{k}") for k, parent in enumerate(("base", "l1", "l2"), 1)
)
FLANGE = joint("mount", "l3", "palm", "fixed")


def written(folder, *joints):
    path = folder / "arm.urdf"
    path.write_text(f'<robot name="r">{ARM}{"".join(joints)}</robot>')
    return path


JAWS = {
    "by its joint's name": [joint("gripper", "palm", "beak")],
    "by its body's name": [joint("j4", "palm", "moving_jaw")],
    "followed by another one": [
        joint("j4", "palm", "one", "prismatic"),
        joint("j5", "l1", "two", more='<mimic joint="j4"/>'),
    ],
    "one of two opposite slides": [joint("j4", "palm", "one", "prismatic"), joint("j5", "palm", "two", "prismatic")],
    "at the end of two joints": [joint("finger_1", "palm", "one"), joint("finger_2", "one", "two")],
}


@pytest.mark.parametrize("case", JAWS)
def test_a_tcp_on_a_jaw_is_a_warning_that_names_the_frames_before_it(tmp_path, case):
    path = written(tmp_path, FLANGE, *JAWS[case])
    tip = {"by its joint's name": "beak", "by its body's name": "moving_jaw", "at the end of two joints": "two"}
    with pytest.warns(UserWarning) as warned:
        arm = import_robot(path, tip.get(case, "one"))
    moved = arm.joint_names[3:]
    fix = " ".join(f"--fix {name}=VALUE" for name in moved)
    assert str(warned[0].message) == (
        f"{path}: the TCP {arm.tip.name!r} is on a jaw that {', '.join(moved)} moves as a part of the arm; "
        f"choose a frame before the jaw with --tcp (l3, palm), or freeze the jaw with {fix}"
    )
    assert len(warned) == 1 and (not arm.followers) == (case != "followed by another one")


def test_the_jaw_that_is_found_without_a_name_is_reported_by_the_command(tmp_path, capsys):
    path = written(tmp_path, FLANGE, joint("gripper", "palm", "beak"))
    assert main(["robot", str(path), "--out", str(tmp_path / "arm.xml")]) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "warning" in line]
    assert len(said) == 1 and said[0].startswith(
        f"htcp: warning: {path}: the TCP 'beak' is on a jaw that gripper moves"
    )


QUIET = {
    "a frozen jaw": ([FLANGE, joint("gripper", "palm", "beak")], "beak", {"gripper": 0.2}),
    "a wrist that carries a gripper": ([joint("wrist_roll", "l3", "gripper_link")], "gripper_link", None),
    "a slide alone": ([joint("j4", "l3", "tube", "prismatic")], "tube", None),
    "a lift beside a slide at the base": ([joint("lift", "base", "torso", "prismatic")], "l3", None),
}


@pytest.mark.parametrize("case", QUIET)
def test_other_arms_give_no_warning(tmp_path, case):
    joints, tcp, fixed = QUIET[case]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        import_robot(written(tmp_path, *joints), tcp, fixed=fixed)


def test_a_finger_that_is_a_robot_gives_no_warning(tmp_path):
    path = written(tmp_path)
    path.write_text(path.read_text().replace('joint name="j', 'joint name="finger_'))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert import_robot(path).joint_names == ("finger_1", "finger_2", "finger_3")


def test_too_few_joints_to_the_tcp_suggest_another_one(tmp_path):
    with pytest.raises(InputError) as refused:
        import_robot(written(tmp_path, FLANGE), "l2")
    assert str(refused.value) == (
        f"{tmp_path / 'arm.urdf'}: 2 joints from the world to the TCP; at least 3 are needed; --tcp may name another "
        "frame: l3, palm"
    )


def test_the_only_site_is_suggested_no_second_time(tmp_path, capsys):
    """An MJCF file with one site, on the base: it is taken for the TCP, as in robosuite's arms."""
    body, path = '<body name="{0}"><joint name="j{0}"/><geom size="0.1"/>', tmp_path / "arm.xml"
    bodies = '<body name="base"><site name="here"/>' + "".join(body.format(name) for name in "abc") + 4 * "</body>"
    path.write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    assert main(["robot", str(path), "--out", str(tmp_path / "new.xml")]) == 2 and len(list(tmp_path.iterdir())) == 1
    assert capsys.readouterr().err == (
        f"htcp: {path}: no joints from the world to the TCP; at least 3 are needed; --tcp may name another frame: c\n"
    )


def test_nothing_is_suggested_where_nothing_moves_enough(tmp_path):
    path = written(tmp_path)
    path.write_text(path.read_text().replace('"revolute"', '"fixed"'))
    with pytest.raises(InputError, match=r"at least 3 are needed$"):
        import_robot(path, "l3")
