"""Tool, flange and base of a job give the same arm as a model file that contains them, and MuJoCo agrees on it."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from htcp_jax.io.robots.loading import load_robot
from htcp_jax.model import Robot
from htcp_jax.model.kinematics import capsule_segments, tcp_position
from htcp_jax.model.robot import lengthen_tool
from htcp_jax.spec import GP50
from htcp_jax.spec.tool import ZERO, Tool, ToolBody, pose
from htcp_jax.validation.mujoco_arm import MujocoArm

PIPE = Path(__file__).parents[1] / "configs" / "pipe" / "arm.xml"
SPINDLE = ToolBody("spindle", (0.0, 0.0, 0.05), (0.01, 0.0, 0.22), 0.008)
BALL = ToolBody("ball", (0.1, 0.0, 0.1), (0.1, 0.0, 0.1), 0.02)
TOOLS = {
    "none": None,
    "a tip alone": Tool(tip_m=(0.0, 0.01, 0.1), tip_rpy_rad=(0.3, 0.2, 0.1)),
    "bodies": Tool((0.01, 0.02, 0.25), (0.1, -0.4, 0.7), (SPINDLE, BALL)),
    "a sphere first": Tool((0.0, 0.0, 0.2), bodies=(BALL, SPINDLE)),
}
FLANGED = """
<mujoco><worldbody>{open}
  <geom name="foot" type="sphere" size="0.1" pos="0.1 0 0"/>
  <body name="a"><joint name="j1" axis="0 0 1"/><geom name="column" type="capsule" fromto="0 0 0 0 0 0.4" size="0.05"/>
    <body name="b" pos="0 0 0.5"><joint name="j2" axis="0 1 0"/>
      <body name="c" pos="0.4 0 0"><joint name="j3" axis="0 1 0"/>
        <geom name="wrist" type="capsule" fromto="0 0 0 0.1 0 0" size="0.04"/>
        <site name="camera" pos="0 0 0.2"/>
        <site name="tool0" pos="0.15 0 0" euler="0 90 0"/>
        {tool}
      </body></body></body>
{close}</worldbody></mujoco>
"""


def assert_same(arm: MujocoArm, robot: Robot) -> None:
    x = np.random.default_rng(3).uniform(-1, 1, (10, len(robot.joint_names)))
    found = arm.arm_poses(x)
    order = [arm.names.index(name) for name in robot.capsule_names]
    for k, row in enumerate(jnp.asarray(x)):
        p, q = map(np.asarray, capsule_segments(robot, row))
        ends = np.sort(np.stack([p, q]), axis=0), np.sort(np.stack([found.p[k], found.q[k]])[:, order], axis=0)
        np.testing.assert_allclose(*ends, atol=1e-12)
        np.testing.assert_allclose(np.asarray(tcp_position(robot, row)), found.tcp[k], atol=1e-12)
    np.testing.assert_allclose(arm.radius[order], np.asarray(robot.capsule_radius))


@pytest.mark.parametrize("extension", [0.0, 0.03])
@pytest.mark.parametrize("tool", TOOLS)
@pytest.mark.parametrize("path", [GP50, PIPE], ids=["gp50", "pipe"])
def test_mujoco_and_the_planner_see_the_same_tool_and_base(path, tool, extension):
    cell = {"base_m": (0.3, -0.2, 0.5), "base_rpy_rad": (0.2, 0.5, -1.1), "tool": TOOLS[tool]}
    assert_same(MujocoArm(path, extension, **cell), lengthen_tool(load_robot(path, **cell), extension))


def test_a_cell_in_the_job_is_the_cell_written_into_the_model(tmp_path):
    """Cell from the job, equal to one in the model: nested single-axis frames give roll, pitch and yaw."""
    (tmp_path / "bare.xml").write_text(FLANGED.format(open="", close="", tool=""))
    inside = """<frame pos="0.15 0 0" euler="0 90 0">
      <geom name="spindle" type="capsule" fromto="0 0 0.05 0.01 0 0.22" size="0.008"/>
      <geom name="ball" type="sphere" pos="0.1 0 0.1" size="0.02"/>
      <frame pos="0.01 0.02 0.25" euler="0 0 40"><frame euler="0 -20 0"><frame euler="10 0 0"><site name="tcp"/>
      </frame></frame></frame></frame>"""
    base = '<frame pos="1 2 3"><frame euler="0 0 30"><frame euler="0 20 0"><frame euler="10 0 0">', "</frame>" * 4
    (tmp_path / "whole.xml").write_text(FLANGED.format(open=base[0], close=base[1], tool=inside))
    cell = {
        "base_m": (1.0, 2.0, 3.0),
        "base_rpy_rad": tuple(np.radians([10.0, 20.0, 30.0]).tolist()),
        "tool": Tool((0.01, 0.02, 0.25), tuple(np.radians([10.0, -20.0, 40.0]).tolist()), (SPINDLE, BALL)),
    }
    whole = load_robot(tmp_path / "whole.xml")
    assert_same(MujocoArm(tmp_path / "bare.xml", tcp="tool0", **cell), whole)
    said = load_robot(tmp_path / "bare.xml", tcp_site="tool0", **cell)
    assert_same(MujocoArm(tmp_path / "whole.xml"), said)
    z = np.asarray(whole.T_link_tcp)[:3, 2]
    np.testing.assert_allclose(np.asarray(said.T_link_tcp)[:3, 2], z, atol=1e-15)


def test_a_tool_of_the_job_is_lengthened_and_the_wrist_is_not(tmp_path):
    (tmp_path / "bare.xml").write_text(FLANGED.format(open="", close="", tool=""))
    robot = load_robot(tmp_path / "bare.xml", tcp_site="tool0", tool=Tool((0.0, 0.0, 0.3), bodies=(SPINDLE, BALL)))
    assert robot.capsule_names == ("foot", "column", "wrist", "spindle", "ball")
    np.testing.assert_array_equal(robot.on_tool, [[0, 0], [0, 0], [0, 0], [0, 1], [1, 1]])
    along = np.asarray(lengthen_tool(robot, 0.1).T_link_tcp - robot.T_link_tcp)[:3, 3]
    np.testing.assert_allclose(along, [0.1, 0, 0], atol=1e-15)


def test_without_a_cell_of_the_job_not_a_bit_changes():
    """Base that is not moved: bitwise the frame in which models were read before."""
    assert pose(ZERO, ZERO).tobytes() == np.eye(4).tobytes()
