"""Clearance of the tool alone at the targets of a path, at the orientations that the task allows.

The arm is replaced by three slides and three hinges without bodies that move the last link, so that the tool moves
freely. From random orientations, inverse kinematics (5b) leads it onto each target. The orientations with the largest
clearance are then improved by random turns, and tried at neighbouring targets. An arm can do no better than its tool
alone, and often does worse.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from htcp_jax.clearance import Scene, clearances
from htcp_jax.clearance.obstacles import all_obstacles
from htcp_jax.device import Executor, lane_function, tables
from htcp_jax.errors import InputError
from htcp_jax.model import Robot, Scenario, Task, Workpiece, reanchor
from htcp_jax.model import robot as robots
from htcp_jax.motion import lane_inputs
from htcp_jax.settings import Settings

JOINTS = "x", "y", "z", "roll", "pitch", "yaw"  # of the free tool: slides along the axes, then hinges about them
LAST = len(JOINTS) - 1
EXACT_M = 0.03  # clearance up to which the convex pieces of the tool are measured
STARTS, SEED = 64, 0  # number of random orientations at each target, and their seed
NEIGHBOURS = 0, -3, -1, 1, 3  # targets whose orientations are tried, relative to each target
TURNS_RAD, TRIES = (0.5, 0.2, 0.07, 0.02), 12  # scale of random turns in each round; number of turns in a round


class ToolClearance(NamedTuple):
    """Largest clearances that were found for the tool alone, at T targets and E lengths of its bare tip."""

    target: Int[np.ndarray, "T"]  # indices of the targets on the path
    margin_m: Float[np.ndarray, "T"]  # required clearance
    clearance_m: Float[np.ndarray, "E T"]  # -inf: no orientation was found that the task allows
    body: Int[np.ndarray, "E T"]  # index in `names` of the body with this clearance
    names: tuple[str, ...]  # of the tool's bodies
    ignored: tuple[int, ...]  # rows of the task, from 1, that depend on other links and are not considered

    @property
    def clear(self) -> Bool[np.ndarray, "E T"]:
        """True where the clearance is sufficient, as in `Task.is_satisfied`."""
        return (self.clearance_m > 0) & (self.clearance_m >= self.margin_m)


def tool_clearances(
    robot: Robot,
    workpiece: Workpiece,
    scenario: Scenario,
    settings: Settings,
    task: Task,
    longer_m: Float[np.ndarray, "E"],
    progress: Callable[[int, int], None] = lambda done, count: None,
) -> ToolClearance:
    """Return the clearance between the bodies of the link that carries the TCP and the part, at each target.

    Args:
        robot: The arm with its tool, without the scenario's tool extension.
        workpiece: The part; its cloud or mesh is the only obstacle.
        scenario: One scenario.
        settings: Settings.
        task: The constraints at the targets.
        longer_m: Additional lengths of the bare tip, by which the TCP moves along its z axis away from all bodies [m].
        progress: Function that is called with the numbers of finished rounds, and of all rounds.

    Raises:
        InputError: For a part without a cloud or mesh.
    """
    free = free_tool(robots.lengthen_tool(robot, float(scenario.tool_extension_m)))
    own, numbers, ignored = task.of_link(robot.tcp_link, LAST)
    rounds = 1 + len(TURNS_RAD) * len(longer_m)
    progress(0, rounds)
    executor = Executor(Scene(free, all_obstacles(workpiece, ()), own), settings)
    on_path = np.arange(int(scenario.on_path), int(scenario.count))
    stacked = jax.tree.map(lambda leaf: np.asarray(leaf)[None], scenario)
    inputs = lane_inputs.lane_inputs(stacked, np.zeros(len(on_path), int), on_path)
    margin_m = np.asarray(inputs.margin_m)
    exact_m = np.full(len(on_path), EXACT_M)  # pieces, not capsules, decide below this clearance
    inputs = inputs._replace(target=inputs.target[:, numbers], margin_m=exact_m, max_joint_step=None)
    measure = partial(_measured, executor, inputs, own)
    rng = np.random.default_rng(SEED)
    starts = scipy.spatial.transform.Rotation.random(STARTS, rng=rng).as_euler("XYZ")
    lanes = np.repeat(np.arange(len(on_path)), STARTS)
    first = np.concatenate([scenario.targets[on_path][lanes], np.tile(starts, (len(on_path), 1))], axis=1)
    found = [_best(measure(lanes, np.zeros(len(lanes)), first), lanes, len(on_path))] * len(longer_m)
    for number, scale in enumerate(TURNS_RAD):
        turns = rng.normal(scale=scale, size=(TRIES, len(on_path), 3))
        for k, longer in enumerate(longer_m):
            progress(1 + number * len(longer_m) + k, rounds)
            x, count = found[k].x, len(on_path)
            near = [x[np.clip(np.arange(count) + step, 0, count - 1)] for step in NEIGHBOURS]
            turned = [x + np.pad(each, ((0, 0), (3, 0))) for each in turns]
            tries, lanes = np.concatenate([*near, *turned]), np.tile(np.arange(count), len(near) + len(turned))
            found[k] = _best(measure(lanes, np.full(len(lanes), longer), tries), lanes, count)
    best = [np.stack([getattr(each, name) for each in found]) for name in ("clearance_m", "body")]
    return ToolClearance(on_path, margin_m, *best, free.capsule_names, ignored)


class _Measured(NamedTuple):
    """Configurations of the free tool on targets, with their smallest clearances."""

    x: Float[np.ndarray, "n 6"]  # [m or rad]
    clearance_m: Float[np.ndarray, "n"]  # -inf off the target
    body: Int[np.ndarray, "n"]


def _measured(
    executor: Executor,
    inputs: lane_inputs.LaneInputs,
    task: Task,
    lanes: Int[np.ndarray, "n"],
    longer_m: Float[np.ndarray, "n"],
    x: Float[np.ndarray, "n 6"],
) -> _Measured:
    own = tables.gather(inputs, lanes)._replace(tool_extension_m=longer_m)
    x, residual, clearance, body = executor(FLY, own, x)
    return _Measured(x, np.where(task.reached(residual), clearance, -np.inf), body)


def _best(found: _Measured, lanes: Int[np.ndarray, "n"], count: int) -> _Measured:
    """Return the configuration with the largest clearance at each target."""
    order = np.lexsort([-found.clearance_m, lanes])
    return tables.gather(found, order[np.searchsorted(lanes[order], np.arange(count))])


def _fly(settings: Settings, scene: Scene, lane: lane_inputs.LaneInputs, x):
    """Move one lane's free tool onto its target.

    Returns:
        Configuration, residual [m], the smallest clearance [m], and the row of this clearance.
    """
    robot, obstacles, task = scene
    x, residual = reanchor(robot, x, lane.target, task.fine_m, task=task)
    distance = clearances(robot, obstacles, lane, x, smallest=True)
    row = jnp.argmin(distance)
    return x, residual, distance[row], row


FLY = lane_function.LaneFunction("fly", _fly, lane_function.STEP)


def free_tool(robot: Robot) -> Robot:
    """Return the last link of an arm, with its bodies, on three slides and three hinges without limits.

    If it is lengthened, its TCP moves and its bodies do not.
    """
    kept = np.flatnonzero(np.array(robot.capsule_link, int) == robot.tcp_link)
    if not kept.size:
        remedy = "state bodies in robot.tool, or mount a tool: {model: torch.xml}"
        raise InputError(f"{robot.name} has no body on the link of the TCP; {remedy}")
    endless = jnp.full(len(JOINTS), jnp.inf)
    bodies = {name: getattr(robot, name)[kept] for name in ("capsule_p", "capsule_q", "capsule_radius")}
    return Robot(
        T_parent_joint=jnp.tile(jnp.eye(4), (len(JOINTS), 1, 1)),
        axis=jnp.concatenate([jnp.eye(3), jnp.eye(3)]),
        T_link_tcp=robot.T_link_tcp,
        lower=-endless,
        upper=endless,
        speed=endless,
        acceleration=endless,
        effort=endless,
        **bodies,
        on_tool=jnp.zeros((len(kept), 2)),
        name=f"tool of {robot.name}",
        joint_names=JOINTS,
        slides=(True,) * 3 + (False,) * 3,
        capsule_names=tuple(robot.capsule_names[k] for k in kept),
        capsule_link=(LAST,) * len(kept),
        ignored_geoms=(),
        pieces=jax.tree.map(lambda each: each[kept], robot.pieces),
    )
