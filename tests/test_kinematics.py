"""Kinematics: equal to MuJoCo, MJX, autodiff, finite differences, and a recorded run of the cell."""

from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import made_once
import mujoco
import numpy as np
import pytest
from mujoco import mjx

from htcp_jax.io.robots.loading import gp50, load_robot
from htcp_jax.model import Robot, kinematics
from htcp_jax.spec import GP50

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


class Found(NamedTuple):
    """The package's results for S configurations."""

    T_world_link: np.ndarray  # (S, N, 4, 4)
    T_world_tcp: np.ndarray  # (S, 4, 4)
    tcp: np.ndarray  # (S, 3)
    p: np.ndarray  # (S, K, 3)
    q: np.ndarray
    jacobian: np.ndarray  # (S, 3, N)
    body_jacobians: np.ndarray  # (S, K, 3, N), of the points p


@made_once.quick_jit
@partial(jax.vmap, in_axes=(None, 0))
def found_by(robot: Robot, x: jax.Array) -> Found:
    p, q = kinematics.capsule_segments(robot, x)
    return Found(
        kinematics.link_poses(robot, x),
        kinematics.tcp_pose(robot, x),
        kinematics.tcp_position(robot, x),
        p,
        q,
        kinematics.jacobian(robot, x),
        kinematics.point_jacobians(robot, x, p, robot.capsule_link),
    )


class Arm(NamedTuple):
    robot: Robot
    model: mujoco.MjModel
    xs: np.ndarray  # (1000, N), the first at zero: the GP50's wrist is singular there
    truth: Truth
    found: Found


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
    return Arm(robot, model, xs, mujoco_says(model, xs), jax.tree.map(np.asarray, found_by(robot, xs)))


def assert_close(actual, wanted, atol: float = 1e-9) -> None:
    np.testing.assert_allclose(np.asarray(actual), np.asarray(wanted), rtol=0, atol=atol)


def round_geoms(model: mujoco.MjModel) -> np.ndarray:
    return np.flatnonzero(np.isin(model.geom_type, (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE)))


def test_links_are_mujocos_bodies(arm):
    """Compare the orientation of each link with its body's, and its origin with the joint's anchor."""
    T_world_link = arm.found.T_world_link
    bodies = arm.model.jnt_bodyid
    last = np.flatnonzero(np.append(bodies[1:] != bodies[:-1], True))  # MuJoCo has no frame between a body's two joints
    rotation = arm.truth.body_rotation[:, bodies[last]]
    anchor = np.einsum("snij,nj->sni", rotation, arm.model.jnt_pos[last])
    anchor += arm.truth.body_position[:, bodies[last]]
    assert_close(T_world_link[:, last][..., :3, :3], rotation)
    assert_close(T_world_link[:, last][..., :3, 3], anchor)
    assert (T_world_link[:, :, 3] == [0, 0, 0, 1]).all()


def test_tcp_is_mujocos_site(arm):
    assert_close(arm.found.T_world_tcp[:, :3, :3], arm.truth.tcp_rotation)
    assert_close(arm.found.T_world_tcp[:, :3, 3], arm.truth.tcp)
    assert_close(arm.found.tcp, arm.truth.tcp)


def test_capsule_ends_are_mujocos_geoms(arm):
    """Compare the ends of capsules and spheres, in the model's order, with p at the +z end, also on the base."""
    p, q = arm.found.p, arm.found.q
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
    at = found_by(arm.robot, xs)
    ends = np.stack([np.asarray(end) for end in (at.p, at.q)])
    furthest = (np.linalg.norm(ends - base, axis=3) + np.asarray(arm.robot.capsule_radius)).max(axis=(0, 1))
    bound = kinematics.body_reach(arm.robot)
    assert (furthest[moves] <= bound[moves]).all() and (bound[~moves] == -np.inf).all()


def test_the_tip_stays_within_the_bounds_on_its_motion(arm):
    """Straight joint paths of all lengths, five places each: travel, and distance from the line between both ends.

    Slides without limits have bounds by their own motion, which are smaller.
    """
    endless = jnp.full(len(arm.robot.slides), jnp.inf)
    free = replace(arm.robot, lower=-endless, upper=endless)
    bounds, rng, share = kinematics.tip_bounds(arm.robot), np.random.default_rng(1), np.linspace(0, 1, 5)[:, None, None]
    slides = np.array(arm.robot.slides)
    a = np.where(slides, np.clip(arm.xs[:200], arm.robot.lower, arm.robot.upper), arm.xs[:200])
    b = a + rng.normal(size=a.shape) * 10.0 ** rng.uniform(-3, 0, (200, 1))
    b[:, slides] = rng.permutation(a[:, slides])
    at = np.asarray(found_by(arm.robot, (a + share * (b - a)).reshape(-1, a.shape[1])).tcp).reshape(5, 200, 3)
    turned, longer = np.abs(b - a), np.zeros(200)
    bulge = np.linalg.norm(at - (at[0] + share * (at[-1] - at[0])), axis=2).max(axis=0)
    assert (np.linalg.norm(at - at[0], axis=2).max(axis=0) <= bounds.travel_m(turned, longer)).all()
    assert (bulge <= bounds.bulge_m(turned, longer)).all() and (bulge > 0.03 * bounds.bulge_m(turned, longer)).any()
    own = kinematics.tip_bounds(free).between(a, b)
    assert (np.linalg.norm(at - at[0], axis=2).max(axis=0) <= own.travel_m(turned, longer)).all()
    assert (bulge <= own.bulge_m(turned, longer)).all()
    assert (own.travel_m(turned, longer) <= bounds.travel_m(turned, longer) * (1 + 1e-12)).all()


@pytest.mark.parametrize("arm", ["gp50"], indirect=True)
def test_mjx_agrees(arm):
    """Compare with site and geoms of MJX, MuJoCo's port to JAX."""

    def mjx_says(x: jax.Array) -> tuple:
        data = mjx.kinematics(model, start.replace(qpos=x))
        return data.site_xpos[0], data.site_xmat[0], data.geom_xpos

    with jax.numpy_rank_promotion("allow"):
        model, start = mjx.put_model(arm.model), mjx.make_data(arm.model)
        tcp, rotation, middle = jax.jit(jax.vmap(mjx_says))(jnp.asarray(arm.xs))
    assert_close(arm.found.T_world_tcp[:, :3, 3], tcp)
    assert_close(arm.found.T_world_tcp[:, :3, :3], np.asarray(rotation).reshape(-1, 3, 3))
    p, q = arm.found.p, arm.found.q
    assert_close((p + q) / 2, np.asarray(middle)[:, round_geoms(arm.model)])


def test_jacobians_are_mujocos_and_the_derivative(arm):
    """Compare the geometric Jacobian with mj_jacSite, jacfwd, jacrev and central differences.

    Compare those of points fixed to each link and to the world with jacfwd.
    """
    links = (-1, *range(len(arm.robot.slides)), 1, 0, -1)
    local = jnp.asarray(np.random.default_rng(1).normal(size=(len(links), 3)))
    index = np.array(links)

    def points(robot: Robot, x: jax.Array) -> jax.Array:
        T = jnp.concatenate([kinematics.link_poses(robot, x), jnp.eye(4)[None]])[index]
        return jnp.einsum("pij,pj->pi", T[:, :3, :3], local) + T[:, :3, 3]

    @made_once.quick_jit
    @partial(jax.vmap, in_axes=(None, 0))
    def derivatives(robot: Robot, x: jax.Array):
        of_tcp = [derivative(kinematics.tcp_position, argnums=1)(robot, x) for derivative in (jax.jacfwd, jax.jacrev)]
        closed = kinematics.point_jacobians(robot, x, points(robot, x), links)
        return of_tcp, closed, jax.jacfwd(points, argnums=1)(robot, x)

    jacobian = arm.found.jacobian
    assert_close(jacobian, arm.truth.jacobian)
    of_tcp, closed, of_points = derivatives(arm.robot, arm.xs)
    for differentiated in of_tcp:
        assert_close(jacobian, differentiated)
    assert_close(closed, of_points)
    # The errors of central differences: h^2 / 6 times the third derivative, some metres, and 1e-15 / h.
    h = 1e-5
    ends = [[np.asarray(found_by(arm.robot, arm.xs + side * step).tcp) for side in (h, -h)]
            for step in np.eye(len(arm.robot.slides))]  # fmt: skip
    assert_close(jacobian, np.stack([(ahead - behind) / (2 * h) for ahead, behind in ends], axis=2))


def test_batch_equals_the_loop(arm):
    """Compare bit by bit, so that the result of a scenario cannot depend on its batch."""
    for size in (1, 32):
        part = found_by(arm.robot, arm.xs[:size])
        jax.tree.map(lambda few, all_, n=size: np.testing.assert_array_equal(few, all_[:n]), part, arm.found)


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


@cache
def recorded_poses() -> Found:
    """Results for the recorded run, padded to the number of configurations of the other tests."""
    xs = recorded_run()[0]
    return jax.tree.map(lambda all_: np.asarray(all_)[: len(xs)], found_by(gp50(), np.resize(xs, (1000, 6))))


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
    error = 1e3 * np.linalg.norm(recorded_poses().tcp - target, axis=1)
    assert len(error) == 76
    assert (round(error.mean(), 3), round(error.max(), 3)) == (0.496, 0.996)


def test_recorded_run_just_touches_the_cloud():
    """Minimum clearance of capsules 4 to 6c to the cloud: -0.25 mm, by brute force in numpy."""
    _, rotation, origin = recorded_run()
    cloud = np.loadtxt(DUCT / "cloud.xyz")
    robot = gp50()
    ps, qs = (
        np.einsum("sij,ski->skj", rotation, np.asarray(ends) - origin[:, None])  # in the workpiece frame
        for ends in (recorded_poses().p, recorded_poses().q)
    )
    near = [robot.capsule_names.index(f"capsule_{k}") for k in ("4", "5", "6a", "6b", "6c")]
    radius = np.asarray(robot.capsule_radius)
    clearance = [[distance(cloud, p[k], q[k]) - radius[k] for k in near] for p, q in zip(ps, qs, strict=True)]
    assert round(1e3 * np.min(clearance), 2) == -0.25
