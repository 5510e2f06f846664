"""Viewpoint of a plan: the side from which the arm hides least of the path and the tool."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from htcp_jax.viewer.viewpoints import (
    ASIDE_RAD,
    ShownBodies,
    camera_view,
    flat_side,
    hidden,
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


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_of_a_lone_arm_far_away_the_square_side_without_the_path_is_taken(side):
    cloud = np.random.default_rng(0).uniform(-1, 1, (400, 3)) * [1, 1, 0]
    targets = np.array([[-2, 0, 0], [0.9, 0.5 * side, 0]])
    away = ShownBodies(np.full((1, 2, 3), 9.0), np.full((1, 2, 3), 9.0), np.full(2, 0.1), np.array([False, True]))
    np.testing.assert_allclose(flat_side(cloud, targets, away).near, view_from_side(cloud, targets).near)


def test_an_arm_that_stands_before_the_square_side_is_looked_at_from_another():
    """Viewpoint if the arm covers the square view: another side (regression: the arm hid the part)."""
    square = view_from_side(WALL, PATH)
    before = [hidden(WALL[:0], 0.0, PATH, arm(), towards_camera(square, aside, 0.28)) for aside in ASIDE_RAD]
    chosen = camera_view(WALL, PATH, arm())
    assert square.near[0] < -0.9 and min(before) > 0.25  # from the robot's own side, the link hides the path
    assert hidden(WALL[:0], 0.0, PATH, arm(), towards_camera(*chosen, 0.28)) < 0.1


@given(st.floats(-3, 3), st.floats(0.01, 0.3))
def test_a_ball_hides_what_is_right_behind_it_and_nothing_else(aside, radius):
    ball = ShownBodies(np.zeros((1, 2, 3)), np.zeros((1, 2, 3)), np.array([radius, radius]), np.array([False, False]))
    toward = towards_camera(view_from_side(WALL, PATH), aside, 0.2)
    across = np.cross(toward, [0, 0, 1.0])
    points = np.stack([-toward, -toward + 2 * radius * across, toward])
    assert hidden(WALL[:0], 0.0, points[:1], ball, toward) == 1
    assert hidden(WALL[:0], 0.0, points[1:], ball, toward) == 0


def test_the_cloud_hides_what_is_behind_it_and_not_what_lies_on_it():
    toward = np.array([1.0, 0, 0])
    y, z = np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1, 1, 41))
    plate = np.stack([np.zeros(y.size), y.ravel(), z.ravel()], axis=1)
    none = ShownBodies(np.full((1, 1, 3), 9.0), np.full((1, 1, 3), 9.0), np.zeros(1), np.zeros(1, bool))
    for x, share in ((-0.5, 1.0), (0.0, 0.0), (0.5, 0.0)):
        assert hidden(plate, 0.075, np.array([[x, 0.01, 0.02]]), none, toward) == share


def test_the_same_plan_is_always_looked_at_from_the_same_side():
    first, second = (camera_view(WALL.copy(), PATH.copy(), arm()) for _ in range(2))
    np.testing.assert_array_equal(first.view.near, second.view.near)
    assert first.aside_rad == second.aside_rad
