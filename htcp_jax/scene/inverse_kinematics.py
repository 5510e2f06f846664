"""The null space of the position task: its basis, the step along it, and the way back onto the target."""

from functools import partial

import jax
import jax.numpy as jnp

from htcp_jax.errors import InputError
from htcp_jax.numerics import of_shape, product, safe_norm, solve_spd
from htcp_jax.scene.kinematics import configuration, jacobian, tcp_position
from htcp_jax.scene.robot import Robot
from htcp_jax.types import Array, Bool, Float, Joints, Scalar, Vector3


@jax.jit
def null_basis(task_jacobian: Float[Array, "M N"]) -> Float[Array, "N D"]:
    """Orthonormal basis of the null space of a task Jacobian of full rank M; D = N - M columns.

    (The paper prints its shape as M x (N - M); N x (N - M) is meant.) Gram-Schmidt on the rows, then on the unit
    vectors, each time the one that sticks out furthest (the first of equals), positive along it: unlike a singular
    value decomposition, sign and rotation are the same on every machine. Raises InputError for what is no matrix.
    """
    task_jacobian = jnp.asarray(task_jacobian)
    if task_jacobian.ndim != 2:
        raise InputError(f"the Jacobian has the shape {task_jacobian.shape}, (M, N) is needed; for many use jax.vmap")
    m, n = task_jacobian.shape
    found: list[Joints] = []
    for row in range(m):
        v = _without(found, task_jacobian[row])
        found.append(v / jnp.maximum(safe_norm(v), 1e-12))
    for _ in range(n - m):
        # How far a unit vector sticks out of the span of those found: the rest of its square.
        furthest = jnp.argmax(1.0 - sum(u * u for u in found))
        v = _without(found, jnp.where(jnp.arange(n) == furthest, 1.0, 0.0))
        found.append(v / safe_norm(v))
    return jnp.stack(found[m:], axis=1)


def _without(found: list[Joints], v: Joints) -> Joints:
    """v less its components along the unit vectors found; twice, because once leaves rounding behind."""
    for _ in range(2):
        for u in found:
            v = v - product(v, u) * u
    return v


@partial(jax.jit, static_argnames=("tolerance_m", "iterations"))
def reanchor(
    robot: Robot, x: Joints, target: Vector3, tolerance_m: float, iterations: int = 20
) -> tuple[Joints, Scalar]:
    """Damped Newton inverse kinematics inside the joint limits: (x, TCP error [m]), equation (10b).

    Stops at tolerance_m or after `iterations`. The damping (1e-3 m/rad)^2 keeps singular postures bounded and costs
    1e-6 of a Newton step elsewhere; a joint at its limit is held there while the others make up for it. Raises
    InputError for more than one configuration or target.
    """
    x, target = configuration(robot, x), of_shape(target, (3,), "target")

    def off(x):
        return target - tcp_position(robot, x)

    def step(state):
        x, error, count = state
        jac = jacobian(robot, x)
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


def _weighted(jac: Float[Array, "3 N"], error: Vector3) -> Vector3:
    return solve_spd(product(jac, jac.T) + 1e-6 * jnp.eye(3), error)


def inside(robot: Robot, x: Joints) -> Bool[Array, ""]:
    """Whether x respects the joint limits."""
    return jnp.all((x >= robot.lower) & (x <= robot.upper))
