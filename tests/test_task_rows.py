"""Every kind of row: its error by scipy's rotations, its derivatives by differences, and inverse kinematics onto it."""

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from htcp_jax.errors import InputError
from htcp_jax.model import Task
from htcp_jax.model.inverse_kinematics import reanchor
from htcp_jax.model.kinematics import link_poses, tcp_pose
from htcp_jax.model.rotations import axis_error, rotation_vector
from htcp_jax.model.task_rows import AxisTowards, FrameOrientation, PointAlong, TaskPoint
from htcp_jax.numerics import null_basis

Z, SKEW = (0.0, 0.0, 1.0), (0.6, 0.0, 0.8)
TURNED = tuple(map(tuple, Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix().T.tolist()))
N1, N2 = np.array([0.6, -0.8, 0.0]), np.array([0.0, 0.0, 1.0])
R = Rotation.from_rotvec([0.5, 1.0, -0.7]).as_matrix()
# A part of each kind, and a goal of it.
PARTS = {
    "a point": (TaskPoint(3, (0.1, 0.0, 0.2), (0, 2)), [0.4, 0.9]),
    "the TCP on a plane": (PointAlong(None, (0.0, 0.0, 0.0), 1), [*N1, 0.2]),
    "a point on a line": (PointAlong(4, (0.1, 0.0, 0.3), 2), [*N1, 0.2, *N2, 0.8]),
    "a point within a band": (PointAlong(None, (0.0, 0.0, 0.1), 2, band=True), [*N1, 0.2, *N2, 0.8, 0.05]),
    "an axis": (AxisTowards(None, Z, cone=False), N1),
    "an axis in a cone": (AxisTowards(4, SKEW), [*N1, 0.7]),
    "an axis that looks at a place": (AxisTowards(5, Z, looks_from_m=(0.0, 0.1, 0.0), cone=False), [2.0, 0.3, 0.5]),
    "an axis that looks about a place": (AxisTowards(None, Z, looks_from_m=(0.0, 0.0, 0.0)), [2.0, 0.3, 0.5, 0.4]),
    "a frame": (FrameOrientation(None), R.ravel()),
    "a frame of another body": (FrameOrientation(4, TURNED), R.ravel()),
    "a frame within an angle": (FrameOrientation(None, cone=True), [*R.ravel(), 0.5]),
}


def task_of(name: str, **more) -> tuple[Task, jax.Array]:
    part, goal = PARTS[name]
    return Task((part,), **more), jnp.asarray(goal, float)


def frame(link, x) -> np.ndarray:
    robot = made_once.robot()
    return np.asarray(tcp_pose(robot, x) if link is None else link_poses(robot, x)[link])


def by_scipy(name: str, x) -> np.ndarray:
    """|error| of an equality, slack of an inequality, in the units of the row."""
    part, goal = PARTS[name]
    T, goal = frame(part.link, jnp.asarray(x)), np.asarray(goal, float)
    if isinstance(part, TaskPoint):
        return np.array([np.linalg.norm((T[:3, :3] @ part.offset_m + T[:3, 3])[[0, 2]] - goal)])
    if isinstance(part, PointAlong):
        p = T[:3, :3] @ part.offset_m + T[:3, 3]
        off = np.array([goal[4 * k : 4 * k + 3] @ p - goal[4 * k + 3] for k in range(part.count)])
        return np.array([goal[-1] - np.abs(off).max()]) if part.band else np.array([np.linalg.norm(off)])
    if isinstance(part, AxisTowards):
        axis, direction = T[:3, :3] @ part.axis, goal[:3]
        if part.looks_from_m is not None:
            direction = goal[:3] - T[:3, :3] @ part.looks_from_m - T[:3, 3]
        turn, _ = Rotation.align_vectors(direction[None], axis[None])
        return np.array([goal[3] - turn.magnitude() if part.cone else turn.magnitude()])
    own = T[:3, :3] @ np.array(part.columns).T
    turn = Rotation.from_matrix(goal[:9].reshape(3, 3) @ own.T).magnitude()
    return np.array([goal[9] - turn if part.cone else turn])


@pytest.mark.parametrize("name", PARTS)
def test_a_row_is_off_by_what_scipy_says_in_its_own_unit(name):
    task, goal = task_of(name, tolerance_m=1e-3, tolerance_rad=1e-3)  # with equal tolerances an angle is not scaled
    robot = made_once.robot()
    error, slack = (jax.jit(lambda x, f=f: f(task.value(robot, x), goal)) for f in (task.error, task.slack))
    for x in made_once.configurations(robot, 10):
        found = slack(x) if task.bands else np.linalg.norm(error(x))
        np.testing.assert_allclose(found, by_scipy(name, x)[0], atol=1e-9)
    assert task.rows + task.bands == len(np.atleast_1d(error(x))) + task.bands


@pytest.mark.parametrize("name", PARTS)
def test_its_jacobian_is_that_of_jacfwd_and_of_differences(name):
    task, goal = task_of(name)
    robot = made_once.robot()
    linear = jax.jit(lambda x: task.linear_at(robot, x, goal))
    both = jax.jit(lambda x: jnp.concatenate([-task.error(task.value(robot, x), goal), slacks(task, robot, x, goal)]))
    forward = jax.jit(jax.jacfwd(both))
    for x in made_once.configurations(robot, 6):
        found = np.concatenate([linear(x).jacobian, linear(x).gradient])
        slope = [(np.asarray(both(x + d)) - np.asarray(both(x - d))) / 2e-6 for d in 1e-6 * np.eye(6)]
        np.testing.assert_allclose(found, forward(x), atol=1e-11)
        np.testing.assert_allclose(found, np.transpose(slope), atol=3e-8)


@pytest.mark.parametrize("name", PARTS)
def test_the_least_turn_of_the_last_link_is_what_scipy_says_and_none_where_a_row_looks_at_more(name):
    """Least rotation of the last link by scipy, and 0 for a row that depends on more.

    For every arm the counted rows depend on the last link's rotation alone.
    """
    part, _ = PARTS[name]
    task, goal = task_of(name, tolerance_rad=0.01)
    robot = made_once.robot()
    counts = (
        isinstance(part, AxisTowards | FrameOrientation)
        and part.link is None
        and getattr(part, "looks_from_m", None) is None
    )
    found = jax.jit(lambda x: task.least_turn(robot, link_poses(robot, x)[-1, :3, :3], goal))
    for x in made_once.configurations(robot, 10):
        off = -by_scipy(name, x)[0] if task.bands else by_scipy(name, x)[0] - 0.01
        np.testing.assert_allclose(found(jnp.asarray(x)), max(off, 0.0) if counts else 0.0, atol=1e-9)


def slacks(task, robot, x, goal):
    """Slack of every row, without the inner margin of a step, which depends on the goal alone."""
    linear = task.linear_at(robot, x, goal)
    return linear.slack


@pytest.mark.parametrize("name", PARTS)
def test_inverse_kinematics_comes_onto_it_and_its_null_space_leaves_it_alone(name):
    task, goal = task_of(name)
    robot = made_once.robot()
    off, jac = (
        jax.jit(f) for f in (lambda x: task.residual_at(robot, x, goal), lambda x: linear_at(task, robot, x, goal))
    )
    reached = 0
    for x in made_once.configurations(robot, 12):
        near, residual = reanchor(robot, jnp.asarray(x), goal, task.fine_m, iterations=60, task=task)
        np.testing.assert_allclose(residual, off(near), atol=1e-15)
        reached += bool(task.reached(residual))
        if not task.reached(residual):
            continue
        if task.bands:
            assert by_scipy(name, near)[0] >= -2e-9
        else:
            assert by_scipy(name, near)[0] <= (task.tolerance_rad if task.parts[0].angular else task.tolerance_m)
            basis = null_basis(jac(near))
            assert basis.shape == (6, task.freedom(robot))
            np.testing.assert_allclose(jac(near) @ basis, 0.0, atol=1e-9)
    assert reached >= 9


def linear_at(task, robot, x, goal):
    """Jacobian of the equalities."""
    return task.linear_at(robot, x, goal).jacobian


def test_a_broken_cone_is_never_reached_however_little_it_is_broken():
    task = Task((TaskPoint(), AxisTowards(None, Z)))
    robot, x = made_once.robot(), jnp.asarray(made_once.START)
    T = np.asarray(tcp_pose(robot, x))
    off = np.arccos(T[2, 2])
    for limit, reached in [(off + 1e-6, True), (off - 1e-6, False), (off - 1e-3, False)]:
        goal = jnp.array([*T[:3, 3], 0.0, 0.0, 1.0, limit])
        assert bool(task.reached(task.residual_at(robot, x, goal))) is reached


def test_the_rotation_vector_is_scipys_also_next_to_half_a_turn():
    rng = np.random.default_rng(0)
    for size in (0.0, 1e-9, 1e-3, 1.0, 2.0, 2.5, 3.1, np.pi - 1e-4):
        axis = rng.normal(size=3)
        vector = size * axis / np.linalg.norm(axis)
        found = rotation_vector(jnp.asarray(Rotation.from_rotvec(vector).as_matrix()))
        np.testing.assert_allclose(found, vector, atol=1e-9)


def test_an_axis_that_points_the_other_way_is_half_a_turn_off_and_one_that_is_there_not_at_all():
    direction = jnp.asarray(N1)
    assert np.linalg.norm(axis_error(-direction, direction)) == pytest.approx(np.pi)
    np.testing.assert_allclose(axis_error(direction, direction), 0.0, atol=1e-15)
    assert np.isfinite(jax.jacfwd(axis_error)(direction, direction)).all()


def test_more_equalities_than_joints_are_refused():
    task = Task((TaskPoint(), FrameOrientation(None), TaskPoint(3, axes=(2,))))
    assert (task.rows, task.bands, task.numbers, task.values) == (7, 0, 13, 13)
    with pytest.raises(InputError, match="the task has 7 equations, more than the 6 joints of robot gp50"):
        task.freedom(made_once.robot())
