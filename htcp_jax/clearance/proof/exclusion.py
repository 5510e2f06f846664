"""Exclusion proofs: every configuration of a cell collides.

In a cell of configurations, the displacement of each point of a body from its position at the cell's middle is bounded.
If a body at the middle is so near to a wall that it touches the wall after any such displacement, it collides in all
configurations of the cell. The same is true for a body with an end that is outside the interior's hull by more than the
end can move.

The tool's tip is on the target. If the tool rotates by at most rho, a point of the tool at distance r from the tip
moves by at most 2 r sin(rho / 2). The link before the tool rotates about the last joint's axis, which moves with the
tool. A point of this link stays at the same distance from the axis.
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

UNUSED_M = 1e6  # displacement of bodies that a proof does not use, so that they never certainly touch anything
PIECES = 3  # pieces per capsule: a piece near the tip moves less than the complete capsule


class Bodies(IntEnum):
    """The bodies of the arm that a proof uses; each value includes the bodies of all smaller values."""

    NONE = 0  # no body: only the arm's lengths and the task
    TOOL = 1  # bodies of the last link
    WRIST = 2  # in addition, bodies of the link before the last
    ARM = 3  # in addition, bodies of all links up to the wrist


class SweptCapsules(NamedTuple):
    """Capsules, and bounds on the displacement of their points."""

    p: Float[Array, "n 3"]  # first ends of the axes [m]
    q: Float[Array, "n 3"]  # second ends [m]
    radius: Float[Array, "n"]  # [m]
    moves: Float[Array, "n"]  # largest displacement of any point of the capsule [m]


def surely_touches(
    obstacles: Obstacles, where: HasWorkpiecePose, margin_m: Scalar, bodies: SweptCapsules
) -> Bool[jax.Array, ""]:
    """Return True if one of the bodies certainly has less clearance than margin_m [m].

    Each point of a body may be displaced by up to the body's `moves`. Bodies are in the world. Obstacles without such a
    test are ignored. See docs/equations.md, section Exclusion.
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
    """Return True if the tool, or the link before it, has too little clearance in every configuration of a cell.

    The cell has all configurations with the TCP within the tolerance of the target, and the last link rotated by at
    most rho from the quaternion; see docs/equations.md, section Exclusion.

    Args:
        scene: The scene.
        where: A scenario, or another `HasWorkpiecePose`.
        margin_m: Required clearance, the margin.
        target: The target, world [m].
        quaternion: Orientation of the last link, w first, without a unit.
        rho: Largest rotation from this orientation [rad].
        bodies: The bodies that the proof may use, see `Bodies`.
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
    """Return the bodies of the last two links relative to the TCP, in the last link's frame.

    The bodies of the link before the last are moved onto the last joint's axis.
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
    """Return the displacement to add to the bodies `own` [m]: 0 if `bodies` includes them, else UNUSED_M."""
    return jnp.where(bodies >= own, 0.0, UNUSED_M)


def _on_axis(robot: Robot, points: Float[Array, "n 3"]):
    """Return the points of the last joint's axis nearest to given points of the link before it, and the distances [m].

    The returned points are in the last link's frame [m].
    """
    T, axis = robot.T_parent_joint[-1], robot.axis[-1]
    own = product(points - T[None, :3, 3], T[:3, :3])
    return seen_from(axis, own)


def seen_from(axis: Vector3, points: Float[Array, "n 3"]):
    """Return, for each given point, the nearest point on an axis through the origin, and its distance [m]."""
    on = product(points, axis)[:, None] * axis[None]
    return on, safe_norm(points - on)


def cut_capsules(bodies: SweptCapsules) -> SweptCapsules:
    """Return the capsules, each cut into PIECES along its axis."""
    p, q, radius, moves = bodies
    ends = [p + (q - p) * (k / PIECES) for k in range(PIECES + 1)]
    many = partial(jnp.tile, reps=PIECES)
    return SweptCapsules(jnp.concatenate(ends[:-1]), jnp.concatenate(ends[1:]), many(radius), many(moves))
