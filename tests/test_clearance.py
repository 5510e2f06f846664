"""Clearance D(x, O): equal to plain numpy over all points, to MuJoCo's distances, and to the recorded run."""

from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import made_once
import mujoco
import numpy as np
import pytest

from htcp_jax.backend import Backend, compiled_for
from htcp_jax.clearance import clearance, clearances, contacts, is_clear
from htcp_jax.clearance.obstacles.linearisation import linearise
from htcp_jax.clearance.obstacles.obstacles import all_clear, clearance_rows
from htcp_jax.clearance.obstacles.of_workpiece import make_obstacle
from htcp_jax.model import Workpiece
from htcp_jax.model.kinematics import capsule_segments
from htcp_jax.model.robot import GP50, lengthen_tool
from htcp_jax.model.scenario import make_scenario


class Where(NamedTuple):
    T_world_workpiece: jax.Array
    interior_plane: jax.Array


def posed(workpiece, wy=0.4, wz=0.1) -> Where:
    T = workpiece.T_world(wy, wz)
    return Where(jnp.asarray(T), jnp.asarray(workpiece.interior_plane(T)))


@cache
def configurations() -> np.ndarray:
    """Configurations of the GP50 far from the duct, at its mouth, deep in it and through its wall (M, N)."""
    robot = made_once.robot()
    inside = np.load(made_once.RECORDED)["x"]
    return np.concatenate(
        [
            made_once.configurations(robot, 60),
            made_once.configurations_near(made_once.START, 40, 0.5),
            inside[:60],
            *(made_once.configurations_near(x, 1, 0.15, seed) for seed, x in enumerate(inside[60:120])),
        ]
    )


@cache
def jitted(function):
    """`function` of (robot, obstacle, where, x), compiled once for all tests."""
    return jax.jit(function)


_ENDS = jax.jit(capsule_segments)


def numpy_clearances(robot, workpiece: Workpiece, where: Where, x):
    """D per body by brute force in numpy over all points and facets, and True where the hull decides it."""
    p, q = (np.asarray(end) for end in _ENDS(robot, x))
    T = np.asarray(where.T_world_workpiece)
    points = workpiece.cloud @ T[:3, :3].T + T[:3, 3]
    D, hull = np.empty(len(p)), np.zeros(len(p), bool)
    for k in range(len(p)):
        d = q[k] - p[k]
        s = np.clip((points - p[k]) @ d / (d @ d or 1.0), 0, 1)
        D[k] = np.linalg.norm(p[k] + s[:, None] * d - points, axis=1).min() - robot.capsule_radius[k]
        for end in (p[k], q[k]):
            local = T[:3, :3].T @ (end - T[:3, 3])
            outside = np.max(workpiece.hull_normal @ local - workpiece.hull_offset)
            if end @ where.interior_plane[:3] > where.interior_plane[3] and outside > 0 and -outside < D[k]:
                D[k], hull[k] = -outside, True
    return D, hull


def test_D_is_the_smallest_distance_to_all_points_and_minus_the_depth_outside_the_hull():
    robot, obstacle = made_once.scene()[:2]
    duct = made_once.duct()
    decided = 0
    for wy, wz in ((0.4, 0.1), (0.2, -0.3)):
        where = posed(duct, wy, wz)
        for x in configurations()[::3]:
            exact, hull = numpy_clearances(robot, duct, where, x)
            touch = jitted(contacts)(robot, obstacle, where, x)
            np.testing.assert_allclose(touch.distance, exact, rtol=0, atol=2e-15)
            np.testing.assert_array_equal(touch.plane, hull)
            decided += hull.sum()
    assert decided > 20


def test_all_forms_of_D_agree():
    """Scalar, verdict, and linearisation compute the same number with fewer operations."""
    robot, obstacle = made_once.scene()[:2]
    signs = []
    for wy, wz in ((0.4, 0.1), (0.8, 0.3)):
        where = posed(made_once.duct(), wy, wz)
        for x in configurations():
            every = jitted(clearances)(robot, obstacle, where, x)
            np.testing.assert_allclose(jitted(clearance)(robot, obstacle, where, x), every.min(), rtol=0, atol=1e-15)
            linear = jitted(linearise)(robot, obstacle, where, x)
            np.testing.assert_allclose(linear.clearance.distance, every, rtol=0, atol=1e-15)
            assert jitted(is_clear)(robot, obstacle, where, x) == (every.min() > 0)
            signs.append(every.min() > 0)
    assert 50 < np.sum(signs) < len(signs) - 50


def test_where_only_the_smallest_row_is_asked_for_it_is_right_and_no_other_is_nearer():
    """Check the smallest row, which then is the only row of a linearisation."""
    robot, obstacle = made_once.scene()[:2]
    where, x = posed(made_once.duct()), configurations()

    def rows(look, smallest):
        return jax.jit(jax.vmap(lambda x: look(robot, obstacle, where, x, smallest=smallest)))(x)

    every, few = rows(clearance_rows, False), rows(clearance_rows, True)
    lowest = np.arange(len(x)), np.argmin(every.distance, axis=1)
    np.testing.assert_allclose(few.distance[lowest], every.distance[lowest], rtol=0, atol=1e-15)
    np.testing.assert_allclose(few.gradient[lowest], every.gradient[lowest], rtol=0, atol=1e-12)
    assert (few.distance >= every.distance - 1e-15).all() and (few.distance > every.distance + 1e-3).any()
    alone = rows(linearise, True).clearance
    np.testing.assert_allclose(alone.distance, few.distance[lowest][:, None], rtol=0, atol=1e-15)
    np.testing.assert_allclose(alone.gradient, few.gradient[lowest][:, None], rtol=0, atol=1e-12)


def test_contacts_lie_where_they_say():
    """The contact point is on the body's axis; point - (distance + radius) normal is the cloud's point."""
    robot, obstacle = made_once.scene()[:2]
    duct, where = made_once.duct(), posed(made_once.duct())
    T = np.asarray(where.T_world_workpiece)
    for x in configurations()[::4]:
        touch = jax.tree.map(np.asarray, jitted(contacts)(robot, obstacle, where, x))
        p, q = (np.asarray(end) for end in _ENDS(robot, x))
        along = np.linalg.norm(touch.point - p, axis=1) + np.linalg.norm(q - touch.point, axis=1)
        np.testing.assert_allclose(along, np.linalg.norm(q - p, axis=1), atol=1e-14)
        np.testing.assert_allclose(np.linalg.norm(touch.normal, axis=1), 1.0, atol=1e-14)
        witness = touch.point - touch.normal * (touch.distance + robot.capsule_radius)[:, None]
        points = duct.cloud @ T[:3, :3].T + T[:3, 3]
        nearest = np.linalg.norm(points[None] - witness[~touch.plane][:, None], axis=2).min(axis=1)
        np.testing.assert_allclose(nearest, 0.0, atol=1e-14)


def gradients(robot, obstacle, where, x):
    """Gradients of D (4, K, N) by four methods.

    The rule for D's derivative; autodiff through the nearest points, forward and reverse; and central differences.
    """
    function = partial(jitted(clearances), robot, obstacle, where)
    step = 1e-7 * np.eye(len(x))
    differences = [(np.asarray(function(x + h)) - np.asarray(function(x - h))) / 2e-7 for h in step]
    return (
        np.asarray(jitted(linearise)(robot, obstacle, where, x).clearance.gradient),
        np.asarray(jitted(_FORWARD)(robot, obstacle, where, x)),
        np.asarray(jitted(_REVERSE)(robot, obstacle, where, x)),
        np.stack(differences, axis=1),
    )


def nearest(robot, obstacle, where, x):
    """D per row, without the custom derivative rule."""
    return contacts(robot, obstacle, where, x).distance


_FORWARD, _REVERSE = jax.jacfwd(nearest, argnums=3), jax.jacrev(nearest, argnums=3)


def test_the_derivative_of_D_is_that_of_autodiff_through_what_is_nearest_and_of_finite_differences():
    """Except at kinks, where the two sides of a central difference see different points."""
    robot, obstacle = made_once.scene()[:2]
    where = posed(made_once.duct())
    kinks, hull, total = 0, 0, 0
    for x in configurations()[::2]:
        closed, forward, reverse, differences = gradients(robot, obstacle, where, x)
        np.testing.assert_allclose(forward, closed, rtol=0, atol=1e-12)
        np.testing.assert_allclose(reverse, closed, rtol=0, atol=1e-12)
        smooth = np.abs(differences - closed).max(1) < 1e-6
        kinks, total = kinks + (~smooth).sum(), total + len(smooth)
        hull += np.asarray(jitted(contacts)(robot, obstacle, where, x).plane).sum()
    assert kinks <= 0.002 * total
    assert hull > 20


FEW = 50  # points: the same number in all tests, so that they share one compiled program


def few_points(cloud) -> Workpiece:
    """Workpiece of just these points, in the world frame."""
    cloud = np.resize(cloud, (FEW, 3))
    home = (0.0, 0.0, 0.0)
    return Workpiece("points", cloud, np.zeros((1, 3)), pivot=home, neutral_translation=home, interior="none")


def test_the_gradient_is_finite_where_a_point_lies_on_a_capsules_axis():
    """Points on an axis, at its end, and in the centre of a sphere: their distance is 0 and has no direction."""
    robot = made_once.robot()
    x = jnp.asarray(made_once.START)
    p, q = (np.asarray(end) for end in _ENDS(robot, x))
    cloud = np.concatenate([p, q, 0.3 * p + 0.7 * q])
    obstacle, where = make_obstacle(few_points(cloud)), Where(jnp.eye(4), jnp.array([1.0, 0, 0, 100.0]))
    for gradient in gradients(robot, obstacle, where, x)[:3]:
        assert np.isfinite(gradient).all()
    np.testing.assert_allclose(jitted(clearances)(robot, obstacle, where, x), -robot.capsule_radius, atol=1e-15)
    assert not jitted(is_clear)(robot, obstacle, where, x)


def test_without_an_interior_only_the_points_count():
    """Check a workpiece without a hull: no point is in its interior, however deep the arm reaches."""
    robot, rng = made_once.robot(), np.random.default_rng(0)
    workpiece = few_points(rng.normal((1.5, 0.0, 1.0), 1.0, (FEW, 3)))
    obstacle = make_obstacle(workpiece)
    where = Where(jnp.eye(4), jnp.array([1.0, 0, 0, -100.0]))
    for x in configurations()[:20]:
        exact, hull = numpy_clearances(robot, _without_hull(workpiece), where, x)
        np.testing.assert_allclose(jitted(clearances)(robot, obstacle, where, x), exact, rtol=0, atol=2e-15)
        np.testing.assert_allclose(jitted(clearance)(robot, obstacle, where, x), exact.min(), rtol=0, atol=2e-15)
        assert not hull.any()


class _Everything(NamedTuple):
    cloud: np.ndarray
    hull_normal: np.ndarray
    hull_offset: np.ndarray


def _without_hull(workpiece):
    return _Everything(workpiece.cloud, np.eye(3)[:1], np.array([np.inf]))


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.6, -0.8, 0.0)])
def test_the_gate_is_a_plane_and_only_ends_beyond_it_must_be_inside(direction):
    """Regression: the gate was only correct along the world's x axis."""
    robot, obstacle = made_once.scene()[:2]
    x = jnp.asarray(configurations()[0])
    p, q = (np.asarray(end) for end in _ENDS(robot, x))
    T = jnp.asarray(made_once.duct().T_world(0.4, 0.1)).at[:3, 3].add(100.0)  # the hull is far from everything
    furthest = np.maximum(p @ np.array(direction), q @ np.array(direction))
    order = np.sort(furthest)
    for offset in np.concatenate([[order[0] - 1], (order[1:] + order[:-1]) / 2, [order[-1] + 1]]):
        crossed = jitted(contacts)(robot, obstacle, Where(T, jnp.array([*direction, offset])), x).plane
        np.testing.assert_array_equal(crossed, furthest > offset)


def test_mujocos_own_geometry_measures_the_same():
    """Compare every capsule of the model with MuJoCo's distances to tiny spheres."""
    rng = np.random.default_rng(1)
    cloud = rng.normal((1.2, 0.0, 1.2), 0.6, (FEW, 3))
    radius = 1e-4
    spec = mujoco.MjSpec.from_file(str(GP50))
    for k, point in enumerate(cloud):
        spec.worldbody.add_geom(name=f"point{k}", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], pos=point)
    model = spec.compile()
    data = mujoco.MjData(model)
    robot = made_once.robot()
    geoms = [model.geom(name).id for name in robot.capsule_names]
    spheres = [model.geom(f"point{k}").id for k in range(len(cloud))]
    obstacle, where = make_obstacle(few_points(cloud)), Where(jnp.eye(4), jnp.array([1.0, 0, 0, 100.0]))
    for x in made_once.configurations(robot, 15, seed=2):
        data.qpos[:] = x
        mujoco.mj_kinematics(model, data)
        theirs = [
            min(mujoco.mj_geomDistance(model, data, geom, sphere, 100.0, None) for sphere in spheres) + radius
            for geom in geoms
        ]
        ours = jitted(clearances)(robot, obstacle, where, jnp.asarray(x))
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)


def test_the_recorded_run_comes_within_a_quarter_of_a_millimetre():
    """Minimum clearance of capsules 4 to 6c over the recorded run: -0.25 mm (scene.md), each row at its own pose."""
    duct, robot = made_once.measured_duct(), made_once.robot()
    run = np.loadtxt(made_once.MEASURED / "reference_run.csv", delimiter=",")
    obstacle = make_obstacle(duct)
    smallest = np.inf
    for row in run[11:]:
        where = posed(duct, row[7], row[8])
        smallest = min(smallest, float(jitted(clearances)(robot, obstacle, where, jnp.asarray(row[:6]))[3:].min()))
    assert round(1e3 * smallest, 2) == -0.25


@pytest.mark.parametrize("extension", [-0.05, 0.1])
def test_a_longer_tool_is_measured_longer(extension):
    """Compare D with numpy for a longer and a shorter tool."""
    robot = lengthen_tool(made_once.robot(), extension)
    obstacle, where = made_once.scene().obstacles, posed(made_once.duct())
    for x in configurations()[100:110]:
        exact, _ = numpy_clearances(robot, made_once.duct(), where, x)
        np.testing.assert_allclose(jitted(clearances)(robot, obstacle, where, x), exact, rtol=0, atol=2e-15)


def test_the_nominal_start_is_clear():
    scenario = make_scenario(made_once.robot(), made_once.duct(), made_once.START)
    robot, obstacle = made_once.scene()[:2]
    D = jitted(clearances)(robot, obstacle, posed(made_once.duct()), jnp.asarray(scenario.x_start))
    assert D.min() > 0.05


def test_what_other_devices_compute_is_the_same():
    """Other devices search bodies in parallel and evaluate all facets and complete paths; the results are equal."""
    robot, obstacle = made_once.scene()[:2]
    where = posed(made_once.duct())
    x = configurations()[::3]
    paths = x[:, None] + np.linspace(0, 0.05, 5)[:, None] * np.ones(x.shape[1])

    def look(x, path):
        here = robot, obstacle, where
        return contacts(*here, x).distance, clearance(*here, x), all_clear(*here, path)

    here = jax.jit(jax.vmap(look))(x, paths)
    with compiled_for(Backend("another")):
        there = jax.jit(jax.vmap(look))(x, paths)
    assert 10 < np.asarray(here[2]).sum() < len(x) - 10
    for ours, theirs in zip(here, there, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-14)
