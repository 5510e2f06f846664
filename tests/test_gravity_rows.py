"""Task rows about directions of the world where the part moves, next to angles from MuJoCo's own tree of the cell."""

import json

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import toy
from scipy.spatial.transform import Rotation
from test_moving_part import CELLS, PART

import htcp_jax
from htcp_jax.clearance.proof.row_proof import between, rows_hold
from htcp_jax.errors import InputError
from htcp_jax.io.robots import load_robot
from htcp_jax.jobs import build, load_config
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.model import PathFrames, Task, TaskRow, Workpiece
from htcp_jax.model.task_row_kind import PlacedPath
from htcp_jax.trajectory.displacement import arm_at, displacement_bound
from htcp_jax.trajectory.row_slack import slack_of_rows
from htcp_jax.validation import validate_results

UP = (0.3, -0.2, 2.0)  # in the world
NORMAL = np.array([[0.6, 0.0, 0.8], [0.0, 0.6, 0.8]])  # of the path, in the part's frame
QUATERNION = (0.9, 0.1, -0.3, 0.2)
ROWS = {
    "the seam's normal": TaskRow(axis="path.normal", towards=UP, cone_deg=100.0),
    "minus the normal, exactly": TaskRow(axis="-path.normal", towards=UP, frame="world"),
    "the tool's axis": TaskRow(axis="tcp.z", towards=UP, cone_deg=100.0),
    "the tool's axis, exactly": TaskRow(axis="-tcp.x", towards=UP),
    "an axis of the positioner": TaskRow(axis="tilt.y", towards=UP, cone_deg=100.0),
    "the tool's orientation": TaskRow(orientation=QUATERNION, within_deg=100.0),
}
CELL = CELLS["a rail below the arm, and a positioner"]


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    file = tmp_path_factory.mktemp("cell") / "cell.xml"
    file.write_text(CELL)
    return load_robot(file)


def part_of(row: TaskRow, robot) -> tuple[Task, jax.Array]:
    """The row's task with equal tolerances, so that angles are not scaled, and its goals at two points."""
    path, home = np.eye(2, 3), np.zeros(3)
    frames = PathFrames(NORMAL, NORMAL, None)
    part = Workpiece("path", path[:0], path, interior="none", pivot=home, neutral_translation=home, frames=frames)
    task = Task((row.part(robot),), 1e-3, 1e-3)
    return task, jnp.asarray(row.goals(task.parts[0], PlacedPath(np.eye(3), np.zeros(3), path, part)))


def by_mujoco(row: TaskRow, robot, x: np.ndarray, normal: np.ndarray = NORMAL[0]) -> np.ndarray:
    """The row's angle in MuJoCo's tree, in the world [rad]."""
    model = mujoco.MjModel.from_xml_string(CELL)
    data, order, found = mujoco.MjData(model), [model.joint(name).id for name in robot.joint_names], []
    for each in x:
        data.qpos[order] = each
        mujoco.mj_kinematics(model, data)
        frames = {"tcp": data.site("tcp").xmat, "tilt": data.body("tilt").xmat, "path": data.body("table").xmat}
        if row.axis is None:
            wanted = Rotation.from_quat(QUATERNION, scalar_first=True)
            found.append((wanted * Rotation.from_matrix(frames["tcp"].reshape(3, 3)).inv()).magnitude())
            continue
        name, _, letter = row.axis.lstrip("-").partition(".")
        own = normal if name == "path" else np.eye(3)["xyz".index(letter)]
        axis = frames[name].reshape(3, 3) @ own * (-1.0 if row.axis.startswith("-") else 1.0)
        found.append(np.arctan2(np.linalg.norm(np.cross(axis, UP)), axis @ UP))
    return np.array(found)


def configurations(robot, count: int) -> np.ndarray:
    return np.random.default_rng(3).uniform(robot.lower, robot.upper, (count, len(robot.slides)))


@pytest.mark.parametrize("name", ROWS)
def test_its_angle_is_that_of_mujocos_tree_and_its_jacobian_that_of_jacfwd(robot, name):
    row = ROWS[name]
    (task, goals), x = part_of(row, robot), configurations(robot, 100)

    def of(x):
        value = task.value(robot, x)
        return -task.error(value, goals[0]) if task.rows else task.slack(value, goals[0])[None]

    found = jax.jit(jax.vmap(of))(x)
    angle = np.linalg.norm(found, axis=1) if task.rows else np.deg2rad(row.limit_deg) - found[:, 0]
    np.testing.assert_allclose(angle, by_mujoco(row, robot, x), atol=1e-9)
    linear = jax.jit(jax.vmap(lambda x: task.linear_at(robot, x, goals[0])))(x)
    own = linear.jacobian if task.rows else linear.gradient
    np.testing.assert_allclose(own, jax.jit(jax.vmap(jax.jacfwd(of)))(x), atol=1e-9)
    assert np.abs(own).max() > 0.1


@pytest.mark.parametrize("name", [name for name in ROWS if "exactly" not in name])
def test_a_row_proven_on_a_joint_path_holds_at_a_hundred_places_and_a_displaced_path_keeps_it(robot, name):
    row = ROWS[name]
    task, goals = part_of(row, robot)
    a = configurations(robot, 40)
    b = a + np.random.default_rng(5).normal(scale=0.05, size=a.shape)
    middle = 0.5 * (a + b)
    # Cones that are as wide as the angle in the middle and a little, or a little less.
    given = np.tile(np.asarray(goals)[None, :1], (len(a), 2, 1))
    given[..., -1] = by_mujoco(row, robot, middle)[:, None] + np.linspace(-0.05, 0.15, len(a))[:, None]

    def on(goals, x, rates):
        return rows_hold(robot, task.parts, between(task, goals), x, rates, jnp.asarray(0.5))

    held, broken = (np.asarray(each)[:, 0] for each in jax.jit(jax.vmap(on))(given, middle, b - a))
    assert 5 < held.sum() < 35 and broken.sum() >= 3
    share = np.linspace(0, 1, 100)[:, None]
    for k in range(len(a)):
        most = given[k, 0, -1] + task.tolerance_rad
        angles = by_mujoco(row, robot, a[k] + share * (b[k] - a[k]))
        assert not held[k] or (angles <= most + 1e-9).all()
        assert not broken[k] or by_mujoco(row, robot, middle[k : k + 1])[0] > most

    left = slack_of_rows(task, robot, np.stack([a, b], axis=1).reshape(-1, a.shape[1]), given.repeat(2, axis=0)[:-1],
                         np.arange(2 * len(a) - 1) % 2 == 0)  # fmt: skip
    there, draws = arm_at(robot, a, left.features), np.random.default_rng(6).normal(size=a.shape)
    sizes, kept = np.geomspace(0.3, 1e-4, 30), 0
    nudges = sizes[:, None, None] * draws
    moved = there.moved(displacement_bound(there, np.broadcast_to(np.abs(b - a), nudges.shape), nudges)).features
    taken = left.only(np.arange(0, 2 * len(a), 2)).taken(moved)[..., 0]
    for k in range(len(a)):
        fits = (taken[:, k] <= left.left[2 * k, 0]) & (left.left[2 * k, 0] > 0)
        if fits.any():
            kept += 1
            angles = by_mujoco(row, robot, a[k] + share * (b[k] - a[k]) + nudges[fits.argmax(), k])
            assert (angles <= given[k, 0, -1] + task.tolerance_rad + 1e-9).all()
    assert kept >= 5


# A job: the toy arm above a table that tilts

TILT = """
<body name="stand" pos="0.5 0 0.15">
  <body name="table" pos="0 0 .1"><joint name="tilt" axis="0 1 0" range="-100 100"/>
    <geom name="plate" type="capsule" fromto="0 -.08 -.1 0 .08 -.1" size=".02"/></body></body>
"""
FLAT = {"axis": "path.normal", "towards": [0, 0, 1], "cone_deg": 12, "frame": "world"}


@pytest.fixture
def job(tmp_path):
    """Job of the toy arm: an arc of 100 degrees about a half pipe on a table that tilts."""
    light = '<compiler boundmass="1e-6" boundinertia="1e-6"/>'
    xml = toy.ARM.replace("<worldbody>", light + PART.format("table") + "<worldbody>")
    (tmp_path / "cell.xml").write_text(xml.replace("</worldbody>", TILT + "</worldbody>"))
    angle, along = np.meshgrid(np.linspace(-1.2, 1.2, 24), np.linspace(-0.05, 0.05, 5))
    pipe = np.stack([0.06 * np.sin(angle), along, 0.06 * np.cos(angle)], axis=-1).reshape(-1, 3)
    turn = np.deg2rad(np.linspace(-50, 50, 8))
    normal = np.stack([np.sin(turn), 0 * turn, np.cos(turn)], axis=1)
    np.savetxt(tmp_path / "pipe.xyz", pipe, delimiter=",")
    table = np.column_stack([0.09 * normal, normal])
    np.savetxt(tmp_path / "arc.csv", table, delimiter=",", header="x,y,z,nx,ny,nz", comments="")
    part = {"cloud": str(tmp_path / "pipe.xyz"), "path": str(tmp_path / "arc.csv"), "interior": "none"}
    return {
        "robot": {"model": str(tmp_path / "cell.xml")},
        "workpiece": part | {"tip_contact_m": None},
        "start_rad": "auto",
        "task": [{"point": "tcp", "on": "path"}, FLAT],
        "settings": {**vars(toy.SETTINGS), "q_weights": (1.0,) * 5},
    }


def seam_angles(plan) -> np.ndarray:
    """Angles between the seam's normal and the vertical, by the tilt of the table [degrees]."""
    on_path = plan.plans.x[0, -8:, 0]
    return np.linspace(-50, 50, 8) + np.rad2deg(on_path)


def test_a_seam_is_held_in_flat_position_and_validated_in_mujocos_tree(job, tmp_path):
    plan = htcp_jax.plan(job)
    assert plan.complete, plan.failure()
    assert (np.abs(seam_angles(plan)) <= 12 + 1e-6).all() and np.ptp(plan.plans.x[0, -8:, 0]) > np.deg2rad(70)
    plan.save(tmp_path / "plan")
    found = validate_results(tmp_path / "plan")
    assert found.validated, found.refuted[:3]
    summary = json.loads((tmp_path / "plan/summary.json").read_text())
    summary["config"]["task"][1]["cone_deg"] = 6.0
    (tmp_path / "plan/summary.json").write_text(json.dumps(summary))
    found = validate_results(tmp_path / "plan")
    assert not found.validated and "task.2 (axis path.normal)" in found.refuted[0].reason


def test_without_the_row_the_seam_is_not_held(job):
    plan = htcp_jax.plan(job | {"task": [{"point": "tcp", "on": "path"}]})
    assert plan.complete and np.abs(seam_angles(plan)).max() > 20


def test_the_tool_points_down_in_the_world_whatever_the_table_does(job, tmp_path):
    down = {"axis": "tcp.z", "towards": [0, 0, -1], "cone_deg": 20}
    plan = htcp_jax.plan(job | {"task": [{"point": "tcp", "on": "path"}, FLAT, down]})
    assert plan.complete, plan.failure()
    plan.save(tmp_path / "plan")
    found = validate_results(tmp_path / "plan")
    assert found.validated, found.refuted[:3]


STILL = "no joint changes this angle; it is 50 degrees at point 1 of the path, and at most 12 are allowed"
PLACE = "task.2: frame is world, but the part moves; valid for a position: workpiece"


@pytest.mark.parametrize(
    ("row", "axis", "message"),
    [
        (FLAT, None, f"task.2 (axis path.normal): {STILL}"),
        (FLAT, "0 0 1", f"task.2 (axis path.normal): {STILL}"),
        (FLAT | {"cone_deg": None}, "0 1 0", "it has 2 equations, but the joints rotate it in only 1 directions"),
        (FLAT | {"cone_deg": None}, None, "it has 2 equations, but the joints rotate it in only 0 directions"),
        (FLAT | {"frame": "table"}, "0 1 0", "frame is 'table'; valid: world, workpiece, path"),
        (
            FLAT | {"frame": "workpiece"},
            "0 1 0",
            "axis is path.normal, a direction of the part; set towards: [x, y, z] and",
        ),
        (
            FLAT | {"towards": "path.tangent"},
            "0 1 0",
            "axis is path.normal, a direction of the part; set towards: [x, y",
        ),
        (FLAT | {"axis": "path.side"}, "0 1 0", "axis is 'path.side'; it must be like tcp.z"),
        ({"point": "tcp", "on": [0, 0, 1], "within_m": 1}, "0 1 0", PLACE),
        ({"axis": "tcp.z", "looks_at_m": [0, 0, 1]}, "0 1 0", PLACE),
    ],
)
def test_a_row_that_no_joint_influences_or_that_is_no_row_is_refused_in_one_line(row, axis, message, job, tmp_path):
    """axis: of the table's joint; None: the part stands still in the world."""
    xml = (tmp_path / "cell.xml").read_text()
    if axis is None:
        (tmp_path / "cell.xml").write_text(toy.ARM)
        job["workpiece"]["neutral_translation_m"] = [0.5, 0, 0.25]
        job["settings"]["q_weights"], job["start_rad"] = (1.0,) * 4, [0.0, 0.3, 0.9, 0.4]
    else:
        xml = xml.replace('name="tilt" axis="0 1 0"', f'name="tilt" axis="{axis}"')
        (tmp_path / "cell.xml").write_text(xml)
    row = {key: value for key, value in row.items() if value is not None}
    with pytest.raises(InputError) as error:
        config = load_config(job | {"task": [{"point": "tcp", "on": "path"}, row]})
        build.scene(config)
    assert message in str(error.value) and "\n" not in str(error.value)


def test_a_part_that_stands_still_with_its_seam_within_the_cone_is_planned_as_without_the_row(job, tmp_path):
    (tmp_path / "cell.xml").write_text(toy.ARM)
    job["settings"]["q_weights"] = (1.0,) * 4
    job["workpiece"]["neutral_translation_m"] = [0.5, 0, 0.25]
    plan = htcp_jax.plan(job | {"task": [{"point": "tcp", "on": "path"}, FLAT | {"cone_deg": 55}]})
    assert plan.complete, plan.failure()


def test_a_sweep_keeps_scenarios_whose_angle_no_joint_changes(job, tmp_path):
    (tmp_path / "cell.xml").write_text(toy.ARM)
    job["workpiece"]["neutral_translation_m"] = [0.5, 0, 0.25]
    still = job | {"settings": job["settings"] | {"q_weights": (1.0,) * 4}, "start_rad": list(toy.START)}
    batch = load_sweep({"grid": [{"task.2.cone_deg": [12.0, 55.0]}]}, still).batch()
    np.testing.assert_allclose(batch.scenarios.goals[:, -1, -1], np.deg2rad([12, 55]))
