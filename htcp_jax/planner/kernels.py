"""The engine's device side: pure functions of one lane.

A kernel takes what all lanes share and one lane's arguments; `programs` runs it over tables of them.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.clearance.joint_path import path_clear
from htcp_jax.clearance.obstacles import Linearisation, linearise
from htcp_jax.clearance.scene import Scene, own_scene
from htcp_jax.clearance.verdict import counts
from htcp_jax.numerics import product, safe_norm
from htcp_jax.planner.lane_inputs import Task
from htcp_jax.planner.methods import Sample
from htcp_jax.planner.null_space import (
    Anchored,
    Stuck,
    anchor,
    keep_clear_ascent,
    null_space_step,
    push_clear,
    stuck_key,
)
from htcp_jax.planner.sampling import Candidates, draw_clear
from htcp_jax.scene.inverse_kinematics import reanchor
from htcp_jax.scene.kinematics import tip_segment
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
    clearance: jax.Array
    residual: jax.Array


def _scene(scene: Scene, task: Task) -> Scene:
    return own_scene(scene, task.tool_extension_m)


def _stuck(settings: Settings, task: Task, x_previous, stage: int) -> Stuck:
    return Stuck(x_previous, task.target, stuck_key(settings, task.number, task.row, stage, task.round))


def prepare(settings: Settings, scene: Scene, task: Task, x_ref, x_previous, linear: Linearisation) -> step_qp.StepQP:
    """The step QP of one lane, equation (8)."""
    scene = _scene(scene, task)
    robot = scene.robot
    return step_qp.assemble(
        settings,
        x_ref,
        x_previous,
        task.target - linear.tcp,
        linear.jacobian,
        linear.clearance,
        linear.gradient,
        task.margin_m + settings.aim_above_m,
        robot.lower,
        robot.upper,
    )


def advance(settings: Settings, scene: Scene, task: Task, x_ref, y) -> Measured:
    """The lane after a step y: inside the limits to the last bit, linearised as equation (7) has it, and measured
    against its target."""
    scene = _scene(scene, task)
    x = jnp.clip(x_ref + y, scene.robot.lower, scene.robot.upper)
    linear = linearise(scene.robot, scene.obstacle, task, x)
    return Measured(x, linear, jnp.min(linear.clearance), safe_norm(linear.tcp - task.target))


def _measured(settings: Settings, scene: Scene, task: Task, x) -> Measured:
    return advance(settings, scene, task, x, jnp.zeros_like(x))


class Tracked(NamedTuple):
    """A lane after a burst of step QPs: where it is, how many this target has taken, and the last one's verdict."""

    now: Measured
    iteration: jax.Array
    verdict: jax.Array


def track(settings: Settings, scene: Scene, task: Task, x_ref, x_previous, linear, iteration) -> Tracked:
    """Step QPs solved on the device, one after the other, until the target is reached, the lane is stuck, or the burst
    is over."""

    def going(state: tuple[Tracked, jax.Array]):
        lane, count = state
        here = counts(lane.now.clearance, lane.now.residual, task.margin_m, settings.tolerance_m)
        reached = here & (lane.iteration > 0)
        solved = lane.verdict == step_qp.QPStatus.SOLVED
        return ~reached & solved & (lane.iteration < settings.inner_iterations) & (count < STEPS_A_BURST)

    def step(state: tuple[Tracked, jax.Array]):
        lane, count = state
        step_qp = prepare(settings, scene, task, lane.now.x, x_previous, lane.now.linear)
        found = solve_step(step_qp, settings.qp_tolerance)
        return Tracked(advance(settings, scene, task, lane.now.x, found.y), lane.iteration + 1, found.status), count + 1

    # At a new target, and in a candidate's first burst, nothing is reached before the first step QP.
    known = Measured(x_ref, linear, jnp.full((), -jnp.inf), jnp.full((), jnp.inf))
    start = Tracked(known, iteration, jnp.full((), int(step_qp.QPStatus.SOLVED), jnp.int32))
    return jax.lax.while_loop(going, step, (start, jnp.zeros((), jnp.int32)))[0]


def enter_null_space(settings: Settings, scene: Scene, task: Task, x_previous) -> Measured:
    """Algorithm 1, line 9: inverse kinematics of the stuck target from x_{t-1}."""
    own = _scene(scene, task)
    x, _ = reanchor(own.robot, x_previous, task.target, 0.1 * settings.tolerance_m)
    return _measured(settings, scene, task, anchor(own, settings, task, x, task.target).x)


def walk_null_space(stage, index, settings: Settings, scene: Scene, task: Task, x_previous, x_ref, count) -> Measured:
    """One step of a null-space stage."""
    stuck = _stuck(settings, task, x_previous, index)
    there = null_space_step(stage.minimise, _scene(scene, task), settings, task, stuck, x_ref, count)
    return _measured(settings, scene, task, there.x)


def propose(stage: Sample, index, settings: Settings, scene: Scene, task: Task, x_previous) -> Candidates:
    """Candidates of a sampling stage."""
    scene = _scene(scene, task)
    return stage.propose(scene, settings, task, _stuck(settings, task, x_previous, index))


def push(settings: Settings, scene: Scene, task: Task, x) -> Anchored:
    """x carried over to the task's target and pushed clear."""
    return push_clear(_scene(scene, task), settings, task, x, task.target)


def draw(settings: Settings, scene: Scene, task: Task) -> Anchored:
    """The best of a round of draws at the task's target; which round is the task's."""
    scene = _scene(scene, task)
    stuck = _stuck(settings, task, jnp.zeros_like(scene.robot.lower), DRAW_STAGE)
    return draw_clear(scene, settings, task, stuck, task.round % SPREAD_EVERY == SPREAD_EVERY - 1)


def ascend(settings: Settings, scene: Scene, task: Task, x):
    """Keep-clear ascent at the target just reached."""
    scene = _scene(scene, task)
    return keep_clear_ascent(scene, settings, task, x, task.target)


def check_path(settings: Settings, scene: Scene, task: Task, a, b):
    """Whether the straight joint path from a to b is clear."""
    scene = _scene(scene, task)
    return path_clear(scene, settings, task, a, b)


def tip(settings: Settings, scene: Scene, task: Task, x):
    """The tool's bare tip at x in the workpiece's frame, from the last body to the TCP."""
    rotate, translate = task.T_world_workpiece[:3, :3], task.T_world_workpiece[:3, 3]
    return product(tip_segment(_scene(scene, task).robot, x) - translate[None, :], rotate)
