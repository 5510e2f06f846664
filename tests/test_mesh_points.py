"""Sampled points on a mesh: they cover it within a known radius."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from htcp_jax.errors import InputError
from htcp_jax.model import Workpiece, mesh_points, surface
from htcp_jax.model.mesh_points import FEW, MANY, NearbyBody, cover_mesh, denser_spacing
from htcp_jax.model.surface import area, longest_edge_first, pieces

MESHES = {
    "box": trimesh.creation.box((0.4, 0.36, 0.02)),
    "cylinder": trimesh.creation.cylinder(0.1, 0.5, sections=200),
    "sphere": trimesh.creation.icosphere(4, 0.2),
}
ROOM = 1e-12


def on(triangles: np.ndarray, count: int, seed: int = 0) -> np.ndarray:
    """Random points on the triangles, equally many on small and large ones."""
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet(np.ones(3), count)
    return np.einsum("pk,pkc->pc", weights, triangles[rng.integers(len(triangles), size=count)])


@pytest.mark.parametrize("shape", MESHES)
@pytest.mark.parametrize("spacing", [0.03, 0.011])
def test_no_point_of_a_mesh_is_further_from_a_sample_than_it_says(shape, spacing):
    """Check the covering radius, which is at most half the requested spacing, for all kinds of triangles."""
    triangles = np.asarray(MESHES[shape].triangles)
    found = cover_mesh(triangles, "mesh", spacing)
    distance, _ = cKDTree(found.points).query(on(triangles, 20_000))
    assert 0.5 * found.radius_m < distance.max() <= found.radius_m <= spacing / 2 * (1 + 1e-6)
    assert len(np.unique(found.points, axis=0)) == len(found.points)
    assert len(found.points) < 3 * FEW  # slivers do not multiply them


def test_the_points_are_on_the_mesh_and_the_same_each_time():
    triangles = np.asarray(MESHES["box"].triangles)
    found = cover_mesh(triangles, "mesh", 0.01)
    depth = np.array([0.2, 0.18, 0.01]) - np.abs(found.points)
    assert np.abs(depth.min(axis=1)).max() < 1e-15
    assert found.points.tobytes() == cover_mesh(triangles, "mesh", 0.01).points.tobytes()


def test_the_points_are_spread_evenly():
    """Regression: random sampling had neighbours at 1 mm next to gaps of 30 mm."""
    found = cover_mesh(np.asarray(trimesh.creation.box((1, 1, 1)).triangles), "mesh", 0.05)
    near = cKDTree(found.points).query(found.points, k=2)[0][:, 1]
    assert near.max() < 2 * near.min()


corner = st.tuples(*[st.floats(-1, 1, allow_subnormal=False)] * 3)


@given(st.tuples(corner, corner, corner))
def test_a_triangles_covering_radius_is_attained_and_never_exceeded(corners):
    """Compare with a dense grid of barycentric coordinates, also for flat and acute triangles."""
    triangle = np.array(corners, float).round(9)
    grid = np.array([(i, j, 120 - i - j) for i in range(121) for j in range(121 - i)]) / 120
    points = grid @ triangle
    furthest = np.linalg.norm(points[:, None] - triangle, axis=2).min(axis=1).max()
    radius = mesh_points._covering_radius(longest_edge_first(np.moveaxis(triangle[None], 0, 2)))[0]
    longest = np.linalg.norm(triangle - np.roll(triangle, 1, axis=0), axis=1).max()
    assert furthest <= radius * (1 + 1e-6) + ROOM and radius <= furthest + longest / 120 + ROOM


def test_a_sliver_takes_points_along_its_length_alone():
    sliver = np.array([[[0, 0, 0], [1, 0, 0], [0.3, 1e-7, 0]]])
    found = cover_mesh(np.repeat(sliver, 50, axis=0), "mesh", 0.02)
    assert found.radius_m <= 0.01 * (1 + 1e-6) and len(found.points) < 300


def test_a_mesh_gets_more_points_for_a_thinner_body_within_limits():
    triangles = np.asarray(trimesh.creation.box((1.0, 1.2, 0.8)).triangles)
    thick, thin, tiny = (cover_mesh(triangles, "mesh", body=NearbyBody("rod", r)) for r in (0.1, 0.02, 0.001))
    assert FEW <= len(cover_mesh(triangles, "mesh").points) == len(thick.points) < 3 * FEW < len(thin.points)
    assert MANY <= len(tiny.points) < 3 * MANY
    assert tiny.radius_m < thin.radius_m <= 0.02 / 4 < thick.radius_m


def domed_cylinder() -> np.ndarray:
    """Triangles of a cylinder with a dome: slivers, and triangles much smaller than the spacing."""
    sliver = np.asarray(trimesh.creation.cylinder(0.1, 0.1, sections=200).triangles)
    sphere = np.asarray(trimesh.creation.icosphere(7, 0.1).triangles)
    return np.concatenate([sliver - [0, 0, 0.05], sphere[sphere.mean(axis=1)[:, 2] > 0]])


TESSELLATED = {"domed cylinder": domed_cylinder, "cube": lambda: trimesh.creation.box((0.2, 0.2, 0.2)).triangles}


@pytest.mark.parametrize("shape", TESSELLATED)
def test_a_part_of_200_mm_gets_tens_of_thousands_of_points_for_any_body_and_triangles(shape):
    """Regression: 770,831 points."""
    triangles = np.asarray(TESSELLATED[shape]())
    np.testing.assert_allclose(np.ptp(triangles, axis=(0, 1)), 0.2, atol=1e-4)
    found = cover_mesh(triangles, "mesh", body=NearbyBody("tip", 0.001))
    distance, _ = cKDTree(found.points).query(on(triangles, 20_000))
    assert 10_000 < len(found.points) < 100_000
    assert distance.max() <= found.radius_m < 0.0025


@pytest.mark.parametrize("options, words", [
    ({"spacing": 0.0}, "must be more than 0"),
    ({"spacing": float("nan")}, "must be more than 0"),
    ({"spacing": 1e-5}, "more than 3,000,000 points at a spacing of 1e-05 m; increase workpiece.mesh_spacing_m"),
])  # fmt: skip
def test_what_cannot_be_sampled_is_one_line(options, words):
    with pytest.raises(InputError, match=words) as error:
        cover_mesh(np.asarray(MESHES["box"].triangles), "part.stl", **options)
    assert str(error.value).startswith("part.stl: ") and "\n" not in str(error.value)


def test_a_refusal_names_the_body_that_requires_the_spacing(monkeypatch):
    monkeypatch.setattr(surface, "MOST_POINTS", 400_000)  # which is reached sooner
    slivers = np.array([[[0, 0, y], [30, 0, y], [30, 1e-3, y]] for y in np.linspace(0, 1, 3000)])
    words = (
        r"points at a spacing of 0.0173 m, as fine as capsule tip with a radius of 1 mm requires; increase workpiece.m"
    )
    with pytest.raises(InputError, match=words):
        cover_mesh(slivers, "part.stl", body=NearbyBody("capsule tip", 0.001))


def test_a_mesh_without_an_area_is_refused():
    with pytest.raises(InputError, match="no area"):
        cover_mesh(np.zeros((2, 3, 3)), "part.stl")


@pytest.mark.parametrize("shape", MESHES)
def test_pieces_are_the_mesh_and_none_is_long(shape):
    triangles = np.asarray(MESHES[shape].triangles)
    cut = pieces(triangles, 0.02, "mesh")
    edges = np.linalg.norm(cut - np.roll(cut, 1, axis=1), axis=2)
    assert edges.max() <= 0.02 and area(cut).sum() == pytest.approx(area(triangles).sum(), rel=1e-9)


def test_a_suggested_spacing_has_one_digit_and_a_covering_radius_that_leaves_what_is_lacking():
    draw = np.random.default_rng(3)
    for radius, share in draw.uniform((1e-4, 0), (0.01, 1.1), (200, 2)):
        spacing = denser_spacing(part(np.eye(4, 3), radius), share * radius)
        if spacing is None:
            assert 1.8 * radius * (1 - share) < 2e-4
        else:
            assert spacing / 2 < radius * (1 - share) and float(f"{spacing:.0e}") == pytest.approx(spacing)
    assert denser_spacing(part(np.eye(4, 3), 0.00464), 0.00277) == 0.003
    assert denser_spacing(part(np.eye(4, 3), 0.0), -1.0) is None


def test_a_suggested_spacing_is_not_refused_for_too_many_points(monkeypatch):
    """Regression: 0.001 m was suggested where a mesh may not have that many points."""
    monkeypatch.setattr(surface, "MOST_POINTS", 30_000)
    draw, found = np.random.default_rng(5), set()
    for triangles in (MESHES["box"].triangles, MESHES["sphere"].triangles, draw.uniform(-0.2, 0.2, (30, 3, 3))):
        sparse = cover_mesh(np.asarray(triangles), "mesh", 0.03)
        for lack in np.linspace(0, 0.9, 10) * sparse.radius_m:
            denser = denser_spacing(part(sparse.points, sparse.radius_m), lack)
            found.add(denser is None)
            if denser:
                cover_mesh(np.asarray(triangles), "mesh", denser)
    assert found == {True, False}


def test_the_spacing_that_a_refusal_names_is_accepted(monkeypatch):
    monkeypatch.setattr(surface, "MOST_POINTS", 30_000)
    for triangles in (MESHES["box"].triangles, MESHES["sphere"].triangles):
        with pytest.raises(InputError, match=r"increase workpiece\.mesh_spacing_m to [\d.]+ or more$") as refusal:
            cover_mesh(np.asarray(triangles), "mesh", 1e-4)
        cover_mesh(np.asarray(triangles), "mesh", float(str(refusal.value).split()[-3]))


def part(points: np.ndarray, radius_m: float) -> Workpiece:
    """Part with points on a mesh."""
    return Workpiece("part", points, np.zeros((1, 3)), interior="none", covering_radius_m=radius_m)
