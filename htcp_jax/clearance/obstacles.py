"""D(x, O): the smallest distance between the arm's capsules and the workpiece's points, and where it is attained.

D is the paper's (workspace inequality constraints): per body, the distance between the capsule's segment and the
nearest of all points, less the radius. "Outside the tunnel is negative": a capsule end beyond the gate (deeper than a
set depth behind where the cloud begins, along its inlet's direction) must lie in the cloud's convex hull; where it does
not, the body's clearance is at most minus how far outside it is. Where the points were sampled on a mesh, D is less by
the distance within which they cover it: a bound on the clearance to the mesh itself. The far-off point and the crossed
facet are found once and then held, so the gradient is that of a distance to a fixed point or plane: exact wherever D is
differentiable, and one of its one-sided gradients elsewhere.
"""

from dataclasses import dataclass
from functools import lru_cache, partial
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance.cloud_tree import CloudIndex, build_index, nearest_body, nearest_rows
from htcp_jax.clearance.half_spaces import HalfSpaces, crossed_facets, depths, half_spaces
from htcp_jax.numerics import product, safe_divide, safe_norm, segment_parameter
from htcp_jax.pytree import register_pytree
from htcp_jax.scene.kinematics import capsule_segments, jacobian, point_jacobians, tcp_position
from htcp_jax.scene.robot import Robot
from htcp_jax.scene.workpiece import Workpiece
from htcp_jax.types import Bool, Float, Int, Joints, Pose, Scalar, Vector3


@register_pytree
@dataclass(frozen=True)
class Obstacle:
    """The paper's O on the device, in the workpiece frame: points, their index, the hull's half-spaces, and how far
    from a point there may be wall [m], which makes every body that much thicker."""

    points: Float[jax.Array, "P 3"]
    index: CloudIndex
    hull: HalfSpaces
    cover: Float[jax.Array, ""]


@lru_cache(maxsize=2)
def make_obstacle(workpiece: Workpiece) -> Obstacle:
    """Obstacle of a workpiece, kept for the next plan. The order of its points does not change any distance."""
    return Obstacle(
        points=jnp.asarray(workpiece.cloud),
        index=build_index(np.asarray(workpiece.cloud)),
        hull=half_spaces(workpiece.hull_normal, workpiece.hull_offset, workpiece.hull_vertices),
        cover=jnp.asarray(workpiece.covering_radius_m, float),
    )


@runtime_checkable
class Posed(Protocol):
    """Where the workpiece is: a scenario, or whatever else knows."""

    T_world_workpiece: Pose
    gate: Float[jax.Array, "4"]  # unit normal n, offset [m]: capsule ends with n @ x > offset must lie in the tunnel


class Contacts(NamedTuple):
    """Per body, what is nearest to it: the point on the body's axis, and the direction away from the obstacle."""

    distance: Float[jax.Array, "K"]  # D per body [m]
    point: Float[jax.Array, "K 3"]  # on the body's axis, world [m]
    normal: Float[jax.Array, "K 3"]  # unit, from the obstacle to the body, world
    row: Int[jax.Array, "K"]  # nearest row of the cloud (also where the hull decides)
    reach: Float[jax.Array, "K"]  # from the axis: the body's radius and the cloud's cover [m]
    crossed: Bool[jax.Array, "K"]  # whether the hull decides, and not that row


class Linearisation(NamedTuple):
    """Task and clearance at one configuration, to first order."""

    tcp: Vector3  # [m]
    jacobian: Float[jax.Array, "3 N"]  # of the tcp [m/rad]
    clearance: Float[jax.Array, "K"]  # [m]
    gradient: Float[jax.Array, "K N"]  # [m/rad]


@jax.jit
def contacts(robot: Robot, obstacle: Obstacle, where: Posed, x: Joints) -> Contacts:
    """Nearest obstacle of every body at configuration x [rad]; its tool is the scenario's (see `lengthen_tool`)."""
    rotate, translate = where.T_world_workpiece[:3, :3], where.T_world_workpiece[:3, 3]
    ends = _ends(robot, where, x)
    row = nearest_rows(obstacle.index, ends.p, ends.q)
    witness = obstacle.points[row]
    s = segment_parameter(ends.p, ends.q, witness)[:, None]
    point = ends.p + s * (ends.q - ends.p)
    arm = point - witness
    length = safe_norm(arm)
    reach = robot.capsule_radius + obstacle.cover
    distance = length - reach
    normal = safe_divide(arm, jnp.broadcast_to(length[:, None], arm.shape))

    outside, end, inwards = _outside_hull(obstacle, ends)
    decides = outside > jnp.maximum(0.0, -distance)
    return Contacts(
        distance=jnp.where(decides, -outside, distance),
        point=product(jnp.where(decides[:, None], end, point), rotate.T) + translate[None, :],
        normal=product(jnp.where(decides[:, None], inwards, normal), rotate.T),
        row=row,
        reach=reach,
        crossed=decides,
    )


def clearances(robot: Robot, obstacle: Obstacle, where: Posed, x: Joints) -> Float[jax.Array, "K"]:
    """D per body [m]; its autodiff gradient, through the witness, is what `linearise` gives in closed form."""
    return contacts(robot, obstacle, where, x).distance


@jax.jit
def clearance(robot: Robot, obstacle: Obstacle, where: Posed, x: Joints) -> Scalar:
    """D(x, O) [m], the smallest over all bodies, exact: one search for all bodies, cheaper than `clearances`."""
    ends = _ends(robot, where, x)
    reach = robot.capsule_radius + obstacle.cover
    body, row = nearest_body(obstacle.index, ends.p, ends.q, reach)
    p, q, witness = ends.p[body], ends.q[body], obstacle.points[row]
    arm = p + segment_parameter(p, q, witness) * (q - p) - witness
    outside, _, _ = _outside_hull(obstacle, ends)
    return jnp.minimum(safe_norm(arm) - reach[body], jnp.min(jnp.where(outside > 0, -outside, jnp.inf)))


def is_clear(robot: Robot, obstacle: Obstacle, where: Posed, x: Joints) -> Bool[jax.Array, ""]:
    """Whether D(x, O) > 0; cheaper still, because the search passes over all points beyond the capsules' radii."""
    ends = _ends(robot, where, x)
    reach = robot.capsule_radius + obstacle.cover
    touching = nearest_body(obstacle.index, ends.p, ends.q, reach, below=0.0).row >= 0
    outside, _, _ = _outside_hull(obstacle, ends)
    return ~(touching | jnp.any(outside > 0))


def all_clear(robot: Robot, obstacle: Obstacle, where: Posed, x: Float[jax.Array, "S N"]) -> Bool[jax.Array, ""]:
    """Whether D(x_s, O) > 0 at all of S >= 1 configurations that lie close together: a path.

    Only the middle one is measured in full. A body is clear wherever its ends, and so all its points, have moved from
    there by less than its room; where they have moved further, it is searched for points that touch it.
    """
    if jax.default_backend() != "cpu":  # where a loop costs more than the measurements that it saves
        return jnp.all(jax.vmap(partial(is_clear, robot, obstacle, where))(x))
    middle = x.shape[0] // 2
    ends = jax.vmap(partial(_ends, robot, where))(x)
    free = room(robot, obstacle, where, x[middle])
    moved = jnp.maximum(safe_norm(ends.p - ends.p[middle][None]), safe_norm(ends.q - ends.q[middle][None]))
    open_ = moved >= free[None, :] - 1e-9  # [S K]; 1 nm is more than any rounding

    def check_body(state):
        left, _ = state
        body = jnp.argmax(left)
        p, q, here = ends.p[:, body], ends.q[:, body], open_[:, body]
        within = jnp.where(here, robot.capsule_radius[body] + obstacle.cover, -1.0)
        touching = jnp.any(nearest_rows(obstacle.index, p, q, within) >= 0)
        deep = here[None, :] & (ends.beyond.reshape(x.shape[0], 2, -1)[:, :, body].T > 0)
        return left & (jnp.arange(left.shape[0]) != body), ~(touching | _any_outside(obstacle, p, q, deep.reshape(-1)))

    start = (jnp.any(open_, axis=0), jnp.full((), True))
    return jax.lax.while_loop(lambda state: state[1] & jnp.any(state[0]), check_body, start)[1]


def room(robot: Robot, obstacle: Obstacle, where: Posed, x: Joints) -> Float[jax.Array, "K"]:
    """How far all points of a body may move from x, any way, and it surely stays clear [m]; at most 0 in collision."""
    D = clearances(robot, obstacle, where, x)
    if not obstacle.hull.offset.shape[0]:
        return D
    ends = _ends(robot, where, x)
    depth = depths(obstacle.hull, jnp.concatenate([ends.p, ends.q]), ends.beyond > 0)
    inside = jnp.where(ends.beyond > 0, depth, -ends.beyond).reshape(2, -1)
    return jnp.minimum(D, jnp.min(inside, axis=0))


def _any_outside(obstacle: Obstacle, p, q, deep):
    if not obstacle.hull.offset.shape[0]:
        return jnp.full((), False)
    return jnp.any(crossed_facets(obstacle.hull, jnp.concatenate([p, q]), deep) >= 0)


def linearise(robot: Robot, obstacle: Obstacle, where: Posed, x: Joints) -> Linearisation:
    """TCP, task Jacobian, clearances and their gradients at x [rad]."""
    touch = contacts(robot, obstacle, where, x)
    motion = point_jacobians(robot, x, touch.point, robot.capsule_link)
    return Linearisation(
        tcp=tcp_position(robot, x),
        jacobian=jacobian(robot, x),
        clearance=touch.distance,
        gradient=jnp.sum(touch.normal[:, :, None] * motion, axis=1),
    )


class _Ends(NamedTuple):
    """Ends of the bodies' segments in the workpiece frame, and how far they are beyond the gate (p's, then q's) [m]."""

    p: Float[jax.Array, "K 3"]
    q: Float[jax.Array, "K 3"]
    beyond: Float[jax.Array, "2K"]


def _ends(robot: Robot, where: Posed, x: Joints) -> _Ends:
    rotate, translate = where.T_world_workpiece[:3, :3], where.T_world_workpiece[:3, 3]
    p, q = capsule_segments(robot, x)
    beyond = product(jnp.concatenate([p, q]), where.gate[:3]) - where.gate[3]
    return _Ends(product(p - translate[None, :], rotate), product(q - translate[None, :], rotate), beyond)


def _outside_hull(obstacle: Obstacle, ends: _Ends):
    """Per body: how far its further deep end lies outside the hull [m] (-inf when none does), that end, the inward
    normal of the facet it crossed. Workpiece frame."""
    if not obstacle.hull.offset.shape[0]:
        return jnp.full(ends.p.shape[0], -jnp.inf), ends.p, jnp.zeros_like(ends.p)
    both = jnp.concatenate([ends.p, ends.q])
    facet = crossed_facets(obstacle.hull, both, ends.beyond > 0)
    normal = obstacle.hull.normal[facet]
    outside = jnp.where(facet < 0, -jnp.inf, jnp.sum(normal * both, axis=1) - obstacle.hull.offset[facet])
    k = ends.p.shape[0]
    second = outside[k:] > outside[:k]
    return (
        jnp.maximum(outside[:k], outside[k:]),
        jnp.where(second[:, None], ends.q, ends.p),
        -jnp.where(second[:, None], normal[k:], normal[:k]),
    )
