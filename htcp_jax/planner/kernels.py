"""The engine's device side: pure functions of one lane.

A kernel takes what all lanes share and one lane's arguments; `programs` runs it over tables of them.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.clearance.joint_path import path_clear
from htcp_jax.clearance.scene import Linearisation, Scene, linearise, own_scene
from htcp_jax.numerics import product
from htcp_jax.planner.kernel import DEEP, SAMPLED, STEP, Kernel
from htcp_jax.planner.lane_inputs import LaneInputs
from htcp_jax.planner.null_space import (
    Anchored,
    Minimise,
    Stuck,
    anchor,
    keep_clear_ascent,
    null_space_step,
    push_clear,
    stuck_key,
)
from htcp_jax.planner.sampling import Candidates, Propose, draw_clear
from htcp_jax.scene.inverse_kinematics import reanchor
from htcp_jax.scene.kinematics import tcp_position, tip_segment
from htcp_jax.settings import Settings
from htcp_jax.solvers import step_qp
from htcp_jax.solvers.active_set import solve_step

STEPS_A_BURST = 5  # step QPs that `track` takes before the engine looks at the lanes again
SPREAD_EVERY = 3  # rounds of draws: in every third any of the better draws are pushed clear, not the clearest alone
DRAW_STAGE = 99  # random keys of draws lie apart from those of the stages


class Measured(NamedTuple):
    """A configuration, its linearisation, and how it stands to the target."""

    x: jax.Array
    linear: Linearisation
    clearance: jax.Array  # the smallest [m]
    residual: jax.Array  # [m]
    tcp: jax.Array  # world [m]


def _scene(scene: Scene, lane: LaneInputs) -> Scene:
    return own_scene(scene, lane.tool_extension_m)


def _stuck(lane: LaneInputs, x_previous, stage: int) -> Stuck:
    return Stuck(x_previous, lane.target, stuck_key(lane.seed, lane.number, lane.row, stage, lane.round))


def prepare(
    settings: Settings, scene: Scene, lane: LaneInputs, x_ref, x_previous, linear: Linearisation
) -> step_qp.StepQP:
    """The step QP of one lane, equation (8)."""
    scene = _scene(scene, lane)
    robot = scene.robot
    return step_qp.assemble(
        settings,
        x_ref,
        x_previous,
        scene.task.error(linear.task.value, lane.target),
        linear.task.jacobian,
        linear.clearance.distance,
        linear.clearance.gradient,
        lane.margin_m + settings.aim_above_m,
        robot.lower,
        robot.upper,
    )


def advance(settings: Settings, scene: Scene, lane: LaneInputs, x_ref, y) -> Measured:
    """The lane after a step y: inside the limits to the last bit, linearised as equation (7) has it, and measured
    against its target."""
    scene = _scene(scene, lane)
    x = jnp.clip(x_ref + y, scene.robot.lower, scene.robot.upper)
    linear = linearise(scene.robot, scene.obstacles, lane, x, scene.task)
    residual = scene.task.residual(linear.task.value, lane.target)
    return Measured(x, linear, jnp.min(linear.clearance.distance), residual, tcp_position(scene.robot, x))


def _measured(settings: Settings, scene: Scene, lane: LaneInputs, x) -> Measured:
    return advance(settings, scene, lane, x, jnp.zeros_like(x))


class Tracked(NamedTuple):
    """A lane after a burst of step QPs: where it is, how many this target has taken, and the last one's verdict."""

    now: Measured
    iteration: jax.Array
    verdict: jax.Array


def track(settings: Settings, scene: Scene, lane: LaneInputs, x_ref, x_previous, linear, iteration) -> Tracked:
    """Step QPs solved on the device, one after the other, until the target is reached, the lane is stuck, or the burst
    is over."""

    def going(state: tuple[Tracked, jax.Array]):
        tracked, count = state
        here = scene.task.counts(tracked.now.clearance, tracked.now.residual, lane.margin_m)
        reached = here & (tracked.iteration > 0)
        solved = tracked.verdict == step_qp.QPStatus.SOLVED
        return ~reached & solved & (tracked.iteration < settings.inner_iterations) & (count < STEPS_A_BURST)

    def step(state: tuple[Tracked, jax.Array]):
        tracked, count = state
        step_qp = prepare(settings, scene, lane, tracked.now.x, x_previous, tracked.now.linear)
        found = solve_step(step_qp, settings.qp_tolerance)
        now = advance(settings, scene, lane, tracked.now.x, found.y)
        return Tracked(now, tracked.iteration + 1, found.status), count + 1

    # At a new target, and in a candidate's first burst, nothing is reached before the first step QP.
    nowhere = jnp.zeros(3)  # the TCP is not recorded before
    known = Measured(x_ref, linear, jnp.full((), -jnp.inf), jnp.full((), jnp.inf), nowhere)
    start = Tracked(known, iteration, jnp.full((), int(step_qp.QPStatus.SOLVED), jnp.int32))
    return jax.lax.while_loop(going, step, (start, jnp.zeros((), jnp.int32)))[0]


def enter_null_space(settings: Settings, scene: Scene, lane: LaneInputs, x_previous) -> Measured:
    """Algorithm 1, line 9: inverse kinematics of the stuck target from x_{t-1}."""
    own = _scene(scene, lane)
    x, _ = reanchor(own.robot, x_previous, lane.target, own.task.fine_m, task=own.task)
    return _measured(settings, scene, lane, anchor(own, settings, lane, x, lane.target).x)


def walk_null_space(
    minimise: Minimise, index: int, settings: Settings, scene: Scene, lane: LaneInputs, x_previous, x_ref, count
) -> Measured:
    """One step of a null-space stage, the method's stage `index`."""
    stuck = _stuck(lane, x_previous, index)
    there = null_space_step(minimise, _scene(scene, lane), settings, lane, stuck, x_ref, count)
    return _measured(settings, scene, lane, there.x)


def propose(
    proposed: Propose, index: int, settings: Settings, scene: Scene, lane: LaneInputs, x_previous
) -> Candidates:
    """Candidates of a sampling stage, the method's stage `index`."""
    scene = _scene(scene, lane)
    return proposed(scene, settings, lane, _stuck(lane, x_previous, index))


def push(settings: Settings, scene: Scene, lane: LaneInputs, x) -> Anchored:
    """x carried over to the lane's target and pushed clear."""
    return push_clear(_scene(scene, lane), settings, lane, x, lane.target)


def draw(settings: Settings, scene: Scene, lane: LaneInputs) -> Anchored:
    """The best of a round of draws at the lane's target; which round is the lane's."""
    scene = _scene(scene, lane)
    stuck = _stuck(lane, jnp.zeros_like(scene.robot.lower), DRAW_STAGE)
    return draw_clear(scene, settings, lane, stuck, lane.round % SPREAD_EVERY == SPREAD_EVERY - 1)


def ascend(settings: Settings, scene: Scene, lane: LaneInputs, x):
    """Keep-clear ascent at the target just reached."""
    scene = _scene(scene, lane)
    return keep_clear_ascent(scene, settings, lane, x, lane.target)


def check_path(settings: Settings, scene: Scene, lane: LaneInputs, a, b):
    """Whether the straight joint path from a to b is clear."""
    scene = _scene(scene, lane)
    return path_clear(scene, settings, lane, a, b)


def tip(settings: Settings, scene: Scene, lane: LaneInputs, x):
    """The tool's bare tip at x in the workpiece's frame, from the last body to the TCP."""
    rotate, translate = lane.T_world_workpiece[:3, :3], lane.T_world_workpiece[:3, 3]
    return product(tip_segment(_scene(scene, lane).robot, x) - translate[None, :], rotate)


# The kernels by name, each with the settings that it reads

_STEP_QP = ("q_weights", "cost_about", "rows", "aim_above_m")
_NULL_SPACE = ("alpha_rad", "far_links", "j1_weight", "q_weights")

PREPARE = Kernel("prepare", prepare, STEP, _STEP_QP)
ADVANCE = Kernel("advance", advance, STEP)
TRACK_BURST = Kernel("track", track, STEP, (*_STEP_QP, "inner_iterations", "qp_tolerance"))
ENTER = Kernel("enter", enter_null_space, DEEP)
ASCEND = Kernel("ascend", ascend, DEEP, (*_NULL_SPACE, "keep_clear_m", "keep_clear_steps"))
PUSH = Kernel("push", push, DEEP, _NULL_SPACE)
DRAW = Kernel("draw", draw, SAMPLED, _NULL_SPACE)
CHECK_PATH = Kernel("check_path", check_path, DEEP, ("path_test", "path_steps"))
TIP = Kernel("tip", tip, STEP)


def walk_kernel(minimise: Minimise, index: int, settings: tuple[str, ...]) -> Kernel:
    """A step of stage `index` of a method, a walk by `minimise`, which reads `settings`."""
    return Kernel(f"walk {index}", walk_null_space, DEEP, (*_NULL_SPACE, *settings), (minimise, index))


def sample_kernel(proposed: Propose, index: int, settings: tuple[str, ...]) -> Kernel:
    """Candidates of stage `index` of a method, proposed by a function that reads `settings`."""
    return Kernel(f"sample {index}", propose, SAMPLED, settings, (proposed, index))
