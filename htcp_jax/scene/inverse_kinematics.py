"""The way back onto a target: damped Newton inverse kinematics inside the joint limits."""

from functools import partial

import jax
import jax.numpy as jnp

from htcp_jax.numerics import of_shape, product, safe_norm, solve_spd
from htcp_jax.scene.kinematics import configuration
from htcp_jax.scene.robot import Robot
from htcp_jax.scene.task import TCP_POSITION, Task
from htcp_jax.types import Array, Bool, Float, Joints, Scalar


@partial(jax.jit, static_argnames=("tolerance_m", "iterations", "task"))
def reanchor(
    robot: Robot,
    x: Joints,
    target: Float[Array, "M"],
    tolerance_m: float,
    iterations: int = 20,
    task: Task = TCP_POSITION,
) -> tuple[Joints, Scalar]:
    """Damped Newton inverse kinematics inside the joint limits: (x, residual [m]), equation (10b).

    Stops at tolerance_m or after `iterations`. The damping (1e-3 m/rad)^2 keeps singular postures bounded and costs
    1e-6 of a Newton step elsewhere; a joint at its limit is held there while the others make up for it. Raises
    InputError for more than one configuration or target.
    """
    x, target = configuration(robot, x), of_shape(target, (task.rows,), "target")

    def off(x):
        return task.error(task.value(robot, x), target)

    def step(state):
        x, error, count = state
        jac = task.jacobian(robot, x)
        # A joint at its limit that the step would push further out takes no part.
        push = product(jac.T, _weighted(jac, error))
        blocked = ((x <= robot.lower) & (push < 0)) | ((x >= robot.upper) & (push > 0))
        jac = jnp.where(blocked[None, :], 0.0, jac)
        x = jnp.clip(x + product(jac.T, _weighted(jac, error)), robot.lower, robot.upper)
        return x, off(x), count + 1

    def going(state):
        _, error, count = state
        return (safe_norm(error) > tolerance_m) & (count < iterations)

    x, error, _ = jax.lax.while_loop(going, step, (x, off(x), jnp.zeros((), jnp.int32)))
    return x, safe_norm(error)


def _weighted(jac: Float[Array, "M N"], error: Float[Array, "M"]) -> Float[Array, "M"]:
    return solve_spd(product(jac, jac.T) + 1e-6 * jnp.eye(len(error)), error)


def inside(robot: Robot, x: Joints) -> Bool[Array, ""]:
    """Whether x respects the joint limits."""
    return jnp.all((x >= robot.lower) & (x <= robot.upper))
