"""Triangles of a part in pictures: those of the file, cut exactly, drawn from both sides."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from made_plan import made_plan
from matplotlib.figure import Figure

from htcp_jax.io.parts.workpiece_source import load_workpiece
from htcp_jax.model import surface
from htcp_jax.viewer.drawn_meshes import cut_triangles, flat_mesh
from htcp_jax.viewer.picture_part import Part
from htcp_jax.viewer.render import _model
from htcp_jax.viewer.replay import replays_of
from htcp_jax.viewer.viewpoints import PartAxis, Viewpoint, view_from_side


def random_triangles(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (40, 3, 3))


@given(st.integers(0, 2**32 - 1), st.floats(-1, 1))
def test_both_halves_of_a_cut_have_the_area_of_the_whole_and_lie_on_their_sides(seed, offset):
    triangles, normal = random_triangles(seed), np.array([0.6, 0.0, 0.8])
    below, above = cut_triangles(triangles, normal, offset), cut_triangles(triangles, -normal, -offset)
    whole = surface.area(triangles).sum()
    np.testing.assert_allclose(surface.area(below).sum() + surface.area(above).sum(), whole, rtol=1e-9)
    assert (below @ normal).max(initial=-9) < offset + 1e-9 and (above @ normal).min(initial=9) > offset - 1e-9


@given(st.integers(0, 2**32 - 1))
def test_a_cut_keeps_the_side_from_which_a_triangle_is_seen_and_those_it_does_not_meet(seed):
    triangles = random_triangles(seed)
    for one in triangles:
        normal = np.cross(one[1] - one[0], one[2] - one[0])
        for part in cut_triangles(one[None], np.array([0.0, 0, 1]), 0.1):
            assert np.cross(part[1] - part[0], part[2] - part[0]) @ normal >= -1e-12
    np.testing.assert_array_equal(cut_triangles(triangles, np.array([0.0, 0, 1]), 2.0), triangles)


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    """A plan of a part that was read from an STL file, and the triangles in this file."""
    folder = tmp_path_factory.mktemp("box")
    plan = made_plan(folder)
    mesh = trimesh.creation.box((0.4, 0.3, 0.2), trimesh.transformations.translation_matrix((0, 0, 0.5)))
    mesh.export(folder / "box.stl")
    part = load_workpiece(folder / "box.stl", folder / "path.csv")
    stored = np.asarray(trimesh.load(folder / "box.stl", process=False).triangles)
    return replace(plan, workpiece=part), stored


def test_the_triangles_that_are_drawn_are_those_of_the_file(box):
    plan, stored = box
    replay = replays_of("box", plan).replay(0, "baseline")
    T = np.asarray(plan.scenario.T_world_workpiece)
    np.testing.assert_allclose(replay.triangles, stored @ T[:3, :3].T + T[:3, 3], atol=1e-7)
    mesh = flat_mesh(replay.triangles)
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], replay.triangles)
    reverse = flat_mesh(replay.triangles, -1)
    np.testing.assert_allclose(reverse.normals, -mesh.normals, atol=1e-12)
    whole = replay._replace(sides=tuple(each._replace(cut=False) for each in replay.sides))
    model = _model(whole, 64, 64, False, True, 0)
    assert [int(model.mesh(name).facenum[0]) for name in ("inside", "outside")] == [len(stored)] * 2


def test_the_picture_of_a_plan_draws_the_mesh_with_its_area_and_a_cloud_as_points(box):
    plan, stored = box
    view = view_from_side(plan.workpiece.cloud, plan.workpiece.path)
    at = Viewpoint(view, 0.0, 0.0, 0.0, PartAxis("+x", view.near))
    drawn = {}
    for name, part in {"mesh": Part(plan.workpiece.cloud, stored), "cloud": Part(plan.workpiece.cloud)}.items():
        drawn[name] = Figure().subplots()
        part.draw(drawn[name], at)
    (collection,) = drawn["mesh"].collections
    flat = np.array([path.vertices[:3] for path in collection.get_paths()])
    (x, y), (u, v) = ((flat[:, k] - flat[:, 0]).T for k in (1, 2))
    seen = surface.area(stored) * np.abs(flat_mesh(stored).normals[::3] @ at.view.near)
    assert np.abs(x * v - y * u).sum() / 2 == pytest.approx(seen.sum())
    assert not drawn["cloud"].collections and len(drawn["cloud"].lines) > 1
