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

from htcp_jax.clearance.distance.sweep import SweptCapsules
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


class ToolCell(NamedTuple):
    """Poses of the tool: the TCP is near a target, the last link rotated by at most rho from an orientation."""

    target: Vector3  # the TCP is within the task's tolerance of it, world [m]
    quaternion: Float[Array, "4"]  # orientation of the last link, w first, without a unit
    rho: Scalar  # [rad]


def surely_touches(obstacles: Obstacles, where: HasWorkpiecePose, bodies: SweptCapsules) -> Bool[jax.Array, ""]:
    """Return True if one of the bodies certainly has less clearance than the margin of `where`.

    Each point of a body may be displaced by up to the body's `moves`. Obstacles without such a test are ignored. See
    docs/equations.md, section Exclusion.
    """
    bodies, found = bodies._replace(moves=bodies.moves + ROUNDING_M), jnp.zeros((), bool)
    for each in obstacles:
        found |= each.surely_touches(where, bodies)
    return found


def tool_collides(
    scene: Scene, where: HasWorkpiecePose, cell: ToolCell, bodies: Int[Array, ""] | Bodies = Bodies.ARM
) -> Bool[jax.Array, ""]:
    """Return True if the tool, or the link before it, has too little clearance in every configuration of a cell.

    See docs/equations.md, section Exclusion.

    Args:
        scene: The scene.
        where: A scenario; its margin is required.
        cell: The tool's poses in the cell.
        bodies: The bodies that the proof may use, see `Bodies`.
    """
    R, own = rotations.quaternion_matrix(cell.quaternion), _about_tip(scene.robot, bodies)
    farthest = jnp.maximum(safe_norm(own.p), safe_norm(own.q))
    moves = own.moves + 2 * farthest * jnp.sin(0.5 * jnp.minimum(cell.rho, jnp.pi)) + scene.task.tolerance_m
    p, q = (cell.target[None] + product(ends, R.T) for ends in (own.p, own.q))
    return surely_touches(scene.obstacles, where, SweptCapsules(p, q, own.radius, moves))


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
