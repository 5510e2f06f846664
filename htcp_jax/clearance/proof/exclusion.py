"""Exclusion proofs: every configuration of a cell collides.

In a cell of configurations, the displacement of each point of a body from its position at the cell's middle is bounded.
If a body at the middle is so near to a wall that it touches the wall after any such displacement, it collides in all
configurations of the cell. The same is true for a body with an end that is outside the interior's hull by more than the
end can move.

The tool's tip is on the target. If the tool rotates by at most rho, a point of the tool at distance r from the tip
moves by at most 2 r sin(rho / 2). The link before the tool rotates about the last joint's axis, which moves with the
tool. A point of this link stays at the same distance from the axis.

For an arm with a spherical wrist, the proof also uses the arm before the wrist. If the axes of the last three hinges
meet in a point, the wrist, this point is fixed both to the tool and to the arm before the wrist. There are two kinds of
cells: a cell of tool orientations, and a box of values of the joints before the wrist. Each cell confines the wrist to
a ball. Every configuration is in one cell of each kind, and its wrist is in both balls. Therefore, if no ball of one
kind meets a ball of the other kind, among the cells that are not proven to collide, the target has no clear
configuration. Limits of the last three joints are ignored.
"""

import dataclasses
from enum import IntEnum
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance.distance.sweep import SweptCapsules
from htcp_jax.clearance.obstacles.obstacle import HasWorkpiecePose, Obstacles, Scene
from htcp_jax.clearance.proof.motion_bound import ROUNDING_M, point_motion_bound
from htcp_jax.model import Robot, kinematics, quaternion_matrix
from htcp_jax.model import robot as robots
from htcp_jax.numerics import joined, product, safe_divide, safe_norm
from htcp_jax.types import Anywhere, Array, Bool, Float, Int, Joints, Scalar, Vector3

UNUSED_M = 1e6  # displacement of bodies that a proof does not use, so that they never certainly touch anything
PIECES = 3  # pieces per capsule: a piece near the tip moves less than the complete capsule
WRIST = 3  # number of wrist joints


class Bodies(IntEnum):
    """The bodies of the arm that a proof uses; each value includes the bodies of all smaller values."""

    NONE = 0  # no body: only the arm's lengths and the task
    TOOL = 1  # bodies of the last link
    WRIST = 2  # in addition, bodies of the link before the last
    ARM = 3  # in addition, bodies of all links up to the wrist


def chain_of(robot: Robot) -> Robot:
    """Return the robot without its side branches, whose bodies a proof does not use."""
    count, coupling = robot.tcp_link + 1, robot.coupling
    if coupling is None:
        return robot
    kept = np.flatnonzero(np.array(robot.capsule_link, int) < count)
    bodies = {name: getattr(robot, name)[kept] for name in ("capsule_p", "capsule_q", "capsule_radius", "on_tool")}
    own = {"factors": coupling.factors[:count], "offsets": coupling.offsets[:count]}
    own |= {name: getattr(coupling, name)[:count] for name in ("joint_names", "speed", "acceleration", "parents")}
    return dataclasses.replace(
        robot,
        **bodies,
        T_parent_joint=robot.T_parent_joint[:count],
        axis=robot.axis[:count],
        slides=robot.slides[:count],
        capsule_link=tuple(robot.capsule_link[k] for k in kept),
        capsule_names=tuple(robot.capsule_names[k] for k in kept),
        pieces=jax.tree.map(lambda each: each[kept], robot.pieces),
        coupling=dataclasses.replace(coupling, **own),
    )


class ToolCell(NamedTuple):
    """Poses of the tool: the TCP is near a target, the last link rotated by at most rho from an orientation."""

    target: Vector3  # the TCP is within the task's tolerance of it, world [m]
    quaternion: Float[Array, "4"]  # orientation of the last link, w first, without a unit
    rho: Scalar  # [rad]


def surely_touches(obstacles: Obstacles, where: HasWorkpiecePose, bodies: SweptCapsules) -> Bool[jax.Array, ""]:
    """Return True if one of the bodies certainly has less clearance than the margin of `where`.

    Each point of a body may be displaced by up to the body's `moves`. Obstacles without such a test are ignored. See
    docs/bounds.md, section Exclusion.
    """
    bodies, found = bodies._replace(moves=bodies.moves + ROUNDING_M), jnp.zeros((), bool)
    for each in obstacles:
        found |= each.surely_touches(where, bodies)
    return found


def tool_collides(
    scene: Scene, where: HasWorkpiecePose, cell: ToolCell, bodies: Int[Array, ""] | Bodies = Bodies.ARM
) -> Bool[jax.Array, ""]:
    """Return True if the tool, or the link before it, has too little clearance in every configuration of a cell.

    See docs/bounds.md, section Exclusion.

    Args:
        scene: The scene.
        where: A scenario; its margin is required.
        cell: The tool's poses in the cell.
        bodies: The bodies that the proof may use, see `Bodies`.
    """
    R, own = quaternion_matrix(cell.quaternion), _about_tip(chain_of(scene.robot), bodies)
    farthest = jnp.maximum(safe_norm(own.p), safe_norm(own.q))
    moves = own.moves + 2 * farthest * jnp.sin(0.5 * jnp.minimum(cell.rho, jnp.pi)) + scene.task.tolerance_m
    target = cell.target[None]
    p, q = (target + product(ends, R.T) for ends in (own.p, own.q))
    return surely_touches(scene.obstacles, where, SweptCapsules(p, q, own.radius, moves))


def _about_tip(robot: Robot, bodies: Int[Array, ""] | Bodies) -> SweptCapsules:
    """Return the bodies of the last two links relative to the TCP, in the last link's frame.

    The bodies of the link before the last are moved onto the last joint's axis.
    """
    last = len(robot.slides) - 1
    links, tip = jnp.asarray(robot.capsule_link), robot.T_link_tcp[:3, 3]
    tool, wrist = links == last, (links == last - 1) & (links >= 0) & ~jnp.asarray(robot.slides)[last]
    (a, off_a), (b, off_b) = (_on_axis(robot, end) for end in (robot.capsule_p, robot.capsule_q))
    p, q = (jnp.where(tool[:, None], *ends) for ends in ((robot.capsule_p, a), (robot.capsule_q, b)))
    off = jnp.maximum(off_a, off_b) + jnp.where(wrist, unused_m(bodies, Bodies.WRIST), UNUSED_M)
    moves = jnp.where(tool, unused_m(bodies, Bodies.TOOL), off)
    return cut_capsules(SweptCapsules(p - tip[None], q - tip[None], robots.core_radius(robot), moves))


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

    In a spherical wrist the last three joints of the chain are hinges whose axes meet in a point.
    """
    chain = chain_of(robot)
    if len(chain.slides) <= WRIST or any(chain.slides[-WRIST:]):
        return False
    endless = ~np.asarray(kinematics.is_periodic(robot)) & ~np.isfinite(np.asarray(robot.upper - robot.lower))
    free = np.asarray(before_wrist(robot))
    return free.any() and not (endless & free).any() and float(_MISSED_M(robot)) <= 0.1 * ROUNDING_M


def before_wrist(robot: Robot) -> Bool[Anywhere, "N"]:
    """Return True for coordinates that move a joint before the wrist."""
    first = robot.tcp_link + 1 - WRIST
    if robot.coupling is None:
        return jnp.arange(len(robot.slides)) < first
    return (robot.coupling.factors[:first] != 0).any(axis=0)


def wrist(robot: Robot) -> Wrist:
    """Return the wrist of an arm: the point on the second-last joint's axis that is nearest to the third-last one's.

    `missed_m` is infinite for an arm with fewer than three joints.
    """
    robot = chain_of(robot)
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
    centre = cell.target + product(quaternion_matrix(cell.quaternion), arm)
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
    docs/bounds.md, section Exclusion.

    Args:
        scene: The scene.
        where: A scenario; its margin is required.
        target: The target, world [m].
        x: Middle of the cell [rad or m]; the values of joints that move only the wrist are ignored.
        turns: Largest distance of every joint from x [rad or m]; such values are ignored here too.
        use: The bodies that the proof may use, see `Bodies`.
    """
    robot, tool = chain_of(scene.robot), wrist(scene.robot)
    first, free = len(robot.slides) - WRIST, before_wrist(robot)
    x, turns = jnp.where(free, x, 0.0), jnp.where(free, turns, 0.0)
    p, q, radius, aside, links = _before_wrist(robot)
    own, body = (tool.on_arm[None], p, q), joined([np.array([first]), links, links])
    at = kinematics.point_positions(robot, x, jnp.concatenate(own), body)
    moves = point_motion_bound(robot, x, turns, at, body) + ROUNDING_M
    length = safe_norm(tool.on_tool - robot.T_link_tcp[:3, 3])
    off = jnp.abs(safe_norm(at[0] - target) - length) > moves[0] + scene.task.tolerance_m
    (p, q), (of_p, of_q) = jnp.split(at[1:], 2), jnp.split(moves[1:], 2)
    bodies = SweptCapsules(p, q, radius, aside + jnp.maximum(of_p, of_q) + unused_m(use, Bodies.ARM))
    return CellBounds(off | surely_touches(scene.obstacles, where, bodies), at[0], moves[0])


def _before_wrist(robot: Robot):
    """Return the pieces of all bodies, in the frames of their links; those after the wrist's first link are not used.

    The angle of the wrist's first joint is ignored: the bodies of its link are moved onto the joint's axis.

    Returns:
        Ends p and q [m], radius [m], distance from the joint's axis [m], and link of each piece.
    """
    first, links = len(robot.slides) - WRIST, robot.body_links
    here = jnp.asarray((links >= 0) & (links <= first))
    bodies = robot.capsule_p, robot.capsule_q, robots.core_radius(robot), jnp.where(here, 0.0, UNUSED_M)
    p, q, radius, unused = cut_capsules(SweptCapsules(*bodies))
    links, axis = joined([links] * PIECES), robot.axis[first]
    turned = jnp.asarray(links == first)
    (on_p, off_p), (on_q, off_q) = seen_from(axis, p), seen_from(axis, q)
    aside = jnp.where(turned, jnp.maximum(off_p, off_q), 0.0) + unused
    p, q = jnp.where(turned[:, None], on_p, p), jnp.where(turned[:, None], on_q, q)
    return p, q, radius, aside, links
