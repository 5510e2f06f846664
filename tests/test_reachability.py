"""Reachability bounds: what is found is clear and on target, what is excluded is unreachable, whatever the batch."""

import itertools
from dataclasses import replace

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
import toy
from scipy.spatial.transform import Rotation

from htcp_jax.clearance import minimum_clearance
from htcp_jax.clearance.proof.branch_exclusion import BRANCHES, branch, has_branches
from htcp_jax.clearance.proof.exclusion import Bodies, arm_cell, has_wrist, wrist
from htcp_jax.cli import main
from htcp_jax.device import Executor
from htcp_jax.device.tables import gather
from htcp_jax.model.kinematics import link_poses, point_positions, tcp_position
from htcp_jax.model.scenario import stack
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.motion.tool_cells import BRANCH, TOOL, Cells, tool_cells
from htcp_jax.reachability import reachable_prefixes
from htcp_jax.settings import Settings

COARSE = 0.22


@pytest.fixture(scope="module")
def found():
    robot, workpiece = made_once.robot(), made_once.duct()
    scenarios = [make_scenario(robot, workpiece, made_once.START, rotation=pose) for pose in ((0.4, 0.1), (0.8, 0.0))]
    how = {"resolution_rad": COARSE, "proof_cells": 1024}
    return robot, workpiece, scenarios, reachable_prefixes(robot, workpiece, stack(scenarios), **how)


def test_a_complete_scenario_is_found_reachable_and_one_that_dead_ends_is_not(found):
    _, _, scenarios, result = found
    assert result.prefix[0] == scenarios[0].count
    assert 71 <= result.prefix[1] < scenarios[1].count  # reached by the random search
    assert np.isnan(result.best[0]) and result.best[1] < 5e-4


def test_every_configuration_found_is_clear_and_on_its_target(found):
    _, _, scenarios, result = found
    for scenario, x, prefix in zip(scenarios, result.x, result.prefix, strict=True):
        D, tcp = made_once.measured(scenario, x[:prefix])
        assert (D > 0).all()
        assert (np.linalg.norm(tcp - scenario.targets[:prefix], axis=1) <= 1e-3).all()
        assert np.isnan(x[prefix:]).all()


def test_the_arm_behind_the_tool_proves_that_the_end_of_a_path_is_out_of_reach(found):
    """Proof that the end of a path is out of reach, by the bodies behind the tool."""
    _, _, scenarios, result = found
    assert result.most[0] == result.prefix[0] == scenarios[0].count
    assert result.prefix[1] < result.most[1] < scenarios[1].count


ROWS = 400  # configurations or cells of a call, so that each function is compiled once


def all_branches(robot, tolerance_m, at, R, rho):
    """All branches of a cell, stacked, and the orientation of the link before the wrist at each."""
    own = jax.vmap(lambda number: branch(robot, at, R, rho, number, tolerance_m))(np.arange(BRANCHES))
    return own, jax.vmap(lambda x: link_poses(robot, x)[2, :3, :3])(own.x)


def arm_cells(scene, s, x, about, turns):
    """Wrist position at x, and the bounds of the cell of the joints before the wrist."""
    where = point_positions(scene.robot, x, wrist(scene.robot).on_arm[None], (3,))[0]
    return where, arm_cell(scene, s, s.target, about, turns)


def tcp_and_links(robot, x):
    return tcp_position(robot, x), link_poses(robot, x)[:, :3, :3]


poses, branches, cells_of_the_arm = (made_once.in_rows(each, ROWS) for each in (tcp_and_links, all_branches, arm_cells))


@pytest.fixture(scope="module")
def cells(found):
    """300 clear configurations, and a cell of tool orientations and one of the joints about each, of three sizes."""
    robot, _, scenarios, result = found
    draw = np.random.default_rng(2)
    s, size = draw.integers(2, size=300), draw.choice([0.003, 0.03, 0.3], 300)
    row = draw.integers(result.prefix[s])
    x, axis, inputs = result.x[s, row], draw.normal(size=(300, 3)), lane_inputs(stack(scenarios), s, row)
    axis *= (draw.uniform(0, size) / np.linalg.norm(axis, axis=1))[:, None]
    middle = Rotation.from_rotvec(axis) * Rotation.from_matrix(poses((robot,), x)[1][:, -1])
    turns = size[:, None] * draw.uniform(0, 1, (300, 6))
    return x, inputs, middle, size, x + turns * draw.uniform(-1, 1, (300, 6)), turns


def run(lane_function, inputs, middle, *rest):
    """Bounds of cells of tool orientations, by all bodies."""
    executor, q = Executor(made_once.scene(), Settings()), middle.as_quat()[:, [3, 0, 1, 2]]
    return executor(lane_function, inputs, q, *rest, np.full(len(q), int(Bodies.ARM)))


def test_a_configuration_is_in_the_cells_about_it_with_its_wrist_and_excluded_by_none_where_it_is_clear(found, cells):
    assert has_wrist(found[0])
    x, inputs, middle, size, about, turns = cells
    at, of_arm = cells_of_the_arm((made_once.scene(),), inputs, x, about, turns)
    for cell in (run(TOOL, inputs, middle, size), of_arm):
        assert not cell.collides.any()
        assert (np.linalg.norm(cell.wrist - at, axis=1) <= cell.moves).all()


def moved(robot, joint, shift=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0)):
    """The robot with a joint's frame moved [m] and turned [rad]."""
    T, every = np.eye(4), np.array(robot.T_parent_joint)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), shift
    every[joint] = every[joint] @ T
    return replace(robot, T_parent_joint=jnp.asarray(every))


def away(x, own):
    """Distances of configurations (n, 6) from the middles of all branches (n, BRANCHES, 6), modulo one revolution."""
    return np.abs((x[:, None] - own.x + np.pi) % (2 * np.pi) - np.pi)


@pytest.mark.parametrize(
    ("joint", "shift", "turn"),
    [(0, (0, 0, 0), (0, 0, 0)), (1, (0, 0.02, 0.05), (0, 0, 0)), *((k, (0, 0, 0), (3e-6, 0, 0)) for k in (1, 2, 4, 5))],
    ids=["gp50", "lateral offset", "skew 2", "skew 3", "skew 5", "skew 6"],
)
def test_a_configuration_is_in_a_branch_of_any_cell_of_its_tool_s_orientation(joint, shift, turn):
    """Singular wrists and stretched elbows included; a branch also bounds the rotation of the link before the wrist."""
    robot, draw, tolerance_m = moved(made_once.robot(), joint, shift, turn), np.random.default_rng(joint), 1e-3
    assert has_branches(robot)
    x, size, number = draw.uniform(-3.1, 3.1, (400, 6)), draw.choice([1e-6, 1e-3, 0.03, 0.5], 400), np.arange(400)
    x[:, 4] = np.choose(number % 4, [x[:, 4], 0.0, 1e-7, 1e-4])
    x[:, 2] = np.where(number // 4 % 4 == 3, -0.202, x[:, 2])
    at, R = poses((robot,), x)
    turned, aside = draw.normal(size=(2, 400, 3))
    turned *= (draw.uniform(0, size) / np.linalg.norm(turned, axis=1))[:, None]
    aside *= (draw.uniform(0, tolerance_m, 400) / np.linalg.norm(aside, axis=1))[:, None]
    middle = Rotation.from_rotvec(turned).as_matrix() @ R[:, -1]
    own, forearm = branches((robot, tolerance_m), at + aside, middle, size)
    inside = (away(x, own) <= own.turns).all(axis=-1) & ~own.empty
    assert inside.any(axis=1).all()
    rotated = Rotation.from_matrix((forearm.swapaxes(-1, -2) @ R[:, None, 2])[inside])
    assert (rotated.magnitude() <= own.forearm_turns[inside] + 1e-9).all()


def test_the_branches_of_a_small_cell_are_narrow():
    robot, x = made_once.robot(), np.array([[0.3, -0.5, 0.4, 0.6, 0.9, -0.2]])
    at, R = poses((robot,), x)
    own, _ = branches((robot, 0.0), at, R[:, -1], np.array([1e-6]))
    assert own.turns[~own.empty].max() < 1e-4
    assert np.abs(own.x - x)[~own.empty].max(axis=-1).min() < 1e-5


def test_an_arm_without_an_elbow_or_with_more_joints_has_no_branches(found):
    robot, *_ = found
    assert has_branches(robot)
    assert not has_branches(moved(robot, 2, turn=(0.1, 0, 0)))
    assert not has_branches(moved(robot, 5, shift=(1e-6, 0, 0)))


def test_no_branch_of_a_clear_configuration_is_excluded(cells):
    x, inputs, middle, size, *_ = cells
    own, _ = branches((made_once.robot(), made_once.scene().task.tolerance_m), inputs.target, middle.as_matrix(), size)
    lane, number = np.divmod(np.arange(300 * BRANCHES), BRANCHES)
    collides = run(BRANCH, gather(inputs, lane), middle[lane], size[lane], number).reshape(300, BRANCHES)
    inside = (away(x, own) <= own.turns).all(axis=-1)
    assert inside.any(axis=1).all() and not collides[inside].any()
    assert collides.sum() > 300  # other branches are


def test_an_arm_whose_last_axes_pass_each_other_has_no_wrist(found):
    robot, *_ = found
    nearly = np.array(robot.T_parent_joint)
    nearly[-1, 0, 3] += 1e-6
    assert not has_wrist(replace(robot, T_parent_joint=jnp.asarray(nearly)))
    assert not has_wrist(replace(robot, slides=(False,) * 5 + (True,)))


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


def walled_in(radius_m, margin_m):
    """A target in the centre of a ball of points, and free space around it."""
    count = len(toy.workpiece().cloud)  # as many points as the shelf has, so that the programs are the same
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    ball = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)
    target = np.array([0.3, 0.4, 0.6])
    part = replace(toy.workpiece(), cloud=target + radius_m * ball, path=target[None])
    return part, make_scenario(toy.robot(), part, toy.START, rotation=(0.0, 0.0), approach=(1, 0), margin_m=margin_m)


def test_a_target_behind_walls_all_around_is_proven_unreachable_and_one_in_the_open_is_found():
    part, scenario = walled_in(0.05, 0.08)
    result = reachable_prefixes(toy.robot(), part, stack([scenario]), toy.SETTINGS, resolution_rad=0.11)
    assert result.prefix[0] == result.most[0] == 1
    part, scenario = walled_in(3.5, 0.08)
    result = reachable_prefixes(toy.robot(), part, stack([scenario]), toy.SETTINGS, resolution_rad=0.9)
    assert result.prefix[0] == result.most[0] == scenario.count


def test_the_cells_cover_every_orientation_in_which_the_tool_is_clear(found):
    """Cells that cover every orientation in which the tool is clear.

    Compared with brute force: random configurations, with the part carried to their tip, and only tool and wrist
    measured.
    """
    robot, _, scenarios, _ = found
    scene, row = made_once.scene(), 60
    where = replace(scenarios[0], interior_plane=np.array([1.0, 0.0, 0.0, np.inf]))  # only the walls
    inputs = lane_inputs(stack([where]), np.zeros(1, int), np.array([row]))
    cells = tool_cells(Executor(scene, Settings()), inputs, COARSE, 10**6)
    outer = np.array(robot.capsule_link) >= 4
    only = replace(robot, capsule_radius=jnp.where(outer, robot.capsule_radius, -1e3))

    def measure(x):
        pose = jnp.asarray(where.T_world_workpiece).at[:3, 3].add(tcp_position(robot, x) - where.targets[row])
        moved = replace(where, T_world_workpiece=pose)
        return minimum_clearance(only, scene.obstacles, moved, x), link_poses(robot, x)[-1, :3, :3]

    x = np.random.default_rng(1).uniform(-np.pi, np.pi, (3000, 6))
    D, R = made_once.quick_jit(lambda x: jax.lax.map(measure, x))(x)
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
    toy.write_sweep(tmp_path)
    words = ["reachability", str(tmp_path / "grid.yaml"), "--limit", "1", "--resolution", "0.9", "--proof-cells", "0"]
    words += ["--out", str(tmp_path / "run")]
    assert main(words) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "are reachable: those before the first one, in each scenario, at which no configuration was found" in said
    assert "at most: those before the first one that is proven to be unreachable" in said
    assert (tmp_path / "run" / "reachability.json").exists()
    assert main([*words[:5], "0"]) == 2 and main([*words[:7], "-1"]) == 2
