"""Recovery stages of a method: tried in order when the step QPs are stuck, each with its own lane function."""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.clearance import Scene
from htcp_jax.device import Loop, lane_function
from htcp_jax.model import reanchor
from htcp_jax.motion import lane_inputs, step_functions
from htcp_jax.planning.tracking.null_space import (
    READS,
    Minimise,
    anchor,
    keep_clear_ascent,
    null_space_step,
    push_clear,
    stuck_at,
)
from htcp_jax.planning.tracking.sampling import Candidates, Propose, draw_clear
from htcp_jax.settings import Settings
from htcp_jax.types import Int, Joints

SPREAD_EVERY = 3  # in every third round of draws any draws of the clearest quarter are pushed clear
DRAW_STAGE = 99  # stage number in the random keys of draws, larger than the number of any stage


@dataclass(frozen=True)
class NullSpace:
    """Recovery stage that moves in the null space; every step minimises J2 on the sphere."""

    minimise: Minimise
    settings: tuple[str, ...] = ()  # names of the settings that `minimise` reads
    sizes: lane_function.DeviceSizes = lane_function.DEEP_LOOP  # number of lanes per call

    in_null_space = True

    def lane_function(self, index: int) -> lane_function.LaneFunction:
        """Return the lane function for a chunk of null-space steps, as stage `index` of a method."""
        reads = (*READS, *step_functions.MEASURED, *self.settings)
        return lane_function.LaneFunction(
            f"null space {index}", take_null_space_steps, self.sizes, reads, (self.minimise, index)
        )


@dataclass(frozen=True)
class Sample:
    """Recovery stage that proposes candidates, from which step QPs track the target."""

    propose: Propose
    settings: tuple[str, ...] = ()  # names of the settings that `propose` reads
    in_null_space: bool = True  # True if the stage needs a null space

    def lane_function(self, index: int) -> lane_function.LaneFunction:
        """Return the lane function that proposes a lane's candidates, as stage `index` of a method."""
        return lane_function.LaneFunction(
            f"sample {index}", propose, lane_function.SAMPLED, self.settings, (self.propose, index)
        )


@dataclass(frozen=True, kw_only=True)
class Recoveries:
    """Recoveries of a method, and its actions between targets."""

    stages: tuple[NullSpace | Sample, ...] = ()  # tried in order at a stuck target
    keep_clear: bool = False  # True: increase D in the null space after every target
    replan_backwards: bool = False  # True: if all stages fail, plan backwards from configurations at the failed target
    check_paths: bool = False  # True: every joint path must be clear, regardless of the settings

    @property
    def backwards(self) -> int:
        """`Plans.recovery` of targets that were planned backwards: one more than the last stage."""
        return len(self.stages) + 1


class NullSpaceState(NamedTuple):
    """A lane after a chunk of null-space steps."""

    now: step_functions.State
    null_space_steps: jax.Array  # number of steps so far


def take_null_space_steps(
    minimise: Minimise,
    index: int,
    settings: Settings,
    scene: Scene,
    lane: lane_inputs.LaneInputs,
    x_previous: Joints,
    x_ref: Joints,
    null_space_steps: Int[jax.Array, ""],
    most: Int[jax.Array, ""],
) -> Loop:
    """Take null-space steps until the target is reached with the margin (Algorithm 1, lines 10 to 14).

    The chunk also ends after `most` steps.

    Args:
        minimise: Minimiser on the sphere.
        index: Number of the method's stage; part of the random key.
        settings: Settings of the planner.
        scene: Arm, obstacles and task.
        lane: The lane's inputs.
        x_previous: Configuration at the previous target [rad or m].
        x_ref: Configuration to continue from [rad or m].
        null_space_steps: Number of steps so far.
        most: Number of steps at which the chunk ends.

    Returns:
        A loop whose state is `NullSpaceState`.
    """
    stuck = stuck_at(lane, x_previous, index)

    def going(there: NullSpaceState):
        here = scene.task.is_satisfied(there.now.clearance, there.now.residual, lane.margin_m)
        return ~(here & (there.null_space_steps > null_space_steps)) & (there.null_space_steps < most)

    def step(here: Scene, there: NullSpaceState) -> NullSpaceState:
        new = null_space_step(minimise, scene, settings, lane, stuck, there.now.x, there.null_space_steps)
        return NullSpaceState(step_functions.measured(settings, here, lane, new.x), there.null_space_steps + 1)

    now = step_functions.empty_result(partial(step_functions.measured, settings, scene, lane), x_ref)._replace(x=x_ref)
    return Loop(NullSpaceState(now, null_space_steps), going, step)


def propose(
    proposed: Propose, index: int, settings: Settings, scene: Scene, lane: lane_inputs.LaneInputs, x_previous
) -> Candidates:
    """Return the candidates of a sampling stage.

    Args:
        proposed: Function that draws the candidates.
        index: Number of the method's stage; part of the random key.
        settings: Settings of the planner.
        scene: Arm, obstacles and task.
        lane: The lane's inputs.
        x_previous: Configuration at the previous target (N,) [rad or m].
    """
    return proposed(scene, settings, lane, stuck_at(lane, x_previous, index))


def enter_null_space(
    settings: Settings, scene: Scene, lane: lane_inputs.LaneInputs, x_previous: Joints
) -> step_functions.State:
    """Bring x_{t-1} onto the stuck target by inverse kinematics (5b), Algorithm 1, line 9.

    Args:
        settings: Settings of the planner.
        scene: Arm, obstacles and task.
        lane: The lane's inputs.
        x_previous: x_{t-1}, the configuration at the previous target [rad or m].
    """
    x, _ = reanchor(scene.robot, x_previous, lane.target, scene.task.fine_m, task=scene.task)
    return step_functions.measured(settings, scene, lane, anchor(scene, settings, lane, x, lane.target).x)


def push(settings: Settings, scene: Scene, lane: lane_inputs.LaneInputs, x) -> step_functions.State:
    """Return the state after bringing x (N,) [rad or m] onto the lane's target and pushing it clear."""
    return push_clear(scene, settings, lane, x, lane.target)


def draw(settings: Settings, scene: Scene, lane: lane_inputs.LaneInputs) -> step_functions.State:
    """Return the best configurations of a round of draws at the lane's target, see `draw_clear`."""
    stuck = stuck_at(lane, jnp.zeros_like(scene.robot.lower), DRAW_STAGE)
    return draw_clear(scene, settings, lane, stuck, lane.round % SPREAD_EVERY == SPREAD_EVERY - 1)


def ascend(settings: Settings, scene: Scene, lane: lane_inputs.LaneInputs, x):
    """Return the state after increasing D in the null space from x (N,) [rad or m], see `keep_clear_ascent`."""
    return keep_clear_ascent(scene, settings, lane, x, lane.target)


ENTER = lane_function.LaneFunction("enter", enter_null_space, lane_function.STEP, step_functions.MEASURED)
ASCEND = lane_function.LaneFunction("ascend", ascend, lane_function.STEP, (*READS, "keep_clear_m", "keep_clear_steps"))
PUSH = lane_function.LaneFunction("push", push, lane_function.STEP, READS, any_cone=True)
DRAW = lane_function.LaneFunction("draw", draw, lane_function.SAMPLED, READS)
