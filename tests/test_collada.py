"""Collada meshes of a model: where their triangles are, and what is refused in one line."""

import importlib.util

import numpy as np
import pytest
from collada_box import DAE

from htcp_jax.cli import main
from htcp_jax.errors import InputError, Note, install_command
from htcp_jax.io.robots.collada_mesh import read_triangles
from htcp_jax.io.robots.vendor_import import import_robot

pytest.importorskip("collada", reason="the extra `collada` is not installed")


def written(folder, *changes):
    """Write DAE with some passages replaced; a passage to be replaced must be there."""
    text = DAE
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = folder / "box.dae"
    file.write_text(text)
    return file


def bounds(file) -> np.ndarray:
    triangles = read_triangles(file)
    assert triangles.shape[1:] == (3, 3) and triangles.dtype == np.float64
    return np.concatenate([triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))])


def test_every_side_of_the_box_is_there_at_its_node(tmp_path):
    file = written(tmp_path)
    assert len(read_triangles(file)) == 12
    np.testing.assert_allclose(bounds(file), [0, 0, 1, 0.4, 0.1, 1.06], atol=1e-7)


def test_a_concave_polygon_covers_itself_only(tmp_path):
    """The side x, y at z = 0 becomes a frame that is open at the middle of its side y = 0.1."""
    old = "0 0 0  .4 0 0  .4 .1 0  0 .1 0  0 0 .06  .4 0 .06  .4 .1 .06  0 .1 .06"
    u = "0 0 0  3 0 0  3 3 0  2 3 0  2 1 0  1 1 0  1 3 0  0 3 0"
    sides = (
        "4 4 4 4 4 4</vcount><p>0 3 2 1  4 5 6 7  0 1 5 4  1 2 6 5  2 3 7 6  3 0 4 7",
        "8</vcount><p>0 1 2 3 4 5 6 7",
    )
    found = read_triangles(written(tmp_path, (old, u), sides, ('<polylist count="6">', '<polylist count="1">')))
    edges = found[:, 1:] - found[:, :1]
    assert np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum() / 2 == pytest.approx(7.0)


def test_lines_are_named(tmp_path):
    lines = '</polylist><lines count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1</p></lines>'
    with pytest.warns(Note, match="box.dae: its 1 sets of lines are ignored"):
        assert len(read_triangles(written(tmp_path, ("</polylist>", lines)))) == 12


def test_the_unit_scales_the_mesh(tmp_path):
    file = written(tmp_path, ('name="metre" meter="1"', 'name="inch" meter="0.0254"'))
    np.testing.assert_allclose(bounds(file), 0.0254 * np.array([0, 0, 1, 0.4, 0.1, 1.06]), atol=1e-8)


def test_the_up_axis_is_ignored_as_in_rviz(tmp_path):
    as_is = read_triangles(written(tmp_path))
    np.testing.assert_array_equal(read_triangles(written(tmp_path, ("Z_UP", "Y_UP"))), as_is)


def test_a_node_that_is_used_twice_is_there_twice(tmp_path):
    library = '<library_nodes><node id="part"><instance_geometry url="#box"/></node></library_nodes>'
    use = '<node id="{}"><translate>{} 0 0</translate><instance_node url="#part"/></node>'
    two = use.format("one", 1) + use.format("two", 3)
    file = written(tmp_path, ("<library_nodes></library_nodes>", library), ('<node id="n">', f'{two}<node id="n">'))
    assert len(read_triangles(file)) == 36
    np.testing.assert_allclose(bounds(file), [0, 0, 0, 3.4, 0.1, 1.06], atol=1e-6)


LADDER = "".join(
    f'<node id="k{k}">{2 * f"""<instance_node url="#k{k - 1}"/>"""}</node>' if k else '<node id="k0"/>'
    for k in range(40)
)
ENTITY = '<!DOCTYPE c [<!ENTITY e SYSTEM "file:///etc/passwd">]><COLLADA'
BAD = {
    "cut off": [("</COLLADA>", "")],
    "an entity": [("<COLLADA", ENTITY)],
    "corners missing": [(".4 .1 .06  0 .1 .06", "")],
    "a word among the numbers": [("0 0 .06  .4", "0 zero .06  .4")],
    "NaN": [("0 0 .06  .4", "0 nan .06  .4")],
    "a corner beyond the last": [("3 0 4 7", "3 0 4 8")],
    "a negative corner": [("3 0 4 7", "3 0 4 -7")],
    "fewer corners than stated": [("3 0 4 7</p>", "3 0 4</p>")],
    "more corners than stated": [("3 0 4 7</p>", "3 0 4 7 1</p>")],
    "fewer polygons than stated": [('<polylist count="6">', '<polylist count="7">')],
    "fewer numbers than stated": [('count="24"', 'count="27"')],
    "a polygon that crosses itself": [("0 3 2 1  4", "0 2 3 1  4")],
    "a polygon with a hole": [
        (
            "</polylist>",
            '</polylist><polygons count="1"><input semantic="VERTEX" source="#v" '
            'offset="0"/><ph><p>0 1 2</p><h>0 1 2</h></ph></polygons>',
        )
    ],
    "a geometry that is not there": [('url="#box"', 'url="#cone"')],
    "a unit of nothing": [('meter="1"', 'meter="0"')],
    "no scene": [('<scene><instance_visual_scene url="#s"/></scene>', "")],
    "nodes without end": [
        ("<library_nodes></library_nodes>", f"<library_nodes>{LADDER}</library_nodes>"),
        ('<instance_geometry url="#box"/></node></visual', '<instance_node url="#k39"/></node></visual'),
    ],
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_one_line(tmp_path, capfd, case):
    file = written(tmp_path, *BAD[case])
    with pytest.raises(InputError) as refused:
        read_triangles(file)
    line = str(refused.value)
    assert line.startswith(f"{file}: ") and "\n" not in line and len(line) < 400
    assert capfd.readouterr() == ("", "")


URDF = """<robot name="rod"><link name="base"/><link name="a"/><link name="b"/>
  <link name="c"><collision><geometry><mesh filename="package://rods/meshes/box.dae" scale="1 2 1"/></geometry>
  </collision></link>{joints}</robot>"""
JOINT = '<joint name="{1}" type="revolute"><parent link="{0}"/><child link="{1}"/><limit lower="-1" upper="1"/></joint>'


@pytest.fixture
def package(tmp_path):
    """A ROS package with a model of three joints, whose last link is the box."""
    for name in ("urdf", "meshes"):
        (tmp_path / "rods" / name).mkdir(parents=True)
    written(tmp_path / "rods/meshes")
    joints = "".join(JOINT.format(*pair) for pair in (("base", "a"), ("a", "b"), ("b", "c")))
    (tmp_path / "rods/urdf/rod.urdf").write_text(URDF.format(joints=joints))
    return tmp_path / "rods/urdf/rod.urdf"


def test_a_model_with_collada_meshes_is_imported(package):
    out = package.parent / "arm.xml"
    assert main(["robot", str(package), "--out", str(out), "--most", "1"]) == 0 and out.is_file()
    (piece,) = import_robot(package, most=1).covers[4].pieces.values()
    np.testing.assert_allclose(np.ptp(piece.triangles.reshape(-1, 3), axis=0), [0.4, 0.2, 0.06], atol=1e-7)


def test_without_the_extra_one_line_names_it(package, capsys, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "collada" else find(name))
    out = package.parent / "arm.xml"
    assert main(["robot", str(package), "--out", str(out)]) == 2 and not out.exists()
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and f'needs the extra "collada": {install_command("collada")}' in said
