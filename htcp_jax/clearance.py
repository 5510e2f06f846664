"""D(x, O): the smallest distance between the arm's capsules and the workpiece's points, and where it is attained.

D is the paper's (workspace inequality constraints): per body, the distance between the capsule's segment and the
nearest of all points, less the radius. "Outside the tunnel is negative": a capsule end beyond the gate (deeper than a
set depth behind the cloud's nearest world x) must lie in the cloud's convex hull; where it does not, the body's
clearance is at most minus how far outside it is. The far-off point and the crossed facet are found once and then held,
so the gradient is that of a distance to a fixed point or plane: exact wherever D is differentiable, and one of its
one-sided gradients elsewhere.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.cloud_index import CloudIndex, build_index, nearest_body, nearest_rows
from htcp_jax.half_spaces import HalfSpaces, crossed_facets
from htcp_jax.kinematics import capsule_segments, jacobian, point_jacobians, tcp_position
from htcp_jax.numerics import safe_divide, safe_norm, segment_parameter
from htcp_jax.pytree import register_pytree
from htcp_jax.robot import Robot
from htcp_jax.types import Bool, Float, Int, Joints, Pose, Scalar, Vector3
from htcp_jax.workpiece import Workpiece


@register_pytree
@dataclass(frozen=True)
class Obstacle:
    """The paper's O on the device, in the workpiece frame: points, their index, and the hull's half-spaces."""

    points: Float[jax.Array, "P 3"]
    index: CloudIndex
    hull: HalfSpaces


def make_obstacle(workpiece: Workpiece) -> Obstacle:
    """Obstacle of a workpiece. The order of its points does not change any distance."""
    return Obstacle(
        points=jnp.asarray(workpiece.cloud),
        index=build_index(np.asarray(workpiece.cloud)),
        hull=HalfSpaces(jnp.asarray(workpiece.hull_normal), jnp.asarray(workpiece.hull_offset)),
    )


@runtime_checkable
class Posed(Protocol):
    """Where the workpiece is: a scenario, or whatever else knows."""

    T_world_workpiece: Pose
    gate_x: Scalar  # capsule ends with a world x beyond this must lie inside the tunnel [m]


class Contacts(NamedTuple):
    """Per body, what is nearest to it: the point on the body's axis, and the direction away from the obstacle."""

    distance: Float[jax.Array, "K"]  # D per body [m]
    point: Float[jax.Array, "K 3"]  # on the body's axis, world [m]
    normal: Float[jax.Array, "K 3"]  # unit, from the obstacle to the body, world
    row: Int[jax.Array, "K"]  # nearest row of the cloud (also where the hull decides)
    crossed: Bool[jax.Array, "K"]  # whether the hull decides, and not that row


class Linearisation(NamedTuple):
    """Task and clearance at one configuration, to first order."""

    tcp: Vector3  # [m]
    jacobian: Float[jax.Array, "3 N"]
    clearance: Float[jax.Array, "K"]  # [m]
    gradient: Float[jax.Array, "K N"]  # [m/rad]


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
    distance = length - robot.capsule_radius
    normal = safe_divide(arm, jnp.broadcast_to(length[:, None], arm.shape))

    outside, end, inwards = _outside_hull(obstacle, ends)
    decides = outside > jnp.maximum(0.0, -distance)
    return Contacts(
        distance=jnp.where(decides, -outside, distance),
        point=jnp.where(decides[:, None], end, point) @ rotate.T + translate[None, :],
        normal=jnp.where(decides[:, None], inwards, normal) @ rotate.T,
        row=row,
        crossed=decides,
    )


def clearances(robot: Robot, obstacle: Obstacle, where: Posed, x: Joints) -> Float[jax.Array, "K"]:
    """D per body [m]; its autodiff gradient, through the witness, is what `linearise` gives in closed form."""
    return contacts(robot, obstacle, where, x).distance


def clearance(robot: Robot, obstacle: Obstacle, where: Posed, x: Joints) -> Scalar:
    """D(x, O) [m], the smallest over all bodies, exact: one search for all bodies, cheaper than `clearances`."""
    ends = _ends(robot, where, x)
    body, row = nearest_body(obstacle.index, ends.p, ends.q, robot.capsule_radius)
    p, q, witness = ends.p[body], ends.q[body], obstacle.points[row]
    arm = p + segment_parameter(p, q, witness) * (q - p) - witness
    outside, _, _ = _outside_hull(obstacle, ends)
    return jnp.minimum(safe_norm(arm) - robot.capsule_radius[body], jnp.min(jnp.where(outside > 0, -outside, jnp.inf)))


def is_clear(robot: Robot, obstacle: Obstacle, where: Posed, x: Joints) -> Bool[jax.Array, ""]:
    """Whether D(x, O) > 0; cheaper still, because the search passes over all points beyond the capsules' radii."""
    ends = _ends(robot, where, x)
    touching = nearest_body(obstacle.index, ends.p, ends.q, robot.capsule_radius, below=0.0).row >= 0
    outside, _, _ = _outside_hull(obstacle, ends)
    return ~(touching | jnp.any(outside > 0))


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
    """Ends of the bodies' segments in the workpiece frame, and which of them are beyond the gate (p's, then q's)."""

    p: Float[jax.Array, "K 3"]
    q: Float[jax.Array, "K 3"]
    deep: Bool[jax.Array, "2K"]


def _ends(robot: Robot, where: Posed, x: Joints) -> _Ends:
    rotate, translate = where.T_world_workpiece[:3, :3], where.T_world_workpiece[:3, 3]
    p, q = capsule_segments(robot, x)
    deep = jnp.concatenate([p, q])[:, 0] > where.gate_x
    return _Ends((p - translate[None, :]) @ rotate, (q - translate[None, :]) @ rotate, deep)


def _outside_hull(obstacle: Obstacle, ends: _Ends):
    """Per body: how far its further deep end lies outside the hull [m] (-inf when none does), that end, the inward
    normal of the facet it crossed. Workpiece frame."""
    if not obstacle.hull.offset.shape[0]:
        return jnp.full(ends.p.shape[0], -jnp.inf), ends.p, jnp.zeros_like(ends.p)
    both = jnp.concatenate([ends.p, ends.q])
    facet = crossed_facets(obstacle.hull, both, ends.deep)
    normal = obstacle.hull.normal[facet]
    outside = jnp.where(facet < 0, -jnp.inf, jnp.sum(normal * both, axis=1) - obstacle.hull.offset[facet])
    k = ends.p.shape[0]
    second = outside[k:] > outside[:k]
    return (
        jnp.maximum(outside[:k], outside[k:]),
        jnp.where(second[:, None], ends.q, ends.p),
        -jnp.where(second[:, None], normal[k:], normal[:k]),
    )
