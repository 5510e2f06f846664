"""Sampling stages: recoveries that propose many configurations at once, as candidates for a stuck scenario.

The step QPs then track the target from each candidate. Each stage is a pure function of one scenario.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.clearance import HasWorkpiecePose, Scene, is_clear
from htcp_jax.model import Task, reanchor, within_limits
from htcp_jax.motion import step_functions
from htcp_jax.numerics import null_basis, product, safe_norm
from htcp_jax.planning.tracking.null_space import DRAWS, PUSHED, HasMargin, StuckScenario, anchor, push_clear
from htcp_jax.settings import Settings
from htcp_jax.types import Array, Bool, Float

CLEAREST = 24  # number of samples that `best_nspace_samples` tracks if none is clear and on the target


class Candidates(NamedTuple):
    """Candidates: configurations from which step QPs track the stuck target."""

    x: Float[Array, "C N"]  # [rad or m]
    valid: Bool[Array, "C"]  # False: the candidate is not tried
    done: Bool[Array, "C"]  # True: already clear and on the target, so that no QP is needed


Propose = Callable[[Scene, Settings, HasWorkpiecePose, StuckScenario], Candidates]


def cspace_samples(scene: Scene, settings: Settings, where: HasWorkpiecePose, stuck: StuckScenario) -> Candidates:
    """Return configurations sampled about x_{t-1}, the paper's C-Space sample.

    The paper does not state the distribution. Draws are uniform: within +-1 rad in joint 3, and within +-2 rad in the
    joints after it; the first two, which carry all others, do not move. Among 8 * `samples` draws, the first `samples`
    valid ones are returned. Valid draws are within the joint limits and `max_sample_distance_rad`, and clear.
    """
    robot, n = scene.robot, scene.robot.dof
    width = jnp.asarray([0.0, 0.0, 1.0] + [2.0] * (n - 3))
    draw = jax.random.uniform(stuck.key, (8 * settings.samples, n), minval=-1.0, maxval=1.0)
    x = stuck.x_previous[None, :] + width[None, :] * draw
    feasible = jax.vmap(lambda x: within_limits(robot, x))(x) & jax.vmap(
        lambda x: is_clear(robot, scene.obstacles, where, x)
    )(x)
    feasible &= jax.vmap(safe_norm)(x - stuck.x_previous[None, :]) <= settings.max_sample_distance_rad
    return Candidates(x, feasible & (jnp.cumsum(feasible) <= settings.samples), jnp.zeros_like(feasible))


def nspace_samples(
    scene: Scene, settings: Settings, where: HasWorkpiecePose, stuck: StuckScenario, step_rad: tuple[float, ...]
) -> Candidates:
    """Return configurations sampled in the null space, the paper's N-Space sample.

    For each random direction and each given length, `sample_steps` steps are taken. At every step the direction is
    projected onto the null space of the current configuration. Configurations are re-anchored if the TCP error exceeds
    the tolerance.

    Args:
        scene: Arm with its tool, obstacles and task.
        settings: Number of samples and steps, and the maximum distance.
        where: Pose of the workpiece; not used.
        stuck: The stuck scenario.
        step_rad: Lengths of the steps.
    """
    robot, task = scene.robot, scene.task
    origin, _ = reanchor(robot, stuck.x_previous, stuck.target, task.fine_m, task=task)
    first = null_basis(task.linear_at(robot, origin, stuck.target).jacobian)
    draw = jax.random.normal(stuck.key, (settings.samples, first.shape[1]))
    directions = jax.vmap(lambda w: product(first, w / safe_norm(w)))(draw)

    def travel(direction, length):
        def step(_, state):
            x, v = state
            basis = null_basis(task.linear_at(robot, x, stuck.target).jacobian)
            v = product(basis, product(v, basis))
            v = v / jnp.maximum(safe_norm(v), 1e-12)
            x = jnp.clip(x + length * v, robot.lower, robot.upper)
            anchored, _ = reanchor(robot, x, stuck.target, task.fine_m, iterations=3, task=task)
            return jnp.where(task.reached(task.residual_at(robot, x, stuck.target)), x, anchored), v

        x, _ = jax.lax.fori_loop(0, settings.sample_steps, step, (origin, direction))
        return x

    x = jnp.concatenate([jax.vmap(lambda v, r=r: travel(v, r))(directions) for r in step_rad])
    near = jax.vmap(safe_norm)(x - stuck.x_previous[None, :]) <= settings.max_sample_distance_rad
    return Candidates(x, near, jnp.zeros_like(near))


def best_nspace_samples(
    scene: Scene, settings: Settings, where: HasMargin, stuck: StuckScenario, step_rad: tuple[float, ...]
) -> Candidates:
    """Return N-Space samples; those that are clear and on the target are `done`.

    If no sample is `done`, the CLEAREST clearest samples are valid, and are tracked.

    Args:
        scene: Arm with its tool, obstacles and task.
        settings: Settings of the planner.
        where: Pose of the workpiece and the required clearance.
        stuck: The stuck scenario.
        step_rad: Lengths of the steps.
    """
    x, near, _ = nspace_samples(scene, settings, where, stuck, step_rad)
    here = jax.vmap(lambda x: anchor(scene, settings, where, x, stuck.target))(x)
    done = near & scene.task.is_satisfied(here.clearance, here.residual, where.margin_m)
    rank = jnp.where(near & ~done, here.clearance, -jnp.inf)
    worth = rank >= jax.lax.top_k(rank, CLEAREST)[0][-1]
    return Candidates(here.x, done | (near & worth & ~jnp.any(done)), done)


def draw_clear(
    scene: Scene, settings: Settings, where: HasMargin, stuck: StuckScenario, spread: Bool[Array, ""]
) -> step_functions.State:
    """Return PUSHED configurations from a round of random draws, pushed clear; the clearest first.

    Draws are uniform within the joint limits. Each draw is brought onto the target. The clearest PUSHED ones are pushed
    clear or, with `spread`, any PUSHED of the clearest quarter: the clearest ones are often similar, for example all on
    the same side of the workpiece, with no path back.

    Args:
        scene: Arm with its tool, obstacles and task.
        settings: Settings of the planner.
        where: Pose of the workpiece and the required clearance.
        stuck: The stuck scenario.
        spread: True to push any draws of the clearest quarter.
    """
    robot = scene.robot
    lower, upper = jnp.maximum(robot.lower, -jnp.pi), jnp.minimum(robot.upper, jnp.pi)
    draw = jax.random.uniform(stuck.key, (DRAWS, lower.shape[0]))
    x = lower[None, :] + (upper - lower)[None, :] * draw
    reached = jax.vmap(lambda x: anchor(scene, settings, where, x, stuck.target))(x)
    order = jnp.argsort(-_clearance_rank(scene.task, reached))
    quarter = jnp.sort(order[: DRAWS // 4])  # in the order of the draws, which is random
    first = jnp.where(spread, quarter[:PUSHED], order[:PUSHED])
    pushed = jax.lax.map(lambda x: push_clear(scene, settings, where, x, stuck.target), reached.x[first])
    order = jnp.argsort(-_clearance_rank(scene.task, pushed))
    return jax.tree.map(lambda leaf: leaf[order], pushed)


def _clearance_rank(task: Task, here: step_functions.State) -> Float[Array, "*n"]:
    return jnp.where(task.reached(here.residual), here.clearance, -jnp.inf)
