"""Joints that follow others: limits, poses, Jacobians, bounds and plans, with MuJoCo's equality constraints solved.

The references are MuJoCo's kinematics at joint positions for which the residuals of its constraints vanish.
"""

import dataclasses
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import made_once
import mujoco
import numpy as np
import pytest
import toy

from htcp_jax.clearance import Scene
from htcp_jax.clearance.obstacles.fixtures import HalfSpace, fixtures
from htcp_jax.clearance.obstacles.obstacle import RowPairs
from htcp_jax.clearance.proof import branch_exclusion, exclusion
from htcp_jax.clearance.proof.motion_bound import (
    JointSweep,
    body_sweep,
    motion_bound,
    pair_travel_bound,
    tcp_sweep,
)
from htcp_jax.clearance.proof.row_proof import _FeatureSweep
from htcp_jax.errors import InputError
from htcp_jax.io.robots.loading import gp50, load_robot
from htcp_jax.jobs.batch import _like
from htcp_jax.model import Coupling, Feature, LimitArrays, Robot, coordinate_limits, kinematics
from htcp_jax.model.coupling import joints_between, moved_by
from htcp_jax.model.robot import ArmFrame
from htcp_jax.planning.tracking.null_space import seen_rows
from htcp_jax.reachability.configuration_search import _scaled_pose
from htcp_jax.trajectory.displacement import arm_at, bend_bound, displacement_bound
from htcp_jax.validation.following import Following

NAMES = ["a", "b", "c"]  # b and c follow a
# A lift of two stages, an elbow that follows a lever on the base, a hand that follows the elbow, and a rod next to the
# upper arm. Values in the initial configuration, offsets, negative factors, sliding joints, a chain of followers.
FOLLOWING = """
<mujoco model="following"><compiler angle="radian" boundmass="1e-3" boundinertia="1e-3"/>
<worldbody><geom name="post" type="capsule" size="0.05" fromto="0 0 0 0 0 0.2"/>
  <body name="lever" pos="0.3 0.4 0.1"><joint name="lever" axis="0 0 1" range="-0.6 0.9"/>
    <geom name="lever" type="capsule" size="0.02" fromto="0 0 0 0.2 0 0"/></body>
  <body name="stage1" pos="0 0 0.2"><joint name="lift" type="slide" axis="0 0 1" range="-0.1 0.3" ref="0.1"/>
    <geom name="stage1" type="capsule" size="0.04" fromto="0 0 0 0 0 0.2"/>
    <body name="stage2" pos="0 0 0.2"><joint name="lift2" type="slide" axis="0 0.1 1" range="-0.2 0.2"/>
      <body name="column" pos="0.02 0 0.1"><joint name="turn" axis="0 0 1" range="-2 2"/>
        <body name="rod" pos="-0.1 0 0.05"><joint name="rod" axis="0 1 0" range="-1 1"/>
          <geom name="rod" type="capsule" size="0.02" fromto="0 0 0 0 0 0.3"/></body>
        <body name="upper" pos="0 0 0.05"><joint name="shoulder" axis="0 1 0" range="-1.5 1.2"/>
          <geom name="upper" type="capsule" size="0.03" fromto="0 0 0 0 0 0.3"/>
          <body name="lower" pos="0 0 0.3"><joint name="elbow" axis="0.1 1 0" ref="0.3" range="-1 2" pos="0 0 0.01"/>
            <geom name="lower" type="capsule" size="0.03" fromto="0 0 0 0.3 0 0"/>
            <body name="hand" pos="0.3 0 0"><joint name="level" axis="0 1 0" range="-3 3"/>
              <body name="tool" pos="0.05 0 0"><joint name="roll" axis="0 0 1" range="-3 3"/>
                <geom name="tool" type="capsule" size="0.02" fromto="0 0 0 0 0 -0.1"/>
                <site name="tcp" pos="0 0.02 -0.15"/>
  </body></body></body></body></body></body></body>
</worldbody>
<equality>
  <joint joint1="level" joint2="elbow" polycoef="0.2 -0.8 0 0 0"/>
  <joint joint1="lift2" joint2="lift" polycoef="0.02 0.5 0 0 0"/>
  <joint joint1="elbow" joint2="lever" polycoef="0.1 1.5 0 0 0"/>
  <joint joint1="rod" joint2="shoulder" polycoef="0 1 0 0 0"/>
  <joint joint1="shoulder" joint2="roll" polycoef="0 9 0 0 0" active="false"/>
</equality></mujoco>
"""
COORDINATES = ("lever", "lift", "turn", "shoulder", "roll")
JOINTS = ("lift", "lift2", "turn", "shoulder", "elbow", "level", "roll", "lever", "rod")


class Truth(NamedTuple):
    """MuJoCo's results at S configurations."""

    tcp: np.ndarray  # (S, 3)
    jacobian: np.ndarray  # of the TCP, (S, 3, N)
    ends: np.ndarray  # of the capsules, (2, S, K, 3)
    residual: float  # largest violation of a constraint [rad or m]


@cache
def followers() -> tuple[Robot, mujoco.MjModel]:
    return loaded(FOLLOWING)


def loaded(text: str, **choices) -> tuple[Robot, mujoco.MjModel]:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "arm.xml"
        file.write_text(text)
        return load_robot(file, **choices), mujoco.MjModel.from_xml_path(str(file))


def truth(robot: Robot, model: mujoco.MjModel, x: np.ndarray) -> Truth:
    data, joints = mujoco.MjData(model), range(model.njnt)
    own = Following.of(model, data, np.array(joints), {})
    assert [model.joint(j).name for j in own.free] == [*robot.joint_names]
    geoms = [model.geom(name).id for name in robot.capsule_names]
    tcp, slopes, ends, worst = [], [], [], 0.0
    for row in x:
        data.qpos[own.moving] = own.positions(row)
        mujoco.mj_fwdPosition(model, data)
        held = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        worst = max(worst, np.abs(data.efc_pos[held]).max())
        by_joint = np.empty((3, model.nv))
        mujoco.mj_jacSite(model, data, by_joint, None, model.site("tcp").id)
        along = model.geom_size[geoms, 1][:, None] * data.geom_xmat[geoms, 2::3]
        tcp.append(data.site_xpos[model.site("tcp").id].copy())
        slopes.append(by_joint[:, own.moving] @ own.factors)
        ends.append([data.geom_xpos[geoms] + along, data.geom_xpos[geoms] - along])
    return Truth(np.array(tcp), np.array(slopes), np.swapaxes(ends, 0, 1), worst)


def within(robot: Robot, count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(robot.lower, robot.upper, (count, robot.dof))


def limits_of(lower, upper):
    joints = LimitArrays(
        np.array(lower), np.array(upper), np.array([3.0, 2.0, 9.0]), np.array([np.inf, 8.0, 1.0]), np.array([5.0, 1, 2])
    )
    factors, offsets = np.array([[1.0], [-2.0], [0.5]]), np.array([0.0, 0.25, 0.0])
    return coordinate_limits(factors, offsets, joints, NAMES, ["a"], "arm.urdf: ")


def test_a_coordinate_keeps_the_limits_of_every_joint_that_follows_it():
    found = limits_of([-3.0, -0.75, -np.inf], [3.0, 1.25, 0.2])
    assert [float(each[0]) for each in found] == [-0.5, 0.4, 1.0, 2.0, 5.0]


def test_limits_that_no_value_keeps_are_refused_by_name():
    with pytest.raises(InputError, match=r"arm\.urdf: joint a has no range within the limits of a and c"):
        limits_of([0.6, -0.75, -1.0], [3.0, 1.25, 0.2])


MOUSE = """
<mujoco><compiler angle="radian"/><worldbody><body name="mouse" mocap="true" pos="1 0 1"/>
  <body><joint name="a" axis="0 1 0"/><geom size="0.1"/>
    <body pos="1 0 0"><joint name="b" axis="0 1 0"/><geom size="0.1"/>
      <body name="hand" pos="1 0 0"><joint name="c" axis="0 1 0"/><geom size="0.1"/></body></body></body>
</worldbody><equality><joint joint1="b" joint2="a" polycoef="0.1 2"/>MORE</equality></mujoco>"""


@pytest.mark.parametrize("tie", ["weld", "connect"])
def test_validation_ignores_what_pulls_an_arm_with_followers_to_a_mocap_body(tie):
    anchor = 'anchor="0 0 0"' if tie == "connect" else ""
    more = f'<{tie} body1="mouse" body2="hand" {anchor}/>'
    model = mujoco.MjModel.from_xml_string(MOUSE.replace("MORE", more))
    own = Following.of(model, mujoco.MjData(model), np.arange(3), {})
    np.testing.assert_allclose(own.factors, [[1, 0], [2, 0], [0, 1]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(own.offsets, [0, 0.1, 0], rtol=0, atol=1e-12)


def test_validation_refuses_constraints_that_do_not_hold_together():
    model = mujoco.MjModel.from_xml_string(MOUSE.replace("MORE", '<joint joint1="b" polycoef="0.5"/>'))
    with pytest.raises(InputError, match="<equality> constraints of the joints b do not hold together"):
        Following.of(model, mujoco.MjData(model), np.arange(3), {})


def test_a_joint_moves_the_links_after_it_on_its_own_branch():
    moves = moved_by((-1, 0, 1, 0))
    assert moves.tolist() == [[1, 0, 0, 0], [1, 1, 0, 0], [1, 1, 1, 0], [1, 0, 0, 1], [0, 0, 0, 0]]
    assert joints_between((-1, 0, 1, 0), 3, 2) == ([2, 1, 3], [-1.0, -1.0, 1.0])


def test_poses_and_jacobians_are_mujocos_with_its_equality_constraints_solved():
    robot, model = followers()
    assert (robot.joint_names, robot.all_joint_names) == (COORDINATES, JOINTS)
    x = within(robot, 200)
    known = truth(robot, model, x)
    assert known.residual < 1e-12
    found = jax.vmap(lambda x: (kinematics.tcp_position(robot, x), kinematics.jacobian(robot, x)))(x)
    ends = jax.vmap(partial(kinematics.capsule_segments, robot))(x)
    for ours, theirs in zip((*found, *ends), (known.tcp, known.jacobian, *known.ends), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)


def test_limits_are_those_at_which_a_joint_reaches_its_own_in_mujoco():
    robot, model = followers()
    own = Following.of(model, mujoco.MjData(model), np.arange(model.njnt), {})
    low, high = model.jnt_range[own.moving].T
    for k, limits in enumerate(zip(robot.lower.tolist(), robot.upper.tolist(), strict=True)):
        for limit in limits:
            slack = []
            for off in (-1e-9, 1e-9):
                x = 0.5 * np.asarray(robot.lower + robot.upper)
                x[k] = limit + off
                slack.append(np.minimum(own.positions(x) - low, high - own.positions(x))[own.factors[:, k] != 0].min())
            assert min(slack) < 0 < max(slack)


def test_jacobians_of_points_on_any_link_are_derivatives_of_their_positions():
    robot, _ = followers()
    links = (*range(len(robot.slides)), -1)
    points = jnp.asarray(np.random.default_rng(2).normal(size=(len(links), 3)))

    def both(x):
        at = kinematics.point_positions(robot, x, points, links)
        axes = kinematics.directions(robot, x, points, links)
        slopes = jax.jacfwd(lambda x: kinematics.point_positions(robot, x, points, links))(x)
        turns = jax.jacfwd(lambda x: kinematics.directions(robot, x, points, links))(x)
        by_axes = kinematics.direction_jacobians(robot, x, axes, links)
        return kinematics.point_jacobians(robot, x, at, links) - slopes, by_axes - turns

    assert all(np.abs(each).max() < 1e-12 for each in jax.vmap(both)(within(robot, 20)))


def test_bodies_on_a_straight_path_move_no_further_than_the_bounds_at_1000_places():
    """Rates of the joints are C u': the bounds are tight where opposite followers cancel, too."""
    robot, model = followers()
    bodies = range(len(robot.capsule_link))
    rows = RowPairs(*np.array([(a, robot.capsule_link[b]) for a in bodies for b in bodies if a != b]).T)

    def bounds(x, rates, half):
        own, within = JointSweep(rates, half), motion_bound(robot, x, half * jnp.abs(rates))
        return (
            body_sweep(robot, x, own).travel,
            within,
            pair_travel_bound(robot, rows, x, own),
            tcp_sweep(robot, x, own),
        )

    frames = made_once.quick_jit(jax.vmap(partial(kinematics.link_poses, robot)))
    bounded, rng, tightest = made_once.quick_jit(bounds), np.random.default_rng(4), 0.0
    for x in within(robot, 12, 1):
        rates, half = rng.normal(size=robot.dof) * rng.integers(0, 2, robot.dof), rng.choice([0.02, 0.2])
        if not rates.any():
            continue
        places = np.append(0.0, np.linspace(-half, half, 1000))
        path = x + places[:, None] * rates
        known, T = truth(robot, model, path), np.asarray(frames(path))
        travel, box, relative, tcp = bounded(x, rates, half)
        moved = np.linalg.norm(known.ends - known.ends[:, :1], axis=-1).max(axis=(0, 1))
        assert (moved <= np.asarray(travel) + 1e-12).all() and (moved <= np.asarray(box) + 1e-12).all()
        off = known.tcp - known.tcp[0] - places[:, None] * np.asarray(tcp.velocity)
        assert (np.linalg.norm(off, axis=1) <= 0.5 * places**2 * float(tcp.bend) + 1e-12).all()
        for body, link, most in zip(*rows, np.asarray(relative).tolist(), strict=True):
            R, t = (np.eye(3)[None], np.zeros((1, 3))) if link < 0 else (T[:, link, :3, :3], T[:, link, :3, 3])
            seen = np.einsum("esi,sij->esj", known.ends[:, :, body] - t, np.broadcast_to(R, (len(path), 3, 3)))
            apart = np.linalg.norm(seen - seen[:, :1], axis=-1).max()
            assert apart <= most + 1e-12
            tightest = max(tightest, apart / most if most > 1e-6 else 0.0)
    assert tightest > 0.95


def test_opposite_followers_cancel_on_a_straight_path():
    """A hand that its follower keeps level does not turn with the joint: it moves on an arc of the forearm's length."""
    text = FOLLOWING.replace("0.2 -0.8 0 0 0", "0 -1 0 0 0").replace('axis="0.1 1 0"', 'axis="0 1 0"')
    robot, _ = loaded(text)
    x, rates = jnp.zeros(5), jnp.array([1.0, 0, 0, 0, 0])  # the lever turns the elbow by 1.5
    tool = robot.capsule_names.index("tool")
    assert float(body_sweep(robot, x, JointSweep(rates, jnp.array(1e-4))).travel[tool]) < 1.001 * 1e-4 * 1.5 * np.hypot(
        0.3, 0.01
    )


def test_displacements_of_coordinates_move_no_point_further_than_their_bounds():
    robot, model = followers()
    rng = np.random.default_rng(5)
    x = within(robot, 50, 3)
    near = 0.05 * rng.normal(size=(2, *x.shape))
    arm = arm_at(robot, x)
    bound = arm.moved(displacement_bound(arm, np.abs(near[0]), near[1]))
    first, second = truth(robot, model, x + near[0]), truth(robot, model, x + near[0] + near[1])
    assert (np.linalg.norm(second.ends - first.ends, axis=-1).max(axis=(0, 2)) <= bound.bodies).all()
    assert (np.linalg.norm(second.tcp - first.tcp, axis=-1) <= bound.tcp).all()
    h = 1e-4
    ahead, behind = (truth(robot, model, x + sign * h * near[1]).tcp for sign in (1, -1))
    bend = np.linalg.norm(ahead - 2 * truth(robot, model, x).tcp + behind, axis=1) / h**2
    assert (bend <= arm.moved(bend_bound(arm, h * np.abs(near[1]), near[1])).tcp + 1e-6).all()


def with_rod(robot: Robot) -> Robot:
    """Return an arm with a rod on its first link, which copies its second joint."""
    rows = ("T_parent_joint", "axis"), ("capsule_p", "capsule_q", "capsule_radius", "on_tool")
    more = {name: jnp.concatenate([getattr(robot, name), getattr(robot, name)[1:2]]) for name in sum(rows, ())}
    links, n = len(robot.slides), robot.dof
    own = Coupling(
        jnp.concatenate([jnp.eye(n), jnp.eye(n)[1:2]]), jnp.zeros(n + 1), (*robot.joint_names, "rod"),
        *[(np.inf,) * (n + 1)] * 2, (*range(-1, links - 1), 0), links - 1, robot.slides,
    )  # fmt: skip
    return dataclasses.replace(
        robot, **more, slides=(*robot.slides, False), capsule_names=(*robot.capsule_names, "rod"),
        capsule_link=(*robot.capsule_link, links), coupling=own,
    )  # fmt: skip


def test_exclusions_use_the_branches_of_an_arm_with_followers_on_side_branches_alone():
    robot = with_rod(gp50())
    chain = exclusion.chain_of(robot)
    assert branch_exclusion.has_branches(robot) and chain.capsule_link == gp50().capsule_link
    np.testing.assert_array_equal(exclusion.wrist(robot).on_arm, exclusion.wrist(gp50()).on_arm)
    shifted = dataclasses.replace(robot.coupling, offsets=robot.coupling.offsets.at[2].set(0.1))
    other = dataclasses.replace(robot, coupling=shifted)
    assert exclusion.has_wrist(other) and not branch_exclusion.has_branches(other)


def test_a_box_of_coordinates_confines_the_wrist_of_an_arm_whose_elbow_follows_its_shoulder():
    rod = with_rod(gp50()).coupling
    factors = np.delete(np.asarray(rod.factors)[:6], 2, axis=1)
    factors[2, 1] = -0.5
    own = dataclasses.replace(
        rod, factors=jnp.asarray(factors), offsets=jnp.zeros(6).at[2].set(0.2), joint_names=rod.joint_names[:6],
        speed=rod.speed[:6], acceleration=rod.acceleration[:6], parents=rod.parents[:6], slides=rod.slides[:5],
    )  # fmt: skip
    limits = {name: getattr(gp50(), name)[:5] for name in ("lower", "upper", "speed", "acceleration", "effort")}
    robot = dataclasses.replace(gp50(), **limits, joint_names=tuple(np.delete(gp50().joint_names, 2)), coupling=own)
    assert np.asarray(exclusion.before_wrist(robot)).tolist() == [True, True, False, False, False]
    assert np.asarray(kinematics.is_periodic(robot)).tolist() == [True, False, True, True, True]
    where, rng = made_once.nominal(), np.random.default_rng(6)
    cell = made_once.quick_jit(lambda x, turns: exclusion.arm_cell(Scene(robot, ()), where, jnp.zeros(3), x, turns))
    wrist = made_once.quick_jit(
        lambda x: kinematics.point_positions(robot, x, exclusion.wrist(robot).on_arm[None], (3,))[0]
    )
    for x, turns in rng.uniform(0, 1, (20, 2, 5)) * [[1.0], [0.3]]:
        _, centre, moves = map(np.asarray, cell(x, turns))
        inside = [wrist(x + turns * rng.uniform(-1, 1, 5)) for _ in range(20)]
        assert (np.linalg.norm(np.array(inside) - centre, axis=1) <= moves).all()


def test_directions_on_a_rod_and_the_tools_pose_belong_to_their_own_branches():
    """A rod that turns three times as fast as the shoulder turns its own axes, not the tool."""
    robot = with_rod(toy.robot())
    own = dataclasses.replace(robot.coupling, factors=robot.coupling.factors.at[4, 1].set(3.0))
    robot, rates = dataclasses.replace(robot, coupling=own), jnp.zeros(4).at[1].set(1.0)
    rod, tool = (Feature(link, (0.0, 0.0, 1.0), is_direction=True) for link in (4, None))
    turning = [
        float(_FeatureSweep(robot, (each,), jnp.zeros(4), rates, jnp.array(0.1)).turning) for each in (rod, tool)
    ]
    assert turning == [3.0, 1.0]
    seen = Feature(None, tool.vector, is_direction=True, seen_from=ArmFrame("rod", 4, (0.0,) * 3, ((0.0,) * 3,) * 3))
    assert float(_FeatureSweep(robot, (seen,), jnp.zeros(4), rates, jnp.array(0.1)).turning) == 4.0
    x = jnp.asarray(toy.START)
    np.testing.assert_allclose(_scaled_pose(robot, x), _scaled_pose(toy.robot(), x), atol=1e-12)


def test_a_sweep_names_the_side_branch_by_which_robots_differ():
    message = "toy has 4 joints, 0 of them slides, with rod on j1; toy has 4 joints, 0 of them slides; all robots"
    with pytest.raises(InputError, match=f"grid.yaml: {message}"):
        _like(toy.robot(), with_rod(toy.robot()), "grid.yaml")


def test_a_rod_counts_as_a_body_of_the_link_that_carries_it():
    """It is on the inner half of the chain, and stands on what it touches if its drive is hinged on the pedestal."""
    robot, rows = with_rod(toy.robot()), RowPairs(np.arange(3))
    assert seen_rows(SimpleNamespace(robot=robot, rows=rows), False).tolist() == [True, True, False]
    pedestal = dataclasses.replace(robot.coupling, parents=(-1, 0, 1, 2, -1))
    floor = [("floor", HalfSpace(jnp.array([0.0, 0.0, 1.0]), jnp.array(0.02)))]
    for coupling, is_checked in ((robot.coupling, True), (pedestal, False)):
        arm = dataclasses.replace(robot, coupling=coupling)
        assert np.asarray(fixtures(arm, floor).is_checked)[0].tolist() == [True, True, is_checked]
