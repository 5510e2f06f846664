"""Joint torques by inverse dynamics: those of MJX on published arms, and of a manual calculation on a simple arm."""

import math
import re
from functools import partial

import jax
import numpy as np
import pytest
from mujoco import mjx
from published import path_of

from htcp_jax.spec.config import RobotConfig
from htcp_jax.trajectory import TimedMotion
from htcp_jax.trajectory.joint_torques import model_of, peak_torque, peak_torques, torques

ARM = """<mujoco model="arm"><compiler angle="radian"/><worldbody>
<body name="a"><inertial pos="0.5 0 0" mass="2" diaginertia=".01 .01 .01"/><joint name="j1" axis="0 1 0"/>
<geom type="capsule" size=".3" fromto="0 0 0 1 0 0" mass="50"/>
<body name="b" pos="1 0 0"><inertial pos="0.5 0 0" mass="1" diaginertia=".01 .01 .01"/><joint name="j2" axis="0 1 0"/>
<body name="c" pos="1 0 0"><inertial pos="0 0 0" mass="3" diaginertia=".01 .01 .01"/><joint name="j3" axis="0 1 0"/>
<site name="tcp" pos=".2 0 0"/></body></body></body></worldbody></mujoco>"""


# On CPUs, XLA's fusion recomputes a link's pose for every value that depends on it: 10,000 times the work.
PLAIN = {"xla_disable_hlo_passes": "fusion"}


def by_mjx(model, *states) -> np.ndarray:
    device = mjx.put_model(model)
    blank = mjx.make_data(device)

    @partial(jax.jit, compiler_options=PLAIN)
    @jax.vmap
    def at(x, v, a):
        data = mjx.com_vel(device, mjx.com_pos(device, mjx.kinematics(device, blank.replace(qpos=x, qvel=v, qacc=a))))
        inertial = mjx.rne(device, data, flg_acc=True).qfrc_bias
        return inertial + device.dof_armature * a - mjx.passive(device, data).qfrc_passive

    with jax.numpy_rank_promotion("allow"):  # MJX promotes ranks
        return np.asarray(at(*states))


def states(joints: int, count: int, seed: int = 0):
    rng = np.random.default_rng(seed)
    return [rng.uniform(-size, size, (count, joints)) for size in (2.0, 2.0, 10.0)]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["panda", "ur10"])
def test_torques_of_published_arms_are_those_of_mjx_to_a_millionth_of_the_largest(name):
    model = model_of(RobotConfig(model=str(path_of(name))))
    given = states(model.nv, 200)
    expected = by_mjx(model, *given)
    assert np.abs(expected).max() > 10
    assert np.abs(torques(model)(*given) - expected).max() <= 1e-6 * np.abs(expected).max()


def test_an_arm_held_out_straight_bears_its_weights_by_their_levers(tmp_path):
    """Check torques of the given inertials only: 2, 1 and 3 kg at 0.5, 1.5 and 2 m; the geom of 50 kg is ignored."""
    (tmp_path / "arm.xml").write_text(ARM)
    model = model_of(RobotConfig(model=str(tmp_path / "arm.xml")))
    still = np.zeros((1, 3))
    found = torques(model)(still, still, still)[0]
    expected = -9.81 * np.array([2 * 0.5 + 1 * 1.5 + 3 * 2, 1 * 0.5 + 3 * 1, 0])
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_gravity_stays_down_where_the_base_is_turned(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    model = model_of(RobotConfig(model=str(tmp_path / "arm.xml"), base_rpy_rad=(0.0, math.pi / 2, 0.0)))
    still = np.zeros((1, 3))  # the arm hangs straight down
    np.testing.assert_allclose(torques(model)(still, still, still), 0, atol=1e-9)


def test_without_inertias_in_the_file_there_are_no_loads(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM.replace('<inertial pos="0.5 0 0" mass="1" diaginertia=".01 .01 .01"/>', ""))
    assert model_of(RobotConfig(model=str(tmp_path / "arm.xml"))) is None
    assert model_of(RobotConfig()) is None


def test_links_of_equal_masses_have_placeholders_and_no_loads(tmp_path):
    (tmp_path / "arm.xml").write_text(re.sub('mass="[0-9.]+"', 'mass="2"', ARM))
    assert model_of(RobotConfig(model=str(tmp_path / "arm.xml"))) is None
    (tmp_path / "arm.xml").write_text(re.sub('mass="[0-9.]+"', 'mass="2"', ARM, count=1))
    assert model_of(RobotConfig(model=str(tmp_path / "arm.xml"))) is not None


def test_a_torque_is_the_same_in_any_company_and_at_any_place(tmp_path):
    """Compare motions of 1 to 1,500 configurations one by one, together, and in another order, bit by bit."""
    (tmp_path / "arm.xml").write_text(ARM)
    torque, rng = torques(model_of(RobotConfig(model=str(tmp_path / "arm.xml")))), np.random.default_rng(3)
    motions = []
    for count in (1, 700, 3, 1500, 40):
        kind = np.zeros(count, np.int8)
        motions.append(
            TimedMotion(np.arange(count) * 0.01, *states(3, count, count), kind, kind.astype(int), ("a", "b", "c"))
        )
    effort = np.array([100.0, 50.0, 20.0])
    alone = [peak_torque(each, torque(each.x, each.velocity, each.acceleration), effort) for each in motions]
    assert peak_torques(torque, motions, effort) == alone and len(set(alone)) == len(alone)
    order = rng.permutation(len(motions))
    assert peak_torques(torque, [motions[k] for k in order], effort) == [alone[k] for k in order]


def test_the_load_is_the_one_nearest_to_its_limit_else_the_largest():
    rows = np.zeros((2, 3))
    timed = TimedMotion(np.array([0.0, 0.1]), rows, rows, rows, np.zeros(2, np.int8), np.zeros(2, int), ("a", "b", "c"))
    torque = np.array([[1.0, -2.0, 0.0], [0.5, 1.0, 9.0]])
    assert peak_torque(timed, torque, np.array([2.0, 3.0, np.inf])) == (-2.0, 2 / 3, "b", 0.0)
    assert peak_torque(timed, torque, np.full(3, np.inf)) == (9.0, 0.0, "c", 0.1)


def test_an_arm_whose_file_names_unchecked_pairs_has_torques(tmp_path):
    """Check an arm as `htcp robot` writes it: tuples name geoms, with which MuJoCo deletes them."""
    pairs = '<custom><tuple name="excluded 1, rule b"><element objtype="geom" objname="g"/></tuple></custom><worldbody>'
    named = ARM.replace('<geom type="capsule"', '<geom name="g" type="capsule"').replace("<worldbody>", pairs, 1)
    (tmp_path / "arm.xml").write_text(named)
    assert model_of(RobotConfig(model=str(tmp_path / "arm.xml"))).nv == 3
