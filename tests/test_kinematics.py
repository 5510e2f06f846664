"""Kinematics: equal to MuJoCo, MJX, autodiff, finite differences, and a recorded run of the cell."""

from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx

from htcp_jax.io.robots.loading import gp50, load_robot
from htcp_jax.model import Robot, kinematics
from htcp_jax.model.robot import GP50

DUCT = Path(__file__).parents[2] / "shared" / "data" / "duct"

# A 7-joint arm with features that the GP50 lacks: slides, skew axes, anchors off the body's origin, two joints on one
# body, joints drawn at values other than 0, a capsule on the base, a fixed body in between, a geom to ignore.
SEVEN = """
<mujoco model="seven">
  <compiler angle="radian" boundmass="0.001" boundinertia="0.001"/>
  <worldbody>
    <geom name="post" type="capsule" fromto="0 0 0  0 0 0.5" size="0.1"/>
    <body name="cart" pos="0.1 0.2 0.5" euler="0.2 -0.3 0.4">
      <joint name="rail" type="slide" axis="1 2 0.5" ref="0.3" range="-1 2"/>
      <geom type="sphere" size="0.1" pos="0.01 0.02 0.03"/>
      <body name="shoulder" pos="0 0 0.2" euler="0.1 0 0.7">
        <joint name="yaw" axis="0 0 1" pos="0.02 -0.01 0.05" ref="-0.4"/>
        <joint name="lift" axis="0.3 1 0" pos="-0.03 0 0.01"/>
        <geom type="box" name="cover" size="0.1 0.1 0.1"/>
        <body name="bracket" pos="0.1 0 0.3" euler="0 0.5 0">
          <geom type="capsule" size="0.05 0.1" pos="0 0.1 0" euler="1 0 0"/>
          <body name="upper" pos="0 0.1 0">
            <joint name="elbow" axis="1 0.1 -0.2"/>
            <body name="lower" pos="0 0 0.4">
              <joint name="reach" type="slide" axis="0 0.2 1" pos="0.3 0 0" range="0 0.5"/>
              <geom name="rod" type="capsule" fromto="0 0 0  0 0.1 0.3" size="0.04"/>
              <body name="wrist" pos="0 0 0.3" euler="-0.6 0.2 0">
                <joint name="roll" axis="0 0 1"/>
                <body name="hand" pos="0.05 0 0.1">
                  <joint name="bend" axis="0 1 0" ref="1.2"/>
                  <geom name="palm" type="capsule" fromto="0 0 0  0 0.02 0.15" size="0.03"/>
                  <site name="tcp" pos="0.01 0.02 0.2" euler="0.3 0.2 0.1"/>
                </body>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


class Truth(NamedTuple):
    """MuJoCo's results for S configurations, from its own reading of the file."""

    body_position: np.ndarray  # (S, bodies, 3)
    body_rotation: np.ndarray  # (S, bodies, 3, 3)
    geom_position: np.ndarray
    geom_rotation: np.ndarray
    tcp: np.ndarray  # (S, 3)
    tcp_rotation: np.ndarray
    jacobian: np.ndarray  # (S, 3, N)


class Arm(NamedTuple):
    robot: Robot
    model: mujoco.MjModel
    xs: np.ndarray  # (1000, N), the first at zero: the GP50's wrist is singular there
    truth: Truth


def mujoco_says(model: mujoco.MjModel, xs: np.ndarray) -> Truth:
    data, rows = mujoco.MjData(model), []
    for x in xs:
        data.qpos = x
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, jacobian, None, 0)
        poses = (
            data.xpos,
            data.xmat,
            data.geom_xpos,
            data.geom_xmat,
            data.site_xpos[0],
            data.site_xmat[0],
            jacobian,
        )
        rows.append([np.array(part) for part in poses])
    parts = [np.stack(part) for part in zip(*rows, strict=True)]
    for rotation in (1, 3, 5):
        parts[rotation] = parts[rotation].reshape(*parts[rotation].shape[:-1], 3, 3)
    return Truth(*parts)


@pytest.fixture(scope="module", params=["gp50", "seven"])
def arm(request, tmp_path_factory) -> Arm:
    path = GP50
    if request.param == "seven":
        path = tmp_path_factory.mktemp("seven") / "seven.xml"
        path.write_text(SEVEN)
    robot, model = load_robot(path), mujoco.MjModel.from_xml_path(str(path))
    xs = np.random.default_rng(0).uniform(-np.pi, np.pi, (1000, len(robot.slides)))
    xs[0] = 0.0
    return Arm(robot, model, xs, mujoco_says(model, xs))


def over(function, robot: Robot, xs: np.ndarray):
    return jax.jit(jax.vmap(lambda x: function(robot, x)))(jnp.asarray(xs))


def assert_close(actual, wanted, atol: float = 1e-9) -> None:
    np.testing.assert_allclose(np.asarray(actual), np.asarray(wanted), rtol=0, atol=atol)


def round_geoms(model: mujoco.MjModel) -> np.ndarray:
    return np.flatnonzero(np.isin(model.geom_type, (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE)))


def test_links_are_mujocos_bodies(arm):
    """Compare the orientation of each link with its body's, and its origin with the joint's anchor."""
    T_world_link = np.asarray(over(kinematics.link_poses, arm.robot, arm.xs))
    bodies = arm.model.jnt_bodyid
    last = np.flatnonzero(np.append(bodies[1:] != bodies[:-1], True))  # MuJoCo has no frame between a body's two joints
    rotation = arm.truth.body_rotation[:, bodies[last]]
    anchor = np.einsum("snij,nj->sni", rotation, arm.model.jnt_pos[last])
    anchor += arm.truth.body_position[:, bodies[last]]
    assert_close(T_world_link[:, last][..., :3, :3], rotation)
    assert_close(T_world_link[:, last][..., :3, 3], anchor)
    assert (T_world_link[:, :, 3] == [0, 0, 0, 1]).all()


def test_tcp_is_mujocos_site(arm):
    T_world_tcp = over(kinematics.tcp_pose, arm.robot, arm.xs)
    assert_close(T_world_tcp[:, :3, :3], arm.truth.tcp_rotation)
    assert_close(T_world_tcp[:, :3, 3], arm.truth.tcp)
    assert_close(over(kinematics.tcp_position, arm.robot, arm.xs), arm.truth.tcp)


def test_capsule_ends_are_mujocos_geoms(arm):
    """Compare the ends of capsules and spheres, in the model's order, with p at the +z end, also on the base."""
    p, q = over(kinematics.capsule_segments, arm.robot, arm.xs)
    geoms = round_geoms(arm.model)
    capsule = arm.model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_CAPSULE
    half = np.where(capsule, arm.model.geom_size[geoms, 1], 0.0)
    reach = half[None, :, None] * arm.truth.geom_rotation[:, geoms][..., 2]
    assert_close(p, arm.truth.geom_position[:, geoms] + reach)
    assert_close(q, arm.truth.geom_position[:, geoms] - reach)
    assert_close(arm.robot.capsule_radius, arm.model.geom_size[geoms, 0], atol=0)


def test_no_body_extends_beyond_its_reach(arm):
    """Bodies that move: within the bound for every configuration, slides to the ends of their ranges included."""
    xs = np.where(arm.robot.slides, np.clip(arm.xs, arm.robot.lower, arm.robot.upper), arm.xs)
    base, moves = np.asarray(arm.robot.T_parent_joint)[0, :3, 3], np.array(arm.robot.capsule_link) >= 0
    ends = np.stack([np.asarray(end) for end in over(kinematics.capsule_segments, arm.robot, xs)])
    furthest = (np.linalg.norm(ends - base, axis=3) + np.asarray(arm.robot.capsule_radius)).max(axis=(0, 1))
    bound = kinematics.body_reach(arm.robot)
    assert (furthest[moves] <= bound[moves]).all() and (bound[~moves] == -np.inf).all()


@pytest.mark.parametrize("arm", ["gp50"], indirect=True)
def test_mjx_agrees(arm):
    """Compare with site and geoms of MJX, MuJoCo's port to JAX."""

    def mjx_says(x: jax.Array) -> tuple:
        data = mjx.kinematics(model, start.replace(qpos=x))
        return data.site_xpos[0], data.site_xmat[0], data.geom_xpos

    with jax.numpy_rank_promotion("allow"):
        model, start = mjx.put_model(arm.model), mjx.make_data(arm.model)
        tcp, rotation, middle = jax.jit(jax.vmap(mjx_says))(jnp.asarray(arm.xs))
    T_world_tcp = over(kinematics.tcp_pose, arm.robot, arm.xs)
    assert_close(T_world_tcp[:, :3, 3], tcp)
    assert_close(T_world_tcp[:, :3, :3], np.asarray(rotation).reshape(-1, 3, 3))
    p, q = over(kinematics.capsule_segments, arm.robot, arm.xs)
    assert_close((p + q) / 2, np.asarray(middle)[:, round_geoms(arm.model)])


def test_jacobian_is_mujocos_and_the_derivative(arm):
    """Compare the geometric Jacobian with mj_jacSite, jacfwd, jacrev and central differences."""
    jacobian = over(kinematics.jacobian, arm.robot, arm.xs)
    assert_close(jacobian, arm.truth.jacobian)
    for derivative in (jax.jacfwd, jax.jacrev):
        differentiated = derivative(kinematics.tcp_position, argnums=1)
        assert_close(jacobian, over(differentiated, arm.robot, arm.xs))
    # The errors of central differences: h^2 / 6 times the third derivative, some metres, and 1e-15 / h.
    h = 1e-5
    steps = h * np.concatenate([np.eye(len(arm.robot.slides)), -np.eye(len(arm.robot.slides))])
    around = np.repeat(arm.xs, len(steps), axis=0) + np.tile(steps, (len(arm.xs), 1))
    tcp = np.asarray(over(kinematics.tcp_position, arm.robot, around)).reshape(len(arm.xs), 2, -1, 3)
    assert_close(jacobian, np.swapaxes((tcp[:, 0] - tcp[:, 1]) / (2 * h), 1, 2))


def test_point_jacobians_are_the_derivative(arm):
    """Compare the closed form with autodiff for points fixed to each link and to the world."""
    links = (-1, *range(len(arm.robot.slides)), 1, 0, -1)
    local = jnp.asarray(np.random.default_rng(1).normal(size=(len(links), 3)))
    index = np.array(links)

    def points(robot: Robot, x: jax.Array) -> jax.Array:
        T = jnp.concatenate([kinematics.link_poses(robot, x), jnp.eye(4)[None]])[index]
        return jnp.einsum("pij,pj->pi", T[:, :3, :3], local) + T[:, :3, 3]

    def closed(robot: Robot, x: jax.Array) -> jax.Array:
        return kinematics.point_jacobians(robot, x, points(robot, x), links)

    assert_close(over(closed, arm.robot, arm.xs), over(jax.jacfwd(points, argnums=1), arm.robot, arm.xs))


def test_batch_equals_the_loop(arm):
    """Compare bit by bit, so that the result of a scenario cannot depend on its batch."""

    def everything(robot: Robot, x: jax.Array) -> tuple:
        p, q = kinematics.capsule_segments(robot, x)
        return (
            p,
            q,
            kinematics.jacobian(robot, x),
            kinematics.point_jacobians(robot, x, p, robot.capsule_link),
        )

    batch = over(everything, arm.robot, arm.xs[:65])
    for size in (1, 32):
        part = over(everything, arm.robot, arm.xs[:size])
        jax.tree.map(lambda few, all_, n=size: np.testing.assert_array_equal(few, all_[:n]), part, batch)


# The recorded run, with its figures from scene.md.


def recorded_run() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Configurations (76, 6), workpiece rotations (76, 3, 3) and origins (76, 3) in the world."""
    if not DUCT.is_dir():
        pytest.skip(f"the measured duct is not here: {DUCT}")
    rows = np.loadtxt(DUCT / "reference_run.csv", delimiter=",")[11:]
    (wy, wz), one, zero = rows[:, 7:9].T, np.ones(len(rows)), np.zeros(len(rows))
    Ry = np.array([[np.cos(wy), zero, np.sin(wy)], [zero, one, zero], [-np.sin(wy), zero, np.cos(wy)]])
    Rz = np.array([[np.cos(wz), -np.sin(wz), zero], [np.sin(wz), np.cos(wz), zero], [zero, zero, one]])
    rotation = np.einsum("ijs,jks->sik", Rz, Ry)
    pivot, neutral = (1.73205679, -0.0037799, 0.57539635), (1.24549547, -0.0037799, 0.87525497)
    return rows[:, :6], rotation, pivot + rotation @ np.subtract(neutral, pivot)


def distance(points: np.ndarray, p: np.ndarray, q: np.ndarray) -> float:
    """Smallest distance between the points and the segment from p to q."""
    along, reach = q - p, points - p
    s = np.clip(reach @ along / max(along @ along, 1e-300), 0, 1)
    return np.linalg.norm(reach - s[:, None] * along, axis=1).min()


def test_recorded_run_follows_its_path():
    """Row k >= 11 has its TCP at the path's row k - 11, with an error of 0.496 mm on average, 0.996 at most."""
    xs, rotation, origin = recorded_run()
    path = np.loadtxt(DUCT / "reference_path.csv", delimiter=",")[: len(xs)]
    target = np.einsum("sij,sj->si", rotation, path + np.array([0, 0.02, 0])) + origin
    error = 1e3 * np.linalg.norm(over(kinematics.tcp_position, gp50(), xs) - target, axis=1)
    assert len(error) == 76
    assert (round(error.mean(), 3), round(error.max(), 3)) == (0.496, 0.996)


def test_recorded_run_just_touches_the_cloud():
    """Minimum clearance of capsules 4 to 6c to the cloud: -0.25 mm, by brute force in numpy."""
    xs, rotation, origin = recorded_run()
    cloud = np.loadtxt(DUCT / "cloud.xyz")
    robot = gp50()
    ps, qs = (
        np.einsum("sij,ski->skj", rotation, np.asarray(ends) - origin[:, None])  # in the workpiece frame
        for ends in over(kinematics.capsule_segments, robot, xs)
    )
    near = [robot.capsule_names.index(f"capsule_{k}") for k in ("4", "5", "6a", "6b", "6c")]
    radius = np.asarray(robot.capsule_radius)
    clearance = [[distance(cloud, p[k], q[k]) - radius[k] for k in near] for p, q in zip(ps, qs, strict=True)]
    assert round(1e3 * np.min(clearance), 2) == -0.25
