"""The two plates of a fillet, found in a mesh."""

from itertools import product

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from htcp_jax.errors import InputError
from htcp_jax.jobs import load_config
from htcp_jax.jobs.build import scene
from htcp_jax.model import PathFrames, Workpiece, with_plates

UP = np.array([0.0, 0.0, 1.0])
RIB_M = 0.006  # thickness of the upright plate


def hull_triangles(corners: np.ndarray) -> np.ndarray:
    """Triangles of the convex hull of points, facing outwards."""
    hull = ConvexHull(corners)
    found = corners[hull.simplices]
    facing = np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0])
    inwards = (facing * hull.equations[:, :3]).sum(axis=1) < 0
    found[inwards] = found[inwards][:, ::-1]
    return found


def box(low, high) -> np.ndarray:
    """Triangles of a box."""
    return hull_triangles(np.array(list(product(*zip(low, high, strict=True)))))


def tee(rib_turn_deg: float = 0.0) -> np.ndarray:
    """A thin rib on a plate, whose seam is the x axis from 0 to 0.2 m; the rib's face is turned from upright."""
    rib = box((0.0, -RIB_M, 0.0), (0.2, 0.0, 0.08)) @ Rotation.from_euler("x", rib_turn_deg, degrees=True).as_matrix().T
    return np.concatenate([box((-0.05, -0.1, -0.01), (0.25, 0.1, 0.0)), rib])


def part(triangles, path, normals=None) -> Workpiece:
    return Workpiece(
        "part", triangles.reshape(-1, 3), path, triangles=triangles, interior="none", frames=PathFrames(normals)
    )


SEAM = np.linspace(0, 0.2, 9)[:, None] * np.eye(3)[0]  # from end to end of the rib


@pytest.mark.parametrize("rib_turn_deg", [0, 35, -40])
@pytest.mark.parametrize("offset_m", [0.0, 0.002])
def test_the_plates_of_a_rib_are_found_from_end_to_end_in_any_pose_and_order_of_triangles(rib_turn_deg, offset_m):
    rng = np.random.default_rng(5)
    turn = Rotation.random(rng=rng).as_matrix()
    triangles = tee(rib_turn_deg)
    triangles = triangles[rng.permutation(len(triangles))] @ turn.T
    face = Rotation.from_euler("x", rib_turn_deg, degrees=True).apply([0.0, 1.0, 0.0])
    seam = (SEAM + offset_m * (face + UP)) @ turn.T
    found = with_plates(part(triangles, seam), 0.01, turn @ UP).frames
    np.testing.assert_allclose(found.plates, np.tile([turn @ UP, turn @ face], (9, 1, 1)), atol=1e-12)
    half = turn @ (UP + face) / np.linalg.norm(UP + face)
    np.testing.assert_allclose(found.normals, np.tile(half, (9, 1)), atol=1e-12)


@pytest.mark.parametrize("within_m", [0.005, 0.008, 0.01, 0.015])
def test_the_side_of_thin_plates_that_is_next_to_the_path_is_found(within_m):
    base = box((-0.05, -0.1, -0.006), (0.25, 0.1, 0.0))
    found = with_plates(part(np.concatenate([base, tee()[12:]]), SEAM), within_m, UP).frames.plates
    np.testing.assert_allclose(found, np.tile([UP, [0, 1.0, 0]], (9, 1, 1)), atol=1e-12)


def test_plate_1_faces_the_given_direction_whatever_the_direction_of_travel():
    forward = with_plates(part(tee(), SEAM), 0.01, np.array([0.0, 1.0, 0.2]))
    backward = with_plates(part(tee(), SEAM[::-1].copy()), 0.01, np.array([0.0, 1.0, 0.2]))
    np.testing.assert_allclose(forward.frames.plates[:, 0], np.tile([0, 1.0, 0], (9, 1)), atol=1e-12)
    np.testing.assert_allclose(forward.frames.plates, backward.frames.plates[::-1], atol=1e-12)


def test_a_tube_on_a_plate_has_the_plate_and_the_facet_at_each_point():
    turns = np.linspace(0, 2 * np.pi, 73)
    ring = 0.03 * np.stack([np.cos(turns), np.sin(turns), np.zeros(73)], axis=1)
    tube = hull_triangles(np.concatenate([ring[:-1], ring[:-1] + 0.05 * UP]))
    triangles = np.concatenate([box((-0.1, -0.1, -0.01), (0.1, 0.1, 0.0)), tube])
    found = with_plates(part(triangles, ring), 0.008, UP).frames.plates
    outwards = ring / 0.03
    np.testing.assert_allclose(found[:, 0], np.tile(UP, (73, 1)), atol=1e-12)
    assert np.linalg.norm(found[:, 1] - outwards, axis=1).max() < np.deg2rad(3)  # half a facet's turn


def test_a_rounded_root_is_neither_plate():
    turns = np.linspace(np.pi, 1.5 * np.pi, 8)
    root = 0.003 * np.stack([1 + np.cos(turns), 1 + np.sin(turns)], axis=1)
    outline = np.concatenate([[[0.0, 0.05]], root, [[0.05, 0.0]]])  # y and z from the rib to the plate
    ends = [np.insert(outline, 0, x, axis=1) for x in (-0.01, 0.21)]
    (a, b), (c, d) = ((end[:-1], end[1:]) for end in ends)
    triangles = np.concatenate([np.stack(three, axis=1) for three in ((a, c, b), (b, c, d))])
    found = with_plates(part(triangles, SEAM, np.tile([0, 1.0, 1.0], (9, 1)) / np.sqrt(2)), 0.012, UP).frames.plates
    np.testing.assert_allclose(found, np.tile([UP, [0, 1.0, 0]], (9, 1, 1)), atol=1e-12)


def test_a_files_normals_decide_the_side_of_plates_whose_triangles_face_the_other_way():
    normals = np.tile([0, 1.0, 1.0], (9, 1)) / np.sqrt(2)
    found = with_plates(part(tee()[:, ::-1].copy(), SEAM, normals), 0.01, UP).frames
    np.testing.assert_allclose(found.plates, np.tile([UP, [0, 1.0, 0]], (9, 1, 1)), atol=1e-12)
    np.testing.assert_array_equal(found.normals, normals)


def test_plates_that_cannot_be_found_are_refused_in_one_line():
    flat = box((-0.05, -0.1, -0.01), (0.25, 0.1, 0.0))
    away = SEAM + np.array([0, 0, 0.5])
    given = np.tile([UP, [0, 1.0, 0]], (9, 1, 1))
    for workpiece, message in (
        (part(flat, SEAM), "within 10 mm of point 1 of the path the part has 1 plate, but a fillet has two"),
        (part(flat, away), "within 10 mm of point 1 of the path the part has no plates, but a fillet has two"),
        (Workpiece("cloud", flat.reshape(-1, 3), SEAM, interior="none"), "cloud has no mesh; add columns n1x ... n2z"),
        (
            Workpiece("p", flat.reshape(-1, 3), SEAM, triangles=flat, interior="none", frames=PathFrames(plates=given)),
            "the path's file has the plates' normals; omit the key or these columns",
        ),
    ):
        with pytest.raises(InputError, match=message):
            with_plates(workpiece, 0.01, UP)


def stl(triangles: np.ndarray) -> bytes:
    """A binary STL file."""
    rows = np.zeros(len(triangles), dtype=[("n", "<3f4"), ("v", "<9f4"), ("a", "<u2")])
    rows["v"] = triangles.reshape(-1, 9)
    return bytes(80) + np.uint32(len(rows)).tobytes() + rows.tobytes()


def test_a_jobs_goals_are_the_same_with_plates_from_the_mesh_and_from_the_file(tmp_path):
    (tmp_path / "tee.stl").write_bytes(stl(tee()))
    rows = [[*point, 0, 0, 1, 0, 1, 0] for point in SEAM]
    for name, header, width in (("mesh", "x,y,z", 3), ("file", "x,y,z,n1x,n1y,n1z,n2x,n2y,n2z", 9)):
        lines = [header, *[",".join(map(str, row[:width])) for row in rows]]
        (tmp_path / f"{name}.csv").write_text("\n".join(lines) + "\n")
    job = """
robot: {{model: gp50}}
workpiece: {{cloud: tee.stl, path: {path}, interior: none, inlet_direction: null, {plates} shift_m: [1.0, 0.0, 0.5]}}
task:
  - {{point: tcp, on: path}}
  - {{tool_axis: tcp.z, work_angle_deg: [40, 50], work_angle_from: plate_1, travel_angle_deg: [0, 10]}}
start_rad: auto
"""
    goals = []
    for path, plates in (("mesh.csv", "plates: {within_m: 0.01, plate_1_faces: [0, 0, 1]},"), ("file.csv", "")):
        (tmp_path / "job.yaml").write_text(job.format(path=path, plates=plates))
        _, _, scenario = scene(load_config(tmp_path / "job.yaml"))
        goals.append(np.array(scenario.goals))
    np.testing.assert_allclose(goals[0], goals[1], atol=1e-9)
