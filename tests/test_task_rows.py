"""Every kind of row: its error by scipy's rotations, its derivatives by differences, and inverse kinematics onto it."""

from functools import cache

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from htcp_jax.errors import InputError
from htcp_jax.model import Task
from htcp_jax.model.built_in_rows import AxisTowards, FrameOrientation, PointAlong
from htcp_jax.model.inverse_kinematics import reanchor
from htcp_jax.model.kinematics import link_poses, tcp_pose
from htcp_jax.model.rotations import axis_error, rotation_vector
from htcp_jax.model.task_rows import TaskPoint
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
    "an axis": (AxisTowards(None, Z, cone=False), [*N1, 0.0]),
    "an axis in a cone": (AxisTowards(4, SKEW), [*N1, 0.7]),
    "an axis that looks at a place": (
        AxisTowards(5, Z, looks_from_m=(0.0, 0.1, 0.0), cone=False),
        [2.0, 0.3, 0.5, 0.0],
    ),
    "an axis that looks about a place": (AxisTowards(None, Z, looks_from_m=(0.0, 0.0, 0.0)), [2.0, 0.3, 0.5, 0.4]),
    "a frame": (FrameOrientation(None), R.ravel()),
    "a frame of another body": (FrameOrientation(4, TURNED), R.ravel()),
    "a frame within an angle": (FrameOrientation(None, cone=True), [*R.ravel(), 0.5]),
}


def task_of(name: str, **more) -> tuple[Task, jax.Array]:
    part, goal = PARTS[name]
    return Task((part,), **more), jnp.asarray(goal, float)


@made_once.quick_jit
def frames_at(robot, x):
    return tcp_pose(robot, x), link_poses(robot, x)


def frame(link, x) -> np.ndarray:
    tcp, links = frames_at(made_once.robot(), x)
    return np.asarray(tcp if link is None else links[link])


def by_scipy(name: str, x) -> np.ndarray:
    """|error| of an equality, slack of an inequality, in the units of the row."""
    part, goal = PARTS[name]
    T, goal = frame(part.link, np.asarray(x)), np.asarray(goal, float)
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


ALIKE = {"tolerance_m": 1e-3, "tolerance_rad": 1e-3}  # with equal tolerances an angle is not scaled


@made_once.quick_jit
@jax.vmap
def numbers_at(x):
    """Errors or slacks of all kinds, the least turns of the last link, and the slopes of the rows, by one program."""
    robot = made_once.robot()
    off, turn = {}, {}
    for name in PARTS:
        task, goal = task_of(name, **ALIKE)
        value = task.value(robot, x)
        off[name] = task.slack(value, goal) if task.bands else task.error(value, goal)
        task, goal = task_of(name, tolerance_rad=0.01)
        turn[name] = task.least_turn(robot, link_poses(robot, x)[-1, :3, :3], goal)
    return off, turn


def rows_at(x) -> dict:
    """Minus the error of the equalities, and the slack of the inequalities without the inner margin of a step."""
    robot, found = made_once.robot(), {}
    for name in PARTS:
        task, goal = task_of(name)
        slack = task.linear_at(robot, x, goal).slack
        found[name] = jnp.concatenate([-task.error(task.value(robot, x), goal), slack])
    return found


@made_once.quick_jit
@jax.vmap
def slopes_at(x):
    """Rows of all kinds, their own Jacobians and those of jacfwd, by one program."""
    own = {}
    for name in PARTS:
        task, goal = task_of(name)
        linear = task.linear_at(made_once.robot(), x, goal)
        own[name] = jnp.concatenate([linear.jacobian, linear.gradient])
    return rows_at(x), own, jax.jacfwd(rows_at)(x)


@cache
def numbers() -> tuple:
    """Ten configurations with the result of `numbers_at`."""
    x = made_once.configurations(made_once.robot(), 10)
    return x, *jax.tree.map(np.asarray, numbers_at(x))


@cache
def slopes() -> tuple:
    """Own Jacobians at six configurations, those of jacfwd, and those of differences."""
    x = made_once.configurations(made_once.robot(), 6)
    steps = 1e-6 * np.concatenate([np.zeros((1, 6)), np.eye(6), -np.eye(6)])
    rows, own, forward = jax.tree.map(np.asarray, slopes_at((x[:, None] + steps).reshape(-1, 6)))

    def difference(row):
        _, ahead, behind = np.split(row.reshape(6, 13, -1), [1, 7], axis=1)
        return np.swapaxes(ahead - behind, 1, 2) / 2e-6

    own, forward = ({name: each[::13] for name, each in found.items()} for found in (own, forward))
    return own, forward, {name: difference(row) for name, row in rows.items()}


@pytest.mark.parametrize("name", PARTS)
def test_a_row_is_off_by_what_scipy_says_in_its_own_unit(name):
    task, _ = task_of(name, **ALIKE)
    x, off, _ = numbers()
    found = off[name] if task.bands else np.linalg.norm(off[name], axis=1)
    np.testing.assert_allclose(found, [by_scipy(name, each)[0] for each in x], atol=1e-9)
    assert task.bands or off[name].shape[1] == task.rows


@pytest.mark.parametrize("name", PARTS)
def test_a_kind_has_as_many_equations_and_inequalities_as_its_jacobian_has_rows(name):
    part, _ = PARTS[name]
    own, _, _ = slopes()
    assert min(part.equalities, part.inequalities) == 0
    assert own[name].shape[1] == part.equalities + part.inequalities


@pytest.mark.parametrize("name", PARTS)
def test_its_jacobian_is_that_of_jacfwd_and_of_differences(name):
    own, forward, by_differences = (found[name] for found in slopes())
    np.testing.assert_allclose(own, forward, atol=1e-11)
    np.testing.assert_allclose(own, by_differences, atol=3e-8)


@pytest.mark.parametrize("name", PARTS)
def test_the_least_turn_of_the_last_link_is_what_scipy_says_and_none_where_a_row_looks_at_more(name):
    """Least rotation of the last link by scipy, and 0 for a row that depends on more.

    For every arm the counted rows depend on the last link's rotation alone.
    """
    part, _ = PARTS[name]
    task, _ = task_of(name, tolerance_rad=0.01)
    counts = (
        isinstance(part, AxisTowards | FrameOrientation)
        and part.link is None
        and getattr(part, "looks_from_m", None) is None
    )
    x, _, turn = numbers()
    off = [-by_scipy(name, each)[0] if task.bands else by_scipy(name, each)[0] - 0.01 for each in x]
    np.testing.assert_allclose(turn[name], np.maximum(off, 0.0) if counts else 0.0, atol=1e-9)


@made_once.quick_jit
@jax.vmap
def residuals_at(x):
    """Residuals and Jacobians of the equalities of all kinds, each at its own configuration."""
    robot, found = made_once.robot(), {}
    for name in PARTS:
        task, goal = task_of(name)
        found[name] = task.residual_at(robot, x[name], goal), task.linear_at(robot, x[name], goal).jacobian
    return found


@cache
def moved_onto() -> dict[str, tuple]:
    """Configurations that inverse kinematics reaches for each kind, its residuals, and `residuals_at` there."""
    robot, near, residual = made_once.robot(), {}, {}
    for name in PARTS:
        task, goal = task_of(name)
        found = [
            reanchor(robot, jnp.asarray(x), goal, task.fine_m, iterations=60, task=task)
            for x in made_once.configurations(robot, 12)
        ]
        near[name], residual[name] = (np.array(each) for each in zip(*found, strict=True))
    there = jax.tree.map(np.asarray, residuals_at(near))
    return {name: (near[name], residual[name], *there[name]) for name in PARTS}


@pytest.mark.parametrize("name", PARTS)
def test_inverse_kinematics_comes_onto_it_and_its_null_space_leaves_it_alone(name):
    task, _ = task_of(name)
    near, residual, measured, jacobian = moved_onto()[name]
    np.testing.assert_allclose(residual, measured, atol=1e-15)
    reached = np.flatnonzero(task.reached(residual))
    for k in reached:
        if task.bands:
            assert by_scipy(name, near[k])[0] >= -2e-9
        else:
            assert by_scipy(name, near[k])[0] <= (task.tolerance_rad if task.parts[0].angular else task.tolerance_m)
            basis = null_basis(jnp.asarray(jacobian[k]))
            assert basis.shape == (6, task.freedom(made_once.robot()))
            np.testing.assert_allclose(jacobian[k] @ np.asarray(basis), 0.0, atol=1e-9)
    assert len(reached) >= 9


def test_a_broken_cone_is_never_reached_however_little_it_is_broken():
    task = Task((TaskPoint(), AxisTowards(None, Z)))
    robot, x = made_once.robot(), jnp.asarray(made_once.START)
    T, residual_at = frame(None, x), made_once.quick_jit(task.residual_at)
    off = np.arccos(T[2, 2])
    for limit, reached in [(off + 1e-6, True), (off - 1e-6, False), (off - 1e-3, False)]:
        goal = np.array([*T[:3, 3], 0.0, 0.0, 1.0, limit])
        assert bool(task.reached(residual_at(robot, x, goal))) is reached


def test_the_rotation_vector_is_scipys_also_next_to_half_a_turn():
    rng = np.random.default_rng(0)
    vector_of = made_once.quick_jit(rotation_vector)
    for size in (0.0, 1e-9, 1e-3, 1.0, 2.0, 2.5, 3.1, np.pi - 1e-4):
        axis = rng.normal(size=3)
        vector = size * axis / np.linalg.norm(axis)
        found = vector_of(Rotation.from_rotvec(vector).as_matrix())
        np.testing.assert_allclose(found, vector, atol=1e-9)


def test_an_axis_that_points_the_other_way_is_half_a_turn_off_and_one_that_is_there_not_at_all():
    @made_once.quick_jit
    def error_and_slope(axis, direction):
        return axis_error(axis, direction), jax.jacfwd(axis_error)(axis, direction)

    assert np.linalg.norm(error_and_slope(-N1, N1)[0]) == pytest.approx(np.pi)
    error, slope = error_and_slope(N1, N1)
    np.testing.assert_allclose(error, 0.0, atol=1e-15)
    assert np.isfinite(slope).all()


def test_more_equalities_than_joints_are_refused():
    task = Task((TaskPoint(), FrameOrientation(None), TaskPoint(3, axes=(2,))))
    assert (task.rows, task.bands, task.numbers, task.values) == (7, 0, 13, 13)
    with pytest.raises(InputError, match="the task has 7 equations, more than the 6 joints of robot gp50"):
        task.freedom(made_once.robot())
