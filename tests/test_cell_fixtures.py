"""Carriers of a cell's fixtures: boxes and meshes on moving links, and links that a fixture is not tested against."""

import json
from functools import partial

import fcl
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import toy
import trimesh
from made_once import prove, quick_jit

import htcp_jax
from htcp_jax.clearance import Scene, minimum_clearance
from htcp_jax.clearance.obstacles.fixtures import Fixtures
from htcp_jax.clearance.obstacles.self_collision import make_self_collision
from htcp_jax.clearance.proof.bisection import PathVerdict
from htcp_jax.errors import InputError, Note
from htcp_jax.jobs import build, load_config
from htcp_jax.model.kinematics import capsule_segments, tip_segment
from htcp_jax.runs.identity import config_hash, identity
from htcp_jax.spec.config import CellConfig, RobotConfig
from htcp_jax.validation import validate_results
from htcp_jax.validation.carried import CarriedBody
from htcp_jax.validation.mujoco_arm import MujocoArm
from htcp_jax.validation.mujoco_cell import MujocoCell

ARM = toy.ARM
for name, start in (
    ("turret", '<body pos="0 0 0.3">'),
    ("shoulder", "<body><joint"),
    ("elbow", '<body pos="0 0 0.4"><joint name="j3"'),
    ("hand", '<body pos="0 0 0.4"><joint name="j4"'),
):
    ARM = ARM.replace(start, start.replace("<body", f'<body name="{name}"'))
ARM = ARM.replace("<worldbody>", '<worldbody><body name="plinth"><geom name="foot" type="sphere" size="0.1"/></body>')
CAMERA = '<geom name="camera" type="box" size="0.05 0.03 0.02" pos="0.07 0.01 0.2" euler="10 20 30"/>'
POST = '<geom name="post" type="cylinder" size="0.12 0.2" pos="0.3 0.2 0.5"/>'


@pytest.fixture
def arm(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    return RobotConfig(model=str(tmp_path / "arm.xml"), limits="model")


@pytest.fixture
def cell(tmp_path):
    """Cell with a post and a camera; rules for the fixtures are the arguments."""

    def of(*rules, shapes: str = POST + CAMERA, **more) -> CellConfig:
        (tmp_path / "cell.xml").write_text(f"<mujoco><worldbody>{shapes}</worldbody></mujoco>")
        return CellConfig(model=str(tmp_path / "cell.xml"), fixtures=rules, **more)

    return of


def random_configurations(robot, count: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(robot.lower, robot.upper, (count, 4))


def test_the_clearance_of_a_box_on_a_link_is_a_close_lower_bound_on_mujocos(arm, cell):
    """Compare 200 random configurations with a box that MuJoCo moves itself; capsules stand out of it by 21 mm."""
    surroundings = cell({"name": "camera", "parent": "elbow"})
    robot = build.robot_of(arm, surroundings)
    (posts,) = build.obstacles_of(surroundings, robot)
    assert posts.names == ("post", "", "", "") and {robot.capsule_link[k] for k in robot.attached} == {2}
    light = '<compiler boundmass="1e-6" boundinertia="1e-6"/><worldbody>'
    text = ARM.replace('<geom name="forearm"', CAMERA + '<geom name="forearm"').replace("<worldbody>", light + POST)
    data = mujoco.MjData(model := mujoco.MjModel.from_xml_string(text))
    x, pair, exact = random_configurations(robot, 200), [model.geom(name).id for name in ("camera", "post")], []
    for data.qpos[:] in x:
        mujoco.mj_kinematics(model, data)
        exact.append(mujoco.mj_geomDistance(model, data, *pair, 10, None))
    distances = quick_jit(jax.vmap(lambda x: Fixtures.distances(posts, robot, *capsule_segments(robot, x))))
    over = np.array(exact) - np.asarray(distances(x))[:, 0, list(robot.attached)].min(axis=1)
    assert min(exact) < 0 and over.min() > -1e-6 and over[np.array(exact) > 0].max() < 0.022


def test_a_fixture_is_not_tested_against_links_that_it_excludes(arm, cell):
    robot = build.robot_of(arm)
    (found,) = build.obstacles_of(cell({"name": "post", "exclude": ["hand", "plinth"]}), robot)
    is_checked = dict(zip(found.names, np.asarray(found.is_checked).tolist(), strict=True))
    assert not any(is_checked.pop(""))
    assert robot.capsule_names == ("foot", "forearm", "tool")
    assert is_checked == {"post": [False, True, False], "camera": [False, True, True]}


def test_a_mesh_that_is_not_convex_is_not_tested_against_links_that_it_excludes(arm, cell, tmp_path):
    trimesh.creation.annulus(0.2, 0.3, 0.1).export(tmp_path / "ring.stl")
    rules = {"name": "ring", "exclude": ["hand"]}
    clouds = [{"cloud": str(tmp_path / "ring.stl")}]
    surroundings = CellConfig(clouds=clouds, fixtures=[rules])
    robot = build.robot_of(arm)
    (ring,) = build.obstacles_of(surroundings, robot)
    (checked,) = build.obstacles_of(CellConfig(clouds=clouds), robot)
    x, where = jnp.array([0.0, 1.6, 0.8, 0.0]), toy.scenario()
    of = quick_jit(partial(htcp_jax.clearances, robot))
    by_body = [np.asarray(of((each,), where, x)) for each in (ring, checked)]
    assert (by_body[0][:2] == by_body[1][:2]).all() and by_body[0][2] > 1e3 > by_body[1][2]


def test_a_fixture_without_a_name_has_the_same_one_for_planner_and_validation(arm, tmp_path):
    """A visual geom, a box and a mesh nearly in one plane, which MuJoCo numbers in another order with the arm."""
    corners = trimesh.transformations.random_rotation_matrix(np.full(3, 0.3))[:3, 0:2] @ [[0, 0.1, 0], [0, 0, 0.1]]
    np.savetxt(tmp_path / "part.obj", [*corners.T, corners.mean(axis=1) + 1e-9], fmt="v %.12f %.12f %.12f")
    (tmp_path / "part.obj").write_text((tmp_path / "part.obj").read_text() + "f 1 2 4\nf 2 3 4\nf 3 1 4\n")
    box, mesh = '<geom type="box" size="0.1 0.1 0.1" pos="0 0 2"/>', '<geom type="mesh" mesh="part"/>'
    visual = box.replace("/>", ' contype="0" conaffinity="0"/>')
    text = f'<asset><mesh name="part" file="part.obj"/></asset><worldbody>{visual}<body>{mesh}{box}</body></worldbody>'
    (tmp_path / "cell.xml").write_text(f"<mujoco>{text}</mujoco>")
    own = MujocoArm(tmp_path / "arm.xml")
    for name, count in (("box 2", 8), ("mesh 1", 32)):
        cell = CellConfig(model=str(tmp_path / "cell.xml"), fixtures=[{"name": name, "parent": "elbow"}])
        with pytest.warns(Note, match="mesh 'part' is flat"):
            assert build.robot_of(arm, cell).attached
            (body,) = MujocoCell(cell, own, own).carried
        assert body.parent == "elbow" and len(body.corners) == count


def test_a_box_on_a_link_is_tested_against_other_links_except_those_that_it_excludes(arm, cell):
    def pairs(*excluded) -> set[tuple[str, str]]:
        robot = build.robot_of(arm, cell({"name": "camera", "parent": "elbow", "exclude": excluded}))
        return {tuple(robot.capsule_names[k] for k in pair) for pair in make_self_collision(robot).pairs}

    own = {("tool", "camera_1"), ("tool", "camera_2"), ("camera_1", "foot"), ("camera_2", "foot")}
    assert own <= pairs() and not own & pairs("hand", "plinth")
    assert not any({"forearm", "camera_1"} == set(pair) for pair in pairs())


def test_validation_measures_boxes_and_meshes_on_links_exactly_in_every_place_of_a_cell(arm, cell, tmp_path):
    """A mesh on the forearm and a box on the hand, between a post, a ring of triangles, a cloud, and the arm itself.

    The planner's clearance is the lower one, by at most what its capsules stand out and its points on the ring cover.
    """
    trimesh.creation.box((0.1, 0.06, 0.04)).export(tmp_path / "scanner.stl")
    # A wide ring, as a mesh is cut into grains whose number hardly depends on its area.
    trimesh.creation.annulus(0.6, 1.4, 0.1, sections=8).export(tmp_path / "ring.stl")
    np.savetxt(tmp_path / "dust.xyz", np.random.default_rng(1).uniform(-0.8, 0.8, (40, 3)), delimiter=",")
    places = {"scanner.stl": [0.08, 0.0, 0.1], "ring.stl": [0.0, 0.0, 0.2], "dust.xyz": [0.0, 0.0, 0.6]}
    clouds = [{"cloud": str(tmp_path / name), "base_m": place} for name, place in places.items()]
    surroundings = cell(
        *({"name": name, "parent": parent} for name, parent in (("scanner", "elbow"), ("camera", "hand"))),
        *({"name": name, "exclude": ["hand"]} for name in ("ring", "post")),
        clouds=clouds,
        self_collision=True,
    )
    robot = build.robot_of(arm, surroundings)
    obstacles = build.obstacles_of(surroundings, robot)
    x = random_configurations(robot, 30)
    bound = np.asarray(quick_jit(jax.vmap(partial(minimum_clearance, robot, obstacles, toy.scenario())))(x))
    own = MujocoArm(tmp_path / "arm.xml")
    measured = MujocoCell(surroundings, own, own).distances(x, own.arm_poses(x)).min(axis=1)
    clear = measured > 0
    assert 5 < clear.sum() < 28 and (bound[clear] <= measured[clear] + 1e-6).all()
    assert (bound[clear] >= measured[clear] - 0.03).all() and (bound[~clear] < 0).all()


@pytest.fixture
def job(arm, cell, tmp_path):
    """Job of the toy arm below its shelf, with a camera on its forearm."""
    for name, points in (("shelf.xyz", toy.workpiece().cloud), ("path.csv", toy.workpiece().path[:6])):
        np.savetxt(tmp_path / name, points, delimiter=",")
    surroundings = cell({"name": "camera", "parent": "elbow"}, shapes=CAMERA, self_collision=True)
    part = {"cloud": str(tmp_path / "shelf.xyz"), "path": str(tmp_path / "path.csv"), "interior": "none"}
    part |= {"approach_to_inlet": 2, "approach_to_path": 2, "tip_contact_m": None}
    more = {"start_rad": toy.START, "settings": toy.SETTINGS}
    return {"robot": arm.model_dump(), "workpiece": part, "cell": surroundings.model_dump(), **more}


@pytest.mark.slow
def test_a_plan_with_a_box_on_a_link_is_confirmed_by_mujoco_and_refuted_with_the_box_on_another(job, tmp_path):
    plan = htcp_jax.plan(job)
    assert plan.complete, plan.failure()
    plan.save(tmp_path / "plan")
    found = validate_results(tmp_path / "plan")
    assert found.validated
    summary = json.loads((tmp_path / "plan/summary.json").read_text())
    summary["config"]["cell"]["fixtures"][0]["parent"] = "hand"
    (tmp_path / "plan/summary.json").write_text(json.dumps(summary))
    found = validate_results(tmp_path / "plan")
    assert not found.validated and "mm was saved" in found.refuted[0].reason


def test_a_box_is_as_far_from_triangles_and_points_as_fcl_finds():
    size, draw = np.array([0.2, 0.1, 0.05]), np.random.default_rng(0)
    corners = size * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    body = CarriedBody(0, "world", 0, frozenset(), np.eye(3), np.zeros(3), corners, None)
    box, passed = fcl.CollisionObject(fcl.Box(*(2 * size))), 0
    for triangle in draw.uniform(-0.4, 0.4, (200, 1, 3, 3)):
        wall = fcl.BVHModel()
        wall.beginModel(1, 3)
        wall.addSubModel(triangle[0], np.array([[0, 1, 2]]))
        wall.endModel()
        exact = max(0.0, fcl.distance(box, fcl.CollisionObject(wall)))
        found = body.clearance(triangle)
        assert abs(max(found, 0.0) - exact) < 1e-6
        passed += found <= 0
        beyond = np.abs(triangle[0]) - size
        exact = np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0)
        assert abs(body.clearance(triangle[0][:, None]) - exact.min()) < 1e-9
    assert 50 < passed < 150


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        ({"name": "vice"}, "cell.fixtures.0: no fixture 'vice'; valid: camera, post"),
        (
            {"name": "camera", "parent": "wrist"},
            "cell.fixtures.0: no link 'wrist' on toy; valid: elbow, hand, plinth, ",
        ),
        (
            {"name": "post", "exclude": ["wrist"]},
            "cell.fixtures.0: no link 'wrist' on toy; valid: elbow, hand, plinth, ",
        ),
        (
            {"name": "post", "parent": "elbow"},
            "fixture 'post' is a cylinder; only a box or a mesh can move with a link",
        ),
    ],
)
def test_a_wrong_name_in_a_fixture_is_named_with_the_valid_ones(rule, message, arm, cell):
    surroundings = cell(rule)
    with pytest.raises(InputError) as error:
        build.obstacles_of(surroundings, build.robot_of(arm, surroundings))
    assert message in str(error.value) and "\n" not in str(error.value)


def test_the_proof_of_a_motion_knows_the_box_on_a_link(arm, cell):
    """The turret turns the camera through a thin rod; the arm's own capsules pass next to it."""
    rod = '<geom name="post" type="capsule" size="0.003" fromto="0.1 0 0.9 0.2 0 0.9"/>'
    verdicts, where, proven = [], toy.scenario(), quick_jit(prove)
    for rules in ([], [{"name": "camera", "parent": "elbow"}]):
        surroundings = cell(*rules, shapes=rod + (CAMERA if rules else ""))
        robot = build.robot_of(arm, surroundings)
        a, b = jnp.array([-0.4, 0.0, 0.0, 0.0]), jnp.array([0.4, 0.0, 0.0, 0.0])
        verdicts.append(int(proven(Scene(robot, build.obstacles_of(surroundings, robot)), where, a, b).verdict))
    assert verdicts == [PathVerdict.VALID, PathVerdict.IN_COLLISION]


def test_the_tip_begins_at_the_tool_and_not_at_a_box_next_to_the_tcp(arm, cell):
    plain = build.robot_of(arm)
    robot = build.robot_of(arm, cell({"name": "camera", "parent": "hand"}))
    x = jnp.array([0.3, 0.2, 0.1, 0.4])
    segment = quick_jit(tip_segment)
    np.testing.assert_array_equal(segment(robot, x), segment(plain, x))


def test_a_fixture_on_the_base_stands_in_the_frame_of_the_base(arm, cell):
    moved = arm.model_copy(update={"base_m": (0.0, 0.0, 1.0)})
    surroundings = cell({"name": "post", "parent": "plinth"}, shift_m=(5.0, 0.0, 0.0))
    robot = build.robot_of(moved, surroundings)
    (found,) = build.obstacles_of(surroundings, robot)
    heights = {kind.centre[0, 0].item(): kind.centre[0, 2].item() for kind in found.simple}
    assert heights == pytest.approx({0.3: 1.5, 5.07: 0.2})


def test_a_job_without_fixtures_keeps_its_identity():
    config = load_config().model_dump(mode="json")
    before = {**config, "cell": {key: value for key, value in config["cell"].items() if key != "fixtures"}}
    assert config_hash(identity(config, [], "float64", {})) == config_hash(identity(before, [], "float64", {}))
