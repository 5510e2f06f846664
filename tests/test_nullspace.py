"""The null-space basis of a Jacobian, steps along it, and the re-anchoring of configurations on a target."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest

from htcp_jax.clearance import minimum_clearance
from htcp_jax.model.built_in_rows import AxisTowards
from htcp_jax.model.inverse_kinematics import reanchor, within_limits
from htcp_jax.model.kinematics import jacobian, tcp_pose, tcp_position
from htcp_jax.model.robot import lengthen_tool
from htcp_jax.model.task import Task
from htcp_jax.model.task_rows import TaskPoint
from htcp_jax.numerics import null_basis

RNG = np.random.default_rng(0)
BASIS = made_once.quick_jit(null_basis)


@pytest.mark.parametrize(("m", "n"), [(3, 6), (3, 7), (3, 4), (1, 3), (2, 9), (5, 6)])
def test_the_basis_is_orthonormal_and_the_task_does_not_move_along_it(m, n):
    for scale in (1e-6, 1.0, 1e6):
        for _ in range(20):
            J = scale * RNG.normal(size=(m, n))
            N = np.asarray(BASIS(jnp.asarray(J)))
            assert N.shape == (n, n - m)
            np.testing.assert_allclose(N.T @ N, np.eye(n - m), atol=1e-14)
            np.testing.assert_allclose(J @ N, 0.0, atol=1e-14 * scale)


def test_the_basis_spans_what_a_singular_value_decomposition_spans():
    for x in made_once.configurations(made_once.robot(), 50):
        J = np.asarray(jacobian(made_once.robot(), jnp.asarray(x)))
        N, V = np.asarray(BASIS(jnp.asarray(J))), np.linalg.svd(J)[2][3:].T
        np.testing.assert_allclose(N @ N.T, V @ V.T, atol=1e-11)


def test_near_a_singular_configuration_the_basis_is_still_orthonormal():
    """Orthonormal basis near a singularity: N' N = 1 exactly, even where two rows of J are nearly parallel."""
    for parallel in (1e-4, 1e-8, 1e-12):
        J = RNG.normal(size=(3, 6))
        J[2] = J[1] + parallel * RNG.normal(size=6)
        N = np.asarray(BASIS(jnp.asarray(J)))
        np.testing.assert_allclose(N.T @ N, np.eye(3), atol=1e-13)
        np.testing.assert_allclose(J @ N, 0.0, atol=1e-13)


def test_a_jacobian_a_little_different_has_a_basis_a_little_different():
    """Continuity of the basis in J, except where two unit vectors project equally far and the pivot switches."""
    moved = []
    for _ in range(300):
        J = RNG.normal(size=(3, 6))
        change = RNG.normal(size=(3, 6))
        a, b = (np.asarray(BASIS(jnp.asarray(J + h * change))) for h in (0.0, 1e-9))
        moved.append(np.abs(a - b).max())
    assert np.mean(np.array(moved) < 1e-6) > 0.99


def test_each_column_is_positive_along_the_joint_that_sticks_out_furthest():
    """Sign and rotation of the basis, by its rule.

    The first column is the projection of a unit vector onto the null space, of the one whose projection is longest; the
    others follow in the remaining space.
    """
    for _ in range(50):
        J = RNG.normal(size=(3, 6))
        N = np.asarray(BASIS(jnp.asarray(J)))
        projector = np.eye(6) - np.linalg.pinv(J) @ J
        for k in range(3):
            pivot = np.argmax(np.diag(projector))
            expected = projector[pivot] / np.sqrt(projector[pivot, pivot])
            np.testing.assert_allclose(N[:, k], expected, atol=1e-10)
            projector = projector - np.outer(N[:, k], N[:, k])


def test_the_basis_is_the_same_in_a_batch_to_rounding():
    J = RNG.normal(size=(64, 3, 6))
    together = made_once.quick_jit(jax.vmap(null_basis))(jnp.asarray(J))
    np.testing.assert_allclose(together, [BASIS(jnp.asarray(each)) for each in J], atol=1e-13)


@pytest.fixture(scope="session", params=["gp50", "seven"])
def arm(request, tmp_path_factory):
    return made_once.robot() if request.param == "gp50" else made_once.seven_joints(tmp_path_factory.mktemp("arm"))


def test_a_step_in_the_null_space_keeps_the_tcp_to_first_order(arm):
    for x in made_once.configurations(arm, 10):
        N = null_basis(jacobian(arm, jnp.asarray(x)))
        w = RNG.normal(size=N.shape[1])
        before = tcp_position(arm, jnp.asarray(x))
        moved = [np.linalg.norm(tcp_position(arm, x + h * N @ w) - before) for h in (1e-3, 1e-4)]
        assert moved[0] < 1e-4 and moved[1] < 0.02 * moved[0]


TOLERANCE_M = 1e-4
REANCHOR = made_once.quick_jit(reanchor, static_argnames=("tolerance_m", "iterations"))


def test_reanchoring_ends_inside_the_limits_and_on_the_target_or_says_that_it_did_not(arm):
    """Re-anchoring to reachable targets (near or far) and unreachable ones, from any start."""
    count = 150
    starts = made_once.configurations(arm, count, seed=1)
    at_limit = RNG.random(starts.shape) < 0.2
    starts = np.where(at_limit, np.where(starts > 0, arm.upper, arm.lower), starts)
    goals = np.clip(starts + np.geomspace(1e-3, 3.0, count)[:, None] * RNG.normal(size=starts.shape), -2.9, 2.9)
    on_target = 0
    for k, (start, goal) in enumerate(zip(starts, goals, strict=True)):
        target = np.asarray(tcp_position(arm, jnp.asarray(goal))) + (10.0 if k % 10 == 9 else 0.0)
        x, error = REANCHOR(arm, jnp.asarray(start), jnp.asarray(target), tolerance_m=TOLERANCE_M)
        assert (x >= arm.lower).all() and (x <= arm.upper).all() and within_limits(arm, x)
        actual = np.linalg.norm(np.asarray(tcp_position(arm, x)) - target)
        np.testing.assert_allclose(error, actual, rtol=0, atol=1e-14)
        on_target += bool(error <= TOLERANCE_M)
        if k % 10 == 9:
            assert error > 1.0  # out of reach: the error is large
        elif k < count // 2:
            assert error <= TOLERANCE_M, (k, float(error))
    assert on_target > 0.7 * count


def test_reanchoring_leaves_a_configuration_on_its_target_alone(arm):
    x = jnp.asarray(made_once.configurations(arm, 1)[0])
    same, error = REANCHOR(arm, x, tcp_position(arm, x) + 1e-5, tolerance_m=TOLERANCE_M)
    np.testing.assert_array_equal(same, x)
    np.testing.assert_allclose(error, 1e-5 * np.sqrt(3), rtol=1e-6)


def differences(function, at: tuple, k: int, h: float) -> np.ndarray:
    """Central differences of a function by its k-th argument; like `jax.jacfwd`, the last axis is the argument's."""
    steps = h * np.eye(at[k].size).reshape(-1, *at[k].shape)
    ends = [[function(*at[:k], at[k] + sign * step, *at[k + 1 :]) for sign in (1, -1)] for step in steps]
    columns = np.stack([(more - less) / (2 * h) for more, less in ends], axis=-1)
    return columns if at[k].ndim else columns[..., 0]


CONE = Task((TaskPoint(), AxisTowards(None, (0.0, 0.0, 1.0), cone=True)))


@pytest.mark.parametrize("task", [Task(), CONE], ids=["point", "cone"])
def test_reanchoring_has_one_derivative_in_forward_and_reverse_mode_and_by_differences(arm, task):
    """Derivative by configuration, goal and tool length; its part along the task is the implicit function theorem's."""
    x = jnp.asarray(np.clip(made_once.configurations(arm, 1, seed=6)[0], -2.0, 2.0))
    tcp = tcp_pose(arm, x)
    tilted = (tcp[:3, 2] + 0.3 * tcp[:3, 0]) / np.sqrt(1 + 0.3**2)  # by 0.29 rad: the cone below is violated at x
    goal = jnp.concatenate([tcp[:3, 3] + jnp.array([0.02, -0.03, 0.01]), tilted, jnp.array([0.2])])[: task.numbers]

    def found(x, p, extension_m):
        target = jnp.concatenate([p, goal[3:]])
        return reanchor(lengthen_tool(arm, extension_m), x, target, 1e-11, task=task)[0]

    at, which = (x, goal[:3], jnp.zeros(())), (0, 1, 2)
    forward, reverse = (made_once.quick_jit(mode(found, which))(*at) for mode in (jax.jacfwd, jax.jacrev))
    found = made_once.quick_jit(found)
    there = found(*at)
    assert np.linalg.norm(there - x) > 0.01
    for k, (one, other) in enumerate(zip(forward, reverse, strict=True)):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
        np.testing.assert_allclose(other, differences(found, at, k, 1e-5), rtol=0, atol=1e-7)
    J = np.asarray(jacobian(arm, there))
    np.testing.assert_allclose(J @ reverse[0], 0.0, atol=1e-7)
    np.testing.assert_allclose(J @ reverse[1], np.eye(3), atol=1e-7)


def test_the_gradient_of_the_clearance_by_the_tools_length_and_the_parts_place_is_that_of_differences():
    arm, obstacle, where = made_once.robot(), made_once.scene().obstacles, made_once.nominal()
    x, p = jnp.asarray(made_once.START), jnp.asarray(where.targets[30])

    def D(extension_m, shift_m):
        longer = lengthen_tool(arm, extension_m)
        moved = replace(where, T_world_workpiece=jnp.asarray(where.T_world_workpiece).at[:3, 3].add(shift_m))
        on_target, _ = reanchor(longer, x, p + shift_m, 1e-11)
        return minimum_clearance(longer, obstacle, moved, on_target)

    at, quick = (jnp.zeros(()), jnp.zeros(3)), made_once.quick_jit(D)
    for k, slope in enumerate(made_once.quick_jit(jax.grad(D, argnums=(0, 1)))(*at)):
        assert np.linalg.norm(slope) > 1e-3
        np.testing.assert_allclose(slope, differences(quick, at, k, 1e-6), rtol=0, atol=1e-7)


def test_reanchoring_stops_at_its_iterations(arm):
    """Iteration limit of re-anchoring: 0 leaves x unchanged; 2 iterations equal 1 and 1 more."""
    x = jnp.asarray(made_once.configurations(arm, 1, seed=3)[0])
    target = tcp_position(arm, x) + 0.1
    after = {n: REANCHOR(arm, x, target, tolerance_m=1e-12, iterations=n)[0] for n in (0, 1, 2)}
    np.testing.assert_array_equal(after[0], x)
    one_more, _ = REANCHOR(arm, after[1], target, tolerance_m=1e-12, iterations=1)
    np.testing.assert_array_equal(after[2], one_more)
    assert np.linalg.norm(after[1] - x) > 0.01


def test_reanchoring_moves_the_joints_about_as_little_as_it_must():
    """Step of re-anchoring: to first order the pseudo-inverse's, without motion in the null space."""
    robot = made_once.robot()
    for start in made_once.configurations(robot, 20, seed=4):
        x = jnp.asarray(np.clip(start, -2.5, 2.5))
        J = np.asarray(jacobian(robot, x))
        if np.linalg.svd(J, compute_uv=False)[-1] < 0.1:
            continue
        target = np.asarray(tcp_position(robot, x)) + 1e-3 * RNG.normal(size=3)
        moved, _ = REANCHOR(robot, x, jnp.asarray(target), tolerance_m=1e-9)
        shortest = np.linalg.pinv(J) @ (target - np.asarray(tcp_position(robot, x)))
        np.testing.assert_allclose(np.asarray(moved) - np.asarray(x), shortest, atol=1e-4)


def test_a_joint_at_its_limit_is_held_there_while_the_others_make_up_for_it():
    """Step with a joint at its limit: the shortest of the joints that are free to move, not a full step cut off."""
    robot, held = made_once.robot(), 0
    for start in made_once.configurations(robot, 40, seed=5):
        for joint, limit in ((1, robot.upper[1]), (2, robot.lower[2])):
            x = jnp.asarray(np.clip(start, -2.5, 2.5)).at[joint].set(limit)
            J = np.asarray(jacobian(robot, x))
            error = 1e-3 * RNG.normal(size=3)
            push = np.linalg.pinv(J)[joint] @ error * (1 if limit > 0 else -1)
            free = J.copy()
            free[:, joint] *= push < 0
            if np.linalg.svd(free, compute_uv=False)[-1] < 0.1 or abs(push) < 1e-6:
                continue
            moved, _ = REANCHOR(robot, x, tcp_position(robot, x) + error, tolerance_m=1e-12, iterations=1)
            np.testing.assert_allclose(moved - x, np.linalg.pinv(free) @ error, rtol=1e-3, atol=1e-7)
            held += push > 0
    assert held > 20


def test_reanchoring_survives_a_singular_configuration(arm):
    """Finite re-anchoring at singular configurations: the GP50 upright, the seven joints in a line."""
    x = jnp.zeros(len(arm.slides))
    for offset in ([0.0, 0.0, -0.05], [0.02, 0.0, 0.0], [0.0, 0.02, 0.0]):
        x_new, error = REANCHOR(arm, x, tcp_position(arm, x) + jnp.asarray(offset), tolerance_m=TOLERANCE_M)
        assert np.isfinite(x_new).all() and np.isfinite(error)
        assert error < 0.06


def test_inside_means_every_joint_and_the_limits_themselves():
    robot = made_once.robot()
    assert within_limits(robot, robot.lower) and within_limits(robot, robot.upper)
    for joint in range(6):
        assert not within_limits(robot, robot.upper.at[joint].add(1e-12))
        assert not within_limits(robot, robot.lower.at[joint].add(-1e-12))
