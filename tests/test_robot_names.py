"""Names in a model file: xacro, links called world, and repeated names."""

import importlib.util
import re

import mujoco
import numpy as np
import pytest

import htcp_jax
from htcp_jax.cli import main
from htcp_jax.errors import InputError, install_command
from htcp_jax.io.robots import model_files
from htcp_jax.io.robots.vendor_import import import_robot

BALL = '<collision><geometry><sphere radius="0.05"/></geometry></collision>'
JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
  <origin xyz="0 0 0.3"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>"""


def urdf(*chain, kinds=("revolute",) * 3, before="") -> str:
    """A URDF whose links are a chain, with joints j1, j2, ...; `before` precedes them."""
    links = "".join(f'<link name="{name}">{BALL}</link>' for name in chain)
    pairs = zip(kinds, chain, chain[1:], strict=False)
    joints = [JOINT.format(name=f"j{k}", kind=kind, parent=a, child=b) for k, (kind, a, b) in enumerate(pairs, 1)]
    return f'<robot name="r">{before}{links}{"".join(joints)}</robot>'


def tcp_at(path, tcp, x) -> np.ndarray:
    """Position of the TCP by the arm that the model is made into."""
    out = path.parent / "arm.xml"
    assert main(["robot", str(path), "--tcp", tcp, "--out", str(out), "--replace"]) == 0
    model = mujoco.MjModel.from_xml_path(str(out))
    data = mujoco.MjData(model)
    data.qpos[:] = x
    mujoco.mj_kinematics(model, data)
    return data.site("tcp").xpos.copy()


def refusal(path, capsys) -> str:
    """The line by which the command refuses the model; nothing is written."""
    there = sorted(path.parent.iterdir())
    assert main(["robot", str(path), "--out", str(path.parent / "arm.xml")]) == 2
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1 and not printed.out and sorted(path.parent.iterdir()) == there
    return printed.err


@pytest.mark.parametrize("place", range(4))
def test_a_link_called_world_anywhere_moves_as_one_of_another_name(tmp_path, place):
    names = ["base", "a", "b", "c"]
    plain, other = tmp_path / "plain.urdf", tmp_path / "world.urdf"
    plain.write_text(urdf(*names))
    other.write_text(urdf(*("world" if k == place else name for k, name in enumerate(names))))
    x, last = [0.3, -0.2, 0.5], "world_link" if place == 3 else "c"
    np.testing.assert_array_equal(tcp_at(other, last, x), tcp_at(plain, "c", x))


def test_a_job_may_name_such_a_model_itself(tmp_path):
    path = tmp_path / "world.urdf"
    path.write_text(urdf("base", "a", "world", "c"))
    assert htcp_jax.load_robot(path).capsule_names == ("base:0", "a:1", "world_link:2", "c:3")


def test_a_new_name_is_not_taken(tmp_path):
    path = tmp_path / "world.urdf"
    path.write_text(urdf("base", "world_link", "world", "c"))
    arm = import_robot(path)
    assert [arm.model.body(b).name for b in arm.bodies] == ["world", "base", "world_link", "world_link_", "c"]


def test_an_empty_world_may_be_stated_twice(tmp_path):
    path = tmp_path / "world.urdf"
    stand = '<link name="world"/><link name="world"/>' + JOINT.format(
        name="stand", kind="fixed", parent="world", child="base"
    )
    path.write_text(urdf("base", "a", "b", "c", before=stand))
    assert import_robot(path).joint_names == ("j1", "j2", "j3")


def test_a_body_called_world_is_accepted(tmp_path):
    path, body = tmp_path / "world.xml", '<body name="{}"><joint name="{}"/><geom size="0.1"/>'
    bodies = "".join(body.format(*names) for names in (("a", "j1"), ("world", "j2"), ("c", "j3")))
    path.write_text(f"<mujoco><worldbody>{bodies}</body></body></body></worldbody></mujoco>")
    arm = import_robot(path)
    assert arm.joint_names == ("j1", "j2", "j3") and arm.model.body(2).name == "world_link"


REPEATED = {
    "link": (urdf("base", "a", "b", "c").replace("<joint", f'<link name="b">{BALL}</link><joint', 1), "link 'b'"),
    "joint": (urdf("base", "a", "b", "c").replace('name="j2"', 'name="j1"'), "joint 'j1'"),
    "two of them": (
        urdf("base", "a", "b", "c").replace('name="j2"', 'name="j1"').replace('<link name="c"/>', "").replace(
            "<joint", '<link name="a"/><link name="c"/><joint', 1
        ),
        "link 'a', link 'c', joint 'j1'",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REPEATED)
def test_repeated_names_are_reported(tmp_path, capsys, case):
    text, names = REPEATED[case]
    (tmp_path / "arm.urdf").write_text(text)
    line = refusal(tmp_path / "arm.urdf", capsys)
    assert f"arm.urdf: repeated names: {names}; the names of links and joints must be unique" in line


@pytest.mark.parametrize("kind", ["mesh", "body"])
def test_repeated_names_of_an_mjcf_file_are_reported(tmp_path, capsys, kind):
    asset = 2 * '<mesh name="twice" vertex="0 0 0  1 0 0  0 1 0  0 0 1"/>' if kind == "mesh" else ""
    bodies = 2 * f'<body name="{"twice" if kind == "body" else ""}"><geom size="1"/></body>'
    (tmp_path / "arm.xml").write_text(
        f"<mujoco><asset>{asset}</asset><worldbody>{bodies}</worldbody></mujoco>".replace(' name=""', "")
    )
    (tmp_path / "arm.xml").rename(tmp_path / "model.xml")
    assert f"repeated name 'twice' in {kind}" in refusal(tmp_path / "model.xml", capsys)


def test_what_matters_to_no_arm_may_be_repeated(tmp_path):
    """Materials and fixed joints: published models repeat their names."""
    path, colour = tmp_path / "arm.urdf", '<material name="grey"><color rgba="1 1 1 1"/></material>'
    text = urdf("base", "a", "b", "c", "d", "e", kinds=("revolute", "revolute", "revolute", "fixed", "fixed"))
    path.write_text(
        text.replace('name="j5"', 'name="j4"').replace('<link name="base">', 2 * colour + '<link name="base">')
    )
    assert import_robot(path).joint_names == ("j1", "j2", "j3")


MACRO = '<xacro:macro name="arm" params="prefix"><link name="${prefix}base"/></xacro:macro>'
XACRO = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'


EXPAND = {"my arm.urdf.xacro": "xacro 'my arm.urdf.xacro' > arm.urdf", "arm.urdf": "xacro arm.urdf > expanded.urdf"}


@pytest.fixture
def no_xacrodoc(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "xacrodoc" else find(name))


@pytest.mark.parametrize("file", EXPAND)
def test_without_the_extra_a_xacro_file_is_refused_with_the_command_that_expands_it(
    tmp_path, capsys, monkeypatch, no_xacrodoc, file
):
    """By its suffix, or by its elements; the command does not write over the file."""
    monkeypatch.chdir(tmp_path)
    macro = "" if "xacro" in file else MACRO
    (tmp_path / file).write_text(urdf("base", "a", "b", "c", before=macro).replace("<robot", f"<robot {XACRO}"))
    assert main(["robot", file, "--out", "arm.xml"]) == 2
    needs = f'reading it needs the extra "xacro": {install_command("xacro")}; or expand it first'
    assert capsys.readouterr().err == f"htcp: {file}: a xacro file; {needs}: {EXPAND[file]}\n"
    assert [each.name for each in tmp_path.iterdir()] == [file]


def test_an_srdf_file_may_be_a_xacro_file_too(tmp_path, capsys, no_xacrodoc):
    (tmp_path / "arm.urdf").write_text(urdf("base", "a", "b", "c"))
    (tmp_path / "arm.srdf.xacro").write_text(f'<robot name="r" {XACRO}/>')
    words = ["--srdf", str(tmp_path / "arm.srdf.xacro"), "--out", str(tmp_path / "arm.xml")]
    assert main(["robot", str(tmp_path / "arm.urdf"), *words]) == 2
    assert f"expand it first: xacro {tmp_path / 'arm.srdf.xacro'} > arm.srdf" in capsys.readouterr().err


@pytest.fixture
def macros(tmp_path):
    """A xacro file of a package, whose macro is in another package in the same folder, which is not named in ROS."""
    pytest.importorskip("xacrodoc", reason="the extra `xacro` is not installed")
    for name in ("arm_description/urdf", "parts"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "parts/j.xacro").write_text(f'<robot {XACRO}><xacro:property name="top" value="${{1 + 1}}"/></robot>')
    text = urdf("base", "a", "b", "c", before='<xacro:include filename="$(find parts)/j.xacro"/>')
    file = tmp_path / "arm_description/urdf/arm.xacro"
    file.write_text(text.replace("<robot", f"<robot {XACRO}").replace('upper="1"', 'upper="${top}"'))
    return file


def test_a_xacro_file_is_expanded_with_the_packages_near_it(macros, tmp_path):
    arm = import_robot(macros)
    assert arm.joint_names == ("j1", "j2", "j3") and arm.model.jnt_range[:, 1].tolist() == [2.0] * 3
    assert model_files(macros) == {macros, tmp_path / "parts/j.xacro"}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("find parts", "find lost", "no package 'lost' in "),
        ("find parts", "arg side", "xacro cannot expand it: Undefined substitution argument side"),
        ("${top}", "${open('a')}", "xacro cannot expand it: name 'open' is not defined"),
    ],
)
def test_a_xacro_file_that_cannot_be_expanded_is_refused_in_one_line(macros, old, new, message):
    macros.write_text(macros.read_text().replace(old, new))
    with pytest.raises(InputError, match=re.escape(f"{macros}: {message}")) as caught:
        import_robot(macros)
    assert "\n" not in str(caught.value)


def test_an_expanded_file_may_still_declare_xacro(tmp_path):
    """Published URDFs do, for example the iiwa's and PR2's."""
    (tmp_path / "arm.urdf").write_text(urdf("base", "a", "b", "c").replace("<robot", f"<robot {XACRO}"))
    assert import_robot(tmp_path / "arm.urdf").joint_names == ("j1", "j2", "j3")
