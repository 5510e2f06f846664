"""Facets that points lie beyond: the same by brute force, in a batch, and for any core of the hull."""

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest

from htcp_jax.backend import Backend, compiled_for, triton
from htcp_jax.clearance.distance.half_spaces import ROUNDING_M, crossed_facets, depths, half_spaces
from htcp_jax.model.workpiece import convex_hull

NEEDS_KERNEL = pytest.mark.skipif(triton() is None, reason="this JAX has no Triton backend of Pallas")
RNG = np.random.default_rng(0)


def duct_hull():
    duct = made_once.duct()
    return np.asarray(duct.hull_normal), np.asarray(duct.hull_offset)


def crossed(normal, offset, points, requested=None, vertices=None):
    requested = np.ones(len(points), bool) if requested is None else requested
    hull = half_spaces(normal, offset, made_once.duct().hull_vertices if vertices is None else vertices)
    return np.asarray(made_once.quick_jit(crossed_facets)(hull, jnp.asarray(points), jnp.asarray(requested)))


def points_about(normal, offset, count):
    """Random points around the duct, and points 1e-12 m to 0.1 m from a facet, on either side."""
    cloud = made_once.duct().cloud
    everywhere = RNG.uniform(cloud.min(0) - 0.3, cloud.max(0) + 0.3, (count, 3))
    facet = RNG.integers(len(normal), size=count)
    corners = made_once.duct().hull_vertices
    vertices = corners[np.argmax(corners @ normal[facet].T, axis=0)]  # one point that touches each facet
    depth = RNG.choice([-1, 1], count) * 10.0 ** RNG.uniform(-12, -1, count)
    return np.concatenate([everywhere, vertices + depth[:, None] * normal[facet]])


def test_the_facet_crossed_is_the_one_furthest_beyond():
    normal, offset = duct_hull()
    points = points_about(normal, offset, 1000)
    height = points @ normal.T - offset
    facet = crossed(normal, offset, points)
    outside = height.max(1) > 1e-15
    inside = height.max(1) < -1e-15
    assert 300 < outside.sum() < 1800 and inside.sum() > 300
    assert (facet[inside] == -1).all()
    np.testing.assert_allclose(height[outside, facet[outside]], height.max(1)[outside], rtol=0, atol=1e-15)


def test_without_a_facet_every_point_is_infinitely_deep_inside():
    points, requested = jnp.asarray(RNG.normal(size=(50, 3))), jnp.ones(50, bool)
    everywhere = half_spaces(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))
    assert (made_once.quick_jit(crossed_facets)(everywhere, points, requested) == -1).all()
    assert (made_once.quick_jit(depths)(everywhere, points, requested) == np.inf).all()


def test_a_point_not_asked_about_has_crossed_nothing():
    normal, offset = duct_hull()
    points = points_about(normal, offset, 200)
    requested = RNG.random(len(points)) < 0.5
    np.testing.assert_array_equal(
        crossed(normal, offset, points, requested), np.where(requested, crossed(normal, offset, points), -1)
    )
    assert (crossed(normal, offset, points, np.zeros(len(points), bool)) == -1).all()


def test_one_point_near_the_boundary_does_not_change_the_others():
    """Check other points: if one point needs the exact evaluation, all get it, and their results must not change."""
    normal, offset = duct_hull()
    middle = made_once.duct().cloud.mean(0)
    far = middle + 3.0
    on = made_once.duct().hull_vertices[0]
    for points in ([middle, far], [middle, far, on], [on, middle, far]):
        facet = crossed(normal, offset, np.array(points))
        heights = np.array(points) @ normal.T - offset
        for k, point in enumerate(points):
            if point is not on:
                assert facet[k] == (np.argmax(heights[k]) if heights[k].max() > 0 else -1)


def test_the_core_lies_inside_the_hull_and_fills_most_of_it():
    normal, offset = duct_hull()
    hull = half_spaces(normal, offset, made_once.duct().hull_vertices)
    points = points_about(normal, offset, 4000)[:4000]
    inside = (points @ normal.T - offset).max(1) <= 0
    core = (points @ np.asarray(hull.core[:3]) - np.asarray(hull.core[3])).max(1) <= 0
    assert inside[core].all()
    assert core.sum() > 0.8 * inside.sum()


def test_a_hull_too_thin_for_a_core_is_measured_all_the_same():
    needle = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0], [1, 0, 0]])
    normal, offset = np.eye(3), np.array([1.0, 0.0, 0.0])
    points = np.array([[0.5, -1, -1], [2.0, -1, -1], [0.5, 0.25, -1]])
    np.testing.assert_array_equal(crossed(normal, offset, points, vertices=needle), [-1, 0, 1])


def test_32_bit_heights_are_within_their_room_up_to_20_metres():
    normal = RNG.normal(size=(2000, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    offset = RNG.uniform(0, 20, 2000)
    points = RNG.uniform(-1, 1, (200, 3)) * 20 / np.sqrt(3)
    exact = points @ normal.T - offset
    narrow = np.float32(points) @ np.float32(normal).T - np.float32(offset)
    assert np.abs(narrow - exact).max() < ROUNDING_M


def test_a_cube_is_crossed_where_its_faces_are():
    corners = np.stack(np.meshgrid(*[[0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    hull = convex_hull(corners, 0.0, "cube")
    for axis in range(3):
        for side, sign in ((0.0, -1.0), (1.0, 1.0)):
            for beyond in (1e-9, 1e-3, 2.0):
                point = np.full(3, 0.5)
                point[axis] = side + sign * beyond
                (facet,) = crossed(hull.normal, hull.offset, point[None], vertices=corners)
                np.testing.assert_allclose(hull.normal[facet], sign * np.eye(3)[axis], atol=1e-12)
                point[axis] = side - sign * beyond * 0.1
                assert crossed(hull.normal, hull.offset, point[None], vertices=corners) == -1


def test_a_batch_equals_one_after_the_other():
    normal, offset = duct_hull()
    hull = half_spaces(normal, offset, made_once.duct().hull_vertices)
    points = jnp.asarray(points_about(normal, offset, 40)).reshape(10, 8, 3)
    requested = jnp.asarray(RNG.random((10, 8)) < 0.7)
    together = made_once.quick_jit(jax.vmap(crossed_facets, in_axes=(None, 0, 0)))(hull, points, requested)
    alone = made_once.quick_jit(crossed_facets)
    np.testing.assert_array_equal(together, [alone(hull, *each) for each in zip(points, requested, strict=True)])


def test_a_depth_is_never_more_than_the_true_one():
    normal, offset = duct_hull()
    hull = half_spaces(normal, offset, made_once.duct().hull_vertices)
    points = points_about(normal, offset, 500)
    found = np.asarray(made_once.quick_jit(depths)(hull, points, np.ones(len(points), bool)))
    true = np.maximum(-(points @ normal.T - offset).max(1), 0)
    assert (found <= true + 1e-15).all() and (found > 0).sum() > 0.9 * (true > 0).sum()


@pytest.mark.parametrize("kernel", [pytest.param(True, marks=NEEDS_KERNEL), False])
@pytest.mark.parametrize("ask", [crossed_facets, depths])
def test_a_gpu_finds_the_same_with_a_kernel_and_without(ask, kernel):
    """Compare a batch of points, some requested; the kernel is interpreted, as there is no GPU here."""
    normal, offset = duct_hull()
    hull = half_spaces(normal, offset, made_once.duct().hull_vertices)
    points = jnp.asarray(points_about(normal, offset, 200)).reshape(25, 16, 3)
    requested = jnp.asarray(RNG.random((25, 16)) < 0.7)
    expected = made_once.quick_jit(jax.vmap(ask, in_axes=(None, 0, 0)))(hull, points, requested)
    with compiled_for(Backend("gpu", kernel, interprets=True)):
        found = made_once.quick_jit(jax.vmap(ask, in_axes=(None, 0, 0)))(hull, points, requested)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7)  # the kernel uses 32-bit values
