"""What the roadmap asks of a device: to feed a posture on to the next target, and to walk on in the null space of one.

Pure functions of one lane, as in `kernels`.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.clearance.linearisation import linearise
from htcp_jax.clearance.motion_proof import Proof, Tube, Verdict, prove
from htcp_jax.clearance.obstacles import clearance
from htcp_jax.clearance.scene import Scene, own_scene
from htcp_jax.numerics import fold_keys, null_basis, product, safe_norm
from htcp_jax.planner.kernel import DEEP, Kernel
from htcp_jax.planner.lane_inputs import LaneInputs
from htcp_jax.scene.inverse_kinematics import reanchor
from htcp_jax.scene.kinematics import tcp_position
from htcp_jax.settings import Settings
from htcp_jax.solvers.active_set import solve_step
from htcp_jax.solvers.step_qp import QPStatus, assemble

ENOUGH = 0.9  # of what is aimed at above the margin
PATIENCE = 6  # step QPs that aim high, before they aim low
LEAST_STEP = 0.3  # of a walk's step; a shorter one is held by the joint limits


class Posture(NamedTuple):
    """Where a lane is, and how it stands to its target."""

    x: jax.Array
    clearance: jax.Array  # [m]
    residual: jax.Array  # [m]
    tcp: jax.Array  # world [m]


def _posture(scene: Scene, lane: LaneInputs, x) -> Posture:
    robot, task = scene.robot, scene.task
    D = clearance(robot, scene.obstacles, lane, x)
    return Posture(x, D, task.off(robot, x, lane.target), tcp_position(robot, x))


class Fed(NamedTuple):
    """A lane at its next target."""

    begun: jax.Array  # D where it was [m]
    at: Posture
    reached: jax.Array  # whether it counts there
    proof: Proof  # of the way there
    step_qps: jax.Array


class Walked(NamedTuple):
    """A lane after a walk."""

    at: Posture
    path: jax.Array  # (steps, N), of which the first `steps` are walked
    steps: jax.Array
    queries: jax.Array


def feed(settings: Settings, scene: Scene, lane: LaneInputs, x, tube: Tube) -> Fed:
    """From x at the target before: by inverse kinematics where that keeps clear of everything by `front_aim_m`, and
    else by step QPs, which aim as high at first, and in the end at what must be kept."""
    scene = own_scene(scene, lane.tool_extension_m)
    robot, task = scene.robot, scene.task
    above = jnp.array([settings.front_aim_m, settings.aim_above_m])
    aims, enough = lane.margin_m + above, lane.margin_m + ENOUGH * above
    measured = partial(_posture, scene, lane)

    def going(state):
        here, aim, count = state
        there = (here.residual <= task.fine_m) & (here.clearance >= enough[jnp.minimum(aim, 1)])
        return ~there & (aim < 2) & (count < settings.max_step_qps)

    def step(state):
        here, aim, count = state
        linear = linearise(robot, scene.obstacles, lane, here.x, task)
        to_target = task.error(linear.task.value, lane.target)
        rows = linear.clearance
        qp = assemble(
            settings, here.x, x, to_target, linear.task.jacobian, rows.distance, rows.gradient, aims[aim],
            robot.lower, robot.upper,
        )  # fmt: skip
        found = solve_step(qp, settings.qp_tolerance)
        lost = (found.status != QPStatus.SOLVED) | ((aim == 0) & (count >= PATIENCE))
        there = measured(jnp.where(lost, x, jnp.clip(here.x + found.y, robot.lower, robot.upper)))
        return there, jnp.where(lost, aim + 1, aim), count + 1

    straight = measured(reanchor(robot, x, lane.target, task.fine_m, task=task)[0])
    good = task.reached(straight.residual) & (straight.clearance >= enough[0])
    first = straight._replace(x=jnp.where(good, straight.x, x), residual=jnp.where(good, 0.0, jnp.inf))
    zero = jnp.zeros((), jnp.int32)
    here, _, count = jax.lax.while_loop(going, step, (first, zero, zero))
    here = here._replace(residual=task.off(robot, here.x, lane.target))
    reached = task.counts(here.clearance, here.residual, lane.margin_m)
    anywhere = tube._replace(radius=jnp.where(reached, tube.radius, jnp.inf))
    proof = prove(scene, lane, x, jnp.where(reached, here.x, x), anywhere)
    return Fed(clearance(robot, scene.obstacles, lane, x), here, reached, proof, count)


def walk(settings: Settings, scene: Scene, lane: LaneInputs, x, walker, tube: Tube) -> Walked:
    """From x, on its target, along a random direction of the null space, which is carried along by projection, for a
    random number of steps, as far as every step is a proven motion within the tube and counts. walker: tells the walks
    of one round from each other."""
    scene = own_scene(scene, lane.tool_extension_m)
    robot, task = scene.robot, scene.task
    key = fold_keys(jax.random.PRNGKey(lane.seed), lane.number, lane.row, lane.round, walker)
    towards, length = jax.random.split(key)
    basis = null_basis(task.jacobian(robot, x))
    first = product(basis, jax.random.normal(towards, (basis.shape[1],)))
    longest = jax.random.randint(length, (), 1, settings.walk_steps + 1)

    def going(state):
        good, _, walked = state
        return good & (walked.steps < longest)

    def step(state):
        _, direction, walked = state
        basis = null_basis(task.jacobian(robot, walked.at.x))
        direction = product(basis, product(direction, basis))
        direction = direction / jnp.maximum(safe_norm(direction), 1e-12)
        ahead = jnp.clip(walked.at.x + settings.walk_step_rad * direction, robot.lower, robot.upper)
        here = _posture(scene, lane, reanchor(robot, ahead, lane.target, task.fine_m, task=task)[0])
        good = task.counts(here.clearance, here.residual, lane.margin_m)
        good &= safe_norm(here.x - walked.at.x) >= LEAST_STEP * settings.walk_step_rad
        proof = prove(scene, lane, walked.at.x, jnp.where(good, here.x, walked.at.x), tube)
        good &= proof.verdict == Verdict.PROVEN
        new = Walked(here, walked.path.at[walked.steps].set(here.x), walked.steps + 1, walked.queries + proof.queries)
        return good, direction, jax.tree.map(lambda new, old: jnp.where(good, new, old), new, walked)

    zero = jnp.zeros((), jnp.int32)
    here = Posture(x, jnp.zeros(()), jnp.zeros(()), jnp.zeros(3))  # measured where a step was taken
    start = Walked(here, jnp.zeros((settings.walk_steps, x.shape[0])), zero, zero)
    return jax.lax.while_loop(going, step, (jnp.full((), True), first, start))[2]


FEED = Kernel(
    "feed", feed, DEEP,
    ("q_weights", "cost_about", "clearance_rows", "aim_above_m", "max_step_qps", "qp_tolerance", "front_aim_m"),
)  # fmt: skip
WALK = Kernel("walk", walk, DEEP, ("walk_steps", "walk_step_rad"))
