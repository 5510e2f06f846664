"""Tasks as written by a user: rows, their goals at every target, and the rejected ones."""

import jax.numpy as jnp
import made_once
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from htcp_jax.errors import InputError
from htcp_jax.io.parts.workpiece_source import load_workpiece
from htcp_jax.jobs import load_config
from htcp_jax.jobs.build import scene, task_of_job
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.model import PathFrames
from htcp_jax.model.goals import task_of
from htcp_jax.model.kinematics import tcp_pose
from htcp_jax.model.path_frames import tangents, wall_normals
from htcp_jax.model.task import TCP_POSITION
from htcp_jax.spec import TASK_ROWS, TCP_ON_PATH, AxisRow, OrientationRow, PointRow

ON_PATH = {"point": "tcp", "on": "path"}
UP = (0.0, 0.0, 2.0)
CONE = {"axis": "tcp.z", "towards": "-path.normal", "cone_deg": 60}


def made(*rows, **more):
    """The task and the scenario of a job with these rows."""
    job = load_config({"task": list(rows), **more})
    robot, _, scenario = scene(job)
    return task_of_job(job, robot), scenario


def test_a_job_without_a_task_has_the_papers_and_so_has_one_that_writes_it_out():
    for rows in ((), (ON_PATH,)):
        task, scenario = made(*rows)
        assert task == TCP_POSITION and scenario.task_goals is None and scenario.goals is scenario.targets


def test_the_rows_follow_from_the_list():
    robot = made_once.robot()
    for row, rows, bands in [
        (PointRow(point="tcp", on="path", axes="xz"), 2, 0),
        (PointRow(point="link3", on="plane", through_m=UP, normal=UP), 1, 0),
        (PointRow(point="tcp", on="line", through_m=UP, direction=UP), 2, 0),
        (PointRow(point="tcp", on="line", through_m=UP, direction=UP, within_m=0.1), 0, 4),
        (PointRow(point="tcp", on=(1.0, 0.0, 1.0)), 3, 0),
        (AxisRow(axis="tcp.z", towards="path.normal"), 2, 0),
        (AxisRow(axis="tcp.z", towards="path.normal", cone_deg=0.0), 2, 0),
        (AxisRow(axis="-link5.x", towards=UP, within_deg=10.0), 0, 1),
        (OrientationRow(orientation=(1.0, 0.0, 0.0, 0.0)), 3, 0),
        (OrientationRow(orientation="path", within_deg=3.0), 0, 1),
    ]:
        task = task_of([row], robot)
        assert (task.rows, task.bands) == (rows, bands), row


def test_a_point_held_in_all_directions_is_a_place_whatever_frame_they_are_of():
    for frame in ("workpiece", "path"):
        task, scenario = made({**ON_PATH, "frame": frame})
        assert task == TCP_POSITION and scenario.task_goals is None
    task, scenario = made({"point": "tcp", "on": [1.0, 0.0, 1.0]})
    assert task == TCP_POSITION and (scenario.task_goals[11:] == (1.0, 0.0, 1.0)).all()


def test_built_in_rows_are_found_by_name_like_those_of_other_packages():
    assert [TASK_ROWS.find(name) for name in ("point", "axis", "orientation")] == [PointRow, AxisRow, OrientationRow]
    for row in (ON_PATH, CONE, {"orientation": [1, 0, 0, 0]}):
        (kind,) = {"point", "axis", "orientation"} & row.keys()
        assert load_config({"task": [{"kind": kind, **row}]}).task == load_config({"task": [row]}).task


def test_a_record_of_a_row_has_the_keys_of_all_classes_and_is_read_back():
    job = load_config({"task": [ON_PATH, CONE, {"orientation": [1, 0, 0, 0]}]})
    record = job.model_dump(mode="json")["task"]
    assert {len(row) for row in record} == {21} and record[1]["axes"] == "xyz" and record[1]["point"] is None
    assert load_config({"task": record}).task == job.task


def test_without_a_job_rows_are_named_by_their_numbers():
    with pytest.raises(InputError, match=r"^row 2 \(point tcp\) repeats or contradicts an earlier row"):
        task_of([TCP_ON_PATH, PointRow("tcp", on=(1.0, 0.0, 1.0))], made_once.robot())


def test_before_the_path_rows_are_eased_so_that_the_start_is_on_its_target():
    for rows in ([ON_PATH, CONE], [ON_PATH, {**CONE, "cone_deg": 0}], [ON_PATH, {"orientation": [1, 0, 0, 0]}],
                 [{**ON_PATH, "axes": "yz", "frame": "workpiece"}], [{**ON_PATH, "frame": "path", "within_m": 0.01}],
                 [ON_PATH, {"axis": "tcp.x", "looks_at_m": [0, 0, 3]}]):  # fmt: skip
        task, scenario = made(*rows)
        robot, x = made_once.robot(), jnp.asarray(made_once.START)
        assert made_once.quick_jit(task.residual_at)(robot, x, jnp.asarray(scenario.task_goals[0])) < 1e-9
        np.testing.assert_allclose(scenario.task_goals[10], scenario.task_goals[11], atol=1e-9)  # of the first point
        assert scenario.task_goals.shape == (105, task.numbers)


def test_a_cone_is_data_so_scenarios_of_one_grid_share_their_programs():
    sweep = load_sweep(
        {"grid": [{"task.2.cone_deg": [90, 60, 30]}, {"workpiece.rotation_y_rad": [0.3, 0.4]}]},
        {"task": [ON_PATH, CONE]},
    )
    batch = sweep.batch()
    assert len(batch.cells) == 1 and batch.scenarios.task_goals.shape == (6, 105, 7)
    np.testing.assert_allclose(np.rad2deg(batch.scenarios.task_goals[:, -1, 6]), [90, 90, 60, 60, 30, 30])
    assert dict(batch.points[0].varied) == {"task.2.cone_deg": "90.0"}
    assert sweep.config.task[1].cone_deg == 60  # the configuration is unchanged


def test_a_row_is_addressed_by_its_number_on_the_command_line():
    given = {"task": [ON_PATH, CONE]}
    assert load_config(given, ["task.2.cone_deg=45"]).task[1].cone_deg == 45
    assert given["task"][1]["cone_deg"] == 60
    with pytest.raises(InputError, match=r"task.3.cone_deg: no row 3; the list has 2"):
        load_config(given, ["task.3.cone_deg=45"])
    with pytest.raises(InputError, match=r"task.3.cone_deg: the task has 2 rows"):
        load_sweep({"grid": [{"task.3.cone_deg": [5, 0]}]}, given).batch()


def test_scenarios_whose_tasks_have_other_kinds_of_rows_have_their_own_inputs_and_goals():
    """A row with cone_deg: 0 is no cone."""
    batch = load_sweep({"grid": [{"task.2.cone_deg": [5, 0]}]}, {"task": [ON_PATH, CONE]}).batch()
    assert [cell.task.rows for cell in batch.cells] == [3, 5] and batch.cell.tolist() == [0, 1]


TILTED = {"orientation": [1, 1, 0, 0], "within_deg": 20}
PLANE = {"point": "tcp", "on": "plane", "through_m": [0, 0, 0], "normal": [0, 0, 1]}


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([{"point": "flange", "on": "path"}], "task.1: no point 'flange' on gp50; valid: link1, .*, tcp, tool"),
        ([ON_PATH, {"axis": "elbow.z", "towards": [0, 0, 1]}], "task.2: no axis 'elbow' on gp50; valid: "),
        ([{"orientation": [1, 0, 0, 0], "of": "hand"}], "task.1: no frame 'hand' on gp50; valid: "),
        ([{**CONE, "cone_deg": -1}], "task.1: cone_deg is -1; it must be 0 to 180"),
        ([ON_PATH, {**CONE, "cone_deg": 181}], "task.2: cone_deg is 181; it must be 0 to 180"),
        ([{**CONE, "towards": [0, 0, 0]}], "task.1: towards is zero; it must have a direction"),
        ([{**CONE, "towards": "path.binormal"}], "towards is 'path.binormal'; valid: path.normal, -path.normal"),
        ([{**CONE, "within_deg": 4}], "cone_deg and within_deg mean the same"),
        ([{"axis": "tcp", "towards": [0, 0, 1]}], "axis is 'tcp'; it must be like tcp.z"),
        ([{"point": "tcp"}], "on is None; valid: path, plane, line, or x,y,z in metres"),
        ([{"point": "tcp", "on": "plane"}], "set through_m for a point on a plane"),
        ([{**ON_PATH, "axes": "zx"}], "axes is 'zx'; valid: some of x, y, z, in this order"),
        ([{**ON_PATH, "frame": "tool"}], "frame is 'tool'; valid: world, workpiece, path"),
        ([{**ON_PATH, "cone_deg": 3}], "cone_deg is not a key of a point row; valid: offset_m, on"),
        ([{**ON_PATH, "within_m": 0}], "within_m is 0; it must be more than 0"),
        ([{**ON_PATH, "to": 0}], "unknown key task.1.to"),
        ([{**ON_PATH, "axis": "tcp.z"}], "tool_axis; this row has point and axis"),
        ([{"orientation": [0, 0, 0, 0]}], "orientation is a quaternion of length 0"),
        ([{"orientation": "path"}], "the path has no orientations; add columns qw,qx,qy,qz to its file"),
        ([ON_PATH, {"point": "tcp", "on": [1, 0, 1]}], r"task.2 \(point tcp\) repeats or contradicts an earlier row"),
        ([ON_PATH, {"point": "link6", "on": [1, 0, 1]}], r"task.2 \(point link6\) repeats or contradicts"),
        ([{**CONE, "cone_deg": 0}, {"axis": "tcp.x", "towards": "path.tangent"}], r"task.2 \(axis tcp.x\) repeats"),
        ([CONE, {**CONE, "axis": "-tcp.z"}], r"task.1 \(axis tcp.z\) and task.2 \(axis -tcp.z\) contradict each other"),
        ([TILTED, {"axis": "tcp.z", "towards": [0, 0, -1], "cone_deg": 60}], "axes are 0 degrees apart"),
        ([TILTED, {"orientation": [1, 0, 0, 0], "within_deg": 60}], "frames are 0 degrees apart, .* 90"),
        ([ON_PATH, {**PLANE, "through_m": [0, 0, 9], "within_m": 0.1}], "contradict each other at point 1 of"),
        ([{**PLANE, "within_m": 0.1}, {**PLANE, "normal": [0, 0, -1], "through_m": [0, 0, 0.3], "within_m": 0.1}],
         r"contradict each other at point 1 of the path: required positions are 0.3 m apart, 0.202 m are allowed"),
        ([ON_PATH, {"orientation": [1, 0, 0, 0]}, {"point": "link4", "on": [1, 0, 1]}], "the task has 9 equations"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_named_before_planning(rows, message):
    with pytest.raises(InputError, match=message):
        made(*rows)


# The path's directions


def test_the_wall_normals_of_the_duct_are_those_of_its_sections_and_point_into_its_bore():
    duct = made_once.duct()
    found, path = wall_normals(duct.cloud, duct.path), duct.path
    inside = made_once.section_value(path[5:-8] + 0.02 * found[5:-8])  # the duct ends at the path's ends
    assert (inside < made_once.section_value(path[5:-8])).all() and (inside < 0).all()
    slope = np.stack(
        [made_once.section_value(path + d) - made_once.section_value(path - d) for d in 1e-5 * np.eye(3)], axis=1
    )
    across = -slope / np.linalg.norm(slope, axis=1, keepdims=True)
    assert np.degrees(np.arccos((across * found).sum(axis=1)[5:-8])).max() < 6


def test_tangents_are_those_of_the_curve_and_stay_where_a_point_stands_twice():
    t = np.linspace(0, 2, 200)
    helix = np.stack([np.cos(t), np.sin(t), 0.5 * t], axis=1)
    known = np.stack([-np.sin(t), np.cos(t), np.full(200, 0.5)], axis=1) / np.sqrt(1.25)
    np.testing.assert_allclose(tangents(helix)[1:-1], known[1:-1], atol=1e-4)
    twice = tangents(np.repeat(helix, 2, axis=0))
    np.testing.assert_allclose(twice[::2], twice[1::2])
    np.testing.assert_allclose(twice[::2], tangents(helix), atol=1e-12)
    with pytest.raises(InputError, match="the path has no tangent"):
        tangents(np.zeros((3, 3)))


def weld_file(tmp_path, names: str, columns: np.ndarray):
    file = tmp_path / "weld.csv"
    table = np.column_stack([made_once.duct().path, np.broadcast_to(columns, (94, np.shape(columns)[-1]))])
    np.savetxt(file, table, delimiter=",", header=f"x,y,z,{names}", comments="", fmt="%.17g")
    return file


def test_a_path_file_brings_its_normals_tangents_and_quaternions(tmp_path):
    turn = Rotation.from_rotvec([0.1, 0.4, -0.3])
    columns = np.concatenate([[0, 0.6, 0.8], [1, 0, 0], 2 * turn.as_quat(scalar_first=True)])
    part = load_workpiece(path=weld_file(tmp_path, "nx,ny,nz,tx,ty,tz,qw,qx,qy,qz", columns))
    np.testing.assert_array_equal(part.normals, np.tile([0, 0.6, 0.8], (94, 1)))
    np.testing.assert_array_equal(part.tangents, np.tile([1, 0, 0], (94, 1)))
    np.testing.assert_allclose(part.frames.rotations[7], turn.as_matrix(), atol=1e-15)
    task, scenario = made(
        {"orientation": "path"}, workpiece={"path": str(weld_file(tmp_path, "qw,qx,qy,qz", columns[6:]))}
    )
    wanted = np.asarray(scenario.T_world_workpiece)[:3, :3] @ turn.as_matrix()
    np.testing.assert_allclose(scenario.task_goals[50].reshape(3, 3), wanted, atol=1e-12)
    own = np.asarray(tcp_pose(made_once.robot(), jnp.asarray(made_once.START)))[:3, :3]
    np.testing.assert_allclose(scenario.task_goals[0].reshape(3, 3), own, atol=1e-12)
    assert task.rows == 3


@pytest.mark.parametrize(
    ("names", "columns", "message"),
    [
        ("nx,ny,nz", [0, 0, 0.9], "the normal at point 1 has the length 0.9; it must be 1"),
        ("nx,ny,nz", [0, 0, 0.0], "the normal at point 1 has the length 0; it must be 1"),
        ("tx,ty,tz", [2.0, 0, 0], "the tangent at point 1 has the length 2; it must be 1"),
        ("qw,qx,qy,qz", [0, 0, 0.0, 0], "the quaternion at point 1 has the length 0"),
        ("qw,qx,qy,qz", [np.nan, 0, 0.0, 0], "qw,qx,qy,qz of point 1 is 'nan,0,0,0'"),
    ],
)
def test_directions_that_are_none_are_refused(names, columns, message, tmp_path):
    with pytest.raises(InputError, match=message):
        load_workpiece(path=weld_file(tmp_path, names, np.array(columns)))


def test_as_many_directions_as_points_are_needed():
    duct = made_once.duct()
    with pytest.raises(InputError, match="normals of the path has 3 rows, but the path has 94 points"):
        load_workpiece(path=duct.path, frames=PathFrames(normals=np.tile([0.0, 0.0, 1.0], (3, 1))))
