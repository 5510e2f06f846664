"""The GP50 is the scene's robot; user-supplied models load; each error in a model is one line."""

import dataclasses
import os
from pathlib import Path

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest

from htcp_jax.errors import InputError
from htcp_jax.io.robots.loading import gp50, load_robot
from htcp_jax.model import Robot, kinematics
from htcp_jax.model.convex_piece import body_pieces, make_piece
from htcp_jax.model.robot import capsule_label, lengthen_tool
from htcp_jax.validation.mujoco_arm import MujocoArm

# Standard DH of the GP50: d, a, alpha; and its capsules: frame, p, q, radius.
DH = (
    (0.281, 0.145, -np.pi / 2),
    (0, 0.870, 0),
    (0, 0.210, -np.pi / 2),
    (1.025, 0, np.pi / 2),
    (0, 0, -np.pi / 2),
    (0.175, 0, 0),
)
T_FLANGE_TOOL = np.array(
    [
        [0.71906213, -0.49627146, -0.48648154, -0.073912],
        [0.48562900, 0.85957094, -0.15906689, -0.074794],
        [0.49710575, -0.12187057, 0.85908872, 0.46376],
        [0, 0, 0, 1],
    ]
)
TOOL = 7
CAPSULES = {
    "capsule_1": (1, (-0.145, 0.105, 0), (-0.145, 0.105, 0), 0.385),
    "capsule_2": (2, (-0.87, 0, -0.1945), (0, 0, -0.1945), 0.195),
    "capsule_3": (3, (-0.02, 0.073, 0.115), (-0.09, 0.073, 0.115), 0.33),
    "capsule_4": (4, (0, 0, -0.0235), (0, -0.65, -0.0235), 0.115),
    "capsule_5": (5, (0, 0.0145, 0.025), (0, 0.0145, 0.025), 0.15),
    "capsule_6a": (TOOL, (-0.1423911, 0.0844531, -0.4485528), (-0.0081731, 0.0515486, -0.2165986), 0.065),
    "capsule_6b": (TOOL, (-0.0040759, 0.0819148, -0.2095179), (-0.0077706, 0.0218345, -0.2159030), 0.05),
    "capsule_6c": (TOOL, (0.0025299, 0, -0.1707673), (0.0018881, 0, -0.1298686), 0.03),
}
START = (0.0, -2.3, 0.5, 0.0, 0.5, -2.0)

# The manufacturer's convention, as in ROS-Industrial's public description: link origins and axes in the zero
# configuration (lower arm upright, upper arm horizontal), limits and speeds of the data sheet [deg, deg/s].
MANUFACTURER = """
<mujoco>
  <worldbody>
    <body name="s" pos="0 0 0.540"><joint axis="0 0 1"/><geom size="0.1"/>
      <body name="l" pos="0.145 0 0"><joint axis="0 1 0"/><geom size="0.1"/>
        <body name="u" pos="0 0 0.870"><joint axis="0 -1 0"/><geom size="0.1"/>
          <body name="r" pos="1.025 0 0.210"><joint axis="-1 0 0"/><geom size="0.1"/>
            <body name="b"><joint axis="0 -1 0"/><geom size="0.1"/>
              <body name="t"><joint axis="-1 0 0"/><geom size="0.1"/><site name="tcp" pos="0.175 0 0"/></body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
DATASHEET_LOWER = (-180, -90, -80, -360, -125, -360)
DATASHEET_UPPER = (180, 135, 206, 360, 125, 360)
DATASHEET_SPEED = (180, 178, 178, 250, 250, 360)

# Lift, turn, turn, with a tool frame on a fixed link, and a mesh that cannot be found.
URDF = """
<robot name="lifter">
  <link name="base"><collision><geometry><capsule radius="0.2" length="0.6"/></geometry></collision></link>
  <link name="column"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <link name="arm">
    <visual><geometry><mesh filename="package://nowhere/arm.stl"/></geometry></visual>
    <collision><origin xyz="0.2 0 0" rpy="0 1.5707963267948966 0"/>
      <geometry><capsule radius="0.05" length="0.3"/></geometry></collision>
    <collision><geometry><mesh filename="package://nowhere/arm.stl"/></geometry></collision>
  </link>
  <link name="hand"/>
  <link name="tool0"/>
  <joint name="lift" type="prismatic"><parent link="base"/><child link="column"/><axis xyz="0 0 1"/>
    <origin xyz="0.1 0 0.3" rpy="0 0 0"/><limit lower="-0.2" upper="0.8" effort="1" velocity="1"/></joint>
  <joint name="turn" type="revolute"><parent link="column"/><child link="arm"/><axis xyz="0 0 1"/>
    <origin xyz="0 0 0.2" rpy="0 0 0.5"/><limit lower="-2" upper="1.5" effort="1" velocity="1"/></joint>
  <joint name="spin" type="continuous"><parent link="arm"/><child link="hand"/><axis xyz="0 1 0"/>
    <origin xyz="0.4 0 0" rpy="0 0 0"/></joint>
  <joint name="tip" type="fixed"><parent link="hand"/><child link="tool0"/>
    <origin xyz="0.1 0 0.02" rpy="0 0.3 0"/></joint>
</robot>
"""


def written(folder: Path, text: str, name: str = "arm.xml") -> Path:
    (folder / name).write_text(text)
    return folder / name


def dh_frames(theta) -> list[np.ndarray]:
    """World poses of the DH frames 0 to 6 and of the tool frame, by the textbook."""
    base = np.eye(4)
    base[2, 3] = 0.259
    frames = [base]
    for angle, (d, a, alpha) in zip(theta, DH, strict=True):
        (c, s), (ca, sa) = (np.cos(angle), np.sin(angle)), (np.cos(alpha), np.sin(alpha))
        row = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        frames.append(frames[-1] @ np.array(row))
    return [*frames, frames[-1] @ T_FLANGE_TOOL]


def configurations(count: int) -> np.ndarray:
    return np.random.default_rng(2).uniform(-np.pi, np.pi, (count, 6))


def over(function, robot: Robot, xs: np.ndarray):
    return made_once.quick_jit(jax.vmap(lambda x: function(robot, x)))(jnp.asarray(xs))


# The GP50


def test_gp50_is_the_scenes_robot():
    """TCP and capsule ends by the DH table, to the 1e-8 to which the tool's rotation is given."""
    robot, xs = gp50(), configurations(50)
    frames = np.array([dh_frames(x) for x in xs])
    np.testing.assert_allclose(over(kinematics.tcp_pose, robot, xs), frames[:, TOOL], rtol=0, atol=2e-8)
    p, q = over(kinematics.capsule_segments, robot, xs)
    assert robot.capsule_names == tuple(CAPSULES)
    for k, (frame, p_frame, q_frame, radius) in enumerate(CAPSULES.values()):
        np.testing.assert_allclose(p[:, k], (frames[:, frame] @ (*p_frame, 1))[:, :3], rtol=0, atol=2e-8)
        np.testing.assert_allclose(q[:, k], (frames[:, frame] @ (*q_frame, 1))[:, :3], rtol=0, atol=2e-8)
        assert robot.capsule_radius[k] == radius


def test_gp50_start_configuration():
    """TCP at the start, as the scene states it; its y is 0.28 um off what its own table gives."""
    tcp = kinematics.tcp_position(gp50(), jnp.array(START))
    np.testing.assert_allclose(tcp, (1.1213389, -0.0983330, 1.4193919), rtol=0, atol=3e-7)


def test_gp50_fields():
    """Fields of the GP50: six hinges, each capsule on its link, a sphere with equal ends, 64-bit floats, names."""
    robot = gp50()
    assert robot.name == "gp50"
    assert robot.joint_names == tuple(f"joint{i}" for i in range(1, 7))
    assert robot.slides == (False,) * 6
    assert robot.capsule_link == (0, 1, 2, 3, 4, 5, 5, 5)
    assert robot.ignored_geoms == ()
    assert {leaf.dtype for leaf in jax.tree.leaves(robot)} == {jnp.dtype("float64")}
    np.testing.assert_array_equal(robot.capsule_p[0], robot.capsule_q[0])


def test_gp50_simulation_limits_are_pi():
    robot = gp50()
    np.testing.assert_array_equal(robot.lower, np.full(6, -np.pi))
    np.testing.assert_array_equal(robot.upper, np.full(6, np.pi))
    np.testing.assert_array_equal(load_robot(limits="model").upper, robot.upper)


def to_theta(manufacturer) -> np.ndarray:
    """Convert the manufacturer's joint values [rad] to the DH angles of this package."""
    s, l_, u, r, b, t = np.asarray(manufacturer).T
    return np.stack([s, l_ - np.pi / 2, -u, -r, -b, -t], axis=-1)


def test_datasheet_convention_moves_the_same_arm(tmp_path):
    """Flange of an arm built from the manufacturer's axes and origins: the GP50's, up to a constant rotation."""
    robot, other = gp50(), load_robot(written(tmp_path, MANUFACTURER))
    xs = configurations(50)
    links = over(kinematics.link_poses, robot, to_theta(xs))
    flange = links[:, 5, :3, 3] + 0.175 * links[:, 5, :3, 2]
    T_world_flange = over(kinematics.tcp_pose, other, xs)
    np.testing.assert_allclose(flange, T_world_flange[:, :3, 3], rtol=0, atol=1e-12)
    turn = np.swapaxes(T_world_flange[:, :3, :3], 1, 2) @ links[:, 5, :3, :3]
    np.testing.assert_allclose(turn, np.broadcast_to(turn[0], turn.shape), rtol=0, atol=1e-12)


def test_datasheet_limits_and_speeds():
    """Ranges and speeds of the data sheet, converted: those of the profile; the start is inside."""
    robot = gp50("datasheet")
    ends = to_theta(np.radians([DATASHEET_LOWER, DATASHEET_UPPER]))
    np.testing.assert_allclose(robot.lower, ends.min(axis=0), rtol=0, atol=1e-15)
    np.testing.assert_allclose(robot.upper, ends.max(axis=0), rtol=0, atol=1e-15)
    np.testing.assert_allclose(robot.speed, np.radians(DATASHEET_SPEED), rtol=0, atol=1e-15)
    assert ((robot.lower < jnp.array(START)) & (jnp.array(START) < robot.upper)).all()


# The tool's length


def test_lengthened_tool_moves_the_tcp_along_its_axis():
    """TCP of a longer tool: moved by exactly e; the flange's end and the arm stay, the rest of the tool follows."""
    robot, x, e = gp50(), jnp.array(START), 0.07
    longer = lengthen_tool(robot, e)
    T_world_tcp = kinematics.tcp_pose(robot, x)
    moved = kinematics.tcp_pose(longer, x)
    np.testing.assert_allclose(moved[:3, 3] - T_world_tcp[:3, 3], e * T_world_tcp[:3, 2], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(moved[:3, :3], T_world_tcp[:3, :3])
    p, q = kinematics.capsule_segments(robot, x)
    p_longer, q_longer = kinematics.capsule_segments(longer, x)
    follows_p, follows_q = np.array([0, 0, 0, 0, 0, 0, 1, 1]), np.array([0, 0, 0, 0, 0, 1, 1, 1])
    step = e * np.asarray(T_world_tcp[:3, 2])
    np.testing.assert_allclose(p_longer - p, follows_p[:, None] * step, rtol=0, atol=1e-15)
    np.testing.assert_allclose(q_longer - q, follows_q[:, None] * step, rtol=0, atol=1e-15)


def test_a_locked_joint_leaves_the_tool_what_it_is():
    np.testing.assert_array_equal(load_robot(locked={"joint1": 0.1}).on_tool, gp50().on_tool)


def test_tool_lengthened_by_nothing_is_identical():
    robot = gp50()
    same = lengthen_tool(robot, 0.0)
    assert jax.tree.structure(same) == jax.tree.structure(robot)
    for one, other in zip(jax.tree.leaves(same), jax.tree.leaves(robot), strict=True):
        np.testing.assert_array_equal(one, other)


def test_tool_length_may_be_traced():
    """Traced tool length: swept in one compiled call, and differentiated; the TCP moves along the tool's z."""
    robot, x = gp50(), jnp.array(START)

    def tcp(e: jax.Array) -> jax.Array:
        return kinematics.tcp_position(lengthen_tool(robot, e), x)

    lengths = jnp.array([-0.02, 0.0, 0.05])
    swept = made_once.quick_jit(jax.vmap(tcp))(lengths)
    np.testing.assert_allclose(swept, [tcp(e) for e in lengths], rtol=0, atol=1e-15)
    z = kinematics.tcp_pose(robot, x)[:3, 2]
    np.testing.assert_allclose(jax.jacfwd(tcp)(jnp.array(0.0)), z, rtol=0, atol=1e-15)


# User-supplied models


def test_urdf_with_a_slide_joint(tmp_path):
    """URDF with a slide joint.

    The TCP is the outermost link, fixed bodies keep their capsules, meshes are never opened.
    """
    robot = load_robot(written(tmp_path, URDF, "lifter.urdf"))
    assert robot.joint_names == ("lift", "turn", "spin")
    assert robot.slides == (True, False, False)
    assert robot.capsule_link == (-1, 0, 1)
    assert len(robot.ignored_geoms) == 1  # the mesh that collides; MuJoCo drops a URDF's visual geoms
    np.testing.assert_array_equal(robot.lower, (-0.2, -2, -np.inf))
    np.testing.assert_array_equal(robot.upper, (0.8, 1.5, np.inf))
    np.testing.assert_array_equal(robot.speed, (1, 1, np.inf))
    x = jnp.array([0.25, -0.5, 0.4])  # the turn cancels the joint's own 0.5 rad
    c, s = np.cos(0.4), np.sin(0.4)
    by_hand = (0.1 + 0.4 + 0.1 * c + 0.02 * s, 0, 0.3 + 0.25 + 0.2 - 0.1 * s + 0.02 * c)
    np.testing.assert_allclose(kinematics.tcp_position(robot, x), by_hand, rtol=0, atol=1e-12)
    p, q = kinematics.capsule_segments(robot, x)
    np.testing.assert_allclose(p, [(0, 0, 0.3), (0.1, 0, 0.55), (0.45, 0, 0.75)], rtol=0, atol=1e-12)
    np.testing.assert_allclose(q, [(0, 0, -0.3), (0.1, 0, 0.55), (0.15, 0, 0.75)], rtol=0, atol=1e-12)


def test_speeds_of_a_urdf_are_its_joints_wherever_they_stand_in_the_file(tmp_path):
    """Speeds of a URDF, by joint, in any order of the file (regression: they were not read)."""
    joints = URDF[URDF.index('  <joint name="lift"') : URDF.index("</robot>")].split("  <joint")[1:]
    text = URDF[: URDF.index('  <joint name="lift"')] + "".join(f"  <joint{each}" for each in reversed(joints))
    text = text.replace('upper="1.5" effort="1" velocity="1"', 'upper="1.5" effort="1" velocity="2.5"') + "</robot>"
    file = written(tmp_path, text, "lifter.urdf")
    for arm in (load_robot(file), MujocoArm(file)):
        np.testing.assert_array_equal(arm.speed, (1, 2.5, np.inf))


def test_a_urdf_range_that_is_turned_round_is_refused(tmp_path):
    """Descending range in a URDF: refused, as MuJoCo takes it for no limit at all."""
    with pytest.raises(InputError, match=r"joint 'turn' has range 1.5 to -2; the lower limit must come first"):
        load_robot(written(tmp_path, URDF.replace('lower="-2" upper="1.5"', 'lower="1.5" upper="-2"'), "lifter.urdf"))


def test_urdf_with_simulation_limits(tmp_path):
    """Simulation limits of a URDF: +-pi for hinges; a slide keeps its own range."""
    robot = load_robot(written(tmp_path, URDF, "lifter.urdf"), limits="simulation")
    np.testing.assert_array_equal(robot.lower, (-0.2, -np.pi, -np.pi))
    np.testing.assert_array_equal(robot.upper, (0.8, np.pi, np.pi))


def test_tcp_may_be_any_body(tmp_path):
    robot = load_robot(written(tmp_path, URDF, "lifter.urdf"), tcp_site="hand")
    np.testing.assert_array_equal(robot.T_link_tcp, np.eye(4))


def arm(body: str = "", joints: tuple[str, str, str] = ("", "", ""), geom: str = "", top: str = "") -> str:
    """A plain 3-joint MJCF with additional elements."""
    body = body or '<site name="tcp"/>'
    geom = geom or '<geom name="rod" type="capsule" fromto="0 0 0  0 0 1" size="0.1"/>'
    first, second, third = joints
    return f"""
      <mujoco><compiler boundmass="1" boundinertia="1"/>{top}
        <worldbody><body name="a"><joint name="j1" {first}/>{geom}
          <body name="b" pos="0 0 1"><joint name="j2" axis="0 1 0" {second}/>
            <body name="c" pos="0 0 1"><joint name="j3" axis="1 0 0" {third}/>{body}</body>
          </body>
        </body></worldbody>
      </mujoco>"""


def test_the_only_site_is_the_tcp(tmp_path):
    robot = load_robot(written(tmp_path, arm(body='<site name="tip" pos="0 0 0.5"/>')))
    np.testing.assert_array_equal(robot.T_link_tcp[:3, 3], (0, 0, 0.5))


def test_names_for_the_unnamed(tmp_path):
    text = arm(geom='<geom type="capsule" fromto="0 0 0  0 0 1" size="0.1"/>').replace('name="j2"', "")
    robot = load_robot(written(tmp_path, text))
    assert robot.joint_names == ("j1", "joint2", "j3")
    assert robot.capsule_names == ("a:0",)


NUMERIC = '<custom><numeric name="{}" data="{}"/></custom>'
LOWER, UPPER = '<numeric name="datasheet_lower" data="{}"/>', '<numeric name="datasheet_upper" data="{}"/>'

BAD_MODELS = {
    "not xml": ("no model at all", {}, "not a model that MuJoCo can read: "),
    "not mjcf": ("<html></html>", {}, "not a model that MuJoCo can read: "),
    "empty": ("", {}, "not a model that MuJoCo can read: "),
    "no geoms": (
        arm(geom=" "),
        {},
        "; with --visual if the model has only visual geometry",
    ),
    "only others": (
        arm(
            geom='<geom type="box" size="1 1 1"/><geom type="mesh" mesh="m"/>',
            top='<asset><mesh name="m" file="m.stl"/></asset>',
        ),
        {},
        "no capsule or sphere geoms; geoms of the model: box, mesh",
    ),
    "zero radius": (
        arm(geom='<geom name="ball" size="0"/>'),
        {},
        "sphere 'ball' of body 'a' has radius 0 m; it must be positive",
    ),
    "negative radius": (
        arm(geom='<geom type="capsule" size="-0.1 1"/>'),
        {},
        "capsule '' of body 'a' has radius -0.1 m; it must be positive",
    ),
    "nan radius": (arm(geom='<geom size="nan"/>'), {}, "has radius nan m; it must be positive"),
    "huge radius": (arm(geom='<geom size="1e999"/>'), {}, "number is too large in attribute 'size'"),
    "no joints": (
        '<mujoco><worldbody><geom size="1"/><site name="tcp"/></worldbody></mujoco>',
        {},
        "no joints from the world to the TCP; at least 3 are needed",
    ),
    "two joints": (
        arm().replace('<joint name="j2" axis="0 1 0" />', ""),
        {},
        "2 joints from the world to the TCP; at least 3 are needed",
    ),
    "ball joint": (arm(joints=("", 'type="ball"', "")), {}, "ball or free joints (j2)"),
    "free joint": (arm(joints=('type="free"', "", "")), {}, "ball or free joints (j1)"),
    "finger": (
        arm(body='<site name="tcp"/><body><joint name="finger"/><geom size="0.1"/></body>'),
        {},
        "joints off the chain from the world to the TCP: finger",
    ),
    "no site": (arm(body=" "), {}, "no site or body 'tcp' for the TCP; sites of the model: none"),
    "two sites": (
        arm(body='<site name="left"/><site name="right"/>'),
        {},
        "no site or body 'tcp' for the TCP; sites of the model: left, right",
    ),
    "named site absent": (
        arm(),
        {"tcp_site": "tip"},
        "no site or body 'tip' for the TCP; sites of the model: tcp",
    ),
    "unknown limits": (arm(), {"limits": "none"}, "no joint limits 'none' for robot.limits; valid: model, simulation"),
    "no data sheet": (
        arm(),
        {"limits": "datasheet"},
        "no joint limits 'datasheet' for robot.limits; valid: model, simu",
    ),
    "short numeric": (arm(top=NUMERIC.format("speed", "1 2")), {}, "'speed' has 2 values for 3 joints"),
    "negative speed": (arm(top=NUMERIC.format("speed", "1 2 -3")), {}, "numeric 'speed' must be positive"),
    "crossed limits": (
        arm(top=f"<custom>{LOWER.format('0 0 1')}{UPPER.format('1 1 0')}</custom>"),
        {"limits": "datasheet"},
        "joint limits 'datasheet' must be lower < upper",
    ),
    "half a data sheet": (
        arm(top=f"<custom>{LOWER.format('0 0 1')}</custom>"),
        {"limits": "datasheet"},
        "joint limits 'datasheet' must be lower < upper",
    ),
    "nan position": (arm(geom='<geom size="0.1" pos="0 0 nan"/>'), {}, "is not finite; correct the model"),
    "nan axis": (arm(joints=("", 'pos="0 nan 0"', "")), {}, "is not finite; correct the model"),
    "turned range": (
        arm(joints=('range="20 -20"', "", "")),
        {},
        "joint 'j1' has range 20 to -20; the lower limit must come first",
    ),
}


@pytest.mark.parametrize("case", BAD_MODELS)
def test_bad_model_gets_one_line(case, tmp_path, monkeypatch):
    """Error for a bad model: one line that starts with the file and names the cause; no log file of MuJoCo remains."""
    monkeypatch.chdir(tmp_path)
    text, options, message = BAD_MODELS[case]
    path = written(tmp_path, text)
    with pytest.raises(InputError) as caught:
        load_robot(path, **options)
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not list(Path().glob("MUJOCO_LOG.TXT"))


@pytest.mark.parametrize(("capsule", "label"), [("capsule_4", "link4"), ("capsule_6b", "link6 (capsule_6b)")])
def test_a_numbered_capsule_goes_by_its_link_and_by_its_own_name_only_among_others(capsule, label):
    assert capsule_label(gp50(), capsule) == label


def test_a_part_of_a_mesh_goes_by_its_own_name_and_by_its_link_unless_it_begins_with_that():
    arm = gp50()
    names = ("link1", "link2_2", "torch_5", *arm.capsule_names[3:])
    pieces = body_pieces([make_piece(np.eye(3))] * 8, np.array([1.0, 1.0, 1.0] + 5 * [0.0]))
    named = dataclasses.replace(arm, capsule_names=names, capsule_link=(0, 1, 2, *arm.capsule_link[3:]), pieces=pieces)
    assert [capsule_label(named, name) for name in names[:3]] == ["link1", "link2_2", "link3 (torch_5)"]
    bare = dataclasses.replace(named, pieces=None)
    assert [capsule_label(bare, name) for name in names[:3]] == ["capsule link1", "capsule link2_2", "capsule torch_5"]


def test_gp50_refuses_an_unknown_profile():
    with pytest.raises(InputError, match="no joint limits 'paper'"):
        gp50("paper")


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match=r"none\.xml: cannot read the model: No such file or directory"):
        load_robot(tmp_path / "none.xml")


def test_folder_instead_of_a_file(tmp_path):
    with pytest.raises(InputError, match="not a regular file"):
        load_robot(tmp_path)


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="permissions do not bind this user")
def test_unreadable_file(tmp_path):
    path = written(tmp_path, arm())
    path.chmod(0)
    with pytest.raises(InputError, match="cannot read the model: Permission denied"):
        load_robot(path)
