"""Device functions of the beam search: extend a configuration to the next target, and move in the null space.

They are pure functions of one lane, as in `step_functions`. `CollisionChecker.edges` then proves, for many lanes at
once, that the results are motions.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance import Scene, minimum_clearance
from htcp_jax.clearance.proof import motion_proof
from htcp_jax.device import Loop, lane_function
from htcp_jax.model import kinematics, reanchor
from htcp_jax.motion import Problem, lane_inputs, step_functions
from htcp_jax.numerics import fold_keys, null_basis, product, safe_norm
from htcp_jax.settings import Settings
from htcp_jax.solvers import solve_step, step_qp

ENOUGH = 0.9  # share of `beam_aim_m` above the margin that is sufficient
PATIENCE = 6  # number of step QPs that aim at `beam_aim_m` above the margin; further ones aim at the margin alone
REACHING_STEPS = 24  # maximum number of steps towards another configuration
LEAST_STEP = 0.3  # minimum share of a step's length; a shorter step is blocked by joint limits


class Extension(NamedTuple):
    """Result of extending a lane to its target."""

    at: step_functions.State
    reached: jax.Array  # True if the state meets the success criterion
    step_qps: jax.Array  # number of step QPs solved


class SelfMotion(NamedTuple):
    """A lane's self-motion, step by step."""

    path: step_functions.State  # (steps, ...), of which the first `steps` are valid
    steps: jax.Array  # number of steps
    arrives: jax.Array  # True if the last configuration is within a step's length of the motion's end


def extend(settings: Settings, scene: Scene, lane: lane_inputs.LaneInputs, x) -> Loop:
    """Extend x (N,) [rad or m] from the previous target to the lane's target.

    Inverse kinematics is tried first, and accepted if its clearance is sufficiently near to `beam_aim_m` above the
    margin. Otherwise step QPs are solved: the first PATIENCE ones with this required clearance, the others with the
    margin alone.

    Returns:
        A loop whose result is `Extension`.
    """
    robot, task = step_functions.with_still_joints(scene, lane, x), scene.task
    of_moving = partial(step_functions.of_moving_joints, lane)
    above = jnp.array([settings.beam_aim_m, settings.aim_above_m])
    lower, upper = step_functions.joint_box(scene, lane, x)
    aims, enough = lane.margin_m + above, lane.margin_m + ENOUGH * above
    look = jax.jit(partial(step_functions.advance, settings))  # traced only once, for its shape and for the loop

    def going(state):
        here, _, aim, count = state
        there = (here.residual <= task.fine_m) & (here.clearance >= enough[jnp.minimum(aim, 1)])
        if lane.max_joint_step is not None:
            there &= jnp.all(jnp.abs(here.x - x) <= lane.max_joint_step)
        return ~there & (aim < 2) & (count <= settings.max_step_qps)

    def step(scene, state):
        here, straight, aim, count = state
        rows, held = here.linear.clearance, task.linear(*here.linear.task, lane.target)
        qp = step_qp.assemble(
            settings, here.x, x, held.error, of_moving(held.jacobian),
            rows.distance, of_moving(rows.gradient), aims[aim], lower, upper, held.slack, of_moving(held.gradient),
        )  # fmt: skip
        found = solve_step(qp, settings.qp_tolerance, task.optional)
        stuck = (found.status != step_qp.QPStatus.SOLVED) | ((aim == 0) & (count > PATIENCE))
        # The first iteration measures the result of inverse kinematics, the second x, from which step QPs continue.
        goes_to = jnp.where(count < 0, straight, x)
        y = jnp.where(stuck | (count < 1), goes_to - here.x, of_moving(found.y))
        return look(scene, lane, here.x, y), straight, jnp.where(stuck & (count > 0), aim + 1, aim), count + 1

    def extended(state) -> Extension:
        here, *_, count = state
        reached = task.is_satisfied(here.clearance, here.residual, lane.margin_m)
        return Extension(here._replace(linear=None), reached, jnp.maximum(count - 1, 0))

    straight, _ = reanchor(robot, x, lane.target, task.fine_m, task=task)
    zero = jnp.zeros((), jnp.int32)
    start = step_functions.empty_result(look, scene, lane, x, x)._replace(x=x, residual=jnp.full((), jnp.inf))
    return Loop((start, straight, zero, zero - 1), going, step, extended)


def self_motion(settings: Settings, scene: Scene, lane: lane_inputs.LaneInputs, x, end, motion_number) -> Loop:
    """Move from x (N,) [rad or m], on its target, in the null space: in a random direction, or towards an end.

    At every step the direction is projected onto the null space of the current configuration. The motion ends before
    the first configuration that is not valid. A random motion has a random number of steps. A motion towards an end
    has at most REACHING_STEPS; every step brings it nearer.

    Args:
        settings: Length and number of steps.
        scene: Arm, obstacles and task.
        lane: The lane's inputs.
        x: Configuration on the lane's target (N,) [rad or m].
        end: Another configuration at the same target (N,) [rad or m], or NaN for a random motion.
        motion_number: Number of a random motion in its round, which seeds its random numbers.

    Returns:
        A loop whose result is `SelfMotion`.
    """
    robot, task = step_functions.with_still_joints(scene, lane, x), scene.task
    length, of_moving = settings.self_motion_step_rad, partial(step_functions.of_moving_joints, lane)
    key = fold_keys(jax.random.PRNGKey(lane.seed), lane.number, lane.row, lane.round, motion_number)
    towards, count = jax.random.split(key)
    has_end = ~jnp.isnan(end[0])
    drawn = jax.random.randint(count, (), 1, settings.self_motion_steps + 1).astype(jnp.int32)
    most = jnp.where(has_end, REACHING_STEPS, drawn)

    def going(state):
        good, x, *_, steps = state
        return good & (steps < most) & ~(safe_norm(end - x) <= length)

    def step(_, state):
        _, x, direction, path, steps = state
        basis = null_basis(of_moving(task.linear_at(robot, x, lane.target).jacobian), task.optional)
        within = product(jnp.where(has_end, end - x, direction), basis)
        within = jnp.where(has_end | (steps > 0), within, direction[: basis.shape[1]])
        direction = of_moving(product(basis, within))
        direction = direction / jnp.maximum(safe_norm(direction), 1e-12)
        ahead = jnp.clip(x + length * direction, robot.lower, robot.upper)
        there, residual = reanchor(robot, ahead, lane.target, task.fine_m, task=task)
        D = minimum_clearance(robot, scene.obstacles, lane, there)
        good = task.is_satisfied(D, residual, lane.margin_m)
        nearer = safe_norm(end - there) <= safe_norm(end - x) - LEAST_STEP * length
        good &= jnp.where(has_end, nearer, safe_norm(there - x) >= LEAST_STEP * length)
        here = step_functions.State(there, clearance=D, residual=residual, tcp=kinematics.tcp_position(robot, there))
        path = jax.tree.map(lambda all_, new: all_.at[steps].set(jnp.where(good, new, all_[steps])), path, here)
        return good, jnp.where(good, there, x), direction, path, steps + good.astype(jnp.int32)

    def moved(state) -> SelfMotion:
        _, x, _, path, steps = state
        return SelfMotion(path, steps, safe_norm(end - x) <= length)

    rows = max(settings.self_motion_steps, REACHING_STEPS)
    names = {"x": x.shape, "clearance": (), "residual": (), "tcp": (3,)}
    path = step_functions.State(**{name: jnp.zeros((rows, *shape)) for name, shape in names.items()})
    # The first direction is random in the null space: its coordinates are the first entries of this vector.
    first = jax.random.normal(towards, x.shape)
    return Loop((jnp.full((), True), x, first, path, jnp.zeros((), jnp.int32)), going, step, moved)


EXTEND = lane_function.LaneFunction(
    "extend", extend, lane_function.TRACKED,
    ("q_weights", "cost_about", "clearance_rows", "aim_above_m", "max_step_qps", "qp_tolerance", "beam_aim_m"),
    any_cone=True,
)  # fmt: skip
SELF_MOTION = lane_function.LaneFunction(
    "self_motion", self_motion, lane_function.TRACKED, ("self_motion_steps", "self_motion_step_rad"), any_cone=True
)


def inputs_and_tubes(
    problem: Problem, scenario: np.ndarray, target: np.ndarray, draws: np.ndarray, turns: bool
) -> tuple[lane_inputs.LaneInputs, motion_proof.Tube]:
    """Return the inputs of lanes, and their tubes: for the segment to the target, or for a self-motion at the target.

    Args:
        problem: The problem.
        scenario: Row of each lane's scenario (n,).
        target: Index of each lane's target (n,).
        draws: Number of each lane's round of random draws (n,).
        turns: True for the tubes of self-motions, False for those of segments.
    """
    inputs = lane_inputs.lane_inputs(problem.scenarios, scenario, target, seed=problem.settings.seed, round_=draws)
    return inputs, problem.tubes(scenario, target + turns, turns=turns)
