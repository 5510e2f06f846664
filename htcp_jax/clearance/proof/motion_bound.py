"""Bounds on the motion of the arm while every joint stays within a given distance of its value.

Let joint j move by at most d_j to either side. In the frame of the link before it, a point of a body moves by

    M_j <= M_{j+1} + d_j (r_j + M_{j+1}),

where r_j is the point's distance to the joint's axis at the middle, and M_{j+1} bounds the motion due to the joints
after j, up to the body's link (0 after it). A slide adds only d_j. A body is rigid and convex, so its ends bound all
of its points.

On a straight joint path x(s) with x' = t, a point has p'' = sum_ij t_i t_j d2p / dq_i dq_j. The Jacobian's column of a
hinge j is z_j x (p - o_j). Its length is the distance of p from the axis, and it rotates with every hinge i before j
(Siciliano et al., Robotics, section 3.1). With r_j bounded as above, and sums over the joints that move the point,

    |p''| <= sum_j |t_j| r_j (|t_j| + 2 sum_{i < j} |t_i|).

The column of a slide has length 1. It does not depend on the slide, and rotates only with the hinges before it. With
|p''| <= A within h of the middle m,

    |p(s) - p(m)| <= h |p'(m)| + A h^2 / 2,

This bound is small if joints cancel each other's motion, as they do near a tool that hardly moves.

Relative to another link, a body is moved only by the joints between both links. If the links are on different
branches, these joints form one chain too: from that link back to the branching, and on to the body.

If joints follow others, t = C x' for the joints on a straight path, so that opposite followers cancel, and d = |C| d_x
if the coordinates vary within d_x.

On a curved path, |t_j| is a bound on all of the interval, and each joint adds |x_j''| r_j to the bound on
|p''|. If, in addition, each joint may be up to e_j away from the path, a point may be sum_j e_j r_j away from its own
path: the joints are moved one after the other, and r_j bounds the distance in all of these configurations.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance.distance.sweep import BodySweep
from htcp_jax.clearance.obstacles.obstacle import RowPairs
from htcp_jax.model import Robot, joints_between, kinematics
from htcp_jax.numerics import joined, safe_norm
from htcp_jax.types import Anywhere, Array, Bool, Float, Int, Joints, Scalar, Vector3

OUTSIDE_M = 1e-6  # distance by which a convex piece may extend beyond its capsule
ROUNDING_M = 1e-9  # upper bound on the rounding error of any position; margin of every proof


class JointSweep(NamedTuple):
    """Motion of the joints on an interval of a joint path x(s), about its middle, with |s| <= half."""

    rates: Joints  # derivative x' at the middle [rad or m]
    half: Scalar
    speeds: Joints | None = None  # bound on |x'| [rad or m]; None: the path is straight
    bends: Joints | None = None  # bound on |x''| [rad or m]; None: the path is straight
    off: Joints | None = None  # largest distance of each joint from the path [rad or m]; None: 0

    def of_joints(self, robot: Robot) -> "JointSweep":
        """Return the motion of all joints of an arm in which joints follow others."""
        bounds = (each if each is None else kinematics.joint_ranges(robot, each) for each in self[2:])
        return JointSweep(kinematics.joint_rates(robot, self.rates), self.half, *bounds)

    @property
    def turns(self) -> Joints:
        """Largest distance of each joint from its value at the middle [rad or m]."""
        turns = self.half * (jnp.abs(self.rates) if self.speeds is None else self.speeds)
        return turns if self.off is None else turns + self.off

    def chain(self, joints: Int[np.ndarray, "n"], signs: Sequence[float]) -> "JointSweep":
        """Return the motion of some joints, with the signs of their rates."""
        bounds = (each if each is None else each[joints] for each in self[2:])
        return JointSweep(self.rates[joints] * np.array(signs), self.half, *bounds)

    def only(self, moving: Bool[Array, "N"]) -> "JointSweep":
        """Return the motion in which all other joints stand still."""
        still = lambda each: jnp.where(moving, each, 0.0)  # noqa: E731
        return jax.tree.map(still, self._replace(half=None))._replace(half=self.half)


class TcpSweep(NamedTuple):
    """Motion of the TCP on an interval of a joint path, about its position at the middle."""

    position: Vector3  # world [m]
    velocity: Vector3  # derivative in s [m]
    bend: Scalar  # bound on the second derivative |p''| [m]
    off: Scalar | None = None  # largest distance from the path [m]; None: 0


class _Bounds(NamedTuple):
    """Bounds on the motion of P points that are fixed to links."""

    velocity: Float[Array, "P 3"]  # derivative in s [m]
    moved: Float[Array, "P"]  # bound on each point's displacement [m]
    bend: Float[Array, "P"]  # bound on each point's |p''| [m]
    off: Float[Array, "P"] | None = None  # bound on each point's distance from its path [m]; None: 0


def motion_bound(robot: Robot, x: Joints, turns: Joints) -> Float[Array, "K"]:
    """Return a bound [m] on the displacement of any point of each body from x.

    Args:
        robot: The robot.
        x: The configuration [rad or m].
        turns: Largest distance of every joint from x [rad or m].
    """
    return _larger(point_motion_bound(robot, x, turns, *_axis_ends(robot, kinematics.capsule_segments(robot, x))))


def point_motion_bound(
    robot: Robot, x: Joints, turns: Joints, points: Float[Array, "P 3"], links: Int[Anywhere, "P"]
) -> Float[Array, "P"]:
    """Return `motion_bound` for points that are fixed to links.

    Args:
        robot: The robot.
        x: The configuration [rad or m].
        turns: Largest distance of every joint from x [rad or m].
        points: The points at x, world [m].
        links: Each point's link, -1 for the world.
    """
    ranges = kinematics.joint_ranges(robot, turns)
    return _bounds(robot, x, JointSweep(jnp.zeros_like(ranges), 0.0), ranges, points, links).moved


def body_sweep(robot: Robot, x: Joints, sweep: JointSweep) -> BodySweep:
    """Return the motion of the bodies on an interval of a joint path.

    Args:
        robot: The robot.
        x: The configuration at the interval's middle [rad or m].
        sweep: The joints' motion about it.
    """
    within = jax.tree.map(lambda bounds: bounds[:-1], _of_arm(robot, x, sweep)[1])
    return _swept(within, sweep.half)


def _swept(within: _Bounds, half: Scalar) -> BodySweep:
    off = 0.5 * half * half * within.bend
    if within.off is not None:
        off = off + within.off
    along = half * safe_norm(within.velocity) + off
    travel = jnp.minimum(_larger(along), _larger(within.moved))
    p, q = half * within.velocity.reshape(2, -1, 3)
    return BodySweep(p, q, _larger(off), travel)


def tcp_sweep(robot: Robot, x: Joints, sweep: JointSweep) -> TcpSweep:
    """Return the motion of the TCP on an interval of a joint path.

    If the same compiled function also calls `body_sweep`, this costs almost nothing.

    Args:
        robot: The robot.
        x: The configuration at the interval's middle [rad or m].
        sweep: The joints' motion about it.
    """
    points, within = _of_arm(robot, x, sweep)
    return TcpSweep(points[-1], within.velocity[-1], within.bend[-1], None if within.off is None else within.off[-1])


def travel_bound(robot: Robot, x: Joints, sweep: JointSweep) -> Float[Array, "K"]:
    """Return a bound [m] on the displacement of any point of each body from x on an interval of a joint path.

    Args:
        robot: The robot.
        x: The configuration at the interval's middle [rad or m].
        sweep: The joints' motion about it.
    """
    return body_sweep(robot, x, sweep).travel


def pair_travel_bound(robot: Robot, rows: RowPairs, x: Joints, sweep: JointSweep) -> Float[Array, "R"]:
    """Return a bound [m] on the displacement of each row's body from x, seen from the link on the row's other side.

    Only the joints between both links move the body, see `travel_bound`.

    Args:
        robot: The robot.
        rows: Both sides of each row.
        x: The configuration at the interval's middle [rad or m].
        sweep: The joints' motion about it.

    Raises:
        ValueError: If a row's body does not lie after the link on its other side, in an arm that is one chain; in
            programs, whose rows are not known, this is not checked.
    """
    p, q = (end[rows.body] for end in kinematics.capsule_segments(robot, x))
    links, own = rows.links(robot), sweep.of_joints(robot)
    if robot.coupling is not None:
        sides = np.tile(links, 2), np.tile(rows.others, 2)
        return _swept(_bounds(robot, x, own, own.turns, jnp.concatenate([p, q]), *sides), sweep.half).travel

    if isinstance(links, np.ndarray) and ((rows.others >= 0) & (rows.others >= links)).any():
        raise ValueError("each row's body must lie after the link on the row's other side, in the chain")

    def of_row(p: Vector3, q: Vector3, link: Int[Array, ""], other: Int[Array, ""]) -> Scalar:
        after = own.only(jnp.arange(len(robot.slides)) > other)
        return _swept(
            _bounds(robot, x, after, after.turns, jnp.stack([p, q]), jnp.stack([link] * 2)), sweep.half
        ).travel[0]

    return jax.vmap(of_row)(p, q, jnp.asarray(links), jnp.asarray(rows.others))


def point_bend_bound(
    robot: Robot, x: Joints, sweep: JointSweep, points: Float[Array, "P 3"], links: Int[Anywhere, "P"]
) -> Float[Array, "P"]:
    """Return a bound [m] on the second derivative |p''| of points fixed to links, on an interval of a joint path.

    Args:
        robot: The robot.
        x: The configuration at the interval's middle [rad or m].
        sweep: The joints' motion about it.
        points: The points at x, world [m].
        links: Each point's link, -1 for the world.
    """
    own = sweep.of_joints(robot)
    return _bounds(robot, x, own, own.turns, points, links).bend


@jax.jit
def _of_arm(robot: Robot, x: Joints, sweep: JointSweep) -> tuple[Float[Array, "P 3"], _Bounds]:
    """Return the ends of the bodies' axes and, last, the TCP, with their bounds; one function, compiled once."""
    (points, links), own = arm_points(robot, x), sweep.of_joints(robot)
    return points, _bounds(robot, x, own, own.turns, points, links)


def arm_points(robot: Robot, x: Joints) -> tuple[Float[Array, "P 3"], Int[Anywhere, "P"]]:
    """Return the ends of the bodies' axes and, last, the TCP at x, world [m], and the link of each."""
    ends, links = _axis_ends(robot, kinematics.capsule_segments(robot, x))
    return jnp.concatenate([ends, kinematics.tcp_position(robot, x)[None]]), joined([links, np.array([robot.tcp_link])])


def _axis_ends(robot: Robot, segments: tuple[Float[Array, "K 3"], Float[Array, "K 3"]]):
    """Return both ends of every body's axis [m], first all p, then all q, and their links."""
    return jnp.concatenate(segments), joined([robot.body_links] * 2)


def _larger(bounds: Float[Array, "P"]) -> Float[Array, "K"]:
    """Return the larger of the bounds of each body's two ends."""
    return jnp.max(bounds.reshape(2, -1), axis=0)


def _bounds(
    robot: Robot,
    x: Joints,
    sweep: JointSweep,
    turns: Float[Array, "J"],
    points: Float[Array, "P 3"],
    links: Int[Anywhere, "P"],
    others: Int[np.ndarray, "P"] | None = None,
) -> _Bounds:
    """Return bounds for points at x [m]: every joint q stays within `turns` of its value, and moves by `sweep`.

    The motion is seen from the world, or from the links `others`.
    """
    hinge = robot.hinges
    if robot.coupling is None:
        columns = kinematics.point_jacobians(robot, x, points, links).swapaxes(1, 2)
        own = jnp.where(~hinge[None] & (np.arange(len(hinge))[None] <= links[:, None]), 1.0, safe_norm(columns))
        return _bounds_of_chain(columns, own, sweep, turns, hinge)
    columns, parts, rows = kinematics.by_joint(robot, x, points, None).swapaxes(1, 2), [], []
    pairs = np.stack([links, np.full_like(links, -1) if others is None else others], axis=1)
    for pair in np.unique(pairs, axis=0):
        rows.append(np.flatnonzero((pairs == pair).all(axis=1)))
        joints, signs = joints_between(robot.parents, *pair.tolist())
        chain = np.array(joints, int)
        own = columns[rows[-1]][:, chain]
        levers = jnp.where(hinge[chain][None], safe_norm(own), 1.0)
        parts.append(_bounds_of_chain(own, levers, sweep.chain(chain, signs), turns[chain], hinge[chain]))
    order = np.argsort(np.concatenate(rows))
    return jax.tree.map(lambda *each: jnp.concatenate(each)[order], *parts)


def _bounds_of_chain(
    columns: Float[Array, "P n 3"],
    levers: Float[Array, "P n"],
    sweep: JointSweep,
    turns: Float[Array, "n"],
    hinge: Bool[Anywhere, "n"],
) -> _Bounds:
    """Return the bounds for P points by the n joints of a chain, from their velocities per unit speed of each joint."""
    rates, bend = sweep.rates, jnp.zeros(len(columns))
    speeds = jnp.abs(rates) if sweep.speeds is None else sweep.speeds
    if not len(hinge):
        return _Bounds(jnp.zeros((len(columns), 3)), bend, bend, None if sweep.off is None else bend)
    (lever, moved), turning = lever_bounds(levers, turns, hinge), hinge.astype(float)
    for j in reversed(range(len(hinge))):
        turned = 2 * jnp.sum(speeds[:j], where=hinge[:j])
        bend = bend + speeds[j] * lever[j] * (turned + turning[j] * speeds[j])
    if sweep.bends is not None:
        bend = bend + sum(own * lever[j] for j, own in enumerate(sweep.bends))
    off = None if sweep.off is None else sum(own * lever[j] for j, own in enumerate(sweep.off))
    return _Bounds(jnp.sum(columns * rates[None, :, None], axis=1), moved, bend, off)


def lever_bounds(
    levers: Float[Anywhere, "*L P N"], turns: Float[Anywhere, "*T N"], hinge: Bool[Anywhere, "N"]
) -> tuple[list[Float[Anywhere, "... P"]], Float[Anywhere, "... P"]]:
    """Return r_j + M_{j+1} for each joint (r_j for a slide), and M_1, see the module's docstring; numpy or JAX.

    Args:
        levers: r_j of each point and joint [m]; 0 for a joint that does not move the point.
        turns: d_j, the largest distance of every joint from its value [rad or m].
        hinge: True for hinges.
    """
    bounds, moved, turning = [], 0.0, hinge.astype(float)
    for j in reversed(range(len(hinge))):
        bounds.insert(0, levers[..., j] + turning[j] * moved)
        moved = moved + turns[..., None, j] * bounds[0]
    return bounds, moved
