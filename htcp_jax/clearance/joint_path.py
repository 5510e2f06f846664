"""Whether the arm is clear all along a straight joint path, between its ends.

Two tests. `bisection` proves: at the middle of an interval every body's room (how far all its points may move and it
stays clear) is held against a bound on how far any of its points does move within the interval; where the room is too
small, the interval is halved. `samples` looks at a number of places and knows nothing of what lies between them.

The bound: let joint j turn by at most d_j either way. In the frame of the link before it, a point of a body moves by

    M_j <= M_{j+1} + d_j (r_j + M_{j+1}),

where r_j is the point's distance to the joint's axis at the middle, and M_{j+1} bounds what the joints beyond add
(0 beyond the body's own link). A slide adds d_j alone. A body is rigid and convex, so its ends bound all its points.
"""

from functools import partial

import jax
import jax.numpy as jnp

from htcp_jax.clearance.obstacle import Posed
from htcp_jax.clearance.obstacles import all_clear, room
from htcp_jax.clearance.scene import Scene
from htcp_jax.scene.kinematics import capsule_segments, joint_levers
from htcp_jax.scene.robot import Robot
from htcp_jax.settings import Settings
from htcp_jax.types import Bool, Float, Joints

RESOLUTION_M = 1e-5  # what the arm may touch unnoticed: grazing paths would be halved for ever; far above rounding
DEEPEST = 30  # halvings; a joint turns by less than 1e-8 rad then


def path_clear(scene: Scene, settings: Settings, where: Posed, a: Joints, b: Joints) -> Bool[jax.Array, ""]:
    """Whether the straight joint path from a to b is clear by the test of `settings.path_test`, the ends left out."""
    if settings.path_test == "bisection":
        return proven_clear(scene, where, a, b)
    if settings.path_steps == 1:
        return jnp.full((), True)
    fractions = jnp.arange(1, settings.path_steps) / settings.path_steps
    return all_clear(scene.robot, scene.obstacles, where, a[None, :] + fractions[:, None] * (b - a)[None, :])


def proven_clear(scene: Scene, where: Posed, a: Joints, b: Joints) -> Bool[jax.Array, ""]:
    """Whether D > 0 wherever bisection looks, and D > -RESOLUTION_M for certain everywhere else on the path."""

    def going(state):
        index, depth, clear = state
        return clear & ~((depth == 0) & (index == 1))

    def look(state):
        index, depth, _ = state
        length = jnp.ldexp(1.0, -depth)
        x = a + (index + 0.5) * length * (b - a)
        left = room(scene.robot, scene.obstacles, where, x)
        moves = motion_bound(scene.robot, x, 0.5 * length * jnp.abs(b - a))
        proven = jnp.all(moves <= left + RESOLUTION_M) | (depth == DEEPEST)
        index, depth = jax.tree.map(partial(jnp.where, proven), _next_interval(index, depth), (2 * index, depth + 1))
        return index, depth, jnp.all(left > 0)

    zero = jnp.zeros((), jnp.int64)
    return jax.lax.while_loop(going, look, (zero, zero, jnp.full((), True)))[2]


def _next_interval(index, depth):
    """The interval after number `index` of those of length 2^-depth: as long a one as begins there."""
    index = index + 1
    up = jnp.minimum(jax.lax.population_count((index & -index) - 1), depth)
    return index >> up, depth - up


def motion_bound(robot: Robot, x: Joints, turns: Joints) -> Float[jax.Array, "K"]:
    """How far any point of each body is from where it is at x, at most, while every joint stays within `turns`
    [rad or m] of x [m]."""
    p, q = capsule_segments(robot, x)
    links = jnp.asarray(robot.capsule_link)

    def farthest(points):
        levers = joint_levers(robot, x, points)
        moved = jnp.zeros(len(robot.capsule_link))
        for j in reversed(range(len(robot.slides))):
            adds = turns[j] * (1.0 if robot.slides[j] else levers[:, j] + moved)
            moved = moved + jnp.where(links >= j, adds, 0.0)
        return moved

    return jnp.maximum(farthest(p), farthest(q))
