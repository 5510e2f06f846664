"""Reachability bounds: what is found is clear and on target, what is excluded is unreachable, whatever the batch."""

import itertools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from htcp_jax.clearance import Scene, clearance
from htcp_jax.clearance.obstacles.of_workpiece import make_obstacle
from htcp_jax.clearance.proof.arm_exclusion import arm_cell, has_wrist, tool_cell, wrist
from htcp_jax.clearance.proof.branch_exclusion import BRANCHES, branch, branch_collides, has_branches
from htcp_jax.clearance.proof.exclusion import tool_collides
from htcp_jax.cli import main
from htcp_jax.device import Executor
from htcp_jax.io.parts.workpiece_source import load_workpiece
from htcp_jax.io.robots.loading import gp50
from htcp_jax.model import Workpiece
from htcp_jax.model.kinematics import link_poses, point_positions, tcp_position
from htcp_jax.model.scenario import make_scenario, stack
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.motion.tool_cells import Cells, tool_cells
from htcp_jax.reachability import reachable_prefixes
from htcp_jax.settings import Settings

COARSE = 0.22
START = (0.0, -2.3, 0.5, 0.0, 0.5, -2.0)


@pytest.fixture(scope="module")
def found():
    robot, workpiece = gp50(), load_workpiece()
    scenarios = [make_scenario(robot, workpiece, START, rotation=pose) for pose in ((0.4, 0.1), (0.8, 0.0))]
    return robot, workpiece, scenarios, reachable_prefixes(robot, workpiece, stack(scenarios), resolution_rad=COARSE)


def test_a_complete_scenario_is_found_reachable_and_one_that_dead_ends_is_not(found):
    _, _, scenarios, result = found
    assert result.prefix[0] == scenarios[0].count
    assert 71 <= result.prefix[1] < scenarios[1].count  # reached by the random search
    assert np.isnan(result.best[0]) and result.best[1] < 5e-4


def test_every_configuration_found_is_clear_and_on_its_target(found):
    robot, workpiece, scenarios, result = found
    obstacle = make_obstacle(workpiece)
    for scenario, x, prefix in zip(scenarios, result.x, result.prefix, strict=True):
        rows = np.linspace(0, prefix - 1, 7).astype(int)
        measure = jax.jit(lambda x, s=scenario: (clearance(robot, obstacle, s, x), tcp_position(robot, x)))
        for row in rows:
            D, tcp = measure(x[row])
            assert D > 0
            assert np.linalg.norm(tcp - scenario.targets[row]) <= 1e-3
        assert np.isnan(x[prefix:]).all()


def test_the_arm_behind_the_tool_proves_that_the_end_of_a_path_is_out_of_reach(found):
    """Proof that the end of a path is out of reach, by the bodies behind the tool."""
    _, _, scenarios, result = found
    assert result.most[0] == result.prefix[0] == scenarios[0].count
    assert result.prefix[1] < result.most[1] < scenarios[1].count


def test_a_configuration_is_in_the_cells_about_it_with_its_wrist_and_excluded_by_none_where_it_is_clear(found):
    robot, workpiece, scenarios, result = found
    scene, draw = Scene(robot, make_obstacle(workpiece)), np.random.default_rng(2)
    assert has_wrist(robot)

    @jax.jit
    def cells(s, target, x, about, turns, q, rho):
        where = point_positions(robot, x, wrist(robot).on_arm[None], (3,))[0]
        margin = jnp.asarray(s.margin_m)
        return where, tool_cell(scene, s, margin, target, q, rho), arm_cell(scene, s, margin, target, about, turns)

    for _ in range(300):
        s = draw.integers(2)
        row, size = draw.integers(result.prefix[s]), draw.choice([0.003, 0.03, 0.3])
        x = jnp.asarray(result.x[s, row])
        axis = draw.normal(size=3)
        turned = Rotation.from_matrix(np.asarray(link_poses(robot, x)[-1, :3, :3]))
        middle = Rotation.from_rotvec(draw.uniform(0, size) * axis / np.linalg.norm(axis)) * turned
        q, turns = middle.as_quat()[[3, 0, 1, 2]], size * draw.uniform(0, 1, 6)
        about = x + turns * draw.uniform(-1, 1, 6)
        at, *both = cells(scenarios[s], *map(jnp.asarray, (scenarios[s].targets[row], x, about, turns, q, size)))
        for cell in both:
            assert not cell.collides
            assert np.linalg.norm(cell.wrist - at) <= cell.moves


def branches(robot, at, R, rho, tolerance_m):
    """All branches of a cell, stacked."""
    return jax.vmap(lambda number: branch(robot, at, R, rho, number, tolerance_m))(np.arange(BRANCHES))


def moved(robot, joint, shift=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0)):
    """The robot with a joint's frame moved [m] and turned [rad]."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), shift
    return replace(robot, T_parent_joint=robot.T_parent_joint.at[joint].set(robot.T_parent_joint[joint] @ T))


@pytest.mark.parametrize(
    ("joint", "shift", "turn"),
    [(0, (0, 0, 0), (0, 0, 0)), (1, (0, 0.02, 0.05), (0, 0, 0)), *((k, (0, 0, 0), (3e-6, 0, 0)) for k in (1, 2, 4, 5))],
    ids=["gp50", "lateral offset", "skew 2", "skew 3", "skew 5", "skew 6"],
)
def test_a_configuration_is_in_a_branch_of_any_cell_of_its_tool_s_orientation(joint, shift, turn):
    """Singular wrists and stretched elbows included; a branch also bounds the rotation of the link before the wrist."""
    robot, draw, tolerance_m = moved(gp50(), joint, shift, turn), np.random.default_rng(joint), 1e-3
    assert has_branches(robot)
    cells = jax.jit(lambda at, R, rho: branches(robot, at, R, rho, jnp.asarray(tolerance_m)))
    pose = jax.jit(lambda x: (tcp_position(robot, x), link_poses(robot, x)[:, :3, :3]))
    for number in range(400):
        x, size = draw.uniform(-3.1, 3.1, 6), draw.choice([1e-6, 1e-3, 0.03, 0.5])
        x[4] = [x[4], 0.0, 1e-7, 1e-4][number % 4]
        x[2] = [x[2], x[2], x[2], -0.202][number // 4 % 4]
        at, R = pose(x)
        turned, aside = draw.normal(size=(2, 3))
        turned *= draw.uniform(0, size) / np.linalg.norm(turned)
        aside *= draw.uniform(0, tolerance_m) / np.linalg.norm(aside)
        middle = Rotation.from_rotvec(turned).as_matrix() @ np.asarray(R[-1])
        found = jax.tree.map(np.asarray, cells(at + aside, middle, size))
        away = (x - found.x + np.pi) % (2 * np.pi) - np.pi
        inside = (np.abs(away) <= found.turns).all(axis=1) & ~found.empty
        assert inside.any()
        for k in np.flatnonzero(inside):
            forearm = np.asarray(pose(found.x[k])[1][2]).T @ np.asarray(R[2])
            assert Rotation.from_matrix(forearm).magnitude() <= found.forearm_turns[k] + 1e-9


def test_the_branches_of_a_small_cell_are_narrow():
    robot, x = gp50(), jnp.array([0.3, -0.5, 0.4, 0.6, 0.9, -0.2])
    at, R = tcp_position(robot, x), link_poses(robot, x)[-1, :3, :3]
    found = [branch(robot, at, R, jnp.asarray(1e-6), jnp.asarray(k), jnp.asarray(0.0)) for k in range(BRANCHES)]
    assert max(float(own.turns.max()) for own in found if not own.empty) < 1e-4
    assert min(float(np.abs(own.x - x).max()) for own in found) < 1e-5


def test_an_arm_without_an_elbow_or_with_more_joints_has_no_branches(found):
    robot, *_ = found
    assert has_branches(robot)
    assert not has_branches(moved(robot, 2, turn=(0.1, 0, 0)))
    assert not has_branches(moved(robot, 5, shift=(1e-6, 0, 0)))


def test_no_branch_of_a_clear_configuration_is_excluded(found):
    robot, workpiece, scenarios, result = found
    scene, draw = Scene(robot, make_obstacle(workpiece)), np.random.default_rng(3)

    @jax.jit
    def both(s, at, q, R, rho):
        def collides(number):
            return branch_collides(scene, s, jnp.asarray(s.margin_m), at, q, rho, number)

        return jax.vmap(collides)(np.arange(BRANCHES)), branches(robot, at, R, rho, scene.task.tolerance_m)

    excluded = 0
    for _ in range(300):
        s = draw.integers(2)
        row, size = draw.integers(result.prefix[s]), draw.choice([0.003, 0.03, 0.3])
        x, axis = result.x[s, row], draw.normal(size=3)
        turned = Rotation.from_matrix(np.asarray(link_poses(robot, jnp.asarray(x))[-1, :3, :3]))
        middle = Rotation.from_rotvec(draw.uniform(0, size) * axis / np.linalg.norm(axis)) * turned
        at = jnp.asarray(scenarios[s].targets[row])
        collides, own = both(scenarios[s], at, middle.as_quat()[[3, 0, 1, 2]], middle.as_matrix(), size)
        away = (x - np.asarray(own.x) + np.pi) % (2 * np.pi) - np.pi
        inside = (np.abs(away) <= own.turns).all(axis=1)
        assert inside.any() and not np.asarray(collides)[inside].any()
        excluded += int(np.sum(collides))
    assert excluded > 300  # other branches are


def test_an_arm_whose_last_axes_pass_each_other_has_no_wrist(found):
    robot, *_ = found
    assert not has_wrist(replace(robot, T_parent_joint=robot.T_parent_joint.at[-1, 0, 3].add(1e-6)))
    assert not has_wrist(replace(robot, slides=(False,) * 5 + (True,)))


def test_no_orientation_near_that_of_a_clear_configuration_is_excluded(found):
    """No orientation near a clear configuration's is excluded, for any radius."""
    robot, workpiece, scenarios, result = found
    scene, draw = Scene(robot, make_obstacle(workpiece)), np.random.default_rng(0)
    excluded = jax.jit(lambda s, target, q, rho: tool_collides(scene, s, jnp.asarray(s.margin_m), target, q, rho))
    for _ in range(300):
        s = draw.integers(2)
        row, rho = draw.integers(result.prefix[s]), draw.choice([0.003, 0.03, 0.3])
        turned = Rotation.from_matrix(np.asarray(link_poses(robot, jnp.asarray(result.x[s, row]))[-1, :3, :3]))
        axis = draw.normal(size=3)
        middle = Rotation.from_rotvec(draw.uniform(0, rho) * axis / np.linalg.norm(axis)) * turned
        q = middle.as_quat()[[3, 0, 1, 2]]
        assert not excluded(scenarios[s], *map(jnp.asarray, (scenarios[s].targets[row], q, rho)))


def test_an_approach_whose_lines_lead_out_of_reach_is_at_the_path_s_first_point(found):
    """Approach over an unreachable point: the configurations stay at the path's first point.

    Planners leave the straight lines there, too; the given scenario is not changed.
    """
    robot, workpiece, (scenario, _), _ = found
    targets, first = scenario.targets[:14].copy(), int(scenario.on_path)
    targets[5] = 9.0
    scenario = replace(scenario, targets=targets, count=np.asarray(14, np.int32))
    result = reachable_prefixes(robot, workpiece, stack([scenario]), resolution_rad=0.9)
    assert result.prefix[0] == result.most[0] == 14 and (scenario.targets[5] == 9.0).all()
    for row in range(5, first):
        assert np.linalg.norm(tcp_position(robot, jnp.asarray(result.x[0, row])) - targets[first]) <= 1e-3


def walled_in(radius_m):
    """A target in the centre of a ball of points, and free space around it."""
    k = np.arange(8000) + 0.5
    z, turn = 1 - 2 * k / 8000, np.pi * (1 + 5**0.5) * k
    ball = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)
    target = np.array([1.5, 0.0, 1.0])
    part = Workpiece("ball", target + radius_m * ball, target[None], interior="none", pivot=np.zeros(3),
                     neutral_translation=np.zeros(3))  # fmt: skip
    return part, make_scenario(gp50(), part, START, rotation=(0.0, 0.0), approach=(1, 0))


def test_a_target_behind_walls_all_around_is_proven_unreachable_and_one_in_the_open_is_found():
    part, scenario = walled_in(0.3)
    result = reachable_prefixes(gp50(), part, stack([scenario]), resolution_rad=0.11)
    assert result.prefix[0] == result.most[0] == 1
    part, scenario = walled_in(3.5)
    result = reachable_prefixes(gp50(), part, stack([scenario]), resolution_rad=0.9)
    assert result.prefix[0] == result.most[0] == scenario.count


def test_the_cells_cover_every_orientation_in_which_the_tool_is_clear(found):
    """Cells that cover every orientation in which the tool is clear.

    Compared with brute force: random configurations, with the part carried to their tip, and only tool and wrist
    measured.
    """
    robot, workpiece, scenarios, _ = found
    scene, where, row = Scene(robot, make_obstacle(workpiece)[:1]), scenarios[0], 60
    inputs = lane_inputs(stack([where]), np.zeros(1, int), np.array([row]))
    cells = tool_cells(Executor(scene, Settings()), inputs, COARSE, 10**6)
    outer = np.array(robot.capsule_link) >= 4
    only = replace(robot, capsule_radius=jnp.where(outer, robot.capsule_radius, -1e3))

    def measure(x):
        pose = jnp.asarray(where.T_world_workpiece).at[:3, 3].add(tcp_position(robot, x) - where.targets[row])
        moved = replace(where, T_world_workpiece=pose)
        return clearance(only, scene.obstacles, moved, x), link_poses(robot, x)[-1, :3, :3]

    x = np.random.default_rng(1).uniform(-np.pi, np.pi, (3000, 6))
    D, R = jax.jit(jax.vmap(measure))(x)
    q = Rotation.from_matrix(np.asarray(R)).as_quat()[:, [3, 0, 1, 2]]
    inside = 2 * np.arccos(np.clip(np.abs(q @ cells.quaternion.T), 0, 1)) <= cells.radius_rad
    clear = np.asarray(D) >= where.margin_m
    assert 0 < clear.sum() < 3000 and inside[clear].any(axis=1).all()
    assert not inside.any(axis=1).all()  # some orientations are excluded


def test_a_cell_has_no_rotation_beyond_its_radius_and_one_at_it():
    rng = np.random.default_rng(3)
    half = np.array([1.0, 0.5, 0.25, 2.0**-8, 2.0**-16])
    cube = rng.uniform(-1, 1, (5, 3)) * (1 - half)[:, None]
    some = Cells(np.zeros(5, int), np.arange(5) % 4, cube, half, np.zeros((5, 3)), np.zeros(5), np.zeros(5, int))
    corners = np.array(list(itertools.product([-1.0, 1.0], repeat=3)))
    for k in range(5):
        points = cube[k] + half[k] * np.concatenate([corners, rng.uniform(-1, 1, (500, 3))])
        there = Rotation.from_quat(np.insert(points, some.face[k], 1.0, axis=1))
        angles = (Rotation.from_quat(some.quaternion[k]).inv() * there).magnitude()
        assert angles.max() <= some.radius_rad[k] + 1e-9 and np.isclose(angles.max(), some.radius_rad[k], rtol=1e-6)


def test_the_command_writes_the_prefixes_and_refuses_a_resolution_of_nothing(tmp_path, capsys):
    words = [
        "reachability",
        "sweeps/workpiece.yaml",
        "--limit",
        "1",
        "--resolution",
        "0.9",
        "--proof-cells",
        "0",
        "--out",
        str(tmp_path / "run"),
    ]
    assert main(words) == 0
    assert "lower bound" in capsys.readouterr().out
    assert (tmp_path / "run" / "reachability.json").exists()
    assert main([*words[:5], "0"]) == 2 and main([*words[:7], "-1"]) == 2
