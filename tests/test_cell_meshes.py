"""Meshes of a cell: the planner and `htcp validate` check the same bodies, which are those that the author meant."""

import json
from functools import cache, partial

import fcl
import jax
import made_once
import mujoco
import numpy as np
import pytest
import toy
from mesh_cells import CELLS, truth, write_cell

import htcp_jax
from htcp_jax.clearance import minimum_clearance
from htcp_jax.clearance.obstacles.of_cell import PlacedCloud
from htcp_jax.errors import Note
from htcp_jax.io.cell import load_cell, read_meshes
from htcp_jax.jobs import build
from htcp_jax.spec.config import CellConfig
from htcp_jax.validation import validate_results
from htcp_jax.validation.mujoco_arm import MujocoArm
from htcp_jax.validation.mujoco_cell import MujocoCell

pytestmark = pytest.mark.filterwarnings("ignore:.*is flat; it is a wall of thickness 0")
each_cell = pytest.mark.parametrize("name", CELLS)
CONFIGURATIONS = 60


@pytest.fixture
def arm(tmp_path):
    (tmp_path / "arm.xml").write_text(toy.ARM)
    return MujocoArm(tmp_path / "arm.xml")


def in_order(triangles: np.ndarray) -> np.ndarray:
    """Triangles in an order that does not depend on the file's, each with its corners in order."""
    return np.array(sorted(sorted(triangle) for triangle in triangles.round(6).tolist()))


@each_cell
def test_both_check_the_triangles_that_the_author_meant_as_a_solid_or_as_a_surface(name, tmp_path, arm):
    cell = CELLS[name]
    file = write_cell(cell, tmp_path)
    for shape, expected in zip(load_cell(file), truth(cell), strict=True):
        np.testing.assert_allclose(in_order(shape.triangles), in_order(expected), atol=2e-6)
        assert shape.convex == cell.is_solid
    found = MujocoCell(CellConfig(model=str(file)), arm, arm)
    assert len(found.walls) == (not cell.is_solid)


@pytest.mark.parametrize("name", [name for name, cell in CELLS.items() if cell.by_mujoco])
def test_mujocos_own_reading_of_a_file_has_the_same_corners(name, tmp_path):
    file = write_cell(CELLS[name], tmp_path)
    data = mujoco.MjData(model := mujoco.MjModel.from_xml_path(str(file)))
    mujoco.mj_kinematics(model, data)
    for g, shape in enumerate(load_cell(file)):
        mesh = model.mesh(model.geom_dataid[g])
        own = model.mesh_vert[mesh.vertadr[0] :][: mesh.vertnum[0]]
        corners = own @ data.geom_xmat[g].reshape(3, 3).T + data.geom_xpos[g]
        apart = np.linalg.norm(corners[:, None] - shape.triangles.reshape(-1, 3), axis=2)
        assert max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 1e-6


def by_fcl(corners: np.ndarray, triangles: np.ndarray) -> float:
    """Distance of a triangle from others by FCL [m]; 0 if it crosses one."""
    models = []
    for part in (corners[None], triangles):
        models.append(fcl.BVHModel())
        models[-1].beginModel(len(part), 3 * len(part))
        models[-1].addSubModel(part.reshape(-1, 3), np.arange(3 * len(part)).reshape(-1, 3))
        models[-1].endModel()
    return max(0.0, fcl.distance(*map(fcl.CollisionObject, models)))


@cache
def planner_clearances():
    robot, where = toy.robot(), toy.scenario()
    return made_once.quick_jit(lambda obstacles, x: jax.vmap(partial(minimum_clearance, robot, obstacles, where))(x))


@each_cell
def test_planner_and_validation_measure_the_distances_by_fcl_to_the_authors_triangles(name, tmp_path, arm):
    """FCL measures the axes, as triangles without an area; an axis in a solid has no distance from its triangles."""
    cell = CellConfig(model=str(write_cell(CELLS[name], tmp_path)))
    poses = arm.arm_poses(x := arm.random(CONFIGURATIONS, seed=3))
    triangles, exact = np.concatenate(truth(CELLS[name])), np.full(len(x), np.inf)
    for k in range(len(x)):
        for p, q, radius in zip(poses.p[k], poses.q[k], arm.radius, strict=True):
            exact[k] = min(exact[k], by_fcl(np.stack([p, q, q]), triangles) - radius)
    apart = exact > -arm.radius.min() + 1e-3
    assert apart.mean() > 0.9
    measured = MujocoCell(cell, arm, arm).distances(x, poses).min(axis=1)
    np.testing.assert_allclose(measured[apart], exact[apart], atol=1e-6)
    obstacles = build.obstacles_of(cell, toy.robot())
    covers = [each.cloud.cover for each in obstacles if isinstance(each, PlacedCloud)]
    under = exact - np.asarray(planner_clearances()(obstacles, x))
    assert (under[apart] > -1e-6).all() and (under[apart] < 2 * max(covers, default=0.0) + 1e-6).all()


@pytest.mark.slow
@each_cell
def test_a_plan_is_confirmed_next_to_a_mesh_and_refuted_with_the_last_triangle_in_the_tool(name, tmp_path, arm):
    cell = {"model": str(write_cell(CELLS[name], tmp_path)), "shift_m": (0.1, 0.45, 0.0), "self_collision": False}
    plan = htcp_jax.plan(toy.write_job(tmp_path, 4, cell=cell))
    assert plan.complete, plan.failure()
    plan.save(tmp_path / "plan")
    assert validate_results(tmp_path / "plan").validated
    poses = arm.arm_poses(plan.plans.x[0, -1:])
    shift_m = (poses.p + poses.q)[0, -1] / 2 - truth(CELLS[name])[0][-1].mean(axis=0)
    summary = json.loads((tmp_path / "plan/summary.json").read_text())
    summary["config"]["cell"]["shift_m"] = shift_m.tolist()
    (tmp_path / "plan/summary.json").write_text(json.dumps(summary))
    found = validate_results(tmp_path / "plan")
    assert any("the arm is in collision" in each.reason for each in found.refuted)


def test_a_wall_that_is_too_far_to_be_measured_at_any_configuration_has_no_distance(tmp_path, arm):
    own = MujocoCell(CellConfig(model=str(write_cell(CELLS["binary PLY"], tmp_path))), arm, arm)
    found = own.distances(x := np.zeros((2, 4)), arm.arm_poses(x), np.zeros((2, 2), bool))
    np.testing.assert_array_equal(found, np.inf)


def test_a_flat_mesh_is_named(tmp_path):
    file = write_cell(CELLS["a tilted sheet"], tmp_path)
    for read in (load_cell, read_meshes):
        with pytest.warns(
            Note, match="mesh 'part' is flat; it is a wall of thickness 0, which is checked on both sides"
        ):
            read(file)
