"""Kernels that look for other postures at a target: in the null space of the task, or drawn."""

import jax.numpy as jnp

from htcp_jax.clearance.scene import Scene, own_scene
from htcp_jax.planner.kernel import DEEP, SAMPLED, Kernel
from htcp_jax.planner.kernels import Measured, measured
from htcp_jax.planner.lane_inputs import LaneInputs
from htcp_jax.planner.null_space import READS, Anchored, anchor, keep_clear_ascent, push_clear, stuck_at
from htcp_jax.planner.sampling import draw_clear
from htcp_jax.scene.inverse_kinematics import reanchor
from htcp_jax.settings import Settings

SPREAD_EVERY = 3  # rounds of draws: in every third any of the better draws are pushed clear, not the clearest alone
DRAW_STAGE = 99  # random keys of draws lie apart from those of the stages


def enter_null_space(settings: Settings, scene: Scene, lane: LaneInputs, x_previous) -> Measured:
    """Algorithm 1, line 9: inverse kinematics of the stuck target from x_{t-1}."""
    own = own_scene(scene, lane.tool_extension_m)
    x, _ = reanchor(own.robot, x_previous, lane.target, own.task.fine_m, task=own.task)
    return measured(settings, scene, lane, anchor(own, settings, lane, x, lane.target).x)


def push(settings: Settings, scene: Scene, lane: LaneInputs, x) -> Anchored:
    """x carried over to the lane's target and pushed clear."""
    return push_clear(own_scene(scene, lane.tool_extension_m), settings, lane, x, lane.target)


def draw(settings: Settings, scene: Scene, lane: LaneInputs) -> Anchored:
    """The best of a round of draws at the lane's target; which round is the lane's."""
    scene = own_scene(scene, lane.tool_extension_m)
    stuck = stuck_at(lane, jnp.zeros_like(scene.robot.lower), DRAW_STAGE)
    return draw_clear(scene, settings, lane, stuck, lane.round % SPREAD_EVERY == SPREAD_EVERY - 1)


def ascend(settings: Settings, scene: Scene, lane: LaneInputs, x):
    """Keep-clear ascent at the target just reached."""
    scene = own_scene(scene, lane.tool_extension_m)
    return keep_clear_ascent(scene, settings, lane, x, lane.target)


ENTER = Kernel("enter", enter_null_space, DEEP)
ASCEND = Kernel("ascend", ascend, DEEP, (*READS, "keep_clear_m", "keep_clear_steps"))
PUSH = Kernel("push", push, DEEP, READS)
DRAW = Kernel("draw", draw, SAMPLED, READS)
