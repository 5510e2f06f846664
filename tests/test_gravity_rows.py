"""Task rows about directions of the world where the part moves, next to angles from MuJoCo's own tree of the cell."""

import json
from functools import cache

import jax
import jax.numpy as jnp
import made_once
import mujoco
import numpy as np
import pytest
import toy
from scipy.spatial.transform import Rotation
from test_moving_part import CELLS, PART

import htcp_jax
from htcp_jax.clearance.proof.row_proof import between, row_slacks
from htcp_jax.errors import InputError
from htcp_jax.io.robots import load_robot
from htcp_jax.jobs import build, load_config
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.model import PathFrames, Task, Workpiece
from htcp_jax.model.rows_of_spec import PlacedPath, goals_of, row_of
from htcp_jax.spec import AxisRow, OrientationRow
from htcp_jax.trajectory.displacement import arm_at, displacement_bound
from htcp_jax.trajectory.row_slack import slack_of_rows
from htcp_jax.validation import validate_results

UP = (0.3, -0.2, 2.0)  # in the world
NORMAL = np.array([[0.6, 0.0, 0.8], [0.0, 0.6, 0.8]])  # of the path, in the part's frame
QUATERNION = (0.9, 0.1, -0.3, 0.2)
ROWS = {
    "the seam's normal": AxisRow(axis="path.normal", towards=UP, cone_deg=100.0),
    "minus the normal, exactly": AxisRow(axis="-path.normal", towards=UP, frame="world"),
    "the tool's axis": AxisRow(axis="tcp.z", towards=UP, cone_deg=100.0),
    "the tool's axis, exactly": AxisRow(axis="-tcp.x", towards=UP),
    "an axis of the positioner": AxisRow(axis="tilt.y", towards=UP, cone_deg=100.0),
    "the tool's orientation": OrientationRow(orientation=QUATERNION, within_deg=100.0),
}
CELL = CELLS["a rail below the arm, and a positioner"]


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    file = tmp_path_factory.mktemp("cell") / "cell.xml"
    file.write_text(CELL)
    return load_robot(file)


def part_of(row: AxisRow | OrientationRow, robot) -> tuple[Task, jax.Array]:
    """The row's task with equal tolerances, so that angles are not scaled, and its goals at two points."""
    path, home = np.eye(2, 3), np.zeros(3)
    frames = PathFrames(NORMAL, NORMAL, None)
    part = Workpiece("path", path[:0], path, interior="none", pivot=home, neutral_translation=home, frames=frames)
    task = Task((row_of(row, robot),), 1e-3, 1e-3)
    return task, jnp.asarray(goals_of(row, task.parts[0], PlacedPath(np.eye(3), np.zeros(3), path, part)))


@cache
def tree() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(CELL)


def by_mujoco(row: AxisRow | OrientationRow, robot, x: np.ndarray, normal: np.ndarray = NORMAL[0]) -> np.ndarray:
    """The row's angle in MuJoCo's tree, in the world [rad]."""
    model = tree()
    data, order, found = mujoco.MjData(model), [model.joint(name).id for name in robot.joint_names], []
    for each in x:
        data.qpos[order] = each
        mujoco.mj_kinematics(model, data)
        frames = {"tcp": data.site("tcp").xmat, "tilt": data.body("tilt").xmat, "path": data.body("table").xmat}
        if isinstance(row, OrientationRow):
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


@pytest.fixture(scope="module")
def computed(robot):
    """Configurations, and at each every row's error or slack, its own Jacobian and that of jacfwd, by one program."""
    known = {name: part_of(row, robot) for name, row in ROWS.items()}

    def value_of(name, x):
        task, goals = known[name]
        value = task.value(robot, x)
        return -task.error(value, goals[0]) if task.rows else task.slack(value, goals[0])[None]

    def jacobian_of(name, x):
        task, goals = known[name]
        linear = task.linear_at(robot, x, goals[0])
        return linear.jacobian if task.rows else linear.gradient

    @made_once.quick_jit
    @jax.vmap
    def at(x):
        values, own = (lambda x, of=of: {name: of(name, x) for name in ROWS} for of in (value_of, jacobian_of))
        return values(x), own(x), jax.jacfwd(values)(x)

    x = configurations(robot, 100)
    return x, *jax.tree.map(np.asarray, at(x))


@pytest.mark.parametrize("name", ROWS)
def test_its_angle_is_that_of_mujocos_tree_and_its_jacobian_that_of_jacfwd(robot, computed, name):
    row = ROWS[name]
    x, values, own, forward = computed
    task, _ = part_of(row, robot)
    angle = np.linalg.norm(values[name], axis=1) if task.rows else np.deg2rad(row.limit) - values[name][:, 0]
    np.testing.assert_allclose(angle, by_mujoco(row, robot, x), atol=1e-9)
    np.testing.assert_allclose(own[name], forward[name], atol=1e-9)
    assert np.abs(own[name]).max() > 0.1


CONES = [name for name in ROWS if "exactly" not in name]


@pytest.fixture(scope="module")
def proven(robot):
    """Ends of joint paths, a task of all cones, their widths (paths, rows), and the rows proven, broken and left."""
    parts, goals = zip(*(part_of(ROWS[name], robot) for name in CONES), strict=True)
    task = Task(tuple(part for own in parts for part in own.parts), 1e-3, 1e-3)
    a = configurations(robot, 40)
    b = a + np.random.default_rng(5).normal(scale=0.05, size=a.shape)
    middle = 0.5 * (a + b)
    # Cones that are as wide as the angle in the middle and a little, or a little less.
    middles = np.stack([by_mujoco(ROWS[name], robot, middle) for name in CONES], axis=1)
    widths = middles + np.linspace(-0.05, 0.15, len(a))[:, None]
    given = np.tile(np.concatenate([np.asarray(own)[0] for own in goals]), (len(a), 2, 1))
    given[..., np.cumsum([part.numbers for part in task.parts]) - 1] = widths[:, None]

    def on(goals, x, rates):
        found = row_slacks(robot, task.parts, between(task, goals), x, rates, jnp.asarray(0.5))
        return found.left >= 0, found.broken

    held, broken = map(np.asarray, made_once.quick_jit(jax.vmap(on))(given, middle, b - a))
    left = slack_of_rows(task, robot, np.stack([a, b], axis=1).reshape(-1, a.shape[1]), given.repeat(2, axis=0)[:-1],
                         np.arange(2 * len(a) - 1) % 2 == 0)  # fmt: skip
    there, draws = arm_at(robot, a, left.features), np.random.default_rng(6).normal(size=a.shape)
    nudges = np.geomspace(0.3, 1e-4, 30)[:, None, None] * draws
    moved = there.moved(displacement_bound(there, np.broadcast_to(np.abs(b - a), nudges.shape), nudges)).features
    left = left.only(np.arange(0, 2 * len(a), 2))
    return a, b, widths + task.tolerance_rad, held, broken, nudges, left.left, left.taken(moved)


@pytest.mark.parametrize("name", CONES)
def test_a_row_proven_on_a_joint_path_holds_at_a_hundred_places_and_a_displaced_path_keeps_it(robot, proven, name):
    row, own = ROWS[name], CONES.index(name)
    a, b, *each, nudges, left, taken = proven
    most, held, broken, left, taken = (values[..., own] for values in (*each, left, taken))
    assert 5 < held.sum() < 35 and broken.sum() >= 3
    share, kept = np.linspace(0, 1, 100)[:, None], 0
    for k in range(len(a)):
        path = a[k] + share * (b[k] - a[k])
        angles = by_mujoco(row, robot, np.vstack([path, 0.5 * (a[k] + b[k])]))
        assert not held[k] or (angles[:-1] <= most[k] + 1e-9).all()
        assert not broken[k] or angles[-1] > most[k]
        fits = (taken[:, k] <= left[k]) & (left[k] > 0)
        if fits.any():
            kept += 1
            assert (by_mujoco(row, robot, path + nudges[fits.argmax(), k]) <= most[k] + 1e-9).all()
    assert kept >= 5


# A job: the toy arm above a table that tilts

TILT = """
<body name="stand" pos="0.5 0 0.15">
  <body name="table" pos="0 0 .1"><joint name="tilt" axis="0 1 0" range="-100 100"/>
    <geom name="plate" type="capsule" fromto="0 -.08 -.1 0 .08 -.1" size=".02"/></body></body>
"""
ON_PATH = {"point": "tcp", "on": "path"}
FLAT = {"axis": "path.normal", "towards": [0, 0, 1], "cone_deg": 12, "frame": "world"}


TOOL_DOWN = {"axis": "tcp.z", "towards": [0, 0, -1], "cone_deg": 20}


def job_in(folder, axis: str = "0 1 0") -> dict:
    """Job of the toy arm: an arc of 100 degrees about a half pipe on a table that tilts, or turns about another axis.

    All plans have the same kinds of rows, so that they share their programs.
    """
    light = '<compiler boundmass="1e-6" boundinertia="1e-6"/>'
    xml = toy.ARM.replace("<worldbody>", light + PART.format("table") + "<worldbody>")
    xml = xml.replace("</worldbody>", TILT + "</worldbody>").replace(
        'name="tilt" axis="0 1 0"', f'name="tilt" axis="{axis}"'
    )
    (folder / "cell.xml").write_text(xml)
    angle, along = np.meshgrid(np.linspace(-1.2, 1.2, 24), np.linspace(-0.05, 0.05, 5))
    pipe = np.stack([0.06 * np.sin(angle), along, 0.06 * np.cos(angle)], axis=-1).reshape(-1, 3)
    turn = np.deg2rad(np.linspace(-50, 50, 8))
    normal = np.stack([np.sin(turn), 0 * turn, np.cos(turn)], axis=1)
    np.savetxt(folder / "pipe.xyz", pipe, delimiter=",")
    table = np.column_stack([0.09 * normal, normal])
    np.savetxt(folder / "arc.csv", table, delimiter=",", header="x,y,z,nx,ny,nz", comments="")
    part = {"cloud": str(folder / "pipe.xyz"), "path": str(folder / "arc.csv"), "interior": "none"}
    return {
        "robot": {"model": str(folder / "cell.xml")},
        "workpiece": part | {"tip_contact_m": None},
        "start_rad": "auto",
        "task": [ON_PATH, FLAT, TOOL_DOWN],
        "settings": {**vars(toy.SETTINGS), "q_weights": (1.0,) * 5},
    }


@pytest.fixture
def job(tmp_path):
    return job_in(tmp_path)


def seam_angles(plan) -> np.ndarray:
    """Angles between the seam's normal and the vertical, by the tilt of the table [degrees]."""
    on_path = plan.plans.x[0, -8:, 0]
    return np.linspace(-50, 50, 8) + np.rad2deg(on_path)


def test_a_seam_in_flat_position_and_a_tool_that_points_down_are_held_and_validated_in_mujocos_tree(job, tmp_path):
    plan = htcp_jax.plan(job)
    assert plan.complete, plan.failure()
    assert (np.abs(seam_angles(plan)) <= 12 + 1e-6).all() and np.ptp(plan.plans.x[0, -8:, 0]) > np.deg2rad(70)
    model = mujoco.MjModel.from_xml_path(job["robot"]["model"])
    data, order = mujoco.MjData(model), [model.joint(name).id for name in plan.robot.joint_names]
    for data.qpos[order] in plan.plans.x[0, -8:]:
        mujoco.mj_kinematics(model, data)
        assert data.site("tcp").xmat[8] <= -np.cos(np.deg2rad(20)) + 1e-9
    plan.save(tmp_path / "plan")
    found = validate_results(tmp_path / "plan")
    assert found.validated, found.refuted[:3]
    summary = json.loads((tmp_path / "plan/summary.json").read_text())
    summary["config"]["task"][1]["cone_deg"] = 6.0
    (tmp_path / "plan/summary.json").write_text(json.dumps(summary))
    found = validate_results(tmp_path / "plan")
    assert not found.validated and "task.2 (axis path.normal)" in found.refuted[0].reason


def test_within_a_cone_of_180_degrees_the_seam_is_not_held(job):
    plan = htcp_jax.plan(job, {"task.2.cone_deg": 180})
    assert plan.complete and np.abs(seam_angles(plan)).max() > 20


def test_a_seam_within_its_cone_whose_angle_no_joint_changes_is_planned(tmp_path):
    plan = htcp_jax.plan(job_in(tmp_path, axis="0 0 1"), {"task.2.cone_deg": 55, "task.3.cone_deg": 90})
    assert plan.complete, plan.failure()


def standing(folder) -> dict:
    """The same job with the toy arm alone, in front of a part that stands still."""
    job = job_in(folder)
    (folder / "cell.xml").write_text(toy.ARM)
    job["workpiece"]["neutral_translation_m"] = [0.5, 0, 0.25]
    job["settings"]["q_weights"], job["start_rad"] = (1.0,) * 4, list(toy.START)
    return job | {"task": [ON_PATH, FLAT]}


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
def test_a_row_that_no_joint_influences_or_that_is_no_row_is_refused_in_one_line(row, axis, message, tmp_path):
    """axis: of the table's joint; None: the part stands still in the world."""
    job = standing(tmp_path) if axis is None else job_in(tmp_path, axis)
    row = {key: value for key, value in row.items() if value is not None}
    with pytest.raises(InputError) as error:
        config = load_config(job | {"task": [ON_PATH, row]})
        build.scene(config)
    assert message in str(error.value) and "\n" not in str(error.value)


def test_a_part_that_stands_still_with_its_seam_within_the_cone_is_accepted(tmp_path):
    *_, scenario = build.scene(load_config(standing(tmp_path) | {"task": [ON_PATH, FLAT | {"cone_deg": 55}]}))
    np.testing.assert_allclose(scenario.goals[-1, -1], np.deg2rad(55))


def test_a_sweep_keeps_scenarios_whose_angle_no_joint_changes(tmp_path):
    batch = load_sweep({"grid": [{"task.2.cone_deg": [12.0, 55.0]}]}, standing(tmp_path)).batch()
    np.testing.assert_allclose(batch.scenarios.goals[:, -1, -1], np.deg2rad([12, 55]))
