"""Fitted capsules: they enclose every triangle of the mesh, tightly."""

from functools import cache

import numpy as np
import pytest
import trimesh
from enclosed import are_enclosed, from_axis
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as of_numpy

from htcp_jax.io.robots.capsule_fit import GRID_M, Capsule, Cut, clip, cover_with_capsules, fit_capsule, hull_volume

SHIFTED = trimesh.transformations.translation_matrix((0.25, 0, 0.25))
SOLIDS = {  # of convex parts
    "cube": [trimesh.creation.box((1, 1, 1))],
    "slab": [trimesh.creation.box((0.4, 0.3, 0.02))],
    "rod": [trimesh.creation.cylinder(radius=0.05, height=0.8)],
    "ball": [trimesh.creation.icosphere(subdivisions=2, radius=0.07)],
    "elbow": [trimesh.creation.box((0.6, 0.1, 0.1)), trimesh.creation.box((0.1, 0.1, 0.6), transform=SHIFTED)],
}
coordinates = st.floats(-1, 1, allow_nan=False, width=32)


def triangles_of(name: str) -> np.ndarray:
    return np.concatenate([np.asarray(part.triangles, float) for part in SOLIDS[name]])


@cache
def covered(name: str, most: int) -> list[Capsule]:
    return [piece.capsule for piece in cover_with_capsules(triangles_of(name), most)]


@pytest.mark.parametrize(("name", "most"), [*((name, 1) for name in SOLIDS), ("slab", 3), ("elbow", 3)])
def test_every_triangle_is_held(name, most):
    capsules = covered(name, most)
    assert 1 <= len(capsules) <= most and are_enclosed(triangles_of(name), capsules)


def test_a_capsule_that_is_too_thin_is_found_out():
    """Sensitivity of the enclosure check: it finds 10 um, and a triangle whose corners alone are enclosed."""
    capsule = fit_capsule(SOLIDS["rod"][0].vertices)
    assert not are_enclosed(triangles_of("rod"), [capsule._replace(radius=capsule.radius - 2 * GRID_M)])
    triangle = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    assert not are_enclosed(triangle, [Capsule(corner, corner, 0.4) for corner in triangle[0]])
    assert are_enclosed(triangle, [Capsule(corner, corner, 0.75) for corner in triangle[0]])


@pytest.mark.parametrize("name", ["slab", "elbow"])
def test_what_a_closed_mesh_encloses_is_held(name):
    draw = np.random.default_rng(0)
    for part in SOLIDS[name]:
        inside = draw.dirichlet(np.full(len(part.vertices), 0.3), size=2000) @ part.vertices
        away = [from_axis(inside, capsule) - capsule.radius for capsule in covered(name, 3)]
        assert (np.min(away, axis=0) <= 0).all()


@settings(max_examples=40)
@given(of_numpy.arrays(float, st.tuples(st.integers(1, 30), st.just(3)), elements=coordinates))
def test_any_points_are_held_by_a_capsule_on_the_grid(points):
    """Random points, including a single point and points in a line or a plane."""
    capsule = fit_capsule(points)
    assert (from_axis(points, capsule) <= capsule.radius).all() and capsule.radius > 0
    numbers = np.array([*capsule.p, *capsule.q, capsule.radius]) / GRID_M
    np.testing.assert_allclose(numbers, numbers.round(), rtol=0, atol=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_a_capsule_is_found_again(seed):
    """Fit to points on a capsule: as large as this capsule, to 1 %."""
    draw = np.random.default_rng(seed)
    true = Capsule(*draw.uniform(-0.5, 0.5, (2, 3)), float(draw.uniform(0.02, 0.3)))
    directions = draw.normal(size=(4000, 3))
    directions *= true.radius / np.linalg.norm(directions, axis=1)[:, None]
    share = draw.uniform(size=(4000, 1)).round(draw.integers(0, 2))
    points = true.p + share * (true.q - true.p) + directions
    points = np.concatenate([points, true.p + directions, true.q + directions])
    found = fit_capsule(points[np.abs(from_axis(points, true) - true.radius) < 1e-9])
    assert found.volume == pytest.approx(true.volume, rel=0.01)


@pytest.mark.parametrize(
    ("name", "most", "ratio"), [("rod", 1, 1.25), ("cube", 1, 2.73), ("slab", 3, 7), ("elbow", 3, 1.1)]
)
def test_capsules_are_tight(name, most, ratio):
    """Capsule volume relative to the convex hull. A cube's ball has 2.72 of it; an elbow's hull is mostly empty."""
    volume = sum(capsule.volume for capsule in covered(name, most))
    assert volume <= ratio * hull_volume(triangles_of(name).reshape(-1, 3))


@settings(max_examples=60)
@given(
    of_numpy.arrays(float, (5, 3, 3), elements=coordinates),
    of_numpy.arrays(float, 3, elements=coordinates).filter(lambda normal: np.linalg.norm(normal) > 0.1),
    st.sampled_from([0.0, 0.25, 1.0]),
)
def test_a_plane_leaves_nothing_out(triangles, normal, offset):
    """Check both halves of a cut: each stays on its side, and their areas add up to the original."""
    cuts = Cut(tuple(normal.tolist()), offset), Cut(tuple((-normal).tolist()), -offset)
    halves = [clip(triangles, cut) for cut in cuts]
    for half, sign in zip(halves, (1, -1), strict=True):
        assert (sign * (half @ normal - offset) <= 1e-12).all()
    flat = (triangles @ normal == offset).all(axis=1)  # triangles in the plane are in both halves
    area = [_area(each) for each in (*halves, triangles, triangles[flat])]
    assert area[0] + area[1] == pytest.approx(area[2] + area[3], abs=1e-9)


def _area(triangles: np.ndarray) -> float:
    sides = triangles[:, 1:] - triangles[:, :1]
    return float(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum()) / 2


def test_flat_points_have_no_volume():
    assert hull_volume(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])) == 0.0
