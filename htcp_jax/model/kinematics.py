"""Kinematics of one configuration x (N,) [rad or m], in closed form: link poses, TCP, capsules, Jacobians.

If joints follow others, q = C x + d is computed once, and Jacobians by q are multiplied by C, see `coupling`.

The paper's Gamma and Jac; the geometric Jacobian is that of Siciliano et al., Robotics, section 3.1.

No matrix is inverted or decomposed, and the loop over the joints is unrolled on a GPU, so the functions compile fast
and batch well. Several of them in one jitted function cost one pass over the joints, as the compiler merges common
subexpressions. x may also be a list. An x that is not one configuration of the robot raises InputError.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.backend import backend
from htcp_jax.model.coupling import moved_by
from htcp_jax.model.robot import Robot
from htcp_jax.model.rotations import axis_angle_matrix
from htcp_jax.numerics import checked_shape, product
from htcp_jax.types import Anywhere, Array, Bool, Float, Int, Joints, Pose, Vector3

Links = tuple[int, ...] | Int[Anywhere, "*n"]  # index of each point's link, -1 for the world


def link_poses(robot: Robot, x: Joints) -> Float[Array, "J 4 4"]:
    """Return T_world_link, the frame of every link in the world [m]."""
    return _homogeneous(_link_frames(robot, x))


def tcp_pose(robot: Robot, x: Joints) -> Pose:
    """Return T_world_tcp, the frame of the tool centre point in the world [m]."""
    last = _frame_at(_link_frames(robot, x), robot.tcp_link)
    T = robot.T_link_tcp
    return _homogeneous(_Frames(product(last.rotation, T[:3, :3]), _to_world(last, T[:3, 3])))


def tcp_position(robot: Robot, x: Joints) -> Vector3:
    """Return the tool centre point in the world [m]; the paper's Gamma_j(x), equation (1)."""
    return _to_world(_frame_at(_link_frames(robot, x), robot.tcp_link), robot.T_link_tcp[:3, 3])


def capsule_segments(robot: Robot, x: Joints) -> tuple[Float[Array, "K 3"], Float[Array, "K 3"]]:
    """Return the end points p and q of the capsules' axes in the world [m]."""
    own = _frames_of(robot, x, robot.capsule_link)
    return _to_world(own, robot.capsule_p), _to_world(own, robot.capsule_q)


def body_poses(robot: Robot, x: Joints) -> Float[Array, "K 4 4"]:
    """Return T_world_link of each capsule's link [m]."""
    own = _frames_of(robot, x, robot.capsule_link)
    moved = jnp.concatenate([own.rotation, own.origin[:, :, None]], axis=2)
    return jnp.concatenate([moved, jnp.broadcast_to(jnp.eye(4)[3:], (len(moved), 1, 4))], axis=1)


def tip_segment(robot: Robot, x: Joints) -> Float[Array, "2 3"]:
    """Return the bare tip in the world [m]: the segment from the nearest end of a capsule to the TCP.

    Only capsules of the last link that has capsules are considered; fixtures are ignored. The nearest end is selected
    at x = 0, so that it is the same in every configuration.
    """
    zero, here = (jnp.concatenate(capsule_segments(robot, at)) for at in (jnp.zeros_like(x), x))
    away = zero - tcp_position(robot, jnp.zeros_like(x))[None]
    square = jnp.where(jnp.tile(_on_last_link(robot), 2), jnp.sum(away * away, axis=1), jnp.inf)
    return jnp.stack([here[jnp.argmin(square)], tcp_position(robot, x)])


def _on_last_link(robot: Robot) -> Bool[Anywhere, "K"]:
    """Return True for the capsules of the chain's last link that has capsules, except fixtures."""
    links = robot.body_links
    where = np.where if isinstance(links, np.ndarray) else jnp.where
    links = where((links > robot.tcp_link) | np.isin(np.arange(len(links)), robot.attached), -2, links)
    return links == links.max()


class TipBounds(NamedTuple):
    """Bounds on the motion of the bare tip, without the tool's extension."""

    speeds: Float[np.ndarray, "*n C"]  # of the tip's points, per unit speed of the chain's C joints [m/rad or 1]
    is_rigid: bool  # True if both ends of the tip are fixed to the last link
    factors: Float[np.ndarray, "C N"] | None = None  # the chain's joints by the coordinates; None: they are the same
    open_slides: Float[np.ndarray, "C C"] | None = None  # rise of the speeds per |q| of slides without limits; None: 0
    offsets: Float[np.ndarray, "C"] | float = 0.0  # of the chain's joints, see `Coupling`

    def between(self, a: Float[np.ndarray, "n N"], b: Float[np.ndarray, "n N"]) -> "TipBounds":
        """Return the bounds on n straight joint paths from a to b [rad or m]: slides without limits move there only."""
        if self.open_slides is None:
            return self
        ends = (x if self.factors is None else x @ self.factors.T for x in (a, b))
        farthest = np.maximum(*(np.abs(q + self.offsets) for q in ends))
        return self._replace(speeds=self.speeds + farthest @ self.open_slides.T)

    def turned(self, step: Float[np.ndarray, "*n N"]) -> Float[np.ndarray, "*n C"]:
        """Return by how much each of the chain's joints moves on straight joint paths [rad or m]."""
        return np.abs(step if self.factors is None else step @ self.factors.T)

    def travel_m(self, turned: Float[np.ndarray, "n C"], longer_m: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Return bounds on the travel of the tip's points along straight joint paths [m].

        Args:
            turned: Travel of each joint [rad or m].
            longer_m: Absolute value of the tool's extension [m].
        """
        by_speeds = turned @ self.speeds if self.speeds.ndim == 1 else (turned * self.speeds).sum(axis=1)
        return by_speeds + longer_m * turned.sum(axis=1)

    def bulge_m(self, turned: Float[np.ndarray, "n C"], longer_m: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Return bounds on the distance of the tip's points from the lines between their positions at both ends [m].

        The second derivative of a point by two joints is at most its speed by the outer one. Arguments as in
        `travel_m`.
        """
        outer = np.maximum.accumulate(self.speeds[..., ::-1], axis=-1)[..., ::-1]
        return turned.sum(axis=1) * self._replace(speeds=outer).travel_m(turned, longer_m) / 8


def tip_bounds(robot: Robot) -> TipBounds:
    """Return bounds on the motion of the bare tip, see `tip_segment`.

    A speed's bound is the sum of the lengths of the links after the joint, of the tip's distance from its link's
    origin, and of the slides' travel. For slides without limits, see `TipBounds.between`.
    """
    chain, last = slice(robot.tcp_link + 1), np.flatnonzero(_on_last_link(robot))
    slides = np.array(robot.slides)[chain]
    links = np.linalg.norm(np.asarray(robot.T_parent_joint)[chain][1:, :3, 3], axis=1)
    travel = np.where(slides, joint_travel(robot)[chain], 0.0)
    links += np.where(np.isinf(travel), 0.0, travel)[1:]
    ends = np.concatenate([np.asarray(end)[last] for end in (robot.capsule_p, robot.capsule_q)])
    tip = np.linalg.norm(np.vstack([ends, np.asarray(robot.T_link_tcp)[:3, 3]]), axis=1).max()
    speeds = np.where(slides, 1.0, np.append(np.cumsum(links[::-1])[::-1], 0.0) + tip)
    bounds = TipBounds(speeds, bool(robot.capsule_link[last[0]] == robot.tcp_link))
    if np.isinf(travel[1:]).any():
        after = np.triu(np.ones((len(slides), len(slides))), 1)
        bounds = bounds._replace(open_slides=np.where(slides[:, None] | ~np.isinf(travel), 0.0, after))
    if robot.coupling is None:
        return bounds
    factors, offsets = (np.asarray(each)[chain] for each in (robot.coupling.factors, robot.coupling.offsets))
    return bounds._replace(factors=factors, offsets=offsets)


class ArmShape(NamedTuple):
    """Geometry of an arm for drawing, at W configurations or at one, in the world [m]."""

    p: Float[Array, "*W K 3"]  # first ends of the capsules' axes
    q: Float[Array, "*W K 3"]  # second ends
    tip: Float[Array, "*W 3"]  # start of the tool's bare tip, see `tip_segment`
    tcp: Float[Array, "*W 3"]  # end of the bare tip

    def axes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the ends of K + 1 axes at one configuration: the capsules' axes, then the bare tip [m]."""
        return np.vstack([self.p, self.tip]), np.vstack([self.q, self.tcp])


def arm_shape(robot: Robot, x: Joints) -> ArmShape:
    """Return the arm's geometry for drawing."""
    return ArmShape(*capsule_segments(robot, x), *tip_segment(robot, x))


def root_pose(robot: Robot, x: Joints) -> Pose:
    """Return the pose of the chain's root in the workshop [m].

    The root is the part's link if the part moves. Otherwise it is the world, and the pose is the identity.
    """
    origin, axes = jnp.array([robot.world.origin_m]), jnp.array(robot.world.columns)
    link = -1 if robot.world.link is None else robot.world.link
    rotation = directions(robot, x, axes, (link,) * 3)  # row i: the workshop's axis i, in the root's frame
    place = -product(rotation, point_positions(robot, x, origin, (link,)).T)[:, 0]
    return _homogeneous(_Frames(rotation, place))


def jacobian(robot: Robot, x: Joints) -> Float[Array, "3 N"]:
    """Return the geometric Jacobian of the TCP's position, d tcp_position / dx [m/rad or m/m].

    The paper's Jac(x) of (7).
    """
    links = _link_frames(robot, x)
    tcp = _to_world(_frame_at(links, robot.tcp_link), robot.T_link_tcp[:3, 3])
    if robot.coupling is not None:
        return point_jacobians(robot, x, tcp[None], (robot.tcp_link,))[0]
    return _velocities(robot, links, tcp[None])[0].T


def point_jacobians(robot: Robot, x: Joints, points: Float[Array, "P 3"], links: Links) -> Float[Array, "P 3 N"]:
    """Return the translational Jacobians of points that are fixed to links [m/rad or m/m].

    Joints that do not move a point's link do not move the point: their columns are zero.

    Args:
        robot: The robot.
        x: The configuration [rad or m].
        points: Positions of the points at x, in the world [m].
        links: Index of each point's link, -1 for the world; `robot.capsule_link` for one point per capsule.
    """
    return by_coordinates(robot, by_joint(robot, x, points, links))


def by_joint(robot: Robot, x: Joints, points: Float[Array, "P 3"], links: Links | None) -> Float[Array, "P 3 J"]:
    """Return the Jacobians of points by the joints q, see `point_jacobians`; links None: every joint moves them."""
    if links is None:
        return _velocities(robot, _link_frames(robot, x), points).swapaxes(1, 2)
    if robot.coupling is None:
        moves = jnp.arange(len(robot.slides))[None, :] <= jnp.asarray(links)[:, None]
    else:
        moves = jnp.asarray(moved_by(robot.parents))[jnp.asarray(links)]
    velocities = _velocities(robot, _link_frames(robot, x), points)
    return jnp.where(moves[:, :, None], velocities, 0.0).swapaxes(1, 2)


def by_coordinates(robot: Robot, columns: Float[Array, "*n J"]) -> Float[Array, "*n N"]:
    """Return Jacobians by the coordinates x, from those by the joints q = C x + d."""
    if robot.coupling is None:
        return columns
    factors = robot.coupling.factors
    return product(columns, factors.reshape((1,) * (columns.ndim - 2) + factors.shape))


def joint_rates(robot: Robot, rates: Joints) -> Float[Array, "J"]:
    """Return the rates C x' of the joints q, from those of the coordinates [rad or m]."""
    return rates if robot.coupling is None else product(robot.coupling.factors, rates)


def joint_ranges(robot: Robot, turns: Joints) -> Float[Array, "J"]:
    """Return bounds |C| d on the motion of the joints q if every coordinate moves by at most d [rad or m]."""
    return turns if robot.coupling is None else product(jnp.abs(robot.coupling.factors), turns)


def joint_positions(robot: Robot, x: Joints) -> Float[Array, "J"]:
    """Return the joints' positions q = C x + d [rad or m]."""
    return x if robot.coupling is None else product(robot.coupling.factors, x) + robot.coupling.offsets


def point_positions(robot: Robot, x: Joints, points: Float[Array, "P 3"], links: Links) -> Float[Array, "P 3"]:
    """Return the positions in the world [m] of points that are fixed to links.

    Args:
        robot: The robot.
        x: The configuration [rad or m].
        points: Positions in the frames of the points' links [m].
        links: Index of each point's link, -1 for the world.
    """
    return _to_world(_frames_of(robot, x, links), points)


def directions(robot: Robot, x: Joints, vectors: Float[Array, "P 3"], links: Links) -> Float[Array, "P 3"]:
    """Rotate directions that are fixed to links into the world; lengths are preserved.

    Args:
        robot: The robot.
        x: The configuration [rad or m].
        vectors: Directions in the frames of their links, without a unit.
        links: Index of each direction's link, -1 for the world.
    """
    return product(_frames_of(robot, x, links).rotation, vectors[:, :, None])[..., 0]


def direction_jacobians(
    robot: Robot, x: Joints, directions: Float[Array, "P 3"], links: Links
) -> Float[Array, "P 3 N"]:
    """Return the Jacobians of `directions`: axis x direction for a hinge [1/rad], 0 for a slide [1/m].

    Args:
        robot: The robot.
        x: The configuration [rad or m].
        directions: Directions in the world at x, without a unit.
        links: Index of each direction's link, -1 for the world.
    """
    frames = _link_frames(robot, x)
    axes = product(frames.rotation, robot.axis[:, :, None])[..., 0]
    moves = moved_by(robot.parents)[np.array(links)] & ~jnp.asarray(robot.slides)[None, :]
    turning = jnp.cross(axes[None], directions[:, None])
    return by_coordinates(robot, jnp.where(moves[:, :, None], turning, 0.0).swapaxes(1, 2))


def checked_configuration(robot: Robot, x: Joints, name: str = "x") -> Joints:
    """Return x as an array of N joint positions.

    Args:
        robot: The robot.
        x: One configuration [rad or m], an array or a list.
        name: Name of x in the message.

    Raises:
        InputError: For any other shape, such as several configurations.
    """
    return checked_shape(x, (robot.dof,), f"{name} of {robot.name}")


def with_free_joints(robot: Robot) -> Robot:
    """Return the robot with its joints q as coordinates, for kinematics only: the limits remain those of x."""
    if robot.coupling is None:
        return robot
    joints = len(robot.slides)
    own = dataclasses.replace(
        robot.coupling, factors=jnp.eye(joints), offsets=jnp.zeros(joints), slides=tuple(robot.slides)
    )
    return dataclasses.replace(robot, joint_names=own.joint_names, coupling=own)


def is_periodic(robot: Robot) -> Bool[Anywhere, "N"]:
    """Return True for coordinates after one revolution of which every link is back in its place."""
    hinge = ~jnp.asarray(robot.slides)
    if robot.coupling is None:
        return hinge
    factors = robot.coupling.factors
    return jnp.all((factors == 0) | (factors == jnp.round(factors)) & hinge[:, None], axis=0)


def joint_travel(robot: Robot) -> Float[np.ndarray, "J"]:
    """Return the largest |q| of every joint within the limits [rad or m]."""
    lower, upper = np.asarray(robot.lower), np.asarray(robot.upper)
    if robot.coupling is not None:
        factors, offsets = np.asarray(robot.coupling.factors), np.asarray(robot.coupling.offsets)
        ends = [factors * np.where(factors != 0, limit, 0.0) for limit in (lower, upper)]
        lower, upper = (choose(*ends).sum(axis=1) + offsets for choose in (np.minimum, np.maximum))
    return np.maximum(np.abs(lower), np.abs(upper))


def max_reach(robot: Robot) -> float:
    """Return a bound on the TCP's distance from the origin of the first joint's frame [m].

    The bound is the sum of the lengths of links and tool and of the slides' travel; infinite if a slide has no limits.
    """
    chain = slice(robot.tcp_link + 1)
    links = np.linalg.norm(np.asarray(robot.T_parent_joint)[chain][1:, :3, 3], axis=1)
    travel = joint_travel(robot)[chain][np.array(robot.slides)[chain]]
    return float(links.sum() + travel.sum() + np.linalg.norm(np.asarray(robot.T_link_tcp)[:3, 3]))


def body_reach(robot: Robot) -> Float[np.ndarray, "K"]:
    """Return a bound on the distance of each body's points from the origin of the first joint's frame [m].

    The bound is computed as in `max_reach`; it is -inf for bodies that are fixed in the world.
    """
    links = np.linalg.norm(np.asarray(robot.T_parent_joint)[:, :3, 3], axis=1)
    to_base, links[0] = links[0], 0.0
    travel = np.where(robot.slides, joint_travel(robot), 0.0)
    along = np.cumsum(links + travel)
    for link in range(robot.tcp_link + 1, len(along)):  # on side branches
        parent = robot.parents[link]
        along[link] = links[link] + travel[link] + (along[parent] if parent >= 0 else to_base)
    to_link = np.append(along, -np.inf)[list(robot.capsule_link)]  # the world last: it is link -1
    ends = [np.linalg.norm(np.asarray(end), axis=1) for end in (robot.capsule_p, robot.capsule_q)]
    return to_link + np.maximum(*ends) + np.asarray(robot.capsule_radius)


class _Frames(NamedTuple):
    """Frames in the world."""

    rotation: Float[Array, "*n 3 3"]
    origin: Float[Array, "*n 3"]


@jax.jit
def _link_frames(robot: Robot, x: Joints) -> _Frames:
    """Return the frames of the J links, by multiplying the joints' motions along the chain."""
    x = joint_positions(robot, checked_configuration(robot, x))
    fixed = _Frames(robot.T_parent_joint[:, :3, :3], robot.T_parent_joint[:, :3, 3])
    slides = jnp.asarray(robot.slides)
    turn, slide = jnp.where(slides, 0.0, x), jnp.where(slides, x, 0.0)
    rotation = product(fixed.rotation, axis_angle_matrix(robot.axis, turn))
    steps = _Frames(rotation, _to_world(fixed, slide[:, None] * robot.axis))

    def then(last: _Frames, step: _Frames):
        link = _Frames(product(last.rotation, step.rotation), _to_world(last, step.origin))
        return link, link

    world = _Frames(jnp.eye(3, dtype=x.dtype), jnp.zeros(3, x.dtype))
    chain = jax.tree.map(lambda each: each[: robot.tcp_link + 1], steps) if robot.coupling else steps
    # On a CPU a loop costs little and keeps executables small: each contains the kinematics several times.
    found = jax.lax.scan(then, world, chain, unroll=1 if backend().is_cpu else robot.tcp_link + 1)[1]
    for link in range(robot.tcp_link + 1, len(slides)):  # on side branches
        parent = robot.parents[link]
        own = then(world if parent < 0 else _frame_at(found, parent), _frame_at(steps, link))[0]
        found = jax.tree.map(lambda every, one: jnp.concatenate([every, one[None]]), found, own)
    return found


def _frames_of(robot: Robot, x: Joints, links: Links) -> _Frames:
    """Return the frames of the given links, -1 for the world."""
    moving = _link_frames(robot, x)
    world = jnp.eye(3, 4, dtype=moving.origin.dtype)[None]
    with_world = _Frames(  # the world last, so that it is link -1
        jnp.concatenate([moving.rotation, world[:, :, :3]]), jnp.concatenate([moving.origin, world[:, :, 3]])
    )
    return _frame_at(with_world, jnp.asarray(links))


@jax.jit
def _velocities(robot: Robot, links: _Frames, points: Float[Array, "P 3"]) -> Float[Array, "P J 3"]:
    """Return each point's velocity per unit velocity of each joint q, as if all points were fixed to the last link."""
    axes = product(links.rotation, robot.axis[:, :, None])[..., 0]
    turning = jnp.cross(axes[None], points[:, None] - links.origin[None])
    return jnp.where(jnp.asarray(robot.slides)[None, :, None], axes[None], turning)


def _to_world(frames: _Frames, points: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    return product(frames.rotation, points[..., None])[..., 0] + frames.origin


def _frame_at(frames: _Frames, index: int | np.ndarray | Array) -> _Frames:
    return _Frames(frames.rotation[index], frames.origin[index])


def _homogeneous(frames: _Frames) -> Float[Array, "*n 4 4"]:
    top = jnp.concatenate([frames.rotation, frames.origin[..., None]], axis=-1)
    bottom = jnp.broadcast_to(jnp.eye(4, dtype=top.dtype)[3:], (*top.shape[:-2], 1, 4))
    return jnp.concatenate([top, bottom], axis=-2)
