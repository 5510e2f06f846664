"""Steps in the null space of the task (Algorithm 1), each a pure function of one scenario.

A step minimises J2 of equation (11) on the sphere, moves by alpha in the resulting direction, and re-anchors.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.backend import backend
from htcp_jax.clearance import HasWorkpiecePose, Obstacles, Scene, clearances, contacts, minimum_clearance
from htcp_jax.clearance.obstacles import ContactModel, Contacts, hold_contacts, predict_distances
from htcp_jax.errors import InputError
from htcp_jax.model import Robot, kinematics, reanchor
from htcp_jax.motion import lane_inputs, step_functions
from htcp_jax.numerics import checked_shape, fold_keys, null_basis, product, with_gradient
from htcp_jax.settings import Settings, settings_of
from htcp_jax.solvers import sphere
from htcp_jax.types import Anywhere, Array, Bool, Float, Int, Joints, Scalar

READS = ("alpha_rad", "include_proximal_bodies", "j1_weight", "q_weights")  # settings read by every null-space step
BEYOND_M = 10.0  # distance that is never the smallest
DRAWS, PUSHED, PUSHES = 256, 6, 60  # numbers in `draw_clear`: draws, draws pushed clear, null-space steps per push


@runtime_checkable
class HasMargin(HasWorkpiecePose, Protocol):
    """Protocol of objects with a workpiece pose and a required clearance: a scenario, or a lane's inputs."""

    margin_m: Scalar


class StuckScenario(NamedTuple):
    """State of one stuck scenario."""

    x_previous: Joints  # x_{t-1}
    target: Float[Array, "G"]  # C_next, the task's goal [m]
    key: jax.Array  # random key, folded from seed, scenario, target, stage and round


def seen_rows(scene: Scene, include_proximal_bodies: bool) -> Bool[Anywhere, "R"]:
    """Return True for the rows that J2 includes: all rows, or only those of bodies on the outer half of the chain.

    On the GP50 the outer half has capsules 4 to 8. Bodies on a side branch belong to the chain's link that carries it.
    """
    robot, links = scene.robot, scene.rows.links(scene.robot)

    def on_chain(link: int) -> int:
        return link if link <= robot.tcp_link else on_chain(robot.parents[link])

    if include_proximal_bodies:
        return np.ones(len(links), bool)
    if robot.coupling is not None:
        links = np.array([on_chain(link) for link in links.tolist()])
    return links >= (robot.tcp_link + 1) // 2


def sphere_problem(
    scene: Scene,
    settings: Settings,
    where: HasWorkpiecePose,
    x_ref: Joints,
    target: Float[Array, "G"] | None = None,
    touch: Contacts | None = None,
) -> tuple[sphere.Sphere, ContactModel, Float[Array, "N D"]]:
    """Return the problem of equation (11) at x_ref, the contacts at x_ref, and alpha N(x_ref) [rad].

    The results are undefined if D = 0.

    Args:
        scene: Arm with its tool, obstacles and task.
        settings: `alpha_rad`, `j1_weight`, `q_weights` and `include_proximal_bodies`.
        where: Pose of the workpiece.
        x_ref: The configuration [rad or m].
        target: The task's goal; not needed for a task of points, where it may be None.
        touch: The contacts at x_ref, if they are known; None: they are measured.
    """
    robot, obstacles, task = scene
    rows = scene.rows
    touch = contacts(robot, obstacles, where, x_ref) if touch is None else touch
    held = task.linear_at(robot, x_ref, jnp.zeros(task.numbers) if target is None else target)
    step_basis = settings.alpha_rad * null_basis(held.jacobian, task.optional)
    weights = jnp.asarray(settings.q_weights)
    # J1 = |x - x_ref|_Q^2 = w' (alpha N)' Q (alpha N) w
    half = settings.j1_weight * product(step_basis.T, weights[:, None] * step_basis)
    unseen = ~jnp.asarray(seen_rows(scene, settings.include_proximal_bodies))
    # Rows that J2 does not include, and those of bodies that are not tested, get a distance that is never the smallest.
    far = jnp.where(unseen, BEYOND_M, 0.0)

    def observe(w):
        x = x_ref + product(step_basis, w)
        new = contacts(robot, obstacles, where, x)
        distance = jnp.minimum(new.distance, BEYOND_M) + far
        return distance - product(w, product(half, w)), hold_contacts(robot, x, rows, new)

    def measure(w):
        x, j1 = x_ref + product(step_basis, w), product(w, product(half, w))
        if not settings.include_proximal_bodies:
            return jnp.min(clearances(robot, obstacles, where, x) + far) - j1
        return minimum_clearance(robot, obstacles, where, x) - j1

    def predicted(w, held):
        value, gradient = predict_distances(robot, x_ref + product(step_basis, w), rows, held)
        rounds = value.shape[0] // far.shape[0]
        value = jnp.minimum(value, BEYOND_M) + jnp.concatenate([far] * rounds) - product(w, product(half, w))
        return value, product(gradient, step_basis) - 2 * product(half, w)[None, :]

    G = jnp.concatenate([step_basis, -step_basis])
    h = jnp.concatenate([robot.upper - x_ref, x_ref - robot.lower])
    if task.bands:
        G = jnp.concatenate([G, -product(held.gradient, step_basis)])
        h = jnp.concatenate([h, jnp.maximum(held.slack, 0.0)])
    predict = with_gradient(lambda w, held: predicted(w, held)[0], predicted)
    problem = sphere.Sphere(observe, measure, predict, 2 * half, G, jnp.minimum(h, 1e3))
    return problem, hold_contacts(robot, x_ref, rows, touch), step_basis


def null_space_objective(
    robot: Robot,
    obstacles: Obstacles,
    where: HasWorkpiecePose,
    x_ref: Joints,
    w: Float[Array, "N-3"],
    settings: Settings | Mapping[str, Any] | None = None,
) -> Scalar:
    """Return J2 of equation (11a): -D(x, O) + J1(x, x_ref) [m] at x = x_ref + alpha N(x_ref) w of (11c).

    The planners minimise J2 over |w| = 1 within the joint limits; this function does not check these conditions.

    ```python
    >>> import jax
    >>> import jax.numpy as jnp
    >>> import htcp_jax
    >>> arm, duct = htcp_jax.gp50(), htcp_jax.load_workpiece()
    >>> where = htcp_jax.make_scenario(arm, duct, (0.0, -2.3, 0.5, 0.0, 0.5, -2.0))
    >>> J2 = htcp_jax.null_space_objective
    >>> scene = arm, htcp_jax.make_obstacle(duct), where, jnp.array(where.x_start)
    >>> w = jnp.array([1.0, 0.0, 0.0])
    >>> round(float(J2(*scene, w)), 3)
    -0.497
    >>> jax.grad(J2, argnums=4)(*scene, w).shape
    (3,)
    >>> jax.vmap(J2, in_axes=(None, None, None, None, 0))(*scene, jnp.eye(3)).round(3).tolist()
    [-0.497, -0.499, -0.498]

    ```

    Args:
        robot: The arm with its tool.
        obstacles: The obstacles, for example from `make_obstacle`.
        where: A scenario, or any other object that is `HasWorkpiecePose`.
        x_ref: Configuration [rad or m].
        w: Direction in the null space (N - 3,), a number for each column of N(x_ref).
        settings: `alpha_rad`; `j1_weight` and `q_weights` of J1 = j1_weight (x - x_ref)' Q (x - x_ref), with weight 1
            in the paper; and `include_proximal_bodies`. None: the default settings, but `q_weights` 1 for every joint,
            as in the paper. A mapping, such as {"j1_weight": 1.0}, changes some of these values. The default
            `j1_weight` is 0: then J2 = -D.

    Raises:
        InputError: If x_ref or w has a wrong shape (also for batches), or `q_weights` a wrong length.
    """
    x_ref = kinematics.checked_configuration(robot, x_ref, "x_ref")
    joints = x_ref.shape[0]
    w = checked_shape(w, (joints - 3,), "w")
    if not isinstance(settings, Settings):
        settings = settings_of({"q_weights": (1.0,) * joints} | dict(settings or {}))
    if len(settings.q_weights) != joints:
        raise InputError(
            f"q_weights has {len(settings.q_weights)} values, but the robot {robot.name} has {joints} joints"
        )
    return _objective(robot, obstacles, where, x_ref, w, settings)


@partial(jax.jit, static_argnames="settings")
def _objective(
    robot: Robot, obstacles: Obstacles, where: HasWorkpiecePose, x_ref: Joints, w: Float[Array, "D"], settings: Settings
) -> Scalar:
    problem, _, _ = sphere_problem(Scene(robot, obstacles), settings, where, x_ref)
    return -problem.measure(w)


def anchor(
    scene: Scene, settings: Settings, where: HasWorkpiecePose, x: Joints, target: Float[Array, "G"]
) -> step_functions.State:
    """Re-anchor x by (5b) if its task error exceeds xi (Algorithm 1, line 13); return the resulting state.

    Args:
        scene: Arm with its tool, obstacles and task.
        settings: Not used.
        where: Pose of the workpiece.
        x: Configuration [rad or m].
        target: The task's goal [m].
    """
    here = _on_target(scene, x, target)
    return here._replace(clearance=minimum_clearance(scene.robot, scene.obstacles, where, here.x))


def _on_target(scene: Scene, x: Joints, target: Float[Array, "G"]) -> step_functions.State:
    """Return x, re-anchored if its task error exceeds xi, with its residual but without its clearance."""
    robot, _, task = scene
    anchored, _ = reanchor(robot, x, target, task.fine_m, task=task)
    x = jnp.where(task.reached(task.residual_at(robot, x, target)), x, anchored)
    return step_functions.State(x, residual=task.residual_at(robot, x, target))


Minimise = Callable[[sphere.Sphere, ContactModel, jax.Array, Settings], sphere.Best]


def null_space_step(
    minimise: Minimise,
    scene: Scene,
    settings: Settings,
    where: HasWorkpiecePose,
    stuck: StuckScenario,
    x_ref: Joints,
    count: Int[Array, ""],
) -> step_functions.State:
    """Take one null-space step, Algorithm 1, lines 11 to 13: minimise J2 on the sphere, move, re-anchor.

    Args:
        minimise: Minimiser on the sphere.
        scene: Arm with its tool, obstacles and task.
        settings: Settings of the planner.
        where: Pose of the workpiece.
        stuck: The stuck scenario.
        x_ref: Configuration before the step [rad or m].
        count: Number of steps so far; folded into the random key.

    Returns:
        The state at x = x_ref + alpha N w after re-anchoring.
    """
    problem, held, step_basis = sphere_problem(scene, settings, where, x_ref, stuck.target)
    best = minimise(problem, held, jax.random.fold_in(stuck.key, count), settings)
    x = jnp.clip(x_ref + product(step_basis, best.w), scene.robot.lower, scene.robot.upper)
    return anchor(scene, settings, where, x, stuck.target)


def keep_clear_ascent(
    scene: Scene,
    settings: Settings,
    where: HasWorkpiecePose,
    x: Joints,
    target: Float[Array, "G"],
    enough_m: Scalar | float | None = None,
    steps: int | None = None,
    anchorings: int = 1,
) -> step_functions.State:
    """Return the state after max-min null-space steps away from obstacles; its D is never smaller than at x.

    Each step linearises once, and moves by at most alpha in the direction that is best for the contacts at that
    configuration. Steps are halved whenever D does not increase.

    Args:
        scene: Arm with its tool, obstacles and task.
        settings: Settings of the planner.
        where: Pose of the workpiece.
        x: Configuration to start at [rad or m].
        target: The task's goal, which remains satisfied [m].
        enough_m: Clearance D at which to stop; None: `keep_clear_m`.
        steps: Maximum number of steps; None: `keep_clear_steps`.
        anchorings: How often x is brought onto the target before the first step.
    """
    enough_m = settings.keep_clear_m if enough_m is None else enough_m
    steps = settings.keep_clear_steps if steps is None else steps

    def going(state):
        (best, _), scale, count = state
        return (count < 0) | (best.clearance < enough_m) & (count < steps) & (scale > 1e-4)

    def raised(best, touch, scale):
        problem, held, step_basis = sphere_problem(scene, settings, where, best.x, target, touch)
        w = sphere.max_min_step(problem, held, scale)
        return jnp.clip(best.x + product(step_basis, w), scene.robot.lower, scene.robot.upper)

    def look(x):
        here = _on_target(scene, x, target)
        touch = contacts(scene.robot, scene.obstacles, where, here.x)
        return here._replace(clearance=jnp.min(touch.distance)), touch

    def step(state):
        (best, touch), scale, count = state
        if backend().is_cpu:
            x = jax.lax.cond(count < 0, lambda best, *_: best.x, raised, best, touch, scale)
        else:  # under vmap a cond computes both branches, and batches all that they read, even the scene
            x = jnp.where(count < 0, best.x, raised(best, touch, scale))
        new = look(x)
        better = (count < 0) | (new[0].clearance > best.clearance) & scene.task.reached(new[0].residual)
        best = jax.tree.map(lambda n, b: jnp.where(better, n, b), new, (best, touch))
        return best, jnp.where(better, scale, 0.5 * scale), count + 1

    if not scene.task.freedom(scene.robot):
        return anchor(scene, settings, where, x, target)
    # The first iterations anchor and measure the initial x, so that both functions are compiled only once.
    unknown = step_functions.empty_result(look, x)
    start = (unknown[0]._replace(x=x), unknown[1]), jnp.full((), 0.5), jnp.full((), -anchorings, jnp.int32)
    (best, _), *_ = jax.lax.while_loop(going, step, start)
    return best


def push_clear(
    scene: Scene, settings: Settings, where: HasMargin, x: Joints, target: Float[Array, "G"]
) -> step_functions.State:
    """Bring x onto the target, and push it in the null space until it satisfies the margin, or as far as possible.

    Args:
        scene: Arm with its tool, obstacles and task.
        settings: Settings of the planner.
        where: Pose of the workpiece and the required clearance.
        x: Configuration [rad or m].
        target: The task's goal [m].
    """
    enough_m = jnp.maximum(1e-9, where.margin_m)
    return keep_clear_ascent(scene, settings, where, x, target, enough_m, PUSHES, anchorings=2)


def stuck_key(seed, number, row, stage: int, round_) -> jax.Array:
    """Return the random key of one recovery, folded from seed, scenario `number`, target `row`, stage and round.

    The seed is data, so that another seed does not cause a compilation.
    """
    return fold_keys(jax.random.key(seed), number, row, stage, round_)


def stuck_at(lane: lane_inputs.LaneInputs, x_previous: Joints, stage: int) -> StuckScenario:
    """Return the state of a stuck lane, with the random key of one stage."""
    return StuckScenario(x_previous, lane.target, stuck_key(lane.seed, lane.number, lane.row, stage, lane.round))
