"""Section `cell:` of a job: self-collision, fixtures, point clouds, and the names of colliding bodies."""

import dataclasses
import json
import re
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import made_once
import mujoco
import numpy as np
import pytest
import trimesh
from made_plan import made_plan
from matplotlib.colors import to_rgba
from small_cell import small_job
from test_self_collision import CHAIN

import htcp_jax
from htcp_jax.clearance import minimum_clearance
from htcp_jax.clearance.distance.solids import Box
from htcp_jax.clearance.obstacles.fixtures import fixtures
from htcp_jax.clearance.obstacles.of_cell import PlacedCloud, make_fixtures, solid_of
from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.io.cell import load_cell
from htcp_jax.jobs import build, load_config
from htcp_jax.jobs.build import obstacles_of
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.model.kinematics import capsule_segments
from htcp_jax.motion.start_check import check_start
from htcp_jax.runs.identity import config_hash, identity, identity_differences, refuse_changed
from htcp_jax.runs.input_files import anchor_files, file_hashes
from htcp_jax.spec import GP50
from htcp_jax.spec.config import CellConfig
from htcp_jax.validation import validate_results
from htcp_jax.viewer.colours import FIXTURE

BENCH = """<body name="bench" pos="-1.6 -1.2 0"><geom name="table" type="box" size="0.3 0.3 0.05"/>
    <geom name="vice" type="box" size="0.05 0.05 0.05" pos="0 0 0.1"/></body>"""
CELL = f"""<mujoco><worldbody>
  <geom name="floor" type="plane" size="3 3 1" pos="0 0 -0.6"/>
  <geom name="pedestal" type="cylinder" size="0.3 0.3" pos="0 0 -0.1"/>
  <body name="post" pos="2 2 1"><geom name="post" type="sphere" size="0.02"/></body>
  {BENCH}
</worldbody></mujoco>"""


@pytest.fixture
def cell(tmp_path):
    (tmp_path / "cell.xml").write_text(CELL)
    return tmp_path / "cell.xml"


@pytest.mark.parametrize(("top_m", "stated"), [(0.0, None), (0.6, "capsule_1 deep in the fixture 'table'")])
def test_a_first_link_that_is_deep_in_a_table_is_stated_as_not_checked_and_one_that_stands_on_it_is_not(top_m, stated):
    table = Box(np.eye(3), np.array([0.0, 0.0, top_m - 0.5]), np.full(3, 0.5))
    facts = build.checked_facts(made_once.robot(), (fixtures(made_once.robot(), [("table", table)]),))
    assert facts.get("not checked") == (stated and f"{stated}: fixed bodies are not tested")


def test_an_arm_of_one_s_own_keeps_clear_of_itself_and_the_gp50_where_it_is_asked_to(tmp_path):
    (tmp_path / "arm.xml").write_text(CHAIN.format(size=0.1, more=""))
    own = {"robot.model": str(tmp_path / "arm.xml"), "start_rad": [0, 0, 0, 0]}
    assert not load_config().cell.self_collision and load_config(own).cell.self_collision
    assert load_config({"cell.self_collision": True}).cell.self_collision
    assert not load_config(own | {"cell.self_collision": False}).cell.self_collision
    (found,) = obstacles_of(load_config(own).cell, htcp_jax.load_robot(tmp_path / "arm.xml"))
    assert len(found.pairs) == 9 and not obstacles_of(load_config().cell, made_once.robot())


@pytest.fixture
def afar(tmp_path) -> list[str]:
    """Job settings with a few points that the arm does not touch."""
    points = np.random.default_rng(0).uniform(1.0, 1.1, (20, 3))
    for name, rows in (("part.xyz", points), ("path.csv", points[:2])):
        np.savetxt(tmp_path / name, rows, delimiter=",")
    part, path = tmp_path / "part.xyz", tmp_path / "path.csv"
    return [f"workpiece.cloud={part}", f"workpiece.path={path}", "workpiece.interior=none"]


def refused_start(overrides: list[str]) -> str:
    """Message by which a job with a colliding start is refused before planning."""
    job = load_config({}, overrides)
    robot, part, scenario = build.scene(job)
    with pytest.raises(InputError) as error:
        check_start(robot, part, scenario, build.obstacles_of(job.cell, robot))
    assert "\n" not in str(error.value)
    return str(error.value)


def test_a_start_that_hits_itself_names_the_pair_and_the_depth(afar):
    folded = [0.0, -2.3, 2.6, 0.0, 1.5, 0.0]
    model = mujoco.MjModel.from_xml_path(str(GP50))
    data = mujoco.MjData(model)
    data.qpos[:] = folded
    mujoco.mj_kinematics(model, data)
    apart = [
        (mujoco.mj_geomDistance(model, data, a, b, 10, None), a, b) for a in range(8) for b in range(8) if a > b + 1
    ]
    depth, a, b = min(each for each in apart if not (each[1] > 4 and each[2] > 4))
    assert depth < 0
    first, second = (model.body(model.geom(k).bodyid[0]).name for k in (a, b))
    message = f"start is in collision: {first} is {-1e3 * depth:.3f} mm inside {second}"
    assert message in refused_start([*afar, "cell.self_collision=true", f"start_rad={folded}"])


def test_a_start_in_a_fixture_names_it(afar, cell):
    x = np.array(made_once.START)
    p = np.asarray(capsule_segments(made_once.robot(), jnp.asarray(x))[0])[-1]
    there = (p - [-1.6, -1.2, 0]).tolist()
    cell.write_text(f"<mujoco><worldbody>{BENCH}</worldbody></mujoco>")
    own = [f"cell.model={cell}", "cell.moved=bench", f"cell.shift_m={there}"]
    found = refused_start([*afar, *own])
    assert re.match(r"start is in collision: link6 \(capsule_.* is [\d.]+ mm inside the fixture 'table'$", found)


def test_shapes_stand_where_mujoco_puts_them_and_where_they_are_moved(cell):
    model = mujoco.MjModel.from_xml_path(str(cell))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    as_drawn = load_cell(cell)
    assert [each.name for each in as_drawn] == ["floor", "pedestal", "post", "table", "vice"]
    for each, at, turn in zip(as_drawn, data.geom_xpos, data.geom_xmat, strict=True):
        np.testing.assert_allclose(each.T_world[:3, 3], at, atol=1e-15)
        np.testing.assert_allclose(each.T_world[:3, :3], turn.reshape(3, 3), atol=1e-15)
    moved = load_cell(cell, moved="bench", shift_m=(0.0, 0.0, 1.0), rpy_rad=(np.pi / 2, 0.0, 0.0))
    np.testing.assert_allclose(moved[3].T_world[:3, 3], [-1.6, -1.2, 1.0], atol=1e-15)
    np.testing.assert_allclose(moved[4].T_world[:3, 3], [-1.6, -1.3, 1.0], atol=1e-15)  # no longer above the table
    np.testing.assert_array_equal(moved[0].T_world, as_drawn[0].T_world)
    whole = load_cell(cell, shift_m=(1.0, 0.0, 0.0))
    assert all(
        np.allclose(a.T_world[:3, 3] - b.T_world[:3, 3], [1, 0, 0]) for a, b in zip(whole, as_drawn, strict=True)
    )


def test_the_first_link_stands_on_its_pedestal_and_other_bodies_heed_it(cell):
    (found,) = make_fixtures(made_once.robot(), load_cell(cell))
    is_checked = dict(zip(found.names, np.asarray(found.is_checked), strict=True))
    assert not is_checked["pedestal"][0] and is_checked["pedestal"][1:].all() and is_checked["table"].all()


@pytest.mark.parametrize(
    ("geoms", "message"),
    [
        (
            '<geom name="egg" type="ellipsoid" size="1 1 1"/>',
            "egg is a geom of type ellipsoid; valid in a cell: plane",
        ),
        ('<geom type="box" size="1 1 1" contype="0" conaffinity="0"/>', "no collision geoms"),
        ('<geom type="mesh" mesh="gone"/>', "mesh gone.stl: no such file"),
        (
            '<geom type="mesh" mesh="torn"/>',
            "torn.stl: not a readable .stl file (14 bytes; neither text nor a header of 84)",
        ),
        ('<geom type="mesh" mesh="flat"/>', "mesh 'flat' has no triangles"),
        ('<geom type="sphere" size="-1"/>', "not a model that MuJoCo can read: Error: size 0 must be positive"),
        ("<geom", "not a model that MuJoCo can read"),
    ],
)
def test_a_cell_that_cannot_be_taken_in_is_named_in_one_line(geoms, message, tmp_path, capsys):
    file = tmp_path / "cell.xml"
    (tmp_path / "torn.stl").write_text("no mesh at all")
    meshes = {"gone": 'file="gone.stl"', "torn": 'file="torn.stl"', "flat": 'vertex="0 0 0 1 0 0 0 1 0"'}
    own = [f'<mesh name="{name}" {what}/>' for name, what in meshes.items() if f'"{name}"' in geoms]
    file.write_text(f"<mujoco><asset>{''.join(own)}</asset><worldbody>{geoms}</worldbody></mujoco>")
    refused([f"cell.model={file}"], message, capsys)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (["cell.model=none.xml"], "none.xml: cannot read the model: No such file"),
        (["cell.modle=cell.xml"], "unknown key cell.modle; did you mean cell.model?"),
        (["cell.moved=bench"], "cell.moved is set, but cell.model is missing"),
        (["cell.shift_m=[1, 0, 0]"], "cell.shift_m is set, but cell.model is missing"),
        (["cell.shift_m=[.nan, 0, 0]"], "cell.shift_m.0 is nan"),
        (["cell.clouds=[{cloud: none.xyz}]"], "none.xyz: no such file"),
        (["cell.clouds=[{file: a.xyz}]"], "unknown key cell.clouds.0.file; valid: cloud, unit, base_m, base_rpy_rad"),
        (["cell.self_collision=maybe"], "cell.self_collision is 'maybe'"),
    ],
)
def test_what_a_job_says_wrongly_of_its_cell_is_named_in_one_line(settings, message, capsys):
    refused(settings, message, capsys)


def refused(settings, message: str, capsys) -> str:
    """Error line of `htcp plan`. The path check is off, so that less is compiled for a plan that is never made."""
    settings = [*settings, "settings.path_check=none"]
    assert main(["plan", "--method", "baseline", *(word for each in settings for word in ("--set", each))]) == 2
    errors = capsys.readouterr().err
    assert message in errors and errors.count("\n") == 1
    return errors


def test_a_body_that_is_not_there_cannot_be_moved(cell):
    with pytest.raises(InputError, match="no body 'desk' to move; bodies of the cell: post, bench"):
        load_cell(cell, moved="desk")


def test_a_mesh_that_is_not_convex_is_a_bound_on_its_triangles(tmp_path):
    """Compare a ring, which the arm may reach through, with trimesh."""
    ring = trimesh.creation.annulus(0.35, 0.4, 0.2)
    ring.export(tmp_path / "ring.stl")
    (tmp_path / "cell.xml").write_text(
        '<mujoco><asset><mesh name="ring" file="ring.stl"/></asset><worldbody>'
        '<geom name="hoop" type="mesh" mesh="ring" pos="1.2 0.3 1" euler="0 90 0"/></worldbody></mujoco>'
    )
    robot, where = made_once.robot(), made_once.nominal()
    (hoop,) = make_fixtures(robot, load_cell(tmp_path / "cell.xml"))
    assert isinstance(hoop, PlacedCloud) and 0 < hoop.cloud.cover <= 0.03 / 4  # a quarter of the thinnest radius
    ring.apply_transform(np.vstack([[0, 0, 1, 1.2], [0, 1, 0, 0.3], [-1, 0, 0, 1.0], [0, 0, 0, 1]]))
    for x in made_once.configurations_near(made_once.START, 4, 0.5):
        axes, radius = axes_of(robot, x)
        apart = trimesh.proximity.closest_point_naive(ring, axes.reshape(-1, 3))[1].reshape(axes.shape[:2]).min(axis=1)
        truth = (apart - radius).min()
        D = float(minimum_clearance(robot, (hoop,), where, jnp.asarray(x)))
        assert truth - 2 * float(hoop.cloud.cover) - 1e-3 < D <= truth + 1e-3  # the axes are sampled


def test_a_cloud_of_its_own_stands_where_the_job_says(tmp_path):
    points = np.random.default_rng(0).uniform(-0.2, 0.2, (50, 3))
    np.savetxt(tmp_path / "scan.xyz", points)
    placed = {"cloud": str(tmp_path / "scan.xyz"), "base_m": [1.2, 0.3, 1.0], "base_rpy_rad": [0.0, np.pi / 2, 0.0]}
    robot, where = made_once.robot(), made_once.nominal()
    (scan,) = obstacles_of(load_config({"cell.clouds": [placed]}).cell, robot)
    world = points @ np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]).T + [1.2, 0.3, 1.0]
    for x in made_once.configurations_near(made_once.START, 4, 0.5):
        axes, radius = axes_of(robot, x)
        truth = (np.linalg.norm(axes[:, :, None] - world, axis=3).min(axis=(1, 2)) - radius).min()
        assert abs(float(minimum_clearance(robot, (scan,), where, jnp.asarray(x))) - truth) < 1e-3


def axes_of(robot, x) -> tuple[np.ndarray, np.ndarray]:
    """Points on the axes of the bodies (K, 201, 3), and their radii."""
    p, q = (np.asarray(end) for end in capsule_segments(robot, jnp.asarray(x)))
    return p[:, None] + np.linspace(0, 1, 201)[:, None] * (q - p)[:, None], np.asarray(robot.capsule_radius)


def test_what_is_drawn_of_a_shape_lies_on_it(tmp_path):
    shapes = ["box", "sphere", "capsule", "cylinder"]
    geoms = "".join(f'<geom type="{kind}" size="0.1 0.3 0.2" pos="0.1 0.2 0.3" euler="20 30 40"/>' for kind in shapes)
    (tmp_path / "cell.xml").write_text(f"<mujoco><worldbody>{geoms}</worldbody></mujoco>")
    for shape in load_cell(tmp_path / "cell.xml"):
        solid, corners = jax.tree.map(jnp.asarray, solid_of(shape)), jnp.asarray(shape.surface.reshape(-1, 3))
        found = made_once.quick_jit(jax.vmap(solid.contact))(corners, corners)
        np.testing.assert_allclose(found.distance, 0.0, atol=1e-7)


def test_the_picture_of_a_plan_shows_its_cell(cell, tmp_path):
    def has_fixtures(plan) -> bool:
        colours = [each.get_facecolor() for axes in plan.figure().axes for each in axes.collections]
        return to_rgba(FIXTURE, 0.25) in [tuple(own[0]) for own in colours if len(own)]

    alone = made_plan(tmp_path / "job")
    beside = alone.job.model_copy(update={"cell": CellConfig(model=str(cell))})
    assert not has_fixtures(alone) and has_fixtures(dataclasses.replace(alone, job=beside))


@pytest.fixture
def job(tmp_path, cell):
    """Job with a line in front of a plate, for the GP50 in a cell."""
    return small_job(GP50, tmp_path) | {"cell": {"self_collision": True, "model": str(cell)}, "method": "baseline"}


@pytest.mark.slow
def test_a_plan_next_to_a_fixture_is_as_mujoco_measures_it_and_refuted_where_the_fixture_is_in_collision(job, tmp_path):
    """A post next to the tool is nearest at the targets; moved into the tool, it collides."""
    p, q = (np.asarray(end)[-1] for end in capsule_segments(htcp_jax.load_robot(GP50), jnp.array(job["start_rad"])))
    aside = np.linalg.svd((q - p)[None])[2][1]
    job["cell"] |= {"moved": "post", "shift_m": (0.5 * (p + q) + 0.06 * aside - [2, 2, 1]).tolist()}
    plan = htcp_jax.plan(job)
    duct = htcp_jax.make_obstacle(plan.workpiece)
    alone = made_once.quick_jit(jax.vmap(partial(minimum_clearance, plan.robot, duct, plan.scenario)))
    tracked = plan.plans.tracked[0]
    assert tracked.any() and (alone(plan.plans.x[0, tracked]) > plan.plans.clearance[0, tracked] + 1e-3).all()
    plan.save(tmp_path / "plan")
    found = validate_results(tmp_path / "plan")
    assert found.validated and found.methods["baseline"].clearance_off_max_mm < 1e-6
    summary = json.loads((tmp_path / "plan/summary.json").read_text())
    summary["config"]["cell"]["shift_m"] = (0.5 * (p + q) - [2, 2, 1]).tolist()
    (tmp_path / "plan/summary.json").write_text(json.dumps(summary))
    found = validate_results(tmp_path / "plan")
    assert not found.validated and "the arm is in collision" in found.refuted[0].reason


def test_a_sweep_moves_a_fixture(job, tmp_path):
    x = np.array(job["start_rad"])
    tool = np.asarray(capsule_segments(made_once.robot(), jnp.asarray(x))[0])[-1]
    there = (tool - [-1.6, -1.2, 0]).tolist()
    job["cell"]["moved"] = "bench"
    sweep = load_sweep({"grid": [{"cell.shift_m": [[0, 0, 0], there]}, {"margin_m": [0.0, 1e-3]}]}, job)
    batch = sweep.batch()
    assert len(batch.cells) == 2 and batch.cell.tolist() == [0, 0, 1, 1]
    boxes = [next(kind for kind in cell.obstacles[0].simple if isinstance(kind, Box)) for cell in batch.cells]
    offsets = [box.centre for box in boxes]
    np.testing.assert_allclose(offsets[1] - offsets[0], np.tile(there, (len(offsets[0]), 1)), atol=1e-12)


def test_a_sweep_plans_with_and_without_a_cell(job):
    model = job.pop("cell")["model"]
    batch = load_sweep({"grid": [{"cell.model": [None, model]}]}, job).batch()
    assert [len(cell.obstacles) for cell in batch.cells] == [1, 2]  # the arm's self-collision is one of them
    with pytest.raises(InputError, match=r"cell\.clouds is a list, which cannot vary"):
        load_sweep({"grid": [{"cell.clouds": [[], []]}]}, job)


def test_the_meshes_of_a_cell_and_what_models_include_are_part_of_a_runs_identity(tmp_path):
    """Files count by their contents, not by their location; purely visual meshes are excluded."""

    def made(name: str):
        folder = tmp_path / name
        (folder / "parts").mkdir(parents=True)
        for part in ("vice", "logo"):
            trimesh.creation.box([0.1, 0.1, 0.1]).export(folder / f"parts/{part}.stl")
        (folder / "posts.xml").write_text('<mujoco><worldbody><geom type="sphere" size="0.1"/></worldbody></mujoco>')
        (folder / "cell.xml").write_text(
            '<mujoco><compiler meshdir="parts"/><include file="posts.xml"/>'
            '<asset><mesh name="vice" file="vice.stl"/><mesh name="logo" file="logo.stl"/></asset><worldbody>'
            '<geom type="mesh" mesh="vice"/><geom type="mesh" mesh="logo" contype="0" conaffinity="0"/>'
            "</worldbody></mujoco>"
        )
        return folder

    def same(folder):
        config = load_config({"cell.model": str(folder / "cell.xml")}).model_dump(mode="json")
        files = file_hashes(anchor_files(config))
        assert [Path(file).name for file in files] == ["cell.xml", "vice.stl", "posts.xml"]
        return identity(config, [], "float64", files), files

    (here, files), (there, _) = same(made("here")), same(made("there"))
    assert here == there
    (tmp_path / "there/parts/logo.stl").write_bytes(b"")
    assert same(tmp_path / "there")[0] == here
    for part in ("parts/vice.stl", "posts.xml"):
        (tmp_path / "there" / part).write_bytes((tmp_path / "there" / part).read_bytes() + b"\n")
        changed = same(tmp_path / "there")[0]
        (line,) = identity_differences(here, changed)
        assert line.startswith(f"parts.{Path(part).name} was SHA-256 ") and config_hash(here) != config_hash(changed)
        here = changed
    refuse_changed(files, tmp_path)
    (tmp_path / "here/parts/vice.stl").write_bytes(b"")
    with pytest.raises(InputError, match=r"vice\.stl has changed since"):
        refuse_changed(files, tmp_path)
