"""Robot programs of other arms, with orientation tasks, in a cell: limits, clearance, rows and torques, by MuJoCo."""

import jax.numpy as jnp
import numpy as np
import pytest
from published import MODELS, path_of
from scipy.spatial.transform import Rotation
from small_cell import small_job

import htcp_jax
from htcp_jax.cli import main
from htcp_jax.jobs import load_config
from htcp_jax.jobs.build import robot_of
from htcp_jax.model.kinematics import tcp_pose
from htcp_jax.runs import open_plans
from htcp_jax.status import Kind
from htcp_jax.trajectory.plan_program import program_of
from htcp_jax.validation import check_timed
from htcp_jax.validation.records import read_results
from htcp_jax.validation.validate import LoadedParts

STEP_S = 1e-3
ROUNDING = 1e-6  # of a limit: third differences of doubles over 1 ms
FLOOR = '<mujoco><worldbody><geom name="floor" type="plane" size="3 3 .1" pos="0 0 -0.6"/></worldbody></mujoco>'


def rows(kind: str, job: dict) -> list[dict]:
    """A task that holds at the job's start: the tool's axis in a cone, along a direction, or its full orientation."""
    config = load_config(job)
    R = np.asarray(tcp_pose(robot_of(config.robot), jnp.array(config.start)))[:3, :3]
    more = {
        "cone": {"axis": "tcp.z", "towards": R[:, 2].tolist(), "cone_deg": 10},
        "axis": {"axis": "tcp.z", "towards": R[:, 2].tolist()},
        "orientation": {"orientation": Rotation.from_matrix(R).as_quat(scalar_first=True).tolist()},
    }
    return [{"point": "tcp", "on": "path"}, more[kind]]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), [("panda", "orientation"), ("panda", "cone"), ("ur10", "axis")])
def test_an_arm_with_a_task_in_a_cell_is_timed_within_its_limits_and_nothing_is_refuted(name, kind, tmp_path):
    model, arm = MODELS[name], tmp_path / "arm.xml"
    words = [] if model.tcp is None else ["--tcp", model.tcp]
    assert main(["robot", str(path_of(name)), "--out", str(arm), *words]) == 0
    (tmp_path / "cell.xml").write_text(FLOOR)
    job = small_job(arm, tmp_path, model.out) | {"cell": {"model": str(tmp_path / "cell.xml")}}
    plan = htcp_jax.plan(job | {"task": rows(kind, job)})
    assert plan.complete
    plan.save(tmp_path / "plan")
    made = program_of(open_plans(tmp_path / "plan"), 0.02)
    timed = made.program.timed(STEP_S)
    for order, limit in enumerate(made.limits, 1):
        assert (np.abs(np.diff(timed.x, n=order, axis=0)) / STEP_S**order <= (1 + ROUNDING) * limit).all()
    found = check_timed(tmp_path / "plan", timed, made.method)
    assert found.refuted == 0 and found.clearance_min_m > 0
    assert 0 < made.peak_torque.share < 1 and abs(made.peak_torque.torque) > 1
    if kind != "cone":
        passed = made.program.at(made.program.at_configurations().time_s)
        results = read_results(tmp_path / "plan")
        seen, _, _ = LoadedParts(results).of(next(iter(results.tracks)))
        axes = seen.frames(np.vstack([job["start_rad"], passed.x[passed.kind == Kind.PROCESS]]), "tcp")[1][:, :, 2]
        assert np.arccos(np.minimum(axes[1:] @ axes[0], 1.0)).max() <= made.job.settings.tolerance_rad
