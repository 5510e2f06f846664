"""Inverse kinematics: damped Newton steps within the joint limits."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.model.kinematics import checked_configuration
from htcp_jax.model.robot import Robot
from htcp_jax.model.task import TCP_POSITION, Task
from htcp_jax.numerics import checked_shape, product, safe_norm, solve_spd
from htcp_jax.types import Array, Bool, Float, Int, Joints, Scalar

DAMPING = 1e-6  # damping of a step [m2/rad2]


@partial(jax.jit, static_argnames=("tolerance_m", "iterations", "task"))
def reanchor(
    robot: Robot,
    x: Joints,
    target: Float[Array, "G"],
    tolerance_m: float,
    iterations: int = 20,
    task: Task = TCP_POSITION,
) -> tuple[Joints, Scalar]:
    """Move a configuration onto a target by damped Newton steps within the joint limits, equation (5b).

    The damping (1e-3 m/rad)^2 bounds the steps at singularities; elsewhere it shortens a Newton step by about 1e-6 of
    its length. A joint at its limit stays there while the others compensate. A violated band or cone adds a row to the
    step's equations. The derivative is that of the steps, in forward and in reverse mode.

    Args:
        robot: The robot.
        x: The initial configuration [rad or m].
        target: The task's goal (G,), in the format of its rows.
        tolerance_m: Residual at which to stop [m].
        iterations: Maximum number of steps.
        task: The task; static.

    Returns:
        The new configuration [rad or m] and its residual [m], which may exceed the tolerance.

    Raises:
        InputError: For more than one configuration or target.
    """
    x, target = checked_configuration(robot, x), checked_shape(target, (task.numbers,), "target")
    x, error, _ = _newton_steps(task, tolerance_m, iterations, robot, x, target)
    return x, task.residual_at(robot, x, target) if task.bands else safe_norm(error)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2))
def _newton_steps(
    task: Task, tolerance_m: float, iterations: int, robot: Robot, x: Joints, target: Float[Array, "G"]
) -> tuple[Joints, Float[Array, "R"], Int[Array, ""]]:
    """Return x after the steps of `reanchor`, the residual that the next step would remove [m], and their number."""
    off, slopes = partial(_residual_to_remove, robot, task, target), partial(_slopes, robot, task, target)

    def look(x):
        return x, off(x), slopes(x)

    def step(state):
        (x, error, jac), count = state
        return look(jnp.where(count < 0, x, damped_step(robot, x, error, jac, DAMPING))), count + 1

    def going(state):
        (_, error, _), count = state
        return (count < 0) | (safe_norm(error) > tolerance_m) & (count < iterations)

    # The first iteration evaluates the initial x, so that the kinematics is compiled only once.
    blank = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(look, x))
    (x, error, _), count = jax.lax.while_loop(going, step, ((x, *blank[1:]), jnp.full((), -1, jnp.int32)))
    return x, error, count


@_newton_steps.defjvp
def _derivative_of_newton_steps(task: Task, tolerance_m: float, iterations: int, primals, tangents):
    """Differentiate the same steps in a loop of fixed length: one that ends by a condition has no reverse mode."""
    found = *_, count = _newton_steps(task, tolerance_m, iterations, *primals)

    def again(robot, x, target):
        def step(x):
            error, jac = _residual_to_remove(robot, task, target, x), _slopes(robot, task, target, x)
            return damped_step(robot, x, error, jac, DAMPING)

        def next_one(x, number):
            return jax.lax.cond(number < count, step, lambda x: x, x), None

        x, _ = jax.lax.scan(next_one, x, jnp.arange(iterations, dtype=count.dtype))
        return x, _residual_to_remove(robot, task, target, x)

    return found, (*jax.jvp(again, primals, tangents)[1], np.zeros((), jax.dtypes.float0))


def damped_step(robot: Robot, x: Joints, error: Float[Array, "M"], jac: Float[Array, "M N"], damping: float) -> Joints:
    """Return x after a damped least-squares step within the joint limits (Siciliano et al., Robotics, section 3.7).

    A joint at its limit that the step would push further out is excluded.

    Args:
        robot: The robot.
        x: The configuration [rad or m].
        error: The error that the step removes [m].
        jac: J, minus the error's Jacobian [m/rad or m/m].
        damping: Number that is added to the diagonal of J J^T [m2/rad2].
    """

    def move(jac):
        return product(jac.T, solve_spd(product(jac, jac.T) + damping * jnp.eye(len(error)), error))

    push = move(jac)
    blocked = ((x <= robot.lower) & (push < 0)) | ((x >= robot.upper) & (push > 0))
    return jnp.clip(x + move(jnp.where(blocked[None, :], 0.0, jac)), robot.lower, robot.upper)


def _residual_to_remove(robot: Robot, task: Task, target: Float[Array, "G"], x: Joints) -> Float[Array, "R"]:
    """Return the residual that a step removes [m]: the error, then the violations of bands and cones."""
    if not task.bands:
        return task.error(task.value(robot, x), target)
    linear = task.linear_at(robot, x, target)
    return jnp.concatenate([linear.error, jnp.maximum(-linear.slack, 0.0)])


def _slopes(robot: Robot, task: Task, target: Float[Array, "G"], x: Joints) -> Float[Array, "R N"]:
    """Return minus the Jacobian of the residual in `_residual_to_remove` [m/rad or m/m]."""
    if task.is_points:
        return task.jacobian(robot, x)
    linear = task.linear_at(robot, x, target)
    return jnp.concatenate([linear.jacobian, jnp.where((linear.slack < 0)[:, None], linear.gradient, 0.0)])


def within_limits(robot: Robot, x: Joints) -> Bool[Array, ""]:
    """Return True if x is within the joint limits."""
    return jnp.all((x >= robot.lower) & (x <= robot.upper))
