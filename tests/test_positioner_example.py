"""The example that ships with a positioner: only a free positioner holds its seam in flat position."""

import mujoco
import numpy as np
import pytest

import htcp_jax
from htcp_jax.cli import main
from htcp_jax.io.robots import load_robot
from htcp_jax.spec import GP50
from htcp_jax.spec.examples import examples
from htcp_jax.validation import validate_results

JOB = examples()["positioner"]
SHARED = {"shoulder": 1, "upper_arm": 2, "elbow": 3, "forearm": 4, "wrist": 5}  # with their numbers in the GP50's file


def posed(file, x):
    """MuJoCo's data of a model with the arm's joints at x; all others are 0."""
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    for k, value in enumerate(x, 1):
        data.joint(f"joint{k}").qpos = value
    mujoco.mj_kinematics(model, data)
    return model, data


@pytest.mark.parametrize("seed", range(3))
def test_the_cells_arm_is_the_built_in_gp50(seed):
    x = np.random.default_rng(seed).uniform(-3, 3, 6)
    (ours, here), (theirs, there) = posed(JOB.parent / "cell.xml", x), posed(GP50, x)
    for name, k in SHARED.items():
        one, other = ours.geom(name), theirs.geom(f"capsule_{k}")
        np.testing.assert_allclose(here.geom(name).xpos, there.geom(f"capsule_{k}").xpos, atol=1e-9)
        np.testing.assert_allclose(one.size[:1], other.size[:1], atol=1e-9)
    np.testing.assert_allclose(here.body("link6").xpos, there.body("link6").xpos, atol=1e-9)
    np.testing.assert_allclose(here.body("link6").xmat, there.body("link6").xmat, atol=1e-9)


def test_its_limits_and_speeds_are_the_data_sheets():
    cell, gp50 = load_robot(JOB.parent / "cell.xml"), load_robot(GP50, limits="datasheet")
    assert cell.joint_names == ("turn", "tilt", *gp50.joint_names)
    for name in ("lower", "upper", "speed"):
        np.testing.assert_allclose(getattr(cell, name)[2:], getattr(gp50, name), rtol=1e-12, err_msg=name)


def test_a_locked_positioner_is_refused_with_the_angle_that_no_joint_changes(tmp_path, capsys):
    locked = ["--set", "robot.locked={tilt: -0.8, turn: 0}"]  # the distance of points on the part plays no role
    words = [*locked, "--set", "workpiece.mesh_spacing_m=0.02", "--out", str(tmp_path / "plan")]
    assert main(["plan", str(JOB), *words]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert "task.3 (axis path.normal): no joint changes this angle; it is 17.42 degrees at point 3 of the path" in line
    assert not (tmp_path / "plan").exists()


@pytest.mark.slow
def test_the_seam_is_complete_and_validated_with_the_positioner_free_and_not_with_its_tilt_locked(tmp_path):
    plan = htcp_jax.plan(JOB)
    assert plan.complete and plan.outcome.executable == 50, plan.failure()
    assert np.ptp(plan.plans.x[0, :, 0]) > 4.0  # the table turns
    plan.save(tmp_path / "plan")
    found = validate_results(tmp_path / "plan")
    assert found.validated, found.refuted[:3]
    tilted = htcp_jax.plan(JOB, {"robot.locked": {"tilt": -0.8}})
    assert not tilted.complete and tilted.outcome.failed == 9


@pytest.mark.slow
def test_with_an_indexed_tilt_the_seam_is_complete_and_validated_at_one_tilt_that_the_planner_chooses(tmp_path):
    plan = htcp_jax.plan(JOB, {"robot.indexed": ["tilt"]})
    assert plan.complete and plan.outcome.executable == 50, plan.failure()
    (tilt,) = {*plan.motion().x[:, 1].tolist()}
    assert 50.9 < abs(np.rad2deg(tilt)) < 60  # the only tilts that do, see docs/positioner.md
    plan.save(tmp_path / "plan")
    found = validate_results(tmp_path / "plan")
    assert found.validated, found.refuted[:3]
