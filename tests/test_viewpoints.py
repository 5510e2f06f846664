"""Viewpoint of a plan: the side from which the arm hides least of the path and the tool."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from htcp_jax.viewer.viewpoints import (
    ABOVE_RAD,
    ASIDE_RAD,
    PartAxis,
    ShownBodies,
    ShownScene,
    View,
    Viewpoint,
    best_views,
    camera_views,
    flat_side,
    hidden_targets,
    shadowed,
    towards_camera,
    view_from_side,
)

WALL = np.random.default_rng(0).uniform([0.8, -0.3, 0], [1.4, 0.3, 0.5], (400, 3))
PATH = np.linspace([1.3, -0.2, 0.1], [1.3, 0.2, 0.1], 30)  # across the far end, as a seam in a box's corner


def arm(thick: float = 0.12) -> ShownBodies:
    """A link from the origin towards the path, and a tool at its end."""
    p = np.array([[[0.0, 0, 0.4], [1.0, 0, 0.3]]])
    q = np.array([[[1.0, 0, 0.3], [1.3, 0, 0.1]]])
    return ShownBodies(p, q, np.array([thick, 0.01]), np.array([False, True]))


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_near_half_is_the_one_without_the_path(side):
    cloud = np.random.default_rng(0).uniform(-1, 1, (100, 3))
    targets = np.array([[-2, 0, 0], [0.9, 0.5 * side, 0]])
    view = view_from_side(cloud, targets)
    assert view.near @ targets[-1] < view.near @ cloud.mean(axis=0)
    np.testing.assert_allclose(np.cross(view.right, view.up), view.near, atol=1e-12)


def test_of_a_lone_arm_far_away_the_square_side_is_taken():
    """The part lies below the path and hides nothing, so it stays whole."""
    cloud = np.random.default_rng(0).uniform(-1, 1, (400, 3)) * [1, 1, 0]
    targets = np.array([[-0.9, 0, 0.5], [0.9, 0.5, 0.5]])
    away = ShownBodies(np.full((1, 2, 3), 9.0), np.full((1, 2, 3), 9.0), np.full(2, 0.1), np.array([False, True]))
    chosen = flat_side(ShownScene(cloud, targets, away))
    np.testing.assert_allclose(chosen.view.near, view_from_side(cloud, targets).near)
    assert not chosen.cut


def test_an_arm_that_stands_before_the_square_side_is_looked_at_from_another():
    """Viewpoint if the arm covers the square view: another side (regression: the arm hid the part)."""
    scene = ShownScene(WALL, PATH, arm(), triangles=np.full((1, 3, 3), 9.0))
    square = view_from_side(WALL, PATH)
    axis = PartAxis("+x", square.near)
    before = [hidden_targets(scene, Viewpoint(square, aside, ABOVE_RAD[0], 0.0, axis)).mean() for aside in ASIDE_RAD]
    assert square.near[0] < -0.9 and min(before) > 0.25  # from the robot's own side, the link hides the path
    for chosen in camera_views([scene]):
        assert hidden_targets(scene, chosen).mean() < 0.1  # the tool hides the target that it touches


def box(sides: str) -> np.ndarray:
    """Sides of the unit cube around the path, as triangles: -x, +x, -y, +y, -z or +z."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    found = []
    for sign, axis in zip(sides[::2], sides[1::2], strict=True):
        k, square = "xyz".index(axis), np.empty((4, 3))
        square[:, [(k + 1) % 3, (k + 2) % 3]], square[:, k] = corners, 1 if sign == "+" else -1
        found += [square[[0, 1, 2]], square[[0, 2, 3]]]
    return 0.5 * np.array(found) + [1.3, 0, 0.3]


def test_the_chosen_sides_hide_hardly_a_target_where_the_worst_hides_all():
    mesh = box("+x-x-y+y+z-z")
    scene = ShownScene(mesh.reshape(-1, 3), PATH, arm(), mesh)
    every = best_views([scene], ASIDE_RAD, ABOVE_RAD)
    counts = [int(hidden_targets(scene, each).sum()) for each in every]
    chosen = camera_views([scene])
    assert all(each.cut for each in chosen)  # a closed box is cut open
    np.testing.assert_array_equal(chosen[0].toward, every[0].toward)
    shown = [int(hidden_targets(scene, each).sum()) for each in chosen]
    assert max(shown) < 0.1 * len(PATH) and max(counts) == len(PATH)
    assert chosen[0].toward[:2] @ chosen[1].toward[:2] < np.cos(np.radians(59)) * np.prod(
        [np.linalg.norm(each.toward[:2]) for each in chosen]
    )


def test_a_part_with_one_open_side_is_seen_from_there_and_stays_whole():
    mesh = box("-x-y+y-z+z")
    scene = ShownScene(mesh.reshape(-1, 3), PATH, arm(0.001), mesh)
    chosen = camera_views([scene])[0]
    assert not chosen.cut and chosen.toward[0] > 0.6 and hidden_targets(scene, chosen).mean() < 0.1


@given(st.floats(-3, 3), st.floats(0.01, 0.3))
def test_a_ball_hides_what_is_right_behind_it_and_nothing_else(aside, radius):
    ball = ShownBodies(np.zeros((1, 2, 3)), np.zeros((1, 2, 3)), np.array([radius, radius]), np.array([False, False]))
    at = Viewpoint(view := view_from_side(WALL, PATH), aside, 0.2, 0.0, PartAxis("+x", view.near))
    across = np.cross(at.toward, [0, 0, 1.0])
    points = np.stack([-at.toward, -at.toward + 2 * radius * across, at.toward])
    scene = ShownScene(np.full((4, 3), 9.0), points, ball, np.full((1, 3, 3), 9.0))
    np.testing.assert_array_equal(hidden_targets(scene, at), [[True, False, False]])


def test_the_cloud_hides_what_is_behind_it_and_not_what_lies_on_it():
    y, z = np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1, 1, 41))
    plate = np.stack([np.zeros(y.size), y.ravel(), z.ravel()], axis=1)
    none = ShownBodies(np.full((1, 1, 3), 9.0), np.full((1, 1, 3), 9.0), np.zeros(1), np.zeros(1, bool))
    view = view_from_side(plate, np.array([[-1, -1, 0], [-1, 1.0, 0]]))
    path = np.array([[-0.5, 0.01, 0.02], [0.0, 0.01, 0.02], [0.5, 0.01, 0.02]])
    np.testing.assert_allclose(view.near, [1, 0, 0], atol=1e-12)
    for cut, shares in ((0.0, [True, False, False]), (0.5, [True, False, False])):
        found = hidden_targets(ShownScene(plate, path, none), Viewpoint(view, 0.0, 0.0, cut, PartAxis("+x", view.near)))
        np.testing.assert_array_equal(found, [shares])


@given(st.integers(0, 2**32 - 1))
def test_a_ray_meets_the_triangles_that_its_equations_say(seed):
    rng = np.random.default_rng(seed)
    triangles, points = rng.uniform(-1, 1, (6, 3, 3)), rng.uniform(-1, 1, (5, 3))
    toward = towards_camera(view_from_side(WALL, PATH), *rng.uniform(-1, 1, 2))
    expected = []
    for point in points:
        edges = np.stack([triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]], axis=2)
        solved = np.linalg.solve(
            np.concatenate([edges, np.tile(-toward, (6, 1))[..., None]], 2), (point - triangles[:, 0])[..., None]
        )
        u, v, along = solved[..., 0].T
        expected.append(bool(((u >= 0) & (v >= 0) & (u + v <= 1) & (along > 0.005)).any()))
    np.testing.assert_array_equal(shadowed(points, triangles, toward), expected)


def cuboid(low, high) -> np.ndarray:
    """Triangles of an axis-aligned box, from its lowest to its highest corner."""
    return (box("-x+x-y+y-z+z") - [1.3, 0, 0.3] + 0.5) * np.subtract(high, low) + low


def fillet(*walls: np.ndarray) -> ShownScene:
    """A seam at the foot of a rib on a plate, with a torch that leans away from the rib, and walls on the plate."""
    plate, rib = cuboid([0.8, -0.26, 0], [1.2, 0.26, 0.01]), cuboid([0.9, -0.004, 0.01], [1.17, 0.004, 0.12])
    mesh = np.concatenate([plate, rib, *walls])
    seam = np.linspace([0.96, -0.004, 0.01], [1.14, -0.004, 0.01], 31)
    leans, middle = np.array([0, -(0.5**0.5), 0.5**0.5]), seam[15]
    p, q = middle + np.outer([0.027, 0.2], leans), middle + np.outer([0.2, 0.5], leans)
    torch = ShownBodies(
        p[None], q[None], np.array([0.012, 0.06]), np.array([True, False]), tip=middle[None] + 0.005 * leans
    )
    cloud = np.concatenate([mesh.mean(axis=1), mesh.reshape(-1, 3)])
    return ShownScene(cloud, seam, torch, mesh)


def walls(height: float) -> list[np.ndarray]:
    """Four walls on the edges of the plate."""
    return [
        cuboid([1.19, -0.26, 0.01], [1.2, 0.26, height]),
        cuboid([0.8, -0.26, 0.01], [0.81, 0.26, height]),
        cuboid([0.8, -0.26, 0.01], [1.2, -0.25, height]),
        cuboid([0.8, 0.25, 0.01], [1.2, 0.26, height]),
    ]


def shows_tip(scene: ShownScene, at: Viewpoint) -> bool:
    """Walk from the tip to the camera in steps of 1 mm: no step is in a body, or in the part in front of the cut."""
    steps = scene.arm.tip[0] + 0.001 * np.arange(2, 600)[:, None] * at.toward
    depth = scene.cloud @ at.axis.direction
    for corners in scene.triangles.reshape(-1, 36, 3):
        inside = ((steps > corners.min(axis=0)) & (steps < corners.max(axis=0))).all(axis=1)
        if (inside & (steps @ at.axis.direction <= depth.max() - at.cut * np.ptp(depth))).any():
            return False
    for p, q, radius in zip(scene.arm.p[0], scene.arm.q[0], scene.arm.radius, strict=True):
        share = np.clip((steps - p) @ (q - p) / ((q - p) @ (q - p)), 0, 1)
        if (np.linalg.norm(steps - p - share[:, None] * (q - p), axis=1) < radius).any():
            return False
    return True


def test_a_fillet_on_an_open_plate_is_seen_complete_with_its_tip_from_two_sides():
    scene = fillet()
    first, second = camera_views([scene])
    assert not first.cut and not second.cut and shows_tip(scene, first) and shows_tip(scene, second)
    assert (np.array([first.toward[1], second.toward[1]]) < 0.35).all()  # not from behind the rib
    behind = View(np.array([-1.0, 0, 0]), np.array([0.0, 0, 1]), np.array([0.0, 1, 0]))
    assert not shows_tip(scene, Viewpoint(behind, 0.0, ABOVE_RAD[0], 0.0, PartAxis("+y", behind.near)))


def test_a_part_that_shows_the_seam_over_its_walls_is_not_cut():
    scene = fillet(*walls(0.17))
    for each in camera_views([scene]):
        assert not each.cut and shows_tip(scene, each) and hidden_targets(scene, each).mean() < 0.5


def test_a_cut_in_front_of_a_fillet_keeps_the_plate_next_to_the_seam():
    scene = fillet(*walls(0.6))
    chosen = camera_views([scene])
    assert all(each.cut for each in chosen) and all(shows_tip(scene, each) for each in chosen)
    for each in chosen:
        depth = scene.cloud @ each.axis.direction
        cut = depth.max() - each.cut * np.ptp(depth)
        assert (scene.path @ each.axis.direction).max() + 0.029 < cut or not each.cut


@given(st.floats(-3, 3))
def test_a_cut_is_perpendicular_to_an_axis_of_the_turned_part_and_says_which(turn):
    c, s = np.cos(turn), np.sin(turn)
    axes = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    scene = fillet(*walls(0.6))
    cloud, path, mesh = scene.cloud @ axes.T, scene.path @ axes.T, scene.triangles @ axes.T
    bodies = scene.arm._replace(p=scene.arm.p @ axes.T, q=scene.arm.q @ axes.T, tip=scene.arm.tip @ axes.T)
    for each in camera_views([ShownScene(cloud, path, bodies, mesh, part_axes=axes)]):
        sign, name = each.axis.name
        np.testing.assert_allclose(each.axis.direction, (1 if sign == "+" else -1) * axes[:, "xyz".index(name)])
        assert each.cut and f"perpendicular to its {name} axis" in each.cut_text
        assert each.view.near @ each.axis.direction > 0.99  # the camera looks at the plane of the cut


def test_the_same_plan_is_always_looked_at_from_the_same_side():
    first, second = (camera_views([ShownScene(WALL.copy(), PATH.copy(), arm())]) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.toward, other.toward)
        assert one[1:4] == other[1:4] and one.axis.name == other.axis.name
