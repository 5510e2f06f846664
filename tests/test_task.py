"""The task: M rows at points of the arm, its error, Jacobian and verdict; with M = N there is no null space."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
from own_obstacles import Floor

from htcp_jax.clearance.obstacles.obstacle import bodies_at
from htcp_jax.errors import InputError
from htcp_jax.model import Robot, Scenario, Task
from htcp_jax.model.inverse_kinematics import reanchor
from htcp_jax.model.kinematics import link_poses, tcp_position
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.model.task import TCP_POSITION
from htcp_jax.model.task_rows import TaskPoint
from htcp_jax.motion import Problem
from htcp_jax.numerics import null_basis
from htcp_jax.planning.batch import plan
from htcp_jax.settings import Settings
from htcp_jax.solvers import ClarabelSolver, step_qp
from htcp_jax.solvers.active_set import solve_step
from htcp_jax.status import Status

ELBOW = TaskPoint(link=2, offset_m=(0.1, -0.2, 0.3))
TASKS = {
    "the TCP": TCP_POSITION,
    "its height": Task((TaskPoint(axes=(2,)),)),
    "the TCP, and x and z of the elbow": Task((TaskPoint(), TaskPoint(ELBOW.link, ELBOW.offset_m, (0, 2)))),
    "as many rows as joints": Task(
        (TaskPoint(), TaskPoint(5, (0.3, 0.0, 0.1), (0, 1)), TaskPoint(ELBOW.link, ELBOW.offset_m, (2,)))
    ),
}


@pytest.mark.parametrize("name", TASKS)
def test_the_value_is_where_the_points_are_and_the_jacobian_its_derivative(name):
    robot, task = made_once.robot(), TASKS[name]
    evaluated = made_once.quick_jit(lambda x: (task.value(robot, x), task.jacobian(robot, x), link_poses(robot, x)))
    value = lambda x: np.asarray(evaluated(x)[0])  # noqa: E731
    for x in made_once.configurations(robot, 5):
        found, jacobian, T = map(np.asarray, evaluated(x))
        by_hand = []
        for point in task.parts:
            own = T[-1 if point.link is None else point.link]
            offset = np.asarray(robot.T_link_tcp)[:3, 3] if point.link is None else np.array(point.offset_m)
            by_hand += (own[:3, :3] @ offset + own[:3, 3])[list(point.axes)].tolist()
        assert len(by_hand) == task.rows
        np.testing.assert_allclose(found, by_hand, atol=1e-13)
        slope = [(value(x + d) - value(x - d)) / 2e-6 for d in 1e-6 * np.eye(6)]
        np.testing.assert_allclose(jacobian, np.transpose(slope), atol=1e-8)


@pytest.mark.parametrize("name", TASKS)
def test_inverse_kinematics_reaches_any_task_and_its_null_space_leaves_it_alone(name):
    robot, task, rng = made_once.robot(), TASKS[name], np.random.default_rng(0)
    value, residual_at, jacobian = map(made_once.quick_jit, (task.value, task.residual_at, task.jacobian))
    basis_of, reached = made_once.quick_jit(null_basis), 0
    for x in made_once.configurations_near(made_once.START, 10, 0.5):
        target = value(robot, x)
        near, residual = reanchor(robot, jnp.asarray(x + rng.uniform(-0.1, 0.1, 6)), target, task.fine_m, task=task)
        np.testing.assert_allclose(residual, residual_at(robot, near, target), atol=1e-15)
        reached += bool(task.reached(residual))
        J = jacobian(robot, near)
        basis = basis_of(J)
        assert basis.shape == (6, task.freedom(robot))
        np.testing.assert_allclose(np.asarray(J) @ np.asarray(basis), 0.0, atol=1e-9)
    assert reached >= 8


def step_for(task: Task, x: np.ndarray, ahead: np.ndarray) -> step_qp.StepQP:
    """Step QP at x with its target at the task's value at `ahead`, without obstacles near."""
    return _assembled(task, made_once.robot(), jnp.asarray(x), jnp.asarray(ahead))


@partial(made_once.quick_jit, static_argnames="task")
def _assembled(task: Task, robot: Robot, x: jax.Array, ahead: jax.Array) -> step_qp.StepQP:
    error = task.error(task.value(robot, x), task.value(robot, ahead))
    far = jnp.full(1, 10.0), jnp.zeros((1, 6))
    limits = jnp.full(6, -4.0), jnp.full(6, 4.0)
    return step_qp.assemble(Settings(), x, x, error, task.jacobian(robot, x), *far, jnp.zeros(()), *limits)


@pytest.mark.parametrize("name", TASKS)
def test_both_solvers_take_the_same_step_for_any_task_also_without_a_choice(name):
    task, rng = TASKS[name], np.random.default_rng(1)
    for x in made_once.configurations_near(made_once.START, 5, 0.5):
        qp = step_for(task, x, x + rng.uniform(-0.05, 0.05, 6))
        host = ClarabelSolver(np.asarray(qp.P), 1, task_rows=task.rows).solve(
            jax.tree.map(lambda a: np.asarray(a)[None], qp)
        )
        device = made_once.quick_jit(solve_step)(qp)
        assert host.status[0] == device.status == step_qp.QPStatus.SOLVED
        np.testing.assert_allclose(device.y, host.y[0], atol=1e-6)
        np.testing.assert_allclose(np.asarray(qp.A) @ np.asarray(device.y), qp.b, atol=1e-9)


def test_a_step_without_a_choice_that_breaks_a_limit_is_infeasible():
    task = TASKS["as many rows as joints"]
    x = np.array(made_once.START)
    qp = step_for(task, x, x + 0.05)._replace(ub=jnp.full(6, 0.01))
    assert made_once.quick_jit(solve_step)(qp).status == step_qp.QPStatus.INFEASIBLE


def test_the_success_criterion_is_clear_by_the_margin_and_on_the_target():
    task = Task(tolerance_m=1e-3)
    clearance, residual = np.array([-1e-9, 0.0, 1e-9, 4e-4, 5e-4]), np.array([0.0, 1e-3, 1.001e-3, 0.0, 1e-3])
    np.testing.assert_array_equal(task.is_satisfied(clearance, 0.0, 0.0), [False, False, True, True, True])
    np.testing.assert_array_equal(task.is_satisfied(1.0, residual, 0.0), [True, True, False, True, True])
    np.testing.assert_array_equal(task.is_satisfied(clearance, residual, 5e-4), [False, False, False, False, True])


def test_a_task_that_is_none_is_refused():
    with pytest.raises(InputError, match="axes of a task point is"):
        TaskPoint(axes=(2, 1))
    with pytest.raises(InputError, match="offset_m of the TCP must be 0"):
        TaskPoint(offset_m=(0.1, 0.0, 0.0))
    with pytest.raises(InputError, match="the task has 9 equations, more than the 6 joints of robot gp50"):
        Task((TaskPoint(), ELBOW, TaskPoint(link=4))).freedom(made_once.robot())


def test_the_default_task_is_the_papers():
    robot, x = made_once.robot(), jnp.asarray(made_once.START)
    np.testing.assert_array_equal(TCP_POSITION.value(robot, x), tcp_position(robot, x))
    assert TCP_POSITION.rows == 3 and TCP_POSITION.freedom(robot) == 3


# Planning with tasks


def along(task: Task, xs: np.ndarray, number: int = 0) -> Scenario:
    """A scenario in the duct whose targets are the task's values at these configurations, starting at the first."""
    robot = made_once.robot()
    given = make_scenario(robot, made_once.duct(), xs[0], margin_m=0.0, number=number)
    targets = np.stack([np.asarray(task.value(robot, jnp.asarray(x))) for x in xs])
    return dataclasses.replace(given, targets=targets, count=np.asarray(len(targets), np.int32))


def test_a_task_with_as_many_rows_as_joints_is_planned_and_says_where_there_is_no_null_space_to_recover_in():
    task = dataclasses.replace(TASKS["as many rows as joints"], tolerance_m=1e-6)
    start = np.array(made_once.START)
    xs = start + np.linspace(0, 1, 4)[:, None] * np.array([0.02, 0.03, -0.02, 0.04, 0.03, 0.05])
    free, lost = along(task, xs), along(task, xs, number=1)
    lost.targets[2:] += 5.0  # out of the arm's reach
    plans = plan(Problem.of(made_once.robot(), made_once.duct(), [free, lost], task=task), "nspace-sqp")
    assert plans.tracked[0].all() and plans.outcome(0).complete
    for x, target in zip(plans.x[0], plans.target[0], strict=True):
        assert task.reached(task.residual_at(made_once.robot(), jnp.asarray(x), jnp.asarray(target)))
    np.testing.assert_allclose(plans.x[0], xs, atol=5e-3)  # these are the only solutions
    assert plans.tracked[1].tolist() == [True, True, False, False]
    assert plans.outcome(1).status == Status.NO_NULL_SPACE and "no null space" in Status.NO_NULL_SPACE.message


def test_targets_must_have_as_many_numbers_as_the_task_has_rows():
    scenario = make_scenario(made_once.robot(), made_once.duct(), made_once.START)
    with pytest.raises(InputError, match="the task has 1 equations, but the targets have 3 numbers"):
        plan(Problem.of(made_once.robot(), made_once.duct(), scenario, task=TASKS["its height"]), "baseline")


def test_a_further_obstacle_is_kept_clear_of_as_the_workpiece_is():
    """Additional obstacle, kept clear of by the margin like the workpiece.

    A floor blocks the way down: with it no tracked configuration is nearer to it than the margin.
    """
    robot, duct, margin_m = made_once.robot(), made_once.duct(), 5e-3
    xs = np.array(made_once.START) + np.linspace(0, 1, 6)[:, None] * np.array([0.0, 0.25, -0.1, 0.0, 0.1, 0.0])
    scenario = dataclasses.replace(along(TCP_POSITION, xs), margin_m=np.asarray(margin_m))

    @made_once.quick_jit
    def smallest(floor: Floor, x):
        return floor.smallest(robot, scenario, bodies_at(robot, scenario, x))

    def above(height_m: float, x) -> float:
        return float(smallest(Floor(jnp.asarray(height_m)), jnp.asarray(x)))

    height_m = sorted(above(0.0, x) for x in xs)[1]  # some configurations are nearer than the margin
    free, kept = (  # with a floor far below all configurations, and with this one
        plan(Problem.of(robot, duct, scenario, obstacles=(Floor(jnp.asarray(height)),)), "baseline")
        for height in (-1e3, height_m)
    )
    assert free.tracked.all() and min(above(height_m, x) for x in free.x[0]) < margin_m
    for x in kept.x[kept.tracked]:
        assert above(height_m, x) >= margin_m - 1e-12
    assert not kept.tracked.all() or np.abs(kept.x - free.x).max() > 1e-3
