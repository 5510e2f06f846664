"""Full poses along a path, by an arm with one redundant joint, in free space; public problems by their own rules."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import jax.numpy as jnp
import made_once
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import htcp_jax
from benchmarks.path_check import check, clearance
from benchmarks.path_problems import CHECKED, arm_xml, made, poses, problems, read_problem
from htcp_jax.errors import InputError
from htcp_jax.jobs import load_config
from htcp_jax.model.kinematics import tcp_pose
from htcp_jax.validation import validate_results

DATA = Path(__file__).parents[2] / "shared/data/paths"
TASK = [{"point": "tcp", "on": "path"}, {"orientation": "path"}]
MIDDLE = np.array([0.3, 0.8, -0.2, -1.2, 0.4, 0.7, 0.1])
POINTS, STEP_M, TURN_RAD = 4, 0.01, 0.02


@pytest.fixture
def job(tmp_path):
    """Job of seven joints with a short line of poses that turn along it; without obstacles."""
    arm = made_once.seven_joints(tmp_path)
    T = np.asarray(made_once.quick_jit(tcp_pose)(arm, jnp.asarray(MIDDLE)))
    places = T[:3, 3] + np.outer(STEP_M * np.arange(POINTS), [0, 0.6, 0.8])
    turned = Rotation.from_rotvec(np.outer(TURN_RAD * np.arange(POINTS), [1, 0, 0])) * Rotation.from_matrix(T[:3, :3])
    table = np.column_stack([places, turned.as_quat(scalar_first=True)])
    file = tmp_path / "path.csv"
    np.savetxt(file, table, delimiter=",", header="x,y,z,qw,qx,qy,qz", comments="", fmt="%.17g")
    return {
        "robot": {"model": str(tmp_path / "seven.xml")},
        "workpiece": {"cloud": "none", "path": str(file)},
        "start_rad": "auto",
        "task": TASK,
        "settings": {"tolerance_m": 1e-4, "tolerance_rad": 1e-3, "path_tolerance_m": 0.01, "beam_width": 8},
    }


@pytest.mark.parametrize("method", ["baseline", pytest.param("beam", marks=pytest.mark.slow)])
def test_an_arm_with_a_joint_to_spare_follows_poses_in_empty_space_from_where_it_likes(job, tmp_path, method):
    plan = htcp_jax.plan(job | {"method": method})
    assert plan.complete
    far = plan.plans._replace(clearance=np.full_like(plan.plans.clearance, np.inf))  # no nearest bodies to measure
    assert replace(plan, plans=far).facts(verbose=True)["clearance is to"] == "none"
    x = plan.motion().x
    np.testing.assert_allclose(x[0], plan.plans.x[0, 0], atol=1e-6)
    assert np.abs(np.diff(x, axis=0)).max() < 0.1
    path = np.genfromtxt(job["workpiece"]["path"], delimiter=",", skip_header=1)
    wanted = Rotation.from_quat(path[:, 3:], scalar_first=True)
    model = mujoco.MjModel.from_xml_path(job["robot"]["model"])
    data = mujoco.MjData(model)
    for row, place, rotation in zip(plan.plans.x[0, 1:], path[:, :3], wanted, strict=True):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        assert np.linalg.norm(data.site_xpos[0] - place) <= 1e-4
        assert (Rotation.from_matrix(data.site_xmat[0].reshape(3, 3)).inv() * rotation).magnitude() <= 1e-3
    plan.save(tmp_path / "plan")
    found = validate_results(tmp_path / "plan")
    assert not found.refuted


def test_a_job_without_a_cloud_keeps_clear_of_itself_and_needs_no_wall(job):
    made = load_config(job)
    assert made.cell.self_collision and made.workpiece.rotation_y_rad == 0.0 and made.workpiece.tip_contact_m is None
    part = htcp_jax.load_workpiece(htcp_jax.NoCloud(), job["workpiece"]["path"])
    assert len(part.cloud) == 0 and part.walls == "none" and not htcp_jax.make_obstacle(part)
    with pytest.raises(InputError, match="the path's file must have normals"):
        part.normals  # noqa: B018


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cell.self_collision": False}, "no obstacles: set workpiece.cloud"),
        ({"workpiece.path": "weld"}, "workpiece.path is missing"),
        ({"task": [{"axis": "tcp.z", "towards": "path.normal"}]}, "the path's file must have normals"),
    ],
)
def test_what_a_job_without_a_cloud_lacks_is_said_in_one_line(job, change, message):
    with pytest.raises(InputError, match=message):
        htcp_jax.plan(job, change)


@pytest.fixture
def data():
    if not DATA.is_dir():
        pytest.skip("../shared/data/paths is not next to the repository")
    return DATA


def test_a_problem_s_arm_is_the_same_by_mujoco_and_by_products_of_matrices(data, tmp_path):
    for name in ("fetch__circle", "fetch_arm__hello", "panda__1cube", "iklink__panda"):
        problem = read_problem(data, name)
        (tmp_path / "arm.xml").write_text(arm_xml(name, problem.arm))
        model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
        assert [model.joint(k).name for k in range(model.njnt)] == [joint.name for joint in problem.arm.moving]
        at = mujoco.MjData(model)
        for x in made_once.configurations(htcp_jax.load_robot(tmp_path / "arm.xml"), 5):
            at.qpos[:] = x
            mujoco.mj_kinematics(model, at)
            T = poses(problem.arm, x)
            np.testing.assert_allclose(at.site_xpos[0], T[problem.arm.tip][:3, 3], atol=1e-12)
            np.testing.assert_allclose(at.site_xmat[0].reshape(3, 3), T[problem.arm.tip][:3, :3], atol=1e-12)


def test_the_rules_refuse_what_breaks_them(data):
    problem = read_problem(data, "fetch_arm__circle")
    still = np.tile(np.zeros(7), (len(problem.position), 1))
    found = check(problem, still)
    assert not found.good.any() and found.calm.all() and found.reconfigurations == 0 and found.length == 0
    leaps = still.copy()
    leaps[3:, 0], leaps[5:, 2] = np.deg2rad(8), 2 * np.pi
    found = check(problem, leaps)
    assert not found.calm[2] and found.calm.sum() == len(found.calm) - 1 and found.reconfigurations == 1
    assert np.isnan(check(problem, np.where(np.arange(len(still))[:, None] == 1, np.nan, still)).steps[0]).all()


def test_clearance_is_that_of_capsules_and_boxes(data):
    problem = read_problem(data, "panda__1cube")
    lower, upper = (np.array([getattr(joint, side) for joint in problem.arm.moving]) for side in ("lower", "upper"))
    x = np.random.default_rng(0).uniform(lower, upper, (20, 7))
    T = poses(problem.arm, x)
    sampled = np.full(20, np.inf)
    for link, numbers in problem.arm.capsules.items():
        axis = numbers[:3] + np.linspace(0, 1, 400)[:, None] * (numbers[3:6] - numbers[:3])
        own = np.broadcast_to(T[link], (len(x), 4, 4))
        points = axis @ np.swapaxes(own[:, :3, :3], 1, 2) + own[:, None, :3, 3]
        outside = np.abs(points - problem.boxes[0, :3]) - problem.boxes[0, 6:] / 2
        away = np.linalg.norm(np.maximum(outside, 0), axis=2) + np.minimum(outside.max(axis=2), 0)
        sampled = np.minimum(sampled, away.min(axis=1) - numbers[6])
    found, shallow = clearance(problem, T), sampled > -0.04  # deeper an axis is in the box, and there are other depths
    assert (found[shallow] <= sampled[shallow] + 1e-6).all() and (found[~shallow] < 0).all()
    alone = problem._replace(
        arm=problem.arm._replace(ignored=frozenset(map(frozenset, combinations(CHECKED["panda"], 2))))
    )
    np.testing.assert_allclose(clearance(alone, T)[shallow], sampled[shallow], atol=1e-4)
    assert len(problems(data)) == 11


@pytest.mark.slow
def test_a_public_problem_is_valid_by_its_own_rules(data, tmp_path):
    problem = read_problem(data, "fetch_arm__hello")
    plan = htcp_jax.plan(made(problem, tmp_path))
    assert check(problem, plan.plans.x[0, plan.scenario.on_path :]).valid
