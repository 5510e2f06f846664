"""The workpiece: pose by its rule, hull around all points, and one line for each rejected input."""

import dataclasses
from pathlib import Path

import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
import trimesh
from made_once import load_cloud
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from htcp_jax.errors import InputError
from htcp_jax.io.parts.workpiece_source import (
    GeneratedDuct,
    PointCloud,
    TriangleMesh,
    load_workpiece,
    read_path,
    read_source,
)
from htcp_jax.model import Workpiece, duct
from htcp_jax.spec import NEUTRAL_TRANSLATION, PIVOT

REAL = Path(__file__).parents[2] / "shared" / "data" / "duct"
needs_real_duct = pytest.mark.skipif(
    not (REAL / "cloud.xyz").exists(), reason="the measured duct is not part of the package"
)
CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
PATH = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])


@pytest.fixture(scope="module")
def generated():
    return load_workpiece()


@pytest.fixture(scope="module")
def real():
    return load_workpiece(REAL / "cloud.xyz", REAL / "weld.csv", inlet=duct.INLET)


def place(T, points):
    return points @ T[:3, :3].T + T[:3, 3]


def height(workpiece, points):
    """Distance of points outside the hull's half-spaces [m]: the largest over the facets."""
    blocks = np.array_split(points, max(1, len(points) // 500))
    return np.concatenate([
        (block @ workpiece.hull_normal.T - workpiece.hull_offset).max(axis=1) for block in blocks
    ])  # fmt: skip


# Pose


def test_the_pose_turns_about_the_pivot_first_about_y_then_about_z():
    rng = np.random.default_rng(0)
    workpiece = Workpiece("cube", CUBE, PATH)
    pivot, neutral = np.array(PIVOT), np.array(NEUTRAL_TRANSLATION)
    for wy, wz in rng.uniform(-np.pi, np.pi, (20, 2)):
        shift = rng.uniform(-0.1, 0.1, 3)
        turn = Rotation.from_euler("z", wz) * Rotation.from_euler("y", wy)
        expected = pivot + turn.apply(CUBE + neutral - pivot) + shift
        T = workpiece.T_world(wy, wz, shift=tuple(shift))
        np.testing.assert_allclose(place(T, CUBE), expected, atol=1e-14)


def test_the_neutral_pose_is_a_translation_and_the_pivot_stays():
    workpiece = Workpiece("cube", CUBE, PATH)
    np.testing.assert_allclose(workpiece.T_world(0.0, 0.0)[:3, :3], np.eye(3), atol=0)
    np.testing.assert_allclose(workpiece.T_world(0.0, 0.0)[:3, 3], NEUTRAL_TRANSLATION, atol=1e-15)
    fixed = np.array([PIVOT]) - np.array([NEUTRAL_TRANSLATION])
    np.testing.assert_allclose(place(workpiece.T_world(0.7, -0.4), fixed), [PIVOT], atol=1e-15)


def test_pivot_and_neutral_translation_are_parameters():
    workpiece = Workpiece("cube", CUBE, PATH, pivot=(0.0, 0.0, 0.0), neutral_translation=(1.0, 0.0, 0.0))
    quarter = place(workpiece.T_world(0.0, np.pi / 2), PATH[:1])
    np.testing.assert_allclose(quarter, [[-0.2, 1.1, 0.3]], atol=1e-15)


@needs_real_duct
def test_the_measured_weld_lands_where_the_scene_says(real):
    """Measured weld in the world frame, to 1e-5 m.

    No reading of the pose rule is exact: the stated points are 5.4 um farther apart than the weld's ends, and no rigid
    pose stretches.
    """
    ends = place(real.T_world(0.4, 0.1), real.path[[0, -1]])
    stated = np.array([[1.6560575, -0.1859774, 1.1261086], [2.3518327, -0.1180665, 0.8345056]])
    np.testing.assert_allclose(ends, stated, atol=1e-5)
    stretch = np.linalg.norm(stated[1] - stated[0]) - np.linalg.norm(real.path[-1] - real.path[0])
    assert stretch == pytest.approx(5.37e-6, abs=0.1e-6)


# Hull


def test_a_cubes_hull_is_its_six_faces():
    """Hull of a cube: six planes, although Qhull gives twelve triangles."""
    cloud = np.concatenate([CUBE, np.random.default_rng(0).uniform(size=(100, 3))])
    cube = Workpiece("cube", cloud, PATH)
    planes = np.column_stack([cube.hull_normal, cube.hull_offset]).round(12)
    assert len(planes) == 6
    faces = {tuple(plane) for plane in planes}
    assert faces == {(1, 0, 0, 1), (0, 1, 0, 1), (0, 0, 1, 1), (-1, 0, 0, 0), (0, -1, 0, 0), (0, 0, -1, 0)}
    assert sorted(cube.hull_vertices.tolist()) == sorted(CUBE.tolist())


def test_the_hull_holds_the_duct_and_reaches_no_farther_than_its_tolerance(generated):
    assert len(generated.hull_normal) == 944
    np.testing.assert_allclose(np.linalg.norm(generated.hull_normal, axis=1), 1.0, atol=1e-12)
    assert height(generated, generated.hull_vertices).max() < 1e-12
    touch = (generated.hull_normal @ generated.hull_vertices.T).max(axis=1)
    np.testing.assert_allclose(touch, generated.hull_offset, atol=1e-12)

    exact = ConvexHull(generated.cloud)
    rng = np.random.default_rng(0)
    away = rng.choice(len(exact.simplices), 1000)
    outside = generated.cloud[exact.simplices[away]].mean(axis=1) + 6e-4 * exact.equations[away, :3]
    assert (height(generated, outside) > 0).all()  # 0.6 mm out of the exact hull is out of this one


def test_the_ducts_exact_hull_has_two_facets_to_a_vertex():
    """Exact hull of the duct: two facets per vertex.

    A smooth wall makes most points vertices, hence thousands of facets and the duct's coarser default.
    """
    duct_points = load_workpiece(GeneratedDuct(points=5000), hull_tolerance_m=0.0)
    assert len(duct_points.hull_normal) == 2 * len(duct_points.hull_vertices) - 4
    assert len(duct_points.hull_normal) > 2000
    assert height(duct_points, duct_points.cloud).max() < 1e-12


@needs_real_duct
def test_the_measured_hull_is_exact_and_small(real):
    assert len(real.hull_normal) == 2443  # of 2,484 triangles
    assert height(real, real.cloud).max() < 1e-9
    inside = np.random.default_rng(0).dirichlet(np.ones(4), 500)
    rows = np.random.default_rng(1).integers(len(real.cloud), size=(500, 4))
    assert height(real, np.einsum("pk,pkc->pc", inside, real.cloud[rows])).max() < 1e-9


@pytest.mark.parametrize("tolerance", [1e-12, 1e-3, 0.05, 5.0])
def test_at_any_tolerance_the_hull_is_closed_and_holds_the_cloud(tolerance):
    part = load_workpiece(GeneratedDuct(points=2000), hull_tolerance_m=tolerance)
    assert height(part, part.cloud).max() < 1e-12
    far = np.random.default_rng(0).normal(size=(200, 3))
    assert (height(part, 20.0 * far / np.linalg.norm(far, axis=1)[:, None]) > 0).all()


def test_a_flat_cloud_needs_interior_none(generated):
    flat = CUBE * [1.0, 1.0, 0.0]
    with pytest.raises(InputError, match=r"cloud of sheet: the points lie in one plane.*set interior to 'none'"):
        Workpiece("sheet", flat, PATH)
    sheet = Workpiece("sheet", flat, PATH, interior="none")
    assert sheet.hull_normal.shape == (0, 3) and sheet.hull_offset.shape == (0,)
    assert sheet.interior_plane(np.eye(4)).tolist() == [1, 0, 0, 0.2]


def test_the_gate_is_behind_the_clouds_nearest_x(generated):
    for wy, wz in ((0.0, 0.0), (0.4, 0.1), (0.8, 0.8), (-1.0, 2.0)):
        T = generated.T_world(wy, wz)
        nearest = place(T, generated.cloud)[:, 0].min()
        np.testing.assert_allclose(generated.interior_plane(T), [1, 0, 0, nearest + 0.2], atol=1e-12)


# Construction


def test_arrays_are_read_only_copies():
    cloud = CUBE.copy()
    workpiece = Workpiece("cube", cloud, PATH)
    cloud[0] = 9.0
    assert np.array_equal(workpiece.cloud, CUBE)
    for name in ("cloud", "path", "pivot", "hull_normal", "hull_offset", "hull_vertices"):
        assert not getattr(workpiece, name).flags.writeable
    with pytest.raises(dataclasses.FrozenInstanceError):
        workpiece.name = "other"


@pytest.mark.parametrize("change, words", [
    ({"cloud": CUBE[:3]}, "cloud of w: 3 points, at least 4"),
    ({"cloud": CUBE[:, :2]}, r"cloud of w: the shape is \(8, 2\)"),
    ({"cloud": np.where(CUBE == 1.0, np.nan, 0.0)}, "cloud of w: row 2 contains NaN"),
    ({"path": PATH[:0]}, "path of w: 0 points"),
    ({"path": PATH * np.nan}, "path of w: row 1 contains NaN"),
    ({"inlet": (0.0, 0.0)}, "inlet is"),
    ({"pivot": (0.0, 0.0, float("nan"))}, "pivot is"),
    ({"neutral_translation": "abc"}, "neutral_translation"),
    ({"interior_depth_m": -0.1}, "interior_depth_m is -0.1"),
    ({"hull_tolerance_m": float("nan")}, "hull_tolerance_m is nan"),
    ({"interior": "mesh"}, "interior is 'mesh'; valid: hull, none"),
])  # fmt: skip
def test_bad_figures_give_one_line(monkeypatch, change, words):
    # As users run it: the type checks, which only run in tests, would fail first.
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    with pytest.raises(InputError, match=words) as caught:
        Workpiece(**{"name": "w", "cloud": CUBE, "path": PATH, **change})
    assert "\n" not in str(caught.value)


# Loading


def test_the_default_is_the_generated_duct_and_its_weld(generated):
    assert generated.name == "duct"
    assert np.array_equal(generated.cloud, duct.duct_cloud())
    assert np.array_equal(generated.path, duct.weld())
    np.testing.assert_allclose(generated.inlet, (0.0, 0.0, 0.19138), atol=0)


def test_another_cloud_brings_its_path_and_has_no_inlet_unless_given(tmp_path):
    np.savetxt(tmp_path / "part.xyz", CUBE)
    np.savetxt(tmp_path / "seam.csv", PATH, delimiter=",", header="x,y,z", comments="")
    part = load_workpiece(tmp_path / "part.xyz", tmp_path / "seam.csv")
    assert part.name == "part" and part.inlet is None and part.hull_tolerance_m == 0.0
    assert np.array_equal(part.cloud, CUBE) and np.array_equal(part.path, PATH)
    with_inlet = load_workpiece(tmp_path / "part.xyz", tmp_path / "seam.csv", inlet=(1.0, 2.0, 3.0))
    assert with_inlet.inlet.tolist() == [1.0, 2.0, 3.0]
    with pytest.raises(InputError, match=r"part.xyz: workpiece.path is missing"):
        load_workpiece(tmp_path / "part.xyz")


def test_the_duct_takes_another_path_and_can_lose_its_inlet(tmp_path):
    np.savetxt(tmp_path / "seam.csv", PATH, delimiter=",")
    workpiece = load_workpiece(GeneratedDuct(1000, seed=5), tmp_path / "seam.csv", inlet=None)
    assert workpiece.inlet is None and np.array_equal(workpiece.path, PATH)
    assert np.array_equal(workpiece.cloud, duct.duct_cloud(1000, seed=5))
    for wrong in (GeneratedDuct(points=3), GeneratedDuct(seed=-1)):
        with pytest.raises(InputError):
            load_workpiece(wrong)


@pytest.mark.parametrize("content, words", [
    ("", "the tool path is empty"), ("x,y,z\n", "the tool path is empty"),
    ("1,2,3\nnan,0,0\n", "line 2 contains NaN"), ("1,2\n", "line 1 has 2 columns"),
])  # fmt: skip
def test_bad_paths_give_one_line(tmp_path, content, words):
    (tmp_path / "seam.csv").write_text(content)
    with pytest.raises(InputError, match=words):
        read_path(tmp_path / "seam.csv")


def test_a_path_is_a_text_table_that_may_be_one_point(tmp_path):
    (tmp_path / "seam.csv").write_text("1,2,3\n")
    assert read_path(tmp_path / "seam.csv").tolist() == [[1.0, 2.0, 3.0]]
    with pytest.raises(InputError, match="no such file"):
        read_path(tmp_path / "missing.csv")
    with pytest.raises(InputError, match=r"unknown ending '.npy'; valid: .xyz .csv .txt"):
        read_path(tmp_path / "seam.npy")


def test_a_workpiece_of_arrays_is_that_of_their_files(tmp_path):
    """Workpiece from arrays: the same as from their files (regression: a TypeError)."""
    cloud, seam = duct.duct_cloud(500), duct.weld()[::9]
    np.save(tmp_path / "part.npy", cloud)
    np.savetxt(tmp_path / "seam.csv", seam, delimiter=",")
    read = load_workpiece(tmp_path / "part.npy", tmp_path / "seam.csv")
    for given in (cloud, jnp.asarray(cloud)):
        part = load_workpiece(given, seam, name="part")
        for name in ("name", "inlet", "cloud", "path", "hull_normal", "hull_offset", "interior_depth_m"):
            np.testing.assert_array_equal(getattr(part, name), getattr(read, name), err_msg=name)
    assert load_workpiece(cloud, seam).name == "cloud"
    np.testing.assert_array_equal(load_workpiece(path=seam).path, seam)


@pytest.mark.parametrize(
    ("cloud", "path", "line"),
    [
        (np.zeros((5, 2)), np.zeros((1, 3)), r"cloud: the shape is \(5, 2\); it must be \(points, 3\)"),
        (np.zeros((3, 3)), np.zeros((1, 3)), "cloud: 3 points, at least 4 are needed"),
        (np.full((9, 3), np.nan), np.zeros((1, 3)), "cloud: row 1 contains NaN"),
        (np.eye(4)[:, :3], None, "cloud: workpiece.path is missing"),
        (np.eye(4)[:, :3], np.zeros(3), r"path: the shape is \(3,\); it must be \(points, 3\)"),
        (np.eye(4)[:, :3], np.zeros((0, 3)), "path: 0 points, at least 1 are needed"),
    ],
)
def test_bad_arrays_give_one_line(cloud, path, line):
    with pytest.raises(InputError, match=line):
        load_workpiece(cloud, path)


def test_a_files_content_decides_whether_its_source_is_a_cloud_or_a_mesh(tmp_path):
    box = trimesh.creation.box()
    trimesh.PointCloud(box.vertices).export(tmp_path / "points.ply")
    box.export(tmp_path / "faces.ply")
    points, faces = read_source(tmp_path / "points.ply"), read_source(tmp_path / "faces.ply", 0.5)
    assert isinstance(points, PointCloud) and len(points.points) == 8
    assert isinstance(faces, TriangleMesh) and len(faces.triangles) == 12 and faces.spacing_m == 0.5


def test_a_workpiece_of_a_source_is_that_of_its_file(tmp_path):
    trimesh.creation.box().export(tmp_path / "part.ply")
    made = load_workpiece(read_source(tmp_path / "part.ply"), PATH)
    for part in (
        load_workpiece(tmp_path / "part.ply", PATH),
        load_workpiece(TriangleMesh(made.triangles, "part"), PATH),
    ):
        for name in ("name", "cloud", "triangles", "covering_radius_m", "hull_offset"):
            np.testing.assert_array_equal(getattr(part, name), getattr(made, name), err_msg=name)


@needs_real_duct
def test_the_measured_files_load_as_they_are(real):
    assert real.name == "cloud" and real.cloud.shape == (50_015, 3) and real.path.shape == (94, 3)
    assert np.array_equal(real.cloud, np.loadtxt(REAL / "cloud.xyz"))
    assert np.array_equal(load_cloud(REAL / "cloud.xyz"), real.cloud)
