"""The cloud as discs: normals point inwards, corners lie in the surface, and every point has a disc."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from htcp_jax.model.surface import Surface, surface_of
from htcp_jax.viewer.drawn_meshes import CORNERS, discs


def tube(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points of a tube of radius 0.2 m about the x axis, and the directions from them to the axis."""
    rng = np.random.default_rng(seed)
    angle, x = rng.uniform(0, 2 * np.pi, count), rng.uniform(0, 1, count)
    out = np.stack([np.zeros(count), np.cos(angle), np.sin(angle)], axis=1)
    return np.stack([x, np.zeros(count), np.zeros(count)], axis=1) + 0.2 * out, -out


def test_the_normals_of_a_tube_point_to_its_axis():
    points, inwards = tube(5000)
    surface = surface_of(points)
    agreement = (surface.normals * inwards).sum(axis=1)
    assert np.median(agreement) > 0.995 and (agreement > 0.7).mean() > 0.99


def test_the_discs_leave_few_gaps_in_a_tube():
    points, _ = tube(5000)
    surface = surface_of(points)
    anywhere, _ = tube(300, seed=1)
    apart = np.linalg.norm(anywhere[:, None] - surface.points[None], axis=2)
    assert (apart < surface.radius[None]).any(axis=1).mean() > 0.99


def test_a_big_cloud_is_thinned_and_the_same_each_time():
    points, _ = tube(500)
    first, second = surface_of(points, most=400), surface_of(points, most=400)
    assert len(first.points) == 400 and (first.points == second.points).all()


def test_a_cloud_of_four_points_has_a_surface():
    assert np.isfinite(discs(surface_of(np.vstack([np.zeros(3), np.eye(3)]))).vertices).all()


UNIT = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array).filter(lambda v: np.linalg.norm(v) > 1e-3)


@given(UNIT, st.sampled_from([1, -1]))
def test_a_disc_is_flat_and_turns_as_its_normal_says(normal, side):
    normal = normal / np.linalg.norm(normal)
    mesh = discs(Surface(np.ones((1, 3)), normal[None], np.array([0.3])), side)
    assert mesh.vertices.shape == (CORNERS, 3) and mesh.faces.shape == (CORNERS - 2, 3)
    np.testing.assert_allclose((mesh.vertices - 1) @ normal, 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices - 1, axis=1), 0.3)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a) @ (side * normal) > 0).all()
    np.testing.assert_allclose(mesh.normals, np.tile(side * normal, (CORNERS, 1)))
