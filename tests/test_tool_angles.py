"""Work angle, travel angle and spin of a tool: their signs, limits, gradients, and goals along a path."""

from itertools import product

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from htcp_jax.errors import InputError
from htcp_jax.io.parts.path_file import read_path_points
from htcp_jax.jobs import load_config
from htcp_jax.jobs.build import scene, task_of_job
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.model import PathFrames, Task, Workpiece, tool_angles_at
from htcp_jax.model.goals import task_of
from htcp_jax.model.kinematics import tcp_pose
from htcp_jax.model.rows_of_spec import PlacedPath, angles_of
from htcp_jax.motion import Plans
from htcp_jax.runs.written_run import tables
from htcp_jax.spec import TOOL_ANGLES, ToolAxisRow
from htcp_jax.status import Status
from htcp_jax.validation.records import data_of
from htcp_jax.validation.task_check import part_between
from htcp_jax.validation.tool_angle_check import path_axes
from htcp_jax.validation.tool_angle_check import tool_angles as validated_angles
from htcp_jax.viewer.angle_strip import draw_angles

POSES = 1000
ON_PATH = {"point": "tcp", "on": "path"}
EVERY = [
    ("value", "value", "range"),
    ("range", "value", "value"),
    ("value", "free", "free"),
    ("range", "range", "range"),
]


def defined_angles(tool: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """The angles of a tool [rad], by their definition; columns of the tool are x, y, z, of the frame t, n x t, n."""
    (t, b, n), (x, _, to_tip) = frame.T, tool.T
    h = -to_tip
    ahead = t - (t @ to_tip) * to_tip
    across = np.cross(to_tip, ahead)
    return np.array([np.arctan2(h @ b, h @ n), np.arctan2(-(h @ t), h @ n), np.arctan2(x @ across, x @ ahead)])


def leaning(work: float, travel: float, spin: float) -> np.ndarray:
    """The tool with these angles [rad] on a path along x whose normal is z."""
    tip = -np.array([-np.tan(travel), np.tan(work), 1.0])
    tip /= np.linalg.norm(tip)
    ahead = np.array([1.0, 0.0, 0.0]) - tip[0] * tip
    ahead /= np.linalg.norm(ahead)
    x = np.cos(spin) * ahead + np.sin(spin) * np.cross(tip, ahead)
    return np.stack([x, np.cross(tip, x), tip], axis=1)


def row_and_goals(limits, rng) -> tuple:
    """A row with these kinds of limits, tools, goals near their angles, and True where the angles are allowed."""
    spec = {"value": 0.0, "range": (-1.0, 1.0), "free": "free"}
    row = task_of([ToolAxisRow("tcp.z", *(spec[limit] for limit in limits))], made_once.robot()).parts[0]
    angles = rng.uniform((-1.2, -1.2, -3.0), (1.2, 1.2, 3.0), (POSES, 3))
    frames = Rotation.random(POSES, rng=rng).as_matrix()
    tools = frames @ np.array([leaning(*each) for each in angles])
    np.testing.assert_allclose([defined_angles(*pair) for pair in zip(tools, frames, strict=True)], angles, atol=1e-9)
    off = rng.uniform(-0.2, 0.2, (POSES, 3)) * (rng.random((POSES, 3)) < 0.5)
    half = np.array([0.1 if limit == "range" else 0.0 for limit in limits])
    bounds = (angles + off)[..., None] + np.stack([-half, half], axis=1)
    goals = np.column_stack([frames.reshape(-1, 9), bounds.reshape(-1, 6), np.zeros((POSES, row.numbers - 15))])
    limited = np.array([limit != "free" for limit in limits])
    return row, tools, goals, (np.abs(off) <= half + 1e-12)[:, limited].all(axis=1)


def values(row, tools: np.ndarray) -> jnp.ndarray:
    """The features' coordinates for tools whose frame is the TCP's."""
    return jnp.asarray(np.concatenate([tools @ np.array(feature.vector) for feature in row.features], axis=1))


@pytest.mark.parametrize("limits", EVERY)
def test_angles_and_limits_are_those_of_the_definition_at_a_thousand_poses(limits):
    row, tools, goals, good = row_and_goals(limits, np.random.default_rng(2))
    value, goals = values(row, tools), jnp.asarray(goals)
    error, slack = made_once.quick_jit(jax.vmap(lambda v, g: (row.error(v, g), row.slack(v, g))))(value, goals)
    found = (np.linalg.norm(error, axis=1) < 1e-9) & (np.asarray(slack) > -1e-9).all(axis=1)
    assert (found == good).all() and 0.05 < good.mean() < 0.95
    region = made_once.quick_jit(jax.vmap(lambda g: row.between(jnp.stack([g, g]), 0.0, 1e-9)))(goals)
    inside = np.einsum("nkcv,nv->nkc", region.vectors, value) + region.beyond
    assert ((inside > -1e-9).all(axis=2).any(axis=1) == good).all()


@pytest.mark.parametrize("limits", EVERY)
def test_gradients_are_those_of_differences(limits):
    row, tools, goals, _ = row_and_goals(limits, np.random.default_rng(3))
    value, goals, h = values(row, tools)[:50], jnp.asarray(goals[:50]), 1e-6
    both = made_once.quick_jit(jax.vmap(lambda v, g: jnp.concatenate([row.error(v, g), row.slack(v, g)])))
    slopes = made_once.quick_jit(jax.vmap(jax.jacfwd(lambda v, g: jnp.concatenate([row.error(v, g), row.slack(v, g)]))))
    exact = np.asarray(slopes(value, goals))
    for k in range(row.size):
        step = h * np.tile(np.eye(row.size)[k], (len(value), 1))
        np.testing.assert_allclose((both(value + step, goals) - both(value - step, goals)) / (2 * h), exact[:, :, k],
                                   atol=1e-7)  # fmt: skip


def made(row: dict, path=None):
    """The task and the goals on the path of a job with this row, on the duct's path or another one's file."""
    given = {"task": [ON_PATH, row]}
    if path is not None:
        given["workpiece"] = {"cloud": "none", "path": str(path)}
    job = load_config(given)
    robot, _, scenario = scene(job)
    task = task_of_job(job, robot)
    return task, scenario.task_goals[int(scenario.on_path) :, 3:]


def line(folder, name: str, *directions: str):
    """A path's file along y, each row with the same directions."""
    columns = {"n": "nx,ny,nz", "t": "tx,ty,tz", "p": "n1x,n1y,n1z,n2x,n2y,n2z"}
    names = ["x,y,z", *(columns[each[0]] for each in directions)]
    rows = [",".join([f"1.0,{0.01 * k},0.5", *(each[2:] for each in directions)]) for k in range(4)]
    file = folder / name
    file.write_text("\n".join([",".join(names), *rows]) + "\n")
    return file


def test_a_path_turned_about_its_normal_with_the_angles_exchanged_allows_the_same_tools(tmp_path):
    plain, turned = line(tmp_path, "a.csv", "n:0,0,1", "t:0,1,0"), line(tmp_path, "b.csv", "n:0,0,1", "t:-1,0,0")
    rows = ({"work_angle_deg": [10, 20], "travel_angle_deg": [-5, 12]},
            {"work_angle_deg": [-5, 12], "travel_angle_deg": [-20, -10]})  # fmt: skip
    found = []
    tools = values(task_of([ToolAxisRow("tcp.z", (10.0, 20.0))], made_once.robot()).parts[0],
                   Rotation.random(POSES, rng=np.random.default_rng(4)).as_matrix())  # fmt: skip
    for file, row in zip((plain, turned), rows, strict=True):
        task, goals = made({"tool_axis": "tcp.z", **row}, path=file)
        slack = made_once.quick_jit(jax.vmap(task.parts[1].slack, (0, None)))(tools, jnp.asarray(goals[0]))
        found.append(np.sort(slack, axis=1))
    np.testing.assert_allclose(*found, atol=1e-12)


def test_zero_from_the_bisector_is_45_degrees_from_a_plate_of_a_right_angle(tmp_path):
    file = line(tmp_path, "fillet.csv", "p:0,0,1,1,0,0", "t:0,1,0")
    np.testing.assert_allclose(read_path_points(file).frames.normals, np.tile([0.5**0.5, 0, 0.5**0.5], (4, 1)))
    _, middle = made({"tool_axis": "tcp.z", "work_angle_deg": [-1, 3]}, path=file)
    for plate, bounds in (("plate_1", [44, 48]), ("plate_2", [42, 46])):
        _, goals = made({"tool_axis": "tcp.z", "work_angle_deg": bounds, "work_angle_from": plate}, path=file)
        np.testing.assert_allclose(goals, middle, atol=1e-12)


def test_validation_measures_from_the_same_plate_as_the_goals_where_plates_are_not_perpendicular_to_the_path():
    """As in the corner of a square, where the tangent is half way between both sides."""
    rng = np.random.default_rng(5)
    frames = Rotation.random(20, rng=rng).as_matrix()
    local = np.stack([np.tile([0.0, 0.0, 1.0], (20, 1)), np.tile([0.6, 0.8, 0.0], (20, 1))], axis=1)
    plates = np.einsum("nij,npj->npi", frames, local)
    tools = Rotation.random(20, rng=rng).as_matrix()
    at = {"pivot": np.zeros(3), "neutral_translation": np.zeros(3)}
    normals, tangents = frames[:, :, 2], frames[:, :, 0]
    path = PathFrames(normals, tangents, None, plates)
    part = Workpiece(
        "path", made_once.duct().cloud[::1000], rng.normal(size=(20, 3)), interior="none", frames=path, **at
    )
    placed = PlacedPath(np.eye(3), np.zeros(3), part.path, part)
    for plate in ("plate_1", "plate_2"):
        row = ToolAxisRow("tcp.z", 45.0, work_angle_from=plate)
        angles, _ = validated_angles(row, tools, path_axes(row, frames, plates))
        h, x = -tools[:, :, 2], tools[:, :, 0]
        value = np.concatenate([h, x, np.cross(h, x)], axis=1)
        off = angles_of(row, value, placed) - angles
        np.testing.assert_allclose((off + np.pi) % (2 * np.pi) - np.pi, 0, atol=1e-9)


def test_a_plate_whose_normal_is_along_the_seam_is_refused(tmp_path):
    file = line(tmp_path, "along.csv", "p:0,0,1,0,1,0", "t:0,1,0")
    with pytest.raises(InputError, match=r"task.2 .*: the normal of plate 2 is 0 degrees from the seam at point 1"):
        made({"tool_axis": "tcp.z", "work_angle_deg": 45, "work_angle_from": "plate_1"}, path=file)


def test_a_direction_in_the_paths_frame_is_x_along_the_tangent_and_z_along_the_normal(tmp_path):
    file = line(tmp_path, "a.csv", "n:0,0,1", "t:0,1,0")
    _, goals = made({"axis": "tcp.z", "towards": [3, 0, -4], "frame": "path"}, path=file)
    np.testing.assert_allclose(goals[:, :3], np.tile([0, 0.6, -0.8], (4, 1)), atol=1e-12)


def test_goals_between_targets_turn_with_the_path():
    row = task_of([ToolAxisRow("tcp.z", 5.0, (0.0, 4.0))], made_once.robot()).parts[0]
    frames = Rotation.from_rotvec([[0, 0, 0], [0, 0, np.pi / 6]]).as_matrix().reshape(2, 9)
    goals = np.column_stack([frames, np.tile(np.arange(6.0), (2, 1)), np.zeros((2, row.numbers - 15))])[None]
    (half,) = row.interpolated(goals, np.array([0.5]))
    np.testing.assert_allclose(half[:9].reshape(3, 3), Rotation.from_rotvec([0, 0, np.pi / 12]).as_matrix())
    np.testing.assert_allclose(np.rad2deg(row.turn(goals)), [30.0])


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ({"work_angle_deg": [20, 10]}, "work_angle_deg is the empty range 20 to 10; the first angle must be less"),
        ({"travel_angle_deg": [5, 5]}, "travel_angle_deg is the empty range 5 to 5; write 5"),
        ({"spin_deg": [170, -170]}, r"for a range across 180 write \[170, 190\]"),
        ({"work_angle_deg": "push"}, r"'push' is no angle; valid: a number of degrees, a range such as \[42, 48\], or"),
        ({"work_angle_deg": [1, 2, 3]}, r"\[1, 2, 3\] is no angle; valid: a number of degrees"),
        ({"work_angle_deg": 90}, "work_angle_deg is 90; it must be between -90 and 90"),
        ({"travel_angle_deg": [-91, 0]}, "travel_angle_deg is -91 to 0; it must be -90 to 90, or free"),
        ({"spin_deg": [-100, 100]}, "spin_deg is a range of 200 degrees; at most 180 are possible, or free"),
        ({}, "all angles are free; set at least one of work_angle_deg, travel_angle_deg, spin_deg"),
        ({"work_angle_deg": 45, "work_angle_from": "plate"}, "valid: normal, plate_1, plate_2"),
        ({"travel_angle_deg": 5, "work_angle_from": "plate_1"}, "work_angle_from would have no effect"),
        ({"work_angle_deg": 45, "work_angle_from": "plate_1"}, "task.2 .*: the path has no plates; add columns n1x"),
        ({"tool_axis": "tcp", "work_angle_deg": 5}, "tool_axis is 'tcp'; it must be like tcp.z"),
        ({"work_angle_deg": 5, "cone_deg": 3}, "cone_deg is not a key of a tool_axis row; valid: work_angle_deg"),
    ],
)
def test_angles_that_cannot_be_are_refused_in_one_line(row, message):
    with pytest.raises(InputError, match=message) as refused:
        made({"tool_axis": "tcp.z", **row})
    assert "\n" not in str(refused.value)


def test_angles_on_a_path_without_normals_are_refused(tmp_path):
    with pytest.raises(InputError, match="normals"):
        made({"tool_axis": "tcp.z", "work_angle_deg": 5}, path=line(tmp_path, "bare.csv"))


def test_every_combination_of_angles_is_a_task_of_full_rank():
    spec = {"value": 3.0, "range": (1.0, 5.0), "free": "free"}
    for limits in product(spec, repeat=3):
        if set(limits) != {"free"}:
            task = task_of([ToolAxisRow("tcp.z", *(spec[limit] for limit in limits))], made_once.robot())
            assert isinstance(task, Task) and task.rows == limits.count("value")


def test_an_angle_is_data_so_scenarios_of_one_grid_share_their_programs():
    row = {"tool_axis": "tcp.z", "work_angle_deg": 5.0}
    batch = load_sweep({"grid": [{"task.2.work_angle_deg": [0, 10, 20]}]}, {"task": [ON_PATH, row]}).batch()
    assert len(batch.cells) == 1
    np.testing.assert_allclose(np.rad2deg(batch.scenarios.task_goals[:, -1, 12]), [0, 10, 20])


def test_a_plans_angles_are_those_of_the_definition_at_each_target_of_the_path(tmp_path):
    """Also the work angle from plate 2, which is 45 degrees minus that from the bisector."""
    file = line(tmp_path, "fillet.csv", "p:0,0,1,1,0,0", "t:0,1,0")
    job = load_config({"workpiece": {"cloud": "none", "path": str(file)}})
    robot, part, scenario = scene(job)
    x = made_once.configurations_near(made_once.START, len(scenario.targets), 0.3)
    found = {plate: tool_angles_at(scenario, ToolAxisRow("tcp.z", 45.0, work_angle_from=plate), robot, part, x)
             for plate in ("normal", "plate_2")}  # fmt: skip
    frame = np.array([[0, 1, 0], [-(0.5**0.5), 0, 0.5**0.5], [0.5**0.5, 0, 0.5**0.5]]).T
    tools = np.asarray(made_once.quick_jit(jax.vmap(tcp_pose, (None, 0)))(robot, jnp.asarray(x)))[-4:, :3, :3]
    np.testing.assert_allclose(
        np.deg2rad(found["normal"][-4:]), [defined_angles(tool, frame) for tool in tools], atol=1e-9
    )
    from_plate = 45 - found["normal"][-4:, 0]
    np.testing.assert_allclose(found["plate_2"][-4:, 0], (from_plate + 180) % 360 - 180)
    assert np.isnan(found["normal"][:-4]).all()


def test_a_sweeps_table_has_the_angles_at_each_target_of_each_scenarios_own_path(tmp_path):
    """Also from plates, with paths of two directions and lengths, and with a longer tool; empty off the path."""
    given = {"along.csv": ("t:0,1,0", 4), "across.csv": ("t:1,0,0", 3)}
    for name, (tangent, count) in given.items():
        file = line(tmp_path, name, "p:0,0,1,0.8,0,-0.6" if "along" in name else "p:0,0,1,0,1,0", tangent)
        file.write_text("".join(file.read_text().splitlines(keepends=True)[: 1 + count]))
    row = {"tool_axis": "tcp.z", "work_angle_deg": [40, 50], "work_angle_from": "plate_1"}
    grid = [{"workpiece.path": [str(tmp_path / name) for name in given]}, {"robot.tool_extension_m": [0.0, 0.02]}]
    batch = load_sweep({"grid": grid}, {"workpiece": {"cloud": "none"}, "task": [ON_PATH, row]}).batch()
    scenarios = batch.scenarios
    plans = Plans.empty(np.asarray(scenarios.x_start), np.asarray(scenarios.targets), np.asarray(scenarios.count))
    x = made_once.configurations_near(made_once.START, plans.exists.size, 0.3).reshape(*plans.exists.shape, -1)
    there = plans.exists & (np.arange(plans.exists.shape[1]) % 5 != 3)  # some targets are not tracked
    plans.x[there], plans.status[there] = x[there], Status.TRACKED
    rows = tables(batch, "beam", range(4), plans)["targets"]
    found = np.stack([rows[name].to_numpy() for name in TOOL_ANGLES], axis=1)
    s, t = rows["scenario"].to_numpy(), rows["target"].to_numpy()
    first = np.asarray(scenarios.on_path)[s]
    assert (np.isfinite(found).all(axis=1) == there[s, t] & (t >= first)).all() and there[s, t][t >= first].sum() == 10
    normals = {"along.csv": ((0, 0, 1), (0.8, 0, -0.6), (0, 1, 0)), "across.csv": ((0, 0, 1), (0, 1, 0), (1, 0, 0))}
    for k in np.flatnonzero(np.isfinite(found[:, 0])):
        one, two, tangent = np.array(normals["along.csv" if s[k] < 2 else "across.csv"], float)
        tool = np.asarray(tcp_pose(batch.robot, jnp.asarray(plans.x[s[k], t[k]])))[:3, :3]
        surface = two - (two @ one) * one  # along plate 1, away from plate 2
        from_plate = np.arctan2(-tool[:, 2] @ one, -tool[:, 2] @ surface / np.linalg.norm(surface))
        np.testing.assert_allclose((found[k, 0] - np.rad2deg(from_plate) + 180) % 360 - 180, 0, atol=1e-9)
        n = (one + two) / np.linalg.norm(one + two)
        travel_and_spin = defined_angles(tool, np.stack([tangent, np.cross(n, tangent), n], axis=1))[1:]
        np.testing.assert_allclose(np.deg2rad(found[k, 1:]), travel_and_spin, atol=1e-9)


def test_a_picture_shows_limited_angles_with_their_ranges():
    axes = Figure().add_subplot()
    rows = [
        (slice(0, 3), ToolAxisRow("tcp.z", (13.0, 17.0), 10.0)),
        (slice(3, 5), ToolAxisRow("tcp.z", (5.0, 6.0), 2.0)),
    ]
    draw_angles(axes, rows, np.full((5, 3), 14.0))
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["work angle", "travel angle"]
    boxes = [band.get_datalim(axes.transData).extents.tolist() for band in axes.collections]
    assert boxes == [[-0.5, 13.0, 2.5, 17.0], [2.5, 5.0, 4.5, 6.0]]


def test_between_points_validation_has_the_same_zero_of_a_plates_angle_as_inserted_goals(tmp_path):
    """In a corner, where the plates and the path turn by different angles."""
    rows = ["1.0,0.0,0.5,0,0,1,-1,0,0", "1.0,0.01,0.5,0,0,1,-1,0,0", "1.01,0.01,0.5,0,0,1,0,1,0"]
    (tmp_path / "corner.csv").write_text("\n".join(["x,y,z,n1x,n1y,n1z,n2x,n2y,n2z", *rows]) + "\n")
    row = {"tool_axis": "tcp.z", "work_angle_deg": [40, 50], "work_angle_from": "plate_1"}
    job = load_config({"task": [ON_PATH, row], "workpiece": {"cloud": "none", "path": str(tmp_path / "corner.csv")}})
    robot, part, scenario = scene(job)
    goals = scenario.task_goals[-2:, 3:][None]
    (half,) = task_of_job(job, robot).parts[1].interpolated(goals, np.array([0.3]))
    T = scenario.T_world_workpiece
    place = part_between(job.task, T[:3, :3], T[:3, 3], data_of(part), np.array([2]), np.array([0.3]))
    axes = place.axes(job.task[1])
    np.testing.assert_allclose(axes.frames[0], half[:9].reshape(3, 3), atol=1e-12)
    bounds = np.sort(axes.zero + axes.sense * np.deg2rad([40, 50]))
    np.testing.assert_allclose(bounds, half[9:11], atol=1e-12)
