"""Tasks of one to six equalities by arms other than the GP50, in front of a plate: every row confirmed by MuJoCo."""

import jax.numpy as jnp
import numpy as np
import pytest
from published import MODELS, path_of
from scipy.spatial.transform import Rotation
from small_cell import small_job

import htcp_jax
from htcp_jax.io.robots.mjcf import arm_xml
from htcp_jax.io.robots.vendor_import import import_robot
from htcp_jax.jobs import load_config
from htcp_jax.jobs.build import scene
from htcp_jax.model.kinematics import link_poses, tcp_pose
from htcp_jax.runs import open_plans
from htcp_jax.validation import validate_results

ON_PATH = {"point": "tcp", "on": "path"}


@pytest.fixture(params=["panda", "ur10"])
def job(request, tmp_path):
    name = request.param
    arm = tmp_path / "arm.xml"
    arm.write_text(arm_xml(import_robot(path_of(name), MODELS[name].tcp), name))
    return small_job(arm, tmp_path, MODELS[name].out)


def tasks(job: dict) -> dict[int, list[dict]]:
    """Tasks by their number of equalities, which all hold at the start. Four: two points at once."""
    robot, _, scenario = scene(load_config(job))
    x = jnp.asarray(scenario.x_start)
    T = np.asarray(tcp_pose(robot, x))
    body = next(frame for frame in robot.frames if frame.link == 3)
    elbow = np.asarray(link_poses(robot, x))[3] @ [*body.origin_m, 1.0]
    ahead = T[:3, 2].tolist()
    return {
        1: [{**ON_PATH, "axes": "z"}],
        2: [{**ON_PATH, "axes": "xy"}],
        3: [ON_PATH, {"axis": "tcp.z", "towards": ahead, "cone_deg": 3}],
        4: [ON_PATH, {"point": body.name, "on": "plane", "through_m": elbow[:3].tolist(), "normal": [1, 2, 3]}],
        5: [ON_PATH, {"axis": "tcp.z", "towards": ahead}],
        6: [ON_PATH, {"orientation": Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True).tolist()}],
    }


@pytest.mark.slow
@pytest.mark.parametrize("rows", [1, 2, 3, 4, 5, 6])
def test_an_arm_is_given_a_task_of_any_number_of_equalities(job, rows, tmp_path):
    task = tasks(job)[rows]
    plan = htcp_jax.plan(job | {"task": task}, method="baseline")
    held = plan.plans
    assert plan.complete and held.executable.all()
    plan.save(tmp_path / "plan")
    assert validate_results(tmp_path / "plan").validated


def test_the_tcp_distance_is_the_position_alone_and_the_orientation_has_a_row_of_its_own(job, tmp_path):
    """TCP distance and orientation error, separately (regression: 0.401 mm were printed for 0.319 mm)."""
    task = tasks(job)[6]
    plan = htcp_jax.plan(job | {"task": task}, method="baseline")
    held, s = plan.plans, plan.summary
    assert held.tracked.all()
    np.testing.assert_allclose(held.residual, np.linalg.norm(held.tcp - held.target, axis=2), atol=1e-12)
    wanted = Rotation.from_quat(task[1]["orientation"], scalar_first=True)
    turned = Rotation.from_matrix([np.asarray(tcp_pose(plan.robot, jnp.asarray(x)))[:3, :3] for x in held.x[0]])
    angle = (turned * wanted.inv()).magnitude()
    np.testing.assert_allclose(held.orientation_error[0], angle, atol=1e-9)
    assert angle.max() > 1e-6 and s.orientation_error_max_deg == pytest.approx(np.degrees(angle.max()))
    assert plan.facts()["orientation error"] == f"{s.orientation_error_mean_deg:.3g} deg mean, " + (
        f"{s.orientation_error_max_deg:.3g} deg maximum"
    )
    plan.save(tmp_path / "plan")
    read = open_plans(tmp_path / "plan").plans("baseline")
    np.testing.assert_array_equal(read.orientation_error, held.orientation_error)


def test_a_job_without_an_orientation_says_nothing_of_one(job):
    plan = htcp_jax.plan(job | {"task": tasks(job)[3]}, method="baseline")
    assert plan.plans.tracked.all() and np.isnan(plan.plans.orientation_error).all()
    assert "orientation error" not in plan.facts() and plan.record()["orientation_error_max_deg"] is None
