"""Exclusion proofs: every configuration of a cell collides.

A configuration in a cell is known up to a bound on the distance of each point of a body from its position in the cell's
middle. A body whose axis comes so near to a wall that it still touches after moving by that much touches in all of
them; so does one with an end further outside of the interior's hull than it can move.

With its tip on the target, the tool is known except for its orientation: turned by at most rho, a point of it at
distance r from the tip moves by at most 2 r sin(rho / 2). The link before it turns about the last joint's axis, which
moves with the tool: as seen from the axis, a body of that link is never further away than its own distance from it.
"""

from enum import IntEnum
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance.obstacles.obstacle import HasWorkpiecePose, Obstacles
from htcp_jax.clearance.obstacles.scene import Scene
from htcp_jax.clearance.proof.motion_bound import ROUNDING_M
from htcp_jax.model import Robot, rotations
from htcp_jax.model import robot as robots
from htcp_jax.numerics import product, safe_norm
from htcp_jax.types import Array, Bool, Float, Int, Scalar, Vector3

UNUSED_M = 1e6  # displacement of bodies that a proof does not use: they touch nothing for sure
PIECES = 3  # per capsule: the part near the tip moves less than the complete one


class Bodies(IntEnum):
    """The bodies of the arm that a proof uses; each value includes those before it."""

    NONE = 0  # the proof is by the arm's lengths and the task alone
    TOOL = 1  # those of the last link
    WRIST = 2  # and of the link before it
    ARM = 3  # and of all links up to the wrist


class SweptCapsules(NamedTuple):
    """Capsules, and bounds on the displacement of each one's points."""

    p: Float[Array, "n 3"]  # ends of the axes [m]
    q: Float[Array, "n 3"]
    radius: Float[Array, "n"]  # [m]
    moves: Float[Array, "n"]  # [m]


def surely_touches(
    obstacles: Obstacles, where: HasWorkpiecePose, margin_m: Scalar, bodies: SweptCapsules
) -> Bool[jax.Array, ""]:
    """Return True if some body surely has less clearance than margin_m [m].

    The points of each body may be anywhere within `moves` of its segment, in the world. Obstacles that cannot decide
    this are ignored. By the triangle inequality (docs/equations.md, section Exclusion).
    """
    p, q, radius, moves = bodies
    moves, found = moves + ROUNDING_M, jnp.zeros((), bool)
    for each in obstacles:
        found |= each.surely_touches(where, margin_m, p, q, radius, moves)
    return found


def tool_collides(
    scene: Scene,
    where: HasWorkpiecePose,
    margin_m: Scalar,
    target: Vector3,
    quaternion: Float[Array, "4"],
    rho: Scalar,
    bodies: Int[Array, ""] | Bodies = Bodies.ARM,
) -> Bool[jax.Array, ""]:
    """Return True if the tool, or the link before it, has less than the margin in every configuration of a cell.

    The cell has the TCP within the tolerance of the target, and the last link turned by at most rho from the
    quaternion; see docs/equations.md, section Exclusion.

    Args:
        scene: The scene.
        where: A scenario, or another `HasWorkpiecePose`.
        margin_m: Required clearance, the margin.
        target: The target, world [m].
        quaternion: Orientation of the last link, w first, without a unit.
        rho: Largest angle from it [rad].
        bodies: The `Bodies` to use.
    """
    R, own = rotations.quaternion_matrix(quaternion), _about_tip(scene.robot, bodies)
    farthest = jnp.maximum(safe_norm(own.p), safe_norm(own.q))
    moves = own.moves + 2 * farthest * jnp.sin(0.5 * jnp.minimum(rho, jnp.pi)) + scene.task.tolerance_m
    at = partial(jnp.add, target[None])
    return surely_touches(
        scene.obstacles,
        where,
        margin_m,
        SweptCapsules(at(product(own.p, R.T)), at(product(own.q, R.T)), own.radius, moves),
    )


def _about_tip(robot: Robot, bodies: Int[Array, ""] | Bodies) -> SweptCapsules:
    """Return the tool's bodies relative to the TCP, in the last link's frame, and those of the link before it.

    The latter are placed on the last joint's axis.
    """
    last = len(robot.slides) - 1
    links, tip = np.array(robot.capsule_link), robot.T_link_tcp[:3, 3]
    tool, wrist = np.flatnonzero(links == last), np.flatnonzero((links == last - 1) & (links >= 0))
    p, q = robot.capsule_p[tool], robot.capsule_q[tool]
    moves = jnp.zeros(len(tool)) + unused_m(bodies, Bodies.TOOL)
    if not robot.slides[last] and len(wrist):
        (a, off_a), (b, off_b) = (_on_axis(robot, end[wrist]) for end in (robot.capsule_p, robot.capsule_q))
        p, q = jnp.concatenate([p, a]), jnp.concatenate([q, b])
        off = jnp.maximum(off_a, off_b) + unused_m(bodies, Bodies.WRIST)
        moves, tool = jnp.concatenate([moves, off]), np.concatenate([tool, wrist])
    return cut_capsules(SweptCapsules(p - tip[None], q - tip[None], robots.core_radius(robot)[tool], moves))


def unused_m(bodies: Int[Array, ""] | Bodies, own: Bodies) -> Scalar:
    """Return the displacement of bodies for not being used [m]: 0 if `bodies` includes `own`, else UNUSED_M."""
    return jnp.where(bodies >= own, 0.0, UNUSED_M)


def _on_axis(robot: Robot, points: Float[Array, "n 3"]):
    """Return the points of the last joint's axis nearest to points of the link before it, and their distances.

    They are in the last link's frame.
    """
    T, axis = robot.T_parent_joint[-1], robot.axis[-1]
    own = product(points - T[None, :3, 3], T[:3, :3])
    return seen_from(axis, own)


def seen_from(axis: Vector3, points: Float[Array, "n 3"]):
    """Return the points of an axis through the origin nearest to others, and their distances [m]."""
    on = product(points, axis)[:, None] * axis[None]
    return on, safe_norm(points - on)


def cut_capsules(bodies: SweptCapsules) -> SweptCapsules:
    """Return the capsules, each cut into PIECES."""
    p, q, radius, moves = bodies
    ends = [p + (q - p) * (k / PIECES) for k in range(PIECES + 1)]
    many = partial(jnp.tile, reps=PIECES)
    return SweptCapsules(jnp.concatenate(ends[:-1]), jnp.concatenate(ends[1:]), many(radius), many(moves))
