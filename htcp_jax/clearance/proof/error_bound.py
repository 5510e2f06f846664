"""Scale up to which errors of the part, the tool, the joints and a cloud are proven to cause no contact.

Errors e lie in a box of half-widths. The largest scale l is sought at which no error in the box times l causes a
contact. A pair of a convex body and a convex feature of an obstacle is separated by the plane with the unit normal n
through the feature's nearest point (Boyd and Vandenberghe, Convex Optimization, section 2.5): every point of the body
is at least d beyond it. For any motion of both, the clearance remains at least

    d - max -n.u(a) - max n.v(b),

with u the displacement of the body's points a, and v that of the feature's points b. n is fixed, so nothing is
linearised but the displacements themselves. A body is the convex hull of its corners a, thickened by a radius, so only
the corners count. With t_j the largest distance of joint j from its value at an interval's middle, of which s_j is due
to the motion on the interval and l e_j is an error,

    -n.u(a) <= | sum_j n.J_j(a) x'_j | h + l sum_j |n.J_j(a)| e_j + T S (1 + T P)

where J_j is the Jacobian's column of joint j, r_j its length, T the sum of t_j over all hinges, S = sum_j t_j r_j, and
P the product of 1 + t_j over all hinges. The last term bounds the remainder: |p''| <= 2 T sum_j t_j (r_j + M), where no
point moves by more than M <= P S, see `motion_bound`. A rotation by the vector w displaces a point at a from the centre
by w x a, and a remainder of at most |w|^2 |a| / 2. For the part, shifted by p and rotated by w, and the tool, alike,

    n.v(b) <= l (sum_i |n_i| p_i + sum_i |(b x n)_i| w_i) + l^2 |w|^2 |b| / 2,

and for the tool l T (|p| + |w| |a|) is added, as the joints rotate its displacement. If the feature is a point, the
plane is fixed to the body instead, and the point moves: the same displacements at b, in the opposite order, which adds
l |w| P S + l^2 |w| |p| for the tool's, and l (T + l |w|) times the size of v for the part's. A plane of the part, as of
the interior rule, is treated alike. All of it is a quadratic function of l, whose root is the pair's scale. The scale
of an interval is the smallest of all pairs.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.clearance.proof.motion_bound import OUTSIDE_M, ROUNDING_M
from htcp_jax.model import Robot, moved_by

NOTHING = 3 * ROUNDING_M  # part of every distance that is not used, for rounding [m]


class ErrorSet(NamedTuple):
    """Half-widths of errors, in the frame of the chain's root, which is the world unless the part moves."""

    part_shift_m: Float[np.ndarray, "3"]
    part_turn_rad: Float[np.ndarray, "3"]  # of a rotation vector
    part_about_m: Float[np.ndarray, "3"]  # point about which the part turns
    tool_shift_m: Float[np.ndarray, "3"]  # along the axes of the frame `T_link_tool`
    tool_turn_rad: Float[np.ndarray, "3"]  # about its origin
    T_link_tool: Float[np.ndarray, "4 4"]  # frame of the tool's errors, in the link that carries the TCP [m]
    is_tool: Bool[np.ndarray, "K"]  # True for bodies of the tool
    joints: Float[np.ndarray, "N"]  # [rad or m]
    cloud_m: float  # radius about each of the part's points


class Places(NamedTuple):
    """n intervals of joint paths, about their middles."""

    x: Float[np.ndarray, "n N"]  # [rad or m]
    rates: Float[np.ndarray, "n N"]  # largest first-order displacement h x' within the interval [rad or m]
    turns: Float[np.ndarray, "n N"]  # largest distance of each coordinate from its value at the middle [rad or m]
    rest: Float[np.ndarray, "n N"]  # that without the first-order displacement [rad or m]
    T: Float[np.ndarray, "n L 4 4"]  # frames of the L = J + 1 links; the last one is the root's, so that it is link -1


class Pairs(NamedTuple):
    """P pairs of a body and a feature that may touch, and a plane between both."""

    place: Int[np.ndarray, "P"]  # interval
    body: Int[np.ndarray, "P"]
    other: Int[np.ndarray, "P"]  # link that the feature is fixed to
    corners: Float[np.ndarray, "P V 3"]  # of the body, at the interval's middle [m]
    radius: Float[np.ndarray, "P"]  # about the corners [m]
    normal: Float[np.ndarray, "P 3"]  # from the feature to the body, unit; NaN: unknown, any direction is possible
    height: Float[np.ndarray, "P"]  # largest n.b of the feature's points; the distance if the normal is unknown [m]
    point: Float[np.ndarray, "P 3"]  # the feature, if it is a point of the part; NaN: another feature [m]
    is_side: Bool[np.ndarray, "P"]  # True: the feature is a plane of the part
    other_body: Int[np.ndarray, "P"]  # the feature, if it is a body of the arm; -1: another feature
    in_body: Bool[np.ndarray, "P"]  # True: the plane is fixed to the body, and the only corner is the feature, a point


class Levers(NamedTuple):
    """Joints of a robot in each interval, on the host, for bounds on its motion."""

    hinge: Bool[np.ndarray, "J"]
    moves: Bool[np.ndarray, "L J"]  # True where a joint moves a link, see `moved_by`
    factors: Float[np.ndarray, "J N"]  # of the joints q = C x + d
    axis: Float[np.ndarray, "n J 3"]  # of the joints, at the middles
    origin: Float[np.ndarray, "n J 3"]  # [m]

    def columns(self, place: Int[np.ndarray, "*#r"], points: Float[np.ndarray, "*#r V 3"]) -> np.ndarray:
        """Return the columns of points' Jacobians in some intervals, of each joint (*r, V, J, 3) [m/rad or 1].

        Args:
            place: The intervals.
            points: The points [m].
        """
        axis = self.axis[place][..., None, :, :]
        arm = points[..., None, :] - self.origin[place][..., None, :, :]
        return np.where(self.hinge[:, None], np.cross(axis, arm), axis)


def displacement_size(shift_m: Float[np.ndarray, "3"], turn_rad: Float[np.ndarray, "3"], distance):
    """Return a bound on the displacement of points at a distance from the centre of a displaced body [m]."""
    return np.linalg.norm(shift_m) + np.linalg.norm(turn_rad) * distance


def levers_of(robot: Robot, places: Places) -> Levers:
    """Return the joints' axes at the middles of intervals."""
    joints = len(robot.slides)
    factors = np.eye(joints) if robot.coupling is None else np.asarray(robot.coupling.factors)
    axis = np.einsum("njab,jb->nja", places.T[:, :joints, :3, :3], np.asarray(robot.axis))
    return Levers(~np.array(robot.slides), moved_by(robot.parents), factors, axis, places.T[:, :joints, :3, 3])


def scales(
    robot: Robot, errors: ErrorSet, places: Places, levers: Levers, pairs: Pairs, margin_m: float, most: float
) -> Float[np.ndarray, "P"]:
    """Return each pair's scale: no error in the set times it causes a contact of the pair on its interval.

    Args:
        robot: The robot.
        errors: The errors at the scale 1.
        places: The intervals.
        levers: Their joints' axes.
        pairs: The pairs.
        margin_m: Required clearance [m].
        most: Largest scale to return.
    """
    is_directed = ~np.isnan(pairs.normal[:, 0])
    gap = np.einsum("pvi,pi->pv", pairs.corners, pairs.normal) - (pairs.radius + pairs.height)[:, None]
    gap = np.where(is_directed[:, None], gap, pairs.height[:, None])
    c0, c1, c2 = joint_terms(robot, errors, places, levers, pairs, most)
    b1, b2 = part_terms(errors, pairs)
    slack = gap - c0 - (margin_m + NOTHING)
    return np.clip(root(slack, c1 + b1, c2 + b2).min(axis=1), 0.0, most)


def root(slack: Float[np.ndarray, "*n"], first, second) -> Float[np.ndarray, "*n"]:
    """Return the largest l with first l + second l^2 <= slack [1]; 0 if there is no slack [m]."""
    size = first + np.sqrt(first * first + 4 * second * np.maximum(slack, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(slack > 0, np.where(size > 0, 2 * slack / size, np.inf), 0.0)


def joint_terms(robot: Robot, errors: ErrorSet, places: Places, levers: Levers, pairs: Pairs, most: float):
    """Return three tables (P, V) [m]: the terms of a corner's motion by joints and tool, by powers of the scale.

    Args:
        robot: The robot.
        errors: The errors at the scale 1.
        places: The intervals.
        levers: Their joints' axes.
        pairs: The pairs.
        most: Largest scale; the remainder is bounded up to it.
    """
    i, link = pairs.place, np.array(robot.capsule_link)[pairs.body]
    sign = levers.moves[link].astype(float) - levers.moves[pairs.other]  # joints between both
    between, hinge = np.abs(sign), levers.hinge[None]
    column = levers.columns(i, pairs.corners)
    lever = np.linalg.norm(column, axis=3) * between[:, None]
    is_directed = ~np.isnan(pairs.normal[:, 0])
    normal = np.where(is_directed[:, None], pairs.normal, 0.0)
    along = np.einsum("pvji,pi->pvj", column, normal) * sign[:, None]
    factors, sizes = levers.factors, np.abs(levers.factors)
    moved = np.abs(np.einsum("pvj,pj->pv", along, (places.rates @ factors.T)[i]))
    moved += np.einsum("pvn,pn->pv", np.abs(along @ factors), places.rest[i])
    first = np.abs(along @ factors) @ errors.joints
    if not is_directed.all():
        any_way = ~is_directed
        moved[any_way] = np.einsum("pvj,pj->pv", lever[any_way], (places.turns @ sizes.T)[i][any_way])
        first[any_way] = lever[any_way] @ (sizes @ errors.joints)
    t0, t1 = (places.turns @ sizes.T)[i] * between, (sizes @ errors.joints)[None] * between
    turn0, turn1 = (np.sum(t, axis=1, where=hinge)[:, None] for t in (t0, t1))
    sweep0, sweep1 = (np.einsum("pvj,pj->pv", lever, t) for t in (t0, t1))
    stretch = np.prod(1 + t0 + most * t1, axis=1, where=hinge)[:, None]
    rest = 1 + (turn0 + most * turn1) * stretch
    c0 = moved + rest * turn0 * sweep0
    c1 = first + rest * (turn0 * sweep1 + turn1 * sweep0)
    c2 = rest * turn1 * sweep1
    first, second, size = tool_terms(robot, errors, places, pairs, pairs.body, normal, is_directed)
    other = _of_other(robot, errors, places, pairs)
    c1, c2 = c1 + first + turn0 * size + other[0], c2 + second + turn1 * size + other[1]
    if pairs.is_side.any():  # the part turns also what the arm has moved
        turn = np.linalg.norm(errors.part_turn_rad) * pairs.is_side[:, None]
        c1, c2 = c1 + turn * stretch * sweep0, c2 + turn * (stretch * sweep1 + size)
    if pairs.in_body.any():  # the same displacements, in the opposite order
        inside = pairs.in_body[:, None]
        turn = np.linalg.norm(errors.tool_turn_rad) * errors.is_tool[pairs.body][:, None]
        away = np.linalg.norm(pairs.point - errors.part_about_m, axis=1)[:, None]
        part = displacement_size(errors.part_shift_m, errors.part_turn_rad, np.nan_to_num(away))
        part = np.where(np.isnan(away), 0.0, part)
        c1 = c1 + inside * (turn * stretch * sweep0 + turn0 * part)
        more = turn * (stretch * sweep1 + np.linalg.norm(errors.tool_shift_m)) + (turn1 + turn) * part
        c2 = c2 + inside * more
    return c0, c1, c2


def tool_terms(robot: Robot, errors: ErrorSet, places: Places, pairs: Pairs, body, normal, is_directed):
    """Return two terms (P, V) of a corner's displacement by the tool's errors [m], and a bound on its size [m]."""
    frame = places.T[pairs.place, robot.tcp_link] @ errors.T_link_tool
    away = pairs.corners - frame[:, None, :3, 3]
    distance, is_tool = np.linalg.norm(away, axis=2), errors.is_tool[body][:, None]
    turn = np.linalg.norm(errors.tool_turn_rad)
    size = displacement_size(errors.tool_shift_m, errors.tool_turn_rad, distance)
    first = np.abs(np.einsum("pi,pij->pj", normal, frame[:, :3, :3])) @ errors.tool_shift_m
    across = np.einsum("pvi,pij->pvj", np.cross(away, normal[:, None]), frame[:, :3, :3])
    first = first[:, None] + np.abs(across) @ errors.tool_turn_rad
    first = np.where(is_directed[:, None], first, size)
    return first * is_tool, 0.5 * turn * turn * distance * is_tool, size * is_tool


def _of_other(robot: Robot, errors: ErrorSet, places: Places, pairs: Pairs) -> tuple[np.ndarray, np.ndarray]:
    """Return the terms (P, 1) of a feature that is a body of the tool [m]."""
    is_tool = (pairs.other_body >= 0) & errors.is_tool[pairs.other_body]
    if not is_tool.any():
        return np.zeros((1, 1)), np.zeros((1, 1))
    turn, link = np.linalg.norm(errors.tool_turn_rad), np.array(robot.capsule_link)
    ends = np.stack([np.asarray(robot.capsule_p), np.asarray(robot.capsule_q)], axis=1)
    to_tool = np.linalg.norm(ends - errors.T_link_tool[:3, 3], axis=2).max(axis=1) + piece_radius(robot)
    to_tool = to_tool * (link == robot.tcp_link)
    distance = to_tool[pairs.other_body]
    size = displacement_size(errors.tool_shift_m, errors.tool_turn_rad, distance)
    return (is_tool * size)[:, None], (is_tool * 0.5 * turn * turn * distance)[:, None]


def part_terms(errors: ErrorSet, pairs: Pairs) -> tuple[Float[np.ndarray, "P V"], Float[np.ndarray, "P V"]]:
    """Return the terms of the part's displacement towards each corner [m], by powers of the scale.

    Args:
        errors: The errors at the scale 1.
        pairs: The pairs.
    """
    is_point = ~np.isnan(pairs.point[:, 0])
    at = np.where(is_point[:, None, None], pairs.point[:, None], pairs.corners) - errors.part_about_m
    distance, turn = np.linalg.norm(at, axis=2), np.linalg.norm(errors.part_turn_rad)
    shift = np.linalg.norm(errors.part_shift_m)
    size = displacement_size(errors.part_shift_m, errors.part_turn_rad, distance)
    first = (np.abs(pairs.normal) @ errors.part_shift_m)[:, None]
    first = first + np.abs(np.cross(at, pairs.normal[:, None])) @ errors.part_turn_rad
    first = np.where(np.isnan(first), size, first) + errors.cloud_m * is_point[:, None]
    second = 0.5 * turn * turn * distance + (turn * shift) * pairs.is_side[:, None]
    of_part = (is_point | pairs.is_side)[:, None]
    return np.where(of_part, first, 0.0), np.where(of_part, second, 0.0)


def largest_moves(
    robot: Robot,
    errors: ErrorSet,
    places: Places,
    levers: Levers,
    corners: Float[np.ndarray, "n K V 3"],
    most: float,
) -> Float[np.ndarray, "n K"]:
    """Return bounds on the displacement of each body's points from the middle, for all errors up to a scale [m].

    Args:
        robot: The robot.
        errors: The errors at the scale 1.
        places: The intervals.
        levers: Their joints' axes.
        corners: Ends of the bodies' axes [m].
        most: The scale.
    """
    moves = levers.moves[np.array(robot.capsule_link)]
    turns = (places.turns + most * errors.joints) @ np.abs(levers.factors).T
    column = levers.columns(np.arange(len(corners))[:, None], corners)
    swept = np.einsum("nkvj,nj,kj->nkv", np.linalg.norm(column, axis=4), turns, moves)
    stretch = np.prod(np.where(moves & levers.hinge, 1 + turns[:, None], 1.0), axis=2)
    frame = places.T[:, robot.tcp_link] @ errors.T_link_tool
    distance = np.linalg.norm(corners - frame[:, None, None, :3, 3], axis=3)
    size = most * displacement_size(errors.tool_shift_m, errors.tool_turn_rad, distance) * errors.is_tool[:, None]
    # Points of a piece are off the axis, and turn about it, see `interval.piece_turn_bound`.
    turned = (
        turns @ (moves & levers.hinge).T.astype(float) + most * np.linalg.norm(errors.tool_turn_rad) * errors.is_tool
    )
    return (stretch[..., None] * (swept + size)).max(axis=2) + piece_radius(robot) * np.minimum(turned, 2.0)


def piece_radius(robot: Robot) -> Float[np.ndarray, "K"]:
    """Return the largest distance of the points of each body's piece from its axis [m]; 0 for capsules."""
    if robot.pieces is None:
        return np.zeros(len(robot.capsule_radius))
    return np.where(np.asarray(robot.pieces.excess_m) > 0, np.asarray(robot.capsule_radius) + OUTSIDE_M, 0.0)
