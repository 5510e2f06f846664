"""`htcp robot`: moving and frozen joints, the TCP, enclosing capsules; compared with MuJoCo's own reading."""

import json
import re
from itertools import combinations
from pathlib import Path

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import toy
import trimesh
from enclosed import are_enclosed

import htcp_jax
from htcp_jax.cli import main
from htcp_jax.cli.robot import reach_text
from htcp_jax.errors import InputError
from htcp_jax.io.robots import mjcf
from htcp_jax.io.robots.body_covers import BodyCover
from htcp_jax.io.robots.loading import load_robot
from htcp_jax.io.robots.vendor_import import import_robot
from htcp_jax.model.kinematics import tcp_pose
from htcp_jax.viewer import draw_arm

# A slide, three hinges, a gripper of two fingers; shapes of every kind that URDF has.
URDF = """
<robot name="crane">
  <link name="base"><collision><geometry><box size="0.2 0.3 0.1"/></geometry></collision></link>
  <link name="mast"><collision><origin xyz="0 0 0.2" rpy="0.1 0.2 0.3"/><geometry>
    <cylinder radius="0.05" length="0.5"/></geometry></collision></link>
  <link name="boom"><collision><origin xyz="0.1 0 0" rpy="0 1 0"/><geometry>
    <mesh filename="package://crane_description/meshes/boom.stl" scale="0.5 1 2"/></geometry></collision></link>
  <link name="jib"><collision><geometry><sphere radius="0.04"/></geometry></collision></link>
  <link name="hand"><collision><geometry>
    <mesh filename="meshes/boom.stl" scale="0.1 0.1 0.1"/></geometry></collision></link>
  <link name="left"/> <link name="right"/> <link name="grasp"/>
  <joint name="lift" type="prismatic"><parent link="base"/><child link="mast"/><axis xyz="0 0 1"/>
    <limit lower="0.1" upper="0.4" velocity="0.2" effort="500"/></joint>
  <joint name="turn" type="continuous"><parent link="mast"/><child link="boom"/><axis xyz="0 0 1"/>
    <origin xyz="0 0 0.5"/><limit velocity="1.5" effort="90" acceleration="4"/></joint>
  <joint name="left_finger" type="prismatic"><parent link="hand"/><child link="left"/><axis xyz="0 1 0"/>
    <origin xyz="0 0 0.05"/><limit lower="0" upper="0.04" velocity="9" effort="9"/></joint>
  <joint name="bend" type="revolute"><parent link="boom"/><child link="jib"/><axis xyz="0 1 0"/>
    <origin xyz="0.4 0 0" rpy="0 0.5 0"/><limit lower="-1" upper="2" velocity="2.5" effort="0"/></joint>
  <joint name="roll" type="revolute"><parent link="jib"/><child link="hand"/><axis xyz="1 0 0"/>
    <origin xyz="0.3 0 0"/><limit lower="-3" upper="3" effort="20" drake:acceleration="8"/></joint>
  <joint name="right_finger" type="prismatic"><parent link="hand"/><child link="right"/><axis xyz="0 -1 0"/>
    <origin xyz="0 0 0.05"/><limit lower="0" upper="0.04" velocity="9" effort="9"/></joint>
  <joint name="in_hand" type="fixed"><parent link="hand"/><child link="grasp"/>
    <origin xyz="0.1 0 0" rpy="0 1.57 0"/></joint>
</robot>
"""
MESH = trimesh.creation.box((0.4, 0.1, 0.06), transform=trimesh.transformations.translation_matrix((0.2, 0.01, 0)))

MJCF = """
<mujoco model="mixed">
  <compiler angle="degree" meshdir="meshes"/>
  <default><default class="big"><mesh scale="2 3 1"/></default></default>
  <asset>
    <mesh name="boom" class="big" file="boom.stl" refpos="0.1 0.02 0.03" refquat="0.9 0.1 0.3 0.2"/>
    <mesh name="wedge" vertex="0 0 0  0.2 0 0  0 0.1 0  0 0 0.3"/>
    <texture name="t" type="2d" file="nowhere.png"/> <material name="m" texture="t"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/> <geom name="table" type="box" size="1 1 1" pos="0 0 -2"/>
    <body name="target" mocap="true"><geom type="box" size="1 1 1"/><site/></body>
    <body name="ball" pos="1 1 1"><freejoint/><geom type="box" size="0.1 0.1 0.1"/></body>
    <body name="a" pos="0.1 0 0.2" euler="10 20 30"><joint name="j1" axis="0 0 1" range="-90 90"/>
      <geom type="mesh" mesh="boom" pos="0.1 0.2 0.3" euler="40 0 20" material="m"/>
      <body name="b" pos="0.5 0 0"><joint name="j2" axis="0 1 0" ref="30" range="0 90"/>
        <geom type="capsule" mesh="wedge" pos="0 0 0.1" euler="0 30 0"/>
        <geom name="own" type="capsule" fromto="0 0 0 0.1 0 0" size="0.02"/>
        <body name="c" pos="0 0 0.4"><joint name="j3" axis="1 0 0" pos="0 0.1 0" actuatorfrcrange="-5 5"/>
          <geom type="ellipsoid" size="0.05 0.1 0.2" contype="0" conaffinity="0"/>
          <body name="d" pos="0 0 0.2"><geom type="ellipsoid" size="0.1 0.05 0.02"/>
            <site name="flange" pos="0 0 0.1"/></body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A ROS package: the model in one folder, its meshes in another."""
    package = tmp_path_factory.mktemp("ros") / "crane_description"
    for name in ("urdf/meshes", "meshes"):
        (package / name).mkdir(parents=True)
        MESH.export(package / name / "boom.stl")
    (package / "urdf/crane.urdf").write_text(URDF)
    (package / "urdf/mixed.xml").write_text(MJCF)
    return package / "urdf"


@pytest.fixture(scope="module")
def crane(folder):
    """The file that the command writes."""
    out = folder.parent / "arms/crane.xml"
    assert main(["robot", str(folder / "crane.urdf"), "--tcp", "grasp", "--out", str(out), "--most", "1"]) == 0
    return out


def mujoco_reading(path: Path) -> mujoco.MjModel:
    """Model as MuJoCo itself reads and compiles a file, with its meshes; no bodies are merged."""
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.fusestatic = False
    spec.compiler.boundmass = spec.compiler.boundinertia = 1e-9
    spec.compiler.balanceinertia = True
    for texture, material in ((list(spec.textures), list(spec.materials)),):
        for each in (*material, *texture):
            spec.delete(each)
    for geom in spec.geoms:
        geom.material = ""
    return spec.compile()


def test_the_tcp_moves_as_in_the_model_with_its_gripper_closed(crane, folder):
    text = (folder / "crane.urdf").read_text().replace("package://crane_description/meshes/boom.stl", "boom.stl")
    theirs = mujoco.MjSpec.from_string(text)
    theirs.compiler.meshdir, theirs.compiler.fusestatic = str(folder / "meshes"), False
    theirs.compiler.boundmass = theirs.compiler.boundinertia = 1e-9
    for mesh in theirs.meshes:
        mesh.file = Path(mesh.file).name
    model = theirs.compile()
    data, arm = mujoco.MjData(model), htcp_jax.load_robot(crane)
    assert arm.joint_names == ("lift", "turn", "bend", "roll") and arm.slides == (True, False, False, False)
    for x in np.random.default_rng(1).uniform(-2, 2, (5, 4)):
        for name, value in zip(arm.joint_names, x, strict=True):
            data.joint(name).qpos[:] = value
        mujoco.mj_kinematics(model, data)
        T = np.asarray(tcp_pose(arm, jnp.asarray(x)))
        np.testing.assert_allclose(T[:3, 3], data.body("grasp").xpos, rtol=0, atol=1e-12)
        np.testing.assert_allclose(T[:3, :3], data.body("grasp").xmat.reshape(3, 3), rtol=0, atol=1e-12)


def test_limits_of_a_urdf_are_read_back(crane, folder):
    """Limits of a URDF, by joint, despite other branches; a missing speed and an effort of 0 are none."""
    arm = htcp_jax.load_robot(crane)
    np.testing.assert_array_equal(arm.lower, [0.1, -np.inf, -1, -3])
    np.testing.assert_array_equal(arm.speed, [0.2, 1.5, 2.5, np.inf])
    np.testing.assert_array_equal(arm.acceleration, [np.inf, 4, np.inf, 8])
    np.testing.assert_array_equal(arm.effort, [500, 90, np.inf, 20])


def test_capsules_hold_meshes_boxes_and_cylinders_of_a_urdf(folder):
    arm = import_robot(folder / "crane.urdf", "grasp", most=1)
    found = {arm.model.body(b).name: cover for b, cover in arm.covers.items()}
    assert {name: cover.kinds for name, cover in found.items()} == {
        "base": ("box",), "mast": ("cylinder",), "boom": ("mesh",), "jib": (), "hand": ("mesh",)
    }  # fmt: skip
    assert all(are_enclosed(cover.enclosed, list(cover.fitted.values())) for cover in found.values() if cover.fitted)
    assert found["jib"].own["jib"].radius == 0.04 and not found["jib"].fitted
    rim = 0.05 * np.stack([np.cos(angle := np.linspace(0, 7, 500)), np.sin(angle), np.full(500, 5.0)], axis=1)
    turn = mujoco_turn("0.1 0.2 0.3")
    whole = [rim * [1, 1, sign] @ turn.T + [0, 0, 0.2] for sign in (1, -1)]
    assert all((capsule.depth(points) > 0).all() for points in whole for capsule in found["mast"].fitted.values())


def test_all_views_of_a_narrow_arm_have_whole_numbers_and_labels_on_both_axes_which_do_not_overlap(folder):
    (folder / "narrow.urdf").write_text(URDF.replace('size="0.2 0.3 0.1"', 'size="0.2 0.1 0.1"'))
    arm = import_robot(folder / "narrow.urdf", "grasp", most=1)
    figure = draw_arm(arm, mjcf.arm_xml(arm, "narrow.urdf"), "narrow")
    figure.canvas.draw()
    axes = [axis for view in figure.axes[:4] for axis in (view.xaxis, view.yaxis)]
    for axis in axes:
        low, high = sorted(axis.get_view_interval())
        numbers = [
            text
            for text in axis.get_ticklabels()
            if low <= float(text.get_text().replace("\N{MINUS SIGN}", "-")) <= high
        ]
        boxes = [text.get_window_extent() for text in (*numbers, axis.label)]
        assert numbers and all(text.get_visible() for text in numbers)
        assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
        assert all(0 <= box.x0 and box.x1 <= figure.bbox.x1 for box in boxes)


def test_the_lower_views_show_the_convex_pieces_which_are_as_large_as_the_mesh(folder):
    arm = import_robot(folder / "crane.urdf", "grasp", most=1)
    figure = draw_arm(arm, mjcf.arm_xml(arm, "crane.urdf"), "crane")
    *views, _ = figure.axes
    assert [axes.get_title(loc="left").split(",")[0] for axes in views] == ["capsules"] * 2 + ["convex pieces"] * 2
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert len(texts) == 4 and any("convex pieces" in text for text in texts)
    for capsules, pieces in zip(views[:2], views[2:], strict=True):
        mesh, round_ = (_corners(capsules, zorder) for zorder in (2, 3))
        hulls = _corners(pieces, 3)
        np.testing.assert_allclose(
            [hulls.min(axis=0), hulls.max(axis=0)], [mesh.min(axis=0), mesh.max(axis=0)], atol=0.02
        )
        assert (np.ptp(round_, axis=0) > np.ptp(hulls, axis=0) + 0.01).all()


def _corners(axes, zorder: int) -> np.ndarray:
    return np.concatenate(
        [path.vertices for each in axes.collections if each.zorder == zorder for path in each.get_paths()]
    )


def mujoco_turn(rpy: str) -> np.ndarray:
    body = f'<body pos="0 0 0" euler="{rpy}"/>'
    text = f'<mujoco><compiler angle="radian" eulerseq="XYZ"/><worldbody>{body}</worldbody></mujoco>'
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return data.xmat[1].reshape(3, 3).copy()


def test_meshes_lie_where_mujoco_has_them(folder, tmp_path):
    """Meshes in the frames of their bodies, as MuJoCo has them.

    Shifted, rotated and scaled in MuJoCo's order; MuJoCo itself keeps them in frames of its own.
    """
    model, arm = mujoco_reading(folder / "mixed.xml"), import_robot(folder / "mixed.xml", "flange", most=1)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    geom = next(g for g in range(model.ngeom) if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH)
    mesh = model.mesh(model.geom_dataid[geom])
    vertices = model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]]
    theirs = vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
    body = model.body("a").id
    ours = (
        arm.covers[arm.model.body("a").id].enclosed.reshape(-1, 3) @ data.xmat[body].reshape(3, 3).T + data.xpos[body]
    )
    apart = np.linalg.norm(ours[:, None] - theirs[None], axis=2)
    assert apart.min(axis=0).max() < 1e-6 and apart.min(axis=1).max() < 1e-6  # MuJoCo keeps 32-bit floats


def test_a_capsule_that_mujoco_fits_to_a_mesh_is_read_as_it_fits_it(folder):
    model, arm = mujoco_reading(folder / "mixed.xml"), import_robot(folder / "mixed.xml", "flange", most=1)
    b = model.body("b").id
    geom = next(g for g in range(model.ngeom) if model.geom_bodyid[g] == b and not model.geom(g).name)
    axis = np.zeros(9)
    mujoco.mju_quat2Mat(axis, model.geom_quat[geom])
    cover = arm.covers[arm.model.body("b").id]
    capsule = cover.own["b"]
    assert capsule.radius == pytest.approx(model.geom_size[geom, 0], abs=1e-6)
    reach = model.geom_size[geom, 1] * axis[2::3]
    ends = model.geom_pos[geom] + np.outer([1, -1], reach)
    np.testing.assert_allclose(sorted([*map(tuple, ends)]), sorted([tuple(capsule.p), tuple(capsule.q)]), atol=1e-6)
    corners = cover.drawn.reshape(-1, 3)
    depth = np.max([each.depth(corners) for each in cover.own.values()], axis=0)
    assert cover.outside_m == pytest.approx(-depth.min()) and cover.outside_m > 0.01


def test_what_is_no_part_of_the_arm_is_left_out(folder):
    arm = import_robot(folder / "mixed.xml", most=1)  # the only site except the mouse's
    assert arm.tip.name == "flange" and arm.joint_names == ("j1", "j2", "j3") and not arm.frozen
    assert arm.excluded == ("floor of world", "table of world") and arm.shapeless == ("c",)
    assert "target" not in [arm.model.body(b).name for b in arm.bodies] and len(arm.covers) == 3
    drawn = import_robot(folder / "mixed.xml", most=1, visual=True)
    assert drawn.shapeless == () and drawn.covers[drawn.model.body("c").id].kinds == ("ellipsoid",)


def test_the_reach_and_the_longest_capsule_are_stated_and_lengths_in_millimetres_named(tmp_path):
    found = "the TCP is at most 1 m from the first joint; the longest capsule, forearm, is 0.42 m long"
    assert reach_text(toy.robot()) == found

    def in_mm(lengths: re.Match) -> str:
        return f'{lengths[1]}="{" ".join(str(1000 * float(each)) for each in lengths[2].split())}"'

    (tmp_path / "mm.xml").write_text(re.sub(r'(pos|size|fromto)="(.*?)"', in_mm, toy.ARM))
    with pytest.warns(UserWarning, match="at most 1e.03 m .* is 420 m long: lengths seem to be in millimetres"):
        reach_text(load_robot(tmp_path / "mm.xml"))


def test_a_joint_that_is_drawn_turned_stays_so(folder, tmp_path, capsys):
    out = tmp_path / "arm.xml"
    assert main(["robot", str(folder / "mixed.xml"), "--out", str(out), "--json", "--most", "1"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["TCP"] == "flange" and answer["files"] == [str(out), str(tmp_path / "arm.png")]
    assert answer["reach"].startswith("the TCP is at most ")
    assert [row["own"] for row in answer["bodies"]] == [0, 2, 0]
    model, arm = mujoco_reading(folder / "mixed.xml"), htcp_jax.load_robot(out)
    data = mujoco.MjData(model)
    np.testing.assert_array_equal(arm.effort, [np.inf, np.inf, 5])
    for x in np.random.default_rng(2).uniform(-1, 1, (3, 3)):
        for name, value in zip(arm.joint_names, x, strict=True):
            data.joint(name).qpos[:] = value
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(
            np.asarray(tcp_pose(arm, jnp.asarray(x)))[:3, 3], data.site("flange").xpos, atol=1e-12
        )
    assert "own" in arm.capsule_names and arm.capsule_link[arm.capsule_names.index("own")] == 1


def test_a_terminal_shows_how_far_the_import_is(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")  # as on a terminal
    monkeypatch.setenv("TERM", "xterm-256color")
    assert main(["robot", str(folder / "crane.urdf"), "--tcp", "grasp", "--out", str(tmp_path / "arm.xml")]) == 0
    said = capsys.readouterr().err
    assert all(steps in said for steps in ("bodies", "pairs of capsules", "pictures"))


def test_the_picture_shows_the_arm(crane):
    from matplotlib.image import imread

    picture = imread(crane.with_suffix(".png"))[::3, ::3, :3]
    drawn = np.unique(picture.reshape(-1, 3).round(2), axis=0)
    assert picture.shape[0] > 300 and len(drawn) > 20  # meshes, capsules, the TCP's axes


def test_an_arm_of_our_own_comes_out_as_it_is(tmp_path):
    """Import of a native model: unchanged capsules, limits and TCP, and a file that MuJoCo reads."""
    source, out = Path(__file__).parents[1] / "configs/pipe/arm.xml", tmp_path / "arm.xml"
    assert main(["robot", str(source), "--out", str(out)]) == 0
    mujoco.MjModel.from_xml_path(str(out))
    before, after = htcp_jax.load_robot(source), htcp_jax.load_robot(out)
    assert before.capsule_names == after.capsule_names and before.joint_names == after.joint_names
    for name in (
        "T_parent_joint",
        "T_link_tcp",
        "lower",
        "upper",
        "capsule_radius",
        "capsule_p",
        "capsule_q",
        "on_tool",
    ):
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), rtol=0, atol=1e-12, err_msg=name)


ONE_LINE = {
    "unknown TCP": (["--tcp", "nose"], "no site or body 'nose' for the TCP; valid: base, mast, boom, jib, hand"),
    "TCP not clear": ([], "the TCP is ambiguous: hand, left, right, grasp; choose it with --tcp NAME"),
    "two joints": (["--tcp", "boom"], "2 joints from the world to the TCP; at least 3 are needed"),
    "not an XML file": (["--tcp", "grasp", "--out", "arm.urdf"], "whose name must end in .xml"),
}


@pytest.mark.parametrize("case", ONE_LINE)
def test_bad_input_is_one_line_and_nothing_is_written(folder, tmp_path, monkeypatch, capsys, case):
    monkeypatch.chdir(tmp_path)
    words, line = ONE_LINE[case]
    assert main(["robot", str(folder / "crane.urdf"), "--out", "arm.xml", *words]) == 2
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1 and line in printed.err and not printed.out
    assert not list(tmp_path.iterdir())


BROKEN = {
    "no mesh": (
        "package://crane_description/meshes/boom.stl",
        "package://other/jib.stl",
        "or above it; put it into one of these folders",
    ),
    "no file": ('meshes/boom.stl" scale="0.1', 'meshes/jib.stl" scale="0.1', "mesh meshes/jib.stl: no such file"),
    "damaged": ("package://crane_description/meshes/boom.stl", "bad.stl", "bad.stl: damaged: solid"),
    "unknown": (
        "package://crane_description/meshes/boom.stl",
        "bad.wrl",
        "bad.wrl: unsupported mesh format; save it as .stl or .obj or .ply and name that in",
    ),
    "free": ('name="bend" type="revolute"', 'name="bend" type="floating"', "has type floating"),
    "range": (
        'lower="-1" upper="2"',
        'lower="2" upper="-1"',
        "joint 'bend' has range 2 to -1; the lower limit must come first",
    ),
    "no shapes": (
        "collision>",
        "visual>",
        "geoms of the model: none; if the model has only visual geometry, pass --visual to enclose it",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_what_is_wrong_with_a_model_is_one_line(folder, tmp_path, capsys, case):
    old, new, line = BROKEN[case]
    assert old in URDF
    for name in ("bad.stl", "bad.wrl"):
        (tmp_path / name).write_bytes(b"solid\nfacet normal 0 0")
    (tmp_path / "meshes").mkdir()
    for name in ("boom.stl", "meshes/boom.stl"):
        MESH.export(tmp_path / name)
    (tmp_path / "crane.urdf").write_text(URDF.replace(old, new).replace("package://crane_description/", ""))
    before = sorted(tmp_path.iterdir())
    assert main(["robot", str(tmp_path / "crane.urdf"), "--tcp", "grasp", "--out", str(tmp_path / "arm.xml")]) == 2
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1 and line in printed.err and sorted(tmp_path.iterdir()) == before


def test_an_arm_that_is_there_is_not_written_over(crane, folder, capsys):
    words = ["robot", str(folder / "crane.urdf"), "--tcp", "grasp", "--out", str(crane), "--most", "1"]
    before = crane.read_bytes()
    crane.write_bytes(before + b"<!-- corrected -->")
    assert main(words) == 2 and "pass --replace to overwrite it" in capsys.readouterr().err
    assert crane.read_bytes().endswith(b"<!-- corrected -->")
    assert main([*words, "--replace"]) == 0 and crane.read_bytes() == before


def test_a_job_that_names_the_model_itself_is_reported_the_next_step(folder):
    """Message for a job with an unconverted model: the command to run.

    The model has joints off the chain, or a capsule that is fitted to a mesh.
    """
    path = folder / "crane.urdf"
    with pytest.raises(InputError, match=r"htcp robot .*crane.urdf --out arm.xml"):
        htcp_jax.load_robot(path, tcp_site="grasp")
    with pytest.raises(InputError, match=r"fitted to a mesh; .*htcp robot .*mixed.xml --out arm.xml"):
        htcp_jax.load_robot(folder / "mixed.xml")


def test_outside_is_nothing_without_a_mesh():
    empty = np.empty((0, 3, 3))
    cover = BodyCover({}, {}, {}, {}, empty, empty, ())
    assert cover.outside_m == 0 and np.isnan(cover.ratio) and np.isnan(cover.excess_m)


def test_a_flat_mesh_is_enclosed_and_written(tmp_path):
    """A marker of two triangles, as on mobile arms: its hull has no volume."""
    square = trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]], [[0, 1, 2], [0, 2, 3]])
    square.export(tmp_path / "square.stl")
    shape = '<geom type="mesh" mesh="square"/>'
    for name in "ab":
        shape = f'<body pos="0 0 0.2"><joint name="{name}" range="-1 1"/>{shape}</body>'
    text = f'<mujoco><asset><mesh name="square" file="square.stl"/></asset><worldbody>{shape}</worldbody></mujoco>'
    (tmp_path / "arm.xml").write_text(text)
    arm = import_robot(tmp_path / "arm.xml", fewest=2)
    (cover,) = arm.covers.values()
    assert np.isnan(cover.ratio) and are_enclosed(cover.enclosed, list(cover.fitted.values()))
    assert "about mesh, flat" in mjcf.arm_xml(arm, "arm.xml")


def test_a_mesh_may_be_in_the_folder_above_the_model(tmp_path):
    """As in a ROS package with the folders urdf/ and meshes/, whose URDF says meshes/boom.stl."""
    (tmp_path / "urdf").mkdir()
    (tmp_path / "meshes").mkdir()
    MESH.export(tmp_path / "meshes/boom.stl")
    (tmp_path / "urdf/crane.urdf").write_text(URDF.replace("package://crane_description/", ""))
    assert import_robot(tmp_path / "urdf/crane.urdf", "grasp", most=1).joint_names == ("lift", "turn", "bend", "roll")


def test_an_arm_on_a_mocap_body_stands_where_the_body_is(tmp_path):
    """Simulations place arms so; a mocap body without joints is a target, and not the arm's."""
    body = '<geom size="0.1"/>'
    for name in "cba":
        body = f'<body name="{name}" pos="0 0 0.3"><joint name="j{name}" axis="0 1 0" range="-1 1"/>{body}</body>'
    text = '<mujoco><worldbody><body name="base" pos="1 2 3"{}>{}</body></worldbody></mujoco>'
    found = []
    for mocap in ("", ' mocap="true"'):
        (tmp_path / "arm.xml").write_text(text.format(mocap, body))
        found.append(mjcf.arm_xml(import_robot(tmp_path / "arm.xml", "c"), "arm.xml"))
    assert found[0] == found[1] and 'pos="1 2 3"' in found[0]
