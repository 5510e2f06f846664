"""Pure functions of one lane that run on the device: step QPs, measurement, proofs.

A lane is a row of a batch. Each function takes the settings and the scene, which all lanes share, and the inputs of its
own lane. `device.executor` runs the functions over tables of lanes.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.clearance import Scene, in_workpiece, is_clear
from htcp_jax.clearance.obstacles import Linearisation, linearise, surely_collides
from htcp_jax.clearance.proof import ROUNDING_M, bisection, joint_path, known_rows, motion_proof
from htcp_jax.device import Loop, Remembering, by_chunks, lane_function
from htcp_jax.model import Robot, TaskLinear, kinematics, reanchor
from htcp_jax.motion.lane_inputs import LaneInputs
from htcp_jax.settings import Settings
from htcp_jax.solvers import solve_step, step_qp
from htcp_jax.types import Anywhere, Float, Int, Joints

STEP_ROUNDING = 1e-6  # tolerance of QP solvers, relative to the longest joint step
STEPS_PER_CHUNK = 5  # step QPs, or null-space steps, per call


class State(NamedTuple):
    """A configuration at a target with its measurements, or a table of n such states; not measured fields are None."""

    x: Float[Anywhere, "*n N"]  # configuration [rad or m]
    linear: Linearisation | None = None  # task and clearance to first order
    clearance: Float[Anywhere, "*n"] | None = None  # D, the smallest distance of all rows [m]
    residual: Float[Anywhere, "*n"] | None = None  # residual of the task [m]
    tcp: Float[Anywhere, "*n 3"] | None = None  # position of the TCP, world [m]


def prepare(
    settings: Settings, scene: Scene, lane: LaneInputs, x_ref, x_previous, linear: Linearisation
) -> step_qp.StepQP:
    """Return the step QP of one lane, equation (9).

    Args:
        settings: Settings of the planner.
        scene: The scene.
        lane: Scenario and target of the lane.
        x_ref (Joints): The current configuration [rad or m].
        x_previous (Joints): The configuration at the previous target [rad or m].
        linear: Task and clearance at x_ref to first order.
    """
    task = scene.task.linear(*linear.task, lane.target)
    lower, upper = joint_box(scene, lane, x_previous)
    return step_qp.assemble(
        settings,
        x_ref,
        x_previous,
        task.error,
        task.jacobian,
        linear.clearance.distance,
        linear.clearance.gradient,
        lane.margin_m + settings.aim_above_m,
        lower,
        upper,
        task.slack,
        task.gradient,
    )


def joint_box(scene: Scene, lane: LaneInputs, x: Joints) -> tuple[Joints, Joints]:
    """Return the joint limits at the lane's target: the arm's limits, narrowed by the maximum travel from x.

    Args:
        scene: The scene.
        lane: Scenario and target.
        x: The configuration at the previous target [rad or m].
    """
    robot = scene.robot
    if lane.max_joint_step is None:
        return robot.lower, robot.upper
    most = (1 - STEP_ROUNDING) * lane.max_joint_step
    return jnp.maximum(robot.lower, x - most), jnp.minimum(robot.upper, x + most)


def with_still_joints(scene: Scene, lane: LaneInputs, x: Joints) -> Robot:
    """Return the robot; the ranges of joints that must not move contain only their positions in x [rad or m]."""
    robot = scene.robot
    if lane.still is None:
        return robot
    lower, upper = (jnp.where(lane.still, x, limit) for limit in (robot.lower, robot.upper))
    return dataclasses.replace(robot, lower=lower, upper=upper)


def of_moving_joints(lane: LaneInputs, columns: Float[jax.Array, "*n N"]) -> Float[jax.Array, "*n N"]:
    """Return a Jacobian, gradients or a step with 0 for the joints that must not move."""
    return columns if lane.still is None else jnp.where(lane.still, 0.0, columns)


def advance(
    settings: Settings, scene: Scene, lane: LaneInputs, x_ref: Joints, y: Joints, smallest: bool = False
) -> State:
    """Return the lane's state after a step y, linearised by equations (6) to (8) and measured at the lane's target.

    Args:
        settings: Settings of the planner.
        scene: The scene.
        lane: Scenario and target.
        x_ref: The configuration before the step [rad or m].
        y: The step [rad or m]; x_ref + y is clipped to the joint limits.
        smallest: True to linearise only the smallest clearance, see `linearise`.
    """
    x = jnp.clip(x_ref + y, scene.robot.lower, scene.robot.upper)
    linear = linearise(scene.robot, scene.obstacles, lane, x, scene.task, smallest)
    residual = scene.task.residual(linear.task.value, lane.target)
    return State(x, linear, jnp.min(linear.clearance.distance), residual, kinematics.tcp_position(scene.robot, x))


def advance_smallest(settings: Settings, scene: Scene, lane: LaneInputs, x_ref, y) -> State:
    """Return the lane's state after a step, linearised with only the smallest clearance."""
    return advance(settings, scene, lane, x_ref, y, smallest=True)


def measured(settings: Settings, scene: Scene, lane: LaneInputs, x) -> State:
    """Return the lane's state at x, linearised for the step QP."""
    return advance(settings, scene, lane, x, jnp.zeros_like(x), settings.clearance_rows == "smallest")


def empty_result(look: Callable, *arguments) -> Any:
    """Return zeros with the structure and shapes of the result of look(*arguments)."""
    return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(look, *arguments))


class TrackingState(NamedTuple):
    """A lane after a chunk of step QPs."""

    now: State
    iteration: jax.Array  # number of step QPs solved for this target
    verdict: jax.Array  # status of the last step QP


def track(
    settings: Settings,
    scene: Scene,
    lane: LaneInputs,
    x_ref: Joints,
    x_previous: Joints,
    linear: Linearisation,
    iteration: Int[jax.Array, ""],
) -> Loop:
    """Solve step QPs (9) on the device, one after the other: Algorithm 1, line 7.

    The loop ends when the target is reached, the lane is stuck, or the chunk of steps is complete.

    Args:
        settings: Settings of the planner.
        scene: The scene.
        lane: Scenario and target.
        x_ref: The current configuration [rad or m].
        x_previous: The configuration at the previous target [rad or m].
        linear: Task and clearance at x_ref to first order.
        iteration: Number of step QPs already solved for this target.

    Returns:
        A loop whose state is `TrackingState`.
    """
    most = jnp.minimum(iteration + STEPS_PER_CHUNK, settings.max_step_qps)

    def going(tracked: TrackingState):
        here = scene.task.is_satisfied(tracked.now.clearance, tracked.now.residual, lane.margin_m)
        reached = here & (tracked.iteration > 0)
        return ~reached & (tracked.verdict == step_qp.QPStatus.SOLVED) & (tracked.iteration < most)

    def step(scene: Scene, tracked: TrackingState) -> TrackingState:
        step_qp = prepare(settings, scene, lane, tracked.now.x, x_previous, tracked.now.linear)
        found = solve_step(step_qp, settings.qp_tolerance)
        now = advance(settings, scene, lane, tracked.now.x, found.y, settings.clearance_rows == "smallest")
        return TrackingState(now, tracked.iteration + 1, found.status)

    # At a new target, and in a candidate's first chunk, the target is not reached before the first step QP.
    nowhere = jnp.zeros(3)  # the TCP is not recorded before the first step QP
    known = State(x_ref, linear, jnp.full((), -jnp.inf), jnp.full((), jnp.inf), nowhere)
    return Loop(TrackingState(known, iteration, jnp.full((), int(step_qp.QPStatus.SOLVED), jnp.int32)), going, step)


def is_configuration_clear(settings: Settings, scene: Scene, lane: LaneInputs, x):
    """Return True if the arm touches no obstacle at x."""
    return is_clear(scene.robot, scene.obstacles, lane, x)


def may_be_valid(settings: Settings, scene: Scene, lane: LaneInputs, x):
    """Return False if x is certainly not valid: off the lane's target, or in collision. `advance` is more expensive."""
    residual = scene.task.residual(scene.task.value(scene.robot, x), lane.target)
    may_reach = scene.task.reached(0.5 * residual)  # twice the tolerance, as rounding differs
    return may_reach & ~surely_collides(scene.robot, scene.obstacles, lane, x)


def settle(settings: Settings, scene: Scene, lane: LaneInputs, x):
    """Move x onto the lane's target by inverse kinematics, with a tenth of the usual tolerance."""
    robot = with_still_joints(scene, lane, x)
    return reanchor(robot, x, lane.target, 0.1 * scene.task.fine_m, task=scene.task)[0]


def tip(settings: Settings, scene: Scene, lane: LaneInputs, x):
    """Return both ends of the tool's bare tip at x, first the end at the last body, in the workpiece's frame [m]."""
    return in_workpiece(lane, kinematics.tip_segment(scene.robot, x))


class ProofResolution(NamedTuple):
    """Resolution of a proof, see `clearance.proof.motion_proof.query_on`."""

    kept: Float[jax.Array, ""]  # share of D to prove [1]
    resolution_m: Float[jax.Array, ""]  # the proof is D > -resolution_m [m]
    deepest: Int[jax.Array, ""]  # maximum number of halvings


def prove_path(
    settings: Settings, scene: Scene, lane: LaneInputs, a, b, tube: motion_proof.Tube, closely: ProofResolution
) -> Loop:
    """Prove or refute that the straight joint path from a to b is a motion.

    Tube and resolution are arguments, so that one executable serves all callers.

    Args:
        settings: Settings of the planner.
        scene: The scene.
        lane: Scenario and target.
        a (Joints): Start of the path [rad or m].
        b (Joints): End of the path [rad or m].
        tube: Allowed region of the TCP.
        closely: Resolution of the proof.

    Returns:
        A loop whose result is a `Proof`, see `proven_result`.
    """
    return _proof_of(scene, lane, joint_path.StraightPath(a, b), tube, closely)


def prove_polynomial(
    settings: Settings,
    scene: Scene,
    lane: LaneInputs,
    path: joint_path.PolynomialPath,
    tube: motion_proof.Tube,
    closely: ProofResolution,
) -> Loop:
    """Prove or refute that all joint paths near a polynomial are clear, see `prove_path`.

    Args:
        settings: Settings of the planner.
        scene: The scene.
        lane: Scenario and target.
        path: The joint path.
        tube: Allowed region of the TCP; goals of the task are not checked.
        closely: Resolution of the proof.

    Returns:
        A loop whose result is a `Proof`, see `proven_result`.
    """
    return _proof_of(scene, lane, path, tube._replace(goals=None, required=None), closely)


def stay_in_tube(settings: Settings, scene: Scene, lane: LaneInputs, a, b, tube: motion_proof.Tube) -> Loop:
    """Prove or refute that the TCP stays in its tube on a straight joint path, see `prove_path`; return a verdict."""
    path, nothing = joint_path.StraightPath(a, b), scene._replace(obstacles=())
    tube, deepest = tube._replace(margin=None), motion_proof.DEEPEST
    check = motion_proof.query_on(nothing, lane, path, tube, -ROUNDING_M, deepest, 0.0)
    start = jax.tree.map(jnp.asarray, bisection.initial_state())
    step = lambda _, search: check(search, None)[0]  # noqa: E731
    return Loop(start, lambda search: search.going, step, lambda search: search.proof.verdict)


def _proof_of(
    scene: Scene, lane: LaneInputs, path: joint_path.JointPath, tube: motion_proof.Tube, closely: ProofResolution
) -> Loop:
    check = motion_proof.query_on(scene, lane, path, tube, closely.resolution_m, closely.deepest, closely.kept)
    start = jax.tree.map(jnp.asarray, bisection.initial_state())
    result = lambda search: bisection.proven_result(search.proof)  # noqa: E731
    return Loop(
        start,
        lambda search: search.going,
        lambda _, search: check(search, None)[0],
        result,
        _remembering(scene, lane, check),
    )


def _remembering(scene: Scene, lane: LaneInputs, check: Callable) -> Remembering:
    """Return the steps of a proof that pass on the rows measured in the scenario."""
    # Distances of exact obstacles depend on no other input. The margin decides which capsules' pieces are measured.
    own = lane.T_world_workpiece, lane.tool_extension_m, lane.margin_m
    nothing = known_rows.nothing_known(scene.robot, scene.obstacles)

    def step(scene: Scene, search: bisection.Bisection, memory):
        of, known = memory
        is_same = jnp.all(jnp.array([jnp.all(a == b) for a, b in zip(of, own, strict=True)]))
        passed_on = known_rows.exact_alone(scene.robot, scene.obstacles, known)
        passed_on = jax.tree.map(partial(jnp.where, is_same), passed_on, nothing)
        known = jax.tree.map(partial(jnp.where, search.proof.queries == 0), passed_on, known)
        search, known = check(search, known)
        return search, (own, known)

    return Remembering((jax.tree.map(lambda leaf: jnp.full_like(leaf, jnp.nan), own), nothing), step)


def task_rows(settings: Settings, scene: Scene, lane: LaneInputs, linear: Linearisation) -> TaskLinear:
    """Return the task's rows at the lane's target to first order, from the linearisation."""
    return scene.task.linear(*linear.task, lane.target)


# Lane functions by name, each with the settings that it reads

MEASURED: tuple[str, ...] = ("clearance_rows",)  # settings that `measured` reads
_STEP_QP = ("q_weights", "cost_about", "clearance_rows", "aim_above_m")

PREPARE = lane_function.LaneFunction("prepare", prepare, lane_function.STEP, _STEP_QP)
ADVANCE = lane_function.LaneFunction("advance", advance, lane_function.STEP, any_cone=True)
ADVANCE_SMALLEST = lane_function.LaneFunction("advance", advance_smallest, lane_function.STEP, any_cone=True)
TRACK_CHUNK = lane_function.LaneFunction(
    "track", track, lane_function.TRACKED, (*_STEP_QP, "max_step_qps", "qp_tolerance")
)
CLEAR = lane_function.LaneFunction("is_clear", is_configuration_clear, lane_function.STEP, any_cone=True)
MAY_BE_VALID = lane_function.LaneFunction("may_be_valid", may_be_valid, lane_function.STEP, any_cone=True)
SETTLE = lane_function.LaneFunction("settle", settle, lane_function.STEP, any_cone=True)
TASK_ROWS = lane_function.LaneFunction("hold", task_rows, lane_function.STEP, any_cone=True)
TIP = lane_function.LaneFunction("tip", tip, lane_function.STEP, any_cone=True)
PROVE = lane_function.LaneFunction(
    "prove", prove_path, lane_function.TRACKED, refill=by_chunks, remembers=True, any_cone=True
)
STAY_IN_TUBE = lane_function.LaneFunction("stay_in_tube", stay_in_tube, lane_function.TRACKED, any_cone=True)
PROVE_POLYNOMIAL = lane_function.LaneFunction(
    "prove_polynomial", prove_polynomial, lane_function.TRACKED, refill=by_chunks, remembers=True, any_cone=True
)


def advance_of(settings: Settings) -> lane_function.LaneFunction:
    """Return the lane function that advances and measures lanes with the rows of `settings.clearance_rows`."""
    return ADVANCE_SMALLEST if settings.clearance_rows == "smallest" else ADVANCE
