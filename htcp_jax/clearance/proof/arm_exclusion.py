"""Exclusion proofs for an arm with a spherical wrist, from the tool and the arm before the wrist together.

If the axes of the last three hinges meet in a point, the wrist, this point is fixed both to the tool and to the arm
before the wrist. There are two kinds of cells: a cell of tool orientations, and a box of values of the joints before
the wrist. Each cell confines the wrist to a ball. Every configuration is in one cell of each kind, and its wrist is in
both balls. Therefore, if no ball of one kind meets a ball of the other kind, among the cells that are not proven to
collide, the target has no clear configuration. Limits of the last three joints are ignored.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance.distance.sweep import SweptCapsules
from htcp_jax.clearance.obstacles.obstacle import HasWorkpiecePose
from htcp_jax.clearance.obstacles.scene import Scene
from htcp_jax.clearance.proof.exclusion import (
    PIECES,
    Bodies,
    ToolCell,
    cut_capsules,
    seen_from,
    surely_touches,
    tool_collides,
    unused_m,
)
from htcp_jax.clearance.proof.motion_bound import ROUNDING_M, point_motion_bound
from htcp_jax.model import Robot, kinematics, rotations
from htcp_jax.model import robot as robots
from htcp_jax.numerics import product, safe_divide, safe_norm
from htcp_jax.types import Array, Bool, Int, Joints, Scalar, Vector3

WRIST = 3  # number of wrist joints


class Wrist(NamedTuple):
    """The point in which the last three axes meet."""

    on_arm: Vector3  # in the frame of the link that the first of these joints moves [m]
    on_tool: Vector3  # in the last link's frame [m]
    missed_m: Scalar  # largest distance between the axes, 0 if they meet [m]


class CellBounds(NamedTuple):
    """Result for a cell of configurations: True if all collide, and a ball that contains the wrist."""

    collides: Bool[Array, ""]  # True: all configurations collide
    wrist: Vector3  # centre of the ball: the wrist's position at the cell's middle, world [m]
    moves: Scalar  # radius of the ball [m]


def has_wrist(robot: Robot) -> bool:
    """Return True if the arm has a spherical wrist, and all its slides have limits.

    In a spherical wrist the last three joints are hinges whose axes meet in a point.
    """
    if len(robot.slides) <= WRIST or any(robot.slides[-WRIST:]):
        return False
    endless = np.array(robot.slides) & ~np.isfinite(np.asarray(robot.upper - robot.lower))
    return not endless.any() and float(_MISSED_M(robot)) <= 0.1 * ROUNDING_M


def wrist(robot: Robot) -> Wrist:
    """Return the wrist of an arm: the point on the second-last joint's axis that is nearest to the third-last one's.

    `missed_m` is infinite for an arm with fewer than three joints.
    """
    if len(robot.slides) < WRIST:
        return Wrist(jnp.zeros(3), jnp.zeros(3), jnp.asarray(jnp.inf))
    first, second, third = robot.axis[-WRIST:]
    (R, o), (S, c) = ((T[:3, :3], T[:3, 3]) for T in robot.T_parent_joint[-2:])
    along = product(R, second)
    cos = product(first, along)
    t = safe_divide(cos * product(first, o) - product(along, o), 1 - cos * cos)
    on_arm, own = o + t * along, product(S.T, t * second - c)
    on_tool = product(third, own) * third
    missed = jnp.maximum(safe_norm(on_arm - product(first, on_arm) * first), safe_norm(own - on_tool))
    return Wrist(on_arm, on_tool, missed)


_MISSED_M = jax.jit(lambda robot: wrist(robot).missed_m)


def tool_cell(
    scene: Scene, where: HasWorkpiecePose, cell: ToolCell, bodies: Int[Array, ""] | Bodies = Bodies.ARM
) -> CellBounds:
    """Return the bounds of a cell of tool orientations.

    Args:
        scene: The scene.
        where: A scenario; its margin is required.
        cell: The tool's poses in the cell.
        bodies: The bodies that the proof may use, see `Bodies`.
    """
    arm = wrist(scene.robot).on_tool - scene.robot.T_link_tcp[:3, 3]
    moves = 2 * safe_norm(arm) * jnp.sin(0.5 * jnp.minimum(cell.rho, jnp.pi)) + scene.task.tolerance_m
    collides = tool_collides(scene, where, cell, bodies)
    centre = cell.target + product(rotations.quaternion_matrix(cell.quaternion), arm)
    return CellBounds(collides, centre, moves + ROUNDING_M)


def arm_cell(
    scene: Scene,
    where: HasWorkpiecePose,
    target: Vector3,
    x: Joints,
    turns: Joints,
    use: Int[Array, ""] | Bodies = Bodies.ARM,
) -> CellBounds:
    """Return the bounds of a cell of the joints before the wrist: all configurations near x with the TCP on the target.

    `collides` is also True if the wrist is too near to the target for the length of the tool, or too far away; see
    docs/equations.md, section Exclusion.

    Args:
        scene: The scene.
        where: A scenario; its margin is required.
        target: The target, world [m].
        x: Middle of the cell [rad or m]; the values of the last three joints are ignored.
        turns: Largest distance of every joint from x [rad or m]; values of the last three joints are ignored.
        use: The bodies that the proof may use, see `Bodies`.
    """
    robot, tool = scene.robot, wrist(scene.robot)
    first = len(robot.slides) - WRIST
    free = jnp.arange(len(robot.slides)) < first
    x, turns = jnp.where(free, x, 0.0), jnp.where(free, turns, 0.0)
    p, q, radius, aside, links = _before_wrist(robot)
    own, body = (tool.on_arm[None], p, q), (first, *links, *links)
    at = kinematics.point_positions(robot, x, jnp.concatenate(own), body)
    moves = point_motion_bound(robot, x, turns, at, jnp.array(body)) + ROUNDING_M
    length = safe_norm(tool.on_tool - robot.T_link_tcp[:3, 3])
    off = jnp.abs(safe_norm(at[0] - target) - length) > moves[0] + scene.task.tolerance_m
    (p, q), (of_p, of_q) = jnp.split(at[1:], 2), jnp.split(moves[1:], 2)
    bodies = SweptCapsules(p, q, radius, aside + jnp.maximum(of_p, of_q) + unused_m(use, Bodies.ARM))
    return CellBounds(off | surely_touches(scene.obstacles, where, bodies), at[0], moves[0])


def _before_wrist(robot: Robot):
    """Return the pieces of all bodies up to the wrist's first link, in the frames of their links.

    The angle of the wrist's first joint is ignored: the bodies of its link are moved onto the joint's axis.

    Returns:
        Ends p and q [m], radius [m], distance from the joint's axis [m], and link of each piece.
    """
    first = len(robot.slides) - WRIST
    links = np.array(robot.capsule_link)
    here = np.flatnonzero((links >= 0) & (links <= first))
    bodies = robot.capsule_p[here], robot.capsule_q[here], robots.core_radius(robot)[here]
    p, q, radius, _ = cut_capsules(SweptCapsules(*bodies, jnp.zeros(len(here))))
    links, axis = np.tile(links[here], PIECES), robot.axis[first]
    turned = jnp.asarray(links == first)
    (on_p, off_p), (on_q, off_q) = seen_from(axis, p), seen_from(axis, q)
    aside = jnp.where(turned, jnp.maximum(off_p, off_q), 0.0)
    p, q = jnp.where(turned[:, None], on_p, p), jnp.where(turned[:, None], on_q, q)
    return p, q, radius, aside, tuple(links.tolist())
