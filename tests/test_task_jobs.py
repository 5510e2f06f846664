"""Jobs with every number of equalities, two points, cones and bands: planned, and every row confirmed by MuJoCo."""

from functools import cache

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from htcp_jax import api
from htcp_jax.jobs import load_config
from htcp_jax.jobs.build import scene, task_of_job
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.model import Workpiece
from htcp_jax.model.kinematics import link_poses, tcp_pose
from htcp_jax.motion import Execution, Problem
from htcp_jax.planning.batch import plan
from htcp_jax.runs.plan_folder import SUMMARY
from htcp_jax.spec import GP50
from htcp_jax.system.output_files import write_json
from htcp_jax.validation import validate_results
from htcp_jax.validation.mujoco_arm import MujocoArm
from htcp_jax.validation.records import data_of
from htcp_jax.validation.task_check import PartPose, check_rows

ON_PATH = {"point": "tcp", "on": "path"}
CONE = {"axis": "tcp.z", "towards": "-path.normal", "cone_deg": 60}
NO_SEGMENTS = {"path_check": "none"}


@cache
def free_plan():
    """Configurations of the default job with a free tool orientation, and the workpiece's pose."""
    job = load_config({"method": "baseline", "settings": NO_SEGMENTS})
    robot, part, scenario = scene(job)
    plans = plan(Problem.of(robot, part, scenario, job.settings, check_paths=False), "baseline")
    assert plans.tracked.all()
    return plans.x[0], np.asarray(scenario.T_world_workpiece)


def tool_frames() -> np.ndarray:
    """Orientations of the tool on that plan's path, in the workpiece frame."""
    x, T_world_workpiece = free_plan()
    T = jax.vmap(lambda x: tcp_pose(made_once.robot(), x))(jnp.asarray(x[11:]))
    return T_world_workpiece[:3, :3].T @ np.asarray(T)[:, :3, :3]


@pytest.fixture
def as_planned(tmp_path):
    """A path's file with that plan's orientations; its normals are against the tool's axis."""
    frames = tool_frames()
    quaternions = Rotation.from_matrix(frames).as_quat(scalar_first=True)
    table = np.column_stack([made_once.duct().path, quaternions, -frames[:, :, 2]])
    file = tmp_path / "weld.csv"
    np.savetxt(file, table, delimiter=",", header="x,y,z,qw,qx,qy,qz,nx,ny,nz", comments="", fmt="%.15g")
    return str(file)


def elbow() -> list[float]:
    return np.asarray(link_poses(made_once.robot(), jnp.asarray(made_once.START)))[3, :3, 3].tolist()


def tasks() -> dict[int, list[dict]]:
    """Typical tasks by their number of equalities.

    To hold a height, to follow a line seen from one side, a point, a point with the elbow in a plane, with the tool's
    axis, with its full orientation.
    """
    return {
        1: [{**ON_PATH, "axes": "z"}],
        2: [{**ON_PATH, "axes": "yz", "frame": "workpiece"}],
        3: [ON_PATH, CONE],
        4: [ON_PATH, {"point": "link4", "on": "plane", "through_m": elbow(), "normal": [0, 1, 0]}],
        5: [ON_PATH, {"axis": "tcp.z", "towards": "-path.normal"}],
        6: [ON_PATH, {"orientation": "path"}],
    }


def planned(task: list[dict], path: str = "weld", method: str = "baseline"):
    """The plan of a job, its task, and its rows by MuJoCo at the tracked targets of the path."""
    settings = NO_SEGMENTS | {"aim_above_m": 0.0}  # as clear as with a free orientation, and no clearer
    job = load_config({"task": task, "workpiece": {"path": path}, "method": method, "settings": settings})
    robot, part, scenario = scene(job)
    held = task_of_job(job, robot)
    plans = plan(Problem.of(robot, part, scenario, job.settings, held, check_paths=False), method)
    return plans, held, confirmed(job, part, scenario, plans)


def confirmed(job, part: Workpiece, scenario, plans):
    t = np.flatnonzero(plans.tracked[0] & (np.arange(plans.tracked.shape[1]) >= scenario.on_path))
    T = np.asarray(scenario.T_world_workpiece)
    place = PartPose(T[:3, :3], T[:3, 3], data_of(part), t - int(scenario.on_path))
    settings = job.settings
    arm = MujocoArm(GP50, limits="simulation")
    return check_rows(job.task, arm, plans.x[0, t], place, settings.tolerance_m, settings.tolerance_rad)


@pytest.mark.slow
@pytest.mark.parametrize("rows", [1, 2, 3, 4, 5, 6])
def test_a_job_of_any_number_of_equalities_is_planned_to_its_end_and_every_row_confirmed(rows, as_planned):
    plans, task, checks = planned(tasks()[rows], as_planned if rows > 4 else "weld")
    assert task.rows == rows and plans.tracked.all()
    assert len(checks) == len(task.parts)
    for number, one in enumerate(checks, 1):
        assert len(one.off) == 94 and not [why for k in range(94) if (why := one.reason(number, k))]


@pytest.mark.slow
@pytest.mark.parametrize("method", ["nspace-sqp", "hybrid", "beam"])
def test_no_method_leaves_its_cone_where_a_free_tool_would(method):
    """Cone constraint in every method, where a free tool would leave the cone.

    The cone is about the direction into the wall, from which the free tool deviates by 60 degrees in the middle.
    """
    plans, _, checks = planned([ON_PATH, {**CONE, "cone_deg": 55}], method=method)
    assert plans.tracked.sum() > 40
    assert not [why for k in range(len(checks[1].off)) if (why := checks[1].reason(2, k))]
    x, _ = free_plan()
    job = load_config({"task": [ON_PATH, {**CONE, "cone_deg": 55}]})
    _, part, scenario = scene(job)
    free = plans._replace(x=x[None])
    assert any(confirmed(job, part, scenario, free)[1].reason(2, k) for k in range(20))


@pytest.mark.slow
def test_a_band_and_a_cone_alone_leave_every_joint_free_and_hold_all_the_same():
    task = [{**ON_PATH, "within_m": 0.004}, {"axis": "tcp.z", "looks_at_m": [3.5, -1.0, 0.8], "cone_deg": 40}]
    plans, held, checks = planned(task)
    assert (held.rows, held.bands) == (0, 7) and plans.tracked.all()
    assert checks[0].off.max() > 1e-3  # it uses the band
    assert not [why for n, one in enumerate(checks, 1) for k in range(94) if (why := one.reason(n, k))]


@pytest.mark.slow
def test_a_plan_with_a_cone_is_validated_and_with_a_narrower_one_on_record_refuted(tmp_path):
    found = api.plan({"task": [ON_PATH, CONE]}, method="baseline")
    found.save(tmp_path / "plan")
    stands = validate_results(tmp_path / "plan")
    assert stands.validated
    point, axis = stands.methods["baseline"].rows
    assert (point.row, axis.row) == ("task.1: point tcp", "task.2: axis tcp.z")
    assert (axis.unit, axis.most) == ("degrees", CONE["cone_deg"])
    assert 0 < point.off <= point.most == 1.0 and 50 < axis.off <= axis.most
    record = found.record()
    record["config"]["task"][1]["cone_deg"] = 50.0
    write_json(tmp_path / "plan" / SUMMARY, record)
    narrower = validate_results(tmp_path / "plan", between=0)
    assert narrower.methods["baseline"].rows[1].off == axis.off > narrower.methods["baseline"].rows[1].most == 50
    refuted = narrower.refuted
    assert refuted and all(
        "task.2 (axis tcp.z) deviates by" in one.reason and "50 are allowed" in one.reason for one in refuted
    )


@pytest.mark.slow
def test_a_scenario_with_a_cone_is_the_same_alone_and_among_others_with_other_cones():
    sweep = load_sweep(
        {"grid": [{"task.2.cone_deg": [70, 45, 30]}]}, {"task": [ON_PATH, CONE], "settings": NO_SEGMENTS}
    )
    batch = sweep.batch()
    [(robot, part, settings, task, obstacles)] = batch.cells
    how = {"settings": settings, "task": task, "obstacles": obstacles, "check_paths": False}
    together = plan(Problem.of(robot, part, batch.scenarios, execution=Execution(threads=2), **how), "nspace-sqp")
    assert len(set(together.tracked.sum(axis=1).tolist())) > 1
    for k in range(3):
        one = jax.tree.map(lambda leaf, k=k: leaf[k : k + 1], batch.scenarios)
        alone = plan(Problem.of(robot, part, one, execution=Execution(threads=1), **how), "nspace-sqp")
        for name in ("x", "status", "clearance", "residual"):
            np.testing.assert_array_equal(getattr(alone, name)[0], getattr(together, name)[k], err_msg=name)
