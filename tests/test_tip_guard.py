"""The bare tip: it must not pass through a wall, except with its very end."""

import made_once
import numpy as np
import pytest
import stranger_jobs
import trimesh

from htcp_jax.clearance.obstacles.tip_guard import TipGuard, WallTriangles, make_tip_guard
from htcp_jax.io.parts.workpiece_source import GeneratedDuct, load_workpiece
from htcp_jax.jobs import load_config
from htcp_jax.jobs.build import robot_of, workpiece_of
from htcp_jax.model import Workpiece
from htcp_jax.model.kinematics import capsule_segments, tcp_position, tip_segment
from htcp_jax.model.robot import lengthen_tool

MESHES = {
    "box": trimesh.creation.box((0.4, 0.36, 0.02)),
    "cylinder": trimesh.creation.cylinder(0.1, 0.5, sections=60),
    "sphere": trimesh.creation.icosphere(3, 0.2),
}

_TIP = made_once.quick_jit(
    lambda robot, x: (tip_segment(robot, x), *capsule_segments(robot, x), tcp_position(robot, x))
)


def tips(mesh: trimesh.Trimesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Tip segments with ends near the mesh."""
    rng = np.random.default_rng(0)
    ends = mesh.triangles[rng.integers(len(mesh.triangles), size=count)]
    q = np.einsum("pk,pkc->pc", rng.dirichlet(np.ones(3), count), ends) + rng.normal(size=(count, 3)) * 0.01
    return q + rng.normal(size=(count, 3)) * 0.04, q


def through(mesh: trimesh.Trimesh, p: np.ndarray, q: np.ndarray) -> bool:
    """Return True if the segment passes through a triangle: ends on both sides of the plane, the crossing inside."""
    a, b, c = np.moveaxis(mesh.triangles, 1, 0)
    normal = np.cross(b - a, c - a)
    before, after = ((p - a) * normal).sum(axis=1), ((q - a) * normal).sum(axis=1)
    for k in np.flatnonzero(before * after < 0):
        point = p + before[k] / (before[k] - after[k]) * (q - p)
        corners = np.array([a[k], b[k], c[k]])
        turns = np.cross(np.roll(corners, -1, axis=0) - corners, point - corners) @ normal[k]
        if (turns >= 0).all():
            return True
    return False


@pytest.mark.parametrize("shape", MESHES)
def test_what_passes_through_a_mesh_is_found_and_nothing_else(shape):
    """Tip segments through a mesh: exactly those found by testing every triangle."""
    mesh = MESHES[shape]
    p, q = tips(mesh, 600)
    length = np.linalg.norm(q - p, axis=1, keepdims=True)
    end = p + (q - p) * np.maximum(1 - 0.01 / length, 0)
    expected = [through(mesh, a, b) for a, b in zip(p, end, strict=True)]
    found = TipGuard(WallTriangles(np.asarray(mesh.triangles)), 0.01).passes(p, q)
    assert found.tolist() == expected and 50 < sum(expected) < 500


@pytest.mark.parametrize("shape", MESHES)
def test_tips_along_a_path_get_the_verdicts_of_the_same_tips_in_any_order(shape):
    """Neighbours on slow and fast paths are excluded together; in a random order, nearly every tip is tested alone."""
    rng, count = np.random.default_rng(2), 99
    p, q = (np.repeat(each, count, axis=0) for each in tips(MESHES[shape], 60))
    along = np.tile(np.arange(count) / count, 60)[:, None]
    travel = rng.normal(size=(60, 3)) * rng.choice([0.0, 1e-3, 0.1], size=(60, 1))
    p, q = (each + along * np.repeat(travel * turn, count, axis=0) for each, turn in ((p, 0.8), (q, 1.0)))
    guard, order = TipGuard(WallTriangles(np.asarray(MESHES[shape].triangles)), 0.01), rng.permutation(len(p))
    found = guard.passes(p, q)
    assert found[order].tolist() == guard.passes(p[order], q[order]).tolist() and 0.1 < found.mean() < 0.9


def test_an_edge_between_two_triangles_is_no_way_through():
    square = np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]], float)
    s = np.linspace(0.01, 0.99, 97)
    p, q = (np.column_stack([s, s, np.full(97, z)]) for z in (-0.05, 0.05))
    assert TipGuard(WallTriangles(square), 0.0).passes(p, q).all()


def test_the_end_may_touch_as_far_as_the_key_says():
    wall = np.array([[[-1, -1, 0], [1, -1, 0], [0, 1, 0]]], float)
    guard = TipGuard(WallTriangles(wall), 0.01)
    p = np.tile([0.0, 0.0, 0.05], (3, 1))
    assert guard.passes(p, np.array([[0, 0, -0.009], [0, 0, -0.011], [0, 0, 0.051]])).tolist() == [False, True, False]
    assert not guard.passes(p, p).any() and guard.passes(p[:0], p[:0]).shape == (0,)


def test_the_discs_of_a_cloud_are_a_wall_too():
    """Tip segments through the discs of a random cloud: at least 99 % of the true ones, few others."""
    mesh = MESHES["sphere"]
    cloud = np.asarray(trimesh.sample.sample_surface(mesh, 20_000, seed=1)[0])
    part = Workpiece("cloud", cloud, cloud[:1], interior="none", tip_contact_m=0.01)
    p, q = tips(mesh, 2000)
    truth = TipGuard(WallTriangles(np.asarray(mesh.triangles)), 0.01).passes(p, q)
    found = make_tip_guard(part).passes(p, q)
    assert (truth & ~found).sum() <= 0.01 * truth.sum() and (found & ~truth).sum() <= 0.05 * (~truth).sum()


def test_the_guard_is_off_for_the_duct_and_on_for_a_part_of_one_s_own(tmp_path):
    assert make_tip_guard(load_workpiece(GeneratedDuct(points=1000))) is None
    job = stranger_jobs.box_job(tmp_path)
    parts = [load_config(job, more).workpiece for more in ([], ["workpiece.tip_contact_m=null"])]
    assert [part.tip_contact_m for part in parts] == [0.01, None]
    assert load_config().workpiece.tip_contact_m is None


def test_from_outside_through_the_tubs_wall_is_refused_and_from_above_is_not(tmp_path):
    """Tip through a tub's closed wall: refused; from above: accepted (regression: 42 of 52 targets)."""
    job = load_config(stranger_jobs.tub_job(tmp_path), ["workpiece.mesh_spacing_m=0.01"])
    part = workpiece_of(job.workpiece, robot_of(job.robot))
    guard, seam = make_tip_guard(part), part.path
    from_outside, from_above = (seam + np.array(offset) for offset in ((-0.03, 0, 0.01), (0.015, 0, 0.03)))
    assert guard.passes(from_outside, seam).all() and not guard.passes(from_above, seam).any()


def test_the_tip_goes_from_the_spindles_end_to_the_tcp(tmp_path):
    stranger_jobs.box_job(tmp_path)
    own = robot_of(load_config(tmp_path / "job.yaml").robot)
    for robot in (own, made_once.robot(), lengthen_tool(made_once.robot(), 0.05), made_once.seven_joints(tmp_path)):
        for x in made_once.configurations(robot, 5):
            tip, p, q, tcp = map(np.asarray, _TIP(robot, x))
            ends = np.concatenate([p, q])
            np.testing.assert_allclose(tip[1], tcp, atol=1e-14)
            tool = np.tile(np.array(robot.capsule_link) == max(robot.capsule_link), 2)
            nearest = np.linalg.norm(ends[tool] - tip[1], axis=1).min()
            assert np.linalg.norm(tip[0] - tip[1]) == pytest.approx(nearest, abs=1e-12)
    assert np.ptp(np.asarray(_TIP(own, np.zeros(6))[0])[:, 1]) == pytest.approx(0.038)
