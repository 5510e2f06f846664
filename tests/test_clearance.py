"""Clearance D(x, O): equal to plain numpy over all points, to MuJoCo's distances, and to the recorded run."""

from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import made_once
import mujoco
import numpy as np
import pytest
from scipy.spatial import cKDTree
from test_cloud_index import smallest_distances

from htcp_jax.backend import Backend, compiled_for
from htcp_jax.clearance import clearances, contacts, is_clear, minimum_clearance
from htcp_jax.clearance.obstacles.linearisation import linearise
from htcp_jax.clearance.obstacles.obstacle import Contacts
from htcp_jax.clearance.obstacles.obstacles import ClearanceRows, clearance_rows
from htcp_jax.clearance.obstacles.of_workpiece import make_obstacle
from htcp_jax.model import Workpiece
from htcp_jax.model.kinematics import capsule_segments
from htcp_jax.model.robot import lengthen_tool
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.spec import GP50


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
    return made_once.quick_jit(function)


ROWS = 44  # configurations per call, in all tests


def at_each(function, robot, obstacle, where, x):
    """`function` of (robot, obstacle, where, x) at every x."""
    return made_once.in_rows(function, ROWS)((robot, obstacle, where), x)


class Forms(NamedTuple):
    """All forms of D at a configuration, and its gradients through the nearest points."""

    contacts: Contacts
    clearances: jax.Array
    clearance: jax.Array
    is_clear: jax.Array
    linear: ClearanceRows
    smallest: ClearanceRows  # where only the smallest row is required
    only: ClearanceRows  # in its linearisation
    forward: jax.Array
    reverse: jax.Array


def forms(robot, obstacle, where, x) -> Forms:
    here = robot, obstacle, where, x
    return Forms(
        contacts(*here),
        clearances(*here),
        minimum_clearance(*here),
        is_clear(*here),
        linearise(*here).clearance,
        clearance_rows(*here, smallest=True),
        linearise(*here, smallest=True).clearance,
        jax.jacfwd(nearest, argnums=3)(*here),
        jax.jacrev(nearest, argnums=3)(*here),
    )


def nearest(robot, obstacle, where, x):
    """D per row, without the custom derivative rule."""
    return contacts(robot, obstacle, where, x).distance


@cache
def in_duct(wy=0.4, wz=0.1) -> Forms:
    """All forms of D in the duct at this pose, at all `configurations`."""
    robot, obstacle = made_once.scene()[:2]
    return at_each(forms, robot, obstacle, posed(made_once.duct(), wy, wz), configurations())


_ENDS = made_once.quick_jit(capsule_segments)


def numpy_clearances(robot, workpiece: Workpiece, where: Where, x):
    """D per body by brute force in numpy over all points and facets, and True where the hull decides it."""
    p, q = (np.asarray(end) for end in _ENDS(robot, x))
    T = np.asarray(where.T_world_workpiece)
    points = workpiece.cloud @ T[:3, :3].T + T[:3, 3]
    D, hull = np.empty(len(p)), np.zeros(len(p), bool)
    for k in range(len(p)):
        D[k] = smallest_distances(p[[k]], q[[k]], points)[0] - robot.capsule_radius[k]
        for end in (p[k], q[k]):
            local = T[:3, :3].T @ (end - T[:3, 3])
            outside = np.max(workpiece.hull_normal @ local - workpiece.hull_offset)
            if end @ where.interior_plane[:3] > where.interior_plane[3] and outside > 0 and -outside < D[k]:
                D[k], hull[k] = -outside, True
    return D, hull


def test_D_is_the_smallest_distance_to_all_points_and_minus_the_depth_outside_the_hull():
    robot, duct = made_once.robot(), made_once.duct()
    decided = 0
    for pose in ((0.4, 0.1), (0.2, -0.3)):
        touch = in_duct(*pose).contacts
        for k in range(0, len(configurations()), 3):
            exact, hull = numpy_clearances(robot, duct, posed(duct, *pose), configurations()[k])
            np.testing.assert_allclose(touch.distance[k], exact, rtol=0, atol=2e-15)
            np.testing.assert_array_equal(touch.plane[k], hull)
            decided += hull.sum()
    assert decided > 20


def test_all_forms_of_D_agree():
    """Scalar, verdict, and linearisation compute the same number with fewer operations."""
    signs = []
    for pose in ((0.4, 0.1), (0.8, 0.3)):
        found = in_duct(*pose)
        least = found.clearances.min(axis=1)
        np.testing.assert_allclose(found.clearance, least, rtol=0, atol=1e-15)
        np.testing.assert_allclose(found.linear.distance, found.clearances, rtol=0, atol=1e-15)
        np.testing.assert_array_equal(found.is_clear, least > 0)
        signs.append(least > 0)
    assert 50 < np.sum(signs) < np.size(signs) - 50


def test_where_only_the_smallest_row_is_asked_for_it_is_right_and_no_other_is_nearer():
    """Check the smallest row, which then is the only row of a linearisation."""
    every, few, alone = in_duct().linear, in_duct().smallest, in_duct().only
    lowest = np.arange(len(configurations())), np.argmin(every.distance, axis=1)
    np.testing.assert_allclose(few.distance[lowest], every.distance[lowest], rtol=0, atol=1e-15)
    np.testing.assert_allclose(few.gradient[lowest], every.gradient[lowest], rtol=0, atol=1e-12)
    assert (few.distance >= every.distance - 1e-15).all() and (few.distance > every.distance + 1e-3).any()
    np.testing.assert_allclose(alone.distance, few.distance[lowest][:, None], rtol=0, atol=1e-15)
    np.testing.assert_allclose(alone.gradient, few.gradient[lowest][:, None], rtol=0, atol=1e-12)


def test_contacts_lie_where_they_say():
    """The contact point is on the body's axis; point - (distance + radius) normal is the cloud's point."""
    robot, duct, where = made_once.robot(), made_once.duct(), posed(made_once.duct())
    T = np.asarray(where.T_world_workpiece)
    points = cKDTree(duct.cloud @ T[:3, :3].T + T[:3, 3])
    radius = np.asarray(robot.capsule_radius)
    for k in range(0, len(configurations()), 4):
        x, touch = configurations()[k], jax.tree.map(lambda leaf, k=k: leaf[k], in_duct().contacts)
        p, q = (np.asarray(end) for end in _ENDS(robot, x))
        along = np.linalg.norm(touch.point - p, axis=1) + np.linalg.norm(q - touch.point, axis=1)
        np.testing.assert_allclose(along, np.linalg.norm(q - p, axis=1), atol=1e-14)
        np.testing.assert_allclose(np.linalg.norm(touch.normal, axis=1), 1.0, atol=1e-14)
        witness = touch.point - touch.normal * (touch.distance + radius)[:, None]
        np.testing.assert_allclose(points.query(witness[~touch.plane])[0], 0.0, atol=1e-14)


def test_the_derivative_of_D_is_that_of_autodiff_through_what_is_nearest_and_of_finite_differences():
    """Except at kinks, where the two sides of a central difference see different points."""
    robot, obstacle = made_once.scene()[:2]
    found, x = jax.tree.map(lambda leaf: leaf[::2], in_duct()), configurations()[::2]
    closed = found.linear.gradient
    np.testing.assert_allclose(found.forward, closed, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.reverse, closed, rtol=0, atol=1e-12)
    steps = 1e-7 * np.concatenate([np.eye(6), -np.eye(6)])
    around = at_each(clearances, robot, obstacle, posed(made_once.duct()), (x[:, None] + steps).reshape(-1, 6))
    ahead, behind = np.moveaxis(around.reshape(len(x), 2, 6, -1), (1, 2, 3), (0, 3, 2))
    smooth = np.abs((ahead - behind) / 2e-7 - closed).max(axis=1) < 1e-6
    assert (~smooth).sum() <= 0.002 * smooth.size
    assert found.contacts.plane.sum() > 20


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
    found = at_each(forms, robot, obstacle, where, x[None])
    for gradient in (found.linear.gradient, found.forward, found.reverse):
        assert np.isfinite(gradient).all()
    np.testing.assert_allclose(found.clearances[0], -robot.capsule_radius, atol=1e-15)
    assert not found.is_clear[0]


def test_without_an_interior_only_the_points_count():
    """Check a workpiece without a hull: no point is in its interior, however deep the arm reaches."""
    robot, rng = made_once.robot(), np.random.default_rng(0)
    workpiece = few_points(rng.normal((1.5, 0.0, 1.0), 1.0, (FEW, 3)))
    obstacle = make_obstacle(workpiece)
    where = Where(jnp.eye(4), jnp.array([1.0, 0, 0, -100.0]))
    found = at_each(forms, robot, obstacle, where, configurations()[:20])
    for x, every, least in zip(configurations()[:20], found.clearances, found.clearance, strict=True):
        exact, hull = numpy_clearances(robot, _without_hull(workpiece), where, x)
        np.testing.assert_allclose(every, exact, rtol=0, atol=2e-15)
        np.testing.assert_allclose(least, exact.min(), rtol=0, atol=2e-15)
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
    xs = made_once.configurations(robot, 15, seed=2)
    for x, ours in zip(xs, at_each(forms, robot, obstacle, where, xs).clearances, strict=True):
        data.qpos[:] = x
        mujoco.mj_kinematics(model, data)
        theirs = [
            min(mujoco.mj_geomDistance(model, data, geom, sphere, 100.0, None) for sphere in spheres) + radius
            for geom in geoms
        ]
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
    xs = configurations()[100:110]
    for x, found in zip(xs, at_each(clearances, robot, obstacle, where, xs), strict=True):
        exact, _ = numpy_clearances(robot, made_once.duct(), where, x)
        np.testing.assert_allclose(found, exact, rtol=0, atol=2e-15)


def test_the_nominal_start_is_clear():
    scenario = make_scenario(made_once.robot(), made_once.duct(), made_once.START)
    robot, obstacle = made_once.scene()[:2]
    D = at_each(clearances, robot, obstacle, posed(made_once.duct()), np.asarray(scenario.x_start)[None])
    assert D.min() > 0.05


def test_what_other_devices_compute_is_the_same():
    """Other devices search bodies in parallel and evaluate all facets; the results are equal."""
    robot, obstacle = made_once.scene()[:2]
    where = posed(made_once.duct())
    x = configurations()[::3]

    def look(x):
        here = robot, obstacle, where
        return contacts(*here, x).distance, minimum_clearance(*here, x), is_clear(*here, x)

    here = made_once.quick_jit(jax.vmap(look))(x)
    with compiled_for(Backend("another")):
        there = made_once.quick_jit(jax.vmap(look))(x)
    assert 10 < np.asarray(here[2]).sum() < len(x) - 10
    for ours, theirs in zip(here, there, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-14)
