"""Exclusion proofs for each branch of the inverse kinematics, for an arm with an elbow and a spherical wrist.

Such an arm has six hinges: the first axis is perpendicular to the second, the second is parallel to the third, and the
last three meet in the wrist, each perpendicular to the next. The tool's pose determines the wrist's position. Eight
configurations have the same tool pose: shoulder forward or backward, elbow up or down, wrist flipped or not (Siciliano
et al., Robotics, section 2.12). Each of these choices is a branch. If the tool's orientation is known up to an angle
rho, the wrist is in a ball, and in each branch every joint is in an interval (docs/bounds.md, section Exclusion).
These intervals bound the motion of all bodies in the branch, and are compared with the joint limits.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance.distance.sweep import SweptCapsules
from htcp_jax.clearance.obstacles.obstacle import HasWorkpiecePose, Scene
from htcp_jax.clearance.proof import exclusion
from htcp_jax.clearance.proof.exclusion import (
    Bodies,
    ToolCell,
    cut_capsules,
    seen_from,
    surely_touches,
    unused_m,
)
from htcp_jax.clearance.proof.motion_bound import ROUNDING_M, point_motion_bound
from htcp_jax.model import Robot, axis_angle_matrix, kinematics, quaternion_matrix
from htcp_jax.model import robot as robots
from htcp_jax.numerics import joined, product, safe_norm
from htcp_jax.types import Array, Bool, Float, Int, Joints, Scalar, Vector3

ROUNDING_RAD = 1e-7  # upper bound on the rounding error of any angle, including an arc cosine near 1
SKEW = 1e-4  # largest allowed deviation from right angles and parallel axes, for files with rounded angles [rad]
JOINTS, BRANCHES = 6, 8


class Elbow(NamedTuple):
    """Geometry of the arm before the wrist, for all joints at 0.

    Positions are in a frame with its origin on the first axis, z along the first axis and y along the second.
    """

    R: Float[Array, "3 3"]  # the frame's axes, in columns, world
    origin: Vector3  # the frame's origin, world [m]
    shoulder: Vector3  # point on the second axis [m]
    elbow: Vector3  # point on the third axis [m]
    wrist: Vector3  # point in which the last three axes meet [m]
    reverse: Scalar  # -1 if the third axis is opposite to the second, else 1
    skew: Scalar  # largest deviation from right angles and parallel axes [rad]


class Branch(NamedTuple):
    """Bounds on the joints in one branch of the inverse kinematics, over all tool orientations of a cell."""

    x: Joints  # configuration in the middle [rad]
    turns: Joints  # largest distance of every joint from x [rad]
    forearm_turns: Scalar  # largest rotation of the link before the wrist, from its orientation at x [rad]
    empty: Bool[Array, ""]  # True: no configuration reaches the wrist's ball


class Interval(NamedTuple):
    """An interval of angles [rad]."""

    middle: Scalar
    half: Scalar

    def plus(self, other: "Interval | Scalar", sign: Scalar | float = 1.0) -> "Interval":
        """Return this interval plus sign * other, where `other` is an interval or a number [rad]."""
        middle, half = other if isinstance(other, Interval) else (other, 0.0)
        return Interval(self.middle + sign * middle, self.half + half)


def has_branches(robot: Robot) -> bool:
    """Return True if the arm has an elbow, a spherical wrist and no followers in its chain, as this module requires."""
    robot = exclusion.chain_of(robot)
    if len(robot.slides) != JOINTS or any(robot.slides) or not exclusion.has_wrist(robot):
        return False
    if (own := robot.coupling) and (robot.dof != JOINTS or (own.factors != np.eye(JOINTS)).any() or own.offsets.any()):
        return False
    return float(_SKEW(robot)) <= SKEW


def elbow(robot: Robot) -> Elbow:
    """Return the geometry of an arm of six hinges."""
    frames = kinematics.link_poses(robot, jnp.zeros(JOINTS))
    first, second, third, *_ = axes = product(frames[:, :3, :3], robot.axis[:, :, None])[..., 0]
    x = jnp.cross(second, first)
    x = x / safe_norm(x)
    R, origin = jnp.stack([x, jnp.cross(first, x), first], axis=1), frames[0, :3, 3]
    wrist = frames[3, :3, 3] + product(frames[3, :3, :3], exclusion.wrist(robot).on_arm)
    shoulder, elbow_, wrist = (product(at - origin, R) for at in (frames[1, :3, 3], frames[2, :3, 3], wrist))
    bent = (jnp.abs(product(axes[k], axes[k + 1])) for k in (0, 3, 4))
    skew = jnp.maximum(jnp.max(jnp.stack(list(bent))), safe_norm(jnp.cross(second, third)))
    return Elbow(R, origin, shoulder, elbow_, wrist, jnp.sign(product(second, third)), skew)


_SKEW = jax.jit(lambda robot: elbow(robot).skew)


def branch(
    robot: Robot,
    target: Vector3,
    tool: Float[Array, "3 3"],
    rho: Scalar,
    number: Int[Array, ""],
    tolerance_m: Scalar | float,
) -> Branch:
    """Return bounds on the joints in one branch of the inverse kinematics, over all tool orientations of a cell.

    The branch has all configurations with the TCP on a target and the last link rotated by at most rho from `tool`.

    Args:
        robot: An arm that `has_branches`.
        target: The target, world [m].
        tool: Orientation of the last link.
        rho: Largest rotation from this orientation [rad].
        number: Index of the branch, 0 to BRANCHES - 1.
        tolerance_m: Largest distance of the TCP from the target [m].
    """
    own = elbow(robot)
    forward, up, flipped = (jnp.where((number >> bit) & 1 > 0, -1.0, 1.0) for bit in range(3))
    wrist, radius = _wrist_ball(robot, target, tool, rho, tolerance_m)
    upper, lower = own.elbow - own.shoulder, own.wrist - own.elbow
    length = safe_norm(own.shoulder) + safe_norm(upper) + safe_norm(lower)
    radius = radius + 4 * own.skew * length
    aim, side = product(wrist - own.origin, own.R), own.wrist[1]
    r = safe_norm(aim[:2])
    reach = jnp.stack([r, jnp.maximum(r - radius, 0.0), r + radius])
    outside = reach > jnp.abs(side)
    turned = _between(jnp.arcsin(jnp.where(outside, side / jnp.where(outside, reach, 1.0), jnp.sign(side))))
    turned = Interval(jnp.where(forward > 0, turned.middle, jnp.pi - turned.middle), turned.half)
    first = Interval(jnp.arctan2(aim[1], aim[0]), _cone(radius, r)).plus(turned, -1.0)

    # In the arm's plane: length a of the upper arm, b of the forearm, and c from the shoulder to the wrist.
    ahead = jnp.sqrt(jnp.maximum(reach * reach - side * side, 0.0))
    slope = jnp.where(outside[1], reach[1] / jnp.where(outside[1], ahead[1], 1.0), jnp.inf)
    spread = jnp.sqrt(radius * radius + jnp.max(jnp.abs(ahead - ahead[0])) ** 2)
    radius = jnp.minimum(spread, jnp.where(side == 0.0, 1.0, slope) * radius)
    (a, at_a), (b, at_b) = _in_plane(upper), _in_plane(lower)
    c, at_c = _in_plane(jnp.stack([forward * ahead[0], 0.0, aim[2]]) - own.shoulder)
    empty = (reach[2] < jnp.abs(side)) | (c - radius > a + b) | (c + radius < jnp.abs(a - b))
    sides = jnp.clip(jnp.stack([c - radius, c + radius]), jnp.abs(a - b), a + b)
    toward = Interval(at_c, _cone(radius, c))
    second = toward.plus(_corner(a, b, sides), up).plus(-at_a)
    forearm = toward.plus(_corner(b, a, sides), -up).plus(-at_b)
    fold = _between(_angle(a, b, sides))  # at the elbow
    third = Interval(own.reverse * (up * (fold.middle - jnp.pi) - at_b + at_a), fold.half)
    turns = first.half + forearm.half + jnp.abs(forearm.middle - second.middle - own.reverse * third.middle)

    x = jnp.stack([first.middle, second.middle, third.middle, 0.0, 0.0, 0.0])
    turns = turns + 4 * own.skew + ROUNDING_RAD
    turned = turns + rho + 4 * own.skew + ROUNDING_RAD  # a skewed axis rotates the tool by up to the skew
    last = _wrist_joints(robot, kinematics.link_poses(robot, x)[3, :3, :3], tool, turned, flipped)
    halves = jnp.stack([first.half, second.half, third.half]) + 4 * own.skew + ROUNDING_RAD
    return Branch(x.at[3:].set(last[0]), jnp.concatenate([halves, last[1]]), turns, empty)


def branch_collides(
    scene: Scene,
    where: HasWorkpiecePose,
    cell: ToolCell,
    number: Int[Array, ""],
    use: Int[Array, ""] | Bodies = Bodies.ARM,
) -> Bool[Array, ""]:
    """Return True if no configuration of a branch satisfies both the joint limits and the margin.

    The branch is defined as in `branch`. Bodies of the last link are not tested here, but by `exclusion.tool_collides`.

    Args:
        scene: The scene; its arm `has_branches`.
        where: A scenario; its margin is required.
        cell: The tool's poses in the cell.
        number: Index of the branch, 0 to BRANCHES - 1.
        use: The bodies that the proof may use, see `Bodies`.
    """
    target, quaternion, rho = cell
    robot = dataclasses.replace(exclusion.chain_of(scene.robot), coupling=None)
    tool, tolerance_m = quaternion_matrix(quaternion), scene.task.tolerance_m
    own = branch(robot, target, tool, rho, number, tolerance_m)
    arm = _on_arm(robot, own, _wrist_ball(robot, target, tool, rho, tolerance_m), use)
    of_tool = _on_tool(robot, own, target, tool, rho, tolerance_m, use)
    bodies = cut_capsules(SweptCapsules(*(jnp.concatenate(both) for both in zip(arm, of_tool, strict=True))))
    touches = surely_touches(scene.obstacles, where, bodies)
    return own.empty | _beyond_limits(robot, own) | touches


def _wrist_ball(robot: Robot, target: Vector3, tool: Float[Array, "3 3"], rho: Scalar, tolerance_m: Scalar | float):
    """Return the centre and the radius of a ball that contains the wrist, world [m]."""
    arm = exclusion.wrist(robot).on_tool - robot.T_link_tcp[:3, 3]
    radius = 2 * safe_norm(arm) * jnp.sin(0.5 * jnp.minimum(rho, jnp.pi)) + tolerance_m + ROUNDING_M
    return target + product(tool, arm), radius


def _in_plane(vector: Vector3) -> tuple[Scalar, Scalar]:
    """Return a vector's length in the plane of the arm [m], and its angle from the first axis [rad]."""
    x, _, z = vector
    return jnp.sqrt(x * x + z * z), jnp.arctan2(x, z)


def _cone(radius: Scalar, distance: Scalar) -> Scalar:
    """Return the half angle of the cone about a ball from a point at a distance [rad]; pi for a point inside."""
    outside = radius < distance
    return jnp.where(outside, jnp.arcsin(jnp.minimum(radius / jnp.where(outside, distance, 1.0), 1.0)), jnp.pi)


def _angle(a: Scalar, b: Float[Array, "..."], c: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the angle between the sides a and b of a triangle [rad]."""
    return jnp.arccos(jnp.clip((a * a + b * b - c * c) / (2 * a * b), -1.0, 1.0))


def _corner(a: Scalar, b: Scalar, sides: Float[Array, "2"]) -> Interval:
    """Return the interval of the angle between the sides a and c of a triangle with the sides a, b and c.

    `sides` has the least and the largest c. The angle is largest if the angle between b and c is a right angle.
    """
    largest = jnp.sqrt(jnp.maximum(a * a - b * b, 0.0))
    c = jnp.concatenate([sides, jnp.clip(largest, *sides)[None]])
    return _between(_angle(a, jnp.maximum(c, ROUNDING_M), b))


def _between(angles: Float[Array, "n"]) -> Interval:
    """Return the smallest interval that contains all given angles."""
    least, largest = jnp.min(angles), jnp.max(angles)
    return Interval(0.5 * (least + largest), 0.5 * (largest - least))


def _wrist_joints(
    robot: Robot, before: Float[Array, "3 3"], tool: Float[Array, "3 3"], turned: Scalar, flipped: Scalar
) -> tuple[Vector3, Vector3]:
    """Return the angles of the three wrist joints, and bounds on the deviation from these angles [rad].

    Args:
        robot: An arm that `has_branches`.
        before: Orientation of the link of the wrist's first joint, for the joint at 0.
        tool: Orientation of the last link.
        turned: Bound on the sum of the two links' rotations from these orientations [rad].
        flipped: Sign of the second joint's angle, measured from the angle at which first and third axis are aligned.
    """
    first, second, third = robot.axis[3:]
    R, S = robot.T_parent_joint[4:, :3, :3]
    relative = product(before.T, tool)
    aim = product(relative, third)  # in the frame of `before`, as are all further vectors
    b, c = product(R, second), product(R, product(S, third))
    at_zero = jnp.arctan2(product(first, jnp.cross(b, c)), product(first, c))  # aligns the first and the third axis
    phi = jnp.arctan2(safe_norm(jnp.cross(first, aim)), product(first, aim))
    x2 = at_zero + flipped * phi
    x1 = _azimuth(first, product(_rotation(b, x2), c), aim)
    so_far = product(product(_rotation(first, x1), R), product(_rotation(second, x2), S))
    across = jnp.cross(third, jnp.eye(3)[jnp.argmin(jnp.abs(third))])
    x3 = _azimuth(third, across, product(so_far.T, product(relative, across)))
    known = (turned < phi) & (turned < jnp.pi - phi)
    sine = jnp.sin(jnp.minimum(turned, 0.5 * jnp.pi)) / jnp.where(known, jnp.sin(phi), 1.0)
    turns = jnp.where(known & (sine < 1), jnp.arcsin(jnp.minimum(sine, 1.0)), jnp.pi)
    return jnp.stack([x1, x2, x3]), jnp.stack([turns, turned, turns]) + ROUNDING_RAD


def _rotation(axis: Vector3, turn: Scalar) -> Float[Array, "3 3"]:
    return axis_angle_matrix(axis[None], turn[None])[0]


def _azimuth(axis: Vector3, a: Vector3, b: Vector3) -> Scalar:
    """Return the angle about an axis from a to b [rad]."""
    return jnp.arctan2(product(axis, jnp.cross(a, b)), product(a, b) - product(axis, a) * product(axis, b))


def _beyond_limits(robot: Robot, own: Branch) -> Bool[Array, ""]:
    """Return True if a joint is certainly outside its limits, also if its angle is changed by multiples of 2 pi."""
    narrow = robot.upper - robot.lower < 2 * jnp.pi
    away = own.x - jnp.where(narrow, 0.5 * (robot.lower + robot.upper), 0.0)
    away = jnp.abs(away - 2 * jnp.pi * jnp.round(away / (2 * jnp.pi)))
    return jnp.any(narrow & (away > 0.5 * (robot.upper - robot.lower) + own.turns))


def _on_arm(robot: Robot, own: Branch, ball: tuple[Vector3, Scalar], use: Int[Array, ""] | Bodies) -> SweptCapsules:
    """Return the bodies up to the wrist's first link, with bounds on their displacement in a branch.

    A second bound for bodies of the last two of these links: their distance from the wrist, which stays in a ball.
    """
    links = joined([robot.body_links] * 2)
    here = jnp.asarray((links >= 0) & (links <= 3))
    wrist, ends = exclusion.wrist(robot).on_arm, jnp.concatenate([robot.capsule_p, robot.capsule_q])
    at = kinematics.point_positions(robot, own.x, jnp.concatenate([wrist[None], ends]), joined([np.array([3]), links]))
    moves = point_motion_bound(robot, own.x, own.turns, at[1:], links)
    centre, radius = ball
    turned = 2 * jnp.sin(0.5 * jnp.minimum(jnp.stack([own.forearm_turns, own.turns[3]]), jnp.pi))
    off = jnp.where(links == 3, seen_from(robot.axis[3], ends)[1], 0.0)
    near = radius + safe_norm(at[0] - centre) + turned[0] * safe_norm(at[1:] - at[:1]) + turned[1] * off
    moves = jnp.where(links >= 2, jnp.minimum(moves, near), moves) + ROUNDING_M
    return _swept(robot, at[1:], moves + jnp.where(here, unused_m(use, Bodies.ARM), exclusion.UNUSED_M))


def _on_tool(
    robot: Robot,
    own: Branch,
    target: Vector3,
    tool: Float[Array, "3 3"],
    rho: Scalar,
    tolerance_m: Scalar | float,
    use: Int[Array, ""] | Bodies,
) -> SweptCapsules:
    """Return the bodies of the link before the last, with bounds on their displacement in a branch.

    The bounds follow from the tool's cell of orientations and from the last joint.
    """
    here = jnp.tile(jnp.asarray(robot.capsule_link) == 4, 2)
    T, axis, tip = robot.T_parent_joint[5], robot.axis[5], robot.T_link_tcp[:3, 3]
    ends = jnp.concatenate([robot.capsule_p, robot.capsule_q])
    ends = product(ends - T[None, :3, 3], T[:3, :3])  # in the last link's frame, with the last joint at 0
    off = seen_from(axis, ends)[1]
    ends = product(ends, _rotation(axis, -own.x[5]).T) - tip[None]
    turned = 2 * jnp.sin(0.5 * jnp.minimum(jnp.stack([rho, own.turns[5]]), jnp.pi))
    moves = turned[0] * safe_norm(ends) + turned[1] * off + tolerance_m + ROUNDING_M
    moves += jnp.where(here, unused_m(use, Bodies.WRIST), exclusion.UNUSED_M)
    return _swept(robot, target[None] + product(ends, tool.T), moves)


def _swept(robot: Robot, ends: Float[Array, "n 3"], moves: Float[Array, "n"]) -> SweptCapsules:
    """Return all bodies, from their axes' ends, first all p, then all q, and bounds on the ends' motion [m]."""
    p, q = jnp.split(ends, 2)
    return SweptCapsules(p, q, robots.core_radius(robot), jnp.max(moves.reshape(2, -1), axis=0))
